//! Line of sight. Whether the straight path between two points is free, for any-angle and sampling planners, in cells of a grid.
//!
//! The answer is exact against closed squares: one span of columns per row that the path crosses, tested 64 cells at a time. The prepared
//! data (rows in bands, columns as rows, distances) only saves most of the tests.

use nalgebra::Point2;
use zenav_protocol::grid::Cell;

use super::bits::BitGrid;
use super::configuration::{ConfigurationSpace, UnknownPolicy};
use super::sweep::{Banded, EPSILON, whole};

/// A space in which straight paths are checked exactly. All coordinates are in cells: the centre of cell (0, 0) lies at (0.5, 0.5).
pub trait LineOfSight {
    /// Columns and rows.
    fn size(&self) -> [u32; 2];

    /// Whether the straight path from `a` to `b` is free: no blocked square is touched, not even at a corner. `false` if an end lies
    /// outside the grid or is not finite.
    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool;

    /// Whether a point is free.
    fn admits(&self, p: Point2<f64>) -> bool {
        self.sees(p, p)
    }
}

impl LineOfSight for &dyn LineOfSight {
    fn size(&self) -> [u32; 2] {
        (**self).size()
    }

    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool {
        (**self).sees(a, b)
    }

    fn admits(&self, p: Point2<f64>) -> bool {
        (**self).admits(p)
    }
}

/// Line of sight of a point among free cells: all other cells are closed squares, and so is everything outside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PointLineOfSight {
    rows: Banded,
    /// The bitmap transposed, for steep paths: spans then run along columns.
    columns: Banded,
}

impl PointLineOfSight {
    /// Prepares a bitmap of free cells: linear in its words.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_space::{BitGrid, LineOfSight as _, PointLineOfSight};
    ///
    /// let free = BitGrid::from_fn(20, 20, |cell| cell.x != 10 || cell.y != 5);
    /// let sight = PointLineOfSight::new(&free);
    /// assert!(!sight.sees(Point2::new(1.5, 5.5), Point2::new(18.5, 5.5)));
    /// assert!(sight.sees(Point2::new(1.5, 4.5), Point2::new(18.5, 4.5)));
    /// ```
    #[must_use]
    pub fn new(free: &BitGrid) -> Self {
        let blocked = free.complement();
        Self {
            columns: Banded::new(blocked.transposed()),
            rows: Banded::new(blocked),
        }
    }
}

impl LineOfSight for PointLineOfSight {
    fn size(&self) -> [u32; 2] {
        [self.rows.bits().width(), self.rows.bits().height()]
    }

    #[inline]
    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool {
        let [right, top] = self.size().map(|cells| f64::from(cells) - EPSILON);
        let inside = |p: Point2<f64>| p.x > EPSILON && p.x < right && p.y > EPSILON && p.y < top;
        if !(inside(a) && inside(b)) {
            return false;
        }
        if (b.y - a.y).abs() > (b.x - a.x).abs() {
            return !self
                .columns
                .is_touched_by_point(Point2::new(a.y, a.x), Point2::new(b.y, b.x));
        }
        !self.rows.is_touched_by_point(a, b)
    }
}

/// Line of sight of the robot's inscribed disc with its margin; its centre stays where the policy for unknown cells permits.
impl LineOfSight for ConfigurationSpace {
    fn size(&self) -> [u32; 2] {
        [self.spec.width, self.spec.height]
    }

    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool {
        let (right, top) = (f64::from(self.spec.width), f64::from(self.spec.height));
        let inside = |p: Point2<f64>| p.x >= 0.0 && p.x < right && p.y >= 0.0 && p.y < top;
        inside(a)
            && inside(b)
            && (self.unknown_policy != UnknownPolicy::Blocked || !self.forbidden.is_touched_by_window(a, b, 0.0))
            && disc_passes(self, a, b)
    }
}

