//! Tests of mapping a log: the poses are right, and errors are reported.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::f64::consts::FRAC_PI_2;

use nalgebra::Point2;
use proptest::prelude::*;
use zenav_pose_graph::{EdgeKind, Optimality};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::Scan;
use zenav_protocol::settings::Settings;
use zenav_protocol::time::Stamp;
use zenav_scan_matching::{ScanSettings, points};
use zenav_slam::{Relation, Slam, SlamError, SlamSettings, in_order, read_relations, relation_errors};

mod house;

fn odometry(scans: &[Scan]) -> Vec<(f64, Pose2)> {
    scans
        .iter()
        .map(|scan| (scan.stamp.as_secs(), scan.odom_from_base))
        .collect()
}

#[test]
fn a_drive_through_a_house_is_mapped_closed_and_certified() {
    let (scans, relations) = house::drive(1);
    let raw = relation_errors(&odometry(&scans), &relations).unwrap();
    let mut slam = Slam::new(SlamSettings::default());
    let mut closures = 0;
    for scan in &scans {
        closures += slam.step(scan).unwrap().closures;
    }
    let solved = slam.finish().unwrap();
    let errors = relation_errors(&slam.trajectory(), &relations).unwrap();
    assert!(errors.translation.mean < 0.02, "{errors:?}, odometry {raw:?}");
    assert!(errors.rotation.mean < 0.005, "{errors:?}");
    assert!(
        raw.translation.mean > 5.0 * errors.translation.mean,
        "odometry was too good to tell: {raw:?}"
    );
    assert!(closures > 0, "no closure on the second lap");
    assert_eq!(solved.solution.certificate.optimality, Optimality::Certified);
    assert_eq!(slam.trajectory().len(), scans.len());
    assert_eq!(slam.counts().scans, scans.len());
    // Odometry and matches are separate measurements.
    let trusted = slam
        .graph()
        .edges()
        .iter()
        .filter(|edge| edge.kind == EdgeKind::Odometry);
    assert!(trusted.count() > slam.graph().poses().len());
}

#[test]
fn the_solves_of_a_finish_are_timed_and_its_matches_marked() {
    let (scans, _) = house::drive(1);
    let mut slam = Slam::new(SlamSettings::default());
    let mut closures = 0;
    for scan in &scans {
        closures += slam.step(scan).unwrap().closures;
    }
    assert!(slam.rematches().iter().all(|is_rematch| !is_rematch));
    let mut told = 0.0;
    let mut clock = || {
        told += 1.0;
        told
    };
    let (_, solving) = slam.clone().finish_timed(&mut clock).unwrap();
    // The clock is read before and after each solve: at first, in each round, and for the certificate.
    assert_eq!(solving, f64::from(slam.settings().finish.rounds) + 2.0);
    slam.finish().unwrap();
    let edges = slam.graph().edges().iter().zip(slam.rematches());
    let recognised = edges
        .clone()
        .filter(|(edge, is_rematch)| edge.kind == EdgeKind::Closure && !**is_rematch);
    assert_eq!(recognised.count(), closures);
    assert!(edges.filter(|(_, is_rematch)| **is_rematch).count() > closures);
}

#[test]
fn the_same_scans_make_the_same_map_bit_for_bit() {
    let (scans, _) = house::drive(2);
    let run = || {
        let mut slam = Slam::new(SlamSettings::default());
        for scan in &scans[..120] {
            slam.step(scan).unwrap();
        }
        slam.trajectory()
    };
    assert_eq!(run(), run());
}

#[test]
fn scans_that_cannot_be_are_refused_and_change_nothing() {
    let (scans, _) = house::drive(3);
    let mut slam = Slam::new(SlamSettings::default());
    slam.step(&scans[1]).unwrap();
    let stamp = scans[0].stamp.as_secs();
    assert_eq!(slam.step(&scans[0]), Err(SlamError::Order(stamp)));
    let mut broken = scans[2].clone();
    broken.odom_from_base.x = f64::NAN;
    assert_eq!(slam.step(&broken), Err(SlamError::Scan(broken.stamp.as_secs())));
    assert_eq!(slam.trajectory().len(), 1);
}

