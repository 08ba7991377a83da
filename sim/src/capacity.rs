//! Capacity. How many rays and robots does the simulator hold on this machine? The clock is passed in.

use std::time::Duration;

use serde::Serialize;
use zenav_protocol::id::Id;
use zenav_protocol::robot::RobotModel;

use crate::lidar::AngularBuffer;
use crate::scatter::scatter;
use crate::{RobotSpec, SimError, Simulation, World};

/// Number of rounds of sweeps.
const ROUNDS: usize = 10;
/// Shortest time of a round.
const ROUND: Duration = Duration::from_millis(50);

/// Results.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CapacityReport {
    /// Robots in the world.
    pub robots: usize,
    /// Beams of each lidar.
    pub beams: usize,
    /// Scans of each lidar per simulated second.
    pub rate_hz: f64,
    /// Steps of the whole simulation that was timed.
    pub steps: u64,
    /// Beams per second of exact sweeps alone, on one core, in the fastest round.
    pub rays_per_s: f64,
    /// Simulated time over the time of the whole simulation on one core; robots see one another.
    pub real_time_factor: f64,
    /// The same for a single one of these robots.
    pub single_real_time_factor: f64,
}

/// Times sweeps at random free poses, then a whole simulation of `robots` robots that turn in small circles, and of one alone. `clock`
/// gives the time since any fixed moment.
///
/// # Errors
/// [`SimError`] if the robots do not fit into the world.
pub fn run(
    world: &World,
    model: &RobotModel,
    robots: usize,
    simulated: Duration,
    clock: &dyn Fn() -> Duration,
) -> Result<CapacityReport, SimError> {
    let rays_per_s = rays(world, model, clock);
    let lidars = || model.all_lidars().map(|(_, lidar)| lidar);
    let (robots, steps, real_time_factor) = whole(world, model, robots, simulated, clock)?;
    let single_real_time_factor = match robots {
        0 | 1 => real_time_factor,
        _ => whole(world, model, 1, simulated, clock)?.2,
    };
    Ok(CapacityReport {
        robots,
        beams: lidars().map(|lidar| lidar.beams).max().unwrap_or(0),
        rate_hz: lidars().map(|lidar| lidar.rate_hz).fold(0.0, f64::max),
        steps,
        rays_per_s,
        real_time_factor,
        single_real_time_factor,
    })
}

/// A whole simulation: number of robots that fitted, steps, and real-time factor.
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

/// Exact sweeps from random free poses; beams per second in the fastest of ten rounds, as other load on the machine only slows a round
/// down.
#[must_use]
pub fn rays(world: &World, model: &RobotModel, clock: &dyn Fn() -> Duration) -> f64 {
    let poses = scatter(world, model, 100, 0.0, 2);
    let Some(lidar) = model.first_lidar() else {
        return 0.0;
    };
    let mut buffer = AngularBuffer::new(lidar);
    let (mut fastest, mut seen) = (0.0_f64, 0.0_f64);
    for _ in 0..if poses.is_empty() { 0 } else { ROUNDS } {
        let (begin, mut sweeps) = (clock(), 0);
        let took = loop {
            for pose in &poses {
                buffer.begin(*pose * lidar.mount);
                buffer.scene(world.scene());
                // The result is used, so that the compiler cannot remove any of the work.
                seen += buffer.ranges().filter(|range| range.is_finite()).sum::<f64>();
            }
            sweeps += poses.len();
            let took = clock().saturating_sub(begin);
            if took >= ROUND {
                break took;
            }
        };
        fastest = fastest.max((sweeps * lidar.beams) as f64 / took.as_secs_f64());
    }
    if seen.is_nan() { 0.0 } else { fastest }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_tells_of_all_robots_and_of_one() {
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
