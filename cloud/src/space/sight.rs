//! Can one go straight from here to there? What any-angle and sampling planners ask, in cells of a grid.
//!
//! For points the answer is exact against closed squares: one span of columns for each row that the segment crosses, 64 cells tested at
//! once. For discs the distance field is followed in hops as long as the room there is (Hart, "Sphere Tracing", 1996), and only what
//! comes close to an obstacle is measured exactly.

use nalgebra::Point2;
use zenav_protocol::grid::Cell;

use super::bits::BitGrid;
use super::configuration::{ConfigurationSpace, UnknownPolicy};
use super::shapes::capsule_clearance;

/// A space in which straight ways are checked exactly. All coordinates are in cells: the centre of cell (0, 0) lies at (0.5, 0.5).
pub trait Sight {
    /// Columns and rows.
    fn size(&self) -> [u32; 2];

    /// Whether one may go straight from `a` to `b`: no blocked square is touched, however small the corner. `false` where an end lies
    /// outside the grid or is not finite.
    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool;

    /// Whether one may be at a point.
    fn admits(&self, p: Point2<f64>) -> bool {
        self.sees(p, p)
    }
}

/// Spans are wider by this at both ends, cells: rounding (some 1e-11 on the largest grids) never loses a square that is touched.
const HAIR: f64 = 1e-9;

/// Whether a square window that reaches `half` cells to each side, moved from `a` to `b`, touches a closed square whose bit differs from
/// `clear`; what lies outside the grid is not asked. Windows that come within [`HAIR`] touch, and so do those that are not finite.
pub(super) fn touches(bits: &BitGrid, clear: bool, a: Point2<f64>, b: Point2<f64>, half: f64) -> bool {
    let (a, b) = if a.y <= b.y { (a, b) } else { (b, a) };
    let (d, reach) = (b - a, half + HAIR);
    if !(d.x.is_finite() && d.y.is_finite() && reach.is_finite()) {
        return true;
    }
    let left = (a.x.min(b.x) - reach).max(0.0);
    let right = (a.x.max(b.x) + reach).min(f64::from(bits.width()) - 0.5);
    let (bottom, top) = (
        (a.y - reach).max(0.0),
        (b.y + reach).min(f64::from(bits.height()) - 0.5),
    );
    if left > right || bottom > top {
        return false;
    }
    let (stride, words) = (bits.stride(), bits.words());
    let flip = if clear { u64::MAX } else { 0 };
    // The window meets row `y` while its centre is between `y - reach` and `y + 1 + reach`. Level segments have no slope; what is not a
    // number then loses against `left` and `right`.
    let slope = d.x / d.y;
    let beside = reach * (1.0 + slope.abs());
    let (entry, exit) = if slope >= 0.0 { (0.0, 1.0) } else { (1.0, 0.0) };
    for y in bottom as u32..=top as u32 {
        let above = f64::from(y) - a.y;
        let from = (a.x + (above + entry) * slope - beside).max(left);
        let to = (a.x + (above + exit) * slope + beside).min(right);
        // Nothing is left where the window is beside the grid.
        if from <= to && has_set(&words[y as usize * stride..][..stride], from as u32, to as u32, flip) {
            return true;
        }
    }
    false
}

/// Whether any of the columns `from..=to`, all of them inside the row, is set after flipping.
#[inline]
fn has_set(row: &[u64], from: u32, to: u32, flip: u64) -> bool {
    let (first, last) = ((from / 64) as usize, (to / 64) as usize);
    let (head, tail) = (u64::MAX << (from % 64), u64::MAX >> (63 - to % 64));
    if first == last {
        return (row[first] ^ flip) & head & tail != 0;
    }
    (row[first] ^ flip) & head | (row[last] ^ flip) & tail != 0
        || row[first + 1..last].iter().any(|word| word ^ flip != 0)
}

/// A point among free cells: all others are closed squares, and so is everything outside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PointSight {
    free: BitGrid,
    /// The same turned over, for steep segments: spans are then along columns.
    columns: BitGrid,
}

impl PointSight {
    /// Prepares a bitmap of free cells: linear in its words.
    #[must_use]
    pub fn new(free: BitGrid) -> Self {
        Self {
            columns: free.transposed(),
            free,
        }
    }

    /// Free cells, one bit each.
    #[must_use]
    pub fn free(&self) -> &BitGrid {
        &self.free
    }
}

impl Sight for PointSight {
    fn size(&self) -> [u32; 2] {
        [self.free.width(), self.free.height()]
    }

    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool {
        let d = b - a;
        if d.y.abs() > d.x.abs() {
            let turned = |p: Point2<f64>| Point2::new(p.y, p.x);
            return point_passes(&self.columns, turned(a), turned(b));
        }
        point_passes(&self.free, a, b)
    }
}

