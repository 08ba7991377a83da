//! How far is each cell's centre from the nearest occupied square, at any distance?
//!
//! The lower envelope of Meijster, Roerdink and Hesselink ("A General Algorithm for Computing Distance Transforms in Linear Time",
//! 2000); it needs only that the cost along a row is convex, and so is that of a square.

use super::bits::BitGrid;

/// Squared distance of every cell's centre to the nearest occupied square, in half cells, at any distance, row by row;
/// `u32::MAX` where nothing is occupied or the number would not fit.
///
/// Cost: linear in the number of cells.
#[must_use]
pub fn squared_distances(obstacles: &BitGrid) -> Vec<u32> {
    let mut squared = Vec::with_capacity(obstacles.width() as usize * obstacles.height() as usize);
    for_each_row(obstacles, |_, row| squared.extend_from_slice(row));
    squared
}

/// Hands out [`squared_distances`] row by row, from the lowest on.
pub fn for_each_row(obstacles: &BitGrid, mut take: impl FnMut(u32, &[u32])) {
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
    let mut squared = vec![none; width];
    let mut envelope = Envelope::default();
    for y in 0..height {
        squared.fill(none);
        envelope.row(&columns[y * width..][..width], &mut squared);
        take(y as u32, &squared);
    }
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
