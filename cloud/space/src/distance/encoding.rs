//! Encoding. Squared distances in half cells as numbers that vector instructions compare and add; one byte if the reach is short.
//!
//! From a centre to a closed square `k` cells away it is `2 k - 1` half cells along an axis, zero in the cell itself. Squares of odd
//! numbers are 1 more than a multiple of 8, so a sum over both axes is `8 t + c`, where `c` counts the axes that are not zero. `4 t + c`
//! distinguishes all of them, keeps their order, and is a sum over both axes as well.

use crate::bits::pack;

/// Cells of a word, which are computed together.
pub(super) const WORD: usize = 64;

/// A squared distance from a centre to a closed square.
pub(super) trait Level: Copy + PartialEq + std::fmt::Debug + 'static {
    /// Farthest reach, cells: the sum over both axes still fits.
    const MAX_REACH: u32;

    /// The level of a whole number of cells along one axis; the greatest level beyond the farthest reach.
    fn along(cells: u8) -> Self;

    /// The level for "at least the reach".
    fn far(reach: u32) -> Self;

    /// Squared half cells; `(2 reach)^2` for "at least the reach".
    fn squared(self, reach: u32) -> u16;

    /// The greatest level for at most this many squared half cells.
    fn at_most(squared: u16) -> Self;

    /// The levels of a word from its distances along the columns, cells; distances from `none` on become `far`.
    fn of_columns(columns: &[u8; WORD], none: u8, far: Self, out: &mut [Self; WORD]);

    /// The least of each cell's own level and, for every step to both sides, the neighbour's level plus what the step adds. `row` holds
    /// the word and the words beside it.
    fn relax(row: &[[Self; WORD]; 3], along: &[Self], out: &mut [Self; WORD]);

    /// The levels of a word that are greater than another, as bits.
    fn greater(word: &[Self; WORD], than: Self) -> u64;

    /// How many steps along a row can matter, if the nearest obstacle is this many cells away along the columns.
    fn steps(along: &[Self], nearest: u8, far: Self) -> usize;
}

/// Code shared by both number types. Loops over arrays without a branch become vector instructions; the innermost one is a function of
/// its own, so that this does not depend on the call site.
macro_rules! kernels {
    ($number:ty, $lanes:literal, $add:ident) => {
        fn relax(row: &[[Self; WORD]; 3], along: &[Self], out: &mut [Self; WORD]) {
            /// Cells computed at once: four vectors of sixteen bytes, which stay in registers.
            const LANES: usize = $lanes;
            #[inline(never)]
            #[allow(
                clippy::needless_range_loop,
                reason = "a loop over zipped arrays does not become vector instructions everywhere"
            )]
            fn relax(row: &[$number], at: usize, along: &[$number]) -> [$number; LANES] {
                let mut least = [0; LANES];
                least.copy_from_slice(&row[at..at + LANES]);
                for (step, along) in along.iter().enumerate() {
                    let (left, right) = (&row[at - 1 - step..][..LANES], &row[at + 1 + step..][..LANES]);
                    let before = least;
                    for lane in 0..LANES {
                        least[lane] = before[lane].min(left[lane].min(right[lane]).$add(*along));
                    }
                }
                least
            }
            for (part, out) in out.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
                *out = relax(row.as_flattened(), WORD + part * LANES, along);
            }
        }

        fn greater(word: &[Self; WORD], than: Self) -> u64 {
            pack(word, |level| level > than)
        }

        fn steps(along: &[Self], nearest: u8, far: Self) -> usize {
            let nearest = Self::along(nearest);
            along.iter().take_while(|along| along.$add(nearest) < far).count()
        }
    };
}

/// Encoded as `4 t + c`.
impl Level for u8 {
    const MAX_REACH: u32 = 11;

    fn along(cells: u8) -> Self {
        let k = u16::from(cells);
        (2 * k * k.saturating_sub(1) + k.min(1)).min(255) as Self
    }