/// A point among free cells, without anything prepared.
impl Sight for BitGrid {
    fn size(&self) -> [u32; 2] {
        [self.width(), self.height()]
    }

    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool {
        point_passes(self, a, b)
    }
}

fn point_passes(free: &BitGrid, a: Point2<f64>, b: Point2<f64>) -> bool {
    let (right, top) = (f64::from(free.width()) - HAIR, f64::from(free.height()) - HAIR);
    let inside = |p: Point2<f64>| p.x > HAIR && p.x < right && p.y > HAIR && p.y < top;
    inside(a) && inside(b) && !touches(free, true, a, b, 0.0)
}

/// Least hop that is worth a look at the field, cells.
const LEAST_HOP: f64 = 0.5;
/// Length of what is measured exactly where the room is less, cells.
const PIECE: f64 = 4.0;

/// The inscribed disc of a robot with its margin; its centre stays where the policy for unknown cells lets it be.
impl Sight for ConfigurationSpace {
    fn size(&self) -> [u32; 2] {
        [self.spec.width, self.spec.height]
    }

    fn sees(&self, a: Point2<f64>, b: Point2<f64>) -> bool {
        let (right, top) = (f64::from(self.spec.width), f64::from(self.spec.height));
        let inside = |p: Point2<f64>| p.x >= 0.0 && p.x < right && p.y >= 0.0 && p.y < top;
        inside(a)
            && inside(b)
            && (self.unknown_policy != UnknownPolicy::Blocked || !touches(&self.forbidden, false, a, b, 0.0))
            && disc_passes(self, a, b)
    }
}

