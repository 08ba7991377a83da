//! Evidence. Share of a scan that agrees with the map from a pose.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;

use crate::known_map::KnownMap;
use crate::settings::EvidenceSettings;

/// Evidence of a scan on a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Points in known cells; others do not count.
    pub points: usize,
    /// Share of them that end at a wall without passing through one, 0 to 1.
    pub agreeing: f64,
    /// Share of them that go through a wall, 0 to 1: a pose in the wrong room, or a wall that was removed.
    pub through_walls: f64,
}

/// Weighs a pose `map_from_base`. `laser`: where the beams begin, `points`: where they end, both in the frame of the base, m.
///
/// Cost: one lookup per cell along each beam.
#[must_use]
pub fn evidence(
    map: &KnownMap,
    laser: Point2<f64>,
    points: &[Point2<f64>],
    map_from_base: Pose2,
    settings: &EvidenceSettings,
) -> Evidence {
    let field = map.field();
    let resolution = field.spec().resolution;
    let from = map_from_base.transform_point(laser);
    let (mut counted, mut agreeing, mut through) = (0_usize, 0_usize, 0_usize);
    for point in points {
        let end = map_from_base.transform_point(*point);
        let beam = end - from;
        let length = beam.norm();
        let steps = ((length - settings.own_end) / resolution).floor().max(0.0) as usize;
        let step = beam * (resolution / length.max(f64::MIN_POSITIVE));
        let passes = (0..steps).any(|count| field.at(from + step * count as f64) >= settings.wall);
        let ends = field.at(end) >= settings.explained;
        if !passes && !ends && !map.knows(end) {
            continue;
        }
        counted += 1;
        agreeing += usize::from(ends && !passes);
        through += usize::from(passes);
    }
    let share = |count: usize| count as f64 / counted.max(1) as f64;
    Evidence {
        points: counted,
        agreeing: share(agreeing),
        through_walls: share(through),
    }
}
