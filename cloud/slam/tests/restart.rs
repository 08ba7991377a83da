//! Tests of SLAM for a robot that was restarted, is surrounded by people, or waits.

#![allow(clippy::unwrap_used, reason = "tests")]

use zenav_pose_graph::Optimality;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;
use zenav_slam::{Effects, Slam, SlamSettings};

mod house;

use house::{House, lap};

/// A map of the first two sides of the house, and the robot's pose at its end: the true one, and in the map.
fn driven() -> (Slam, Pose2, Pose2) {
    let truth = lap(0, 2);
    let mut slam = Slam::beside_a_robot(SlamSettings::default(), truth[0]);
    let mut pose = truth[0];
    for scan in House::usual().log(&truth, 1) {
        pose = slam.step(&scan).unwrap().pose;
    }
    (slam, *truth.last().unwrap(), pose)
}

/// Scans of a standing robot whose odometry is zero.
fn standing(at: Pose2, count: usize) -> Vec<Scan> {
    let mut scans = House::usual().log(&vec![at; count], 5);
    for (index, scan) in scans.iter_mut().enumerate() {
        scan.stamp = Stamp::from_secs(1000.0 + 0.2 * index as f64);
        scan.odom_from_base = Pose2::IDENTITY;
    }
    scans
}

#[test]
fn a_restarted_robot_at_rest_is_found_by_the_first_scan_that_fits_and_stays_found() {
    for (moved, unseen) in [
        (Pose2::IDENTITY, 0),
        (Pose2::new(0.25, -0.2, 0.2), 0),
        (Pose2::new(1.5, 0.3, 0.4), 20),
    ] {
        let (mut slam, truth, pose) = driven();
        let (nodes, map_from_truth) = (slam.nodes().len(), pose * truth.inverse());
        slam.interrupt(unseen);
        let effects: Vec<Effects> = standing(truth * moved, 10)
            .iter()
            .map(|scan| slam.step(scan).unwrap())
            .collect();
        for effects in &effects {
            let off = effects.pose.distance(&(map_from_truth * truth * moved));
            assert!(
                effects.score.is_some() && effects.fits && off < 0.05,
                "{moved:?}: {off} m off, {effects:?}"
            );
        }
        assert_eq!(slam.nodes().len(), nodes + 1, "one node says where it was found");
    }
}

#[test]
fn a_robot_that_was_restarted_elsewhere_at_rest_makes_no_node_and_fits_nowhere() {
    let (mut slam, truth, _) = driven();
    let nodes = slam.nodes().len();
    slam.interrupt(0);
    // Beams that end in mid-air, as in a crowd that was not there before.
    for mut scan in standing(truth, 8) {
        for (beam, range) in scan.ranges.iter_mut().enumerate() {
            *range = 0.5 + 0.3 * ((beam * 7 % 11) as f32 / 11.0);
        }
        let effects = slam.step(&scan).unwrap();
        assert!(effects.score.is_none() && !effects.fits, "{effects:?}");
    }
    assert_eq!(slam.nodes().len(), nodes);
    let found = slam.step(&standing(truth, 9)[8]).unwrap();
    assert!(found.score.is_some(), "{found:?}");
}

#[test]
fn a_scan_at_rest_that_would_do_for_a_node_contradicts_nothing() {
    let (mut slam, truth, _) = driven();
    slam.interrupt(0);
    let mut between = 0;
    for (index, mut scan) in standing(truth, 10).into_iter().enumerate() {
        // A person beside the robot hides a part of its beams.
        if index > 0 {
            for range in &mut scan.ranges[..50] {
                *range = range.min(0.6);
            }
        }
        let effects = slam.step(&scan).unwrap();
        assert!(effects.fits, "{effects:?}");
        between += usize::from(effects.score.is_none());
    }
    assert_eq!(between, 9, "too little for a correction");
}

#[test]
fn who_stands_around_the_robot_contradicts_nothing_and_a_look_through_walls_does() {
    let (mut slam, truth, _) = driven();
    slam.interrupt(0);
    let mut scans = standing(truth, 11).into_iter();
    slam.step(&scans.next().unwrap()).unwrap();
    for (index, mut scan) in scans.enumerate() {
        let is_among_people = index < 5;
        for range in &mut scan.ranges {
            *range = if is_among_people { range.min(0.5) } else { 1.6 * *range };
        }
        let effects = slam.step(&scan).unwrap();
        assert!(
            !effects.fits && effects.contradicts != is_among_people,
            "{index}: {effects:?}"
        );
    }
}

