//! Scan bitmap. The cells that one scan passed, and those that it hit.
//!
//! Beams only set bits in bitmaps over the scan's bounding box; the map itself is updated once for each scan, tile by tile.

use nalgebra::{Point2, Vector2};

use super::InsertMode;
use super::tile::Bits;
use super::tiles::TILE_SIDE;
use crate::beams::Beam;

/// Bits for the tiles that one scan can touch, all clear between two scans.
///
/// The words are stored by columns: first all rows of the first column of tiles. So a rising ray goes from word to word, and the words of a
/// tile are contiguous. Coordinates are in cells from the bitmap's lower-left corner.
#[derive(Clone, Debug, Default)]
pub(super) struct ScanBitmap {
    /// Tile column and row of the lower-left corner, from the map's anchor.
    first: [i64; 2],
    /// Tiles in each direction.
    counts: [usize; 2],
    /// Number of rows of cells.
    height: usize,
    /// Cells that beams passed.
    cleared: Vec<u64>,
    /// Cells in which beams ended.
    hits: Vec<u64>,
    /// Borders of filled wedges: bits at which a row changes between inside and outside.
    flips: Vec<u64>,
    /// Whether a tile has any bit set, in the order of the words.
    touched: Vec<bool>,
}

/// Fractional bits of a fixed-point number.
const FRACTION: u32 = 32;

/// Differences in length below this need no border or ray of their own, cells.
const SMALL_STEP: f64 = 0.25;

/// Neighbouring beams whose lengths differ by at most this ended on one surface, cells.
const ONE_SURFACE: f64 = 1.0;

/// Beams at most this far apart, in cells, miss hardly any cell of a surface on which they ended.
const CLOSE: f64 = 0.7;

/// Between beams at most this far apart, m, hardly any obstacle fits that neither beam hits; thinner ones are seen from closer up.
const APART: f64 = 0.1;

/// A cell that a ray meets has its centre at most this far along the ray, cells.
const HALF_DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Converts a coordinate to fixed point, rounding to nearest. Meaningless for coordinates beyond every grid.
///
/// Adding 1.5 * 2^20 leaves 32 fractional bits in the mantissa, without the comparisons of a saturating conversion.
fn fixed(cells: f64) -> i64 {
    const SHIFT: f64 = 1_572_864.0;
    (cells + SHIFT).to_bits().wrapping_sub(SHIFT.to_bits()).cast_signed()
}

/// Column or row of a coordinate.
fn whole(cells: f64) -> i64 {
    fixed(cells) >> FRACTION
}

/// Distances from the origin, cells, up to which neighbouring beams are close to each other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spacing {
    /// At most one cell.
    dense: f64,
    /// At most [`APART`].
    close: f64,
}

impl Spacing {
    /// For beams with this angle between them, rad, and cells with this side, m.
    pub(super) fn new(angle: f64, resolution: f64) -> Self {
        Self {
            dense: angle.recip(),
            close: APART / (resolution * angle),
        }
    }
}

/// How far two beams have both passed the space between them, cells; 0 unless they are neighbours. Near their ends there may be a surface.
fn passed_between(a: &Beam, b: &Beam, spacing: Spacing) -> f64 {
    if a.number + 1 == b.number {
        (a.length.min(b.length) - ONE_SURFACE).clamp(0.0, spacing.close)
    } else {
        0.0
    }
}

impl ScanBitmap {
    /// Places the bitmap over tiles, counted from the map's anchor.
    pub(super) fn lay(&mut self, first: [i64; 2], counts: [usize; 2]) {
        (self.first, self.counts, self.height) = (first, counts, counts[1] * TILE_SIDE);
        let tiles = counts[0] * counts[1];
        if self.touched.len() < tiles {
            self.touched.resize(tiles, false);
            for bits in [&mut self.cleared, &mut self.hits, &mut self.flips] {
                bits.resize(tiles * TILE_SIDE, 0);
            }
        }
    }

    /// Lower-left corner of the bitmap, in cells from the map's anchor.
    pub(super) fn corner(&self) -> Vector2<f64> {
        Vector2::new(self.first[0] as f64, self.first[1] as f64) * TILE_SIDE as f64
    }

