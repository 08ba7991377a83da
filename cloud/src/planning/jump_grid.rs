//! Where does a run over free cells end? At an obstacle, or where one beside it ends: bitmaps of those stops, one for each direction.
//!
//! A run along a row or a column is a look for the next bit, 64 cells at a time; columns have bitmaps of their own, transposed.
//!
//! Source: Harabor and Grastien, "Improving Jump Point Search", ICAPS 2014 (block scanning).

use super::lattice::Lattice;

/// Directions of straight runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    East,
    West,
    North,
    South,
}

impl Direction {
    pub(super) const ALL: [Self; 4] = [Self::East, Self::West, Self::North, Self::South];

    /// Columns and rows of a step.
    pub(super) const fn step(self) -> (i32, i32) {
        match self {
            Self::East => (1, 0),
            Self::West => (-1, 0),
            Self::North => (0, 1),
            Self::South => (0, -1),
        }
    }
}

/// Directions of diagonal runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Diagonal {
    NorthEast,
    NorthWest,
    SouthEast,
    SouthWest,
}

impl Diagonal {
    pub(super) const ALL: [Self; 4] = [Self::NorthEast, Self::NorthWest, Self::SouthEast, Self::SouthWest];

    /// The two straight directions that it goes in.
    pub(super) const fn sides(self) -> [Direction; 2] {
        match self {
            Self::NorthEast => [Direction::East, Direction::North],
            Self::NorthWest => [Direction::West, Direction::North],
            Self::SouthEast => [Direction::East, Direction::South],
            Self::SouthWest => [Direction::West, Direction::South],
        }
    }
}

/// The stops of a lattice. Columns and rows count from the lattice's border.
#[derive(Clone, Debug)]
pub struct JumpGrid {
    /// By direction; rows for east and west, columns for north and south.
    stops: [Vec<u64>; 4],
    /// By direction; diagonals, by row.
    turns: [Vec<u64>; 4],
    /// Words a row and a column.
    strides: [usize; 2],
}

impl JumpGrid {
    /// Prepares a lattice: linear in its words.
    #[must_use]
    pub fn new(lattice: &Lattice) -> Self {
        let stride = lattice.pitch() as usize / 64;
        let height = lattice.len() / lattice.pitch() as usize;
        let column_stride = height.div_ceil(64);
        let rows = &lattice.words()[..height * stride];
        let columns = transposed(rows, stride, height);
        let [east, west] = stops(rows, stride);
        let [north, south] = stops(&columns, column_stride);
        let mut turns = [const { Vec::new() }; 4];
        let [to_east, to_west] = leads(rows, [&east, &west], stride);
        let [to_north, to_south] =
            leads(&columns, [&north, &south], column_stride).map(|to| transposed(&to, column_stride, stride * 64));
        let square = squares(rows, stride);
        for (i, diagonal) in Diagonal::ALL.iter().enumerate() {
            let [dx, dy] = match diagonal {
                Diagonal::NorthEast => [1, 1],
                Diagonal::NorthWest => [-1, 1],
                Diagonal::SouthEast => [1, -1],
                Diagonal::SouthWest => [-1, -1],
            };
            let side = if dx > 0 { &to_east } else { &to_west };
            let up = if dy > 0 { &to_north } else { &to_south };
            let mut all = vec![u64::MAX; height * stride];
            for y in 1..height - 1 {
                for w in 0..stride {
                    let at = y * stride + w;
                    let sq = if dy > 0 {
                        &square[y * stride..][..stride]
                    } else {
                        &square[(y - 1) * stride..][..stride]
                    };
                    let can = if dx > 0 {
                        sq[w]
                    } else {
                        sq[w] << 1 | w.checked_sub(1).map_or(0, |w| sq[w] >> 63)
                    };
                    all[at] = side[at] | up[at] | !can;
                }
            }
            turns[i] = sheared(&all, stride, height, dx * dy);
        }
        Self {
            stops: [east, west, north, south],
            turns,
            strides: [stride, column_stride],
        }
    }

    /// Where a run from a free cell stops: the column going east or west, the row going north or south.
    #[inline]
    pub(super) fn stop(&self, direction: Direction, x: u32, y: u32) -> u32 {
        let [row, column] = self.strides;
        match direction {
            Direction::East => forward(&self.stops[0], row, y, x),
            Direction::West => backward(&self.stops[1], row, y, x),
            Direction::North => forward(&self.stops[2], column, x, y),
            Direction::South => backward(&self.stops[3], column, x, y),
        }
    }

    /// The row where a diagonal run stops.
    #[inline]
    pub(super) fn turn(&self, direction: Diagonal, x: u32, y: u32) -> u32 {
        let [row, column] = self.strides;
        let pitch = row as u32 * 64;
        let (falling, rising) = ((x + pitch - y % pitch) % pitch, (x + y) % pitch);
        match direction {
            Diagonal::NorthEast => forward(&self.turns[0], column, falling, y),
            Diagonal::NorthWest => forward(&self.turns[1], column, rising, y),
            Diagonal::SouthEast => backward(&self.turns[2], column, rising, y),
            Diagonal::SouthWest => backward(&self.turns[3], column, falling, y),
        }
    }
}

/// The next stop at a higher position of a line.
#[inline]
fn forward(stops: &[u64], stride: usize, line: u32, from: u32) -> u32 {
    let start = line as usize * stride;
    let mut word = start + from as usize / 64;
    let mut found = stops[word] & ((u64::MAX << (from % 64)) << 1);
    while found == 0 {
        word += 1;
        // The border stops whatever comes so far.
        found = stops[word];
    }
    (word - start) as u32 * 64 + found.trailing_zeros()
}

