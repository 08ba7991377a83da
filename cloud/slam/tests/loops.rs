//! Tests of loops: closed after metres of drift and behind somebody who walks ahead, and not closed where places look alike.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::f64::consts::{FRAC_PI_2, PI};

use rand::{RngExt as _, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use zenav_pose_graph::EdgeKind;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_slam::{Slam, SlamSettings};

mod house;

use house::House;

/// Range of the lidar, m: never from corner to corner.
const RANGE: f64 = 8.0;
/// Distance between two scans, m.
const STEP: f64 = 0.2;
/// Standard deviation of the odometry's heading in each step, rad.
const HEADING: f64 = 0.012;
/// Scans along 12 m of glass: nothing is seen.
const GLASS: std::ops::Range<usize> = 150..210;

/// Furniture along the first corridor.
#[derive(Clone, Copy, PartialEq)]
enum Furniture {
    Irregular,
    /// The same piece every two metres.
    Alike,
}

/// Four corridors, 2.4 m wide, around a block of 35 m by 19 m, with furniture along their walls.
fn corridors(first: Furniture) -> House {
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let mut walls = vec![
        vec![(0.0, 0.0), (40.0, 0.0), (40.0, 24.0), (0.0, 24.0)],
        vec![(2.4, 2.4), (37.6, 2.4), (37.6, 21.6), (2.4, 21.6)],
    ];
    let mut stand = |x: f64, y: f64, wide: f64, deep: f64| {
        walls.push(vec![(x, y), (x + wide, y), (x + wide, y + deep), (x, y + deep)]);
    };
    let mut along = |length: f64, stand: &mut dyn FnMut(f64, f64)| {
        let mut at = 3.0;
        while at < length - 3.0 {
            stand(at, random.random_range(0.2..0.6));
            at += random.random_range(1.0..3.0);
        }
    };
    for y in [0.0, 1.9, 21.6, 23.5] {
        if y > 2.0 || first == Furniture::Irregular {
            along(40.0, &mut |x, wide| stand(x, y, wide, 0.5));
        } else {
            (0..18).for_each(|index| stand(3.0 + 2.0 * f64::from(index), y, 0.4, 0.5));
        }
    }
    for x in [0.0, 1.9, 37.6, 39.5] {
        along(24.0, &mut |y, wide| stand(x, y, 0.5, wide));
    }
    House::of(walls)
}

/// Once around, from the middle of the first corridor, and 10 m beyond the start.
fn around() -> Vec<Pose2> {
    let mut truth = vec![Pose2::new(15.0, 1.2, 0.0)];
    let mut go = |count: usize, step: Pose2| {
        (0..count).for_each(|_| truth.push(truth[truth.len() - 1] * step));
    };
    for way in [23.8, 21.6, 37.6, 21.6, 23.8] {
        go((way / STEP).round() as usize, Pose2::new(STEP, 0.0, 0.0));
        go(16, Pose2::new(0.0, 0.0, FRAC_PI_2 / 16.0));
    }
    truth
}

/// The scans along the drive, with odometry whose heading drifts.
fn log(house: &House, truth: &[Pose2], seed: u64) -> Vec<Scan> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut scans = house.log(truth, seed);
    let mut odometry = Pose2::IDENTITY;
    for (index, scan) in scans.iter_mut().enumerate() {
        if let Some(before) = index.checked_sub(1) {
            let drawn: f64 = StandardNormal.sample(&mut random);
            odometry = odometry * truth[before].inverse() * truth[index] * Pose2::new(0.0, 0.0, HEADING * drawn);
        }
        scan.odom_from_base = odometry;
        let is_hidden = GLASS.contains(&index);
        for range in scan
            .ranges
            .iter_mut()
            .filter(|range| is_hidden || f64::from(**range) > RANGE)
        {
            *range = f32::INFINITY;
        }
    }
    scans
}

/// Distance of the last pose from the truth, relative to the first, m.
fn off(slam: &Slam, truth: &[Pose2]) -> f64 {
    let (_, pose) = *slam.trajectory().last().unwrap();
    pose.distance(&(truth[0].inverse() * truth[slam.trajectory().len() - 1]))
}

/// Number of accepted closures that contradict the truth, and of all accepted closures. `truth`: poses of the nodes.
fn wrong(slam: &Slam, truth: &[Pose2]) -> (usize, usize) {
    let kept = slam.graph().edges().iter().zip(slam.weights());
    let kept: Vec<_> = kept
        .filter(|(edge, weight)| edge.kind == EdgeKind::Closure && **weight > 0.0)
        .collect();
    let is_wrong = |from: usize, to: usize, measured: Pose2| {
        let there = truth[from].inverse() * truth[to];
        there.distance(&measured) > 0.5 || (there.inverse() * measured).yaw.abs() > PI / 12.0
    };
    let wrong = kept
        .iter()
        .filter(|(edge, _)| is_wrong(edge.from, edge.to, edge.measurement));
    (wrong.count(), kept.len())
}

#[test]
fn a_long_loop_is_closed_after_a_drift_of_more_than_four_metres() {
    let truth = around();
    let house = corridors(Furniture::Irregular);
    for seed in [5, 7] {
        let (mut largest, mut slam) = (0.0_f64, Slam::new(SlamSettings::default()));
        let mut of_nodes = Vec::new();
        for (scan, pose) in log(&house, &truth, seed).iter().zip(&truth) {
            if slam.step(scan).unwrap().is_inserted {
                of_nodes.push(*pose);
            }
            largest = largest.max(off(&slam, &truth));
        }
        let left_out = truth.len() - of_nodes.len();
        assert!(left_out < 5, "{left_out} scans are no nodes");
        assert!(largest > 4.5, "a drift of {largest} m is no trial");
        let off = off(&slam, &truth);
        assert!(off < 0.3, "{off} m off with seed {seed}, {:?}", slam.counts());
        slam.finish().unwrap();
        let (wrong, kept) = wrong(&slam, &of_nodes);
        assert!(
            wrong == 0 && kept > 0,
            "{wrong} of {kept} closures are wrong with seed {seed}"
        );
    }
}

#[test]
fn no_loop_is_closed_wrongly_where_places_look_alike() {
    let truth = around();
    let house = corridors(Furniture::Alike);
    for seed in 0..3 {
        let mut slam = Slam::new(SlamSettings::default());
        let mut of_nodes = Vec::new();
        for (scan, pose) in log(&house, &truth, seed).iter().zip(&truth) {
            if slam.step(scan).unwrap().is_inserted {
                of_nodes.push(*pose);
            }
        }
        let (wrong, kept) = wrong(&slam, &of_nodes);
        assert_eq!(wrong, 0, "of {kept} closures with seed {seed}");
        assert!(slam.counts().searched > 0, "the place was not even searched for");
    }
}

#[test]
fn a_loop_is_closed_although_somebody_walks_ahead_of_the_robot() {
    let truth = house::lap(0, 6);
    let mut scans = House::usual().log(&truth, 1);
    house::look_ahead_only(&mut scans);
    scans.iter_mut().for_each(|scan| house::put_ahead(scan, 1.5, 0.5));
    let (mut slam, mut of_nodes) = (Slam::new(SlamSettings::default()), Vec::new());
    for (scan, pose) in scans.iter().zip(&truth) {
        if slam.step(scan).unwrap().is_inserted {
            of_nodes.push(*pose);
        }
    }
    let (wrong, kept) = wrong(&slam, &of_nodes);
    assert!(wrong == 0 && kept > 0, "{wrong} of {kept} closures are wrong");
}
