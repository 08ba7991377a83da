//! How is the plane cut into cells?
//!
//! The convention, stated once: the origin is the lower-left corner of cell (0, 0) in the map frame, storage is
//! row-major from the lowest row upwards, a cell's centre lies at +0.5, and axes are not rotated against the map frame.
//! An occupied cell is a closed square. Image files and Moving AI maps count rows from the top: they are converted
//! where they are read and written.

use std::ops::{Index, IndexMut};

use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A cell by column and row, counted from the lower-left corner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
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
}

/// Where a grid lies and how fine it is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GridSpec {
    /// Lower-left corner of cell (0, 0), m, map frame.
    pub origin: Point2<f64>,
    /// Side of a cell, m.
    pub resolution: f64,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Why a grid's description was refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum GridError {
    /// The resolution is not a positive finite number.
    #[error("resolution {0} m: expected a positive number")]
    Resolution(f64),
    /// The origin is not finite.
    #[error("origin is not finite")]
    Origin,
    /// More cells than the stack handles.
    #[error("{width} x {height} cells: expected at most {limit} a side")]
    TooLarge {
        /// Columns asked for.
        width: u64,
        /// Rows asked for.
        height: u64,
        /// Largest side.
        limit: u32,
    },
    /// The data does not fill the grid.
    #[error("{got} values for {expected} cells")]
    Length {
        /// Values given.
        got: usize,
        /// Cells of the grid.
        expected: usize,
    },
}

/// Largest side of a grid, cells.
pub const MAX_SIDE: u32 = 32_768;
/// Most cells of a map.
pub const MAX_CELLS: u64 = 1 << 28;

impl GridSpec {
    /// Checks a description.
    ///
    /// # Errors
    /// [`GridError`] for a resolution that is not positive, an origin that is not finite, or more than [`MAX_SIDE`] cells a side.
    pub fn checked(self) -> Result<Self, GridError> {
        if !(self.resolution.is_finite() && self.resolution > 0.0) {
            return Err(GridError::Resolution(self.resolution));
        }
        if !(self.origin.x.is_finite() && self.origin.y.is_finite()) {
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

    /// Whether there is no cell at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.width == 0 || self.height == 0
    }

    /// A point in units of cells: (0, 0) is the lower-left corner of cell (0, 0).
    #[must_use]
    pub fn to_cells(&self, point: Point2<f64>) -> Point2<f64> {
        Point2::new(
            (point.x - self.origin.x) / self.resolution,
            (point.y - self.origin.y) / self.resolution,
        )
    }

    /// A point in cells, in the grid's frame: undoes [`to_cells`](Self::to_cells).
    #[must_use]
    pub fn from_cells(&self, point: Point2<f64>) -> Point2<f64> {
        Point2::new(
            self.origin.x + point.x * self.resolution,
            self.origin.y + point.y * self.resolution,
        )
    }

    /// The cell that holds a point; `None` outside the grid or for a non-finite point.
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

    /// The centre of a cell, m.
    #[must_use]
    pub fn center(&self, cell: Cell) -> Point2<f64> {
        Point2::new(
            self.origin.x + (f64::from(cell.x) + 0.5) * self.resolution,
            self.origin.y + (f64::from(cell.y) + 0.5) * self.resolution,
        )
    }

    /// Position of a cell in row-major storage.
    #[must_use]
    pub fn index(&self, cell: Cell) -> usize {
        cell.y as usize * self.width as usize + cell.x as usize
    }

    /// The cell at a position of row-major storage.
    #[must_use]
    pub fn cell(&self, index: usize) -> Cell {
        let width = (self.width as usize).max(1);
        Cell::new((index % width) as u32, (index / width) as u32)
    }

    /// Whether signed cell coordinates lie inside.
    #[must_use]
    pub fn contains(&self, x: i64, y: i64) -> bool {
        x >= 0 && y >= 0 && x < i64::from(self.width) && y < i64::from(self.height)
    }

    /// Upper-right corner, m.
    #[must_use]
    pub fn upper(&self) -> Point2<f64> {
        Point2::new(
            self.origin.x + f64::from(self.width) * self.resolution,
            self.origin.y + f64::from(self.height) * self.resolution,
        )
    }

    /// Every cell that a segment touches, in order, both ends included; parts outside the grid are left out.
    ///
    /// Where the segment passes exactly through a corner, the two cells beside the corner are visited too, so that a
    /// line never slips between two occupied cells that touch only there. Cost: one step a cell.
    ///
    /// Source: Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987.
    #[must_use]
    pub fn walk(&self, from: Point2<f64>, to: Point2<f64>) -> CellWalk {
        CellWalk::new(self, self.to_cells(from), self.to_cells(to))
    }
}

/// Iterator of [`GridSpec::walk`].
#[derive(Clone, Debug)]
pub struct CellWalk {
    width: i64,
    height: i64,
    x: i64,
    y: i64,
    last_x: i64,
    last_y: i64,
    step_x: i64,
    step_y: i64,
    next_x: f64,
    next_y: f64,
    delta_x: f64,
    delta_y: f64,
    steps_left: i64,
    /// Cells still to be given: beside a corner, and the one reached.
    waiting: [Option<(i64, i64)>; 3],
}

impl CellWalk {
    fn new(spec: &GridSpec, from: Point2<f64>, to: Point2<f64>) -> Self {
        let (width, height) = (i64::from(spec.width), i64::from(spec.height));
        let empty = Self {
            width,
            height,
            x: 0,
            y: 0,
            last_x: 0,
            last_y: 0,
            step_x: 0,
            step_y: 0,
            next_x: f64::INFINITY,
            next_y: f64::INFINITY,
            delta_x: f64::INFINITY,
            delta_y: f64::INFINITY,
            steps_left: -1,
            waiting: [None; 3],
        };
        // Clipped a cell beyond the border: bounded work whatever comes in, and the cells inside stay exact.
        let Some((from, to)) = clip(from, to, -1.0, -1.0, width as f64 + 1.0, height as f64 + 1.0) else {
            return empty;
        };
        let (x, y) = (from.x.floor() as i64, from.y.floor() as i64);
        let (last_x, last_y) = (to.x.floor() as i64, to.y.floor() as i64);
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let axis = |start: f64, cell: i64, d: f64| {
            if d > 0.0 {
                (1, ((cell + 1) as f64 - start) / d, 1.0 / d)
            } else if d < 0.0 {
                (-1, (start - cell as f64) / -d, -1.0 / d)
            } else {
                (0, f64::INFINITY, f64::INFINITY)
            }
        };
        let (step_x, next_x, delta_x) = axis(from.x, x, dx);
        let (step_y, next_y, delta_y) = axis(from.y, y, dy);
        Self {
            x,
            y,
            last_x,
            last_y,
            step_x,
            step_y,
            next_x,
            next_y,
            delta_x,
            delta_y,
            steps_left: (last_x - x).abs() + (last_y - y).abs(),
            waiting: [None, None, Some((x, y))],
            ..empty
        }
    }

