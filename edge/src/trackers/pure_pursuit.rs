//! Regulated pure pursuit. Which arc leads back to the path? After Macenski, Singh, Martin, Ginés, "Regulated pure pursuit for
//! robot path tracking", Autonomous Robots 47, 2023: curvature `2 y / L²` to a point ahead, at a distance that grows with speed;
//! slowed in bends and near the end; turns on the spot where the path leads elsewhere.

use nalgebra::Point2;
use zenav_protocol::geometry::Twist2;
use zenav_protocol::robot::{ControllerGains, Drive};

use super::on_path::{PathLaw, Wanted};
use super::{PathProjection, TrackerInput, bearing};

/// Pursues a point ahead.
#[derive(Clone, Debug, Default)]
pub struct PurePursuit {
    target: Option<Point2<f64>>,
}

impl PathLaw for PurePursuit {
    fn step(
        &mut self,
        projection: &PathProjection,
        drive: &Drive,
        view: &TrackerInput,
        gains: &ControllerGains,
    ) -> Wanted {
        let law = &gains.pure_pursuit;
        let distance = (view.velocity.v.abs() * gains.lookahead_secs).clamp(law.lookahead, law.lookahead_most);
        let target = projection.ahead(&view.map_from_base, distance);
        self.target = Some(target);
        let alpha = bearing(&view.map_from_base, target);
        if alpha.abs() > law.turn_first {
            return Wanted::Turn(alpha);
        }
        let reach = (target - view.map_from_base.position()).norm().max(1e-3);
        let curvature = 2.0 * alpha.sin() / reach;
        let bend = (1.0 / (curvature.abs() * law.slow_radius).max(1e-9)).min(1.0);
        let near = (projection.left() / law.approach).min(1.0);
        let v = (drive.top_speed() * bend).max(law.least_speed) * near.max(law.least_speed / drive.top_speed());
        Wanted::Drive(Twist2::new(v, v * curvature))
    }

    fn target(&self, projection: &PathProjection) -> Point2<f64> {
        self.target.unwrap_or_else(|| projection.here().position())
    }
}
