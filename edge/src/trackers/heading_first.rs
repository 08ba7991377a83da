//! Heading-first law. Which twist drives through a list of waypoints, turning first? The go-to-goal law of the classic exercise:
//! `w = Kw * alpha`, and `v = Kv * rho` once the bearing `alpha` is small.

use nalgebra::Point2;
use zenav_protocol::geometry::Twist2;
use zenav_protocol::robot::{ControllerGains, Drive};

use super::waypoints::WaypointLaw;
use super::{TrackerInput, bearing, capped};
use crate::limiter::within_speed;

/// Turns, then drives.
#[derive(Clone, Copy, Debug, Default)]
pub struct HeadingFirst;

impl WaypointLaw for HeadingFirst {
    fn threshold(&self, gains: &ControllerGains) -> f64 {
        gains.heading_first.waypoint
    }

    fn twist(
        &self,
        drive: &Drive,
        target: Point2<f64>,
        _: &[Point2<f64>],
        view: &TrackerInput,
        gains: &ControllerGains,
    ) -> Twist2 {
        let alpha = bearing(&view.map_from_base, target);
        let ahead = if alpha.abs() > gains.heading_first.aligned {
            0.0
        } else {
            (target - view.map_from_base.position()).norm()
        };
        let wanted = Twist2::new(gains.go_gain * ahead, gains.turn_gain * alpha);
        capped(drive, within_speed(drive, wanted), view.speed_cap)
    }
}