    fn inside(&self, x: i64, y: i64) -> Option<Cell> {
        (x >= 0 && y >= 0 && x < self.width && y < self.height).then(|| Cell::new(x as u32, y as u32))
    }
}

impl Iterator for CellWalk {
    type Item = Cell;

    fn next(&mut self) -> Option<Cell> {
        loop {
            if let Some((x, y)) = self.waiting.iter_mut().find_map(Option::take) {
                if let Some(cell) = self.inside(x, y) {
                    return Some(cell);
                }
                continue;
            }
            if self.steps_left <= 0 {
                return None;
            }
            let (x_left, y_left) = (self.x != self.last_x, self.y != self.last_y);
            let corner = x_left && y_left && (self.next_x - self.next_y).abs() < 1e-12;
            // Rounding may ask for a step past the last column or row: the end cell always wins.
            let along_x = x_left && (self.next_x < self.next_y || !y_left);
            if corner {
                self.waiting[0] = Some((self.x + self.step_x, self.y));
                self.waiting[1] = Some((self.x, self.y + self.step_y));
            }
            if corner || along_x {
                self.x += self.step_x;
                self.next_x += self.delta_x;
                self.steps_left -= 1;
            }
            if corner || !along_x {
                self.y += self.step_y;
                self.next_y += self.delta_y;
                self.steps_left -= 1;
            }
            self.waiting[2] = Some((self.x, self.y));
        }
    }
}

/// Clips a segment to a rectangle (Liang and Barsky 1984); `None` when nothing is left or a number is not finite.
fn clip(
    from: Point2<f64>,
    to: Point2<f64>,
    low_x: f64,
    low_y: f64,
    high_x: f64,
    high_y: f64,
) -> Option<(Point2<f64>, Point2<f64>)> {
    let d = to - from;
    if !(from.x.is_finite() && from.y.is_finite() && d.x.is_finite() && d.y.is_finite()) {
        return None;
    }
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for (p, q) in [
        (-d.x, from.x - low_x),
        (d.x, high_x - from.x),
        (-d.y, from.y - low_y),
        (d.y, high_y - from.y),
    ] {
        if p == 0.0 {
            if q < 0.0 {
                return None;
            }
        } else if p < 0.0 {
            enter = enter.max(q / p);
        } else {
            leave = leave.min(q / p);
        }
    }
    if enter > leave {
        return None;
    }
    // Clamped: far away points lose all their digits on the way to the border.
    let inside = |p: Point2<f64>| Point2::new(p.x.clamp(low_x, high_x), p.y.clamp(low_y, high_y));
    let start = inside(if enter > 0.0 { from + d * enter } else { from });
    let end = inside(if leave < 1.0 { from + d * leave } else { to });
    Some((start, end))
}

/// Values on a grid, row-major from the lowest row upwards.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid<T> {
    spec: GridSpec,
    values: Vec<T>,
}

impl<T: Clone> Grid<T> {
    /// A grid filled with one value.
    #[must_use]
    pub fn filled(spec: GridSpec, value: T) -> Self {
        Self {
            spec,
            values: vec![value; spec.len()],
        }
    }
}

