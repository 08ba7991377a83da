//! Grids. How is the plane divided into cells, and what does each cell hold?
//!
//! The convention for the whole stack:
//!
//! * the origin is the lower-left corner of cell (0, 0), map frame, and the axes are not rotated against the map frame;
//! * storage is row-major, from the lowest row upwards;
//! * the centre of a cell lies at +0.5 cells in both directions;
//! * an occupied cell is a closed square.
//!
//! Image files and Moving AI maps count rows from the top; they are converted when read and written.
//!
//! ```
//! use nalgebra::Point2;
//! use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
//!
//! let spec = GridSpec { origin: Point2::new(-1.0, -1.0), resolution: 0.5, width: 4, height: 4 };
//! let mut map = OccupancyGrid::filled(spec, Occupancy::UNKNOWN);
//! // Everything on the way to (0.9, -0.9) is free.
//! for cell in spec.walk(Point2::new(-0.9, -0.9), Point2::new(0.9, -0.9)) {
//!     map[cell] = Occupancy::FREE;
//! }
//! assert_eq!(spec.cell_at(Point2::new(0.9, -0.9)), Some(Cell::new(3, 0)));
//! assert_eq!(map.at(Point2::new(0.1, -0.9)), Some(&Occupancy::FREE));
//! assert_eq!(map.at(Point2::new(0.1, 0.9)), Some(&Occupancy::UNKNOWN));
//! ```

mod occupancy;
mod spec;
mod values;
mod walk;

pub use occupancy::{Occupancy, OccupancyGrid};
pub use spec::{Cell, GridError, GridSpec, MAX_CELLS, MAX_SIDE};
pub use values::Grid;
pub use walk::CellWalk;
