//! How far is each cell's centre from the nearest occupied square?
//!
//! Exact Euclidean distances to closed squares: a cell `k` columns away is `max(|k| - 1/2, 0)` cells away along x, and the
//! squared distance is the sum over both axes. Distances are kept as squared half cells, which are whole numbers.
//!
//! Two transforms: [`squared_distances`] is exact at any distance (the lower envelope of Meijster, Roerdink and Hesselink,
//! "A General Algorithm for Computing Distance Transforms in Linear Time", 2000; it needs only that the cost along a row is
//! convex, and so is that of a square). [`DistanceField`] stops at a given reach, which is all that a robot asks for, and
//! is several times faster: columns by saturating bytes, rows by a window of the reach's width, both over whole vectors.

use std::ops::Range;

use zenav_protocol::grid::{Cell, GridSpec};

use super::bits::BitGrid;

/// Squared distance of a whole number of cells, in half cells: `(2 |k| - 1)^2`, zero for the cell itself.
const fn squared_half_cells(cells: u32) -> i16 {
    let half = if cells == 0 { 0 } else { 2 * cells - 1 };
    (half * half) as i16
}

/// Farthest reach of a [`DistanceField`], cells: squared half cells of both axes together still fit sixteen bits.
pub const MAX_REACH: u32 = 63;

/// Rows that are transformed together: the bytes of their columns stay in the cache.
const BAND: usize = 64;

/// Distances up to a reach.
#[derive(Clone, Debug, PartialEq)]
pub struct DistanceField {
    spec: GridSpec,
    reach: u32,
    /// Padded to whole words a row; squared half cells, `(2 reach)^2` for "at least the reach".
    squared: Vec<i16>,
    stride: usize,
}

impl DistanceField {
    /// Transforms a whole grid. `reach` in cells is brought into 1 to [`MAX_REACH`].
    ///
    /// Cost: a few nanoseconds a cell near obstacles, a fraction of one where there are none within reach.
    #[must_use]
    pub fn new(spec: GridSpec, obstacles: &BitGrid, reach: u32) -> Self {
        let reach = reach.clamp(1, MAX_REACH);
        let stride = obstacles.stride() * 64;
        let limit = (4 * reach * reach) as i16;
        let mut field = Self {
            spec,
            reach,
            squared: vec![limit; stride * obstacles.height() as usize],
            stride,
        };
        field.refresh(obstacles, 0..obstacles.stride(), 0..obstacles.height() as usize);
        field
    }

    /// Recomputes a window of words and rows after obstacles changed in it or within reach of it.
    pub(super) fn refresh(&mut self, obstacles: &BitGrid, words: Range<usize>, rows: Range<usize>) {
        let mut bands = Bands::new(self.reach, words);
        let mut start = rows.start;
        while start < rows.end {
            let end = (start + BAND).min(rows.end);
            bands.columns(obstacles, start..end);
            for y in start..end {
                let row = &mut self.squared[y * self.stride..(y + 1) * self.stride];
                bands.row(y - start, row);
            }
            start = end;
        }
    }

    /// Distances at least this far are not told apart, cells.
    #[must_use]
    pub fn reach_cells(&self) -> u32 {
        self.reach
    }

    /// Distances at least this far are not told apart, m.
    #[must_use]
    pub fn reach(&self) -> f64 {
        f64::from(self.reach) * self.spec.resolution
    }

    /// Squared distance from a cell's centre, in half cells; `(2 reach)^2` means at least the reach. Zero outside the grid.
    #[must_use]
    pub fn squared(&self, cell: Cell) -> u16 {
        if cell.x < self.spec.width && cell.y < self.spec.height {
            self.squared[cell.y as usize * self.stride + cell.x as usize].cast_unsigned()
        } else {
            0
        }
    }

    /// Distance from a cell's centre to the nearest occupied square, m; at most the reach, zero outside the grid.
    #[must_use]
    pub fn distance(&self, cell: Cell) -> f64 {
        0.5 * f64::from(self.squared(cell)).sqrt() * self.spec.resolution
    }

    /// Squared half cells of a row, padded to whole words.
    pub(super) fn row(&self, y: u32) -> &[i16] {
        &self.squared[y as usize * self.stride..(y as usize + 1) * self.stride]
    }
}

/// Working memory of the truncated transform for one window of words.
struct Bands {
    reach: usize,
    words: Range<usize>,
    /// Words with one more at each side, as far as the grid has them.
    wide: Range<usize>,
    /// Distance along the column, cells, `reach + 1` for none; `BAND` rows of `wide`.
    columns: Vec<u8>,
    /// Whether any cell of a word has an obstacle in its column within reach.
    near: Vec<bool>,
    /// One row's squared column distances with a word of "none" at both ends.
    costs: Vec<i16>,
    squares: Vec<i16>,
    running: Vec<u8>,
}

