//! Lower envelope. The nearest obstacle to each cell of a row, as the lower envelope of the columns' costs.
//!
//! A column costs its own squared distance for all cells in it; for other cells the squared distance to its border is added. Adjacent
//! columns with the same distance form one piece. Of two pieces the right one is better from some cell on and stays better, because the
//! difference of two such costs only grows along the row.

use super::exact::NONE;

/// Adjacent columns with the same distance.
#[derive(Clone, Copy)]
struct Piece {
    /// Borders, in columns.
    left: i64,
    right: i64,
    /// Squared half cells along the columns.
    height: i64,
    /// The first cell at which it is better than the pieces before it.
    from: i64,
}

impl Piece {
    /// Cost at a cell's centre, squared half cells.
    fn cost(&self, cell: i64) -> i64 {
        let center = 2 * cell + 1;
        let along = (2 * self.left - center).max(center - 2 * self.right).max(0);
        along * along + self.height
    }

    /// The first cell at which `self`, which lies on the right, is better than `other`.
    fn better_from(&self, other: &Self) -> i64 {
        // With borders `p` and `q` (half cells) that both costs grow from: (x - p)^2 + other > (q - x)^2 + self, x = 2 cell + 1.
        let between = |p: i64, q: i64| {
            let bound = (self.height - other.height).div_euclid(4 * (q - p)) + p + q;
            bound.div_euclid(2) + bound.rem_euclid(2)
        };
        let square = |columns: i64| 4 * columns * columns;
        let higher = self.height - other.height;
        if higher > square(self.right - other.right) {
            between(other.right, self.right)
        } else if higher > square(self.left - other.right) {
            // Within `self`, where its cost is its height.
            other.right + (root(higher) + 1) / 2
        } else if -higher > square(self.left - other.left) {
            between(other.left, self.left)
        } else if -higher > square(self.left - other.right) {
            // Within `other`.
            self.left - (root(-higher - 1) + 1) / 2
        } else {
            between(other.right, self.left)
        }
    }
}

/// The integer part of a square root; exact, because squares are far smaller than the integers that a float holds.
fn root(square: i64) -> i64 {
    (square as f64).sqrt() as i64
}

/// Computes the envelope of one row after the other.
#[derive(Default)]
pub(super) struct Envelope {
    pieces: Vec<Piece>,
}

impl Envelope {
    /// Squared half cells to the nearest obstacle for each cell of a row, from the distances along its columns (cells).
    pub(super) fn row(&mut self, columns: &[u16], out: &mut [u32]) {
        let width = columns.len() as i64;
        let pieces = &mut self.pieces;
        pieces.clear();
        let mut left = 0;
        for run in columns.chunk_by(|a, b| a == b) {
            let right = left + run.len() as i64;
            if run[0] != NONE {
                let half = (2 * i64::from(run[0]) - 1).max(0);
                let mut piece = Piece {
                    left,
                    right,
                    height: half * half,
                    from: 0,
                };
                while pieces
                    .pop_if(|last| piece.cost(last.from) < last.cost(last.from))
                    .is_some()
                {}
                if let Some(last) = pieces.last() {
                    piece.from = piece.better_from(last);
                }
                if piece.from < width {
                    pieces.push(piece);
                }
            }
            left = right;
        }
        if pieces.is_empty() {
            out.fill(u32::MAX);
        }
        for (number, piece) in pieces.iter().enumerate() {
            let end = pieces.get(number + 1).map_or(width, |next| next.from);
            let (left, right) = (piece.left.clamp(piece.from, end), piece.right.clamp(piece.from, end));
            let cost = |cell: i64| u32::try_from(piece.cost(cell)).unwrap_or(u32::MAX);
            for (out, cell) in out[piece.from as usize..left as usize].iter_mut().zip(piece.from..) {
                *out = cost(cell);
            }
            out[left as usize..right as usize].fill(u32::try_from(piece.height).unwrap_or(u32::MAX));
            for (out, cell) in out[right as usize..end as usize].iter_mut().zip(right..) {
                *out = cost(cell);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn half(cells: u64) -> u64 {
        (2 * cells).saturating_sub(1).pow(2)
    }

    proptest! {
        #[test]
        fn every_cell_gets_the_best_offer(columns in prop::collection::vec(prop_oneof![Just(NONE), 0_u16..6, 0_u16..40, 32_000..32_768_u16], 0..40)) {
            let mut out = vec![0; columns.len()];
            Envelope::default().row(&columns, &mut out);
            for (x, out) in out.iter().enumerate() {
                let offers = columns.iter().enumerate().filter(|(_, cells)| **cells != NONE);
                let best = offers.map(|(at, cells)| half(at.abs_diff(x) as u64) + half(u64::from(*cells))).min();
                prop_assert_eq!(*out, best.and_then(|best| u32::try_from(best).ok()).unwrap_or(u32::MAX));
            }
        }
    }
}