#[test]
fn of_a_log_the_fewest_scans_are_skipped_that_go_back() {
    let (scans, _) = house::drive(3);
    let stamped = |secs: &[f64]| -> Vec<Scan> {
        let all = scans.iter().zip(secs);
        all.map(|(scan, secs)| Scan {
            stamp: Stamp::from_secs(*secs),
            ..scan.clone()
        })
        .collect()
    };
    let kept = |secs: &[f64]| -> Vec<f64> {
        let scans = in_order(stamped(secs)).unwrap().scans;
        scans.iter().map(|scan| scan.stamp.as_secs()).collect()
    };
    assert_eq!(kept(&[1.0, 1.0, 2.0]), [1.0, 1.0, 2.0]);
    // The later of two swapped scans; a clock that was far ahead once; a clock that was set back for a while.
    assert_eq!(kept(&[1.0, 3.0, 2.0, 4.0]), [1.0, 3.0, 4.0]);
    assert_eq!(kept(&[1.0, 900.0, 2.0, 3.0]), [1.0, 2.0, 3.0]);
    assert_eq!(kept(&[5.0, 6.0, 1.0, 2.0, 7.0, 8.0]), [5.0, 6.0, 7.0, 8.0]);
    let log = in_order(stamped(&[5.0, 6.0, 1.0, 2.0, 7.0])).unwrap();
    assert_eq!((log.skipped, log.first_skipped), (2, Some((3, 1.0))));
    let backwards = in_order(stamped(&[5.0, 4.0, 3.0, 2.0])).unwrap_err();
    assert_eq!(
        backwards.to_string(),
        "3 of 4 scans go back in time, the first of them scan 2 at 4.000000 s: sort the log by its stamps"
    );
    assert_eq!(in_order(Vec::new()).unwrap().skipped, 0);

    // The rest is a map like any other.
    let mut stamps: Vec<f64> = scans.iter().map(|scan| scan.stamp.as_secs()).collect();
    for index in (10..stamps.len()).step_by(25) {
        stamps[index] -= 0.7;
    }
    let mut slam = Slam::new(SlamSettings::default());
    let log = in_order(stamped(&stamps)).unwrap();
    assert_eq!(log.skipped, (10..stamps.len()).step_by(25).count());
    for scan in &log.scans {
        slam.step(scan).unwrap();
    }
    assert_eq!(slam.trajectory().len(), log.scans.len());
}

#[test]
fn a_log_whose_clock_was_set_back_loses_no_scan() {
    let (scans, _) = house::drive(3);
    let with_stamps = |scans: &[Scan], stamp: &dyn Fn(usize) -> f64| -> Vec<Scan> {
        let all = scans.iter().enumerate();
        all.map(|(index, scan)| Scan {
            stamp: Stamp::from_secs(stamp(index)),
            ..scan.clone()
        })
        .collect()
    };
    let half = scans.len() / 2;
    let ranges = |scans: &[Scan]| -> Vec<Vec<f32>> { scans.iter().map(|scan| scan.ranges.clone()).collect() };
    // The clock began anew in the middle.
    let log = with_stamps(&scans, &|index| 0.2 * (index % half) as f64);
    let ordered = in_order(log).unwrap();
    let mended = ordered.mended.unwrap();
    assert_eq!((mended.number, mended.is_sorted, ordered.skipped), (half + 1, false, 0));
    assert!(mended.times <= 2 && mended.stamps.1 == 0.0, "{mended:?}");
    assert_eq!(ranges(&ordered.scans), ranges(&scans));
    for pair in ordered.scans.windows(2) {
        assert!((pair[1].stamp.secs_since(pair[0].stamp) - 0.2).abs() < 1e-6);
    }
    // Two halves were joined the wrong way round, and neighbours swapped: their stamps are right, and odometry says so.
    let timed = with_stamps(&scans, &|index| 0.2 * index as f64);
    let mut swapped = timed.clone();
    swapped.chunks_exact_mut(2).for_each(|pair| pair.swap(0, 1));
    let turned = [&timed[half..], &timed[..half]].concat();
    for log in [swapped, turned] {
        let ordered = in_order(log).unwrap();
        assert!(ordered.mended.unwrap().is_sorted);
        assert_eq!(ordered.scans, timed);
    }
}

#[test]
fn relations_beyond_a_trajectory_and_broken_lines_do_not_count() {
    let trajectory = [(5.0, Pose2::IDENTITY), (9.0, Pose2::new(4.0, 0.0, 0.0))];
    let relation = |from: f64, to: f64| Relation {
        from,
        to,
        relative: Pose2::new(to - from, 0.0, 0.0),
    };
    let errors = relation_errors(
        &trajectory,
        &[relation(5.0, 9.0), relation(2.0, 9.0), relation(6.0, 12.0)],
    )
    .unwrap();
    assert_eq!((errors.count, errors.outside, errors.translation.mean), (1, 2, 0.0));
    assert_eq!(relation_errors(&trajectory, &[relation(0.0, 1.0)]), None);
    // Two drives by one clock.
    let twice = [trajectory, trajectory].concat();
    assert_eq!(relation_errors(&twice, &[relation(5.0, 9.0)]), None);
    assert!(read_relations("5 9 1 0 0 0 0 0\n").is_ok());
    assert_eq!(read_relations("5 9 1 x 0 0 0 0 0\n").unwrap_err().line, 1);
}

