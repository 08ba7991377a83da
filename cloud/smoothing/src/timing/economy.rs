//! Economy. Less energy along the same turns and paths, in more time.
//!
//! Slow driving costs the idle power of the electronics, fast driving costs friction that grows with speed, and hard acceleration heats
//! the motors with the square of the force; braking recovers nothing. The best speed and acceleration depend on the robot and on how
//! often the path makes it slow down, so they are sought for each trajectory: the two limits (as shares of the robot's) with the least
//! energy by the robot's own model, found by pattern search.
//!
//! Source: Mei, Lu, Hu and Lee, "Energy-Efficient Motion Planning for Mobile Robots", ICRA 2004 (the best speed from the motors' power); the
//! search: Hooke and Jeeves, "Direct Search Solution of Numerical and Statistical Problems", JACM 1961.

use zenav_protocol::robot::RobotModel;

use super::limits::Limits;
use super::trajectory::PiecewiseTrajectory;

/// First and last step of the search, as shares of a limit.
const STEPS: (f64, f64) = (0.32, 0.02);
/// Smallest share of a limit.
const LEAST: f64 = 0.1;

/// The trajectory with the least energy found along the same turns and paths, and its limits. Never more energy than `fastest`.
#[must_use]
pub fn economical(fastest: PiecewiseTrajectory, model: &RobotModel, limits: &Limits) -> (PiecewiseTrajectory, Limits) {
    let mut best = Found {
        joules: fastest.energy(model),
        shares: [1.0; 2],
        trajectory: fastest.clone(),
        limits: *limits,
    };
    let mut step = STEPS.0;
    while step > STEPS.1 {
        let [speed, acceleration] = best.shares;
        let around = [
            [speed - step, acceleration],
            [speed, acceleration - step],
            [speed + step, acceleration],
            [speed, acceleration + step],
        ];
        let better = around
            .into_iter()
            .filter_map(|shares| Found::new(&fastest, model, limits, shares))
            .min_by(|a, b| a.joules.total_cmp(&b.joules))
            .filter(|found| found.joules < best.joules);
        match better {
            Some(found) => best = found,
            None => step *= 0.5,
        }
    }
    (best.trajectory, best.limits)
}

/// A trajectory under a share of the limits of speed and acceleration.
struct Found {
    joules: f64,
    shares: [f64; 2],
    trajectory: PiecewiseTrajectory,
    limits: Limits,
}

impl Found {
    /// `None` if these limits do not allow the speed at the start.
    fn new(fastest: &PiecewiseTrajectory, model: &RobotModel, limits: &Limits, shares: [f64; 2]) -> Option<Self> {
        if shares.iter().any(|share| !(LEAST..=1.0).contains(share)) {
            return None;
        }
        let [speed, acceleration] = shares;
        let limits = Limits {
            speed: speed * limits.speed,
            yaw_rate: speed * limits.yaw_rate,
            wheel_acceleration: acceleration * limits.wheel_acceleration,
            ..*limits
        };
        let trajectory = fastest.retimed(&limits)?;
        Some(Self {
            joules: trajectory.energy(model),
            shares,
            trajectory,
            limits,
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::geometry::{Pose2, Twist2};

    use super::super::UNRESTRICTED;
    use super::super::stop_turn_go::stop_turn_go;
    use super::*;

    fn robot(name: &str) -> RobotModel {
        zenav_fixtures::robot(name)
    }

    fn drive(model: &RobotModel, speed: f64) -> (PiecewiseTrajectory, Limits) {
        let limits = Limits::of(model);
        let path = [Point2::new(6.0, 0.0), Point2::new(6.0, 4.0), Point2::new(0.0, 4.0)];
        let trajectory = stop_turn_go(
            &path,
            Pose2::IDENTITY,
            Twist2::new(speed, 0.0),
            None,
            &limits,
            UNRESTRICTED,
        );
        (trajectory, limits)
    }

    #[test]
    fn it_takes_longer_draws_less_and_goes_the_same_way() {
        for name in ["tiago", "jackal"] {
            let model = robot(name);
            let (fastest, limits) = drive(&model, 0.0);
            let (economy, kept) = economical(fastest.clone(), &model, &limits);
            assert!(economy.energy(&model) < 0.98 * fastest.energy(&model), "{name}");
            assert!(economy.duration() > fastest.duration() && economy.length() == fastest.length());
            assert!(kept.speed <= limits.speed && kept.wheel_acceleration <= limits.wheel_acceleration);
            let end = |trajectory: &PiecewiseTrajectory| trajectory.at(trajectory.duration()).point.pose();
            assert!(end(&economy).distance(&end(&fastest)) < 1e-9);
        }
    }

    #[test]
    fn a_robot_without_losses_but_with_thirsty_electronics_hurries() {
        let mut model = robot("tiago");
        model.battery.idle_power = 5000.0;
        let (fastest, limits) = drive(&model, 0.0);
        let (economy, _) = economical(fastest.clone(), &model, &limits);
        assert!(economy.duration() < 1.001 * fastest.duration());
    }

    #[test]
    fn a_robot_at_speed_goes_on_at_that_speed() {
        let model = robot("jackal");
        let (fastest, limits) = drive(&model, 1.8);
        let (economy, _) = economical(fastest, &model, &limits);
        assert!((economy.at(0.0).point.v - 1.8).abs() < 1e-9);
    }

    #[test]
    fn the_forecast_is_the_power_summed_up() {
        let model = robot("tiago");
        let (trajectory, _) = drive(&model, 0.0);
        let steps = 200_000;
        let dt = trajectory.duration() / f64::from(steps);
        let summed: f64 = (0..steps)
            .map(|i| {
                let state = trajectory.at(dt * (f64::from(i) + 0.5));
                let wheels = |twist| model.drive.wheels(twist);
                model.power(wheels(state.point.twist()), wheels(Twist2::new(state.a, state.alpha))) * dt
            })
            .sum();
        assert!((trajectory.energy(&model) - summed).abs() < 1e-3 * summed);
    }
}