/// The next stop at a lower position of a line.
#[inline]
fn backward(stops: &[u64], stride: usize, line: u32, from: u32) -> u32 {
    let start = line as usize * stride;
    let mut word = start + from as usize / 64;
    let mut found = stops[word] & !(u64::MAX << (from % 64));
    while found == 0 {
        word -= 1;
        found = stops[word];
    }
    (word - start) as u32 * 64 + 63 - found.leading_zeros()
}

/// Stops of runs towards higher and towards lower positions along each line of free cells.
fn stops(free: &[u64], stride: usize) -> [Vec<u64>; 2] {
    let mut up: Vec<u64> = free.iter().map(|bits| !bits).collect();
    let mut down = up.clone();
    let lines = free.len() / stride;
    for line in 0..lines {
        let bits = &free[line * stride..][..stride];
        for (at, here) in bits.iter().enumerate() {
            if *here == 0 {
                continue;
            }
            let before = at.checked_sub(1).map_or(0, |at| bits[at] >> 63);
            let after = bits.get(at + 1).map_or(0, |bits| bits << 63);
            // Free cells behind which an obstacle ends: a run beside them may turn there.
            let (ends_up, ends_down) = (here & !(here << 1 | before), here & !(here >> 1 | after));
            // The border's lines hold no free cell, so that there are lines on both sides.
            for beside in [line - 1, line + 1] {
                up[beside * stride + at] |= ends_up;
                down[beside * stride + at] |= ends_down;
            }
        }
    }
    [up, down]
}

/// Cells from which a run along the line leads to a jump point: towards higher and towards lower positions.
fn leads(free: &[u64], stops: [&[u64]; 2], stride: usize) -> [Vec<u64>; 2] {
    let mut result = [vec![0; free.len()], vec![0; free.len()]];
    for line in 0..free.len() / stride {
        let at = line * stride;
        let mut carry = false;
        for word in at..at + stride {
            // As the carries of a sum: made by a jump point, handed on by whatever is no stop.
            let jumps = stops[1][word] & free[word];
            let (sum, over) = carrying_add(jumps | !stops[1][word], jumps, carry);
            result[1][word] = sum ^ (jumps | !stops[1][word]) ^ jumps;
            carry = over;
        }
        carry = false;
        for word in (at..at + stride).rev() {
            let jumps = (stops[0][word] & free[word]).reverse_bits();
            let pass = jumps | !stops[0][word].reverse_bits();
            let (sum, over) = carrying_add(pass, jumps, carry);
            result[0][word] = (sum ^ pass ^ jumps).reverse_bits();
            carry = over;
        }
    }
    result
}

fn carrying_add(a: u64, b: u64, carry: bool) -> (u64, bool) {
    let (sum, first) = a.overflowing_add(b);
    let (sum, second) = sum.overflowing_add(u64::from(carry));
    (sum, first || second)
}

/// Cells that are free together with those to the right, above, and both.
fn squares(rows: &[u64], stride: usize) -> Vec<u64> {
    let mut result = vec![0; rows.len()];
    for y in 0..rows.len() / stride - 1 {
        let mut carry = 0;
        for word in (0..stride).rev() {
            let both = rows[y * stride + word] & rows[(y + 1) * stride + word];
            result[y * stride + word] = both & (both >> 1 | carry << 63);
            carry = both & 1;
        }
    }
    result
}

/// Diagonals for rows: cell (x, y) at bit y of line x - y * slope, modulo the row's bits.
fn sheared(rows: &[u64], stride: usize, height: usize, slope: i32) -> Vec<u64> {
    let pitch = stride * 64;
    let column_stride = height.div_ceil(64);
    let mut lines = vec![0; column_stride * pitch];
    for band in 0..column_stride {
        for word in 0..stride {
            let mut block = [u64::MAX; 64];
            for (row, bits) in block.iter_mut().enumerate().take(height - band * 64) {
                let y = band * 64 + row;
                let from = if slope > 0 {
                    (word * 64 + y) % pitch
                } else {
                    (word * 64 + pitch - y % pitch) % pitch
                };
                let line = &rows[y * stride..][..stride];
                let (at, bit) = (from / 64, from % 64);
                *bits = line[at] >> bit | (line[(at + 1) % stride] << 1) << (63 - bit);
            }
            transpose(&mut block);
            for (column, bits) in block.into_iter().enumerate() {
                lines[(word * 64 + column) * column_stride + band] = bits;
            }
        }
    }
    lines
}

/// Columns for rows.
fn transposed(rows: &[u64], stride: usize, height: usize) -> Vec<u64> {
    let column_stride = height.div_ceil(64);
    let mut columns = vec![0; column_stride * stride * 64];
    for band in 0..column_stride {
        for word in 0..stride {
            let mut block = [0_u64; 64];
            for (row, bits) in block.iter_mut().enumerate().take(height - band * 64) {
                *bits = rows[(band * 64 + row) * stride + word];
            }
            if block.iter().any(|bits| *bits != 0) {
                transpose(&mut block);
                for (column, bits) in block.into_iter().enumerate() {
                    columns[(word * 64 + column) * column_stride + band] = bits;
                }
            }
        }
    }
    columns
}

/// Swaps rows and columns of a block of bits (Warren, "Hacker's Delight", 7-3).
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

    #[test]
    fn a_block_is_transposed() {
        let mut block = [0_u64; 64];
        for (row, bits) in block.iter_mut().enumerate() {
            *bits = (row as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        }
        let original = block;
        transpose(&mut block);
        for (row, bits) in block.iter().enumerate() {
            for (column, before) in original.iter().enumerate() {
                assert_eq!(bits >> column & 1, before >> row & 1);
            }
        }
    }
}
