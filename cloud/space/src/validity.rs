//! State validity. Whether the true footprint fits at a pose, along a segment, or along a sweep of poses.
//!
//! Every check is exact against the closed squares of occupied cells: candidates come from bit scans of the rows that the shape can
//! reach, and each candidate is measured in closed form (`shapes`). There is no step size.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::robot::Footprint;

use super::configuration::{ConfigurationSpace, UnknownPolicy};
use super::shapes::{capsule_clearance, disc_clearance, polygon_clearance};

/// A clearance of this size answers whether there is any, m.
const ANY: f64 = 1e-6;
/// Sweeps are bisected until their clearance is certain to within this, m.
const SWEEP_TOLERANCE: f64 = 1e-3;

/// Largest number of bisections of one sweep, plus some for each pose: no input keeps it busy for long.
const SWEEP_BISECTIONS: usize = 10_000;

impl ConfigurationSpace {
    /// Whether the robot may stand at a pose: its true footprint touches no obstacle, and its centre is on a cell that the policy for
    /// unknown cells permits.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
    /// assert!(space.is_valid(Pose2::new(1.7, 2.0, 0.0)) && !space.is_valid(Pose2::new(1.85, 2.0, 0.0)));
    /// ```
    #[must_use]
    pub fn is_valid(&self, pose: Pose2) -> bool {
        if !pose.is_finite() || !self.is_permitted(pose.position()) {
            return false;
        }
        let at = pose.position();
        if let Some(cell) = self.spec.cell_at(at) {
            // The distance of the cell's centre bounds that of the point, and often decides.
            let (distance, off) = (self.field.distance(cell), (self.spec.center(cell) - at).norm());
            if distance < self.reach() && distance + off < self.footprint.inscribed_radius() {
                return false;
            }
            if distance - off > self.footprint.circumscribed_radius() {
                return true;
            }
        }
        match self.footprint {
            // A disc that touches an obstacle collides; a point collides only on the obstacle's closed square.
            Footprint::Radius(radius) => {
                let enough = radius + self.spec.resolution;
                disc_clearance(self.obstacles(), &self.spec, at, enough) > radius
            }
            Footprint::Polygon(_) => self.footprint_clearance_within(pose, ANY) > 0.0,
        }
    }

    /// Whether the policy for unknown cells lets the robot's centre be at a point.
    #[must_use]
    pub fn is_permitted(&self, point: Point2<f64>) -> bool {
        match self.spec.cell_at(point) {
            Some(cell) => !self.forbidden().get(cell),
            None => self.unknown_policy == UnknownPolicy::Free,
        }
    }

    /// Whether the policy for unknown cells lets the robot's centre go straight from `a` to `b`: it touches no forbidden square.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::UNKNOWN; // from (2.0, 2.0) to (2.1, 2.1)
    /// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Blocked, 0.0);
    /// let goes = |y| space.is_permitted_between(Point2::new(1.0, y), Point2::new(3.0, y));
    /// assert!(!goes(2.05) && goes(2.15), "the robot's body may reach over the cell");
    /// ```
    #[must_use]
    pub fn is_permitted_between(&self, a: Point2<f64>, b: Point2<f64>) -> bool {
        let on_squares = || {
            self.forbidden
                .is_touched_by_window(self.spec.to_cells(a), self.spec.to_cells(b), 0.0)
        };
        self.unknown_policy == UnknownPolicy::Free || (self.is_permitted(a) && self.is_permitted(b) && !on_squares())
    }

    /// Exact distance from the true footprint at a pose to the nearest obstacle, m; at most [`reach`](Self::reach), zero in
    /// collision and for a non-finite pose.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let corners = [(-0.4, -0.15), (0.4, -0.15), (0.4, 0.15), (-0.4, 0.15)]; // m, base frame
    /// let footprint = Footprint::Polygon(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
    /// let space = ConfigurationSpace::new(&map, &footprint, UnknownPolicy::Free, 0.0);
    /// assert!((space.footprint_clearance(Pose2::new(1.5, 2.05, 0.0)) - 0.1).abs() < 1e-9);
    /// assert_eq!(space.footprint_clearance(Pose2::new(1.7, 2.05, 0.0)), 0.0, "in collision");
    /// ```
    #[must_use]
    pub fn footprint_clearance(&self, pose: Pose2) -> f64 {
        self.footprint_clearance_within(pose, self.reach())
    }

