//! Smoothing: time, share of smooth curves, soundness of every trajectory. `cargo bench -p zenav-smoothing --bench smoothing`
//!
//! Pairs of places are drawn on a map; for each robot the paths between them are planned and smoothed. Times are thread CPU time, the
//! least of a few runs per path. Every trajectory is then checked independently of the smoother: the true footprint every millimetre,
//! every limit every millisecond; its duration is compared with that of stop, turn and go along the same path. A collision or a violated
//! limit ends the bench.
//!
//! | variable | does |
//! |---|---|
//! | `ZENAV_BENCH_MAP=FILE` | this map instead of a generated house (`.yaml`, `.pgm`, `.png`, `.map`) |
//! | `ZENAV_BENCH_ONLY=NAME` | only robots whose name contains this |
//! | `ZENAV_BENCH_WAYS=N` | number of paths, by default 200 |

#![allow(missing_docs, reason = "a bench has no users")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a bench prints its table and stops at the first thing that is not as it should be"
)]

use std::path::Path;

use nalgebra::Point2;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use rustix::time::{ClockId, clock_gettime};
use zenav_mapping::read_map;
use zenav_planning::{Budget, PlanOptions, Searcher, plan};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::{Cell, Grid, Occupancy, OccupancyGrid};
use zenav_protocol::messages::PlanOutcome;
use zenav_protocol::robot::RobotModel;
use zenav_smoothing::stop_turn_go;
use zenav_smoothing::{Limits, UNRESTRICTED};
use zenav_smoothing::{SmoothQuery, Smoothed, SmoothingSettings, smooth};
use zenav_space::{ConfigurationSpace, UnknownPolicy};

/// Robots that are measured.
const ROBOTS: [&str; 4] = ["tiago", "neato", "turtlebot3_waffle", "jackal"];
const SEED: u64 = 1;
/// Runs of each path; the least time counts.
const RUNS: usize = 3;
/// Length of the long path, m.
const TOUR: f64 = 113.0;
/// Tolerance of the limits.
const ROUNDING: f64 = 1e-6;

fn main() {
    let grid = match std::env::var_os("ZENAV_BENCH_MAP") {
        Some(path) => read_map(Path::new(&path), 0.05).expect("a map"),
        None => house(),
    };
    let only = std::env::var("ZENAV_BENCH_ONLY").unwrap_or_default();
    let ways = std::env::var("ZENAV_BENCH_WAYS").map_or(200, |count| count.parse().expect("a number of ways"));
    println!("times in ms, median (95th percentile); lengths in m\n");
    println!(
        "| robot | ways | smoothed | fallbacks | corridor | geometry | time law | ms a 100 m, both | a path of 113 m: both | time beside stop, turn, go |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for name in ROBOTS.iter().filter(|name| name.contains(&only)) {
        let model = zenav_fixtures::robot(name);
        let mut found = Vec::new();
        let space = ConfigurationSpace::new(&grid, &model.footprint, UnknownPolicy::Blocked, 0.0);
        for (path, start) in drawn(&space, ways, false) {
            found.push(measured(&space, &model, &path, start));
        }
        let tour = tour(&space, TOUR).map(|(path, start)| measured(&space, &model, &path, start).0);
        row(name, &found, tour.as_ref());
    }
}

/// 12 by 9 rooms of 4 m with doors of 1 m and a piece of furniture each.
fn house() -> OccupancyGrid {
    const ROOM: u32 = 80;
    let spec = zenav_fixtures::spec(12 * ROOM + 1, 9 * ROOM + 1, 0.05);
    let mut random = Pcg64Mcg::seed_from_u64(SEED);
    let mut at = || -> Vec<u32> { (0..108).map(|_| random.random_range(6..54)).collect() };
    let [doors_x, doors_y, left, low] = [at(), at(), at(), at()];
    let mut grid = Grid::filled(spec, Occupancy::FREE);
    for y in 0..spec.height {
        for x in 0..spec.width {
            let (room, in_x, in_y) = ((x / ROOM + 12 * (y / ROOM)) as usize % 108, x % ROOM, y % ROOM);
            let outer = x == 0 || y == 0 || x + 1 == spec.width || y + 1 == spec.height;
            let door = |from: u32, at: u32| (from..from + 20).contains(&at);
            let wall = (in_x == 0 && !door(doors_x[room], in_y)) || (in_y == 0 && !door(doors_y[room], in_x));
            let furniture = (left[room]..left[room] + 12).contains(&in_x) && (low[room]..low[room] + 8).contains(&in_y);
            if outer || wall || furniture {
                grid[Cell::new(x, y)] = Occupancy::OCCUPIED;
            }
        }
    }
    grid
}

/// A path, and the start pose of a robot at rest on it: along its first leg.
type PlannedPath = (Vec<Point2<f64>>, Pose2);

/// Paths between drawn places where the robot can turn; with `is_tour` each starts where the last one ends.
fn drawn(space: &ConfigurationSpace, count: usize, is_tour: bool) -> Vec<PlannedPath> {
    let spec = *space.spec();
    let mut random = Pcg64Mcg::seed_from_u64(SEED);
    let mut searcher = Searcher::new(space.free()).unwrap();
    let room = space.footprint().circumscribed_radius();
    let options = PlanOptions {
        any_heading: true,
        ..PlanOptions::default()
    };
    let mut draw = || {
        let cell = Cell::new(random.random_range(0..spec.width), random.random_range(0..spec.height));
        let center = spec.center(cell);
        (space.is_free(cell) && space.clearance(center) > room).then(|| Pose2::new(center.x, center.y, 0.0))
    };
    let (mut ways, mut from) = (Vec::new(), None);
    for _ in 0..100 * count {
        if ways.len() == count {
            break;
        }
        let (Some(start), Some(goal)) = (from.or_else(&mut draw), draw()) else {
            continue;
        };
        let planned = plan(space, &mut searcher, start, goal, &options, Budget::UNLIMITED);
        if let PlanOutcome::Found { path, .. } = planned.outcome
            && let Some(leg) = path.windows(2).map(|leg| leg[1] - leg[0]).find(|leg| leg.norm() > 0.0)
        {
            ways.push((path, Pose2::new(start.x, start.y, leg.y.atan2(leg.x))));
            from = is_tour.then_some(goal);
        }
    }
    ways
}

