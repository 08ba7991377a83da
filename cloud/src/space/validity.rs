//! Does the true footprint fit at a pose, along a segment, along a sweep of poses?
//!
//! Every check is exact against the closed squares of occupied cells: candidates come from bit scans of the rows that the
//! shape can reach, each candidate is measured in closed form. No step size is involved.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::GridSpec;
use zenav_protocol::robot::Footprint;

use super::bits::BitGrid;
use super::configuration::{ConfigurationSpace, UnknownPolicy};

/// Sweeps are bisected until they are certain to within this, m.
const SWEEP_TOLERANCE: f64 = 1e-3;

/// Most bisections of one sweep, and more for each pose: no numbers from outside keep it busy.
const SWEEP_BISECTIONS: usize = 10_000;

impl ConfigurationSpace {
    /// Whether the robot may stand at a pose: its true footprint touches no obstacle, and its centre stands on a cell that
    /// the policy for unknown cells allows.
    #[must_use]
    pub fn is_valid(&self, pose: Pose2) -> bool {
        if !pose.is_finite() || !self.is_permitted(pose.position()) {
            return false;
        }
        let enough = self.footprint.circumscribed_radius() + self.spec.resolution;
        let clearance = disc_clearance(&self.obstacles, &self.spec, pose.position(), enough);
        if clearance <= self.footprint.inscribed_radius() {
            // A disc that touches collides; a point collides only on the obstacle itself, closed as well.
            return false;
        }
        if matches!(self.footprint, Footprint::Radius(_)) || clearance > self.footprint.circumscribed_radius() {
            return true;
        }
        self.footprint_clearance(pose) > 0.0
    }

    /// Whether the policy for unknown cells lets the robot's centre be at a point.
    #[must_use]
    pub fn is_permitted(&self, point: Point2<f64>) -> bool {
        match self.spec.cell_at(point) {
            Some(cell) => !self.forbidden.get(cell),
            None => self.unknown_policy == UnknownPolicy::Free,
        }
    }

    /// Exact distance from the true footprint at a pose to the nearest obstacle, m; at most [`reach`](Self::reach), zero in
    /// collision and for a non-finite pose.
    #[must_use]
    pub fn footprint_clearance(&self, pose: Pose2) -> f64 {
        if !pose.is_finite() {
            return 0.0;
        }
        match &self.footprint {
            Footprint::Radius(radius) => (disc_clearance(&self.obstacles, &self.spec, pose.position(), self.reach() + radius) - radius).max(0.0),
            Footprint::Polygon(corners) => {
                let outline: Vec<Point2<f64>> = corners.iter().map(|corner| self.spec.to_cells(pose.transform_point(*corner))).collect();
                polygon_clearance(&self.obstacles, &outline, self.reach() / self.spec.resolution) * self.spec.resolution
            }
        }
    }

    /// Whether a disc of `radius` (m) moved from `a` to `b` touches no obstacle. Unknown cells count only under
    /// [`UnknownPolicy::Obstacle`].
    #[must_use]
    pub fn segment_is_free(&self, a: Point2<f64>, b: Point2<f64>, radius: f64) -> bool {
        let radius = radius.max(0.0) / self.spec.resolution;
        capsule_clearance(&self.obstacles, self.spec.to_cells(a), self.spec.to_cells(b), radius, true) > radius
    }

    /// Exact least distance from a segment to an obstacle, m; at most [`reach`](Self::reach).
    #[must_use]
    pub fn segment_clearance(&self, a: Point2<f64>, b: Point2<f64>) -> f64 {
        let limit = self.reach() / self.spec.resolution;
        capsule_clearance(&self.obstacles, self.spec.to_cells(a), self.spec.to_cells(b), limit, false).min(limit) * self.spec.resolution
    }

