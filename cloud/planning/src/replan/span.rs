//! Changed cells. Cells of one row with the margin around them in which the change matters, and their distance to a path.

use nalgebra::Point2;
use zenav_protocol::grid::Cell;

use crate::grid_graph::octile;
use crate::node_table::Written;

/// Cells of a row, and all cells within a margin of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub columns: [u32; 2],
    pub row: u32,
    pub margin: u32,
}

impl Span {
    /// Columns and rows between a cell and the nearest cell of the span.
    pub fn gaps(&self, cell: Cell) -> [u32; 2] {
        let x = self.columns[0]
            .saturating_sub(cell.x)
            .max(cell.x.saturating_sub(self.columns[1]));
        [x, cell.y.abs_diff(self.row)].map(|gap| gap.saturating_sub(self.margin))
    }

    /// Least cost between a cell and the span.
    pub fn distance(&self, cell: Cell) -> u32 {
        let [x, y] = self.gaps(cell);
        octile(Cell::new(0, 0), Cell::new(x, y))
    }

    /// Least distance between a point and the squares of the span, in cells.
    pub fn length(&self, p: Point2<f64>) -> f64 {
        let [x, y] = self
            .gaps(Cell::new(p.x as u32, p.y as u32))
            .map(|gap| f64::from(gap.saturating_sub(1)));
        x.hypot(y)
    }

    /// Whether a search may have reached a cell of the span or one beside it.
    pub fn touches(&self, reached: &Written, pitch: u32) -> bool {
        let around = self.margin + 1;
        let rows = self.row.saturating_sub(around)..=self.row + around;
        let columns = [self.columns[0].saturating_sub(around), self.columns[1] + around];
        // Rows and columns are shifted by the graph's border.
        rows.into_iter().any(|row| {
            let [first, last] = columns.map(|column| (row + 1) * pitch + (column + 1).min(pitch - 1));
            reached.any(first, last)
        })
    }
}
