//! A few of the many worlds of the `acceptance` command.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::process::Stdio;
use std::time::Duration;

use zenav_edge::trackers::LAWS;
use zenav_fixtures::robot;
use zenav_protocol::messages::DrivingProfile;
use zenav_sim::World;
use zenav_tests::acceptance::guard::{Command, Protection, drive};
use zenav_tests::acceptance::{pose, tracking};

#[test]
fn whatever_it_is_told_the_robot_drives_into_nothing_and_finishes_what_is_harmless() {
    let mut way = 0.0;
    let mut benign = 0;
    for seed in 1..=24 {
        let outcome = drive(seed, Protection::Monitored).unwrap();
        assert!(outcome.is_good(), "{outcome:?}");
        way += outcome.length;
        benign += u32::from(outcome.command == Command::Benign);
    }
    assert!(
        way > 25.0 && benign > 1,
        "a robot that never moves passes nothing: {way} m"
    );
}

#[test]
fn a_run_whose_findings_nobody_reads_ends_without_an_error() {
    let acceptance = std::process::Command::new(env!("CARGO_BIN_EXE_acceptance"))
        .args(["replay", "1"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let mut acceptance = acceptance.unwrap();
    drop(acceptance.stdout.take());
    let ended = acceptance.wait_with_output().unwrap();
    assert!(ended.status.success() && ended.stderr.is_empty(), "{ended:?}");
}

#[test]
fn without_the_collision_monitor_the_same_commands_drive_the_robot_into_things() {
    let unprotected = (1..=12).map(|seed| drive(seed, Protection::Unprotected).unwrap());
    let teleoperated: Vec<_> = unprotected
        .filter(|outcome| ![Command::Benign, Command::ThroughWalls].contains(&outcome.command))
        .collect();
    let bad = teleoperated.iter().filter(|outcome| !outcome.is_good()).count();
    assert!(
        2 * bad > teleoperated.len() && teleoperated.len() > 6,
        "only {bad} of {} runs are dangerous: they prove little of the monitor",
        teleoperated.len()
    );
}

#[test]
fn the_estimate_is_as_good_as_its_covariance_says_with_late_and_missing_readings_and_without_gps() {
    // Errors within one drive are strongly correlated: a drive counts as little more than one sample, so the band is that of a single
    // step.
    const DRIVES: u32 = 40;
    let runs = f64::from(DRIVES);
    let (low, high) = pose::band(3.0, runs);
    for conditions in pose::CONDITIONS {
        let mut sums = pose::Sums::default();
        for seed in 1..=DRIVES {
            pose::drive(&mut sums, &conditions, seed.into(), 20.0, &|| Duration::ZERO).unwrap();
        }
        let means: Vec<f64> = sums.nees.iter().map(|sum| sum / runs).collect();
        let (_, mean) = pose::share(&means, (low, high));
        assert!((low..high).contains(&mean), "{conditions:?}: {mean} in {low}..{high}");
        let told = |scale: f64| !(low..high).contains(&(mean / scale));
        assert!(
            told(1.4) && told(1.0 / 1.4),
            "{conditions:?}: a covariance that is 40 % off would pass"
        );
        assert!(
            f64::from(sums.within.0) > 0.99 * f64::from(sums.within.1),
            "{conditions:?}"
        );
    }
}

#[test]
fn under_a_wrong_assumption_the_estimate_is_inconsistent_but_its_errors_stay_of_the_order_that_it_says() {
    const DRIVES: u32 = 20;
    let runs = f64::from(DRIVES);
    let [.., gps] = pose::MISMATCHED.map(|conditions| {
        let mut sums = pose::Sums::default();
        for seed in 1..=DRIVES {
            pose::drive(&mut sums, &conditions, seed.into(), 20.0, &|| Duration::ZERO).unwrap();
        }
        assert!(
            f64::from(sums.within.0) > 0.9 * f64::from(sums.within.1),
            "{conditions:?}"
        );
        sums.nees.iter().sum::<f64>() / (runs * sums.nees.len() as f64)
    });
    let (_, high) = pose::band(3.0, runs);
    assert!(gps > high, "GPS that reports too little noise is not noticed: {gps}");
}

#[test]
fn the_time_law_keeps_to_its_reference_more_closely_than_any_other_tracker() {
    let model = robot("tiago");
    let world = World::shipped("kitchen").unwrap();
    let paths = tracking::planned_paths(&tracking::true_map(&world), &model, 2, 2, DrivingProfile::Fastest);
    assert_eq!(paths.len(), 2);
    let p95 = |law: &str| {
        let mut errors = Vec::new();
        for path in &paths {
            let drive = tracking::drive(&world, &model, law, path, tracking::Localised::OnBoard, 1).unwrap();
            // Where the original wheel law swings wide, the collision monitor may hold it.
            let arrived = drive.secs.is_some() || law == tracking::ORIGINAL;
            assert!(arrived && drive.contacts == 0, "{law:?}: {drive:?}");
            errors.extend(drive.errors);
        }
        tracking::percentile(&mut errors, 0.95)
    };
    let own = p95("time_law");
    assert!(own < 0.03, "{own}");
    for law in LAWS.iter().map(|law| law.name).filter(|law| *law != "time_law") {
        let other = p95(law);
        assert!(own < other, "{law:?}: {other}, the time law {own}");
    }
}

#[test]
fn on_the_same_corner_way_the_time_law_keeps_to_the_corners_and_the_original_wheel_law_cuts_them() {
    let model = robot("tiago");
    let (world, way) = (World::shipped("empty").unwrap(), tracking::corner_way(&model));
    let [own, original] = ["time_law", tracking::ORIGINAL].map(|law| {
        let mut drive = tracking::drive(&world, &model, law, &way, tracking::Localised::OnBoard, 1).unwrap();
        assert!(drive.secs.is_some() && drive.contacts == 0, "{law}: {drive:?}");
        tracking::percentile(&mut drive.errors, 0.95)
    });
    assert!(own < 0.03 && own < original, "{own} {original}");
}