    /// Least distance of the true footprint to an obstacle while it moves through the poses, m; at most
    /// [`reach`](Self::reach). Between two poses position and heading (the shorter way round) change evenly.
    ///
    /// Never above the truth, and at most a millimetre below it (for steps that a robot makes; after ten thousand bisections
    /// a safe bound is returned): zero means a collision or less than a millimetre to spare.
    #[must_use]
    pub fn sweep_min_clearance(&self, poses: &[Pose2]) -> f64 {
        let mut least = self.reach();
        if let Footprint::Radius(radius) = &self.footprint {
            let limit = (self.reach() + radius) / self.spec.resolution;
            let steps = poses.iter().zip(poses.iter().skip(1).chain(poses.last()));
            for (a, b) in steps {
                let clearance = capsule_clearance(&self.obstacles, self.spec.to_cells(a.position()), self.spec.to_cells(b.position()), limit, false);
                least = least.min(clearance * self.spec.resolution - radius);
            }
            return least.max(0.0);
        }
        let mut pending: Vec<(Pose2, f64, Pose2, f64)> = Vec::new();
        let mut before: Option<(Pose2, f64)> = None;
        for pose in poses {
            let clearance = self.footprint_clearance(*pose);
            least = least.min(clearance);
            if let Some((last, last_clearance)) = before.replace((*pose, clearance)) {
                pending.push((last, last_clearance, *pose, clearance));
            }
        }
        // Branch and bound: between two poses no point of the footprint moves farther than `motion`, so clearance there is
        // at least the mean of both ends less half the motion.
        let mut certain = least;
        let mut budget = SWEEP_BISECTIONS + 16 * poses.len();
        while let Some((a, at_a, b, at_b)) = pending.pop() {
            let turn = wrap_angle(b.yaw - a.yaw);
            let motion = a.distance(&b) + turn.abs() * self.footprint.circumscribed_radius();
            let bound = 0.5 * (at_a + at_b - motion);
            if bound >= certain {
                continue;
            }
            // Written so that a motion that is not a number ends here as well.
            if !(motion > SWEEP_TOLERANCE && bound < least - SWEEP_TOLERANCE && budget > 0) {
                certain = if bound.is_nan() { 0.0 } else { certain.min(bound) };
                continue;
            }
            budget -= 1;
            let middle = Pose2::new(0.5 * (a.x + b.x), 0.5 * (a.y + b.y), a.yaw + 0.5 * turn);
            let clearance = self.footprint_clearance(middle);
            least = least.min(clearance);
            if least <= 0.0 {
                return 0.0;
            }
            pending.push((a, at_a, middle, clearance));
            pending.push((middle, clearance, b, at_b));
        }
        certain.min(least).max(0.0)
    }
}

/// Whether a disc (m) touches no obstacle.
pub(super) fn is_disc_free(obstacles: &BitGrid, spec: &GridSpec, center: Point2<f64>, radius: f64) -> bool {
    let center = spec.to_cells(center);
    let radius = radius / spec.resolution;
    capsule_clearance(obstacles, center, center, radius, true) > radius
}

/// Exact distance from a point to the nearest obstacle (m), at most `limit`; zero for a non-finite point.
pub(super) fn disc_clearance(obstacles: &BitGrid, spec: &GridSpec, point: Point2<f64>, limit: f64) -> f64 {
    let p = spec.to_cells(point);
    if !(p.x.is_finite() && p.y.is_finite()) {
        return 0.0;
    }
    let height = i64::from(obstacles.height());
    let beyond = |at: f64, end: u32| (-at).max(at - f64::from(end)).max(0.0);
    if beyond(p.x, obstacles.width()).hypot(beyond(p.y, obstacles.height())) * spec.resolution >= limit {
        // Nothing of the grid is near; below, numbers are of a grid's size.
        return limit;
    }
    // A hair more than the limit, so that an obstacle exactly at a bound is still found.
    let mut least = limit / spec.resolution * (1.0 + 1e-12) + 1e-12;
    let (column, row) = (column(p.x), column(p.y));
    let (mut below, mut above) = (row.min(height - 1), (row + 1).max(0));
    let scan = |y: i64, least: &mut f64| -> bool {
        let dy = (y as f64 - p.y).max(p.y - (y + 1) as f64).max(0.0);
        if y < 0 || y >= height || dy >= *least {
            return false;
        }
        // Columns that could still be nearer.
        let half = (*least * *least - dy * dy).sqrt();
        let (low, high) = (self::column(p.x - half) - 1, self::column(p.x + half));
        let left = obstacles.previous_set(y as u32, low, column).map(|x| (p.x - f64::from(x + 1)).max(0.0));
        let right = obstacles.next_set(y as u32, column, high).map(|x| (f64::from(x) - p.x).max(0.0));
        for dx in [left, right].into_iter().flatten() {
            *least = least.min(dx.hypot(dy));
        }
        true
    };
    let (mut down, mut up) = (true, true);
    while down || up {
        down = down && scan(below, &mut least);
        up = up && scan(above, &mut least);
        below -= 1;
        above += 1;
    }
    (least * spec.resolution).min(limit)
}

