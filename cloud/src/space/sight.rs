//! Can one go straight from here to there? What any-angle and sampling planners ask, in cells of a grid.

use nalgebra::Point2;
use zenav_protocol::grid::Cell;

use super::bits::BitGrid;
use super::configuration::ConfigurationSpace;

/// A space in which straight ways are checked exactly. All coordinates are in cells: the centre of cell (0, 0) lies at (0.5, 0.5).
pub trait Sight {
    /// Columns and rows.
    fn size(&self) -> [u32; 2];

    /// Whether one may be at a point; `false` outside the grid and for points that are not finite.
    fn admits(&self, p: Point2<f64>) -> bool;

    /// Whether one may go straight from `a` to `b`: no blocked square is touched, however small the corner.
    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool;
}

/// A point among free cells; all others are closed squares.
impl Sight for BitGrid {
    fn size(&self) -> [u32; 2] {
        [self.width(), self.height()]
    }

    fn admits(&self, p: Point2<f64>) -> bool {
        p.x >= 0.0 && p.y >= 0.0 && self.get(Cell::new(p.x as u32, p.y as u32))
    }

    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool {
        let (from, to) = (Cell::new(a.x as u32, a.y as u32), Cell::new(b.x as u32, b.y as u32));
        self.admits(a) && self.admits(b) && from == to
    }
}

/// The inscribed disc of a robot.
impl Sight for ConfigurationSpace {
    fn size(&self) -> [u32; 2] {
        [self.spec().width, self.spec().height]
    }

    fn admits(&self, p: Point2<f64>) -> bool {
        self.sees(p, p)
    }

    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool {
        let [a, b] = [a, b].map(|p| self.spec().from_cells(p));
        self.is_permitted(a) && self.is_permitted(b) && self.segment_is_free(a, b, self.radius())
    }
}
