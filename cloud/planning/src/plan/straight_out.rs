//! Straight out. A robot that is not round leaves an obstacle of the map along its own heading, forwards or backwards.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::Cell;
use zenav_protocol::robot::Footprint;
use zenav_space::ConfigurationSpace;

use crate::se2_search::can_stand;

/// Step of the search, in cells.
const STEP: f64 = 0.5;
/// An obstacle's centre may be this much deeper inside the outline on the way than at the start, m.
const DEEPER: f64 = 0.01;

/// The nearest place straight ahead of or behind a robot where its footprint fits again, at most `farthest` m away.
///
/// `None` if the footprint fits at the start, if both directions lead deeper into an obstacle, and for a round robot, which turns on the
/// spot.
pub(super) fn straight_out(space: &ConfigurationSpace, start: Pose2, farthest: f64) -> Option<Point2<f64>> {
    let footprint = space.footprint();
    if matches!(footprint, Footprint::Radius(_)) || can_stand(space, start.position(), Some(start.yaw)) {
        return None;
    }
    let around = around(space, start, footprint.circumscribed_radius() + farthest);
    let step = STEP * space.spec().resolution;
    (1..=(farthest / step) as u32).find_map(|nth| {
        let off = f64::from(nth) * step;
        [off, -off].into_iter().find_map(|off| {
            let place = start.position() + start.heading() * off;
            let ways = || (1..=nth).map(|nth| f64::from(nth) * step * off.signum());
            let is_free = can_stand(space, place, Some(start.yaw))
                && !ways().any(|off| leads_farther_in(footprint, &around, Vector2::new(off, 0.0)));
            is_free.then_some(place)
        })
    })
}

/// Centres of the occupied cells around a robot, base frame, m.
fn around(space: &ConfigurationSpace, start: Pose2, reach: f64) -> Vec<Point2<f64>> {
    let (spec, base_from_map) = (space.spec(), start.inverse());
    let center = spec.to_cells(start.position());
    let cells = reach / spec.resolution;
    let span = |middle: f64| ((middle - cells).floor() as i64, (middle + cells).ceil() as i64);
    let ((left, right), (bottom, top)) = (span(center.x), span(center.y));
    let rows = bottom.clamp(0, spec.height.into()) as u32..top.clamp(0, spec.height.into()) as u32;
    rows.flat_map(|y| {
        let occupied = space.obstacles().set_in_row(y, left, right);
        occupied.map(move |x| base_from_map.transform_point(spec.center(Cell::new(x, y))))
    })
    .collect()
}

/// Whether the footprint, moved by `off` (base frame, m), overlaps an obstacle deeper than at its start.
fn leads_farther_in(footprint: &Footprint, obstacles: &[Point2<f64>], off: Vector2<f64>) -> bool {
    obstacles
        .iter()
        .any(|obstacle| footprint.depth(obstacle - off) > footprint.depth(*obstacle).max(0.0) + DEEPER)
}
