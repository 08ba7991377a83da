//! Paths. The result of a search: corner points in cells, from grid, any-angle and sampling planners alike.

use nalgebra::Point2;

use super::grid_graph::GridPath;

/// A path as corner points, in cells of the grid: the centre of cell (0, 0) lies at (0.5, 0.5).
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// The start, the corners in order, and the end.
    pub corners: Vec<Point2<f64>>,
    /// Length of all legs together, cells.
    pub length: f64,
}

impl Path {
    /// A path through points; its length is the sum of its legs.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_planning::Path;
    ///
    /// let path = Path::through([(0.5, 0.5), (3.5, 4.5), (3.5, 6.5)].map(|(x, y)| Point2::new(x, y)).to_vec());
    /// assert_eq!(path.length, 7.0, "cells");
    /// assert!(Path::through(vec![Point2::origin()]).length.is_sign_positive());
    /// ```
    #[must_use]
    pub fn through(corners: Vec<Point2<f64>>) -> Self {
        let length = length(&corners);
        Self { corners, length }
    }
}

impl From<GridPath> for Path {
    fn from(path: GridPath) -> Self {
        // Counted steps are exact; a sum of legs would round.
        let length = path.length();
        let corners = path.corners.iter();
        Self {
            corners: corners.map(|cell| cell.center()).collect(),
            length,
        }
    }
}

/// Length of a polyline, in the unit of its corners.
pub(super) fn length(corners: &[Point2<f64>]) -> f64 {
    let legs = corners.windows(2).map(|leg| (leg[1] - leg[0]).norm());
    // The sum of nothing is -0.
    legs.sum::<f64>() + 0.0
}
