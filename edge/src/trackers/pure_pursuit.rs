//! Which arc leads back to the path? Regulated pure pursuit, after Macenski, Singh, Martin, Ginés, "Regulated pure pursuit for
//! robot path tracking", Autonomous Robots 47, 2023: curvature `2 y / L²` to a point ahead, at a distance that grows with speed;
//! slowed in bends and near the end; turns on the spot where the way leads elsewhere.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::robot::{ControllerGains, Drive};

use super::waypoints::bearing;
use super::{Progress, Rail, Timeline, Tracker, View, capped};
use crate::limiter::{wheel_surface_speed, within_speed};

/// The point ahead is at least and at most this far, m.
const LOOKAHEAD: (f64, f64) = (0.3, 0.9);
/// Bends tighter than this are driven slower, radius in m.
const TIGHT: f64 = 0.9;
/// Slowest in a bend, m/s.
const LEAST_SPEED: f64 = 0.1;
/// The end is approached slower from here on, m.
const APPROACH: f64 = 0.6;
/// Bearing of the point ahead beyond which the robot turns on the spot, rad.
const TURN_FIRST: f64 = 0.785;
/// Turning on the spot: yaw rate for the bearing, 1/s.
const SPIN_GAIN: f64 = 2.0;
/// The end is reached within this, m.
const REACHED: f64 = 0.05;
/// At rest: wheel surface speed, m/s.
const AT_REST: f64 = 0.02;

/// Pursues a point ahead.
#[derive(Clone, Debug)]
pub struct PurePursuit {
    drive: Drive,
    rail: Rail,
    target: Point2<f64>,
    arrived: bool,
    finished: bool,
}

impl PurePursuit {
    /// Along a path.
    #[must_use]
    pub fn new(drive: &Drive, rail: Rail) -> Self {
        Self {
            drive: drive.clone(),
            target: rail.here().pose().position(),
            rail,
            arrived: false,
            finished: false,
        }
    }
}

impl Tracker for PurePursuit {
    fn step(&mut self, view: &View, gains: &ControllerGains) -> Twist2 {
        self.rail.advance(&view.map_from_base);
        let left = self.rail.left();
        let to_end = (self.rail.end().pose().position() - view.map_from_base.position()).norm();
        self.arrived |= left < REACHED && to_end < 2.0 * REACHED || left < 1e-6;
        if self.arrived {
            self.finished |= wheel_surface_speed(&self.drive, view.velocity) < AT_REST;
            return Twist2::ZERO;
        }
        let distance = (view.velocity.v.abs() * gains.lookahead_secs).clamp(LOOKAHEAD.0, LOOKAHEAD.1);
        self.target = self.rail.ahead(&view.map_from_base, distance);
        let alpha = bearing(&view.map_from_base, self.target);
        if alpha.abs() > TURN_FIRST {
            let spin = within_speed(&self.drive, Twist2::new(0.0, SPIN_GAIN * alpha));
            return capped(&self.drive, spin, view.speed_cap);
        }
        let reach = (self.target - view.map_from_base.position()).norm().max(1e-3);
        let curvature = 2.0 * alpha.sin() / reach;
        let bend = (1.0 / (curvature.abs() * TIGHT).max(1e-9)).min(1.0);
        let near = (left / APPROACH).min(1.0);
        let v = (self.drive.top_speed() * bend).max(LEAST_SPEED) * near.max(LEAST_SPEED / self.drive.top_speed());
        let wanted = Twist2::new(v, v * curvature);
        capped(&self.drive, within_speed(&self.drive, wanted), view.speed_cap)
    }

    fn progress(&self, _: &Pose2) -> Progress {
        self.rail.progress(self.finished)
    }

    fn target(&self) -> Option<(&'static str, Point2<f64>)> {
        Some(("reference", self.target))
    }

    fn motion(&self) -> Option<(&Timeline, f64)> {
        Some(self.rail.motion())
    }

    fn off_track(&self) -> f64 {
        self.rail.off_track()
    }

    fn boxed(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }
}
