//! Verdict. Decides whether a scan fits at its pose.
//!
//! Two numbers that a covariance does not have: the share of the points explained by a known surface, and the share of the beams that go
//! through a wall (as emcl2 does). A pose in the wrong room can score well on the first; seldom on both.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;

use crate::field::{LikelihoodField, placed};
use crate::settings::VerdictSettings;

/// The verdict on a scan at a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    /// Share of the points that lie on a known surface, 0 to 1.
    pub explained: f64,
    /// Share of the beams that pass a known surface well before their end, 0 to 1.
    pub through_walls: f64,
}

/// Judges a pose `field_from_scan`. `origin`: where the beams begin, `points`: where they end, both in the frame of the scan, m.
///
/// Cost: one lookup per cell along each beam.
#[must_use]
pub fn judge(
    field: &LikelihoodField,
    origin: Point2<f64>,
    points: &[Point2<f64>],
    field_from_scan: Pose2,
    settings: &VerdictSettings,
) -> Verdict {
    if points.is_empty() {
        return Verdict {
            explained: 0.0,
            through_walls: 0.0,
        };
    }
    let from = field_from_scan.transform_point(origin);
    let (mut explained, mut through) = (0_usize, 0_usize);
    for end in placed(field_from_scan, points) {
        explained += usize::from(field.at(end) >= settings.explained);
        let beam = end - from;
        let length = beam.norm();
        let steps = ((length - settings.own_end) / field.spec().resolution).floor().max(0.0) as usize;
        let step = beam * (field.spec().resolution / length.max(f64::MIN_POSITIVE));
        through += usize::from((0..steps).any(|count| field.at(from + step * count as f64) >= settings.wall));
    }
    Verdict {
        explained: explained as f64 / points.len() as f64,
        through_walls: through as f64 / points.len() as f64,
    }
}