    /// Like [`footprint_clearance`](Self::footprint_clearance), but at most `limit` (m): the smaller, the faster.
    #[must_use]
    pub fn footprint_clearance_within(&self, pose: Pose2, limit: f64) -> f64 {
        if !pose.is_finite() {
            return 0.0;
        }
        let at = pose.position();
        let corners = match &self.footprint {
            Footprint::Polygon(corners) => corners,
            Footprint::Radius(radius) => {
                return (disc_clearance(self.obstacles(), &self.spec, at, limit + radius) - radius).max(0.0);
            }
        };
        let mut limit = limit;
        if let Some(cell) = self.spec.cell_at(at) {
            // The footprint has at least the clearance of its circumscribed disc, and at most that of its inscribed disc.
            let (distance, off) = (self.field.distance(cell), (self.spec.center(cell) - at).norm());
            if distance - off >= self.footprint.circumscribed_radius() + limit {
                return limit;
            }
            if distance < self.reach() {
                limit = limit.min((distance + off - self.footprint.inscribed_radius()).max(ANY));
            }
        }
        let outline = corners
            .iter()
            .map(|corner| self.spec.to_cells(pose.transform_point(*corner)));
        let outline: Vec<_> = outline.collect();
        polygon_clearance(self.obstacles(), &outline, limit / self.spec.resolution) * self.spec.resolution
    }

    /// Whether a disc of `radius` (m) moved from `a` to `b` touches no obstacle. Unknown cells count only under
    /// [`UnknownPolicy::Obstacle`].
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
    /// let [left, right] = [Point2::new(1.0, 2.3), Point2::new(3.0, 2.3)];
    /// assert!(space.segment_is_free(left, right, 0.15) && !space.segment_is_free(left, right, 0.25));
    /// ```
    #[must_use]
    pub fn segment_is_free(&self, a: Point2<f64>, b: Point2<f64>, radius: f64) -> bool {
        !self.obstacles.is_touched_by_disc(
            self.spec.to_cells(a),
            self.spec.to_cells(b),
            radius.max(0.0) / self.spec.resolution,
        )
    }

