//! Exact distance transform. The distance of each cell's centre to the nearest occupied square, without a limit.
//!
//! Columns are counted; along the rows the lower envelope of the columns' distances is computed (Meijster, Roerdink and Hesselink, "A
//! General Algorithm for Computing Distance Transforms in Linear Time", 2000). Neighbouring columns with the same distance form one
//! piece: a wall along a row is a single piece of the envelope, however long it is. Where obstacles are dense the windows of the
//! truncated transform are faster, so rows are tried with windows first while that succeeds.

use super::encoding::{Level, WORD};
use super::lower_envelope::Envelope;
use super::truncated::{BAND, Bands};
use crate::bits::BitGrid;

/// Distances up to this are sought by windows first, cells.
const NEAR: u32 = 20;
/// Rows that skip the windows after a row in which they were not enough.
const PAUSE: usize = 8;

/// Distance along a column without an obstacle, cells: no column is that long.
pub(super) const NONE: u16 = u16::MAX;

/// Squared distance of every cell's centre to the nearest occupied square, in half cells, without a limit, row by row; `u32::MAX` if
/// nothing is occupied or the number does not fit.
///
/// Cost: one to ten nanoseconds per cell.
///
/// ```
/// use zenav_space::{BitGrid, squared_distances};
///
/// let squared = squared_distances(&BitGrid::from_fn(5, 1, |cell| cell.x == 0));
/// assert_eq!(squared, [0, 1, 9, 25, 49]);
/// ```
#[must_use]
pub fn squared_distances(obstacles: &BitGrid) -> Vec<u32> {
    let mut squared = Vec::with_capacity(obstacles.width() as usize * obstacles.height() as usize);
    for_each_row(obstacles, |_, row| squared.extend_from_slice(row));
    squared
}

/// Passes [`squared_distances`] on row by row, from the lowest on.
pub fn for_each_row(obstacles: &BitGrid, mut take: impl FnMut(u32, &[u32])) {
    let (width, height, stride) = (
        obstacles.width() as usize,
        obstacles.height() as usize,
        obstacles.stride(),
    );
    let mut near = Bands::<i16>::new(obstacles, NEAR, &(0..stride));
    let mut columns = Columns::new(obstacles);
    let mut envelope = Envelope::default();
    let mut squared = vec![0; stride * WORD];
    let mut pause = 0;
    for start in (0..height).step_by(BAND) {
        let rows = start..(start + BAND).min(height);
        let mut prepared = false;
        columns.enter(rows.clone());
        for y in rows.clone() {
            let row = columns.next(y);
            if pause == 0 {
                if !prepared {
                    near.columns(rows.clone());
                    prepared = true;
                }
                let words = squared.as_chunks_mut().0.iter_mut().enumerate();
                let within = words.fold(true, |all, (word, out)| {
                    all & within(&near, y - start, word, width, out)
                });
                pause = if within { 0 } else { PAUSE };
                if within {
                    take(y as u32, &squared[..width]);
                    continue;
                }
            }
            pause -= 1;
            envelope.row(&row[..width], &mut squared[..width]);
            take(y as u32, &squared[..width]);
        }
    }
}

/// Squared distances of a word by windows; `false` if a distance may be greater than the windows cover.
fn within(near: &Bands<'_, i16>, row: usize, word: usize, width: usize, out: &mut [u32; WORD]) -> bool {
    let mut levels = [0; WORD];
    near.row(row, word, &mut levels);
    for (out, level) in out.iter_mut().zip(&levels) {
        *out = u32::from(level.cast_unsigned());
    }
    let inside = (width - word * WORD).min(WORD);
    levels[..inside].iter().all(|level| *level < <i16 as Level>::far(NEAR))
}

/// Distances to the nearest obstacle along the columns, cells, band by band.
struct Columns<'a> {
    obstacles: &'a BitGrid,
    /// To obstacles above, for the row above each band.
    tops: Vec<u16>,
    /// To obstacles above, for the band's rows.
    above: Vec<u16>,
    /// To obstacles below, for the last row.
    below: Vec<u16>,
    /// To obstacles in either direction, for the last row.
    both: Vec<u16>,
    first: usize,
}

impl<'a> Columns<'a> {
    fn new(obstacles: &'a BitGrid) -> Self {
        let (count, height) = (obstacles.stride() * WORD, obstacles.height() as usize);
        let mut running = vec![NONE; count];
        let mut tops = vec![NONE; count * height.div_ceil(BAND)];
        for y in (0..height).rev() {
            if (y + 1) % BAND == 0 || y + 1 == height {
                tops[y / BAND * count..][..count].copy_from_slice(&running);
            }
            advance(&mut running, obstacles.row(y as u32));
        }
        Self {
            obstacles,
            tops,
            above: vec![NONE; count * BAND],
            below: vec![NONE; count],
            both: running,
            first: 0,
        }
    }

    /// Moves on to the next band.
    fn enter(&mut self, rows: std::ops::Range<usize>) {
        let count = self.below.len();
        let mut running = self.tops[rows.start / BAND * count..][..count].to_vec();
        self.first = rows.start;
        for y in rows.rev() {
            advance(&mut running, self.obstacles.row(y as u32));
            self.above[(y - self.first) * count..][..count].copy_from_slice(&running);
        }
    }

    /// Moves on to the next row of the band.
    fn next(&mut self, y: usize) -> &[u16] {
        let count = self.below.len();
        advance(&mut self.below, self.obstacles.row(y as u32));
        let above = &self.above[(y - self.first) * count..][..count];
        for ((both, below), above) in self.both.iter_mut().zip(&self.below).zip(above) {
            *both = (*below).min(*above);
        }
        &self.both
    }
}

/// One row further: every distance grows by a cell, and is zero at obstacles.
fn advance(running: &mut [u16], obstacles: &[u64]) {
    for (cells, word) in running.as_chunks_mut::<WORD>().0.iter_mut().zip(obstacles) {
        let before = *cells;
        for i in 0..WORD {
            cells[i] = before[i].saturating_add(1);
        }
        let mut word = *word;
        while word != 0 {
            cells[word.trailing_zeros() as usize] = 0;
            word &= word - 1;
        }
    }
}