    fn far(reach: u32) -> Self {
        // Four times the square of an odd reach is 4 more than a multiple of 8: above every sum with the same `t`.
        (2 * reach * reach + reach % 2) as Self
    }

    fn squared(self, reach: u32) -> u16 {
        if self == Self::far(reach) {
            return (4 * reach * reach) as u16;
        }
        2 * u16::from(self) - u16::from(self % 4)
    }

    fn at_most(squared: u16) -> Self {
        let counted = match squared % 8 {
            c @ 0..=1 => c,
            2..=3 => 2,
            _ => 3,
        };
        (squared / 8 * 4 + counted).min(255) as Self
    }

    #[allow(
        clippy::needless_range_loop,
        reason = "a loop over zipped arrays does not become vector instructions everywhere"
    )]
    fn of_columns(columns: &[u8; WORD], none: u8, far: Self, out: &mut [Self; WORD]) {
        for i in 0..WORD {
            let k = u16::from(columns[i].min(none));
            out[i] = (2 * k * k.wrapping_sub(1) + k.min(1)).min(u16::from(far)) as Self;
        }
    }

    kernels!(u8, 64, saturating_add);
}

/// Squared half cells without encoding.
impl Level for i16 {
    const MAX_REACH: u32 = 63;

    fn along(cells: u8) -> Self {
        let half = (2 * Self::from(cells) - 1).max(0);
        half * half
    }

    fn far(reach: u32) -> Self {
        (4 * reach * reach) as Self
    }

    fn squared(self, _reach: u32) -> u16 {
        self.cast_unsigned()
    }

    fn at_most(squared: u16) -> Self {
        Self::try_from(squared).unwrap_or(Self::MAX)
    }

    #[allow(
        clippy::needless_range_loop,
        reason = "a loop over zipped arrays does not become vector instructions everywhere"
    )]
    fn of_columns(columns: &[u8; WORD], none: u8, far: Self, out: &mut [Self; WORD]) {
        for i in 0..WORD {
            let half = (2 * Self::from(columns[i].min(none)) - 1).max(0);
            out[i] = (half * half).min(far);
        }
    }

    // Twice the square of the farthest distance fits, so nothing wraps.
    kernels!(i16, 32, wrapping_add);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Squared half cells along one axis.
    fn half(cells: u32) -> u32 {
        (2 * cells).saturating_sub(1).pow(2)
    }

    fn check<L: Level + Ord>() {
        for reach in 1..=L::MAX_REACH {
            for (a, b) in (0..=reach).flat_map(|a| (0..=a).map(move |b| (a, b))) {
                let squared = half(a) + half(b);
                let [mut row, mut out] = [[L::far(reach); WORD]; 2];
                // An obstacle in this column, `a` cells away; the result is read `b` columns from there.
                let mut columns = [u8::MAX; WORD];
                columns[0] = a as u8;
                L::of_columns(&columns, reach as u8 + 1, L::far(reach), &mut row);
                let beyond = [L::far(reach); WORD];
                let along: Vec<L> = (1..=reach as u8).map(L::along).collect();
                L::relax(&[beyond, row, beyond], &along, &mut out);
                let level = out[b as usize];
                assert_eq!(
                    u32::from(level.squared(reach)),
                    squared.min(4 * reach * reach),
                    "{a} {b} {reach}"
                );
                for bound in squared.saturating_sub(3)..=squared + 3 {
                    let above = u32::from(level.squared(reach)) > bound;
                    assert_eq!(
                        L::greater(&out, L::at_most(bound as u16)) >> b & 1 == 1,
                        above,
                        "{squared} {bound} {reach}"
                    );
                }
                assert!(L::steps(&along, a as u8, L::far(reach)) >= b as usize || squared >= 4 * reach * reach);
            }
        }
    }

    #[test]
    fn levels_stand_for_squared_half_cells_up_to_every_reach() {
        check::<u8>();
        check::<i16>();
    }
}