/// Whether the disc moves freely between two points inside the grid, cells.
fn disc_passes(space: &ConfigurationSpace, a: Point2<f64>, b: Point2<f64>) -> bool {
    let (radius, half) = (space.radius() / space.spec.resolution, 0.5 * (b - a).norm());
    let reach = f64::from(space.field().reach_cells());
    if half + radius + 1.0 < reach {
        let middle = nalgebra::center(&a, &b);
        let cell = Cell::new(whole(middle.x), whole(middle.y));
        // Distance changes by at most the distance moved: the value of one cell's centre bounds all values on a short path.
        let off = (middle - cell.center()).norm();
        let distance = 0.5 * f64::from(space.field().squared(cell)).sqrt();
        if distance > radius + half + off + EPSILON {
            return true;
        }
        if distance < radius - off - EPSILON {
            return false;
        }
    }
    !space.obstacles.is_touched_by_disc(a, b, radius)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use proptest::prelude::*;
    use zenav_protocol::grid::{GridSpec, Occupancy};
    use zenav_protocol::robot::Footprint;

    use super::super::sweep::tests::{quarters, touches_exactly};
    use super::*;

    const SIDE: i64 = 70;

    fn free(blocked: &[(i64, i64)]) -> BitGrid {
        let mut bits = BitGrid::from_fn(SIDE as u32, SIDE as u32, |_| true);
        for (x, y) in blocked {
            bits.set(Cell::new(*x as u32, *y as u32), false);
        }
        bits
    }

    /// Points on quarter cells: through corners, along borders, from border to border.
    fn quarter_point() -> impl Strategy<Value = (i64, i64)> {
        (1..4 * SIDE, 1..4 * SIDE)
    }

    fn blocked() -> impl Strategy<Value = Vec<(i64, i64)>> {
        prop::collection::vec((0..SIDE, 0..SIDE), 0..40)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]

        #[test]
        fn a_point_sees_along_what_touches_no_closed_square(blocked in blocked(), a in quarter_point(), b in quarter_point()) {
            let expected = !blocked.iter().any(|square| touches_exactly(a, b, 0, *square));
            let sight = PointLineOfSight::new(&free(&blocked));
            prop_assert_eq!(sight.sees(quarters(a), quarters(b)), expected);
            prop_assert_eq!(sight.sees(quarters(b), quarters(a)), expected);
        }

        #[test]
        fn one_blocked_cell_on_the_path_is_never_missed(x in 1..SIDE - 1, y in 1..SIDE - 1, inside in (0.0..=1.0, 0.0..=1.0), angle in 0.0..6.3, before in 0.0..90.0, after in 0.0..90.0) {
            let through = Point2::new(x as f64 + inside.0, y as f64 + inside.1);
            let path = Vector2::new(f64::cos(angle), f64::sin(angle));
            let (a, b) = (through - path * before, through + path * after);
            let sight = PointLineOfSight::new(&free(&[(x, y)]));
            prop_assert!(!sight.sees(a, b));
        }

        #[test]
        fn what_is_seen_is_free_cell_by_cell(blocked in blocked(), a in (0.0..70.0, 0.0..70.0), b in (0.0..70.0, 0.0..70.0)) {
            let spec = GridSpec { origin: Point2::origin(), resolution: 1.0, width: SIDE as u32, height: SIDE as u32 };
            let (a, b) = (Point2::new(a.0, a.1), Point2::new(b.0, b.1));
            let free = free(&blocked);
            if PointLineOfSight::new(&free).sees(a, b) {
                prop_assert!(spec.walk(a, b).all(|cell| free.get(cell)));
            }
        }

        #[test]
        fn no_numbers_from_outside_do_harm(ax in any::<f64>(), ay in any::<f64>(), bx in any::<f64>(), by in any::<f64>()) {
            let sight = PointLineOfSight::new(&free(&[(3, 4)]));
            let (a, b, c) = (Point2::new(ax, ay), Point2::new(bx, by), Point2::new(5.5, 5.5));
            let outside = |p: Point2<f64>| !(p.x > 0.0 && p.x < 70.0 && p.y > 0.0 && p.y < 70.0);
            prop_assert!(!sight.sees(a, b) || !(outside(a) || outside(b)));
            let _ = (sight.sees(a, c), sight.sees(c, b));
            let space = space(&[(3, 4)], 0.3, UnknownPolicy::Blocked);
            prop_assert!(!space.sees(a, b) || [a, b].iter().all(|p| p.x >= 0.0 && p.x < 70.0 && p.y >= 0.0 && p.y < 70.0));
            let _ = (space.sees(a, c), space.sees(c, b));
        }
    }

    /// Cells of 10 cm; every ninth of the occupied squares is unknown instead.
    fn space(occupied: &[(i64, i64)], radius: f64, policy: UnknownPolicy) -> ConfigurationSpace {
        let spec = GridSpec {
            origin: Point2::new(-1.0, 2.0),
            resolution: 0.1,
            width: SIDE as u32,
            height: SIDE as u32,
        };
        let marks = occupied.iter().enumerate().map(|(i, (x, y))| {
            let value = if i % 9 == 8 {
                Occupancy::UNKNOWN
            } else {
                Occupancy::OCCUPIED
            };
            (*x as u32, *y as u32, value)
        });
        let grid = zenav_fixtures::map_with(spec, &marks.collect::<Vec<_>>());
        ConfigurationSpace::new(&grid, &Footprint::Radius(radius), policy, 0.0)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        #[test]
        fn a_disc_sees_along_what_it_fits_through(
            occupied in blocked(),
            radius in prop::sample::select(vec![0.0, 0.04, 0.21, 0.55, 1.7, 8.0]),
            policy in prop::sample::select(vec![UnknownPolicy::Free, UnknownPolicy::Blocked, UnknownPolicy::Obstacle]),
            a in (0.0..70.0, 0.0..70.0),
            b in (0.0..70.0, 0.0..70.0),
        ) {
            let space = space(&occupied, radius, policy);
            let (a, b) = (Point2::new(a.0, a.1), Point2::new(b.0, b.1));
            let [from, to] = [a, b].map(|p| space.spec().from_cells(p));
            prop_assume!(radius == 0.0 || (space.segment_clearance(from, to) - radius).abs() > 1e-8);
            let permitted = space.spec().walk(from, to).all(|cell| !space.forbidden().get(cell));
            prop_assert_eq!(space.sees(a, b), permitted && space.segment_is_free(from, to, radius));
        }
    }

    #[test]
    fn a_gap_between_two_cells_that_touch_at_a_corner_is_closed() {
        let sight = PointLineOfSight::new(&free(&[(10, 11), (11, 10)]));
        assert!(!sight.sees(Point2::new(10.5, 10.5), Point2::new(11.5, 11.5)));
        let one = PointLineOfSight::new(&free(&[(11, 10)]));
        assert!(
            !one.sees(Point2::new(10.5, 10.5), Point2::new(11.5, 11.5)),
            "nor is a corner cut"
        );
        assert!(one.sees(Point2::new(10.5, 10.6), Point2::new(11.5, 11.6)));
        // Along the border of a blocked cell is touching it.
        assert!(one.sees(Point2::new(9.5, 11.0), Point2::new(10.5, 11.0)));
        assert!(!one.sees(Point2::new(9.5, 11.0), Point2::new(12.5, 11.0)));
        assert!(!one.admits(Point2::new(11.0, 11.0)) && one.admits(Point2::new(10.9, 11.0)));
    }

    #[test]
    fn outside_the_grid_nothing_is_seen() {
        let sight = PointLineOfSight::new(&free(&[]));
        assert!(sight.sees(Point2::new(0.5, 0.5), Point2::new(69.5, 69.5)));
        assert!(!sight.sees(Point2::new(0.5, 0.5), Point2::new(70.5, 0.5)));
        assert!(!sight.admits(Point2::new(0.0, 5.0)) && !sight.admits(Point2::new(f64::NAN, 5.0)));
        assert!(!PointLineOfSight::new(&BitGrid::new(0, 0)).admits(Point2::origin()));
    }
}
