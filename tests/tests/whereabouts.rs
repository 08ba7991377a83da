//! Does a robot without GPS and compass find its goal, with wrong odometry parameters? In lockstep, by the simulator's ground truth.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::time::Duration;

use zenav_cloud::mapping::PoseSource;
use zenav_tests::process::run;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");

/// Report of a drive of the worn TIAGo through the house or the kitchen.
fn drive(arguments: &str) -> serde_json::Value {
    let arguments = format!("run --robot tiago+indoor+worn --timeout 120 -o json {arguments}");
    let arguments: Vec<&str> = arguments.split(' ').collect();
    let folder = tempfile::tempdir().unwrap();
    let output = run(ZENAV, &arguments, folder.path(), Duration::from_secs(240));
    serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{output:?}"))
}

#[test]
fn a_closure_of_a_metre_leaves_a_driving_robot_on_its_way_at_its_speed_and_its_goal_on_its_spot() {
    let closing = zenav_tests::acceptance::closure::drive(1).unwrap();
    // On this seed SLAM alone is off by 5 cm there.
    assert!(
        closing.succeeded && closing.error < closing.error_without + 0.01,
        "{closing:?}"
    );
    assert!(
        closing.beside < 0.03 && closing.later < 0.5 && closing.stood == 0.0,
        "{closing:?}"
    );
    assert_eq!((closing.frames, closing.collisions), (1, 0), "{closing:?}");
}

#[test]
fn a_robot_that_is_carried_away_while_it_maps_finds_itself_in_its_own_map() {
    // On the second seed the scan fits near its old place, too.
    for seed in [1009, 7054] {
        let told = zenav_tests::acceptance::kidnapped::kidnap(seed, PoseSource::Slam).unwrap();
        assert!(told.is_good() && told.succeeded && told.off < 0.05, "{told:?}");
    }
}

#[test]
fn in_a_known_map_it_is_at_its_goal_to_a_few_centimetres_although_its_odometry_is_not() {
    let goal = "--world house --goal 2.2 1.6 --known-map --tolerance 0.1";
    let found = drive(&format!("{goal} --poses localise"));
    assert_eq!(found["outcome"], "reached", "{found}");
    assert!(found["pose_error_m"].as_f64().unwrap() < 0.07, "{found}");
    let reckoned = drive(&format!("{goal} --poses edge"));
    assert!(reckoned["pose_error_m"].as_f64().unwrap() > 0.1, "{reckoned}");
}

#[test]
fn slam_maps_the_kitchen_from_scans_and_odometry_alone_and_alike_again() {
    let arguments = "--world kitchen --goal 0.88 0.09 --poses slam";
    let (one, two) = (drive(arguments), drive(arguments));
    assert_eq!(one["outcome"], "reached", "{one}");
    assert!(one["pose_error_m"].as_f64().unwrap() < 0.05, "{one}");
    assert_eq!(one, two, "bit for bit from a seed");
}

#[test]
fn localisation_without_a_map_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["run", "--world", "kitchen", "--goal", "0", "0", "--poses", "localise"];
    let output = run(ZENAV, &arguments, folder.path(), Duration::from_secs(60));
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--known-map"));
}
