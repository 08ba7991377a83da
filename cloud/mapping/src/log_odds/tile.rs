//! Tile. Log-odds of one block of cells.
//!
//! One byte of log-odds for each cell. Most observations change nothing: a cell at the lower clamp is seen free again. One bit for each
//! clamped cell saves touching its byte: a scan's whole area is compared 64 cells at a time, and only bytes that change are touched.

use zenav_protocol::grid::Occupancy;

use super::tiles::TILE_SIDE;
use crate::sensor_model::{QuantizedModel, UNSEEN};

/// One bit for each cell of a tile: one word for each row, the lowest row first, the lowest bit on the left.
pub(super) type Bits = [u64; TILE_SIDE];

/// Up to this number of cells of a row are updated one by one; beyond it, the whole row at once.
const FEW: usize = 4;

/// Eight bits as eight bytes: 255 for a set bit, 0 for a clear one.
const BYTES_OF_BITS: [[u8; 8]; 256] = {
    let mut table = [[0; 8]; 256];
    let mut at = 0;
    while at < 256 * 8 {
        if (at / 8) >> (at % 8) & 1 == 1 {
            table[at / 8][at % 8] = 255;
        }
        at += 1;
    }
    table
};

/// A block of `TILE_SIDE` by `TILE_SIDE` cells.
#[derive(Clone, Debug)]
pub(super) struct LogOddsTile {
    /// Log-odds as bytes of the [`QuantizedModel`], row by row from the lowest.
    cells: [[u8; TILE_SIDE]; TILE_SIDE],
    /// Cells at the lower clamp: another miss leaves them as they are.
    freest: Bits,
    /// Cells at the upper clamp: another hit leaves them as they are.
    fullest: Bits,
    /// Number of free and occupied cells, unless a cell changed since they were counted.
    counted: Option<[u16; 2]>,
}

impl LogOddsTile {
    /// A tile that was never seen.
    pub(super) const UNSEEN: Self = Self {
        cells: [[UNSEEN; TILE_SIDE]; TILE_SIDE],
        freest: [0; TILE_SIDE],
        fullest: [0; TILE_SIDE],
        counted: Some([0, 0]),
    };

    /// Bytes, row by row from the lowest.
    pub(super) fn rows(&self) -> &[[u8; TILE_SIDE]; TILE_SIDE] {
        &self.cells
    }

    /// Cells at the lower clamp.
    pub(super) fn freest(&self) -> &Bits {
        &self.freest
    }

    /// Writes the byte of a cell.
    pub(super) fn set(&mut self, x: usize, y: usize, byte: u8, model: &QuantizedModel) {
        let (row, bit) = (y % TILE_SIDE, 1 << (x % TILE_SIDE));
        self.cells[row][x % TILE_SIDE] = byte;
        self.counted = None;
        mark(&mut self.freest[row], bit, byte == model.least);
        mark(&mut self.fullest[row], bit, byte == model.most);
    }

    /// Applies one scan: a hit to every cell of `hits`, a miss to every other cell of `seen`. Returns whether any cell changed.
    pub(super) fn update(&mut self, seen: &Bits, hits: &Bits, model: &QuantizedModel) -> bool {
        let mut changed = false;
        for row in 0..TILE_SIDE {
            let missed = seen[row] & !hits[row] & !self.freest[row];
            let hit = hits[row] & !self.fullest[row];
            if missed | hit == 0 {
                continue;
            }
            changed = true;
            self.miss(row, missed, model);
            self.hit(row, hit, model);
        }
        if changed {
            self.counted = None;
        }
        changed
    }

    /// Number of free and occupied cells; cheap if they were [cached](Self::cache_counts) since the last change.
    pub(super) fn counts(&self, model: &QuantizedModel) -> [u16; 2] {
        self.counted.unwrap_or_else(|| {
            let mut histogram = [0_u16; 256];
            for byte in self.cells.as_flattened() {
                histogram[usize::from(*byte)] += 1;
            }
            let mut counts = [0; 2];
            for (byte, count) in (0..=u8::MAX).zip(histogram) {
                match Occupancy::of(model.percent(byte)) {
                    Occupancy::Free => counts[0] += count,
                    Occupancy::Occupied => counts[1] += count,
                    Occupancy::Unknown => {}
                }
            }
            counts
        })
    }

    /// Counts now, so that the next [`counts`](Self::counts) is cheap.
    pub(super) fn cache_counts(&mut self, model: &QuantizedModel) {
        self.counted = Some(self.counts(model));
    }

    fn miss(&mut self, row: usize, mut missed: u64, model: &QuantizedModel) {
        let cells = &mut self.cells[row];
        self.fullest[row] &= !missed;
        for _ in 0..FEW {
            if missed == 0 {
                return;
            }
            let (x, bit) = (missed.trailing_zeros() as usize, missed & missed.wrapping_neg());
            let after = model.after_miss(cells[x]);
            cells[x] = after;
            self.freest[row] |= if after == model.least { bit } else { 0 };
            missed ^= bit;
        }
        if missed == 0 {
            return;
        }
        let mut mask = [0; TILE_SIDE];
        for (mask, bits) in mask.as_chunks_mut::<8>().0.iter_mut().zip(missed.to_le_bytes()) {
            *mask = BYTES_OF_BITS[usize::from(bits)];
        }
        for (cell, mask) in cells.iter_mut().zip(&mask) {
            *cell ^= (model.after_miss(*cell) ^ *cell) & mask;
        }
        self.freest[row] = equal(cells, model.least);
    }

    fn hit(&mut self, row: usize, mut hit: u64, model: &QuantizedModel) {
        let cells = &mut self.cells[row];
        self.freest[row] &= !hit;
        while hit != 0 {
            let (x, bit) = (hit.trailing_zeros() as usize, hit & hit.wrapping_neg());
            let after = model.after_hit(cells[x]);
            cells[x] = after;
            self.fullest[row] |= if after == model.most { bit } else { 0 };
            hit ^= bit;
        }
    }
}

fn mark(bits: &mut u64, bit: u64, set: bool) {
    *bits = *bits & !bit | if set { bit } else { 0 };
}

/// One bit for each byte, set where the byte has this value.
fn equal(bytes: &[u8; TILE_SIDE], value: u8) -> u64 {
    const LOW_SEVEN: u64 = 0x7f7f_7f7f_7f7f_7f7f;
    let wanted = u64::from_ne_bytes([value; 8]);
    let mut bits = 0;
    for (at, eight) in bytes.as_chunks::<8>().0.iter().enumerate() {
        let differ = u64::from_le_bytes(*eight) ^ wanted;
        // The highest bit of each byte that is zero; the product then gathers all eight in the highest byte.
        let zero = !(((differ & LOW_SEVEN) + LOW_SEVEN) | differ | LOW_SEVEN);
        bits |= ((zero >> 7).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * at);
    }
    bits
}
