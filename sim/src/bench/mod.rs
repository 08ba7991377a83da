//! How much does this machine hold? Rays a second and the real-time factor, by a clock that is passed in.

mod worlds;

use std::collections::HashMap;
use std::time::Duration;

use nalgebra::Point2;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::Serialize;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::robot::RobotModel;

use crate::lidar::AngularBuffer;
use crate::simulation::{RobotSpec, SimError, Simulation};
use crate::world::World;
pub use worlds::{floor, office, polygons};

/// Rounds of sweeps.
const ROUNDS: usize = 10;
/// Least time of each.
const ROUND: Duration = Duration::from_millis(50);

/// What was measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchReport {
    /// Robots in the world.
    pub robots: usize,
    /// Beams of each lidar.
    pub beams: usize,
    /// Scans a second of each, of simulated time.
    pub rate_hz: f64,
    /// Steps of the whole simulation that were timed.
    pub steps: u64,
    /// Beams a second of exact sweeps alone, on one core, in the fastest round.
    pub rays_per_s: f64,
    /// Simulated time over the time that the whole simulation took on one core, everything included; robots see one another.
    pub real_time_factor: f64,
    /// The same of a single one of these robots.
    pub single_real_time_factor: f64,
}

/// Where so many poses in a row are taken there is no room.
const TRIES: usize = 10_000;

/// Places `count` robots at random in the free part of a world, at least `margin` m apart from everything; fewer where
/// there is no room left. Robots are only compared with those in the cells around them.
#[must_use]
pub fn scatter(world: &World, model: &RobotModel, count: usize, margin: f64, seed: u64) -> Vec<Pose2> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let (low, high) = world.bounds();
    let apart = 2.0 * model.footprint.circumscribed_radius() + margin;
    let mut poses: Vec<Pose2> = Vec::new();
    let mut cells: HashMap<(i64, i64), Vec<usize>> = HashMap::new();
    let cell = |value: f64| (value / apart.max(1e-3)).floor() as i64;
    let mut failures = 0;
    while poses.len() < count && failures < TRIES {
        let mut unit = || rng.next_u64() as f64 / u64::MAX as f64;
        let at = Point2::new(low.x + unit() * (high.x - low.x), low.y + unit() * (high.y - low.y));
        let pose = Pose2::new(at.x, at.y, (unit() - 0.5) * std::f64::consts::TAU);
        let (x, y) = (cell(at.x), cell(at.y));
        let mut around = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| (x, y)));
        let taken = around.any(|cell| {
            let near = cells.get(&cell).into_iter().flatten();
            near.filter_map(|index| poses.get(*index))
                .any(|other| other.distance(&pose) <= apart)
        });
        if taken || world.clearance(&model.footprint, pose) <= margin {
            failures += 1;
            continue;
        }
        failures = 0;
        cells.entry((x, y)).or_default().push(poses.len());
        poses.push(pose);
    }
    poses
}

/// Times sweeps at random free poses, then a whole simulation of `robots` robots that turn in small circles, and of one alone.
/// `clock` tells the time since any fixed moment.
///
/// # Errors
/// [`SimError`] when the robots cannot stand in the world.
pub fn run(
    world: &World,
    model: &RobotModel,
    robots: usize,
    simulated: Duration,
    clock: &dyn Fn() -> Duration,
) -> Result<BenchReport, SimError> {
    let rays_per_s = rays(world, model, clock);
    let (robots, steps, real_time_factor) = whole(world, model, robots, simulated, clock)?;
    let single_real_time_factor = match robots {
        0 | 1 => real_time_factor,
        _ => whole(world, model, 1, simulated, clock)?.2,
    };
    Ok(BenchReport {
        robots,
        beams: model.lidar.beams,
        rate_hz: model.lidar.rate_hz,
        steps,
        rays_per_s,
        real_time_factor,
        single_real_time_factor,
    })
}