#[test]
fn scans_a_metre_apart_are_matched_around_a_corner() {
    // Two corridors cross. Past the corner a scan of half a circle sees only the second one.
    let (far, wide) = (20.0, 1.0);
    let quarter = [(-far, -wide), (-wide, -wide), (-wide, -far)];
    let turned = |turns: i32| {
        let frame = Pose2::new(0.0, 0.0, FRAC_PI_2 * f64::from(turns));
        quarter.map(|(x, y)| frame.transform_point(Point2::new(x, y)))
    };
    let walls: Vec<(f64, f64)> = (0..4).flat_map(turned).map(|corner| (corner.x, corner.y)).collect();
    let mut truth = vec![Pose2::new(-12.0, 0.0, 0.0)];
    let mut go = |count: usize, step: Pose2| (0..count).for_each(|_| truth.push(truth[truth.len() - 1] * step));
    go(11, Pose2::new(1.0, 0.0, 0.0));
    go(3, Pose2::new(0.77, -0.21, -FRAC_PI_2 / 3.0));
    go(13, Pose2::new(1.0, 0.0, 0.0));
    for seed in 0..3 {
        let mut scans = house::House::of(vec![walls.clone()]).log(&truth, seed);
        house::look_ahead_only(&mut scans);
        let mut slam = Slam::new(SlamSettings::default());
        let inserted = scans.iter().map(|scan| slam.step(scan).unwrap().is_inserted);
        let inserted = inserted.filter(|is_inserted| *is_inserted).count();
        let (_, end) = *slam.trajectory().last().unwrap();
        let off = (truth[0].inverse() * truth[truth.len() - 1]).inverse() * end;
        assert!(
            inserted == scans.len() && off.yaw.abs() < 0.05,
            "{inserted} of {} scans are nodes, {off:?} off with seed {seed}",
            scans.len()
        );
    }
}

#[test]
fn without_anything_in_sight_odometry_leads() {
    let (mut scans, _) = house::drive(4);
    scans.truncate(40);
    let mut slam = Slam::new(SlamSettings::default());
    for scan in &mut scans {
        scan.ranges.fill(f32::INFINITY);
        slam.step(scan).unwrap();
    }
    for ((_, pose), scan) in slam.trajectory().iter().zip(&scans) {
        assert!(pose.distance(&scan.odom_from_base) < 1e-6);
    }
    assert!(slam.counts().unmatched > 0);
}

#[test]
fn along_a_corridor_odometry_leads_and_the_ends_of_what_is_seen_of_its_walls_do_not() {
    let truth: Vec<Pose2> = (0..400)
        .map(|at| Pose2::new(20.0 + 0.05 * f64::from(at), 0.0, 0.0))
        .collect();
    let mut slam = Slam::new(SlamSettings::default());
    let mut is_flagged = false;
    for (scan, at) in house::House::corridor().log(&truth, 5).iter_mut().zip(&truth) {
        scan.odom_from_base = *at;
        scan.range_max = 3.5;
        for range in scan.ranges.iter_mut().filter(|range| **range > 3.5) {
            *range = f32::INFINITY;
        }
        // A person walks ahead.
        scan.moving = vec![[54, 66]];
        is_flagged |= slam.step(scan).unwrap().degenerate.is_some();
    }
    let (first, last) = (truth[0], truth[truth.len() - 1]);
    let check = |slam: &Slam| {
        let (_, pose) = *slam.trajectory().last().unwrap();
        let error = (first.inverse() * last).inverse() * pose;
        assert!(error.x.abs() < 0.04 && error.y.abs() < 0.1, "{error:?}");
    };
    assert!(is_flagged);
    check(&slam);
    slam.finish().unwrap();
    check(&slam);
}

