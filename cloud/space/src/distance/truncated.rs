//! Truncated distance transform. Distances up to a reach, in bands of rows: down the columns in bytes, along the rows in whole vectors.
//!
//! The separable transform of Saito and Toriwaki ("New Algorithms for Euclidean Distance Transformation", 1994) with windows of the
//! reach's width instead of a search: exact up to the reach, and without a branch inside a word of 64 cells. For each word the distance
//! of its nearest obstacle along the columns is known: beyond the reach nothing is computed, and above zero the window is narrower.

use std::ops::Range;

use super::encoding::{Level, WORD};
use crate::bits::BitGrid;

/// Rows per band; the bytes of its columns stay in the cache.
pub(super) const BAND: usize = 64;

/// One byte for each column of a word.
type Columns = [u8; WORD];

/// Working memory of the transform for a window of words.
pub(super) struct Bands<'a, L> {
    obstacles: &'a BitGrid,
    reach: usize,
    /// Distance along a column for "none within reach".
    none: u8,
    far: L,
    /// The window with one more word at each side, where the grid has one.
    wide: Range<usize>,
    /// Distances to the nearest obstacle below, cells, for the row before the band, the band's rows, and as many rows above as the reach.
    below: Vec<Columns>,
    /// The least of them in each word; for `none` the word in `below` is not written.
    nearest_below: Vec<u8>,
    /// Distances to the nearest obstacle below or above in the row that was last computed.
    both: Vec<Columns>,
    nearest_both: Vec<u8>,
    /// Levels along the columns for the band's rows, with an empty word at both ends.
    levels: Vec<[L; WORD]>,
    /// The least distance in each of those words.
    nearest: Vec<u8>,
    /// The level that each step along a row adds.
    along: Vec<L>,
    /// Number of steps that can matter, by the least distance of a word and the words beside it.
    steps: Vec<usize>,
    /// The rows computed last; the band above them reuses some rows.
    last: Range<usize>,
}

impl<'a, L: Level> Bands<'a, L> {
    /// Prepares a window of words; `reach` in cells, from 1 to the level's farthest.
    pub(super) fn new(obstacles: &'a BitGrid, reach: u32, words: &Range<usize>) -> Self {
        let wide = words.start.saturating_sub(1)..(words.end + 1).min(obstacles.stride());
        let (far, none, count) = (L::far(reach), reach as u8 + 1, wide.len());
        let rows = 1 + BAND + reach as usize;
        let along: Vec<L> = (1..none).map(L::along).collect();
        Self {
            obstacles,
            reach: reach as usize,
            none,
            far,
            wide,
            below: vec![[0; WORD]; rows * count],
            nearest_below: vec![none; rows * count],
            both: vec![[0; WORD]; count],
            nearest_both: vec![none; count],
            levels: vec![[far; WORD]; BAND * (count + 2)],
            nearest: vec![none; BAND * (count + 2)],
            steps: (0..none).map(|nearest| L::steps(&along, nearest, far)).collect(),
            along,
            last: 0..0,
        }
    }

    /// Distances along the columns for a band of at most [`BAND`] rows. Consecutive bands cost least.
    pub(super) fn columns(&mut self, rows: Range<usize>) {
        self.upwards(&rows);
        self.downwards(rows.len(), self.rows_above(&rows));
        self.last = rows;
    }

    /// Number of rows, from the band's first on, that affect the band.
    fn rows_above(&self, rows: &Range<usize>) -> usize {
        (rows.end + self.reach).min(self.obstacles.height() as usize) - rows.start
    }

    fn upwards(&mut self, rows: &Range<usize>) {
        let count = self.wide.len();
        let first = if self.last.end == rows.start && !self.last.is_empty() {
            self.below.copy_within(self.last.len() * count.., 0);
            self.nearest_below.copy_within(self.last.len() * count.., 0);
            self.reach.min(self.obstacles.height() as usize - rows.start)
        } else {
            self.nearest_below[..count].fill(self.none);
            for y in rows.start.saturating_sub(self.reach)..rows.start {
                let words = &self.obstacles.row(y as u32)[self.wide.clone()];
                for ((columns, nearest), word) in self.below.iter_mut().zip(&mut self.nearest_below).zip(words) {
                    let before = *columns;
                    *nearest = raise(&before, *nearest, *word, self.none, columns);
                }
            }
            0
        };
        for row in first..self.rows_above(rows) {
            let words = &self.obstacles.row((rows.start + row) as u32)[self.wide.clone()];
            let (before, now) = self.below.split_at_mut((row + 1) * count);
            let (nearest_before, nearest_now) = self.nearest_below.split_at_mut((row + 1) * count);
            let before = before[row * count..].iter().zip(&nearest_before[row * count..]);
            for (((before, nearest_before), (now, nearest_now)), word) in
                before.zip(now.iter_mut().zip(nearest_now)).zip(words)
            {
                *nearest_now = raise(before, *nearest_before, *word, self.none, now);
            }
        }
    }

