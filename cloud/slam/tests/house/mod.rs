//! House. The simulated log shared by the tests and the example.

#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each of those that share this uses a part of it, and stops at what is wrong"
)]

use nalgebra::Point2;
use rand::{RngExt as _, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;
use zenav_slam::Relation;

/// Corners of closed walls, m: the house, a block in its middle, and furniture that makes its corners distinct.
const WALLS: &[&[(f64, f64)]] = &[
    &[(0.0, 0.0), (12.0, 0.0), (12.0, 8.0), (0.0, 8.0)],
    &[(4.0, 3.0), (8.0, 3.0), (8.0, 5.0), (4.0, 5.0)],
    &[(5.0, 0.0), (5.6, 0.0), (5.6, 0.5), (5.0, 0.5)],
    &[(11.2, 3.0), (12.0, 3.0), (12.0, 4.7), (11.2, 4.7)],
    &[(6.5, 7.4), (7.0, 7.6), (6.7, 8.0)],
    &[(0.0, 4.0), (0.7, 4.0), (0.7, 4.5), (0.0, 4.9)],
];
/// Corners of another house, with rooms as wide but a different layout.
const ANOTHER: &[&[(f64, f64)]] = &[
    &[
        (0.0, 0.0),
        (7.0, 0.0),
        (7.0, -1.2),
        (12.5, -1.2),
        (12.5, 8.5),
        (3.0, 8.5),
        (3.0, 7.6),
        (0.0, 7.6),
    ],
    &[(3.6, 2.6), (8.7, 2.6), (8.7, 4.1), (7.2, 4.1), (7.2, 5.2), (3.6, 5.2)],
    &[(2.0, 0.0), (3.4, 0.0), (3.4, 0.3), (2.0, 0.3)],
    &[(11.9, 4.9), (12.5, 4.9), (12.5, 6.2), (11.9, 6.4)],
    &[(8.0, 7.9), (8.4, 7.7), (8.8, 7.9), (8.4, 8.2)],
    &[(0.0, 2.7), (0.5, 2.7), (0.5, 3.6), (0.0, 3.6)],
];
/// The drive around the block.
const WAY: [(f64, f64); 4] = [(2.0, 1.5), (10.0, 1.5), (10.0, 6.5), (2.0, 6.5)];
/// Beams of a full circle.
const BEAMS: usize = 120;
/// Standard deviation of a range, m.
const NOISE: f64 = 0.01;

/// Walls of a house, each a closed sequence of corners, m.
#[derive(Clone)]
pub struct House(Vec<Vec<(f64, f64)>>);

impl House {
    /// Walls, each a closed sequence of corners, m.
    pub fn of(walls: Vec<Vec<(f64, f64)>>) -> Self {
        Self(walls)
    }

    /// The house of all tests.
    pub fn usual() -> Self {
        Self(WALLS.iter().map(|wall| wall.to_vec()).collect())
    }

    /// A different house in which the same path can be driven.
    pub fn another() -> Self {
        Self(ANOTHER.iter().map(|wall| wall.to_vec()).collect())
    }

    /// A corridor of 60 m with nothing in it.
    pub fn corridor() -> Self {
        Self(vec![vec![(0.0, -0.6), (60.0, -0.6), (60.0, 0.6), (0.0, 0.6)]])
    }

    /// The same house with its furniture moved along the walls by up to this much, m.
    pub fn moved(&self, seed: u64, by: f64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut walls = self.0.clone();
        for furniture in &mut walls[2..] {
            let along = random.random_range(-by..by);
            let is_low = furniture.iter().all(|corner| corner.0 > 0.1 && corner.0 < 11.9);
            for corner in furniture {
                let axis = if is_low { &mut corner.0 } else { &mut corner.1 };
                *axis += along;
            }
        }
        Self(walls)
    }

    /// Distance to the nearest wall along a ray.
    fn cast(&self, from: Point2<f64>, angle: f64) -> f64 {
        let (sin, cos) = angle.sin_cos();
        let mut nearest = f64::INFINITY;
        for wall in &self.0 {
            for (index, a) in wall.iter().enumerate() {
                let b = wall[(index + 1) % wall.len()];
                let (ex, ey) = (b.0 - a.0, b.1 - a.1);
                let (ax, ay) = (a.0 - from.x, a.1 - from.y);
                let across = cos * ey - sin * ex;
                let (along, part) = ((ax * ey - ay * ex) / across, (ax * sin - ay * cos) / across);
                if along > 0.0 && (0.0..=1.0).contains(&part) {
                    nearest = nearest.min(along);
                }
            }
        }
        nearest
    }

    /// The scans of a robot at these poses, a fifth of a second apart, with odometry that drifts.
    pub fn log(&self, truth: &[Pose2], seed: u64) -> Vec<Scan> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut normal = move |sigma: f64| -> f64 {
            let drawn: f64 = StandardNormal.sample(&mut random);
            sigma * drawn
        };
        let mut odometry = Pose2::IDENTITY;
        let mut scans = Vec::new();
        for (index, pose) in truth.iter().enumerate() {
            if let Some(before) = index.checked_sub(1) {
                let step = truth[before].inverse() * *pose;
                let drift = Pose2::new(
                    step.x * 0.03 + normal(0.003),
                    normal(0.002),
                    0.03 * step.x + normal(0.004),
                );
                odometry = odometry * step * drift;
            }
            let increment = std::f64::consts::TAU / BEAMS as f64;
            let ranges = (0..BEAMS).map(|beam| {
                let angle = pose.yaw - std::f64::consts::PI + increment * beam as f64;
                (self.cast(pose.position(), angle) + normal(NOISE)) as f32
            });
            scans.push(Scan {
                stamp: Stamp::from_secs(0.2 * index as f64),
                angle_min: -std::f64::consts::PI,
                angle_increment: increment,
                range_min: 0.02,
                range_max: 30.0,
                ranges: ranges.collect(),
                odom_from_base: odometry,
                ..Scan::default()
            });
        }
        scans
    }
}

