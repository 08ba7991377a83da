//! Bounded pyramid. What can a point meet at most that may lie in any cell of a square?
//!
//! A table holds the largest value over squares of so many cells, one square for each cell or, for large squares, for every quarter of a side:
//! a block of positions, and the cells over which a group of headings spreads a point, fit closely into one of them. Squares of twice the
//! side follow from those before. All tables together take about four times the memory of the field.

use crate::field::LikelihoodField;

/// Points after which a sum is given up where the rest cannot make it large enough.
const PART: usize = 16;
/// Sides of the first squares, cells; those after them are twice as large as the ones before the last.
const FIRST: [u32; 3] = [2, 4, 6];

/// Largest values over growing squares of a field.
#[derive(Clone, Debug)]
pub struct Pyramid {
    field: LikelihoodField,
    highest: u32,
    tables: Vec<Table>,
}

/// The largest values over all squares of a size.
#[derive(Clone, Debug)]
pub(crate) struct Table {
    /// Any square of so many cells each way lies within what one value covers.
    side: u32,
    /// There is a value for every two to this power cells, each way.
    shift: u32,
    /// So many cells to the left of the field, and below it, is the first square: whole steps.
    pad: i32,
    width: u32,
    height: u32,
    values: Vec<u8>,
}

impl Pyramid {
    /// The pyramid of a field, with squares for blocks of `2^highest` cells and groups of headings that spread a point by half as many. Cost:
    /// some looks a cell.
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

    /// The field at its foot.
    #[must_use]
    pub fn field(&self) -> &LikelihoodField {
        &self.field
    }

    /// The highest level: blocks of two to this power cells have a bound.
    #[must_use]
    pub fn highest(&self) -> u32 {
        self.highest
    }

    /// What a point can meet at most in the `side` cells each way from the cell `(x, y)` on, up and right, counted from the field's lower left. With a
    /// side of one it is the value of the cell itself; one that is larger than all squares tells nothing.
    #[must_use]
    pub fn bound(&self, side: u32, x: i32, y: i32) -> u8 {
        if side <= 1 {
            return value_at(
                self.field.values(),
                self.field.spec().width,
                self.field.spec().height,
                x,
                y,
            );
        }
        self.table(side).map_or(u8::MAX, |table| table.at(x, y))
    }

    /// The table for squares of a side above one.
    pub(crate) fn table(&self, side: u32) -> Option<&Table> {
        self.tables.iter().find(|table| table.side >= side)
    }

    /// The sum of the field's values in cells, each moved by `(dx, dy)`; something smaller than `least` where the sum is.
    pub(crate) fn sum(&self, cells: &[(i32, i32)], dx: i32, dy: i32, least: u32) -> u32 {
        let (width, height) = (self.field.spec().width, self.field.spec().height);
        let values = self.field.values();
        summed(cells, least, |(x, y)| {
            value_at(values, width, height, x.wrapping_add(dx), y.wrapping_add(dy))
        })
    }
}

impl Table {
    /// The sum of what points can meet in the squares from cells on, each moved by `(dx, dy)`; something smaller than `least` where the sum is.
    pub(crate) fn sum(&self, cells: &[(i32, i32)], dx: i32, dy: i32, least: u32) -> u32 {
        summed(cells, least, |(x, y)| self.at(x.wrapping_add(dx), y.wrapping_add(dy)))
    }

    #[inline]
    fn at(&self, x: i32, y: i32) -> u8 {
        let step = |along: i32| along.wrapping_add(self.pad) >> self.shift;
        value_at(&self.values, self.width, self.height, step(x), step(y))
    }

    /// The table for squares of a larger side, of those of one that is at least half as large; `shift`: its own, at most one above.
    fn widened(&self, side: u32, shift: u32, field: &LikelihoodField) -> Self {
        let step = 1_u32 << shift;
        // A value covers every square that begins within its step.
        let covered = side + step - 1;
        let own = self.side + (1 << self.shift) - 1;
        let pad = (covered - 1).next_multiple_of(step);
        let count = |length: u32| (length + pad).div_ceil(step);
        let (width, height) = (count(field.spec().width), count(field.spec().height));
        // Where the squares of this table begin that together cover one of the new table, of the first one: the last ends with it. From one to the
        // next it is as many values as there are for a step.
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

/// Each value becomes the larger of it and another one.
fn raise(values: &mut [u8], others: &[u8]) {
    raise_by(values, others.iter());
}

#[inline]
fn raise_by<'a>(values: &mut [u8], others: impl Iterator<Item = &'a u8>) {
    for (value, other) in values.iter_mut().zip(others) {
        *value = (*value).max(*other);
    }
}

/// A value of a table, row by row from the lower left; zero outside.
#[inline]
fn value_at(values: &[u8], width: u32, height: u32, x: i32, y: i32) -> u8 {
    // What is negative wraps to something too large.
    let (x, y) = (x as u32, y as u32);
    if x < width && y < height {
        values[y as usize * width as usize + x as usize]
    } else {
        0
    }
}

/// The sum of values of cells, given up where it cannot reach `least`.
#[inline]
fn summed(cells: &[(i32, i32)], least: u32, value: impl Fn((i32, i32)) -> u8) -> u32 {
    let mut sum = 0;
    let mut left = cells.len() as u32;
    for part in cells.chunks(PART) {
        sum += part.iter().map(|cell| u32::from(value(*cell))).sum::<u32>();
        left -= part.len() as u32;
        if sum + left * u32::from(u8::MAX) < least {
            return sum;
        }
    }
    sum
}
