//! Ends of a search. The free cells at which a search starts and ends.
//!
//! A robot that stands slightly inside its footprint's margin leaves through the nearest free cell; it is refused only if it stands in an
//! obstacle.

use nalgebra::Point2;
use zenav_protocol::grid::Cell;
use zenav_space::{ConfigurationSpace, LineOfSight as _};

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
            self.cell.center()
        }
    }
}

/// The free cell nearest to a point from whose centre a disc of `radius` (m) can move straight to the point over cells that it may enter;
/// at most a few cells away.
pub(super) fn cell_beside(space: &ConfigurationSpace, point: Point2<f64>, radius: f64) -> Option<Cell> {
    reachable(space, point, radius, NEARBY).find(|cell| space.is_permitted_between(space.spec().center(*cell), point))
}

/// The free cell through which a robot leaves its start; the start may be closer to obstacles than a planned path. From a start that the
/// policy for unknown cells permits, the nearest cell is taken to which it permits the straight way, if there is one.
pub(super) fn leaving(space: &ConfigurationSpace, start: Point2<f64>, settings: &LeavingSettings) -> Option<Cell> {
    let nearest = |radius: f64, cells: i64| {
        let is_permitted = |cell: &Cell| space.is_permitted_between(start, space.spec().center(*cell));
        let permitted = space
            .is_permitted(start)
            .then(|| reachable(space, start, radius, cells).find(is_permitted));
        permitted
            .flatten()
            .or_else(|| reachable(space, start, radius, cells).next())
    };
    let radius = space.radius();
    if let Some(cell) = nearest(radius, NEARBY) {
        return Some(cell);
    }
    let clearance = space.clearance(start);
    let tolerance = settings.depth;
    if clearance < space.footprint().inscribed_radius() - tolerance {
        return None;
    }
    let cells = (settings.distance / space.spec().resolution).ceil().clamp(1.0, 64.0) as i64;
    nearest(radius.min(clearance * (1.0 - 1e-9) - 1e-9), cells)
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

#[cfg(test)]
mod tests {
    use zenav_protocol::grid::Occupancy;
    use zenav_protocol::robot::Footprint;
    use zenav_space::UnknownPolicy;

    use super::*;

    #[test]
    fn a_robot_leaves_a_tight_place_past_an_unknown_cell_and_not_through_it() {
        // Cells of 0.1 m and a wall of one row: a disc of 0.16 m fits in the upper part of row 2, but not at the centres of its cells.
        let wall = (0..20).map(|x| (x, 0, Occupancy::OCCUPIED));
        let marks: Vec<_> = wall.chain([(10, 3, Occupancy::UNKNOWN)]).collect();
        let grid = zenav_fixtures::map_with(zenav_fixtures::spec(20, 20, 0.1), &marks);
        let space = ConfigurationSpace::new(&grid, &Footprint::Radius(0.16), UnknownPolicy::Blocked, 0.0);
        let start = space.spec().from_cells(Point2::new(10.5, 2.7));
        assert!(space.clearance(start) > 0.16 && !space.is_free(Cell::new(10, 2)));
        let by = leaving(&space, start, &LeavingSettings::default());
        let leads = |cell: Cell| space.is_permitted_between(start, space.spec().center(cell));
        assert!(by.is_some_and(leads), "{by:?}");
        // The nearest free cells lie behind the unknown one.
        assert!(space.is_free(Cell::new(9, 3)) && !leads(Cell::new(9, 3)) && !leads(Cell::new(11, 3)));
    }
}
