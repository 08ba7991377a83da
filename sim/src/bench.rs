//! How much does this machine hold? Rays a second and the real-time factor, by a clock that is passed in.

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

/// What was measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchReport {
    /// Robots in the world.
    pub robots: usize,
    /// Beams of each lidar.
    pub beams: usize,
    /// Steps of the whole simulation that were timed.
    pub steps: u64,
    /// Beams a second of exact sweeps alone, on one core.
    pub rays_per_s: f64,
    /// Simulated time over wall time of the whole simulation, everything included.
    pub real_time_factor: f64,
}

/// Free poses are searched for so many times a robot.
const TRIES: usize = 10_000;

/// Places `count` robots at random in the free part of a world, at least `margin` m apart from everything; fewer where
/// there is no room.
#[must_use]
pub fn scatter(world: &World, model: &RobotModel, count: usize, margin: f64, seed: u64) -> Vec<Pose2> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let (low, high) = world.bounds();
    let apart = 2.0 * model.footprint.circumscribed_radius() + margin;
    let mut poses: Vec<Pose2> = Vec::new();
    for _ in 0..count.saturating_mul(TRIES) {
        if poses.len() >= count {
            break;
        }
        let mut unit = || rng.next_u64() as f64 / u64::MAX as f64;
        let at = Point2::new(low.x + unit() * (high.x - low.x), low.y + unit() * (high.y - low.y));
        let pose = Pose2::new(at.x, at.y, (unit() - 0.5) * std::f64::consts::TAU);
        if poses.iter().all(|other| other.distance(&pose) > apart) && world.clearance(&model.footprint, pose) > margin {
            poses.push(pose);
        }
    }
    poses
}

/// Times sweeps at random free poses, then a whole simulation of `robots` robots that turn in small circles. `clock` tells
/// the time since any fixed moment.
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
    Ok(BenchReport {
        robots: simulation.robots(),
        beams: model.lidar.beams,
        steps,
        rays_per_s,
        real_time_factor: simulation.now().as_secs() / took.max(1e-9),
    })
}

/// Exact sweeps from random free poses, for about half a second; beams a second.
fn rays(world: &World, model: &RobotModel, clock: &dyn Fn() -> Duration) -> f64 {
    let poses = scatter(world, model, 100, 0.0, 2);
    let mut buffer = AngularBuffer::new(&model.lidar);
    let begin = clock();
    let (mut sweeps, mut seen) = (0_u64, 0.0_f64);
    let took = loop {
        for pose in &poses {
            buffer.begin(*pose * model.lidar.mount);
            buffer.scene(world.scene());
            // The result is used, so that nothing of the work can be left out.
            seen += buffer.ranges().filter(|range| range.is_finite()).sum::<f64>();
        }
        sweeps += poses.len() as u64;
        let took = clock().saturating_sub(begin);
        if took >= Duration::from_millis(500) || poses.is_empty() {
            break took;
        }
    };
    if seen.is_nan() {
        0.0
    } else {
        (sweeps * model.lidar.beams as u64) as f64 / took.as_secs_f64().max(1e-9)
    }
}
