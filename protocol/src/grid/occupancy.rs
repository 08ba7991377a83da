//! Occupancy. Is a cell free, occupied or unknown?

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::{Cell, Grid, GridSpec};

/// An occupancy grid with ROS's values: -1 is unknown, 0 to 100 is the occupancy probability, percent.
pub type OccupancyGrid = Grid<i8>;

impl Cell {
    /// The lowest and the highest cell of the box around cells; `None` without any.
    #[must_use]
    pub fn around(cells: impl IntoIterator<Item = Self>) -> Option<[Self; 2]> {
        let grown = |[low, high]: [Self; 2], cell: Self| {
            let low = Self::new(low.x.min(cell.x), low.y.min(cell.y));
            [low, Self::new(high.x.max(cell.x), high.y.max(cell.y))]
        };
        let boxes = cells.into_iter().map(|cell| [cell, cell]);
        boxes.reduce(|found, [cell, _]| grown(found, cell))
    }
}

impl OccupancyGrid {
    /// The box around all known cells, as in [`Cell::around`].
    #[must_use]
    pub fn known(&self) -> Option<[Cell; 2]> {
        let cells = self.values().iter().enumerate();
        let known = cells.filter(|(_, value)| Occupancy::of(**value) != Occupancy::Unknown);
        Cell::around(known.map(|(index, _)| self.spec().cell(index)))
    }

    /// A part of the grid, from its lowest to its highest cell, in cells `scale` times as large: occupied if any cell in them is, else free
    /// if any is.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 0.5, width: 4, height: 2 };
    /// let mut grid = OccupancyGrid::filled(spec, Occupancy::FREE);
    /// grid[Cell::new(3, 1)] = Occupancy::OCCUPIED;
    /// let coarse = grid.coarse([Cell::new(0, 0), Cell::new(3, 1)], 2);
    /// assert_eq!(coarse.values(), [Occupancy::Free, Occupancy::Occupied]);
    /// ```
    #[must_use]
    pub fn coarse(&self, [low, high]: [Cell; 2], scale: u32) -> Grid<Occupancy> {
        let from = self.spec();
        let side = |low: u32, high: u32| (high - low + 1).div_ceil(scale);
        let spec = GridSpec {
            origin: from.from_cells(Point2::new(low.x.into(), low.y.into())),
            resolution: from.resolution * f64::from(scale),
            width: side(low.x, high.x),
            height: side(low.y, high.y),
        };
        let mut coarse = Grid::filled(spec, Occupancy::Unknown);
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let seen = self.get(Cell::new(x, y)).map(|value| Occupancy::of(*value));
                let most = &mut coarse[Cell::new((x - low.x) / scale, (y - low.y) / scale)];
                *most = seen.map_or(*most, |seen| seen.max(*most));
            }
        }
        coarse
    }
}

/// Class of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Occupancy {
    /// The state of the cell is unknown: never seen, or contradictory evidence.
    Unknown,
    /// The cell is free.
    Free,
    /// The cell is occupied.
    Occupied,
}

impl Occupancy {
    /// Value of a cell that was never seen.
    pub const UNKNOWN: i8 = -1;
    /// Value of a cell that is certainly free.
    pub const FREE: i8 = 0;
    /// Value of a cell that is certainly occupied.
    pub const OCCUPIED: i8 = 100;
    /// A cell is occupied from this percentage on (`map_server`'s `occupied_thresh` 0.65).
    pub const OCCUPIED_FROM: i8 = 65;
    /// A cell is free below this percentage (`map_server`'s `free_thresh` 0.196, rounded up).
    pub const FREE_BELOW: i8 = 20;

    /// Classifies an occupancy value.
    ///
    /// ```
    /// use zenav_protocol::grid::Occupancy;
    ///
    /// assert_eq!([-1, 10, 50, 90].map(Occupancy::of), [Occupancy::Unknown, Occupancy::Free, Occupancy::Unknown, Occupancy::Occupied]);
    /// ```
    #[must_use]
    pub const fn of(value: i8) -> Self {
        if value >= Self::OCCUPIED_FROM {
            Self::Occupied
        } else if value >= 0 && value < Self::FREE_BELOW {
            Self::Free
        } else {
            Self::Unknown
        }
    }
}
