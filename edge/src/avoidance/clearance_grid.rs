//! Clearance grid. How far is a place from what stands around the robot?

use nalgebra::{Point2, Vector2};

use super::cell_of;

/// Cells a side, and their size, m.
const SIDE: usize = 120;
const CELL: f64 = 0.05;

/// Distances to what stands around the robot.
#[derive(Clone, Debug, Default)]
pub(super) struct ClearanceGrid {
    origin: Point2<f64>,
    /// In cells.
    distances: Vec<f32>,
}

impl ClearanceGrid {
    /// Chamfer distances (Borgefors, "Distance transformations in digital images", CVGIP 1986) around a place to these points, odometry
    /// frame.
    pub(super) fn fill(&mut self, here: Point2<f64>, points: &[Point2<f64>]) {
        self.origin = here - Vector2::repeat(0.5 * SIDE as f64 * CELL);
        self.distances.clear();
        self.distances.resize(SIDE * SIDE, 1e3);
        for point in points {
            if let Some(index) = cell_of(*point, self.origin, CELL, SIDE) {
                self.distances[index] = 0.0;
            }
        }
        let side = SIDE as isize;
        let (straight, diagonal) = (0.955, 1.369);
        let mut pass = |order: &mut dyn Iterator<Item = isize>, shifts: [(isize, f32); 4]| {
            for index in order {
                let (row, column) = (index / side, index % side);
                if row == 0 || row == side - 1 || column == 0 || column == side - 1 {
                    continue;
                }
                let mut least = self.distances[index as usize];
                for (shift, step) in shifts {
                    least = least.min(self.distances[(index + shift) as usize] + step);
                }
                self.distances[index as usize] = least;
            }
        };
        let before = [
            (-1, straight),
            (-side, straight),
            (-side - 1, diagonal),
            (1 - side, diagonal),
        ];
        pass(&mut (0..side * side), before);
        let after = before.map(|(shift, step)| (-shift, step));
        pass(&mut (0..side * side).rev(), after);
    }

    /// Distance of a point from what stands, m, to within a cell.
    pub(super) fn distance(&self, point: Point2<f64>) -> f64 {
        let cells = cell_of(point, self.origin, CELL, SIDE).and_then(|index| self.distances.get(index));
        cells.map_or(1.0, |cells| f64::from(*cells) * CELL)
    }
}
