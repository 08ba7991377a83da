//! Grid geometry. Which cell contains a point, and where is a cell?

use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::CellWalk;
use crate::geometry::MAX_COORDINATE;

/// A cell by column and row, counted from the lower-left corner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Cell {
    /// Column, along the map's x axis.
    pub x: u32,
    /// Row, along the map's y axis.
    pub y: u32,
}

impl Cell {
    /// A cell by column and row.
    #[must_use]
    pub const fn new(x: u32, y: u32) -> Self {
        Self { x, y }
    }

    /// Its centre, in cells; [`GridSpec::center`] has it in metres.
    #[inline]
    #[must_use]
    pub fn center(self) -> Point2<f64> {
        Point2::new(f64::from(self.x) + 0.5, f64::from(self.y) + 0.5)
    }
}

/// Geometry of a grid: origin, resolution and size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GridSpec {
    /// Lower-left corner of cell (0, 0), m, map frame.
    #[cfg_attr(feature = "schema", schemars(with = "[f64; 2]"))]
    pub origin: Point2<f64>,
    /// Side of a cell, m.
    pub resolution: f64,
    /// Number of columns, along x.
    pub width: u32,
    /// Number of rows, along y.
    pub height: u32,
}

/// Why a grid was refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum GridError {
    /// The resolution is not a positive finite number.
    #[error("resolution {0} m: expected a positive number")]
    Resolution(f64),
    /// The origin is too far away, or not finite.
    #[error("origin: expected coordinates within {MAX_COORDINATE} m")]
    Origin,
    /// More cells than the stack supports.
    #[error("{width} x {height} cells: expected at most {limit} a side")]
    TooLarge {
        /// Number of columns asked for.
        width: u64,
        /// Number of rows asked for.
        height: u64,
        /// Largest side allowed, cells.
        limit: u32,
    },
    /// The number of values differs from the number of cells.
    #[error("{got} values for {expected} cells")]
    Length {
        /// Number of values given.
        got: usize,
        /// Number of cells of the grid.
        expected: usize,
    },
}

/// Largest side of a grid, cells.
pub const MAX_SIDE: u32 = 32_768;
/// Most cells of a map.
pub const MAX_CELLS: u64 = 1 << 28;

