//! Evidence. Share of a scan that agrees with the map from a pose.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;

use crate::known_map::KnownMap;
use crate::settings::EvidenceSettings;

/// If the laser is in an obstacle of the map, and at least this share of the beams through walls passes only its walls and ends at another, the
/// obstacle was taken away: in a wrong place they end anywhere.
const GONE: f64 = 0.67;

/// Evidence of a scan on a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Points in known cells; others do not count.
    pub points: usize,
    /// Share of them that end at a wall without passing through one, 0 to 1; the walls of an obstacle that was taken away from where the
    /// robot is do not count.
    pub agreeing: f64,
    /// Share of them that go through a wall, 0 to 1: a pose in the wrong room, or a wall that was removed.
    pub through_walls: f64,
}

/// Weighs a pose `map_from_base`. `laser`: where the beams begin, `points`: where they end, both in the frame of the base, m.
///
/// Cost: one lookup per cell along each beam.
///
/// ```
#[doc = include_str!("doc_setup/room.txt")]
/// use zenav_localisation::{EvidenceSettings, KnownMap, evidence};
///
/// let known = KnownMap::new(&map, 0.08);
/// // Seen from the middle of the room: a stretch of the wall at x = 3.
/// let wall: Vec<_> = (-10..=10).map(|i| Point2::new(3.0, 0.05 * f64::from(i))).collect();
/// let weigh = |x| evidence(&known, Point2::origin(), &wall, Pose2::new(x, 0.0, 0.0), &EvidenceSettings::default());
/// assert_eq!((weigh(0.0).points, weigh(0.0).agreeing), (21, 1.0));
/// // About a metre farther ahead every beam would pass the wall.
/// assert_eq!((weigh(1.02).agreeing, weigh(1.02).through_walls), (0.0, 1.0));
/// ```
#[must_use]
pub fn evidence(
    map: &KnownMap,
    laser: Point2<f64>,
    points: &[Point2<f64>],
    map_from_base: Pose2,
    settings: &EvidenceSettings,
) -> Evidence {
    // Where the robot is, nothing else stands.
    let from = map_from_base.transform_point(laser);
    let is_in_obstacle = map.knows(from) && map.places().field().at(from) == 0.0;
    count(map, laser, points, map_from_base, settings, is_in_obstacle)
}

/// The same for a pose at which the robot may be or not: nothing in its place was taken away.
pub(crate) fn evidence_elsewhere(
    map: &KnownMap,
    laser: Point2<f64>,
    points: &[Point2<f64>],
    map_from_base: Pose2,
    settings: &EvidenceSettings,
) -> Evidence {
    count(map, laser, points, map_from_base, settings, false)
}

/// Counts the beams; `is_in_obstacle`: whether the laser may be where an obstacle was.
fn count(
    map: &KnownMap,
    laser: Point2<f64>,
    points: &[Point2<f64>],
    map_from_base: Pose2,
    settings: &EvidenceSettings,
    is_in_obstacle: bool,
) -> Evidence {
    let from = map_from_base.transform_point(laser);
    let (mut counted, mut agreeing, mut through, mut gone) = (0_usize, 0_usize, 0_usize, 0_usize);
    for point in points {
        let end = map_from_base.transform_point(*point);
        let Some(beam) = beam(map, from, end, settings) else {
            continue;
        };
        counted += 1;
        agreeing += usize::from(beam.ends && !beam.passes);
        through += usize::from(beam.passes);
        gone += usize::from(is_in_obstacle && beam.ends && beam.passes && !passes_another(map, from, end, settings));
    }
    if is_in_obstacle && gone as f64 >= GONE * through as f64 {
        agreeing += gone;
    }
    let share = |count: usize| count as f64 / counted.max(1) as f64;
    Evidence {
        points: counted,
        agreeing: share(agreeing),
        through_walls: share(through),
    }
}

/// A beam in the map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Beam {
    /// Whether it goes through a wall.
    pub(crate) passes: bool,
    /// Whether it ends at one.
    pub(crate) ends: bool,
}

/// A beam from one point of the map to another; `None` if it ends in an unknown cell and passes no wall.
pub(crate) fn beam(map: &KnownMap, from: Point2<f64>, end: Point2<f64>, settings: &EvidenceSettings) -> Option<Beam> {
    let field = map.field();
    let passes = along(map, from, end, settings).any(|at| field.at(at) >= settings.wall);
    let ends = field.at(end) >= settings.explained;
    (passes || ends || map.knows(end)).then_some(Beam { passes, ends })
}

/// Whether a beam that begins in an obstacle goes through a wall behind it, too.
fn passes_another(map: &KnownMap, from: Point2<f64>, end: Point2<f64>, settings: &EvidenceSettings) -> bool {
    let (walls, places) = (map.field(), map.places().field());
    let is_wall = |at: &Point2<f64>| walls.at(*at) >= settings.wall;
    along(map, from, end, settings)
        .skip_while(|at| places.at(*at) == 0.0 || is_wall(at))
        .any(|at| is_wall(&at))
}

/// Points along a beam, one for each cell, without its last stretch.
fn along(
    map: &KnownMap,
    from: Point2<f64>,
    end: Point2<f64>,
    settings: &EvidenceSettings,
) -> impl Iterator<Item = Point2<f64>> {
    let resolution = map.spec().resolution;
    let beam = end - from;
    let length = beam.norm();
    let steps = ((length - settings.own_end) / resolution).floor().max(0.0) as usize;
    let step = beam * (resolution / length.max(f64::MIN_POSITIVE));
    (0..steps).map(move |count| from + step * count as f64)
}

#[cfg(test)]
mod tests {
    use zenav_fixtures::{map_where, spec};

    use super::*;

    #[test]
    fn only_the_obstacle_around_the_laser_was_taken_away_and_only_where_the_robot_is() {
        // From a thin partition at x = 2, all beams end at the wall at x = 5.
        let settings = EvidenceSettings::default();
        let known = |has_second: bool| {
            let map = map_where(spec(120, 80, 0.05), |at| {
                let is_at = |x: f64| (at.x - x).abs() < 0.06;
                is_at(2.0) || is_at(5.0) || has_second && is_at(3.5)
            });
            KnownMap::new(&map, 0.08)
        };
        let (laser, truth) = (Point2::origin(), Pose2::new(2.0, 2.0, 0.0));
        let wall: Vec<_> = (-15..=15).map(|nth| Point2::new(3.0, 0.05 * f64::from(nth))).collect();
        let here = |has_second| evidence(&known(has_second), laser, &wall, truth, &settings).agreeing;
        assert_eq!((here(false), here(true)), (1.0, 0.0));
        let elsewhere = evidence_elsewhere(&known(false), laser, &wall, truth, &settings);
        assert_eq!((elsewhere.agreeing, elsewhere.through_walls), (0.0, 1.0));
    }
}
