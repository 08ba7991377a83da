//! Bounded pyramid. Upper bounds on the likelihood of a point that may lie in any cell of a square.
//!
//! A table holds the largest value over squares of one size, one square for each cell or, for large squares, for every quarter of a side. A
//! block of positions, together with the cells over which a group of headings spreads a point, fits closely into one of them. Squares of
//! twice the side are computed from the previous ones. All tables together take about four times the memory of the field.

use crate::field::LikelihoodField;

/// Sides of the first squares, cells; each later one is twice as large as the one before the last.
const FIRST: [u32; 3] = [2, 4, 6];

/// Largest values over growing squares of a field.
#[derive(Clone, Debug)]
pub struct Pyramid {
    field: LikelihoodField,
    highest: u32,
    tables: Vec<Table>,
}

/// The largest values over all squares of one size.
#[derive(Clone, Debug)]
struct Table {
    /// Any square of this many cells each way lies within the area that one value covers.
    side: u32,
    /// There is one value for every two to this power cells, each way.
    shift: u32,
    /// Offset of the first square to the left of the field and below it, cells: whole steps.
    pad: i32,
    width: u32,
    height: u32,
    values: Vec<u8>,
}

/// A view of a table; the field itself counts as squares of one cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Squares<'a> {
    shift: u32,
    pad: i32,
    width: u32,
    height: u32,
    values: &'a [u8],
}

/// The cells of points, and their squares in a table.
#[derive(Clone, Debug, Default)]
pub(crate) struct Spots {
    cells: Vec<(i32, i32)>,
    /// Column and row of the lower left of all squares, and of the upper right.
    low: (i32, i32),
    high: (i32, i32),
    /// Offsets of the squares from the lower-left one, in values; empty if they reach farther than the table.
    offsets: Vec<u32>,
}

impl Pyramid {
    /// The pyramid of a field, with squares for blocks of `2^highest` cells and groups of headings that spread a point by half as many.
    /// Cost: a few operations per cell.
    #[must_use]
    pub fn new(field: LikelihoodField, highest: u32) -> Self {
        let highest = highest.min(16);
        let largest = 3 << highest >> 1;
        let spec = field.spec();
        let foot = Table {
            side: 1,
            shift: 0,
            pad: 0,
            width: spec.width,
            height: spec.height,
            values: field.values().to_vec(),
        };
        let mut tables: Vec<Table> = Vec::new();
        for side in FIRST.into_iter().take_while(|side| *side <= largest) {
            let next = tables.last().unwrap_or(&foot).widened(side, 0, &field);
            tables.push(next);
        }
        while let [.., before, _] = tables.as_slice()
            && 2 * before.side <= largest
        {
            let next = before.widened(2 * before.side, before.shift + 1, &field);
            tables.push(next);
        }
        Self { field, highest, tables }
    }

    /// The underlying field.
    #[must_use]
    pub fn field(&self) -> &LikelihoodField {
        &self.field
    }

    /// The highest level: blocks of two to this power cells have a bound.
    #[must_use]
    pub fn highest(&self) -> u32 {
        self.highest
    }

    /// Upper bound on the value in the `side` cells each way from the cell `(x, y)` on, up and right, counted from the field's lower left.
    /// With a side of one it is the value of the cell itself; a side larger than all squares has no bound.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::grid::GridSpec;
    /// use zenav_scan_matching::{LikelihoodField, Pyramid};
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 1.0, width: 4, height: 1 };
    /// let field = LikelihoodField::from_values(spec, vec![0, 0, 0, 200]).unwrap();
    /// let pyramid = Pyramid::new(field, 2);
    /// assert_eq!([1, 2].map(|side| pyramid.bound(side, 2, 0)), [0, 200]);
    /// assert_eq!(pyramid.bound(64, 0, 0), u8::MAX, "no square is that large: anything is possible");
    /// ```
    #[must_use]
    pub fn bound(&self, side: u32, x: i32, y: i32) -> u8 {
        self.squares(side).map_or(u8::MAX, |squares| squares.at(x, y))
    }

    /// The squares of a side, or the smallest ones that contain them; `None` if all are smaller.
    pub(crate) fn squares(&self, side: u32) -> Option<Squares<'_>> {
        if side <= 1 {
            let spec = self.field.spec();
            return Some(Squares {
                shift: 0,
                pad: 0,
                width: spec.width,
                height: spec.height,
                values: self.field.values(),
            });
        }
        let table = self.tables.iter().find(|table| table.side >= side)?;
        Some(Squares {
            shift: table.shift,
            pad: table.pad,
            width: table.width,
            height: table.height,
            values: &table.values,
        })
    }
}

