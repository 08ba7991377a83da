//! Ray walk. Which cells does a segment touch?
//!
//! Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987.

use nalgebra::Point2;

use super::{Cell, GridSpec};

/// Iterator of [`GridSpec::walk`].
#[derive(Clone, Debug, Default)]
pub struct CellWalk {
    width: i64,
    height: i64,
    x: i64,
    y: i64,
    last_x: i64,
    last_y: i64,
    step_x: i64,
    step_y: i64,
    next_x: f64,
    next_y: f64,
    delta_x: f64,
    delta_y: f64,
    steps_left: i64,
    /// Cells found but not yet returned: the two beside a corner, and the one reached.
    waiting: [Option<(i64, i64)>; 3],
}

impl CellWalk {
    pub(super) fn new(spec: &GridSpec, from: Point2<f64>, to: Point2<f64>) -> Self {
        let (width, height) = (i64::from(spec.width), i64::from(spec.height));
        // Clipped one cell beyond the border: the work is bounded for any input, and the cells inside stay exact.
        let Some((from, to)) = clip(from, to, -1.0, -1.0, width as f64 + 1.0, height as f64 + 1.0) else {
            return Self::default();
        };
        let (x, y) = (from.x.floor() as i64, from.y.floor() as i64);
        let (last_x, last_y) = (to.x.floor() as i64, to.y.floor() as i64);
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let axis = |start: f64, cell: i64, d: f64| {
            if d > 0.0 {
                (1, ((cell + 1) as f64 - start) / d, 1.0 / d)
            } else if d < 0.0 {
                (-1, (start - cell as f64) / -d, -1.0 / d)
            } else {
                (0, f64::INFINITY, f64::INFINITY)
            }
        };
        let (step_x, next_x, delta_x) = axis(from.x, x, dx);
        let (step_y, next_y, delta_y) = axis(from.y, y, dy);
        Self {
            width,
            height,
            x,
            y,
            last_x,
            last_y,
            step_x,
            step_y,
            next_x,
            next_y,
            delta_x,
            delta_y,
            steps_left: (last_x - x).abs() + (last_y - y).abs(),
            waiting: [None, None, Some((x, y))],
        }
    }

    fn inside(&self, x: i64, y: i64) -> Option<Cell> {
        (x >= 0 && y >= 0 && x < self.width && y < self.height).then(|| Cell::new(x as u32, y as u32))
    }
}

impl Iterator for CellWalk {
    type Item = Cell;

    fn next(&mut self) -> Option<Cell> {
        loop {
            if let Some((x, y)) = self.waiting.iter_mut().find_map(Option::take) {
                if let Some(cell) = self.inside(x, y) {
                    return Some(cell);
                }
                continue;
            }
            if self.steps_left <= 0 {
                return None;
            }
            let (x_left, y_left) = (self.x != self.last_x, self.y != self.last_y);
            let corner = x_left && y_left && (self.next_x - self.next_y).abs() < 1e-12;
            // Rounding may request a step past the last column or row: the end cell takes precedence.
            let along_x = x_left && (self.next_x < self.next_y || !y_left);
            if corner {
                self.waiting[0] = Some((self.x + self.step_x, self.y));
                self.waiting[1] = Some((self.x, self.y + self.step_y));
            }
            if corner || along_x {
                self.x += self.step_x;
                self.next_x += self.delta_x;
                self.steps_left -= 1;
            }
            if corner || !along_x {
                self.y += self.step_y;
                self.next_y += self.delta_y;
                self.steps_left -= 1;
            }
            self.waiting[2] = Some((self.x, self.y));
        }
    }
}

/// Clips a segment to a rectangle (Liang and Barsky 1984); `None` when nothing is left or a number is not finite.
fn clip(
    from: Point2<f64>,
    to: Point2<f64>,
    low_x: f64,
    low_y: f64,
    high_x: f64,
    high_y: f64,
) -> Option<(Point2<f64>, Point2<f64>)> {
    let d = to - from;
    if !(from.x.is_finite() && from.y.is_finite() && d.x.is_finite() && d.y.is_finite()) {
        return None;
    }
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for (p, q) in [
        (-d.x, from.x - low_x),
        (d.x, high_x - from.x),
        (-d.y, from.y - low_y),
        (d.y, high_y - from.y),
    ] {
        if p == 0.0 {
            if q < 0.0 {
                return None;
            }
        } else if p < 0.0 {
            enter = enter.max(q / p);
        } else {
            leave = leave.min(q / p);
        }
    }
    if enter > leave {
        return None;
    }
    // Clamped: for very distant points, rounding moves the intersection off the border.
    let inside = |p: Point2<f64>| Point2::new(p.x.clamp(low_x, high_x), p.y.clamp(low_y, high_y));
    let start = inside(if enter > 0.0 { from + d * enter } else { from });
    let end = inside(if leave < 1.0 { from + d * leave } else { to });
    Some((start, end))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn spec() -> GridSpec {
        GridSpec {
            origin: Point2::new(-2.0, 1.0),
            resolution: 0.25,
            width: 40,
            height: 30,
        }
    }

    #[test]
    fn a_line_through_a_corner_visits_both_cells_beside_it() {
        let spec = GridSpec {
            origin: Point2::origin(),
            resolution: 1.0,
            width: 3,
            height: 3,
        };
        let cells: Vec<Cell> = spec.walk(Point2::new(0.5, 0.5), Point2::new(1.5, 1.5)).collect();
        assert_eq!(
            cells,
            vec![Cell::new(0, 0), Cell::new(1, 0), Cell::new(0, 1), Cell::new(1, 1)]
        );
    }

    proptest! {
        #[test]
        fn the_walk_visits_every_cell_that_samples_of_the_segment_lie_in(ax in -4.0..10.0, ay in -1.0..10.0, bx in -4.0..10.0, by in -1.0..10.0) {
            let spec = spec();
            let (a, b) = (Point2::new(ax, ay), Point2::new(bx, by));
            let cells: Vec<Cell> = spec.walk(a, b).collect();
            for i in 0..=500 {
                let p = a + (b - a) * (f64::from(i) / 500.0);
                let in_cells = spec.to_cells(p);
                // Samples within rounding of an edge may fall to either side.
                let near_edge = (in_cells.x - in_cells.x.round()).abs() < 1e-6 || (in_cells.y - in_cells.y.round()).abs() < 1e-6;
                if let (Some(cell), false) = (spec.cell_at(p), near_edge) {
                    prop_assert!(cells.contains(&cell), "{cell:?} at {p}");
                }
            }
            prop_assert!(cells.len() <= 40 + 30 + 80);
        }

        #[test]
        fn the_walk_is_bounded_for_any_numbers(ax in any::<f64>(), ay in any::<f64>(), bx in any::<f64>(), by in any::<f64>()) {
            prop_assert!(spec().walk(Point2::new(ax, ay), Point2::new(bx, by)).count() <= 200);
        }
    }
}
