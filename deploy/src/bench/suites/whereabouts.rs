//! Whereabouts. Localisation without GPS and compass, with the usual odometry and with that of a worn robot.

use std::ops::Range;

use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;
use zenav_cloud::mapping::PoseSource;

use super::floor::Floor;
use super::{Case, Make, rng};
use crate::failure::Failure;

/// Tolerance at the goal, by ground truth, m.
const TOLERANCE: f64 = 0.05;
/// Robots without GPS and compass; those with wrong odometry parameters are last.
pub(super) const ROBOTS: [&str; 4] = [
    "tiago+indoor",
    "turtlebot3_waffle+indoor",
    "tiago+indoor+worn",
    "turtlebot3_waffle+indoor+worn",
];

/// S8: an office of 65 m and a hall of 90 m, known and unknown, and the hall without anything in range.
pub(super) fn whereabouts(robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    let scenarios: [(&str, Make, PoseSource); 5] = [
        ("S8 office known", office, PoseSource::Localise),
        ("S8 hall known", hall, PoseSource::Localise),
        ("S8 office unknown", office, PoseSource::Slam),
        ("S8 hall unknown", hall, PoseSource::Slam),
        ("S8 nothing in sight", bare, PoseSource::Slam),
    ];
    let mut cases = Vec::new();
    for (scenario, make, poses) in scenarios {
        for robot in robots {
            for seed in seeds.clone() {
                // The same worlds, known and unknown.
                let drawn = if scenario.contains("office") {
                    "S8 office"
                } else {
                    "S8 hall"
                };
                let (floor, goal) = make(&mut rng(drawn, seed));
                let mut case = Case::new(scenario, robot, seed, floor, goal)?;
                case.known_map = poses == PoseSource::Localise;
                case.poses = Some(poses);
                case.tolerance = Some(TOLERANCE);
                cases.push(case);
            }
        }
    }
    Ok(cases)
}

/// A corridor of 2.4 m with open doors to furnished rooms on both sides.
fn office(rng: &mut Pcg64Mcg) -> (Floor, [f64; 2]) {
    let length = 66.0;
    let mut floor = Floor::new([length, 12.0], [1.0, 6.0, 0.0]);
    for (wall, outer) in [(4.75, 0.0), (7.15, 12.0)] {
        let mut left: f64 = 0.0;
        while left < length {
            let drawn = left + rng.random_range(3.5..6.0);
            // The last room takes the remainder if that is too small for another room.
            let right = if length - drawn < 2.5 { length } else { drawn };
            let door = left + 0.4 + rng.random_range(0.0..1.0) * (right - left - 1.8).max(0.0);
            let end = door + 1.0;
            floor = floor
                .block([left, wall], [door, wall + 0.1])
                .block([end, wall], [right, wall + 0.1])
                .block(
                    [right - 0.05, f64::min(outer, wall)],
                    [right + 0.05, f64::max(outer, wall + 0.1)],
                );
            for _ in 0..3 {
                let [wide, deep] = [rng.random_range(0.3..0.9), rng.random_range(0.3..0.7)];
                let x = left + 0.3 + rng.random_range(0.0..1.0) * (right - left - wide - 0.6).max(0.0);
                let y = f64::min(outer, wall) + 0.3 + rng.random_range(0.0..2.0);
                floor = floor.block([x, y], [x + wide, y + deep]);
            }
            left = right;
        }
    }
    (floor, [65.0, 6.0])
}

/// Pillars on both sides, about every 7 m.
fn hall(rng: &mut Pcg64Mcg) -> (Floor, [f64; 2]) {
    let (mut floor, goal) = bare(rng);
    let mut x = 4.0;
    while x < 94.0 {
        for y in [7.0, 15.0] {
            let at = [x + rng.random_range(-1.0..1.0), y + rng.random_range(-0.5..0.5)];
            floor = floor.disc(at, 0.3);
        }
        x += 7.0;
    }
    (floor, goal)
}

/// Walls beyond the lidar's range.
fn bare(_: &mut Pcg64Mcg) -> (Floor, [f64; 2]) {
    (Floor::new([96.0, 22.0], [2.0, 11.0, 0.0]), [92.0, 11.0])
}
