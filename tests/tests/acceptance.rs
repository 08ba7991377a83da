//! A few of the many worlds that `acceptance` proves the robot's side in.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::time::Duration;

use zenav_protocol::messages::DrivingProfile;
use zenav_protocol::robot::TrackerKind;
use zenav_sim::World;
use zenav_tests::acceptance::guard::{Command, drive};
use zenav_tests::acceptance::{pose, sim_rig, tracking};

#[test]
fn whatever_it_is_told_the_robot_drives_into_nothing_and_finishes_what_is_harmless() {
    let mut way = 0.0;
    let mut benign = 0;
    for seed in 1..=24 {
        let outcome = drive(seed).unwrap();
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
fn the_estimate_is_as_good_as_its_covariance_says_with_late_and_missing_readings_and_without_gps() {
    for conditions in pose::CONDITIONS {
        let mut sums = pose::Sums::default();
        for seed in 1..=20 {
            pose::drive(&mut sums, &conditions, seed, 20.0, &|| Duration::ZERO).unwrap();
        }
        let means: Vec<f64> = sums.nees.iter().map(|sum| sum / 20.0).collect();
        let (_, mean) = pose::share(&means, (0.0, 1.0));
        assert!((2.0..4.2).contains(&mean), "{conditions:?}: {mean}");
        assert!(
            f64::from(sums.within.0) > 0.99 * f64::from(sums.within.1),
            "{conditions:?}"
        );
    }
}

#[test]
fn the_time_law_keeps_to_its_path_more_closely_than_any_other_tracker() {
    let model = sim_rig::robot("tiago").unwrap();
    let world = World::shipped("kitchen").unwrap();
    let ways = tracking::ways(&tracking::true_map(&world), &model, 2, 2, DrivingProfile::Fastest);
    assert_eq!(ways.len(), 2);
    let p95 = |law: TrackerKind| {
        let mut errors = Vec::new();
        for way in &ways {
            let drive = tracking::drive(&world, &model, law, way, tracking::Localised::Alone, 1).unwrap();
            assert!(drive.secs.is_some() && drive.contacts == 0, "{law:?}: {drive:?}");
            errors.extend(drive.errors);
        }
        tracking::percentile(&mut errors, 0.95)
    };
    let own = p95(TrackerKind::TimeLaw);
    assert!(own < 0.03, "{own}");
    for (_, law) in tracking::LAWS
        .into_iter()
        .filter(|(_, law)| *law != TrackerKind::TimeLaw)
    {
        let other = p95(law);
        assert!(own < other, "{law:?}: {other}, the time law {own}");
    }
}