#[test]
fn over_sixty_metres_of_a_bare_corridor_the_error_along_it_is_that_of_odometry_and_scans_say_so() {
    // The ends are out of sight all the way; odometry overstates the way.
    let walls = vec![(-5.0, -1.0), (65.0, -1.0), (65.0, 1.0), (-5.0, 1.0)];
    let truth: Vec<Pose2> = (0..=600).map(|at| Pose2::new(0.1 * f64::from(at), 0.0, 0.0)).collect();
    let mut scans = house::House::of(vec![walls]).log(&truth, 6);
    let mut slam = Slam::new(SlamSettings::default());
    let mut flagged = 0;
    for (scan, at) in scans.iter_mut().zip(&truth) {
        scan.odom_from_base = Pose2::new(1.01 * at.x + 0.01 * at.x.sin(), 0.0, 0.0);
        scan.range_max = 3.5;
        for range in scan.ranges.iter_mut().filter(|range| **range > 3.5) {
            *range = f32::INFINITY;
        }
        flagged += usize::from(slam.step(scan).unwrap().degenerate.is_some());
    }
    slam.finish().unwrap();
    let farthest = |along: &[f64]| {
        let errors = along.iter().zip(&truth).map(|(along, truth)| (along - truth.x).abs());
        errors.fold(0.0, f64::max)
    };
    let by_odometry: Vec<f64> = scans.iter().map(|scan| scan.odom_from_base.x).collect();
    let by_slam: Vec<f64> = slam.trajectory().iter().map(|(_, pose)| pose.x).collect();
    let (by_odometry, by_slam) = (farthest(&by_odometry), farthest(&by_slam));
    assert!(
        by_odometry > 0.5 && by_slam < 1.1 * by_odometry,
        "{by_slam} m, odometry {by_odometry} m"
    );
    assert!(10 * flagged > 9 * scans.len(), "{flagged} of {}", scans.len());
}

#[test]
fn a_sweep_is_straightened_by_odometry() {
    // A robot that turns by 0.2 rad while the beams of a sweep hit a wall 2 m ahead.
    let settings = ScanSettings {
        sweep: 0.1,
        spacing: 0.0,
        ..ScanSettings::default()
    };
    let step = Pose2::new(0.0, 0.0, 0.2);
    let count = 50;
    let ranges = (0..count).map(|beam| {
        let share = 1.0 - beam as f64 / count as f64;
        let heading = -0.5 + 0.02 * beam as f64 - 0.2 * share;
        (2.0 / heading.cos()) as f32
    });
    let scan = Scan {
        stamp: Stamp::from_secs(1.0),
        angle_min: -0.5,
        angle_increment: 0.02,
        range_min: 0.02,
        range_max: 30.0,
        ranges: ranges.collect(),
        odom_from_base: step,
        ..Scan::default()
    };
    let straight = points(&scan, step, 0.1, &settings);
    assert_eq!(straight.len(), count);
    for point in &straight {
        // In the frame of the last heading, which is perpendicular to the wall.
        assert!((point.x - 2.0).abs() < 1e-3, "{point}");
    }
    let sheared = points(&scan, step, 0.1, &ScanSettings { sweep: 0.0, ..settings });
    assert!(sheared.iter().any(|point| (point.x - 2.0).abs() > 0.05));
}

#[test]
fn relations_are_read_and_a_mistake_is_named_by_its_line() {
    let relations = read_relations("# t1 t2\n1 2 0.5 0 0 0 0 0.1\n\n").unwrap();
    assert_eq!(
        relations,
        [Relation {
            from: 1.0,
            to: 2.0,
            relative: Pose2::new(0.5, 0.0, 0.1)
        }]
    );
    let error = read_relations("1 2 0.5 0 0 0 0 0.1\n1 2 zero 0 0 0 0 0\n").unwrap_err();
    assert_eq!(
        error.to_string(),
        "line 2: expected `t1 t2 x y z roll pitch yaw`, found `1 2 zero 0 0 0 0 0`"
    );
}

#[test]
fn the_settings_are_within_their_own_bounds() {
    SlamSettings::default().check().unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn where_the_map_lies_does_not_change_the_metric(x in -9.0..9.0, y in -9.0..9.0, yaw in -3.0..3.0, error in 0.0..0.5) {
        let truth: Vec<Pose2> = (0..20).map(|step| Pose2::new(0.3 * f64::from(step), 0.0, 0.1 * f64::from(step))).collect();
        let relations: Vec<Relation> = (0..19)
            .map(|from| Relation {
                from: from as f64,
                to: from as f64 + 1.0,
                relative: truth[from].inverse() * truth[from + 1] * Pose2::new(error, 0.0, 0.0),
            })
            .collect();
        let map = Pose2::new(x, y, yaw);
        let trajectory: Vec<(f64, Pose2)> = truth.iter().enumerate().map(|(at, pose)| (at as f64, map * *pose)).collect();
        let errors = relation_errors(&trajectory, &relations).unwrap();
        prop_assert!((errors.translation.mean - error).abs() < 1e-9 && errors.translation.deviation < 1e-6);
        prop_assert!(wrap_angle(errors.rotation.mean).abs() < 1e-9);
    }
}
