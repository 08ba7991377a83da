//! What does it cost to be near obstacles? A number for each distance; for drawing and for users of Nav2 those of its inflation layer.

use zenav_protocol::grid::{Cell, Grid};

use super::configuration::{ConfigurationSpace, UnknownPolicy};
use super::distance::DistanceField;

/// A cost that depends on the distance from a cell's centre to the nearest obstacle alone.
#[derive(Clone, Debug)]
pub struct DistanceCost<'a> {
    field: &'a DistanceField,
    /// By squared half cells; the last one stands for everything at least the reach away.
    by_squared: Vec<u8>,
}

impl<'a> DistanceCost<'a> {
    /// `cost` tells the cost of each distance, m. What is at least the field's reach away costs nothing.
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

    /// The cost of being at a cell; that of an obstacle outside the grid.
    #[must_use]
    pub fn at(&self, cell: Cell) -> u8 {
        self.by_squared
            .get(usize::from(self.field.squared(cell)))
            .copied()
            .unwrap_or(0)
    }
}

/// Nothing is known of the cell.
pub const NO_INFORMATION: u8 = 255;
/// An obstacle is in the cell.
pub const LETHAL: u8 = 254;
/// An obstacle is within the footprint's inscribed radius of the cell's centre: the robot collides whatever its heading.
pub const INSCRIBED: u8 = 253;

/// How costs decay, as in Nav2's inflation layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inflation {
    /// How fast, 1/m. Default 10.
    pub cost_scaling_factor: f64,
    /// Nothing costs anything at this distance from obstacles and beyond, m; at most the space's reach. Default 0.55.
    pub inflation_radius: f64,
}

impl Default for Inflation {
    fn default() -> Self {
        Self {
            cost_scaling_factor: 10.0,
            inflation_radius: 0.55,
        }
    }
}

/// A configuration space seen as Nav2's costmap: `252 exp(-factor (distance - inscribed radius))` outside the inscribed radius.
///
/// Distances are exact, to the obstacles' squares; Nav2's are between cell centres, up to half a cell's diagonal more.
#[derive(Clone, Debug)]
pub struct Costmap<'a> {
    space: &'a ConfigurationSpace,
    costs: DistanceCost<'a>,
}

impl<'a> Costmap<'a> {
    /// The costs of a space.
    #[must_use]
    pub fn new(space: &'a ConfigurationSpace, inflation: &Inflation) -> Self {
        let inscribed = space.footprint().inscribed_radius();
        let cost = |distance: f64| {
            if distance <= 0.0 {
                LETHAL
            } else if distance <= inscribed {
                INSCRIBED
            } else if distance < inflation.inflation_radius {
                // Casts saturate, and what is not a number is no cost.
                (252.0 * (-inflation.cost_scaling_factor * (distance - inscribed)).exp()).min(252.0) as u8
            } else {
                0
            }
        };
        Self {
            space,
            costs: DistanceCost::new(space.field(), cost),
        }
    }

    /// The cost of a cell. Unknown cells that the robot's centre stays off have [`NO_INFORMATION`], unless an obstacle is so near that the
    /// robot collides there; outside the grid nothing is known.
    #[must_use]
    pub fn cost(&self, cell: Cell) -> u8 {
        let spec = self.space.spec();
        if cell.x >= spec.width || cell.y >= spec.height {
            return NO_INFORMATION;
        }
        let cost = self.costs.at(cell);
        let unknown = self.space.unknown_policy() == UnknownPolicy::Blocked && self.space.forbidden().get(cell);
        if unknown && cost < INSCRIBED {
            NO_INFORMATION
        } else {
            cost
        }
    }

    /// The costs of all cells.
    #[must_use]
    pub fn grid(&self) -> Grid<u8> {
        let spec = *self.space.spec();
        let mut grid = Grid::filled(spec, 0);
        for y in 0..spec.height {
            for x in 0..spec.width {
                grid[Cell::new(x, y)] = self.cost(Cell::new(x, y));
            }
        }
        grid
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::grid::{GridSpec, Occupancy};
    use zenav_protocol::robot::Footprint;

    use super::*;

    #[test]
    fn costs_decay_from_an_obstacle_as_in_the_inflation_layer() {
        let spec = GridSpec {
            origin: Point2::origin(),
            resolution: 0.05,
            width: 60,
            height: 3,
        };
        let mut map = Grid::filled(spec, Occupancy::FREE);
        map[Cell::new(0, 1)] = Occupancy::OCCUPIED;
        map[Cell::new(2, 1)] = Occupancy::UNKNOWN;
        map[Cell::new(8, 1)] = Occupancy::UNKNOWN;
        let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Blocked, 0.0);
        let inflation = Inflation {
            cost_scaling_factor: 3.0,
            inflation_radius: 0.7,
        };
        let costs = Costmap::new(&space, &inflation).grid();
        let cost = |x| costs[Cell::new(x, 1)];
        // Centres of cells are half a cell further from the obstacle's side than their number says.
        assert_eq!(
            (cost(0), cost(1), cost(2), cost(4)),
            (LETHAL, INSCRIBED, INSCRIBED, INSCRIBED)
        );
        assert_eq!(
            (cost(8), cost(5)),
            (NO_INFORMATION, (252.0 * (-3.0 * 0.025_f64).exp()) as u8)
        );
        assert_eq!(
            (cost(14), cost(15), cost(59)),
            ((252.0 * (-3.0 * 0.475_f64).exp()) as u8, 0, 0)
        );
        assert!(
            (5..14)
                .filter(|x| *x != 8)
                .all(|x| x == 7 || cost(x) > cost(x + 1) || x + 1 == 8)
        );
        let free = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
        let costs = Costmap::new(&free, &inflation);
        assert!(costs.cost(Cell::new(8, 1)) < INSCRIBED);
        assert_eq!(costs.cost(Cell::new(60, 0)), NO_INFORMATION);
    }
}
