//! PID. Which twist keeps a robot on a path by feedback alone? A PID on the distance from the path, at the plan's speed; the textbook
//! form with a clamped integral and the derivative taken from the heading, so that noise is not differentiated.

use nalgebra::Point2;
use zenav_protocol::geometry::{Twist2, wrap_angle};
use zenav_protocol::robot::{ControllerGains, Drive};

use super::on_path::{PathLaw, Wanted};
use super::{PathProjection, TrackerInput};

/// PID on the cross-track error.
#[derive(Clone, Debug, Default)]
pub struct Pid {
    integral: f64,
}

impl PathLaw for Pid {
    fn step(
        &mut self,
        projection: &PathProjection,
        drive: &Drive,
        view: &TrackerInput,
        gains: &ControllerGains,
    ) -> Wanted {
        let (law, path) = (&gains.pid, projection.here());
        // The direction of the path, not of a turn on the spot that it begins with.
        let ahead = projection.ahead(&view.map_from_base, 0.1) - path.position();
        let yaw = if ahead.norm() > 1e-6 {
            ahead.y.atan2(ahead.x)
        } else {
            path.yaw
        };
        let heading = wrap_angle(yaw - view.map_from_base.yaw);
        if heading.abs() > law.turn_first {
            return Wanted::Turn(heading);
        }
        let aside = path.position() - view.map_from_base.position();
        let cross = -yaw.sin() * aside.x + yaw.cos() * aside.y;
        self.integral = (self.integral + cross * view.dt).clamp(-law.windup, law.windup);
        let braking = (2.0 * law.braking_share * drive.acceleration() * projection.left()).sqrt();
        let v = path.v.abs().max(law.least_speed).min(braking.max(law.least_speed));
        let rate = v.max(0.1) * heading.sin();
        let w = gains.pid_p * cross + gains.pid_i * self.integral + gains.pid_d * rate;
        Wanted::Drive(Twist2::new(v, w))
    }

    fn target(&self, projection: &PathProjection) -> Point2<f64> {
        projection.here().position()
    }
}