/// Leaves of each scan the half circle ahead.
pub fn look_ahead_only(scans: &mut [Scan]) {
    for scan in scans {
        for beam in 0..scan.ranges.len() {
            if scan.angle(beam).cos() < 0.0 {
                scan.ranges[beam] = f32::INFINITY;
            }
        }
    }
}

/// Puts somebody in front of the lidar, this far ahead and this wide, m.
pub fn put_ahead(scan: &mut Scan, ahead: f64, wide: f64) {
    for beam in 0..scan.ranges.len() {
        let (sin, cos) = scan.angle(beam).sin_cos();
        let range = ahead / cos;
        if cos > 0.0 && (range * sin).abs() < 0.5 * wide {
            scan.ranges[beam] = scan.ranges[beam].min(range as f32);
        }
    }
}

/// A drive around the block, from one corner past this many others.
pub fn lap(from: usize, corners: usize) -> Vec<Pose2> {
    let start = WAY[from % 4];
    let mut truth = vec![Pose2::new(start.0, start.1, std::f64::consts::FRAC_PI_2 * from as f64)];
    for corner in from + 1..=from + corners {
        let to = WAY[corner % 4];
        for _ in 0..53 {
            truth.push(truth[truth.len() - 1] * Pose2::new(0.15, 0.0, 0.0));
            let here = truth[truth.len() - 1];
            if here.distance(&Pose2::new(to.0, to.1, 0.0)) < 0.1 {
                break;
            }
        }
        for _ in 0..16 {
            truth.push(truth[truth.len() - 1] * Pose2::new(0.0, 0.0, std::f64::consts::FRAC_PI_2 / 16.0));
        }
    }
    truth
}

/// A drive of a lap and a half around the block; relations between poses 1, 10 and 100 scans apart.
pub fn drive(seed: u64) -> (Vec<Scan>, Vec<Relation>) {
    let truth = lap(0, 6);
    let scans = House::usual().log(&truth, seed);
    let mut relations = Vec::new();
    for apart in [1, 10, 100] {
        for from in (0..truth.len() - apart).step_by(5) {
            relations.push(Relation {
                from: 0.2 * from as f64,
                to: 0.2 * (from + apart) as f64,
                relative: truth[from].inverse() * truth[from + apart],
            });
        }
    }
    (scans, relations)
}