    /// Hands over every tile with a set bit (cells that were passed or hit, and cells that were hit), and clears its bits.
    pub(super) fn take(&mut self, mut tile: impl FnMut([i64; 2], &Bits, &Bits)) {
        for row in 0..self.counts[1] {
            // Rows that are inside a wedge at the right border of the last tile.
            let mut inside = [0; TILE_SIDE];
            let mut any_inside = false;
            for column in 0..self.counts[0] {
                let index = column * self.counts[1] + row;
                let at = [self.first[0] + column as i64, self.first[1] + row as i64];
                if !std::mem::take(&mut self.touched[index]) {
                    if any_inside {
                        tile(at, &inside, &[0; TILE_SIDE]);
                    }
                    continue;
                }
                let bits = index * TILE_SIDE;
                let take = |bitmap: &mut Vec<u64>| -> Bits {
                    let mut bits_of_tile = [0; TILE_SIDE];
                    bits_of_tile.swap_with_slice(&mut bitmap[bits..bits + TILE_SIDE]);
                    bits_of_tile
                };
                let (mut seen, hits, flips) = (take(&mut self.cleared), take(&mut self.hits), take(&mut self.flips));
                let mut any = 0;
                for ((seen, flips), inside) in seen.iter_mut().zip(flips).zip(&mut inside) {
                    let mut filled = flips;
                    for shift in [1, 2, 4, 8, 16, 32] {
                        filled ^= filled << shift;
                    }
                    filled ^= *inside;
                    *seen |= filled;
                    *inside = (filled >> 63).wrapping_neg();
                    any |= *inside;
                }
                any_inside = any != 0;
                tile(at, &seen, &hits);
            }
        }
    }

    /// Has a tile handed over even if no beam passes it; one outside the bitmap is ignored.
    pub(super) fn visit(&mut self, tile: [i64; 2]) {
        let at = [0, 1].map(|axis| usize::try_from(tile[axis] - self.first[axis]).unwrap_or(usize::MAX));
        if at[0] < self.counts[0] && at[1] < self.counts[1] {
            self.touched[at[0] * self.counts[1] + at[1]] = true;
        }
    }

    /// Marks the cells that the beams passed and in which they ended. The space between two close beams that both pass it counts as passed
    /// too, since a beam has a width.
    pub(super) fn draw(&mut self, origin: Point2<f64>, beams: &[Beam], spacing: Spacing, mode: InsertMode) {
        let corner = self.corner();
        let origin = origin - corner;
        let here = |beam: &Beam| Beam {
            end: beam.end - corner,
            ..*beam
        };
        let beams = beams.iter().map(here);
        match mode {
            InsertMode::Fast => self.fill(origin, beams, spacing),
            InsertMode::Reference => self.rays(origin, beams, spacing),
        }
    }

    /// Draws beam by beam, with rays between neighbours that are more than a cell apart.
    fn rays(&mut self, origin: Point2<f64>, beams: impl Iterator<Item = Beam>, spacing: Spacing) {
        let dense = spacing.dense;
        let mut before: Option<Beam> = None;
        for beam in beams {
            if beam.hit {
                self.hit(beam.end);
            }
            self.ray(origin, beam.end);
            let Some(last) = before.replace(beam) else {
                continue;
            };
            let passed = passed_between(&last, &beam, spacing);
            // Enough rays that neighbours are at most a cell apart.
            let between = (passed / dense).ceil().max(1.0);
            for nth in 1..between as u32 {
                let direction = last.direction.lerp(&beam.direction, f64::from(nth) / between);
                self.ray(origin + direction * dense, origin + direction * passed);
            }
        }
    }

    /// Sets bits of a word, unless it lies outside the bitmap.
    #[inline(always)]
    fn set(bits: &mut [u64], touched: &mut [bool], word: usize, mask: u64) {
        if let Some(bits) = bits.get_mut(word)
            && let Some(touched) = touched.get_mut(word / TILE_SIDE)
        {
            *bits |= mask;
            *touched = true;
        }
    }

    /// Marks the cell in which a beam ended.
    #[inline(always)]
    fn hit(&mut self, p: Point2<f64>) {
        let (x, y) = (whole(p.x) as usize, whole(p.y) as usize);
        let word = (x / 64).wrapping_mul(self.height).wrapping_add(y);
        Self::set(&mut self.hits, &mut self.touched, word, 1 << (x % 64));
    }