impl<T> Grid<T> {
    /// A grid of given values.
    ///
    /// # Errors
    /// [`GridError::Length`] unless there is one value a cell.
    pub fn from_values(spec: GridSpec, values: Vec<T>) -> Result<Self, GridError> {
        if values.len() == spec.len() {
            Ok(Self { spec, values })
        } else {
            Err(GridError::Length {
                got: values.len(),
                expected: spec.len(),
            })
        }
    }

    /// Where the grid lies.
    #[must_use]
    pub fn spec(&self) -> &GridSpec {
        &self.spec
    }

    /// All values, row by row from the lowest.
    #[must_use]
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// All values, row by row from the lowest, without a copy.
    #[must_use]
    pub fn into_values(self) -> Vec<T> {
        self.values
    }

    /// All values, row by row from the lowest.
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// The value at a point; `None` outside.
    #[must_use]
    pub fn at(&self, point: Point2<f64>) -> Option<&T> {
        self.spec.cell_at(point).map(|cell| &self[cell])
    }

    /// The value of a cell; `None` outside.
    #[must_use]
    pub fn get(&self, cell: Cell) -> Option<&T> {
        (cell.x < self.spec.width && cell.y < self.spec.height).then(|| &self.values[self.spec.index(cell)])
    }

    /// The same grid with every value changed.
    pub fn map<U>(&self, change: impl FnMut(&T) -> U) -> Grid<U> {
        Grid {
            spec: self.spec,
            values: self.values.iter().map(change).collect(),
        }
    }
}

impl<T> Index<Cell> for Grid<T> {
    type Output = T;
    /// # Panics
    /// Outside the grid: use [`Grid::get`] for a cell that came from elsewhere.
    fn index(&self, cell: Cell) -> &T {
        &self.values[self.spec.index(cell)]
    }
}

impl<T> IndexMut<Cell> for Grid<T> {
    fn index_mut(&mut self, cell: Cell) -> &mut T {
        let index = self.spec.index(cell);
        &mut self.values[index]
    }
}

/// An occupancy grid with ROS's values: -1 unknown, else the probability of being occupied in percent.
pub type OccupancyGrid = Grid<i8>;

/// What an occupancy value says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Occupancy {
    /// Never seen, or seen as often full as empty.
    Unknown,
    /// Seen to be empty.
    Free,
    /// Seen to be full.
    Occupied,
}

impl Occupancy {
    /// The value of a cell that nobody has seen.
    pub const UNKNOWN: i8 = -1;
    /// The value of a surely free cell.
    pub const FREE: i8 = 0;
    /// The value of a surely occupied cell.
    pub const OCCUPIED: i8 = 100;
    /// From this percentage on a cell is occupied (`map_server`'s `occupied_thresh` 0.65).
    pub const OCCUPIED_FROM: i8 = 65;
    /// Below this percentage a cell is free (`map_server`'s `free_thresh` 0.196, rounded up).
    pub const FREE_BELOW: i8 = 20;

    /// Reads an occupancy value.
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn spec() -> GridSpec {
        GridSpec {
            origin: Point2::new(-2.0, 1.0),
            resolution: 0.25,
            width: 40,
            height: 30,
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

    #[test]
    fn a_line_through_a_corner_visits_both_cells_beside_it() {
        let spec = GridSpec {
            origin: Point2::origin(),
            resolution: 1.0,
            width: 3,
            height: 3,
        };
        let cells: Vec<Cell> = spec.walk(Point2::new(0.5, 0.5), Point2::new(1.5, 1.5)).collect();
        assert_eq!(
            cells,
            vec![Cell::new(0, 0), Cell::new(1, 0), Cell::new(0, 1), Cell::new(1, 1)]
        );
    }

    proptest! {
        #[test]
        fn the_walk_visits_every_cell_that_samples_of_the_segment_lie_in(ax in -4.0..10.0, ay in -1.0..10.0, bx in -4.0..10.0, by in -1.0..10.0) {
            let spec = spec();
            let (a, b) = (Point2::new(ax, ay), Point2::new(bx, by));
            let cells: Vec<Cell> = spec.walk(a, b).collect();
            for i in 0..=500 {
                let p = a + (b - a) * (f64::from(i) / 500.0);
                let in_cells = spec.to_cells(p);
                // Samples within rounding of an edge may fall to either side.
                let near_edge = (in_cells.x - in_cells.x.round()).abs() < 1e-6 || (in_cells.y - in_cells.y.round()).abs() < 1e-6;
                if let (Some(cell), false) = (spec.cell_at(p), near_edge) {
                    prop_assert!(cells.contains(&cell), "{cell:?} at {p}");
                }
            }
            prop_assert!(cells.len() <= 40 + 30 + 80);
        }

        #[test]
        fn the_walk_is_bounded_for_any_numbers(ax in any::<f64>(), ay in any::<f64>(), bx in any::<f64>(), by in any::<f64>()) {
            prop_assert!(spec().walk(Point2::new(ax, ay), Point2::new(bx, by)).count() <= 200);
        }
    }
}
