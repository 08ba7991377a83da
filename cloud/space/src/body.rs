//! Motions of the footprint. Whether there is room to drive straight, to turn on the spot, or to move a little.
//!
//! A convex footprint that drives straight along its heading sweeps the convex hull of its first and its last outline, so legs of any
//! length are measured exactly. Turns and small motions are bisected: the motion of the centre and the circumscribed radius bound how far
//! any point of the footprint moves. All of it is measured by `shapes`, whose own code `cargo bench -p zenav-space --bench space` compares
//! with parry's.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::Cell;
use zenav_protocol::polygon::cross;
use zenav_protocol::robot::Footprint;

use super::configuration::ConfigurationSpace;
use super::shapes::{capsule_clearance, outer_squares, polygon_clearance, polygon_touches};

/// Length of a piece that is measured exactly where there is no room to hop, cells.
const PIECE: f64 = 4.0;

/// Motions in which no point of the footprint moves farther are not bisected further, m: less room than that counts as none.
const CERTAIN: f64 = 5e-4;
/// Largest number of bisections of a motion: a turn in a narrow place takes a few hundred.
const BISECTIONS: usize = 10_000;

impl ConfigurationSpace {
    /// Least distance (m) of the true footprint to an obstacle while it drives straight from `a` to `b`, heading along the leg; at most
    /// `limit`, zero if it collides. A leg without length has no heading: the clearance of the inscribed disc.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
    /// let clearance = space.leg_clearance(Point2::new(1.0, 1.5), Point2::new(3.0, 1.5), 1.0);
    /// assert!((clearance - 0.3).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn leg_clearance(&self, a: Point2<f64>, b: Point2<f64>, limit: f64) -> f64 {
        let resolution = self.spec.resolution;
        let (from, to) = (self.spec.to_cells(a), self.spec.to_cells(b));
        let along = b - a;
        match &self.footprint {
            Footprint::Polygon(corners) if along.norm_squared() > 0.0 => {
                // The footprint has at least the clearance of its circumscribed disc.
                if self.segment_is_free(a, b, limit + self.footprint.circumscribed_radius()) {
                    return limit;
                }
                let hull = convex_hull(&swept_corners(corners, Pose2::new(a.x, a.y, along.y.atan2(along.x)), b));
                let outline: Vec<_> = hull.into_iter().map(|corner| self.spec.to_cells(corner)).collect();
                if outline.iter().any(|p| !(p.x.is_finite() && p.y.is_finite())) {
                    return 0.0;
                }
                polygon_clearance(self.obstacles(), &outline, limit / resolution) * resolution
            }
            footprint => {
                let radius = footprint.inscribed_radius();
                let reach = (limit + radius) / resolution;
                let distance = capsule_clearance(self.obstacles(), from, to, reach);
                (distance.min(reach) * resolution - radius).max(0.0)
            }
        }
    }

    /// Whether the true footprint may turn on the spot, the shorter way round.
    ///
    /// ```
    /// # use std::f64::consts::FRAC_PI_2;
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let corners = [(-0.4, -0.15), (0.4, -0.15), (0.4, 0.15), (-0.4, 0.15)];
    /// let footprint = Footprint::Polygon(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
    /// let space = ConfigurationSpace::new(&map, &footprint, UnknownPolicy::Free, 0.0);
    /// assert!(space.turn_is_free(Point2::new(1.5, 2.05), FRAC_PI_2, 0.0));
    /// assert!(!space.turn_is_free(Point2::new(1.7, 2.05), FRAC_PI_2, 0.0), "the front hits the square");
    /// ```
    #[must_use]
    pub fn turn_is_free(&self, at: Point2<f64>, from: f64, to: f64) -> bool {
        let pose = |yaw: f64| Pose2 { x: at.x, y: at.y, yaw };
        self.motion_is_free(pose(from), pose(from + wrap_angle(to - from)))
    }

    /// Whether the true footprint touches nothing while position and heading change linearly from one pose to another (the heading as
    /// given, not the shorter way round). Never true for a collision; `false` with less than half a millimetre to spare.
    ///
    /// ```
    /// # use std::f64::consts::{FRAC_PI_2, TAU};
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// # map[Cell::new(20, 20)] = Occupancy::OCCUPIED;
    /// # let corners = [(-0.4, -0.15), (0.4, -0.15), (0.4, 0.15), (-0.4, 0.15)];
    /// # let footprint = Footprint::Polygon(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
    /// # let space = ConfigurationSpace::new(&map, &footprint, UnknownPolicy::Free, 0.0);
    /// // The robot of 0.8 m by 0.3 m stands beside an obstacle, 0.15 m from its side: a full turn is no turn at all for `turn_is_free`.
    /// let at = |yaw| Pose2 { x: 1.7, y: 2.05, yaw };
    /// assert!(space.turn_is_free(at(FRAC_PI_2).position(), FRAC_PI_2, FRAC_PI_2 + TAU));
    /// assert!(!space.motion_is_free(at(FRAC_PI_2), at(FRAC_PI_2 + TAU)));
    /// assert!(space.motion_is_free(at(FRAC_PI_2), at(FRAC_PI_2 - 0.1)));
    /// ```
    #[must_use]
    pub fn motion_is_free(&self, from: Pose2, to: Pose2) -> bool {
        if !(from.is_finite() && to.is_finite()) {
            return false;
        }
        let around = self.footprint.circumscribed_radius();
        if self.disc_passes(from.position(), to.position(), around) {
            return true;
        }
        if matches!(self.footprint, Footprint::Radius(_)) {
            return false;
        }
        let mut pending = vec![(from, to)];
        for _ in 0..BISECTIONS {
            let Some((from, to)) = pending.pop() else {
                return true;
            };
            let middle = Pose2 {
                x: 0.5 * (from.x + to.x),
                y: 0.5 * (from.y + to.y),
                yaw: 0.5 * (from.yaw + to.yaw),
            };
            // No point of the footprint is farther from its place in the middle than this.
            let motion = 0.5 * (from.distance(&to) + (to.yaw - from.yaw).abs() * around);
            let clearance = self.footprint_clearance_within(middle, motion + CERTAIN);
            if clearance > motion {
                continue;
            }
            if clearance <= 0.0 || motion < CERTAIN {
                return false;
            }
            pending.extend([(from, middle), (middle, to)]);
        }
        false
    }

    /// Whether a disc of `radius` (m) moves freely from `a` to `b`: like [`segment_is_free`](Self::segment_is_free), but in hops as long
    /// as the room that the distance field shows (Hart, "Sphere Tracing", 1996); only close stretches are measured.
    #[must_use]
    pub fn disc_passes(&self, a: Point2<f64>, b: Point2<f64>, radius: f64) -> bool {
        let resolution = self.spec.resolution;
        let d = b - a;
        let length = d.norm();
        if !(length.is_finite() && a.x.is_finite() && a.y.is_finite()) {
            return false;
        }
        let along = |at: f64| if at < length { a + d * (at / length) } else { b };
        let piece = PIECE * resolution;
        let mut at = 0.0;
        loop {
            let p = along(at);
            let Some(cell) = self.spec.cell_at(p) else {
                return self.segment_is_free(p, b, radius);
            };
            // Distance changes by at most the distance moved: the centre's value bounds the point's.
            let room = self.field().distance(cell) - (p - self.spec.center(cell)).norm() - radius;
            if room > 0.5 * resolution {
                at += room - 1e-9 * resolution;
            } else if self.segment_is_free(p, along(at + piece), radius) {
                at += piece;
            } else {
                return false;
            }
            if at >= length {
                return true;
            }
        }
    }

    /// Visits the centre of every obstacle, or of every forbidden cell, that a convex outline (m) touches, except those that are
    /// surrounded by others.
    pub fn outer_cells(&self, outline: &[Point2<f64>], forbidden: bool, mut visit: impl FnMut(Point2<f64>)) {
        let bits = if forbidden { self.forbidden() } else { self.obstacles() };
        let outline: Vec<_> = outline.iter().map(|p| self.spec.to_cells(*p)).collect();
        outer_squares(bits, &outline, |x, y| visit(self.spec.center(Cell::new(x, y))));
    }

    /// Whether a convex outline, in cells of the grid, touches no obstacle.
    #[must_use]
    pub fn is_clear_of(&self, outline: &[Point2<f64>]) -> bool {
        !polygon_touches(self.obstacles(), outline)
    }
}