    /// Marks a cell as passed, even if a beam ended in it.
    pub(super) fn clear(&mut self, x: usize, y: usize) {
        let (word, bit) = (x / 64 * self.height + y, 1 << (x % 64));
        if let Some(hits) = self.hits.get_mut(word) {
            *hits &= !bit;
        }
        Self::set(&mut self.cleared, &mut self.touched, word, bit);
    }

    /// Marks columns `low..=high` (fixed point) of a row as passed.
    #[inline(always)]
    fn run(&mut self, row: usize, low: i64, high: i64) {
        let (low, high) = ((low >> FRACTION) as usize, (high >> FRACTION) as usize);
        let (first, last) = (low / 64, high / 64);
        let (head, tail) = (u64::MAX << (low % 64), u64::MAX >> (63 - high % 64));
        let mut word = first.wrapping_mul(self.height).wrapping_add(row);
        if first == last {
            Self::set(&mut self.cleared, &mut self.touched, word, head & tail);
        } else {
            Self::set(&mut self.cleared, &mut self.touched, word, head);
            for _ in first + 1..last.min(self.counts[0]) {
                word += self.height;
                Self::set(&mut self.cleared, &mut self.touched, word, u64::MAX);
            }
            Self::set(
                &mut self.cleared,
                &mut self.touched,
                word.wrapping_add(self.height),
                tail,
            );
        }
    }

    /// Marks every cell that a segment touches: the cells of `GridSpec::walk`, found row by row instead of cell by cell. (Within rounding
    /// of a corner the two may differ in the cells beside it.)
    fn ray(&mut self, a: Point2<f64>, b: Point2<f64>) {
        let (a, b) = if a.y <= b.y { (a, b) } else { (b, a) };
        let (first, last) = (whole(a.y).max(0) as usize, whole(b.y).max(0) as usize);
        let last = last.min(self.height - 1);
        // Coordinates at which the segment enters and leaves a row.
        let mut enter = fixed(a.x);
        if first < last {
            let slope = (b.x - a.x) / (b.y - a.y);
            let (mut leave, step) = (fixed(a.x + ((first + 1) as f64 - a.y) * slope), fixed(slope));
            for row in first..last {
                self.run(row, enter.min(leave), enter.max(leave));
                enter = leave;
                leave = leave.wrapping_add(step);
            }
        }
        let end = fixed(b.x);
        self.run(last, enter.min(end), enter.max(end));
    }

    /// Marks nearly the same cells as [`rays`](Self::rays).
    ///
    /// Between two neighbouring beams that are nowhere more than one cell apart, one of the two meets every cell whose centre lies between
    /// them: a line within half a cell of a centre meets that cell. So wedges are filled, 64 cells at a time, as far as both beams reach
    /// and the beams are dense, or as far as they passed the space between them; each beam is drawn only from the end of the shorter of its
    /// two wedges. Where neighbours end close together on one surface, the wedge is filled up to that surface and nothing is drawn. The
    /// cells missed thereby lie within the last cell length of a beam, with their centre behind the surface, and nearly all of them are hit
    /// themselves.
    fn fill(&mut self, origin: Point2<f64>, beams: impl Iterator<Item = Beam>, spacing: Spacing) {
        let dense = spacing.dense;
        let home = Corner::at(origin);
        // End of the border so far, and its distance from the origin.
        let (mut border, mut reach) = (home, 0.0_f64);
        let mut before: Option<Beam> = None;
        for beam in beams {
            if beam.hit {
                self.hit(beam.end);
            }
            let Some(last) = before.replace(beam) else {
                continue;
            };
            let (inner, outer) = (last.length.min(beam.length), last.length.max(beam.length));
            // Length of the wedge along both beams.
            let (from, to) = if last.number + 1 != beam.number {
                (0.0, 0.0)
            } else if outer - inner <= ONE_SURFACE && outer <= CLOSE * dense {
                (last.length, beam.length)
            } else {
                let passed = passed_between(&last, &beam, spacing).max(inner.min(dense));
                (passed, passed)
            };
            if last.length - reach.min(from) > SMALL_STEP {
                self.tail(origin, &last, reach.min(from));
            }
            // The border steps from one wedge to the next along the beam between them.
            if (from - reach).abs() > SMALL_STEP {
                let step = Corner::at(origin + last.direction * from);
                self.border(border, step);
                border = step;
            }
            let corner = Corner::at(origin + beam.direction * to);
            self.border(border, corner);
            (border, reach) = (corner, to);
        }
        if let Some(last) = before {
            self.tail(origin, &last, 0.0);
            self.border(border, home);
        }
    }

