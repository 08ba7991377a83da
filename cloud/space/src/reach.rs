//! Reachability. The free cells connected to a point: a flood fill over four neighbours.

use std::collections::VecDeque;

use nalgebra::Point2;
use zenav_protocol::grid::Cell;

use super::{BitGrid, ConfigurationSpace};

/// Range of the search around a point, cells: a robot may stand slightly inside its own margin.
const NEARBY: i64 = 6;

/// The free cells connected to a point; `None` if no free cell is near it.
///
/// Cost: linear in the cells reached.
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
/// # use zenav_protocol::robot::Footprint;
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy, reach};
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
/// # let mut map = Grid::filled(spec, Occupancy::FREE);
/// // A wall from x = 2.0 m to x = 2.1 m.
/// (0..40).for_each(|y| map[Cell::new(20, y)] = Occupancy::OCCUPIED);
/// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
/// let reached = reach::flood(&space, Point2::new(1.0, 1.0)).unwrap();
/// assert!(reach::is_reached(&space, &reached, Point2::new(1.5, 3.0)));
/// assert!(!reach::is_reached(&space, &reached, Point2::new(3.0, 3.0)));
/// ```
#[must_use]
pub fn flood(space: &ConfigurationSpace, from: Point2<f64>) -> Option<BitGrid> {
    let spec = space.spec();
    let home = spec.cell_at(from)?;
    let around = (-NEARBY..=NEARBY).flat_map(|dy| (-NEARBY..=NEARBY).map(move |dx| (dx, dy)));
    let (_, first) = around
        .filter_map(|(dx, dy)| {
            let (x, y) = (i64::from(home.x) + dx, i64::from(home.y) + dy);
            let cell = spec.contains(x, y).then(|| Cell::new(x as u32, y as u32))?;
            space.is_free(cell).then_some((dx * dx + dy * dy, cell))
        })
        .min()?;
    let mut reached = BitGrid::new(spec.width, spec.height);
    reached.set(first, true);
    let mut edge = VecDeque::from([first]);
    while let Some(cell) = edge.pop_front() {
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let (x, y) = (i64::from(cell.x) + dx, i64::from(cell.y) + dy);
            if !spec.contains(x, y) {
                continue;
            }
            let next = Cell::new(x as u32, y as u32);
            if space.is_free(next) && !reached.get(next) {
                reached.set(next, true);
                edge.push_back(next);
            }
        }
    }
    Some(reached)
}

/// Whether a reached cell lies near a point, with no obstacle between them.
#[must_use]
pub fn is_reached(space: &ConfigurationSpace, reached: &BitGrid, point: Point2<f64>) -> bool {
    let spec = space.spec();
    let Some(home) = spec.cell_at(point) else { return false };
    (-NEARBY..=NEARBY).any(|dy| {
        (-NEARBY..=NEARBY).any(|dx| {
            let (x, y) = (i64::from(home.x) + dx, i64::from(home.y) + dy);
            spec.contains(x, y) && {
                let cell = Cell::new(x as u32, y as u32);
                reached.get(cell) && space.segment_is_free(spec.center(cell), point, 0.0)
            }
        })
    })
}

/// Centre of the reached cell nearest to a point among those that `admit` allows, m.
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
/// # use zenav_protocol::robot::Footprint;
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy, reach};
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
/// # let mut map = Grid::filled(spec, Occupancy::FREE);
/// // A wall from x = 2.0 m to x = 2.1 m; the goal is behind it.
/// (0..40).for_each(|y| map[Cell::new(20, y)] = Occupancy::OCCUPIED);
/// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
/// let reached = reach::flood(&space, Point2::new(1.0, 1.0)).unwrap();
/// let near = reach::nearest(&space, &reached, Point2::new(3.0, 3.05), |_| true).unwrap();
/// assert!((near - Point2::new(1.75, 3.05)).norm() < 1e-9);
/// ```
#[must_use]
pub fn nearest(
    space: &ConfigurationSpace,
    reached: &BitGrid,
    point: Point2<f64>,
    admit: impl Fn(Cell) -> bool,
) -> Option<Point2<f64>> {
    let spec = space.spec();
    let mut best: Option<(f64, Point2<f64>)> = None;
    for y in 0..spec.height {
        for x in reached.set_in_row(y, 0, i64::MAX) {
            let center = spec.center(Cell::new(x, y));
            let distance = (center - point).norm_squared();
            if best.is_none_or(|(least, _)| distance < least) && admit(Cell::new(x, y)) {
                best = Some((distance, center));
            }
        }
    }
    best.map(|(_, center)| center)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::UnknownPolicy;
    use zenav_protocol::robot::Footprint;

    #[test]
    fn a_closed_room_is_not_reached_and_the_nearest_place_is_outside_it() {
        let level = (30..50).flat_map(|x| [(x, 10), (x, 29)]);
        let upright = (10..30).flat_map(|y| [(30, y), (49, y)]);
        let walls: Vec<_> = level.chain(upright).collect();
        let grid = zenav_fixtures::map_with_occupied(zenav_fixtures::spec(60, 40, 0.1), &walls);
        let space = ConfigurationSpace::new(&grid, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
        let reached = flood(&space, Point2::new(1.0, 1.0)).unwrap();
        assert!(is_reached(&space, &reached, Point2::new(5.5, 3.5)));
        assert!(!is_reached(&space, &reached, Point2::new(4.0, 2.0)));
        let near = nearest(&space, &reached, Point2::new(4.0, 2.0), |_| true).unwrap();
        assert!(near.x < 2.8 || near.x > 5.2 || near.y < 0.8 || near.y > 3.2);
        assert!(flood(&space, Point2::new(-1.0, 0.0)).is_none());
    }
}
