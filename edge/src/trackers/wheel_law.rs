//! Wheel law. Which twist drives through a list of waypoints? The proportional law of the classic two-wheel exercise:
//! `left = -p_alpha * alpha + p_rho * rho`, `right = p_alpha * alpha + p_rho * rho`, with the bearing `alpha` and the
//! distance `rho` of the next waypoint, clamped to the wheels' limit.
//!
//! Three changes make it drive well. The clamp takes from the distance term, never from the turn. The distance term
//! fades as `alpha` grows, so that the robot turns first instead of swinging wide. And `rho` reaches beyond a waypoint
//! that is passed straight on, so that the robot slows down for corners and the end only.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::robot::{ControllerGains, Drive};

use super::waypoints::WaypointLaw;
use super::{TrackerInput, bearing};

/// Number of waypoints looked at: farther ahead the speed limit applies anyway.
const LOOK: usize = 8;

/// Drives each wheel by the bearing and the distance of the next waypoint.
#[derive(Clone, Copy, Debug, Default)]
pub struct WheelLaw;

impl WaypointLaw for WheelLaw {
    fn threshold(&self, gains: &ControllerGains) -> f64 {
        gains.waypoint_threshold
    }

    fn twist(
        &self,
        drive: &Drive,
        target: Point2<f64>,
        rest: &[Point2<f64>],
        view: &TrackerInput,
        gains: &ControllerGains,
    ) -> Twist2 {
        let limit = drive.max_wheel_speed.min(view.speed_cap / drive.wheel_radius);
        let alpha = bearing(&view.map_from_base, target);
        let rho = effective_distance(view.map_from_base.position(), rest).max(gains.wheel_law.least_distance);
        let turn = (gains.heading_gain * alpha).clamp(-limit, limit);
        let fade = (1.0 - alpha.abs() / gains.wheel_law.turn_first).max(0.0);
        let forward = (gains.distance_gain * rho * fade)
            .min(limit * fade)
            .min(limit - turn.abs());
        drive.twist([forward - turn, forward + turn])
    }
}

/// The distance that the law uses: to the next waypoint, and beyond it as far as the path goes straight on.
fn effective_distance(here: Point2<f64>, rest: &[Point2<f64>]) -> f64 {
    let mut rho = 0.0;
    let mut weight = 1.0;
    let mut from = here;
    let mut direction: Option<Vector2<f64>> = None;
    for target in rest.iter().take(LOOK) {
        let leg = target - from;
        if let Some(before) = direction {
            let cos = before.dot(&leg) / (before.norm() * leg.norm()).max(1e-9);
            weight *= 0.5 * (1.0 + cos.clamp(-1.0, 1.0));
        }
        rho += weight * leg.norm();
        (direction, from) = (Some(leg), *target);
    }
    rho
}
