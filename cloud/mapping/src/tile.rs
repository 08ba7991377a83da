//! What is known of one square of cells? Log-odds, a byte a cell, and which cells have nothing more to learn.
//!
//! Most looks tell what has been known for long: a cell that is as free as cells get is seen to be free once more. A bit for
//! each such cell spares its byte: a scan's whole footprint is compared 64 cells at a time, and only bytes that change are touched.

use zenav_protocol::grid::Occupancy;

use super::sensor_model::{Evidence, UNSEEN};
use super::tiles::TILE_SIDE;

/// Bits of a tile's cells, a word a row, the lowest row first and the lowest bit left.
pub(super) type Bits = [u64; TILE_SIDE];

/// So many cells of a row are changed one by one; when there are more, all others are computed at once.
const FEW: usize = 4;

/// Eight bits as eight bytes, 255 for a set bit.
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

/// A square of `TILE_SIDE` by `TILE_SIDE` cells.
#[derive(Clone, Debug)]
pub(super) struct EvidenceTile {
    /// Bytes of [`Evidence`], row by row from the lowest.
    cells: [[u8; TILE_SIDE]; TILE_SIDE],
    /// Cells that another miss leaves as they are.
    freest: Bits,
    /// Cells that another hit leaves as they are.
    fullest: Bits,
    /// Free and occupied cells, unless something changed since they were counted.
    counted: Option<[u16; 2]>,
}

impl EvidenceTile {
    /// Nobody has seen any of it.
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

    /// Cells that are as free as cells get.
    pub(super) fn freest(&self) -> &Bits {
        &self.freest
    }

    /// Writes a cell.
    pub(super) fn set(&mut self, x: usize, y: usize, byte: u8, evidence: &Evidence) {
        let (row, bit) = (y % TILE_SIDE, 1 << (x % TILE_SIDE));
        self.cells[row][x % TILE_SIDE] = byte;
        self.counted = None;
        mark(&mut self.freest[row], bit, byte == evidence.least);
        mark(&mut self.fullest[row], bit, byte == evidence.most);
    }

    /// Takes notice of one scan: a hit in every cell of `hits`, a miss in every other cell of `seen`. Says whether anything changed.
    pub(super) fn look(&mut self, seen: &Bits, hits: &Bits, evidence: &Evidence) -> bool {
        let mut changed = false;
        for row in 0..TILE_SIDE {
            let missed = seen[row] & !hits[row] & !self.freest[row];
            let hit = hits[row] & !self.fullest[row];
            if missed | hit == 0 {
                continue;
            }
            changed = true;
            self.miss(row, missed, evidence);
            self.hit(row, hit, evidence);
        }
        if changed {
            self.counted = None;
        }
        changed
    }

    /// Free and occupied cells; quick where they were [kept](Self::keep_counts) since the last change.
    pub(super) fn counts(&self, evidence: &Evidence) -> [u16; 2] {
        self.counted.unwrap_or_else(|| {
            let mut histogram = [0_u16; 256];
            for byte in self.cells.as_flattened() {
                histogram[usize::from(*byte)] += 1;
            }
            let mut counts = [0; 2];
            for (count, percent) in histogram.iter().zip(&evidence.percent) {
                match Occupancy::of(*percent) {
                    Occupancy::Free => counts[0] += count,
                    Occupancy::Occupied => counts[1] += count,
                    Occupancy::Unknown => {}
                }
            }
            counts
        })
    }

    /// Counts now, so that the next [`counts`](Self::counts) need not.
    pub(super) fn keep_counts(&mut self, evidence: &Evidence) {
        self.counted = Some(self.counts(evidence));
    }

    fn miss(&mut self, row: usize, mut missed: u64, evidence: &Evidence) {
        let cells = &mut self.cells[row];
        self.fullest[row] &= !missed;
        for _ in 0..FEW {
            if missed == 0 {
                return;
            }
            let (x, bit) = (missed.trailing_zeros() as usize, missed & missed.wrapping_neg());
            let after = evidence.after_miss(cells[x]);
            cells[x] = after;
            self.freest[row] |= if after == evidence.least { bit } else { 0 };
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
            *cell ^= (evidence.after_miss(*cell) ^ *cell) & mask;
        }
        self.freest[row] = equal(cells, evidence.least);
    }

    fn hit(&mut self, row: usize, mut hit: u64, evidence: &Evidence) {
        let cells = &mut self.cells[row];
        self.freest[row] &= !hit;
        while hit != 0 {
            let (x, bit) = (hit.trailing_zeros() as usize, hit & hit.wrapping_neg());
            let after = evidence.after_hit(cells[x]);
            cells[x] = after;
            self.fullest[row] |= if after == evidence.most { bit } else { 0 };
            hit ^= bit;
        }
    }
}

fn mark(bits: &mut u64, bit: u64, set: bool) {
    *bits = *bits & !bit | if set { bit } else { 0 };
}

/// A bit for every byte that has this value.
fn equal(bytes: &[u8; TILE_SIDE], value: u8) -> u64 {
    const LOW_SEVEN: u64 = 0x7f7f_7f7f_7f7f_7f7f;
    let wanted = u64::from_ne_bytes([value; 8]);
    let mut bits = 0;
    for (at, eight) in bytes.as_chunks::<8>().0.iter().enumerate() {
        let differ = u64::from_le_bytes(*eight) ^ wanted;
        // The highest bit of each byte that is zero; then the product brings all eight into the highest byte.
        let zero = !(((differ & LOW_SEVEN) + LOW_SEVEN) | differ | LOW_SEVEN);
        bits |= ((zero >> 7).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * at);
    }
    bits
}