impl Bands {
    fn new(reach: u32, words: Range<usize>) -> Self {
        let limit = (4 * reach * reach) as i16;
        let mut squares: Vec<i16> = (0..=reach).map(squared_half_cells).collect();
        squares.push(limit);
        Self {
            reach: reach as usize,
            words,
            wide: 0..0,
            columns: Vec::new(),
            near: Vec::new(),
            costs: Vec::new(),
            squares,
            running: Vec::new(),
        }
    }

    /// Distances along the columns for a band of rows: once upwards from `reach` rows below, once downwards from `reach` above.
    fn columns(&mut self, obstacles: &BitGrid, rows: Range<usize>) {
        let height = obstacles.height() as usize;
        self.wide = self.words.start.saturating_sub(1)..(self.words.end + 1).min(obstacles.stride());
        let width = self.wide.len() * 64;
        let none = self.reach as u8 + 1;
        self.columns.clear();
        self.columns.resize(rows.len() * width, none);
        self.near.clear();
        self.near.resize(rows.len() * self.wide.len(), false);
        self.running.clear();
        self.running.resize(width, none);
        for y in rows.start.saturating_sub(self.reach)..rows.end {
            advance(&mut self.running, &obstacles.row(y as u32)[self.wide.clone()], none);
            if y >= rows.start {
                self.columns[(y - rows.start) * width..][..width].copy_from_slice(&self.running);
            }
        }
        self.running.fill(none);
        for y in (rows.start..(rows.end + self.reach).min(height)).rev() {
            advance(&mut self.running, &obstacles.row(y as u32)[self.wide.clone()], none);
            if y < rows.end {
                let row = y - rows.start;
                let cells = &mut self.columns[row * width..][..width];
                for (word, (cells, running)) in cells
                    .chunks_exact_mut(64)
                    .zip(self.running.chunks_exact(64))
                    .enumerate()
                {
                    let mut least = none;
                    for (cell, running) in cells.iter_mut().zip(running) {
                        *cell = (*cell).min(*running);
                        least = least.min(*cell);
                    }
                    self.near[row * self.wide.len() + word] = least < none;
                }
            }
        }
    }

    /// One row of the result from the column distances of a band's row.
    fn row(&mut self, row: usize, out: &mut [i16]) {
        let count = self.wide.len();
        let near = &self.near[row * count..][..count];
        let limit = self.squares[self.reach + 1];
        let offset = self.words.start - self.wide.start;
        self.costs.clear();
        self.costs.resize(count * 64 + 128, limit);
        for (word, _) in near.iter().enumerate().filter(|(_, near)| **near) {
            let cells = &self.columns[(row * count + word) * 64..][..64];
            for (cost, cell) in self.costs[64 + word * 64..][..64].iter_mut().zip(cells) {
                *cost = self.squares[usize::from(*cell)];
            }
        }
        for word in offset..offset + self.words.len() {
            let out = &mut out[(self.wide.start + word) * 64..][..64];
            let touched = near[word.saturating_sub(1)..(word + 2).min(count)]
                .iter()
                .any(|near| *near);
            if !touched {
                out.fill(limit);
                continue;
            }
            let center = 64 + word * 64;
            let mut least = [0_i16; 64];
            least.copy_from_slice(&self.costs[center..][..64]);
            for k in 1..=self.reach {
                let along = self.squares[k];
                let (left, right) = (&self.costs[center - k..][..64], &self.costs[center + k..][..64]);
                for ((least, left), right) in least.iter_mut().zip(left).zip(right) {
                    *least = (*least).min((*left).min(*right) + along);
                }
            }
            out.copy_from_slice(&least);
        }
    }
}

/// One row further: every distance grows by a cell, up to `none`; obstacles begin anew at zero.
fn advance(running: &mut [u8], obstacles: &[u64], none: u8) {
    for (cells, word) in running.chunks_exact_mut(64).zip(obstacles) {
        for cell in cells.iter_mut() {
            *cell = (*cell + 1).min(none);
        }
        let mut word = *word;
        while word != 0 {
            cells[word.trailing_zeros() as usize] = 0;
            word &= word - 1;
        }
    }
}