    fn downwards(&mut self, rows: usize, rows_above: usize) {
        let (count, none) = (self.wide.len(), self.none);
        self.nearest_both.fill(none);
        for row in (0..rows_above).rev() {
            let below = &self.below[(row + 1) * count..][..count];
            let nearest_below = &self.nearest_below[(row + 1) * count..][..count];
            let both = self.both.iter_mut().zip(&mut self.nearest_both);
            for ((both, nearest), (below, nearest_below)) in both.zip(below.iter().zip(nearest_below)) {
                *nearest = lower(both, *nearest, below, *nearest_below, none);
            }
            if row >= rows {
                continue;
            }
            let levels = &mut self.levels[row * (count + 2) + 1..][..count];
            for ((levels, both), nearest) in levels.iter_mut().zip(&self.both).zip(&self.nearest_both) {
                if *nearest < none {
                    L::of_columns(both, none, self.far, levels);
                } else {
                    *levels = [self.far; WORD];
                }
            }
            self.nearest[row * (count + 2) + 1..][..count].copy_from_slice(&self.nearest_both);
        }
    }

    /// Index of the word to the left, and the distance along the columns to the nearest obstacle of a word and the words beside it, in a
    /// row of the band, cells.
    fn nearest(&self, row: usize, word: usize) -> (usize, u8) {
        let at = row * (self.wide.len() + 2) + word - self.wide.start;
        let nearest = self.nearest[at..at + 3]
            .iter()
            .fold(self.none, |least, of| least.min(*of));
        (at, nearest)
    }

    /// Whether an obstacle may be within reach of a word of the window in a row of the band.
    pub(super) fn is_near(&self, row: usize, word: usize) -> bool {
        self.nearest(row, word).1 < self.none
    }

    /// The levels of a word of the window in a row of the band.
    pub(super) fn row(&self, row: usize, word: usize, out: &mut [L; WORD]) {
        let (at, nearest) = self.nearest(row, word);
        match (self.steps.get(usize::from(nearest)), self.levels[at..].first_chunk()) {
            (Some(steps), Some(levels)) => L::relax(levels, &self.along[..*steps], out),
            _ => *out = [self.far; WORD],
        }
    }
}

/// Distances to the nearest obstacle below, one row further up; returns the least one. Nothing is written for `none`.
#[allow(
    clippy::needless_range_loop,
    reason = "a loop over zipped arrays does not become vector instructions everywhere"
)]
fn raise(before: &Columns, nearest: u8, word: u64, none: u8, now: &mut Columns) -> u8 {
    let known = nearest < none;
    match (word != 0, known) {
        (false, false) => return none,
        (false, true) => {
            for i in 0..WORD {
                now[i] = before[i].saturating_add(1);
            }
            return (nearest + 1).min(none);
        }
        (true, false) => *now = empty(word),
        (true, true) => {
            let empty = empty(word);
            for i in 0..WORD {
                now[i] = before[i].saturating_add(1) & empty[i];
            }
        }
    }
    0
}

/// Distances to the nearest obstacle in either direction, one row further down; returns the least one.
#[allow(
    clippy::needless_range_loop,
    reason = "a loop over zipped arrays does not become vector instructions everywhere"
)]
fn lower(both: &mut Columns, nearest: u8, below: &Columns, nearest_below: u8, none: u8) -> u8 {
    let before = *both;
    match (nearest < none, nearest_below < none) {
        (false, false) => return none,
        (false, true) => *both = *below,
        (true, false) => {
            for i in 0..WORD {
                both[i] = before[i].saturating_add(1);
            }
        }
        (true, true) => {
            for i in 0..WORD {
                both[i] = before[i].saturating_add(1).min(below[i]);
            }
        }
    }
    nearest_below.min((nearest + 1).min(none))
}

/// Bytes of a word: zero for set bits, else 255.
#[inline]
fn empty(word: u64) -> Columns {
    let mut empty = [0; WORD];
    for (to, byte) in empty.as_chunks_mut::<8>().0.iter_mut().zip(word.to_le_bytes()) {
        *to = EMPTY[usize::from(byte)];
    }
    empty
}

/// Zero for each set bit of a byte, else 255.
static EMPTY: [[u8; 8]; 256] = {
    let mut bytes = [[u8::MAX; 8]; 256];
    let mut value = 0;
    while value < 256 {
        let mut bit = 0;
        while bit < 8 {
            if value >> bit & 1 == 1 {
                bytes[value][bit] = 0;
            }
            bit += 1;
        }
        value += 1;
    }
    bytes
};
