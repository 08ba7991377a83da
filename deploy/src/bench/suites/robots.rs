//! Robots. Several robots of one kind, each with its own goal, sensors, map and mission.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::Range;

use nalgebra::Point2;
use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;

use super::floor::Floor;
use super::{Case, Other, rng};
use crate::failure::Failure;

/// Largest random offset of starts and goals, to either side, m.
const SCATTER: f64 = 0.1;
/// Extra time for several robots to make way for each other, s.
const TIME: f64 = 120.0;

/// Each robot's start and goal, m and rad.
type Ways = Vec<([f64; 3], [f64; 2])>;

/// S11: robots that swap places in a corridor, meet in a lane with a niche, cross, change sides on a circle, or rotate places.
pub(super) fn robots(robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    type Make = fn() -> (Floor, Ways);
    let scenarios: [(&str, Make); 10] = [
        ("S11 swap, 3.0 m", || swap(3.0)),
        ("S11 swap, 1.8 m", || swap(1.8)),
        ("S11 lane with a niche", lane),
        ("S11 crossing 2", || crossing(2)),
        ("S11 crossing 4", || crossing(4)),
        ("S11 circle 2", || circle(2)),
        ("S11 circle 4", || circle(4)),
        ("S11 circle 8", || circle(8)),
        ("S11 circle 16", || circle(16)),
        ("S11 goals of others", rotation),
    ];
    let mut cases = Vec::new();
    for (scenario, make) in scenarios {
        for robot in robots {
            for seed in seeds.clone() {
                let mut rng = rng(scenario, seed);
                let mut ways = Vec::new();
                for ([x, y, yaw], [to_x, to_y]) in make().1 {
                    let [x, y, to_x, to_y] = [x, y, to_x, to_y].map(|at| scattered(&mut rng, at));
                    ways.push(Other {
                        start: Pose2::new(x, y, yaw),
                        goal: Point2::new(to_x, to_y),
                    });
                }
                let first = ways.remove(0);
                let mut floor = make().0;
                floor = floor.starting([first.start.x, first.start.y, first.start.yaw]);
                let goal = [first.goal.x, first.goal.y];
                let mut case = Case::new(scenario, robot, seed, floor, goal)?;
                case.timeout += TIME;
                case.others = ways;
                cases.push(case);
            }
        }
    }
    Ok(cases)
}

/// A value near `at`, in whole centimetres.
fn scattered(rng: &mut Pcg64Mcg, at: f64) -> f64 {
    (100.0 * (at + rng.random_range(-SCATTER..SCATTER))).round() / 100.0
}

/// Two robots swap the ends of a corridor of this width, m.
fn swap(width: f64) -> (Floor, Ways) {
    let middle = 0.5 * width;
    let ways = vec![
        ([1.0, middle, 0.0], [11.0, middle]),
        ([11.0, middle, PI], [1.0, middle]),
    ];
    (Floor::new([12.0, width], [1.0, middle, 0.0]), ways)
}

/// Two rooms joined by a lane of 0.9 m, too narrow for two robots except at a niche.
fn lane() -> (Floor, Ways) {
    let floor = Floor::new([12.0, 4.0], [1.0, 2.0, 0.0])
        .block([2.5, 0.0], [9.5, 1.55])
        .block([2.5, 2.45], [5.5, 4.0])
        .block([5.5, 3.45], [6.6, 4.0])
        .block([6.6, 2.45], [9.5, 4.0]);
    let ways = vec![([1.0, 2.0, 0.0], [11.0, 2.0]), ([11.0, 2.0, PI], [1.0, 2.0])];
    (floor, ways)
}

/// A hall of 10 m by 10 m; the robots' paths cross in its middle.
fn crossing(robots: usize) -> (Floor, Ways) {
    let mut ways = vec![
        ([1.0, 5.0, 0.0], [9.0, 5.0]),
        ([5.0, 1.0, FRAC_PI_2], [5.0, 9.0]),
        ([1.0, 4.0, 0.0], [9.0, 6.0]),
        ([6.0, 1.0, FRAC_PI_2], [4.0, 9.0]),
    ];
    ways.truncate(robots);
    (Floor::new([10.0, 10.0], [1.0, 5.0, 0.0]), ways)
}

/// A hall of 12 m by 12 m; each robot's goal is the start of the opposite robot on the circle.
fn circle(robots: u32) -> (Floor, Ways) {
    let ways = (0..robots).map(|nth| {
        let angle = TAU * f64::from(nth) / f64::from(robots);
        let off = [4.5 * angle.cos(), 4.5 * angle.sin()];
        ([6.0 + off[0], 6.0 + off[1], angle - PI], [6.0 - off[0], 6.0 - off[1]])
    });
    (Floor::new([12.0, 12.0], [10.5, 6.0, PI]), ways.collect())
}

/// Three robots side by side; each has the next one's place as its goal.
fn rotation() -> (Floor, Ways) {
    let at = |nth: usize| [1.5 + 2.5 * (nth % 3) as f64, 2.0];
    let ways = (0..3).map(|nth| ([at(nth)[0], 2.0, FRAC_PI_2], at(nth + 1)));
    (Floor::new([8.0, 4.0], [1.5, 2.0, FRAC_PI_2]), ways.collect())
}