/// Squared distance of every cell's centre to the nearest occupied square, in half cells, at any distance, row by row;
/// `u32::MAX` where nothing is occupied or the number would not fit.
///
/// Cost: linear in the number of cells.
#[must_use]
pub fn squared_distances(obstacles: &BitGrid) -> Vec<u32> {
    let (width, height) = (obstacles.width() as usize, obstacles.height() as usize);
    // Distances along the columns, cells; no column is longer than this.
    let none = u32::MAX;
    let mut columns = vec![none; width * height];
    for rows in [Vec::from_iter(0..height), Vec::from_iter((0..height).rev())] {
        let mut running = vec![none; width];
        for y in rows {
            for cell in &mut running {
                *cell = cell.saturating_add(1);
            }
            for x in obstacles.set_in_row(y as u32, 0, i64::from(obstacles.width())) {
                running[x as usize] = 0;
            }
            for (cell, running) in columns[y * width..][..width].iter_mut().zip(&running) {
                *cell = (*cell).min(*running);
            }
        }
    }
    let mut squared = vec![none; width * height];
    let mut envelope = Envelope::default();
    for y in 0..height {
        envelope.row(&columns[y * width..][..width], &mut squared[y * width..][..width]);
    }
    squared
}

/// Lower envelope of one row: which column's obstacle is nearest from where on.
#[derive(Default)]
struct Envelope {
    /// Column and the first cell at which it wins.
    winners: Vec<(usize, usize)>,
}

impl Envelope {
    fn row(&mut self, columns: &[u32], out: &mut [u32]) {
        let square = |cells: u64| {
            if cells == 0 {
                0
            } else {
                (2 * cells - 1) * (2 * cells - 1)
            }
        };
        let cost = |x: usize, column: usize| square(x.abs_diff(column) as u64) + square(u64::from(columns[column]));
        self.winners.clear();
        for column in (0..columns.len()).filter(|&column| columns[column] != u32::MAX) {
            // The new column wins from some cell on, for the difference of two convex costs grows only one way.
            let mut from = 0;
            while let Some(&(last, begins)) = self.winners.last() {
                if cost(begins, column) < cost(begins, last) {
                    self.winners.pop();
                    continue;
                }
                let (mut low, mut high) = (begins, columns.len());
                while low + 1 < high {
                    let middle = low.midpoint(high);
                    if cost(middle, column) < cost(middle, last) {
                        high = middle
                    } else {
                        low = middle
                    }
                }
                from = high;
                break;
            }
            if from < columns.len() {
                self.winners.push((column, from));
            }
        }
        let mut ends = self
            .winners
            .iter()
            .skip(1)
            .map(|winner| winner.1)
            .chain([columns.len()]);
        for (column, begins) in &self.winners {
            let end = ends.next().unwrap_or(columns.len());
            for (x, out) in out.iter_mut().enumerate().take(end).skip(*begins) {
                *out = u32::try_from(cost(x, *column)).unwrap_or(u32::MAX);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use proptest::prelude::*;

    use super::*;

    fn grid(width: u32, height: u32, set: &[(u32, u32)]) -> BitGrid {
        let mut bits = BitGrid::new(width, height);
        for (x, y) in set {
            bits.set(Cell::new(x % width.max(1), y % height.max(1)), true);
        }
        bits
    }

    fn brute(bits: &BitGrid, x: u32, y: u32) -> u32 {
        let square = |k: u32| if k == 0 { 0 } else { (2 * k - 1) * (2 * k - 1) };
        let mut least = u32::MAX;
        for v in 0..bits.height() {
            for u in bits.set_in_row(v, 0, i64::from(bits.width())) {
                least = least.min(square(x.abs_diff(u)) + square(y.abs_diff(v)));
            }
        }
        least
    }

    fn spec(width: u32, height: u32) -> GridSpec {
        GridSpec {
            origin: Point2::origin(),
            resolution: 0.1,
            width,
            height,
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn both_transforms_agree_with_every_obstacle_tried(width in 1_u32..150, height in 1_u32..90, set in proptest::collection::vec((0_u32..150, 0_u32..90), 0..12), reach in 1_u32..=MAX_REACH) {
            let bits = grid(width, height, &set);
            let exact = squared_distances(&bits);
            let field = DistanceField::new(spec(width, height), &bits, reach);
            for y in 0..height {
                for x in 0..width {
                    let least = brute(&bits, x, y);
                    prop_assert_eq!(exact[(y * width + x) as usize], least);
                    prop_assert_eq!(u32::from(field.squared(Cell::new(x, y))), least.min(4 * reach * reach));
                }
            }
        }
    }

    #[test]
    fn an_empty_grid_has_nothing_in_reach() {
        let field = DistanceField::new(spec(3, 2), &BitGrid::new(3, 2), 10);
        assert!((field.distance(Cell::new(1, 1)) - 1.0).abs() < 1e-12);
        assert!(squared_distances(&BitGrid::new(0, 0)).is_empty());
        assert!(
            field.distance(Cell::new(3, 1)).abs() < 1e-12,
            "outside there is no clearance"
        );
    }
}
