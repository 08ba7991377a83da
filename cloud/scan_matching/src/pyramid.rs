//! Bounded pyramid. What can a block of positions score at most?
//!
//! Level `k` has a cell for every `2^k` cells of the field, holding the largest value of the `2 · 2^k` cells from its lower left corner on,
//! each way. A point in it, moved by up to `2^k - 1` cells up or right, stays under that value. All levels together take a third more
//! memory than the field.

use crate::field::LikelihoodField;

/// Points after which a sum is given up where the rest cannot make it large enough.
const PART: usize = 16;

/// Largest values over growing squares of a field.
#[derive(Clone, Debug)]
pub struct Pyramid {
    field: LikelihoodField,
    levels: Vec<Level>,
}

#[derive(Clone, Debug)]
struct Level {
    width: i64,
    height: i64,
    values: Vec<u8>,
}

impl Pyramid {
    /// The pyramid of a field with levels up to blocks of `2^highest` cells. Cost: four looks a cell of each level.
    #[must_use]
    pub fn new(field: LikelihoodField, highest: u32) -> Self {
        let (width, height) = (i64::from(field.spec().width), i64::from(field.spec().height));
        // The largest value over each 2^k square, from which that over the square twice as large follows.
        let mut blocks = Level {
            width,
            height,
            values: field.values().to_vec(),
        };
        let mut levels = Vec::new();
        for _ in 0..highest.min(20) {
            let next = blocks.merged(2);
            levels.push(next.merged_in_place());
            blocks = next;
        }
        Self { field, levels }
    }

    /// The field at its foot.
    #[must_use]
    pub fn field(&self) -> &LikelihoodField {
        &self.field
    }

    /// The highest level.
    #[must_use]
    pub fn highest(&self) -> u32 {
        self.levels.len() as u32
    }

    /// What a point in the cell `(x, y)`, from the field's lower left, can meet at most when moved by up to `2^level - 1` cells up and
    /// right. At level 0 the value of the cell itself.
    #[must_use]
    pub fn bound(&self, level: u32, x: i64, y: i64) -> u8 {
        match (level as usize).checked_sub(1).and_then(|index| self.levels.get(index)) {
            Some(values) => values.at(x >> level, y >> level),
            None => {
                let spec = self.field.spec();
                if x < 0 || y < 0 || x >= i64::from(spec.width) || y >= i64::from(spec.height) {
                    return 0;
                }
                self.field.values()[(y * i64::from(spec.width) + x) as usize]
            }
        }
    }
}

impl Pyramid {
    /// The sum of [`Self::bound`] over cells, each moved by `(dx, dy)`; something smaller than `least` where the sum is.
    pub(crate) fn sum(&self, level: u32, cells: &[(i32, i32)], dx: i32, dy: i32, least: u32) -> u32 {
        let spec = self.field.spec();
        // A level above has one more column and row to the left and below.
        let (values, width, height, pad) =
            match (level as usize).checked_sub(1).and_then(|index| self.levels.get(index)) {
                Some(level) => (level.values.as_slice(), level.width as u32, level.height as u32, 1),
                None => (self.field.values(), spec.width, spec.height, 0),
            };
        let value = |(x, y): &(i32, i32)| {
            // What is negative wraps to something too large.
            let x = ((x.wrapping_add(dx) >> level) + pad) as u32;
            let y = ((y.wrapping_add(dy) >> level) + pad) as u32;
            if x < width && y < height {
                u32::from(values[y as usize * width as usize + x as usize])
            } else {
                0
            }
        };
        let mut sum = 0;
        let mut left = cells.len() as u32;
        for part in cells.chunks(PART) {
            sum += part.iter().map(value).sum::<u32>();
            left -= part.len() as u32;
            if sum + left * u32::from(u8::MAX) < least {
                return sum;
            }
        }
        sum
    }
}

impl Level {
    /// One cell more to the left and below: positions there reach into the field.
    fn at(&self, x: i64, y: i64) -> u8 {
        let (x, y) = (x + 1, y + 1);
        if x < 0 || y < 0 || x >= self.width || y >= self.height {
            return 0;
        }
        self.values[(y * self.width + x) as usize]
    }

    fn value(&self, x: i64, y: i64) -> u8 {
        if x < 0 || y < 0 || x >= self.width || y >= self.height {
            return 0;
        }
        self.values[(y * self.width + x) as usize]
    }

    /// The largest values of squares of `side` cells.
    fn merged(&self, side: i64) -> Self {
        let (width, height) = ((self.width + side - 1) / side, (self.height + side - 1) / side);
        let mut values = vec![0_u8; (width * height) as usize];
        for y in 0..self.height {
            for x in 0..self.width {
                let value = &mut values[((y / side) * width + x / side) as usize];
                *value = (*value).max(self.values[(y * self.width + x) as usize]);
            }
        }
        Self { width, height, values }
    }

    /// The largest of each cell and its three neighbours to the right and above, from one cell left and below the first on.
    fn merged_in_place(&self) -> Self {
        let (width, height) = (self.width + 1, self.height + 1);
        let mut values = Vec::with_capacity((width * height) as usize);
        for y in -1..self.height {
            for x in -1..self.width {
                let low = self.value(x, y).max(self.value(x + 1, y));
                let high = self.value(x, y + 1).max(self.value(x + 1, y + 1));
                values.push(low.max(high));
            }
        }
        Self { width, height, values }
    }
}