/// Least distance from a segment to an obstacle, both in cells, when it is at most `limit`, else something greater. With
/// `any` the first one found within the limit ends the search. Minus one for a non-finite segment.
fn capsule_clearance(obstacles: &BitGrid, a: Point2<f64>, b: Point2<f64>, limit: f64, any: bool) -> f64 {
    let d = b - a;
    if !(d.x.is_finite() && d.y.is_finite() && a.x.is_finite() && a.y.is_finite() && limit.is_finite()) {
        return -1.0;
    }
    let mut least = f64::INFINITY;
    let (low, high) = (a.y.min(b.y), a.y.max(b.y));
    let rows = rows_within(obstacles, low - limit, high + limit);
    for y in rows {
        let reach = limit.min(least);
        // The part of the segment within reach of this row, and the columns within reach of that part.
        let (bottom, top) = (f64::from(y) - reach, f64::from(y) + 1.0 + reach);
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        if d.y == 0.0 {
            if a.y < bottom || a.y > top {
                continue;
            }
        } else {
            let (at_bottom, at_top) = ((bottom - a.y) / d.y, (top - a.y) / d.y);
            enter = enter.max(at_bottom.min(at_top));
            leave = leave.min(at_bottom.max(at_top));
            // A rounding error must not lose a touching row.
            if enter > leave + 1e-9 {
                continue;
            }
        }
        let (x0, x1) = (a.x + d.x * enter, a.x + d.x * leave);
        let (from, to) = (column(x0.min(x1) - reach) - 1, column(x0.max(x1) + reach) + 1);
        for x in obstacles.set_in_row(y, from, to) {
            least = least.min(segment_to_square(a, b, x, y));
            if any && least <= limit {
                return least;
            }
        }
    }
    least
}

/// The column or row that a coordinate in cells lies in; far outside any grid it is just far outside.
fn column(at: f64) -> i64 {
    at.floor().clamp(-1e12, 1e12) as i64
}

/// Rows of the grid whose closed squares meet a range of y, cells.
fn rows_within(obstacles: &BitGrid, low: f64, high: f64) -> std::ops::Range<u32> {
    // Casts saturate; one more row at both ends for closed squares.
    let first = (low.floor() - 1.0).max(0.0) as u32;
    let end = ((high.floor() + 2.0).max(0.0) as u32).min(obstacles.height());
    first.min(end)..end
}

/// Exact distance from a segment to the closed square of a cell, cells.
fn segment_to_square(a: Point2<f64>, b: Point2<f64>, x: u32, y: u32) -> f64 {
    let (low, high) = (Vector2::new(f64::from(x), f64::from(y)), Vector2::new(f64::from(x) + 1.0, f64::from(y) + 1.0));
    if segment_meets_box(a, b, low, high) {
        return 0.0;
    }
    // Apart, so the nearest pair has an end of the segment or a corner of the square.
    let point_to_box = |p: Point2<f64>| {
        let (dx, dy) = ((low.x - p.x).max(p.x - high.x).max(0.0), (low.y - p.y).max(p.y - high.y).max(0.0));
        dx.hypot(dy)
    };
    let corners = [(low.x, low.y), (high.x, low.y), (high.x, high.y), (low.x, high.y)];
    let to_corner = corners.iter().map(|(u, v)| point_to_segment(Point2::new(*u, *v), a, b)).fold(f64::INFINITY, f64::min);
    to_corner.min(point_to_box(a)).min(point_to_box(b))
}

fn point_to_segment(p: Point2<f64>, a: Point2<f64>, b: Point2<f64>) -> f64 {
    let (d, to) = (b - a, p - a);
    let length = d.norm_squared();
    let share = if length > 0.0 { (to.dot(&d) / length).clamp(0.0, 1.0) } else { 0.0 };
    (to - d * share).norm()
}

