//! Which cells did one scan look at? Bitmaps over the scan's bounding box: beams only set bits there, and the map itself is
//! touched once a scan, run by run.

use std::ops::Range;

use super::beams::Beam;

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
    /// Borders of filled wedges: bits that flip inside and outside along a row.
    flips: Vec<u64>,
    rays: Vec<Ray>,
}

/// A beam to be drawn, in cells of the window.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    end: (f64, f64),
    /// A step of one cell along the ray.
    step: (f64, f64),
    length: f64,
    /// Position in the sweep.
    number: usize,
    /// Whether the beam met something at its end.
    hit: bool,
}

impl Ray {
    pub(super) fn new(origin: (f64, f64), end: (f64, f64), beam: &Beam) -> Self {
        let (x, y) = (end.0 - origin.0, end.1 - origin.1);
        let length = (x * x + y * y).sqrt();
        let per_cell = if length > 0.0 { 1.0 / length } else { 0.0 };
        Self {
            end,
            step: (x * per_cell, y * per_cell),
            length,
            number: beam.number,
            hit: beam.hit,
        }
    }

    /// The point at a distance from the origin.
    fn at(&self, origin: (f64, f64), distance: f64) -> (f64, f64) {
        (origin.0 + self.step.0 * distance, origin.1 + self.step.1 * distance)
    }
}

/// Whole part of a fixed-point number.
const FRACTION: u32 = 32;

/// The cell that a coordinate lies in; the first one for negative numbers and what is not a number.
fn whole(at: f64) -> usize {
    // Through a signed number: half as long on most processors.
    (at as i32).max(0) as usize
}

/// Steps of a filled border that are not worth an edge of their own, cells.
const SMALL_STEP: f64 = 0.25;

/// A cell that a ray meets has its centre at most so far along the ray from there, cells.
const HALF_DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;

fn fixed(cells: f64) -> i64 {
    // Saturates for anything unreasonable.
    (cells * f64::from(2.0_f32.powi(FRACTION as i32))) as i64
}

impl Window {
    /// Lays the window over words and rows of the grid, all bits clear.
    pub(super) fn lay(&mut self, words: Range<usize>, rows: Range<usize>) {
        (self.first_word, self.first_row, self.stride, self.rows) = (words.start, rows.start, words.len(), rows.len());
        for bits in [&mut self.cleared, &mut self.hits, &mut self.flips] {
            bits.clear();
            bits.resize(words.len() * rows.len(), 0);
        }
    }

    /// Bits of cells that beams went through, and of cells that beams ended in, of a row.
    pub(super) fn row(&self, row: usize) -> (&[u64], &[u64]) {
        let range = row * self.stride..(row + 1) * self.stride;
        (&self.cleared[range.clone()], &self.hits[range])
    }

    /// Marks what all rays of a scan went through and ended in: ray by ray, or with wedges filled as long as neighbouring
    /// rays are at most a cell apart, which they are up to `dense` cells from the origin.
    pub(super) fn draw(&mut self, origin: (f64, f64), rays: impl Iterator<Item = Ray>, dense: Option<f64>) {
        let mut all = std::mem::take(&mut self.rays);
        all.clear();
        all.extend(rays);
        for ray in all.iter().filter(|ray| ray.hit) {
            self.hit(ray.end.0, ray.end.1);
        }
        match dense {
            Some(dense) => self.fill(origin, &all, dense),
            None => all.iter().for_each(|ray| self.ray(origin, ray.end)),
        }
        self.rays = all;
    }

    /// Marks the cell that a beam ended in.
    fn hit(&mut self, x: f64, y: f64) {
        let (x, y) = (whole(x).min(self.stride * 64 - 1), whole(y).min(self.rows - 1));
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
    #[inline(always)]
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
    fn ray(&mut self, a: (f64, f64), b: (f64, f64)) {
        let ((x0, y0), (x1, y1)) = if a.1 <= b.1 { (a, b) } else { (b, a) };
        let (first, last) = (whole(y0).min(self.rows - 1), whole(y1).min(self.rows - 1));
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

    /// Marks what [`ray`](Self::ray) would mark for all rays together, or nearly so.
    ///
    /// Between two neighbouring rays that are nowhere farther apart than a cell, every cell whose centre lies there is met by
    /// one of them. So wedges are filled, as far as both rays reach and as that holds (`dense` cells from the origin), 64
    /// cells in one step; and each ray is drawn only from where the shorter of its two wedges ends.
    fn fill(&mut self, origin: (f64, f64), rays: &[Ray], dense: f64) {
        // The end of the border so far, the ray that it lies on and its distance from the origin.
        let mut border = origin;
        let mut before: Option<&Ray> = None;
        let mut reach = 0.0_f64;
        for ray in rays {
            let Some(last) = before.replace(ray) else {
                continue;
            };
            let neighbours = last.number + 1 == ray.number;
            let wedge = if neighbours {
                last.length.min(ray.length).min(dense)
            } else {
                0.0
            };
            self.tail(origin, last, reach.min(wedge));
            // The border steps from one wedge to the next along the ray between them; small steps are left out.
            if (wedge - reach).abs() > SMALL_STEP {
                let outer = last.at(origin, wedge);
                self.border(border, outer);
                border = outer;
            }
            let end = ray.at(origin, wedge);
            self.border(border, end);
            (border, reach) = (end, wedge);
        }
        if let Some(last) = before {
            self.tail(origin, last, 0.0);
            self.border(border, origin);
        }
        self.fill_flips();
    }

    /// Draws a ray from where cells stop to have their centre within `filled` cells of its length.
    fn tail(&mut self, origin: (f64, f64), ray: &Ray, filled: f64) {
        self.ray(ray.at(origin, (filled - HALF_DIAGONAL).max(0.0)), ray.end);
    }

    /// Flips the first cell with its centre to the right of a segment in every row whose middle the segment crosses.
    fn border(&mut self, a: (f64, f64), b: (f64, f64)) {
        let ((x0, y0), (x1, y1)) = if a.1 <= b.1 { (a, b) } else { (b, a) };
        let (first, end) = (whole(y0 + 0.5), whole(y1 + 0.5));
        if first >= end {
            return;
        }
        let slope = (x1 - x0) / (y1 - y0);
        let last = self.stride * 64 - 1;
        let mut x = x0 + (first as f64 + 0.5 - y0) * slope + 0.5;
        for row in first..end.min(self.rows) {
            let column = whole(x).min(last);
            self.flips[row * self.stride + column / 64] ^= 1 << (column % 64);
            x += slope;
        }
    }

    /// Marks what lies between pairs of flips.
    fn fill_flips(&mut self) {
        let stride = self.stride.max(1);
        for (cleared, flips) in self
            .cleared
            .chunks_exact_mut(stride)
            .zip(self.flips.chunks_exact(stride))
        {
            let mut inside = 0_u64;
            for (cleared, flips) in cleared.iter_mut().zip(flips) {
                if *flips != 0 {
                    let mut bits = *flips;
                    for shift in [1, 2, 4, 8, 16, 32] {
                        bits ^= bits << shift;
                    }
                    *cleared |= bits ^ inside;
                    inside ^= (bits >> 63).wrapping_neg();
                } else {
                    *cleared |= inside;
                }
            }
        }
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