/// Whether the disc moves freely between two points inside the grid, cells.
fn disc_passes(space: &ConfigurationSpace, a: Point2<f64>, b: Point2<f64>) -> bool {
    let radius = space.radius() / space.spec.resolution;
    let field = space.field();
    let known = 4 * field.reach_cells().pow(2);
    let d = b - a;
    let length = d.norm();
    let along = |at: f64| if at < length { a + d * (at / length) } else { b };
    let mut at = 0.0;
    loop {
        let p = along(at);
        let cell = Cell::new(p.x as u32, p.y as u32);
        let squared = field.squared(cell);
        // No distance changes by more than one moves: the centre's bounds the point's.
        let off = (p - Point2::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5)).norm();
        let distance = 0.5 * f64::from(squared).sqrt();
        if u32::from(squared) < known && distance + off < radius - HAIR {
            return false;
        }
        let room = distance - off - radius - HAIR;
        if room >= LEAST_HOP {
            at += room;
        } else {
            let piece = along(at + PIECE);
            if capsule_clearance(&space.obstacles, p, piece, radius, true) <= radius {
                return false;
            }
            at += PIECE;
        }
        if at >= length {
            return true;
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use proptest::prelude::*;
    use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
    use zenav_protocol::robot::Footprint;

    use super::*;

    const SIDE: i64 = 70;

    fn free(blocked: &[(i64, i64)]) -> BitGrid {
        let mut bits = BitGrid::from_fn(SIDE as u32, SIDE as u32, |_| true);
        for (x, y) in blocked {
            bits.set(Cell::new(*x as u32, *y as u32), false);
        }
        bits
    }

    /// Whether a window of a whole number of quarter cells, moved along a segment between points on the grid of quarter cells, touches a
    /// closed square: separating axes in whole numbers.
    fn touches_exactly(a: (i64, i64), b: (i64, i64), half: i64, square: (i64, i64)) -> bool {
        let (low, high) = (
            (4 * square.0 - half, 4 * square.1 - half),
            (4 * square.0 + 4 + half, 4 * square.1 + 4 + half),
        );
        let apart = a.0.max(b.0) < low.0 || a.0.min(b.0) > high.0 || a.1.max(b.1) < low.1 || a.1.min(b.1) > high.1;
        let side = |x: i64, y: i64| ((b.0 - a.0) * (y - a.1) - (b.1 - a.1) * (x - a.0)).signum();
        let sides = [
            side(low.0, low.1),
            side(high.0, low.1),
            side(high.0, high.1),
            side(low.0, high.1),
        ];
        !(apart || sides.iter().all(|s| *s > 0) || sides.iter().all(|s| *s < 0))
    }

    fn quarters(p: (i64, i64)) -> Point2<f64> {
        Point2::new(p.0 as f64 / 4.0, p.1 as f64 / 4.0)
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
            let free = free(&blocked);
            prop_assert_eq!(free.sees(quarters(a), quarters(b)), expected);
            let sight = PointSight::new(free);
            prop_assert_eq!(sight.sees(quarters(a), quarters(b)), expected);
            prop_assert_eq!(sight.sees(quarters(b), quarters(a)), expected);
        }

        #[test]
        fn a_moved_window_touches_what_it_sweeps_over(blocked in blocked(), a in (-40..4 * SIDE + 40, -40..4 * SIDE + 40), b in (-40..4 * SIDE + 40, -40..4 * SIDE + 40), half in 0_i64..20) {
            let expected = blocked.iter().any(|square| touches_exactly(a, b, half, *square));
            let occupied = BitGrid::from_fn(SIDE as u32, SIDE as u32, |cell| blocked.contains(&(cell.x.into(), cell.y.into())));
            prop_assert_eq!(touches(&occupied, false, quarters(a), quarters(b), half as f64 / 4.0), expected);
        }

        #[test]
        fn one_blocked_cell_on_the_way_is_never_missed(x in 1..SIDE - 1, y in 1..SIDE - 1, inside in (0.0..=1.0, 0.0..=1.0), angle in 0.0..6.3, before in 0.0..90.0, after in 0.0..90.0) {
            let through = Point2::new(x as f64 + inside.0, y as f64 + inside.1);
            let way = Vector2::new(f64::cos(angle), f64::sin(angle));
            let (a, b) = (through - way * before, through + way * after);
            let sight = PointSight::new(free(&[(x, y)]));
            prop_assert!(!sight.sees(a, b) && !sight.free().sees(a, b));
        }

        #[test]
        fn what_is_seen_is_free_cell_by_cell(blocked in blocked(), a in (0.0..70.0, 0.0..70.0), b in (0.0..70.0, 0.0..70.0)) {
            let spec = GridSpec { origin: Point2::origin(), resolution: 1.0, width: SIDE as u32, height: SIDE as u32 };
            let (a, b) = (Point2::new(a.0, a.1), Point2::new(b.0, b.1));
            let sight = PointSight::new(free(&blocked));
            if sight.sees(a, b) {
                prop_assert!(spec.walk(a, b).all(|cell| sight.free().get(cell)));
            }
        }

        #[test]
        fn no_numbers_from_outside_do_harm(ax in any::<f64>(), ay in any::<f64>(), bx in any::<f64>(), by in any::<f64>(), half in any::<f64>()) {
            let sight = PointSight::new(free(&[(3, 4)]));
            let (a, b, c) = (Point2::new(ax, ay), Point2::new(bx, by), Point2::new(5.5, 5.5));
            let outside = |p: Point2<f64>| !(p.x > 0.0 && p.x < 70.0 && p.y > 0.0 && p.y < 70.0);
            prop_assert!(!sight.sees(a, b) || !(outside(a) || outside(b)));
            let _ = (sight.sees(a, c), sight.sees(c, b), touches(sight.free(), true, a, b, half), touches(sight.free(), true, a, c, half));
            let space = space(&[(3, 4)], 0.3, UnknownPolicy::Blocked);
            prop_assert!(!space.sees(a, b) || [a, b].iter().all(|p| p.x >= 0.0 && p.x < 70.0 && p.y >= 0.0 && p.y < 70.0));
            let _ = (space.sees(a, c), space.sees(c, b));
        }
    }

    /// Cells of 10 cm; every ninth occupied square stands in the unknown.
    fn space(occupied: &[(i64, i64)], radius: f64, policy: UnknownPolicy) -> ConfigurationSpace {
        let spec = GridSpec {
            origin: Point2::new(-1.0, 2.0),
            resolution: 0.1,
            width: SIDE as u32,
            height: SIDE as u32,
        };
        let mut grid = Grid::filled(spec, Occupancy::FREE);
        for (i, (x, y)) in occupied.iter().enumerate() {
            grid[Cell::new(*x as u32, *y as u32)] = if i % 9 == 8 {
                Occupancy::UNKNOWN
            } else {
                Occupancy::OCCUPIED
            };
        }
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
        let sight = PointSight::new(free(&[(10, 11), (11, 10)]));
        assert!(!sight.sees(Point2::new(10.5, 10.5), Point2::new(11.5, 11.5)));
        let one = PointSight::new(free(&[(11, 10)]));
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
        let sight = PointSight::new(free(&[]));
        assert!(sight.sees(Point2::new(0.5, 0.5), Point2::new(69.5, 69.5)));
        assert!(!sight.sees(Point2::new(0.5, 0.5), Point2::new(70.5, 0.5)));
        assert!(!sight.admits(Point2::new(0.0, 5.0)) && !sight.admits(Point2::new(f64::NAN, 5.0)));
        assert!(!PointSight::new(BitGrid::new(0, 0)).admits(Point2::origin()));
    }
}