#[test]
fn who_walked_ahead_of_the_robot_and_away_contradicts_nothing() {
    let mut truth = lap(0, 2);
    let driven = truth.len();
    truth.extend([truth[driven - 1]; 3]);
    let mut slam = Slam::beside_a_robot(SlamSettings::default(), truth[0]);
    for (index, mut scan) in House::usual().log(&truth, 1).into_iter().enumerate() {
        let has_left = index >= driven;
        if has_left {
            // Others stand behind the robot.
            for beam in 0..scan.ranges.len() {
                let is_behind = scan.angle(beam).cos() < 0.0;
                scan.ranges[beam] = scan.ranges[beam].min(if is_behind { 0.5 } else { f32::INFINITY });
            }
        } else {
            house::put_ahead(&mut scan, 1.5, 0.8);
        }
        let effects = slam.step(&scan).unwrap();
        assert!(
            !has_left || effects.score.is_none() && !effects.contradicts,
            "{effects:?}"
        );
    }
}

#[test]
fn a_robot_that_is_carried_away_between_two_scans_is_lost_at_once_and_draws_nothing() {
    let mut truth = lap(0, 2);
    let (driven, here) = (truth.len(), *truth.last().unwrap());
    // The second place is a corner.
    for there in [truth[40] * Pose2::new(0.0, 0.3, 1.2), Pose2::new(11.3, 7.3, 0.8)] {
        truth.truncate(driven);
        truth.extend([there, there, there, here]);
        let mut scans = House::usual().log(&truth, 1);
        for index in driven..scans.len() {
            scans[index].odom_from_base = scans[driven - 1].odom_from_base;
        }
        let mut slam = Slam::beside_a_robot(SlamSettings::default(), truth[0]);
        for scan in &scans[..driven] {
            slam.step(scan).unwrap();
            assert!(!slam.was_carried());
        }
        let nodes = slam.nodes().len();
        for scan in &scans[driven..driven + 3] {
            let effects = slam.step(scan).unwrap();
            assert!(effects.contradicts && !effects.is_inserted, "{there:?}: {effects:?}");
            assert!(slam.was_carried() && slam.is_lost(), "{there:?}");
        }
        assert_eq!(slam.nodes().len(), nodes);
        let back = slam.step(&scans[driven + 3]).unwrap();
        assert!(
            back.fits && !slam.is_lost() && !slam.was_carried(),
            "{there:?}: {back:?}"
        );
    }
}

#[test]
fn a_robot_that_slips_between_two_scans_was_not_carried() {
    let mut truth = lap(0, 2);
    let here = *truth.last().unwrap();
    let slipped = here * Pose2::new(0.1, 0.1, 0.2);
    truth.push(slipped);
    let mut scans = House::usual().log(&truth, 1);
    let last = scans.len() - 1;
    scans[last].odom_from_base = scans[last - 1].odom_from_base;
    let mut slam = Slam::beside_a_robot(SlamSettings::default(), truth[0]);
    for scan in &scans[..last] {
        slam.step(scan).unwrap();
    }
    slam.step(&scans[last]).unwrap();
    assert!(!slam.was_carried());
}

#[test]
fn a_robot_that_was_carried_goes_on_where_it_is_told_to_be_if_its_scan_says_so_too() {
    let (slam, truth, pose) = driven();
    let map_from_truth = pose * truth.inverse();
    let there = lap(0, 2)[40];
    let scan = &standing(there, 1)[0];
    let guess = map_from_truth * there * Pose2::new(0.5, -0.3, 0.2);
    let (mut found, effects) = slam.go_on_at(guess, scan).unwrap().unwrap();
    let off = effects.pose.distance(&(map_from_truth * there));
    assert!(
        effects.is_inserted && effects.fits && effects.moved.is_none() && off < 0.05,
        "{off} m: {effects:?}"
    );
    assert_eq!(found.sessions(), [slam.nodes().len(), 1]);
    assert!(slam.go_on_at(pose, scan).unwrap().is_none(), "it is not where it was");

    // Both drives are one graph, which can be solved.
    let mut truth = there;
    for nth in 1..30 {
        let step = Pose2::new(0.05, 0.0, 0.0);
        truth = truth * step;
        let mut scan = standing(truth, 1).remove(0);
        scan.stamp = Stamp::from_secs(1001.0 + 0.2 * f64::from(nth));
        scan.odom_from_base = Pose2::new(0.05 * f64::from(nth), 0.0, 0.0);
        let off = found.step(&scan).unwrap().pose.distance(&(map_from_truth * truth));
        assert!(off < 0.06, "{nth}: {off} m off");
    }
    let solved = found.finish().unwrap();
    assert_eq!(solved.solution.certificate.optimality, Optimality::Certified);
}

#[test]
fn a_log_goes_on_after_scans_that_contradict_its_map() {
    let truth = lap(0, 2);
    let mut slam = Slam::new(SlamSettings::default());
    let mut other = House::another().log(&truth, 1);
    let scans = House::usual().log(&truth, 1);
    let half = scans.len() / 2;
    for scan in &scans[..half] {
        slam.step(scan).unwrap();
    }
    let before = slam.nodes().len();
    for scan in &mut other[half..] {
        slam.step(scan).unwrap();
    }
    assert!(!slam.is_lost());
    let (went_on, all) = (slam.nodes().len() - before, scans.len() - half);
    assert!(went_on + 12 > all, "{went_on} of {all} scans");
}