/// Corners (base frame, m) of the footprint at a pose, and at another position with the same heading; map frame, m. Their hull is what a
/// convex footprint sweeps in between.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::geometry::Pose2;
/// use zenav_space::{convex_hull, swept_corners};
///
/// // A square of 0.4 m drives 1 m ahead.
/// let corners = [(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)].map(|(x, y)| Point2::new(x, y));
/// let swept = convex_hull(&swept_corners(&corners, Pose2::IDENTITY, Point2::new(1.0, 0.0)));
/// assert!(swept.iter().all(|corner| corner.x == -0.2 || corner.x == 1.2));
/// ```
pub fn swept_corners(corners: &[Point2<f64>], from: Pose2, to: Point2<f64>) -> Vec<Point2<f64>> {
    let there = Pose2::new(to.x, to.y, from.yaw);
    [from, there]
        .iter()
        .flat_map(|pose| corners.iter().map(|corner| pose.transform_point(*corner)))
        .collect()
}

/// Convex hull, counter-clockwise (Andrew, "Another Efficient Algorithm for Convex Hulls in Two Dimensions", 1979).
///
/// ```
/// use nalgebra::Point2;
/// use zenav_space::convex_hull;
///
/// let points = [(0.0, 0.0), (2.0, 0.0), (1.0, 0.5), (2.0, 2.0), (0.0, 2.0)].map(|(x, y)| Point2::new(x, y));
/// assert_eq!(convex_hull(&points).len(), 4);
/// ```
pub fn convex_hull(points: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    sorted.dedup();
    let mut hull: Vec<Point2<f64>> = Vec::with_capacity(sorted.len() + 1);
    let chain = |hull: &mut Vec<Point2<f64>>, base: usize, point: Point2<f64>| {
        while let [.., a, b] = hull[base..] {
            if cross(b - a, point - a) > 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(point);
    };
    for point in &sorted {
        chain(&mut hull, 0, *point);
    }
    let base = hull.len().saturating_sub(1);
    for point in sorted.iter().rev().skip(1) {
        chain(&mut hull, base, *point);
    }
    if hull.len() > 1 {
        hull.pop();
    }
    hull
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use zenav_protocol::grid::GridSpec;

    use super::*;
    use crate::UnknownPolicy;

    const SPEC: GridSpec = GridSpec {
        origin: Point2::new(-1.0, 2.0),
        resolution: 0.1,
        width: 70,
        height: 60,
    };

    /// A robot whose base is off its middle.
    fn space(occupied: &[(u32, u32)]) -> ConfigurationSpace {
        let grid = zenav_fixtures::map_with_occupied(SPEC, occupied);
        let outline = [(-0.4, -0.15), (0.1, -0.18), (0.2, 0.0), (0.1, 0.18), (-0.4, 0.15)];
        ConfigurationSpace::new(&grid, &zenav_fixtures::footprint(&outline), UnknownPolicy::Blocked, 0.0)
    }

    fn point() -> impl Strategy<Value = Point2<f64>> {
        (-1.0..6.0, 2.0..8.0).prop_map(|(x, y)| Point2::new(x, y))
    }

    fn cells() -> impl Strategy<Value = Vec<(u32, u32)>> {
        prop::collection::vec((0_u32..70, 0_u32..60), 0..25)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn a_leg_is_as_clear_as_its_densest_samples_say(occupied in cells(), a in point(), b in point(), limit in prop::sample::select(vec![0.05, 0.3, 0.9])) {
            let space = space(&occupied);
            let yaw = (b.y - a.y).atan2(b.x - a.x);
            let samples = 600;
            let sampled = (0..=samples).map(|i| a + (b - a) * (f64::from(i) / f64::from(samples))).map(|p| space.footprint_clearance(Pose2::new(p.x, p.y, yaw))).fold(f64::INFINITY, f64::min);
            let clearance = space.leg_clearance(a, b, limit);
            let step = (b - a).norm() / f64::from(samples);
            prop_assert!(clearance <= sampled.min(limit) + 1e-9, "{clearance} above {sampled}");
            prop_assert!(clearance >= (sampled - step).min(limit) - 1e-9, "{clearance} below {sampled}");
        }

        #[test]
        fn a_disc_passes_where_its_segment_is_free(occupied in cells(), a in point(), b in point(), radius in prop::sample::select(vec![0.0, 0.2, 0.6, 1.3])) {
            let space = space(&occupied);
            if (space.segment_clearance(a, b) - radius).abs() > 1e-8 {
                prop_assert_eq!(space.disc_passes(a, b, radius), space.segment_is_free(a, b, radius));
            }
        }

        #[test]
        fn outer_cells_are_the_obstacles_in_an_outline(occupied in cells(), a in point(), b in point(), c in point()) {
            let space = space(&occupied);
            let outline = convex_hull(&[a, b, c]);
            let mut found = Vec::new();
            space.outer_cells(&outline, false, |center| found.extend(SPEC.cell_at(center)));
            found.sort();
            let in_cells: Vec<_> = outline.iter().map(|p| SPEC.to_cells(*p)).collect();
            let touched = |cell: &Cell| {
                let grid = zenav_fixtures::map_with_occupied(SPEC, &[(cell.x, cell.y)]);
                let alone = ConfigurationSpace::new(&grid, space.footprint(), UnknownPolicy::Free, 0.0);
                !alone.is_clear_of(&in_cells)
            };
            let mut all: Vec<_> = occupied.iter().map(|(x, y)| Cell::new(x % SPEC.width, y % SPEC.height)).collect();
            all.sort();
            all.dedup();
            for cell in all {
                let alone = [(1, 0), (-1, 0), (0, 1), (0, -1)].iter().any(|(dx, dy)| !space.obstacles().get(Cell::new(cell.x.wrapping_add_signed(*dx), cell.y.wrapping_add_signed(*dy))));
                prop_assert!(!alone || found.contains(&cell) == touched(&cell), "{cell:?}");
            }
        }

        #[test]
        fn a_motion_is_free_where_its_densest_samples_are(occupied in cells(), a in point(), path in (-0.3..0.3, -0.3..0.3), yaw in -3.0..3.0, turn in -2.0..2.0) {
            let space = space(&occupied);
            let (from, to) = (Pose2 { x: a.x, y: a.y, yaw }, Pose2 { x: a.x + path.0, y: a.y + path.1, yaw: yaw + turn });
            let samples = 300;
            let least = (0..=samples).map(|i| {
                let share = f64::from(i) / f64::from(samples);
                space.footprint_clearance(Pose2 { x: a.x + path.0 * share, y: a.y + path.1 * share, yaw: yaw + turn * share })
            }).fold(f64::INFINITY, f64::min);
            let free = space.motion_is_free(from, to);
            prop_assert!(!free || least > 0.0);
            prop_assert!(free || least < 0.006, "{least} m to spare");
        }

        #[test]
        fn a_turn_goes_the_shorter_path_round(occupied in cells(), a in point(), yaw in -3.2..3.2, turn in -3.0..3.0) {
            let space = space(&occupied);
            let pose = |yaw: f64| Pose2 { x: a.x, y: a.y, yaw };
            let to = wrap_angle(yaw + turn);
            prop_assert_eq!(space.turn_is_free(a, yaw, to), space.motion_is_free(pose(yaw), pose(yaw + turn)));
        }

        #[test]
        fn an_outline_is_clear_where_its_footprint_is(occupied in cells(), a in point(), yaw in -3.0..3.0) {
            let space = space(&occupied);
            let Footprint::Polygon(corners) = space.footprint() else { unreachable!() };
            let pose = Pose2::new(a.x, a.y, yaw);
            let outline: Vec<_> = corners.iter().map(|corner| SPEC.to_cells(pose.transform_point(*corner))).collect();
            let clearance = space.footprint_clearance(pose);
            if clearance > 1e-8 || clearance == 0.0 {
                prop_assert_eq!(space.is_clear_of(&outline), clearance > 0.0);
            }
        }

        #[test]
        fn no_numbers_from_outside_do_harm(x in any::<f64>(), y in any::<f64>(), yaw in any::<f64>(), limit in any::<f64>()) {
            let space = space(&[(3, 4)]);
            let (a, pose) = (Point2::new(x, y), Pose2 { x, y, yaw });
            let _ = (space.leg_clearance(a, Point2::new(y, x), 0.3), space.leg_clearance(a, a, limit), space.is_permitted_between(a, Point2::origin()));
            let _ = (space.motion_is_free(pose, Pose2 { x: y, y: x, yaw }), space.turn_is_free(a, yaw, x), space.footprint_clearance_within(pose, 0.5));
        }
    }

    #[test]
    fn a_hull_holds_all_its_points_and_is_convex() {
        let points: Vec<_> = (0..40)
            .map(|i| f64::from(i) * 2.4)
            .map(|t| Point2::new(t.sin() * t, t.cos() * (t % 7.0)))
            .collect();
        let hull = convex_hull(&points);
        for (a, b) in hull.iter().zip(hull.iter().cycle().skip(1)) {
            let along = b - a;
            assert!(
                points
                    .iter()
                    .all(|p| along.x * (p.y - a.y) - along.y * (p.x - a.x) >= -1e-9)
            );
        }
        assert_eq!(super::convex_hull(&[Point2::origin(); 3]), [Point2::origin()]);
    }
}
