//! Ends of a search. The free cells at which a search starts and ends.
//!
//! A robot that stands slightly inside its footprint's margin leaves through the nearest free cell; it is refused only if it stands in an
//! obstacle.

use nalgebra::Point2;
use zenav_protocol::grid::Cell;
use zenav_space::{ConfigurationSpace, LineOfSight as _};

use super::path::center;
use super::planners::Planner;
use super::settings::LeavingSettings;

/// Range of the search around a point that is not at a free cell's centre, cells in each direction.
const NEARBY: i64 = 3;

/// Start or end of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct End {
    /// The point that was asked for, in cells.
    pub(super) point: Point2<f64>,
    /// The free cell at or close to it.
    pub(super) cell: Cell,
}

impl End {
    /// The point that a planner uses: the requested point if the planner is not bound to cells and the robot fits there, else the cell's
    /// centre.
    pub(super) fn of(&self, space: &ConfigurationSpace, planner: Planner) -> Point2<f64> {
        if planner.grows_trees() && space.admits(self.point) {
            self.point
        } else {
            center(self.cell)
        }
    }
}

/// The free cell nearest to a point from whose centre a disc of `radius` (m) can move straight to the point over cells that it may enter;
/// at most a few cells away.
pub(super) fn cell_beside(space: &ConfigurationSpace, point: Point2<f64>, radius: f64) -> Option<Cell> {
    reachable(space, point, radius, NEARBY).find(|cell| space.is_permitted_between(space.spec().center(*cell), point))
}

/// The free cell through which a robot leaves its start; the start may be closer to obstacles than a planned path.
pub(super) fn leaving(space: &ConfigurationSpace, start: Point2<f64>, settings: &LeavingSettings) -> Option<Cell> {
    let radius = space.radius();
    if let Some(cell) = reachable(space, start, radius, NEARBY).next() {
        return Some(cell);
    }
    let clearance = space.clearance(start);
    let tolerance = settings.depth;
    if clearance < space.footprint().inscribed_radius() - tolerance {
        return None;
    }
    let cells = (settings.distance / space.spec().resolution).ceil().clamp(1.0, 64.0) as i64;
    reachable(space, start, radius.min(clearance * (1.0 - 1e-9) - 1e-9), cells).next()
}

/// The free cells around a point, nearest first, from whose centres a disc of `radius` (m) can move straight to it.
fn reachable(space: &ConfigurationSpace, point: Point2<f64>, radius: f64, cells: i64) -> impl Iterator<Item = Cell> {
    let spec = space.spec();
    let around = |home: Cell| {
        let rows = (-cells..=cells).map(move |dy| i64::from(home.y) + dy);
        rows.flat_map(move |y| (-cells..=cells).map(move |dx| (i64::from(home.x) + dx, y)))
    };
    let mut free: Vec<(f64, Cell)> = spec
        .cell_at(point)
        .into_iter()
        .flat_map(around)
        .filter(|(x, y)| spec.contains(*x, *y))
        .map(|(x, y)| Cell::new(x as u32, y as u32))
        .filter(|cell| space.is_free(*cell))
        .map(|cell| ((spec.center(cell) - point).norm_squared(), cell))
        .collect();
    free.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    free.into_iter()
        .map(|(_, cell)| cell)
        .filter(move |cell| space.segment_is_free(point, spec.center(*cell), radius))
}
