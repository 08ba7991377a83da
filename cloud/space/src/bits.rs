//! Bitmaps. One bit per cell of a grid, so that 64 cells are tested in one step.

use zenav_protocol::grid::Cell;

/// Rows of bits, lowest row first; bit `x % 64` of word `x / 64` is column `x`. Bits beyond the width are zero.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BitGrid {
    width: u32,
    height: u32,
    stride: usize,
    words: Vec<u64>,
}

impl BitGrid {
    /// All bits clear.
    #[must_use]
    pub fn new(width: u32, height: u32) -> Self {
        let stride = (width as usize).div_ceil(64);
        Self {
            width,
            height,
            stride,
            words: vec![0; stride * height as usize],
        }
    }

    /// Sets the bits of all cells for which `is_set` is true.
    ///
    /// ```
    /// use zenav_protocol::grid::Cell;
    /// use zenav_space::BitGrid;
    ///
    /// let diagonal = BitGrid::from_fn(100, 100, |cell| cell.x == cell.y);
    /// assert!(diagonal.get(Cell::new(70, 70)) && diagonal.count() == 100);
    /// assert_eq!(diagonal.next_set(70, 0, 99), Some(70));
    /// ```
    #[must_use]
    pub fn from_fn(width: u32, height: u32, mut is_set: impl FnMut(Cell) -> bool) -> Self {
        let mut bits = Self::new(width, height);
        for y in 0..height {
            for x in 0..width {
                if is_set(Cell::new(x, y)) {
                    bits.words[y as usize * bits.stride + x as usize / 64] |= 1 << (x % 64);
                }
            }
        }
        bits
    }

    /// Columns.
    #[must_use]
    #[inline]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    #[must_use]
    #[inline]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Words per row.
    #[must_use]
    #[inline]
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// The words of a row.
    ///
    /// # Panics
    /// For a row outside the grid.
    #[must_use]
    #[inline]
    pub fn row(&self, y: u32) -> &[u64] {
        let start = y as usize * self.stride;
        &self.words[start..start + self.stride]
    }

    /// The words of a row. Bits beyond the width must stay zero.
    ///
    /// # Panics
    /// For a row outside the grid.
    pub fn row_mut(&mut self, y: u32) -> &mut [u64] {
        let start = y as usize * self.stride;
        &mut self.words[start..start + self.stride]
    }

    /// All words, row by row.
    #[must_use]
    #[inline]
    pub fn words(&self) -> &[u64] {
        &self.words
    }

    /// Whether a cell's bit is set; `false` outside the grid.
    #[must_use]
    #[inline]
    pub fn get(&self, cell: Cell) -> bool {
        cell.x < self.width
            && cell.y < self.height
            && self.words[cell.y as usize * self.stride + cell.x as usize / 64] >> (cell.x % 64) & 1 == 1
    }

    /// Sets or clears a cell's bit; nothing happens outside the grid.
    pub fn set(&mut self, cell: Cell, value: bool) {
        if cell.x < self.width && cell.y < self.height {
            let word = &mut self.words[cell.y as usize * self.stride + cell.x as usize / 64];
            let bit = 1 << (cell.x % 64);
            *word = if value { *word | bit } else { *word & !bit };
        }
    }

    /// Transpose: bit (x, y) goes to (y, x). Linear in the words.
    #[must_use]
    pub fn transposed(&self) -> Self {
        let mut turned = Self::new(self.height, self.width);
        let mut block = [0; 64];
        for row in 0..turned.stride {
            let rows = (row * 64)..(self.height as usize).min(row * 64 + 64);
            for word in 0..self.stride {
                block.fill(0);
                for (to, y) in block.iter_mut().zip(rows.clone()) {
                    *to = self.words[y * self.stride + word];
                }
                transpose(&mut block);
                let columns = (word * 64)..(self.width as usize).min(word * 64 + 64);
                for (from, x) in block.iter().zip(columns) {
                    turned.words[x * turned.stride + row] = *from;
                }
            }
        }
        turned
    }