/// A path of `length` (m), from one drawn place to the next.
fn tour(space: &ConfigurationSpace, length: f64) -> Option<PlannedPath> {
    let ways = drawn(space, 20, true);
    let start = ways.first()?.1;
    let points = ways.iter().flat_map(|(path, _)| path.iter().copied());
    let (mut tour, mut left): (Vec<Point2<f64>>, f64) = (vec![start.position()], length);
    for point in points {
        let last = *tour.last()?;
        let leg = point - last;
        if leg.norm() >= left {
            tour.push(last + leg * (left / leg.norm()));
            return Some((tour, start));
        }
        left -= leg.norm();
        tour.push(point);
    }
    None
}

/// The fastest run, and the duration of stop, turn and go.
fn measured(space: &ConfigurationSpace, model: &RobotModel, path: &[Point2<f64>], start: Pose2) -> (Smoothed, f64) {
    let query = SmoothQuery::new(path, start);
    let run = || smooth(space, &query, model, &SmoothingSettings::default(), None, &mut cpu);
    let best = (1..RUNS).fold(run(), |best, _| {
        let again = run();
        if both(&again) < both(&best) { again } else { best }
    });
    assert_sound(space, model, &best);
    let limits = Limits::of(model);
    let safe = stop_turn_go(path, start, Twist2::ZERO, None, &limits, UNRESTRICTED);
    (best, safe.duration())
}

fn both(smoothed: &Smoothed) -> f64 {
    smoothed.statistics.corridor_ms + smoothed.statistics.geometry_ms
}

/// Free every millimetre; every limit kept every millisecond.
fn assert_sound(space: &ConfigurationSpace, model: &RobotModel, smoothed: &Smoothed) {
    let (drive, limits) = (&model.drive, Limits::of(model));
    let half = 0.5 * drive.wheel_separation;
    let mut last: Option<Pose2> = None;
    for state in smoothed.trajectory.states(1e-3_f64.min(1e-3 / limits.speed)) {
        let (point, a, alpha) = (state.point, state.a, state.alpha);
        for side in [-half, half] {
            assert!((point.v + side * point.w).abs() <= 0.95 * drive.max_wheel_speed * drive.wheel_radius + ROUNDING);
            assert!((a + side * alpha).abs() <= 0.95 * drive.acceleration() + ROUNDING);
        }
        assert!(point.v.abs() <= 0.95 * drive.top_speed() + ROUNDING);
        assert!((point.v * point.w).abs() <= 0.95 * drive.max_lateral_acceleration + ROUNDING);
        let pose = point.pose();
        let moved = |last: Pose2| last.distance(&pose) > 0.5e-3 || (last.yaw - pose.yaw).abs() > 1e-3;
        if last.is_none_or(moved) {
            assert!(
                space.is_valid(pose),
                "collision at {pose:?}: {}",
                smoothed.statistics.status
            );
            last = Some(pose);
        }
    }
}

fn row(name: &str, found: &[(Smoothed, f64)], tour: Option<&Smoothed>) {
    let smooth = found.iter().filter(|(smoothed, _)| smoothed.is_smooth()).count();
    let mut reasons: Vec<&str> = found
        .iter()
        .map(|(smoothed, _)| smoothed.statistics.status.as_str())
        .collect();
    reasons.retain(|reason| *reason != "smoothed");
    reasons.sort_unstable();
    reasons.dedup();
    let all = |of: fn(&Smoothed) -> f64| {
        let mut values: Vec<f64> = found.iter().map(|(smoothed, _)| of(smoothed)).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| {
            values
                .get((values.len() as f64 * share) as usize)
                .copied()
                .unwrap_or(f64::NAN)
        };
        format!("{:.2} ({:.2})", at(0.5), at(0.95))
    };
    let tour = tour.map_or_else(String::new, |tour| {
        let polygons = tour
            .statistics
            .certificate
            .corridor
            .as_ref()
            .map_or(0, |corridor| corridor.polygons);
        format!("{polygons} polygons, {:.2}, {}", both(tour), tour.statistics.status)
    });
    let sum = |of: &dyn Fn(&(Smoothed, f64)) -> f64| found.iter().map(of).sum::<f64>();
    println!(
        "| {name} | {} | {smooth} | {} | {} | {} | {} | {:.2} | {tour} | {:.3} |",
        found.len(),
        reasons.join(" "),
        all(|smoothed| smoothed.statistics.corridor_ms),
        all(|smoothed| smoothed.statistics.geometry_ms),
        all(|smoothed| smoothed.statistics.timing_ms),
        100.0 * sum(&|(smoothed, _)| both(smoothed)) / sum(&|(smoothed, _)| smoothed.statistics.length),
        sum(&|(smoothed, _)| smoothed.trajectory.duration()) / sum(&|(_, safe)| *safe),
    );
}

/// Thread CPU time, s.
fn cpu() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}