    /// Exact least distance from a segment to an obstacle, m; at most [`reach`](Self::reach).
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Blocked, 0.0);
    /// let clearance = space.segment_clearance(Point2::new(1.0, 1.5), Point2::new(3.0, 1.5));
    /// assert!((clearance - 0.5).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn segment_clearance(&self, a: Point2<f64>, b: Point2<f64>) -> f64 {
        let limit = self.reach() / self.spec.resolution;
        capsule_clearance(self.obstacles(), self.spec.to_cells(a), self.spec.to_cells(b), limit).min(limit)
            * self.spec.resolution
    }

    /// Least distance of the true footprint to an obstacle while it moves through the poses, m; at most [`reach`](Self::reach), and at most
    /// `limit` (m): the smaller, the faster. Between two poses position and heading (the shorter way round) change linearly.
    ///
    /// Never above the true value, and at most a millimetre below it (for steps that a robot makes; after ten thousand bisections a safe
    /// bound is returned): zero means a collision or less than a millimetre to spare.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
    /// let clearance = space.sweep_clearance_within(&[Pose2::new(1.0, 2.5, 0.0), Pose2::new(3.0, 2.5, 0.5)], 1.0);
    /// assert!((clearance - 0.2).abs() < 1e-3);
    /// ```
    #[must_use]
    pub fn sweep_clearance_within(&self, poses: &[Pose2], limit: f64) -> f64 {
        let mut least = limit.min(self.reach());
        if let Footprint::Radius(radius) = &self.footprint {
            let steps = poses.iter().zip(poses.iter().skip(1).chain(poses.last()));
            for (a, b) in steps {
                let clearance = capsule_clearance(
                    self.obstacles(),
                    self.spec.to_cells(a.position()),
                    self.spec.to_cells(b.position()),
                    (least.max(0.0) + radius) / self.spec.resolution,
                );
                least = least.min(clearance * self.spec.resolution - radius);
            }
            return least.max(0.0);
        }
        let around = self.footprint.circumscribed_radius();
        let moved = |a: &Pose2, b: &Pose2| a.distance(b) + wrap_angle(b.yaw - a.yaw).abs() * around;
        // A clearance of the least plus this rules out a lower one half a step away.
        let step = poses
            .windows(2)
            .map(|pair| moved(&pair[0], &pair[1]))
            .fold(0.0, f64::max);
        let mut pending: Vec<(Pose2, f64, Pose2, f64)> = Vec::new();
        let mut before: Option<(Pose2, f64)> = None;
        for pose in poses {
            let clearance = self.footprint_clearance_within(*pose, least + step);
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
            let motion = moved(&a, &b);
            let bound = 0.5 * (at_a + at_b - motion);
            if bound >= certain {
                continue;
            }
            // Written so that a motion that is NaN ends here as well.
            if !(motion > SWEEP_TOLERANCE && bound < least - SWEEP_TOLERANCE && budget > 0) {
                certain = if bound.is_nan() { 0.0 } else { certain.min(bound) };
                continue;
            }
            budget -= 1;
            let middle = Pose2::new(0.5 * (a.x + b.x), 0.5 * (a.y + b.y), a.yaw + 0.5 * turn);
            let clearance = self.footprint_clearance_within(middle, least + motion);
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

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use proptest::prelude::*;
    use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};

    use super::*;

    const SPEC: GridSpec = GridSpec {
        origin: Point2::new(-1.0, 2.0),
        resolution: 0.1,
        width: 70,
        height: 60,
    };

    fn map(occupied: &[(u32, u32)]) -> OccupancyGrid {
        zenav_fixtures::map_with_occupied(SPEC, occupied)
    }

    fn space(occupied: &[(u32, u32)], footprint: &Footprint) -> ConfigurationSpace {
        ConfigurationSpace::new(&map(occupied), footprint, UnknownPolicy::Blocked, 0.0)
    }

    fn oblong() -> Footprint {
        zenav_fixtures::footprint(&[(-0.3, -0.12), (0.25, -0.15), (0.3, 0.12), (-0.25, 0.15)])
    }

    /// Least distance from a point to the occupied squares.
    fn brute(occupied: &[(u32, u32)], p: Point2<f64>) -> f64 {
        let squares = occupied.iter().map(|(x, y)| {
            let corner =
                SPEC.origin + Vector2::new(f64::from(x % SPEC.width), f64::from(y % SPEC.height)) * SPEC.resolution;
            let (dx, dy) = (
                (corner.x - p.x).max(p.x - corner.x - SPEC.resolution).max(0.0),
                (corner.y - p.y).max(p.y - corner.y - SPEC.resolution).max(0.0),
            );
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
        fn one_occupied_cell_on_the_path_is_never_missed(x in 1_u32..69, y in 1_u32..59, inside in (0.01..0.99, 0.01..0.99), angle in 0.0..6.3, before in 0.01..5.0, after in 0.01..5.0) {
            let space = space(&[(x, y)], &Footprint::Radius(0.01));
            let through = SPEC.origin + Vector2::new(f64::from(x) + inside.0, f64::from(y) + inside.1) * SPEC.resolution;
            let path = Vector2::new(f64::cos(angle), f64::sin(angle));
            prop_assert!(!space.segment_is_free(through - path * before, through + path * after, 0.0));
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
                let clearance = space.sweep_clearance_within(&[from, to], space.reach());
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
                let _ = space.sweep_clearance_within(&[pose, Pose2 { x: u, y: x, yaw: y }], f64::INFINITY);
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
        let spec = GridSpec {
            resolution: 0.01,
            width: 300,
            height: 200,
            ..SPEC
        };
        let grid = zenav_fixtures::map_with_occupied(spec, &[(5, 100)]);
        let space = ConfigurationSpace::new(&grid, &Footprint::Radius(1.0), UnknownPolicy::Free, 0.0);
        assert!(!space.is_free(Cell::new(105, 100)) && space.is_free(Cell::new(106, 100)));
        let beside = spec.center(Cell::new(106, 100));
        assert!(space.is_valid(Pose2::new(beside.x, beside.y, 0.0)));
    }
}