/// Whether a closed segment meets a closed box: separating axes are x, y and the segment's normal.
fn segment_meets_box(a: Point2<f64>, b: Point2<f64>, low: Vector2<f64>, high: Vector2<f64>) -> bool {
    if a.x.max(b.x) < low.x || a.x.min(b.x) > high.x || a.y.max(b.y) < low.y || a.y.min(b.y) > high.y {
        return false;
    }
    let d = b - a;
    let side = |u: f64, v: f64| d.x * (v - a.y) - d.y * (u - a.x);
    let sides = [side(low.x, low.y), side(high.x, low.y), side(high.x, high.y), side(low.x, high.y)];
    !(sides.iter().all(|s| *s > 0.0) || sides.iter().all(|s| *s < 0.0))
}

/// Least distance from a convex polygon to an obstacle, both in cells; at most `limit`.
fn polygon_clearance(obstacles: &BitGrid, outline: &[Point2<f64>], limit: f64) -> f64 {
    let fold = |pick: fn(&Point2<f64>) -> f64, start: f64, best: fn(f64, f64) -> f64| outline.iter().map(pick).fold(start, best);
    let (left, right) = (fold(|p| p.x, f64::INFINITY, f64::min), fold(|p| p.x, f64::NEG_INFINITY, f64::max));
    let (low, high) = (fold(|p| p.y, f64::INFINITY, f64::min), fold(|p| p.y, f64::NEG_INFINITY, f64::max));
    let mut least = limit;
    for y in rows_within(obstacles, low - limit, high + limit) {
        // Rows are convex obstacles as well: one that is farther away than the best so far has nothing to add.
        if f64::from(y) - high > least || low - f64::from(y) - 1.0 > least {
            continue;
        }
        let (from, to) = (column(left - least) - 1, column(right + least) + 1);
        for x in obstacles.set_in_row(y, from, to) {
            least = least.min(polygon_to_square(outline, x, y));
            if least <= 0.0 {
                return 0.0;
            }
        }
    }
    least
}

