//! Tests of solves beside a robot: their poses come with a later scan, the same whoever computes them, and each says whether it is certified.

#![allow(clippy::unwrap_used, reason = "tests")]

use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::GraphCertificate;
use zenav_protocol::time::Stamp;
use zenav_slam::{Slam, SlamSettings};

mod house;

#[test]
fn each_solve_after_a_closure_is_certified_once_its_poses_are_adopted() {
    let (scans, _) = house::drive(1);
    let mut slam = Slam::beside_a_robot(SlamSettings::default(), Pose2::IDENTITY);
    let (mut closures, mut begun, mut adopted) = (0, 0, 0);
    for scan in &scans {
        let effects = slam.step(scan).unwrap();
        closures += effects.closures;
        if closures == 0 {
            assert_eq!(slam.certificate(), GraphCertificate::NotSolved);
        }
        if effects.moved.is_some() {
            adopted += 1;
            assert_eq!(slam.certificate(), GraphCertificate::Certified, "solve {adopted}");
        }
        if effects.begins_solve {
            begun += 1;
            let begin = scan.stamp.as_secs();
            assert!(slam.waits_for_solve(begin + 0.2) && !slam.waits_for_solve(begin));
            slam.last_solve().unwrap().run();
            assert_eq!(slam.certificate(), GraphCertificate::Pending, "not adopted yet");
            assert!(!slam.waits_for_solve(f64::MAX));
        }
    }
    assert!(begun > 0 && adopted + 1 >= begun, "{adopted} of {begun}");
}

#[test]
fn the_map_is_the_same_whether_solves_are_computed_ahead_or_not() {
    let (scans, _) = house::drive(2);
    let map = |is_ahead: bool| {
        let mut slam = Slam::beside_a_robot(SlamSettings::default(), Pose2::IDENTITY);
        let mut poses = Vec::new();
        for scan in &scans {
            let effects = slam.step(scan).unwrap();
            if is_ahead && let Some(solve) = slam.last_solve().filter(|_| effects.begins_solve) {
                solve.run();
            }
            poses.push((effects.pose, effects.moved));
        }
        (poses, slam.nodes().to_vec(), slam.weights().to_vec())
    };
    assert_eq!(map(true), map(false));
}

#[test]
fn a_solve_that_a_session_was_stored_without_begins_anew_after_it_was_loaded() {
    let (scans, _) = house::drive(1);
    let mut slam = Slam::beside_a_robot(SlamSettings::default(), Pose2::IDENTITY);
    let begun = scans
        .iter()
        .position(|scan| slam.step(scan).unwrap().begins_solve)
        .unwrap();
    let mut settings = SlamSettings::default();
    settings.closure.gap = 100_000;
    let mut loaded = Slam::load(&slam.save().unwrap()).unwrap().with_settings(settings);
    assert_eq!(loaded.certificate(), GraphCertificate::NotSolved);
    let submaps = loaded.submaps();
    for scan in &scans[begun + 1..] {
        let effects = loaded.step(scan).unwrap();
        if effects.begins_solve {
            break;
        }
        assert_eq!(effects.closures, 0, "a closure would make a solve due, too");
        assert_eq!(loaded.submaps(), submaps, "due with the next submap");
    }
    assert!(loaded.last_solve().is_some());
}

#[test]
fn a_solve_that_was_pending_when_the_robot_restarted_with_another_clock_is_made_again() {
    let (mut scans, _) = house::drive(1);
    let mut slam = Slam::beside_a_robot(SlamSettings::default(), Pose2::IDENTITY);
    let begun = scans
        .iter()
        .position(|scan| slam.step(scan).unwrap().begins_solve)
        .unwrap();
    slam.interrupt(0);
    let mut later = scans[begun + 1..].iter_mut().enumerate();
    assert!(later.any(|(index, scan)| {
        scan.stamp = Stamp::from_secs(0.2 * index as f64);
        slam.step(scan).unwrap().moved.is_some()
    }));
}