/// A whole simulation: how many robots had room, steps, and the real-time factor.
fn whole(
    world: &World,
    model: &RobotModel,
    robots: usize,
    simulated: Duration,
    clock: &dyn Fn() -> Duration,
) -> Result<(usize, u64, f64), SimError> {
    let specs = scatter(world, model, robots, model.drive.wheel_separation, 1)
        .into_iter()
        .enumerate()
        .filter_map(|(i, start)| {
            let id = Id::robot(format!("robot_{i}")).ok()?;
            Some(RobotSpec {
                id,
                model: model.clone(),
                start,
            })
        });
    let mut simulation = Simulation::new(world, specs.collect(), 1)?;
    let top = model.drive.max_wheel_speed;
    for robot in 0..simulation.robots() {
        simulation.drive(robot, [-0.1 * top, 0.5 * top]);
    }
    let steps = (simulated.as_secs_f64() / simulation.tick().as_secs_f64()).round() as u64;
    let begin = clock();
    for _ in 0..steps {
        simulation.step();
    }
    let took = clock().saturating_sub(begin).as_secs_f64();
    Ok((simulation.robots(), steps, simulation.now().as_secs() / took.max(1e-9)))
}

/// Exact sweeps from random free poses; beams a second in the fastest of ten rounds, because other programs only ever slow one down.
#[must_use]
pub fn rays(world: &World, model: &RobotModel, clock: &dyn Fn() -> Duration) -> f64 {
    let poses = scatter(world, model, 100, 0.0, 2);
    let mut buffer = AngularBuffer::new(&model.lidar);
    let (mut fastest, mut seen) = (0.0_f64, 0.0_f64);
    for _ in 0..if poses.is_empty() { 0 } else { ROUNDS } {
        let (begin, mut sweeps) = (clock(), 0);
        let took = loop {
            for pose in &poses {
                buffer.begin(*pose * model.lidar.mount);
                buffer.scene(world.scene());
                // The result is used, so that nothing of the work can be left out.
                seen += buffer.ranges().filter(|range| range.is_finite()).sum::<f64>();
            }
            sweeps += poses.len();
            let took = clock().saturating_sub(begin);
            if took >= ROUND {
                break took;
            }
        };
        fastest = fastest.max((sweeps * model.lidar.beams) as f64 / took.as_secs_f64());
    }
    if seen.is_nan() { 0.0 } else { fastest }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn scattered_robots_stand_apart_and_a_full_world_takes_no_more() {
        let model = zenav_fixtures::robot("tiago");
        let world = World::shipped("empty").unwrap();
        let poses = scatter(&world, &model, 50, 0.5, 1);
        assert_eq!(poses.len(), 50);
        for (i, pose) in poses.iter().enumerate() {
            assert!(
                poses
                    .iter()
                    .skip(i + 1)
                    .all(|other| pose.distance(other) > 2.0 * 0.265 + 0.5)
            );
        }
        assert!((20..=100).contains(&scatter(&world, &model, 1000, 2.0, 1).len()));
    }

    #[test]
    fn a_floor_has_room_for_all_robots_that_it_was_made_for() {
        for (name, count) in [("tiago", 1000), ("neato", 300), ("jackal", 1)] {
            let model = zenav_fixtures::robot(name);
            let world = floor(&model, count).unwrap();
            let placed = scatter(&world, &model, count, model.drive.wheel_separation, 1);
            assert_eq!(placed.len(), count, "{name}");
        }
    }

    #[test]
    fn a_bench_tells_of_all_robots_and_of_one() {
        let model = zenav_fixtures::robot("tiago");
        let ticks = std::cell::Cell::new(0);
        let clock = || {
            ticks.set(ticks.get() + 1);
            Duration::from_secs(ticks.get())
        };
        let world = World::shipped("empty").unwrap();
        let report = run(&world, &model, 3, Duration::from_secs(2), &clock).unwrap();
        assert_eq!((report.robots, report.beams, report.steps), (3, 667, 100));
        // By this clock each simulation takes a second.
        assert_eq!((report.real_time_factor, report.single_real_time_factor), (2.0, 2.0));
    }
}
