//! Occupancy. Is a cell free, occupied or unknown?

use serde::{Deserialize, Serialize};

use super::Grid;

/// An occupancy grid with ROS's values: -1 is unknown, 0 to 100 is the occupancy probability, percent.
pub type OccupancyGrid = Grid<i8>;

/// Class of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
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