impl Squares<'_> {
    #[inline]
    fn at(&self, x: i32, y: i32) -> u8 {
        // Negative numbers wrap to something too large.
        let (column, row) = (self.line(x) as u32, self.line(y) as u32);
        if column < self.width && row < self.height {
            self.values[row as usize * self.width as usize + column as usize]
        } else {
            0
        }
    }

    /// The column, or row, of a cell's square.
    fn line(&self, cell: i32) -> i32 {
        cell.wrapping_add(self.pad) >> self.shift
    }

    /// Adds up the bounds of points in each of four blocks, `half` cells wide: one moved by `(x, y)`, whole halves, and those to its right,
    /// above it, and above and to the right.
    #[inline]
    pub(crate) fn add(&self, spots: &Spots, x: i32, y: i32, half: i32, sums: &mut [u32; 4]) {
        let (column, row, step) = (x >> self.shift, y >> self.shift, half >> self.shift);
        let (low, high) = (spots.low, spots.high);
        let is_inside = step > 0
            && low.0 + column >= 0
            && low.1 + row >= 0
            && high.0 + column + step < self.width as i32
            && high.1 + row + step < self.height as i32;
        if is_inside {
            let (step, width) = (step as usize, self.width as usize);
            let first = (low.1 + row) as usize * width + (low.0 + column) as usize;
            let last = &self.values[first + step * width + step..];
            let lower = &self.values[first..][..last.len()];
            let right = &self.values[first + step..][..last.len()];
            let upper = &self.values[first + step * width..][..last.len()];
            for offset in &spots.offsets {
                let offset = *offset as usize;
                sums[0] += u32::from(lower[offset]);
                sums[1] += u32::from(right[offset]);
                sums[2] += u32::from(upper[offset]);
                sums[3] += u32::from(last[offset]);
            }
        } else {
            for (sum, (dx, dy)) in sums.iter_mut().zip(corners(half)) {
                let value = |&(cx, cy): &(i32, i32)| self.at(cx + x + dx, cy + y + dy);
                *sum += spots.cells.iter().map(|cell| u32::from(value(cell))).sum::<u32>();
            }
        }
    }
}

impl Spots {
    /// The spots of cells; without squares they have no bound.
    pub(crate) fn new(cells: Vec<(i32, i32)>, squares: Option<&Squares>) -> Self {
        let Some(table) = squares else {
            return Self {
                cells,
                ..Self::default()
            };
        };
        let squares = cells.iter().map(|(x, y)| (table.line(*x), table.line(*y)));
        let low = squares.clone().reduce(|a, b| (a.0.min(b.0), a.1.min(b.1)));
        let high = squares.clone().reduce(|a, b| (a.0.max(b.0), a.1.max(b.1)));
        let (low, high) = (low.unwrap_or_default(), high.unwrap_or_default());
        let fits = high.0.abs_diff(low.0) < table.width && high.1.abs_diff(low.1) < table.height;
        let offset = |(x, y): (i32, i32)| y.abs_diff(low.1) * table.width + x.abs_diff(low.0);
        Self {
            offsets: if fits {
                squares.map(offset).collect()
            } else {
                Vec::new()
            },
            cells,
            low,
            high,
        }
    }

    /// Their largest possible score.
    pub(crate) fn most(&self) -> u32 {
        self.cells.len() as u32 * u32::from(u8::MAX)
    }
}

/// Corners of four blocks of this side that lie two by two.
pub(crate) fn corners(side: i32) -> [(i32, i32); 4] {
    [(0, 0), (side, 0), (0, side), (side, side)]
}

impl Table {
    /// The table for squares of a larger side, from one whose side is at least half as large; `shift`: of the new table, at most one above
    /// this one's.
    fn widened(&self, side: u32, shift: u32, field: &LikelihoodField) -> Self {
        let step = 1_u32 << shift;
        // A value covers every square that begins within its step.
        let covered = side + step - 1;
        let own = self.side + (1 << self.shift) - 1;
        let pad = (covered - 1).next_multiple_of(step);
        let count = |length: u32| (length + pad).div_ceil(step);
        let (width, height) = (count(field.spec().width), count(field.spec().height));
        // Where the squares of this table begin that together cover the first one of the new table; the last of them ends with it. From one
        // to the next there are as many values as in a step.
        let offsets = [0, self.side.min(covered - own), covered - own];
        let starts = offsets.map(|offset| (offset as i32 + self.pad - pad as i32) >> self.shift);
        let stride = 1_usize << (shift - self.shift);
        let lead = starts[0].unsigned_abs() as usize;
        let mut line = vec![0_u8; lead + self.width as usize + stride * width as usize];
        let mut rows = vec![0_u8; width as usize * self.height as usize];
        let own_rows = self.values.chunks_exact(self.width.max(1) as usize);
        for (row, new) in own_rows.zip(rows.chunks_exact_mut(width.max(1) as usize)) {
            line[lead..lead + row.len()].copy_from_slice(row);
            for start in starts {
                let from = &line[(lead as i32 + start) as usize..];
                match stride {
                    1 => raise(new, from),
                    _ => raise_by(new, from.iter().step_by(stride)),
                }
            }
        }
        let mut values = vec![0_u8; width as usize * height as usize];
        for (y, new) in (0..).zip(values.chunks_exact_mut(width.max(1) as usize)) {
            for start in starts {
                let row = usize::try_from(y * stride as i32 + start).unwrap_or(usize::MAX);
                if row < self.height as usize {
                    raise(new, &rows[row * width as usize..(row + 1) * width as usize]);
                }
            }
        }
        Self {
            side,
            shift,
            pad: pad as i32,
            width,
            height,
            values,
        }
    }
}

/// Replaces each value by the larger of it and another one.
fn raise(values: &mut [u8], others: &[u8]) {
    raise_by(values, others.iter());
}

#[inline]
fn raise_by<'a>(values: &mut [u8], others: impl Iterator<Item = &'a u8>) {
    for (value, other) in values.iter_mut().zip(others) {
        *value = (*value).max(*other);
    }
}
