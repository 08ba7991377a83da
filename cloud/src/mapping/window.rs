//! Which cells did one scan look at? Bitmaps over the scan's bounding box: beams only set bits there, and the map itself is
//! touched once a scan, run by run.

use std::ops::Range;

/// Bits of the words and rows that one scan can touch. Coordinates are in cells from the window's lower-left corner.
#[derive(Clone, Debug, Default)]
pub(super) struct Window {
    /// First word column of the grid.
    pub(super) first_word: usize,
    /// First row of the grid.
    pub(super) first_row: usize,
    /// Words a row.
    pub(super) stride: usize,
    pub(super) rows: usize,
    cleared: Vec<u64>,
    hits: Vec<u64>,
}

/// Whole part of a fixed-point number.
const FRACTION: u32 = 32;

fn fixed(cells: f64) -> i64 {
    // Saturates for anything unreasonable.
    (cells * f64::from(2.0_f32.powi(FRACTION as i32))) as i64
}

impl Window {
    /// Lays the window over words and rows of the grid, all bits clear.
    pub(super) fn lay(&mut self, words: Range<usize>, rows: Range<usize>) {
        (self.first_word, self.first_row, self.stride, self.rows) = (words.start, rows.start, words.len(), rows.len());
        for bits in [&mut self.cleared, &mut self.hits] {
            bits.clear();
            bits.resize(words.len() * rows.len(), 0);
        }
    }

    /// Bits of cells that beams went through, and of cells that beams ended in, of a row.
    pub(super) fn row(&self, row: usize) -> (&[u64], &[u64]) {
        let range = row * self.stride..(row + 1) * self.stride;
        (&self.cleared[range.clone()], &self.hits[range])
    }

    /// Marks the cell that a beam ended in.
    pub(super) fn hit(&mut self, x: f64, y: f64) {
        let (x, y) = ((x as usize).min(self.stride * 64 - 1), (y as usize).min(self.rows - 1));
        self.hits[y * self.stride + x / 64] |= 1 << (x % 64);
    }

    /// Marks a cell as looked through, whatever else was seen in it.
    pub(super) fn vacate(&mut self, x: usize, y: usize) {
        if x < self.stride * 64 && y < self.rows {
            let bit = 1 << (x % 64);
            self.cleared[y * self.stride + x / 64] |= bit;
            self.hits[y * self.stride + x / 64] &= !bit;
        }
    }

    /// Marks columns `low..=high` of a row, clamped to the window.
    #[inline]
    fn run(&mut self, row: usize, low: i64, high: i64) {
        let last = (self.stride * 64 - 1) as i64;
        let (low, high) = (low.clamp(0, last) as usize, high.clamp(0, last) as usize);
        let bits = &mut self.cleared[row * self.stride..(row + 1) * self.stride];
        let (first, end) = (low / 64, high / 64);
        let (head, tail) = (u64::MAX << (low % 64), u64::MAX >> (63 - high % 64));
        if first == end {
            bits[first] |= head & tail;
        } else {
            bits[first] |= head;
            for word in &mut bits[first + 1..end] {
                *word = u64::MAX;
            }
            bits[end] |= tail;
        }
    }

    /// Marks every cell that a segment touches: the cells of `GridSpec::walk`, found row by row instead of cell by cell.
    /// (Within rounding of a corner the two may differ in the cells beside it.)
    pub(super) fn ray(&mut self, a: (f64, f64), b: (f64, f64)) {
        let ((x0, y0), (x1, y1)) = if a.1 <= b.1 { (a, b) } else { (b, a) };
        let (first, last) = ((y0 as usize).min(self.rows - 1), (y1 as usize).min(self.rows - 1));
        let (start, end) = (fixed(x0), fixed(x1));
        if first == last {
            self.run(first, start.min(end) >> FRACTION, start.max(end) >> FRACTION);
            return;
        }
        let slope = (x1 - x0) / (y1 - y0);
        let mut x = fixed(x0 + ((first + 1) as f64 - y0) * slope);
        self.run(first, start.min(x) >> FRACTION, start.max(x) >> FRACTION);
        let step = fixed(slope);
        if step >= 0 {
            for row in first + 1..last {
                self.run(row, x >> FRACTION, (x + step) >> FRACTION);
                x += step;
            }
        } else {
            for row in first + 1..last {
                self.run(row, (x + step) >> FRACTION, x >> FRACTION);
                x += step;
            }
        }
        self.run(last, x.min(end) >> FRACTION, x.max(end) >> FRACTION);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use proptest::prelude::*;
    use zenav_protocol::grid::{Cell, GridSpec};

    use super::*;

    proptest! {
        #[test]
        fn a_ray_marks_the_cells_of_the_one_ray_walk(ax in 0.0..190.0, ay in 0.0..90.0, bx in 0.0..190.0, by in 0.0..90.0) {
            let spec = GridSpec { origin: Point2::origin(), resolution: 1.0, width: 192, height: 90 };
            let mut window = Window::default();
            window.lay(0..3, 0..90);
            window.ray((ax, ay), (bx, by));
            let mut walked: Vec<Cell> = spec.walk(Point2::new(ax, ay), Point2::new(bx, by)).collect();
            walked.sort_by_key(|cell| spec.index(*cell));
            let marked = (0..90_u32).flat_map(|y| (0..192_u32).map(move |x| Cell::new(x, y)));
            let marked: Vec<Cell> = marked.filter(|cell| window.row(cell.y as usize).0[cell.x as usize / 64] >> (cell.x % 64) & 1 == 1).collect();
            prop_assert_eq!(marked, walked);
        }
    }

    #[test]
    fn rays_that_leave_the_window_stay_in_bounds() {
        let mut window = Window::default();
        window.lay(0..1, 0..2);
        for end in [(1e12, 1e12), (-5.0, 1.0), (f64::NAN, 0.5), (3.0, f64::INFINITY)] {
            window.ray((1.0, 1.0), end);
            window.hit(end.0, end.1);
        }
    }
}
