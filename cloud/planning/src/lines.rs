//! Transposed and sheared bitmaps. Columns and diagonals are laid out like rows, 64 cells to a word.
//!
//! Source: Warren, "Hacker's Delight", 7-3 (transposing a block of bits).

/// Lines of bits, `stride` words each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Lines {
    pub(super) words: Vec<u64>,
    pub(super) stride: usize,
}

impl Lines {
    /// Number of lines.
    pub(super) fn count(&self) -> usize {
        self.words.len() / self.stride
    }

    /// The words of a line.
    pub(super) fn line(&self, line: usize) -> &[u64] {
        &self.words[line * self.stride..][..self.stride]
    }

    /// Transpose: bit `y` of line `x` is bit `x` of line `y` here; bits without a source line are zero.
    pub(super) fn transposed(&self) -> Self {
        self.turned(|line, word| line.map_or(0, |line| self.words[line * self.stride + word]))
    }

    /// Shear: bit `y` of line `x - slope * y` is bit `x` of line `y` here, line numbers wrap around; bits without a source line are set.
    pub(super) fn sheared(&self, slope: i32) -> Self {
        let bits = self.stride * 64;
        self.turned(|line, word| {
            let Some(line) = line else { return u64::MAX };
            let shift = line % bits;
            let first = word * 64 + if slope > 0 { shift } else { bits - shift };
            let (at, bit) = (first / 64 % self.stride, first % 64);
            let words = self.line(line);
            words[at] >> bit | words[(at + 1) % self.stride] << 1 << (63 - bit)
        })
    }

    /// Reverses every line.
    pub(super) fn reversed(mut self) -> Self {
        for line in self.words.chunks_mut(self.stride) {
            line.reverse();
            line.iter_mut().for_each(|word| *word = word.reverse_bits());
        }
        self
    }

    /// Transposes block by block; `word` gives the words of a line, or the fill for `None` (past the last line).
    fn turned(&self, word: impl Fn(Option<usize>, usize) -> u64) -> Self {
        let count = self.count();
        let stride = count.div_ceil(64);
        let mut words = vec![0; stride * self.stride * 64];
        for band in 0..stride {
            for column in 0..self.stride {
                let mut block = [0; 64];
                for (row, bits) in block.iter_mut().enumerate() {
                    *bits = word(Some(band * 64 + row).filter(|line| *line < count), column);
                }
                transpose(&mut block);
                for (row, bits) in block.into_iter().enumerate() {
                    words[(column * 64 + row) * stride + band] = bits;
                }
            }
        }
        Self { words, stride }
    }
}

/// Swaps rows and columns of a block of bits.
fn transpose(block: &mut [u64; 64]) {
    let mut mask = 0x0000_0000_FFFF_FFFF_u64;
    let mut width = 32;
    while width != 0 {
        let mut row = 0;
        while row < 64 {
            let swapped = ((block[row] >> width) ^ block[row + width]) & mask;
            block[row] ^= swapped << width;
            block[row + width] ^= swapped;
            row = (row + width + 1) & !width;
        }
        width >>= 1;
        mask ^= mask << width;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn get(lines: &Lines, line: usize, bit: usize) -> bool {
        lines.line(line)[bit / 64] >> (bit % 64) & 1 == 1
    }

    proptest! {
        #[test]
        fn every_bit_lands_where_it_belongs(stride in 1_usize..4, count in 1_usize..150, seed in any::<u64>()) {
            let words = (0..stride * count).map(|i| (i as u64 + seed).wrapping_mul(0x9E37_79B9_7F4A_7C15)).collect();
            let lines = Lines { words, stride };
            let bits = stride * 64;
            let (transposed, falling, rising) = (lines.transposed(), lines.sheared(1), lines.sheared(-1));
            let reversed = lines.clone().reversed();
            prop_assert_eq!(transposed.count(), bits);
            for y in 0..transposed.stride * 64 {
                for x in 0..bits {
                    let expected = (y < count).then(|| get(&lines, y, x));
                    prop_assert_eq!(get(&transposed, x, y), expected.unwrap_or(false));
                    prop_assert_eq!(get(&falling, (x + 3 * bits - y) % bits, y), expected.unwrap_or(true));
                    prop_assert_eq!(get(&rising, (x + y) % bits, y), expected.unwrap_or(true));
                    if let Some(expected) = expected {
                        prop_assert_eq!(get(&reversed, y, bits - 1 - x), expected);
                    }
                }
            }
        }
    }
}