    /// Number of set bits.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.words.iter().map(|word| u64::from(word.count_ones())).sum()
    }

    /// Whether any of the columns `from` to `to` of row `y` is set.
    ///
    /// # Panics
    /// For columns or a row outside the grid.
    #[must_use]
    #[inline(always)]
    pub fn any_set(&self, y: u32, from: u32, to: u32) -> bool {
        let row = self.row(y);
        let (first, last) = ((from / 64) as usize, (to / 64) as usize);
        let (head, tail) = (u64::MAX << (from % 64), u64::MAX >> (63 - to % 64));
        if first == last {
            return row[first] & head & tail != 0;
        }
        row[first] & head | row[last] & tail != 0 || row[first + 1..last].iter().any(|word| *word != 0)
    }

    /// The inverted bitmap.
    #[must_use]
    pub fn complement(&self) -> Self {
        let mut bits = self.clone();
        let edge = u64::MAX >> ((64 - self.width % 64) % 64);
        for y in 0..self.height {
            let row = bits.row_mut(y);
            row.iter_mut().for_each(|word| *word = !*word);
            if let Some(last) = row.last_mut() {
                *last &= edge;
            }
        }
        bits
    }

    /// The first set column of row `y` in `from..=to`; columns outside the grid are never set.
    #[must_use]
    pub fn next_set(&self, y: u32, from: i64, to: i64) -> Option<u32> {
        let (from, to) = self.clamp_columns(y, from, to)?;
        let row = self.row(y);
        let (first, last) = (from / 64, to / 64);
        let mut word = row[first] & (u64::MAX << (from % 64));
        let mut at = first;
        loop {
            if at == last {
                word &= u64::MAX >> (63 - to % 64);
            }
            if word != 0 {
                return Some((at * 64) as u32 + word.trailing_zeros());
            }
            if at == last {
                return None;
            }
            at += 1;
            word = row[at];
        }
    }

    /// The last set column of row `y` in `from..=to`; columns outside the grid are never set.
    #[must_use]
    pub fn previous_set(&self, y: u32, from: i64, to: i64) -> Option<u32> {
        let (from, to) = self.clamp_columns(y, from, to)?;
        let row = self.row(y);
        let (first, last) = (from / 64, to / 64);
        let mut word = row[last] & (u64::MAX >> (63 - to % 64));
        let mut at = last;
        loop {
            if at == first {
                word &= u64::MAX << (from % 64);
            }
            if word != 0 {
                return Some((at * 64) as u32 + 63 - word.leading_zeros());
            }
            if at == first {
                return None;
            }
            at -= 1;
            word = row[at];
        }
    }

    /// All set columns of row `y` in `from..=to`, in order.
    pub fn set_in_row(&self, y: u32, from: i64, to: i64) -> impl Iterator<Item = u32> + '_ {
        let mut next = from;
        std::iter::from_fn(move || {
            let x = self.next_set(y, next, to)?;
            next = i64::from(x) + 1;
            Some(x)
        })
    }

    fn clamp_columns(&self, y: u32, from: i64, to: i64) -> Option<(usize, usize)> {
        let (from, to) = (from.max(0), to.min(i64::from(self.width) - 1));
        (y < self.height && from <= to).then_some((from as usize, to as usize))
    }
}

/// A predicate of 64 values as bits, the first value in the lowest bit.
#[inline]
#[allow(
    clippy::needless_range_loop,
    reason = "a loop over zipped arrays does not become vector instructions everywhere"
)]
pub(super) fn pack<T: Copy>(values: &[T; 64], is: impl Fn(T) -> bool) -> u64 {
    let mut flags = [0_u8; 64];
    for i in 0..64 {
        flags[i] = u8::from(is(values[i]));
    }
    let mut word = 0;
    for (byte, flags) in flags.as_chunks::<8>().0.iter().enumerate() {
        // Each flag is the lowest bit of its byte; the product brings all of them side by side into the highest byte.
        word |= (u64::from_le_bytes(*flags).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * byte);
    }
    word
}

/// Transposes 64 by 64 bits: halves are swapped across the diagonal, then halves of halves (Warren, "Hacker's Delight", 7-3).
fn transpose(block: &mut [u64; 64]) {
    let (mut size, mut mask) = (32, u64::from(u32::MAX));
    while size > 0 {
        for low in (0..64).filter(|row| row & size == 0) {
            let swapped = (block[low] >> size ^ block[low + size]) & mask;
            block[low] ^= swapped << size;
            block[low + size] ^= swapped;
        }
        size /= 2;
        mask ^= mask << size;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_nearest_set_columns_are_those_of_a_plain_search(set in proptest::collection::btree_set(0_u32..200, 0..20), from in -20_i64..220, length in -5_i64..230) {
            let to = from + length;
            let bits = BitGrid::from_fn(200, 1, |cell| set.contains(&cell.x));
            let inside: Vec<u32> = set.iter().copied().filter(|x| i64::from(*x) >= from && i64::from(*x) <= to).collect();
            prop_assert_eq!(bits.next_set(0, from, to), inside.first().copied());
            prop_assert_eq!(bits.previous_set(0, from, to), inside.last().copied());
            if from >= 0 && to < 200 && from <= to {
                prop_assert_eq!(bits.any_set(0, from as u32, to as u32), !inside.is_empty());
            }
            prop_assert_eq!(bits.complement(), BitGrid::from_fn(200, 1, |cell| !set.contains(&cell.x)));
            prop_assert_eq!(bits.set_in_row(0, from, to).collect::<Vec<_>>(), inside);
            prop_assert_eq!(bits.count(), set.len() as u64);
        }

        #[test]
        fn rows_become_columns(width in 0_u32..150, height in 0_u32..150, seed in any::<u64>()) {
            let is_set = |x: u32, y: u32| ((u64::from(x) * 0x9E37_79B9) ^ (u64::from(y) * 0xC2B2_AE3D) ^ seed).wrapping_mul(0xD6E8_FEB8_6659_FD93) >> 63 == 1;
            let turned = BitGrid::from_fn(width, height, |cell| is_set(cell.x, cell.y)).transposed();
            prop_assert_eq!(turned, BitGrid::from_fn(height, width, |cell| is_set(cell.y, cell.x)));
        }
    }

    proptest! {
        #[test]
        fn flags_are_packed_in_order(word in any::<u64>()) {
            prop_assert_eq!(pack(&std::array::from_fn(|bit| word >> bit & 1), |bit: u64| bit == 1), word);
        }
    }

    #[test]
    fn nothing_is_set_outside_the_grid() {
        let mut bits = BitGrid::new(70, 2);
        bits.set(Cell::new(69, 1), true);
        bits.set(Cell::new(70, 1), true);
        assert!(bits.get(Cell::new(69, 1)) && !bits.get(Cell::new(70, 1)) && !bits.get(Cell::new(69, 2)));
        assert_eq!(bits.count(), 1);
        assert_eq!(bits.next_set(5, 0, 100), None);
    }
}
