//! Grid. What is the value of each cell?

use std::ops::{Index, IndexMut};

use nalgebra::Point2;

use super::{Cell, GridError, GridSpec};

/// One value per cell of a grid, row-major from the lowest row upwards.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid<T> {
    spec: GridSpec,
    values: Vec<T>,
}

impl<T: Clone> Grid<T> {
    /// A grid with one value in all cells.
    #[must_use]
    pub fn filled(spec: GridSpec, value: T) -> Self {
        Self {
            spec,
            values: vec![value; spec.len()],
        }
    }
}

impl<T> Grid<T> {
    /// A grid of the given values.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 2, height: 2 };
    /// let map = OccupancyGrid::from_values(spec, vec![0, 0, 100, -1])?;
    /// assert_eq!(map.at(Point2::new(0.05, 0.15)), Some(&Occupancy::OCCUPIED), "the third value begins the second row");
    /// let error = OccupancyGrid::from_values(spec, vec![0; 3]).unwrap_err();
    /// assert_eq!(error.to_string(), "3 values for 4 cells");
    /// # Ok::<(), zenav_protocol::grid::GridError>(())
    /// ```
    ///
    /// # Errors
    /// [`GridError::Length`] unless there is exactly one value for each cell.
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

    /// Geometry of the grid.
    #[must_use]
    pub fn spec(&self) -> &GridSpec {
        &self.spec
    }

    /// All values, row by row from the lowest.
    #[must_use]
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// All values, row by row from the lowest, moved out of the grid.
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

    /// A grid of the same geometry with values computed from this one's.
    pub fn map<U>(&self, change: impl FnMut(&T) -> U) -> Grid<U> {
        Grid {
            spec: self.spec,
            values: self.values.iter().map(change).collect(),
        }
    }
}

impl<T> Index<Cell> for Grid<T> {
    type Output = T;
    /// The value of a cell.
    ///
    /// # Panics
    /// For a cell outside the grid: use [`Grid::get`] for a cell from an external source.
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
