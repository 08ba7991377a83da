//! A few of the many worlds that `acceptance` proves the robot's side in.

#![allow(clippy::unwrap_used, reason = "tests")]

use zenav_tests::proving::guard::{Command, drive};

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
