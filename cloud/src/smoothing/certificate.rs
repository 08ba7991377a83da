//! Is a motion free? The true footprint's sweep along it, against the map, before it leaves the house.

use zenav_protocol::geometry::Pose2;

use super::shortcut::is_permitted_along;
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
/// The first `exempt` metres around the start are no reason to refuse: a robot that stands where it should not has to leave. They
/// count in the clearance that is told.
///
/// # Errors
/// [`Collision`].
pub fn clearance(
    space: &ConfigurationSpace,
    motion: &Motion,
    limits: &Limits,
    exempt: f64,
) -> Result<Option<f64>, Collision> {
    let period = (STEP / limits.speed).min(TURN / limits.yaw_rate);
    // Poses are joined by straight lines; the arc between two of them bulges by no more than this.
    let bulge = limits.lateral_acceleration * period * period / 8.0;
    let all: Vec<Pose2> = motion
        .states(period)
        .into_iter()
        .map(|state| state.point.pose())
        .collect();
    let leaving = all.first().filter(|_| exempt > 0.0).map_or(0, |start| {
        let left = all.iter().position(|pose| pose.distance(start) > exempt);
        left.unwrap_or(all.len())
    });
    let poses = &all[leaving..];
    if poses
        .windows(2)
        .any(|pair| !is_permitted_along(space, pair[0].position(), pair[1].position()))
    {
        return Err(Collision);
    }
    let least = sweep(space, poses);
    if least <= bulge && !poses.is_empty() {
        return Err(Collision);
    }
    let least = if leaving > 0 {
        least.min(sweep(space, &all[..leaving]))
    } else {
        least
    };
    Ok((least < space.reach()).then_some(least))
}

/// Poses that are measured together.
const CHUNK: usize = 16;

/// As [`ConfigurationSpace::sweep_min_clearance`], but the distance field tells first where it is worth looking.
fn sweep(space: &ConfigurationSpace, poses: &[Pose2]) -> f64 {
    let radius = space.footprint().circumscribed_radius();
    let bound = |pose: &Pose2| {
        let Some(cell) = space.spec().cell_at(pose.position()) else {
            return 0.0;
        };
        space.field().distance(cell) - (space.spec().center(cell) - pose.position()).norm() - radius
    };
    // Between two poses that both count, no place is farther from the nearer one than half a step.
    let bounds = (0..poses.len()).step_by(CHUNK).map(|begin| {
        let chunk = &poses[begin..(begin + CHUNK + 1).min(poses.len())];
        (
            chunk.iter().map(bound).fold(f64::INFINITY, f64::min) - 0.5 * STEP - radius * 0.5 * TURN,
            chunk,
        )
    });
    let mut chunks: Vec<_> = bounds.collect();
    chunks.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut least = space.reach();
    for (bound, chunk) in chunks {
        if bound >= least {
            break;
        }
        least = least.min(space.sweep_min_clearance(chunk));
    }
    least
}
