//! Which twist keeps a robot on a path by feedback alone? A PID on the distance from the path, at the plan's speed; the textbook
//! form with a clamped integral and the derivative taken from the heading, so that noise is not differentiated.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::robot::{ControllerGains, Drive};

use super::{Progress, Rail, Timeline, Tracker, View, capped};
use crate::limiter::{wheel_surface_speed, within_speed};

/// The integral is held within this, m s.
const WINDUP: f64 = 0.3;
/// Slowest on the way, m/s.
const LEAST_SPEED: f64 = 0.08;
/// Heading error beyond which the robot turns on the spot, rad.
const TURN_FIRST: f64 = 0.8;
/// Turning on the spot: yaw rate for the heading error, 1/s.
const SPIN_GAIN: f64 = 2.0;
/// The end is reached within this, m.
const REACHED: f64 = 0.05;
/// Deceleration towards the end, as a share of what the robot can.
const BRAKING_SHARE: f64 = 0.5;
/// At rest: wheel surface speed, m/s.
const AT_REST: f64 = 0.02;

/// PID on the cross-track error.
#[derive(Clone, Debug)]
pub struct PidTracker {
    drive: Drive,
    rail: Rail,
    integral: f64,
    arrived: bool,
    finished: bool,
}

impl PidTracker {
    /// Along a path.
    #[must_use]
    pub fn new(drive: &Drive, rail: Rail) -> Self {
        Self {
            drive: drive.clone(),
            rail,
            integral: 0.0,
            arrived: false,
            finished: false,
        }
    }
}

impl Tracker for PidTracker {
    fn step(&mut self, view: &View, gains: &ControllerGains) -> Twist2 {
        self.rail.advance(&view.map_from_base);
        let left = self.rail.left();
        let to_end = (self.rail.end().pose().position() - view.map_from_base.position()).norm();
        self.arrived |= left < REACHED && to_end < 2.0 * REACHED || left < 1e-6;
        if self.arrived {
            self.finished |= wheel_surface_speed(&self.drive, view.velocity) < AT_REST;
            return Twist2::ZERO;
        }
        let path = self.rail.here();
        // The direction of the path, not of a turn on the spot that it begins with.
        let ahead = self.rail.ahead(&view.map_from_base, 0.1) - path.pose().position();
        let yaw = if ahead.norm() > 1e-6 {
            ahead.y.atan2(ahead.x)
        } else {
            path.yaw
        };
        let heading = wrap_angle(yaw - view.map_from_base.yaw);
        if heading.abs() > TURN_FIRST {
            let spin = within_speed(&self.drive, Twist2::new(0.0, SPIN_GAIN * heading));
            return capped(&self.drive, spin, view.speed_cap);
        }
        let aside = path.pose().position() - view.map_from_base.position();
        let cross = -yaw.sin() * aside.x + yaw.cos() * aside.y;
        self.integral = (self.integral + cross * view.dt).clamp(-WINDUP, WINDUP);
        let braking = (2.0 * BRAKING_SHARE * self.drive.acceleration() * left).sqrt();
        let v = path.v.abs().max(LEAST_SPEED).min(braking.max(LEAST_SPEED));
        let rate = v.max(0.1) * heading.sin();
        let w = gains.pid_p * cross + gains.pid_i * self.integral + gains.pid_d * rate;
        capped(
            &self.drive,
            within_speed(&self.drive, Twist2::new(v, w)),
            view.speed_cap,
        )
    }

    fn progress(&self, _: &Pose2) -> Progress {
        self.rail.progress(self.finished)
    }

    fn target(&self) -> Option<(&'static str, Point2<f64>)> {
        Some(("reference", self.rail.here().pose().position()))
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
