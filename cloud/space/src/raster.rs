//! Polygon rasterisation. The cells that a closed polygon touches: none is missed, and none is farther away than a millionth of a cell.
//!
//! A cell that no edge touches lies wholly inside or outside, as its centre does. Edges are walked row by row; a centre is inside if the
//! number of edges on its left is odd (an even-odd scan conversion).

use nalgebra::Point2;
use zenav_protocol::grid::{Cell, GridSpec};
use zenav_protocol::polygon::edges;

/// Cells this near to a polygon count as touched, cells: rounding never loses one.
const EPSILON: f64 = 1e-6;

/// Marked cells of a grid, stored for the window that contains marks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellMask {
    first_row: usize,
    first_word: usize,
    /// Words per row.
    stride: usize,
    words: Vec<u64>,
}

/// First and last column and row that a polygon reaches.
#[derive(Clone, Copy)]
struct Span {
    columns: (usize, usize),
    rows: (usize, usize),
}

impl Span {
    /// The span of a polygon in cells; `None` if it lies beside the grid.
    fn of(corners: &[Point2<f64>], spec: &GridSpec) -> Option<Self> {
        let along = |pick: fn(&Point2<f64>) -> f64, cells: u32| {
            let (low, high) = corners
                .iter()
                .map(pick)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| {
                    (low.min(at), high.max(at))
                });
            touched(low, high, cells)
        };
        Some(Self {
            columns: along(|p| p.x, spec.width)?,
            rows: along(|p| p.y, spec.height)?,
        })
    }
}

impl CellMask {
    /// The cells of a grid that any of some simple polygons (m, map frame) touches; `None` if there are none.
    #[must_use]
    pub fn of<'a>(polygons: impl IntoIterator<Item = &'a [Point2<f64>]>, spec: &GridSpec) -> Option<Self> {
        let polygons: Vec<Vec<Point2<f64>>> = polygons
            .into_iter()
            .map(|corners| corners.iter().map(|corner| spec.to_cells(*corner)).collect())
            .collect();
        let spans = polygons.iter().filter_map(|corners| Span::of(corners, spec));
        let span = spans.reduce(|a, b| Span {
            columns: (a.columns.0.min(b.columns.0), a.columns.1.max(b.columns.1)),
            rows: (a.rows.0.min(b.rows.0), a.rows.1.max(b.rows.1)),
        })?;
        let mut all = Self::empty(span);
        // One at a time, so that large masks are not all held at once.
        for mask in polygons.iter().filter_map(|corners| Self::of_one(corners, spec)) {
            for (row, words) in mask.words.chunks_exact(mask.stride).enumerate() {
                let start = (mask.first_row + row - all.first_row) * all.stride + mask.first_word - all.first_word;
                for (to, from) in all.words[start..].iter_mut().zip(words) {
                    *to |= from;
                }
            }
        }
        Some(all)
    }

    /// The marks of 64 columns of a row.
    #[must_use]
    pub fn word(&self, y: u32, word: usize) -> u64 {
        let inside = |at: usize, first: usize, count: usize| at.checked_sub(first).filter(|at| *at < count);
        match (
            inside(y as usize, self.first_row, self.rows()),
            inside(word, self.first_word, self.stride),
        ) {
            (Some(row), Some(word)) => self.words[row * self.stride + word],
            _ => 0,
        }
    }

    /// Whether a cell is marked.
    #[must_use]
    pub fn is_set(&self, cell: Cell) -> bool {
        self.word(cell.y, cell.x as usize / 64) >> (cell.x % 64) & 1 == 1
    }

    fn empty(Span { columns, rows }: Span) -> Self {
        let (first_word, stride) = (columns.0 / 64, columns.1 / 64 - columns.0 / 64 + 1);
        Self {
            first_row: rows.0,
            first_word,
            stride,
            words: vec![0; (rows.1 - rows.0 + 1) * stride],
        }
    }

    fn rows(&self) -> usize {
        self.words.len() / self.stride.max(1)
    }

    /// The cells that a polygon (in cells) touches.
    fn of_one(corners: &[Point2<f64>], spec: &GridSpec) -> Option<Self> {
        let span = Span::of(corners, spec)?;
        let mut mask = Self::empty(span);
        // Bits where the inside begins or ends along a row.
        let mut turns = mask.clone();
        for edge in edges(corners) {
            let (a, b) = if edge.a.y <= edge.b.y {
                (edge.a, edge.b)
            } else {
                (edge.b, edge.a)
            };
            let Some((first, last)) = touched(a.y, b.y, spec.height) else {
                continue;
            };
            let slope = (b.x - a.x) / (b.y - a.y);
            let at = |y: f64| {
                if b.y - a.y > 0.0 {
                    a.x + (y.clamp(a.y, b.y) - a.y) * slope
                } else {
                    a.x
                }
            };
            for y in first..=last {
                let (bottom, top) = (y as f64 - EPSILON, (y + 1) as f64 + EPSILON);
                let (from, to) = if b.y > a.y { (at(bottom), at(top)) } else { (a.x, b.x) };
                if let Some((from, to)) = touched(from.min(to), from.max(to), spec.width) {
                    mask.mark(y, from, to);
                }
                let middle = y as f64 + 0.5;
                if a.y <= middle && middle < b.y {
                    turns.turn(y, at(middle), spec.width);
                }
            }
        }
        mask.fill(&turns, span.columns);
        Some(mask)
    }

    /// Marks columns of a row, both ends included.
    fn mark(&mut self, y: usize, from: usize, to: usize) {
        let row = &mut self.words[(y - self.first_row) * self.stride..][..self.stride];
        let (first, last) = (from / 64 - self.first_word, to / 64 - self.first_word);
        for (word, bits) in row.iter_mut().enumerate().take(last + 1).skip(first) {
            let low = if word == first {
                u64::MAX << (from % 64)
            } else {
                u64::MAX
            };
            let high = if word == last {
                u64::MAX >> (63 - to % 64)
            } else {
                u64::MAX
            };
            *bits |= low & high;
        }
    }

    /// Records that an edge crosses the line through a row's centres: inside and outside swap for all centres on its right.
    fn turn(&mut self, y: usize, x: f64, width: u32) {
        let column = (x - 0.5).ceil().max((self.first_word * 64) as f64);
        if column < f64::from(width) {
            let (column, row) = (column as usize, y - self.first_row);
            if let Some(word) = self.words[row * self.stride..][..self.stride].get_mut(column / 64 - self.first_word) {
                *word ^= 1 << (column % 64);
            }
        }
    }

    /// Marks the cells inside.
    fn fill(&mut self, turns: &Self, columns: (usize, usize)) {
        let rows = self
            .words
            .chunks_exact_mut(self.stride)
            .zip(turns.words.chunks_exact(self.stride));
        for (row, turns) in rows {
            let mut inside = 0;
            for (word, (bits, turns)) in row.iter_mut().zip(turns).enumerate() {
                // Every bit becomes the parity of the bits up to it.
                let mut parity = *turns;
                for shift in [1, 2, 4, 8, 16, 32] {
                    parity ^= parity << shift;
                }
                parity ^= inside;
                inside = if parity >> 63 == 1 { u64::MAX } else { 0 };
                let beyond = (self.first_word + word + 1) * 64;
                let within = u64::MAX >> beyond.saturating_sub(columns.1 + 1).min(63);
                *bits |= parity & within;
            }
        }
    }
}