impl GridSpec {
    /// Checks a geometry from an external source.
    ///
    /// # Errors
    /// [`GridError`] for a resolution that is not positive, an origin beyond [`MAX_COORDINATE`], or more than [`MAX_SIDE`] cells a side.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::grid::GridSpec;
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 0.0, width: 10, height: 10 };
    /// assert_eq!(spec.checked().unwrap_err().to_string(), "resolution 0 m: expected a positive number");
    /// ```
    pub fn checked(self) -> Result<Self, GridError> {
        if !(self.resolution.is_finite() && self.resolution > 0.0) {
            return Err(GridError::Resolution(self.resolution));
        }
        if !self.origin.iter().all(|value| value.abs() <= MAX_COORDINATE) {
            return Err(GridError::Origin);
        }
        if self.width > MAX_SIDE || self.height > MAX_SIDE {
            return Err(GridError::TooLarge {
                width: self.width.into(),
                height: self.height.into(),
                limit: MAX_SIDE,
            });
        }
        Ok(self)
    }

    /// Number of cells.
    #[must_use]
    pub fn len(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Whether the grid has no cell.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.width == 0 || self.height == 0
    }

    /// Converts a point (m) to cells: (0, 0) is the lower-left corner of cell (0, 0).
    #[must_use]
    pub fn to_cells(&self, point: Point2<f64>) -> Point2<f64> {
        Point2::new(
            (point.x - self.origin.x) / self.resolution,
            (point.y - self.origin.y) / self.resolution,
        )
    }

    /// Converts a point in cells to metres: the inverse of [`to_cells`](Self::to_cells).
    #[must_use]
    pub fn from_cells(&self, point: Point2<f64>) -> Point2<f64> {
        Point2::new(
            self.origin.x + point.x * self.resolution,
            self.origin.y + point.y * self.resolution,
        )
    }

    /// The cell that contains a point; `None` outside the grid, and for a point that is not finite.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::grid::{Cell, GridSpec};
    ///
    /// // 10 m by 10 m around the map's origin.
    /// let spec = GridSpec { origin: Point2::new(-5.0, -5.0), resolution: 0.05, width: 200, height: 200 };
    /// assert_eq!(spec.cell_at(Point2::new(0.01, -5.0)), Some(Cell::new(100, 0)));
    /// assert!((spec.center(Cell::new(100, 0)) - Point2::new(0.025, -4.975)).norm() < 1e-9);
    /// assert_eq!(spec.cell_at(Point2::new(5.01, 0.0)), None);
    /// ```
    #[must_use]
    pub fn cell_at(&self, point: Point2<f64>) -> Option<Cell> {
        let p = self.to_cells(point);
        let inside = p.x >= 0.0 && p.y >= 0.0 && p.x < f64::from(self.width) && p.y < f64::from(self.height);
        inside.then(|| Cell::new(p.x as u32, p.y as u32))
    }

    /// The cell nearest to a point; `None` only for an empty grid.
    #[must_use]
    pub fn clamped_cell(&self, point: Point2<f64>) -> Option<Cell> {
        if self.is_empty() {
            return None;
        }
        let p = self.to_cells(point);
        // Float to integer casts saturate, and NaN becomes zero.
        Some(Cell::new(
            (p.x.floor() as u32).min(self.width - 1),
            (p.y.floor() as u32).min(self.height - 1),
        ))
    }

    /// Centre of a cell, m.
    #[must_use]
    pub fn center(&self, cell: Cell) -> Point2<f64> {
        Point2::new(
            self.origin.x + (f64::from(cell.x) + 0.5) * self.resolution,
            self.origin.y + (f64::from(cell.y) + 0.5) * self.resolution,
        )
    }

    /// Index of a cell in row-major storage.
    #[must_use]
    pub fn index(&self, cell: Cell) -> usize {
        cell.y as usize * self.width as usize + cell.x as usize
    }

    /// The cell at an index of row-major storage.
    #[must_use]
    pub fn cell(&self, index: usize) -> Cell {
        let width = (self.width as usize).max(1);
        Cell::new((index % width) as u32, (index / width) as u32)
    }

    /// Whether a column and a row, possibly negative, lie in the grid.
    #[must_use]
    pub fn contains(&self, x: i64, y: i64) -> bool {
        x >= 0 && y >= 0 && x < i64::from(self.width) && y < i64::from(self.height)
    }

    /// Upper-right corner of the grid, m.
    #[must_use]
    pub fn upper(&self) -> Point2<f64> {
        Point2::new(
            self.origin.x + f64::from(self.width) * self.resolution,
            self.origin.y + f64::from(self.height) * self.resolution,
        )
    }

    /// Distance of a point from the grid's rectangle, m; zero within it.
    #[must_use]
    pub fn distance(&self, point: Point2<f64>) -> f64 {
        let p = self.to_cells(point);
        let outside = |value: f64, size: u32| (-value).max(value - f64::from(size)).max(0.0);
        outside(p.x, self.width).hypot(outside(p.y, self.height)) * self.resolution
    }

    /// Every cell that a segment touches, in order, including both end cells; the part outside the grid is skipped.
    ///
    /// Where the segment passes exactly through a corner, the two cells beside the corner are visited too, so that a line never passes
    /// between two occupied cells that touch only there. Cost: one step per cell.
    ///
    /// Source: Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::grid::{Cell, GridSpec};
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 1.0, width: 3, height: 3 };
    /// let cells: Vec<Cell> = spec.walk(Point2::new(1.5, 0.5), Point2::new(9.0, 0.5)).collect();
    /// assert_eq!(cells, [Cell::new(1, 0), Cell::new(2, 0)], "the rest is outside the grid");
    /// assert_eq!(spec.walk(Point2::new(0.5, 0.5), Point2::new(1.5, 1.5)).count(), 4, "two of them beside the corner");
    /// ```
    #[must_use]
    pub fn walk(&self, from: Point2<f64>, to: Point2<f64>) -> CellWalk {
        CellWalk::new(self, self.to_cells(from), self.to_cells(to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> GridSpec {
        GridSpec {
            origin: Point2::new(-2.0, 1.0),
            resolution: 0.25,
            width: 40,
            height: 30,
        }
    }

    #[test]
    fn a_grid_that_is_too_far_away_is_refused() {
        let at = |x, y| {
            GridSpec {
                origin: Point2::new(x, y),
                ..spec()
            }
            .checked()
        };
        assert!(at(MAX_COORDINATE, -MAX_COORDINATE).is_ok());
        for (x, y) in [(500_000.0, 0.0), (0.0, -5_400_000.0), (f64::NAN, 0.0)] {
            assert_eq!(at(x, y), Err(GridError::Origin));
        }
    }

    #[test]
    fn a_cell_holds_its_centre_and_its_lower_left_corner() {
        let spec = spec();
        for index in 0..spec.len() {
            let cell = spec.cell(index);
            assert_eq!(spec.cell_at(spec.center(cell)), Some(cell));
            assert_eq!(spec.index(cell), index);
        }
        assert_eq!(spec.cell_at(Point2::new(-2.0, 1.0)), Some(Cell::new(0, 0)));
        assert_eq!(spec.cell_at(spec.upper()), None);
        assert_eq!(spec.cell_at(Point2::new(f64::NAN, 1.0)), None);
        assert_eq!(spec.clamped_cell(Point2::new(1e300, -1e300)), Some(Cell::new(39, 0)));
    }
}
