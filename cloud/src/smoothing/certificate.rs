//! Is a motion free? The true footprint's sweep along it, against the map, before it leaves the house.

use zenav_protocol::geometry::Pose2;

use super::timing::{Limits, Motion};
use crate::space::ConfigurationSpace;

/// Largest distance between two checked poses, m, and turn between them, rad.
const STEP: f64 = 0.03;
const TURN: f64 = 0.08;

/// The motion touches an obstacle, or leads where nobody has looked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("collision")]
pub struct Collision;

/// Least distance (m) of the true footprint to an obstacle along a motion; `None` when there is nothing within the space's reach.
///
/// The first `exempt` metres around the start are not looked at: a robot that stands where it should not has to leave.
///
/// # Errors
/// [`Collision`].
pub fn clearance(space: &ConfigurationSpace, motion: &Motion, limits: &Limits, exempt: f64) -> Result<Option<f64>, Collision> {
    let period = (STEP / limits.speed).min(TURN / limits.yaw_rate);
    // Poses are joined by straight lines; the arc between two of them bulges by no more than this.
    let bulge = limits.lateral_acceleration * period * period / 8.0;
    let mut poses: Vec<Pose2> = motion.states(period).into_iter().map(|state| state.point.pose()).collect();
    if exempt > 0.0
        && let Some(start) = poses.first().copied()
    {
        let left = poses.iter().position(|pose| pose.distance(&start) > exempt).unwrap_or(poses.len());
        poses.drain(..left);
    }
    if poses.iter().any(|pose| !space.is_permitted(pose.position())) {
        return Err(Collision);
    }
    let least = space.sweep_min_clearance(&poses);
    if least <= bulge && !poses.is_empty() {
        return Err(Collision);
    }
    Ok((least < space.reach()).then_some(least))
}