/// First and last of `cells` cells that a closed interval touches; `None` if there are none, or for NaN.
fn touched(low: f64, high: f64, cells: u32) -> Option<(usize, usize)> {
    let first = ((low - EPSILON).ceil() - 1.0).max(0.0);
    let last = (high + EPSILON).floor().min(f64::from(cells) - 1.0);
    (first <= last).then_some((first as usize, last as usize))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use zenav_protocol::polygon::{Edge, contains, simple, touch};

    use super::*;

    const SIDE: u32 = 80;

    fn grid() -> GridSpec {
        GridSpec {
            origin: Point2::new(-3.0, 2.0),
            resolution: 0.5,
            width: SIDE,
            height: SIDE,
        }
    }

    /// A polygon around a point (cells), each corner on its own ray: simple wherever the point is inside.
    fn star(center: (f64, f64), radii: &[f64]) -> Vec<Point2<f64>> {
        let corner = |(number, radius): (usize, &f64)| {
            let angle = std::f64::consts::TAU * number as f64 / radii.len() as f64;
            // Whole quarters of a cell: corners on borders of cells, edges along them.
            let quarter = |at: f64| (4.0 * at).round() / 4.0;
            grid().from_cells(Point2::new(
                quarter(center.0 + radius * angle.cos()),
                quarter(center.1 + radius * angle.sin()),
            ))
        };
        radii.iter().enumerate().map(corner).collect()
    }

    /// Whether a closed polygon touches the closed square of a cell, with a tolerance like that of the mask.
    fn touches(corners: &[Point2<f64>], x: f64, y: f64) -> bool {
        let at = |x: f64, y: f64| grid().from_cells(Point2::new(x, y));
        let square = [at(x, y), at(x + 1.0, y), at(x + 1.0, y + 1.0), at(x, y + 1.0)];
        edges(corners).any(|edge| edges(&square).any(|side: Edge| touch(edge, side)))
            || contains(corners, at(x + 0.5, y + 0.5))
            || contains(&square, corners[0])
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn marked_are_the_cells_that_a_polygon_touches(center in (-20.0..100.0, -20.0..100.0_f64), radii in prop::collection::vec(0.3..50.0_f64, 3..9)) {
            let Ok(corners) = simple(star(center, &radii)) else { return Ok(()) };
            let mask = CellMask::of([corners.as_slice()], &grid());
            for y in 0..SIDE {
                for x in 0..SIDE {
                    let marked = mask.as_ref().is_some_and(|mask| mask.word(y, x as usize / 64) >> (x % 64) & 1 == 1);
                    prop_assert_eq!(marked, touches(&corners, f64::from(x), f64::from(y)), "{} {}", x, y);
                }
            }
            let beyond = mask.is_some_and(|mask| (0..SIDE).any(|y| mask.word(y, 1) >> (SIDE % 64) != 0 || mask.word(y, 2) != 0));
            prop_assert!(!beyond, "nothing is marked beyond the grid");
        }
    }

    #[test]
    fn polygons_beside_the_grid_and_grids_without_cells_have_no_marks() {
        let square =
            |low: f64, high: f64| [(low, low), (high, low), (high, high), (low, high)].map(|(x, y)| Point2::new(x, y));
        assert_eq!(CellMask::of([square(-90.0, -80.0).as_slice()], &grid()), None);
        let none = GridSpec {
            width: 0,
            height: 0,
            ..grid()
        };
        assert_eq!(CellMask::of([square(-1e5, 1e5).as_slice()], &none), None);
        let all = CellMask::of([square(-1e5, 1e5).as_slice()], &grid()).unwrap_or_default();
        assert!((0..SIDE).all(|y| all.word(y, 0) == u64::MAX && all.word(y, 1) == u64::MAX >> (128 - SIDE)));
    }
}