    /// Draws a beam beyond the cells whose centre lies within its first `filled` cells.
    fn tail(&mut self, origin: Point2<f64>, beam: &Beam, filled: f64) {
        self.ray(origin + beam.direction * (filled - HALF_DIAGONAL).max(0.0), beam.end);
    }

    /// In every row whose middle a segment crosses, flips the first cell with its centre to the right of the segment.
    #[inline(always)]
    fn border(&mut self, a: Corner, b: Corner) {
        if (a.row - b.row).abs() <= 1 {
            let x = 0.5 * (a.x + b.x) + 0.5;
            self.flip(a.row.min(b.row), whole(x), (a.row ^ b.row) as u64 & 1);
        } else {
            self.long_border(a, b);
        }
    }

    fn long_border(&mut self, a: Corner, b: Corner) {
        let (a, b) = if a.row <= b.row { (a, b) } else { (b, a) };
        let slope = (b.x - a.x) / (b.y - a.y);
        let first = a.row.max(0);
        let mut x = a.x + (first as f64 + 0.5 - a.y) * slope + 0.5;
        for row in first..b.row.min(self.height as i64) {
            self.flip(row, whole(x), 1);
            x += slope;
        }
    }

    /// Flips all cells of a row from a column on.
    #[inline(always)]
    fn flip(&mut self, row: i64, column: i64, bit: u64) {
        let last = (self.counts[0] * TILE_SIDE - 1) as i64;
        let column = column.clamp(0, last) as usize;
        if row as usize >= self.height {
            return;
        }
        let word = column / 64 * self.height + row as usize;
        if let Some(flips) = self.flips.get_mut(word)
            && let Some(touched) = self.touched.get_mut(word / TILE_SIDE)
        {
            *flips ^= bit << (column % 64);
            *touched = true;
        }
    }
}

/// A corner of the border of the filled wedges.
#[derive(Clone, Copy, Debug)]
struct Corner {
    x: f64,
    y: f64,
    /// The lowest row whose middle lies above the corner.
    row: i64,
}

impl Corner {
    fn at(p: Point2<f64>) -> Self {
        Self {
            x: p.x,
            y: p.y,
            row: whole(p.y + 0.5),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use proptest::prelude::*;
    use zenav_protocol::grid::{Cell, GridSpec};

    use super::*;

    proptest! {
        #[test]
        fn a_ray_marks_the_cells_of_the_one_ray_walk(ax in 0.0..190.0, ay in 0.0..90.0, bx in 0.0..190.0, by in 0.0..90.0) {
            let spec = GridSpec { origin: Point2::origin(), resolution: 1.0, width: 192, height: 90 };
            let mut bitmap = ScanBitmap::default();
            bitmap.lay([0, 0], [3, 2]);
            bitmap.ray(Point2::new(ax, ay), Point2::new(bx, by));
            let mut walked: Vec<Cell> = spec.walk(Point2::new(ax, ay), Point2::new(bx, by)).collect();
            walked.sort_by_key(|cell| spec.index(*cell));
            let mut marked: Vec<Cell> = Vec::new();
            bitmap.take(|[x, y], seen, _| {
                for (row, bits) in (0_u32..).zip(seen) {
                    let columns = (0..64_u32).filter(|column| bits >> column & 1 == 1);
                    marked.extend(columns.map(|column| Cell::new(64 * x as u32 + column, 64 * y as u32 + row)));
                }
            });
            marked.sort_by_key(|cell| spec.index(*cell));
            prop_assert_eq!(marked, walked);
        }
    }

    #[test]
    fn rays_that_leave_the_bitmap_stay_in_bounds() {
        let mut bitmap = ScanBitmap::default();
        bitmap.lay([0, 0], [1, 1]);
        for end in [(1e12, 1e12), (-5.0, 1.0), (f64::NAN, 0.5), (3.0, f64::INFINITY)].map(|(x, y)| Point2::new(x, y)) {
            bitmap.ray(Point2::new(1.0, 1.0), end);
            bitmap.border(Corner::at(Point2::new(1.0, 1.0)), Corner::at(end));
            bitmap.hit(end);
        }
    }
}