/// Exact distance from a convex polygon (counter-clockwise) to the closed square of a cell, cells.
fn polygon_to_square(outline: &[Point2<f64>], x: u32, y: u32) -> f64 {
    let center = Point2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    let edges = || outline.iter().zip(outline.iter().cycle().skip(1));
    let inside = edges().all(|(a, b)| {
        let (d, to) = (b - a, center - a);
        d.x * to.y - d.y * to.x >= 0.0
    });
    if inside {
        return 0.0;
    }
    // The square's centre is outside, so a polygon that meets the square has an edge that does.
    edges().map(|(a, b)| segment_to_square(*a, *b, x, y)).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use zenav_protocol::grid::{Cell, Grid, Occupancy, OccupancyGrid};

    use super::*;

    const SPEC: GridSpec = GridSpec { origin: Point2::new(-1.0, 2.0), resolution: 0.1, width: 70, height: 60 };

    fn map(occupied: &[(u32, u32)]) -> OccupancyGrid {
        let mut grid = Grid::filled(SPEC, Occupancy::FREE);
        for (x, y) in occupied {
            grid[Cell::new(x % SPEC.width, y % SPEC.height)] = Occupancy::OCCUPIED;
        }
        grid
    }

    fn space(occupied: &[(u32, u32)], footprint: &Footprint) -> ConfigurationSpace {
        ConfigurationSpace::new(&map(occupied), footprint, UnknownPolicy::Blocked, 0.0)
    }

    fn oblong() -> Footprint {
        Footprint::Polygon(vec![Point2::new(-0.3, -0.12), Point2::new(0.25, -0.15), Point2::new(0.3, 0.12), Point2::new(-0.25, 0.15)])
    }

    /// Distance from a point to every occupied square, the least.
    fn brute(occupied: &[(u32, u32)], p: Point2<f64>) -> f64 {
        let squares = occupied.iter().map(|(x, y)| {
            let corner = SPEC.origin + Vector2::new(f64::from(x % SPEC.width), f64::from(y % SPEC.height)) * SPEC.resolution;
            let (dx, dy) = ((corner.x - p.x).max(p.x - corner.x - SPEC.resolution).max(0.0), (corner.y - p.y).max(p.y - corner.y - SPEC.resolution).max(0.0));
            dx.hypot(dy)
        });
        squares.fold(f64::INFINITY, f64::min)
    }

    fn point() -> impl Strategy<Value = Point2<f64>> {
        (-2.0..7.0, 1.0..9.0).prop_map(|(x, y)| Point2::new(x, y))
    }

    fn cells() -> impl Strategy<Value = Vec<(u32, u32)>> {
        proptest::collection::vec((0_u32..70, 0_u32..60), 0..15)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(96))]

        #[test]
        fn clearance_is_that_of_the_nearest_square(occupied in cells(), p in point()) {
            let space = space(&occupied, &Footprint::Radius(0.25));
            let expected = brute(&occupied, p).min(space.reach());
            prop_assert!((space.clearance(p) - expected).abs() < 1e-9);
        }

        #[test]
        fn a_segment_is_as_clear_as_its_densest_samples_say(occupied in cells(), a in point(), b in point()) {
            let space = space(&occupied, &Footprint::Radius(0.25));
            let exact = space.segment_clearance(a, b);
            let samples = 2000;
            let sampled = (0..=samples).map(|i| brute(&occupied, a + (b - a) * (f64::from(i) / f64::from(samples)))).fold(f64::INFINITY, f64::min);
            let step = (b - a).norm() / f64::from(samples);
            prop_assert!(exact <= sampled.min(space.reach()) + 1e-9, "{exact} above a sample, {sampled}");
            prop_assert!(exact >= (sampled - step).min(space.reach()) - 1e-9, "{exact} below the truth, {sampled}");
            for radius in [0.0, 0.1, 0.5] {
                if (exact - radius).abs() > 1e-9 {
                    prop_assert_eq!(space.segment_is_free(a, b, radius), exact > radius);
                }
            }
        }

        #[test]
        fn one_occupied_cell_on_the_way_is_never_missed(x in 1_u32..69, y in 1_u32..59, inside in (0.01..0.99, 0.01..0.99), angle in 0.0..6.3, before in 0.01..5.0, after in 0.01..5.0) {
            let space = space(&[(x, y)], &Footprint::Radius(0.01));
            let through = SPEC.origin + Vector2::new(f64::from(x) + inside.0, f64::from(y) + inside.1) * SPEC.resolution;
            let way = Vector2::new(f64::cos(angle), f64::sin(angle));
            prop_assert!(!space.segment_is_free(through - way * before, through + way * after, 0.0));
        }

        #[test]
        fn steps_between_free_neighbours_are_free_for_the_disc(occupied in cells(), radius in 0.02..0.6) {
            let space = space(&occupied, &Footprint::Radius(radius));
            for y in 1..SPEC.height {
                for x in 1..SPEC.width - 1 {
                    let here = Cell::new(x, y);
                    for there in [Cell::new(x - 1, y), Cell::new(x, y - 1), Cell::new(x - 1, y - 1), Cell::new(x + 1, y - 1)] {
                        if space.is_free(here) && space.is_free(there) {
                            prop_assert!(space.segment_is_free(SPEC.center(here), SPEC.center(there), radius));
                        }
                    }
                    if space.is_free(here) {
                        prop_assert!(space.is_valid(Pose2::new(SPEC.center(here).x, SPEC.center(here).y, 0.0)));
                    }
                }
            }
        }

        #[test]
        fn a_footprint_is_as_clear_as_the_distance_to_dense_points_of_the_squares(occupied in cells(), p in point(), yaw in -3.0..3.0) {
            let footprint = oblong();
            let space = space(&occupied, &footprint);
            let pose = Pose2::new(p.x, p.y, yaw);
            let base_from_map = pose.inverse();
            let mut sampled = f64::INFINITY;
            for (x, y) in &occupied {
                for i in 0..=20 {
                    for j in 0..=20 {
                        let q = SPEC.origin + Vector2::new(f64::from(*x) + f64::from(i) / 20.0, f64::from(*y) + f64::from(j) / 20.0) * SPEC.resolution;
                        sampled = sampled.min(footprint.distance(base_from_map.transform_point(q)));
                    }
                }
            }
            let exact = space.footprint_clearance(pose);
            prop_assert!(exact <= sampled.min(space.reach()) + 1e-9, "{exact} above {sampled}");
            prop_assert!(exact >= (sampled - 0.004).min(space.reach()) - 1e-9, "{exact} below {sampled}");
            if space.is_permitted(p) && exact > 1e-9 {
                prop_assert!(space.is_valid(pose));
            }
            if sampled == 0.0 {
                prop_assert!(!space.is_valid(pose));
            }
        }

        #[test]
        fn a_sweep_is_as_clear_as_its_densest_samples_say(occupied in cells(), a in point(), b in point(), yaws in (-3.0..3.0, -3.0..3.0)) {
            for footprint in [oblong(), Footprint::Radius(0.3)] {
                let space = space(&occupied, &footprint);
                let (from, to) = (Pose2::new(a.x, a.y, yaws.0), Pose2::new(b.x, b.y, yaws.1));
                let turn = wrap_angle(to.yaw - from.yaw);
                let samples = 400;
                let sampled = (0..=samples).map(|i| {
                    let t = f64::from(i) / f64::from(samples);
                    space.footprint_clearance(Pose2::new(from.x + (to.x - from.x) * t, from.y + (to.y - from.y) * t, from.yaw + turn * t))
                });
                let sampled = sampled.fold(f64::INFINITY, f64::min);
                let step = (from.distance(&to) + turn.abs() * footprint.circumscribed_radius()) / f64::from(samples);
                let clearance = space.sweep_min_clearance(&[from, to]);
                prop_assert!(clearance <= sampled + 1e-9, "{clearance} above {sampled}");
                prop_assert!(clearance >= sampled - step - SWEEP_TOLERANCE - 1e-9, "{clearance} below {sampled}");
            }
        }

        #[test]
        fn the_nearest_free_place_is_the_nearest_of_all(occupied in cells(), p in point()) {
            let space = space(&occupied, &Footprint::Radius(0.5));
            let all = (0..SPEC.len()).map(|index| SPEC.cell(index)).filter(|cell| space.is_free(*cell));
            let least = all.map(|cell| (SPEC.center(cell) - p).norm()).fold(f64::INFINITY, f64::min);
            let found = space.nearest_free(p).map_or(f64::INFINITY, |found| (found - p).norm());
            prop_assert!(found == least || (found - least).abs() < 1e-9);
        }

        #[test]
        fn no_numbers_from_outside_do_harm(x in any::<f64>(), y in any::<f64>(), yaw in any::<f64>(), u in any::<f64>()) {
            for footprint in [oblong(), Footprint::Radius(0.3)] {
                let space = space(&[(3, 4)], &footprint);
                let pose = Pose2 { x, y, yaw };
                let (_, _, _) = (space.is_valid(pose), space.footprint_clearance(pose), space.nearest_free(pose.position()));
                let _ = space.segment_is_free(pose.position(), Point2::new(u, x), u);
                let _ = space.segment_clearance(pose.position(), Point2::new(u, x));
                let _ = space.sweep_min_clearance(&[pose, Pose2 { x: u, y: x, yaw: y }]);
            }
        }
    }

    #[test]
    fn unknown_cells_follow_the_policy() {
        let mut grid = map(&[]);
        grid[Cell::new(30, 30)] = Occupancy::UNKNOWN;
        let (unknown, beside) = (Cell::new(30, 30), Cell::new(31, 30));
        let space = |policy| ConfigurationSpace::new(&grid, &Footprint::Radius(0.3), policy, 0.0);
        let free = space(UnknownPolicy::Free);
        assert!(free.is_free(unknown) && free.is_free(beside) && free.is_permitted(Point2::new(100.0, 0.0)));
        let blocked = space(UnknownPolicy::Blocked);
        assert!(!blocked.is_free(unknown) && blocked.is_free(beside) && !blocked.is_permitted(Point2::new(100.0, 0.0)));
        let obstacle = space(UnknownPolicy::Obstacle);
        assert!(!obstacle.is_free(unknown) && !obstacle.is_free(beside));
    }

    #[test]
    fn a_robot_larger_than_the_field_reaches_is_still_exact() {
        let spec = GridSpec { resolution: 0.01, width: 300, height: 200, ..SPEC };
        let mut grid = Grid::filled(spec, Occupancy::FREE);
        grid[Cell::new(5, 100)] = Occupancy::OCCUPIED;
        let space = ConfigurationSpace::new(&grid, &Footprint::Radius(1.0), UnknownPolicy::Free, 0.0);
        assert!(!space.is_free(Cell::new(105, 100)) && space.is_free(Cell::new(106, 100)));
        let beside = spec.center(Cell::new(106, 100));
        assert!(space.is_valid(Pose2::new(beside.x, beside.y, 0.0)));
    }
}
