//! Cells. Which square of a grid is where, and which are around it?

use nalgebra::{Point2, Vector2};

/// Square cells in rows, numbered from a lower-left corner.
#[derive(Clone, Debug)]
pub(crate) struct Cells {
    low: Point2<f64>,
    side: f64,
    size: [usize; 2],
}

impl Cells {
    /// Cells of a side (m) that cover the box between two corners, m.
    pub(crate) fn new(low: Point2<f64>, high: Point2<f64>, side: f64) -> Self {
        let size = [high.x - low.x, high.y - low.y].map(|length| (length / side).ceil() as usize);
        Self { low, side, size }
    }

    /// Number of cells.
    pub(crate) fn count(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Centre of a cell, m.
    pub(crate) fn center(&self, cell: usize) -> Point2<f64> {
        let (x, y) = (cell % self.size[0], cell / self.size[0]);
        self.low + Vector2::new(x as f64 + 0.5, y as f64 + 0.5) * self.side
    }

    /// The cell of a point; `None` outside.
    pub(crate) fn cell(&self, at: Point2<f64>) -> Option<usize> {
        let off = (at - self.low) / self.side;
        let inside = off.x >= 0.0 && off.y >= 0.0 && (off.x as usize) < self.size[0] && (off.y as usize) < self.size[1];
        inside.then(|| off.y as usize * self.size[0] + off.x as usize)
    }

    /// The cell so many columns and rows from another; `None` outside.
    pub(crate) fn beside(&self, cell: usize, [dx, dy]: [i64; 2]) -> Option<usize> {
        let [width, height] = self.size.map(|side| side as i64);
        let (x, y) = (cell as i64 % width + dx, cell as i64 / width + dy);
        let inside = (0..width).contains(&x) && (0..height).contains(&y);
        inside.then(|| (y * width + x) as usize)
    }

    /// The cells of the square around a point that reaches so far to each side, m.
    pub(crate) fn around(&self, at: Point2<f64>, reach: f64) -> impl Iterator<Item = usize> + use<> {
        let span = |off: f64, size: usize| {
            [off - reach, off + reach].map(|off| ((off / self.side).max(0.0) as usize).min(size.saturating_sub(1)))
        };
        let [left, right] = span(at.x - self.low.x, self.size[0]);
        let [bottom, top] = span(at.y - self.low.y, self.size[1]);
        let width = self.size[0];
        (bottom..=top).flat_map(move |y| (left..=right).map(move |x| y * width + x))
    }

    /// The cell whose centre is nearest to a point, among some.
    pub(crate) fn nearest(&self, at: Point2<f64>, is_one: impl Fn(usize) -> bool) -> Option<usize> {
        let away = |cell: &usize| (self.center(*cell) - at).norm_squared();
        (0..self.count())
            .filter(|cell| is_one(*cell))
            .min_by(|a, b| away(a).total_cmp(&away(b)))
    }

    /// The value at a point, interpolated between the values at the four nearest centres; beyond the outermost centres theirs.
    pub(crate) fn interpolate(&self, values: &[f32], at: Point2<f64>) -> f64 {
        let split = |off: f64, size: usize| {
            let off = (off / self.side - 0.5).clamp(0.0, (size - 1) as f64);
            let from = (off as usize).min(size.saturating_sub(2));
            (from, off - from as f64)
        };
        let (x, right) = split(at.x - self.low.x, self.size[0]);
        let (y, up) = split(at.y - self.low.y, self.size[1]);
        let value = |x: usize, y: usize| f64::from(values[y * self.size[0] + x]);
        let row = |y: usize| value(x, y) * (1.0 - right) + value(x + 1, y) * right;
        row(y) * (1.0 - up) + row(y + 1) * up
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_centres_a_plane_keeps_its_slope() {
        let cells = Cells::new(Point2::new(-1.0, 2.0), Point2::new(0.0, 3.5), 0.25);
        let plane = |at: Point2<f64>| 2.0 * at.x - 3.0 * at.y;
        let values: Vec<f32> = (0..cells.count())
            .map(|cell| plane(cells.center(cell)) as f32)
            .collect();
        for at in [
            Point2::new(-0.52, 2.7),
            Point2::new(-0.86, 2.13),
            Point2::new(-0.13, 3.37),
        ] {
            assert!((cells.interpolate(&values, at) - plane(at)).abs() < 1e-5, "{at}");
            assert_eq!(cells.cell(at), cells.nearest(at, |_| true));
        }
        assert_eq!(cells.cell(Point2::new(0.01, 3.0)), None);
        assert_eq!(cells.beside(3, [1, 0]), None);
        assert_eq!(cells.beside(3, [-1, 1]), Some(6));
    }
}
