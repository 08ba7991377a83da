//! Original wheel law. Which twist drives through a list of waypoints in the two-wheel exercise, unchanged?
//! `left = -p_alpha * alpha + p_rho * rho`, `right = p_alpha * alpha + p_rho * rho`, each wheel clamped to its limit by itself, with the
//! gains 4 and 2 and the next waypoint once the last one is nearer than the threshold.
//!
//! It slows down towards every waypoint, and a clamped wheel takes from the turn. `wheel_law` mends both; this one is the yardstick.

use nalgebra::Point2;
use zenav_protocol::geometry::Twist2;
use zenav_protocol::robot::{ControllerGains, Drive};

use super::waypoints::WaypointLaw;
use super::{TrackerInput, bearing};

/// The wheel law of the exercise.
#[derive(Clone, Copy, Debug, Default)]
pub struct OriginalWheelLaw;

impl WaypointLaw for OriginalWheelLaw {
    fn threshold(&self, gains: &ControllerGains) -> f64 {
        gains.waypoint_threshold
    }

    fn twist(
        &self,
        drive: &Drive,
        target: Point2<f64>,
        _: &[Point2<f64>],
        view: &TrackerInput,
        gains: &ControllerGains,
    ) -> Twist2 {
        let limit = drive.max_wheel_speed.min(view.speed_cap / drive.wheel_radius);
        let turn = gains.heading_gain * bearing(&view.map_from_base, target);
        let forward = gains.distance_gain * (target - view.map_from_base.position()).norm();
        drive.twist([forward - turn, forward + turn].map(|wheel| wheel.clamp(-limit, limit)))
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Pose2;

    use super::*;

    #[test]
    fn each_wheel_gets_what_the_law_says_and_is_clamped_by_itself() {
        let model = zenav_fixtures::robot("tiago");
        let wheels = |yaw: f64, ahead: f64| {
            let view = TrackerInput {
                dt: 0.02,
                map_from_base: Pose2::new(0.0, 0.0, yaw),
                velocity: Twist2::ZERO,
                speed_cap: f64::INFINITY,
            };
            let target = Point2::new(ahead, 0.0);
            model
                .drive
                .wheels(OriginalWheelLaw.twist(&model.drive, target, &[target], &view, &model.controller))
        };
        let most = model.drive.max_wheel_speed;
        for (yaw, ahead, expected) in [
            (0.0, 1.0, [2.0, 2.0]),
            (-0.5, 1.0, [0.0, 4.0]),
            (-1.2, 1.0, [-2.8, most]),
            (0.1, 4.0, [most, most]),
        ] {
            let wheels = wheels(yaw, ahead);
            let off = [wheels[0] - expected[0], wheels[1] - expected[1]];
            assert!(off.iter().all(|off| off.abs() < 1e-9), "{yaw} {ahead}: {wheels:?}");
        }
    }
}
