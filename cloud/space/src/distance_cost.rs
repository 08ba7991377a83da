//! Distance costs. The cost of a cell by its distance to the nearest obstacle.

use zenav_protocol::grid::Cell;

use super::distance::DistanceField;

/// A cost that depends only on the distance from a cell's centre to the nearest obstacle.
#[derive(Clone, Debug)]
pub struct DistanceCost<'a> {
    field: &'a DistanceField,
    /// Indexed by squared half cells; the last entry stands for everything at least the reach away.
    by_squared: Vec<u8>,
}

impl<'a> DistanceCost<'a> {
    /// `cost` gives the cost of each distance, m. Distances of at least the field's reach cost nothing.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::grid::{Cell, GridSpec};
    /// use zenav_space::{BitGrid, DistanceCost, DistanceField};
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 30, height: 30 };
    /// let field = DistanceField::new(spec, &BitGrid::from_fn(30, 30, |cell| cell.x == 0), 10);
    /// let costs = DistanceCost::new(&field, |distance| if distance < 0.3 { 200 } else { 10 });
    /// assert_eq!([3, 5, 29].map(|x| costs.at(Cell::new(x, 15))), [200, 10, 0]);
    /// ```
    #[must_use]
    pub fn new(field: &'a DistanceField, cost: impl Fn(f64) -> u8) -> Self {
        let far = 4 * field.reach_cells().pow(2);
        let cell = field.reach() / f64::from(field.reach_cells());
        let mut by_squared: Vec<u8> = (0..far)
            .map(|squared| cost(0.5 * f64::from(squared).sqrt() * cell))
            .collect();
        by_squared.push(0);
        Self { field, by_squared }
    }

    /// The cost of being at a cell; outside the grid, the cost of being at an obstacle.
    #[must_use]
    pub fn at(&self, cell: Cell) -> u8 {
        self.by_squared
            .get(usize::from(self.field.squared(cell)))
            .copied()
            .unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BitGrid;

    #[test]
    fn a_cell_costs_what_its_exact_distance_to_the_obstacle_costs() {
        let obstacles = BitGrid::from_fn(12, 1, |cell| cell.x == 0);
        let field = DistanceField::new(zenav_fixtures::spec(12, 1, 0.5), &obstacles, 8);
        let costs = DistanceCost::new(&field, |metres| (100.0 - 10.0 * metres) as u8);
        let at = |x| costs.at(Cell::new(x, 0));
        // A cell's centre is half a cell nearer to the obstacle's face than its number of cells.
        assert_eq!((at(0), at(1), at(5)), (100, 97, 77));
        assert_eq!((at(9), at(11)), (0, 0), "beyond the reach of the field");
        assert_eq!(costs.at(Cell::new(0, 1)), 100, "outside the grid");
    }
}
