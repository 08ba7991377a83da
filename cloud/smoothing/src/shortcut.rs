//! Shortcut. Straight cuts across a path, each as far from obstacles as the part that it replaces.
//!
//! A search on a grid knows eight directions; a robot knows all. A cut is made if the robot's true shape fits along it, and if it leads
//! no closer to obstacles than the path itself, up to a clearance: the clearance that the search paid for is kept. A robot that is longer
//! than wide must be able to turn at both ends of a cut.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::Point2;
use zenav_protocol::robot::Footprint;

use zenav_space::ConfigurationSpace;

/// Largest distance between the points at which a path may be cut, m.
const SPACING: f64 = 0.75;
/// Number of passes over the path.
const PASSES: usize = 2;
/// Margin on top of the robot's own shape, m: later rounding stays free.
pub const HAIR: f64 = 5e-4;

/// Whether a disc of `radius` (m) moves freely from `a` to `b`, and its centre stays where the policy for unknown cells permits.
#[must_use]
pub fn is_clear(space: &ConfigurationSpace, a: Point2<f64>, b: Point2<f64>, radius: f64) -> bool {
    space.disc_passes(a, b, radius) && space.is_permitted_between(a, b)
}

/// Whether the policy for unknown cells lets the robot's centre go from `a` to `b`.
pub(super) fn is_permitted_along(space: &ConfigurationSpace, a: Point2<f64>, b: Point2<f64>) -> bool {
    space.is_permitted_between(a, b)
}

/// Whether the robot drives straight from `a` to `b` with `kept` metres to spare on all sides.
#[must_use]
pub fn has_leg(space: &ConfigurationSpace, a: Point2<f64>, b: Point2<f64>, kept: f64) -> bool {
    let footprint = space.footprint();
    let fits = space.disc_passes(a, b, footprint.circumscribed_radius() + kept)
        || matches!(footprint, Footprint::Polygon(_)) && space.leg_clearance(a, b, kept) >= kept;
    fits && space.is_permitted_between(a, b)
}

/// The path with fewer corners; its ends stay. Once `cancel` is set, it is returned as it is. `clearance` (m) is what cuts keep beyond
/// the robot's shape, as far as the path does; `heading` (rad) is the robot's heading at the start, if it matters.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_smoothing::shortcut;
/// # use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
/// # use zenav_protocol::robot::Footprint;
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 100 };
/// # let map = Grid::filled(spec, Occupancy::FREE);
/// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
/// // Stairs across an empty room.
/// let path = [(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (3.0, 2.0), (3.0, 3.0)].map(|(x, y)| Point2::new(x, y));
/// assert_eq!(shortcut(&space, &path, 0.3, None, None), [path[0], path[4]]);
/// ```
#[must_use]
pub fn shortcut(
    space: &ConfigurationSpace,
    path: &[Point2<f64>],
    clearance: f64,
    heading: Option<f64>,
    cancel: Option<&AtomicBool>,
) -> Vec<Point2<f64>> {
    let is_over = || cancel.is_some_and(|cancel| cancel.load(Ordering::Relaxed));
    let mut path = path.to_vec();
    for _ in 0..PASSES {
        if is_over() {
            break;
        }
        let cut = pass(space, &path, clearance, heading, &is_over);
        path = cut.unwrap_or(path);
    }
    path
}

/// The path after one pass of cuts; `None` once cancelled.
fn pass(
    space: &ConfigurationSpace,
    path: &[Point2<f64>],
    clearance: f64,
    heading: Option<f64>,
    is_over: &dyn Fn() -> bool,
) -> Option<Vec<Point2<f64>>> {
    let wanted = HAIR + clearance.max(0.0);
    let (points, clearances) = spaced(space, path, wanted);
    let is_long = matches!(space.footprint(), Footprint::Polygon(_));
    let mut heading = heading.filter(|_| is_long);
    let direction = |from: usize, to: usize| {
        let along = points[to] - points[from];
        along.y.atan2(along.x)
    };
    let mut cut = Vec::new();
    let mut at = 0;
    while let Some(from) = points.get(at) {
        if is_over() {
            return None;
        }
        cut.push(*from);
        let last = points.len() - 1;
        // A robot that is longer than wide turns at both ends: from its last heading, and into the path's next direction.
        let turns = |to: usize| {
            let along = direction(at, to);
            let goes_on = to == last || space.turn_is_free(points[to], along, direction(to, to + 1));
            goes_on && heading.is_none_or(|heading| space.turn_is_free(*from, heading, along))
        };
        // The step doubles while the target is in sight, then it is halved; the farthest point found in sight ends the cut.
        let sees = |to: usize| {
            let kept = clearances[at..to].iter().copied().fold(wanted, f64::min) - 1e-9;
            has_leg(space, *from, points[to], kept.max(1e-9)) && (!is_long || turns(to))
        };
        let (mut seen, mut step) = (at + 1, 1);
        let mut hidden = points.len();
        while seen < last && hidden > seen + 1 {
            let next = (seen + step).min(last).min(hidden - 1);
            if sees(next) {
                (seen, step) = (next, 2 * step);
            } else {
                (hidden, step) = (next, ((next - seen) / 2).max(1));
            }
        }
        if is_long && seen <= last {
            heading = Some(direction(at, seen));
        }
        at = seen;
    }
    Some(cut)
}

/// The path's corners and points between them, and the clearance of each leg beyond the robot's shape (m, at most `wanted`).
fn spaced(space: &ConfigurationSpace, path: &[Point2<f64>], wanted: f64) -> (Vec<Point2<f64>>, Vec<f64>) {
    let mut points: Vec<Point2<f64>> = path.first().copied().into_iter().collect();
    let mut clearances = Vec::new();
    for pair in path.windows(2) {
        let leg = pair[1] - pair[0];
        let pieces = (leg.norm() / SPACING).ceil().clamp(1.0, 1e5) as usize;
        let mut from = pair[0];
        for i in 1..=pieces {
            let to = if i == pieces {
                pair[1]
            } else {
                pair[0] + leg * (i as f64 / pieces as f64)
            };
            clearances.push(if has_leg(space, from, to, wanted) {
                wanted
            } else {
                space.leg_clearance(from, to, wanted)
            });
            points.push(to);
            from = to;
        }
    }
    (points, clearances)
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_space::UnknownPolicy;

    fn space(occupied: &[(u32, u32)]) -> ConfigurationSpace {
        let grid = zenav_fixtures::map_with_occupied(zenav_fixtures::spec(60, 60, 0.1), occupied);
        ConfigurationSpace::new(&grid, &Footprint::Radius(0.3), UnknownPolicy::Blocked, 0.0)
    }

    #[test]
    fn stairs_in_the_open_become_a_line() {
        let stairs: Vec<_> = (0..20)
            .flat_map(|i| [(i, i), (i + 1, i)])
            .map(|(x, y)| Point2::new(1.0 + 0.1 * f64::from(x), 1.0 + 0.1 * f64::from(y)))
            .collect();
        assert_eq!(shortcut(&space(&[]), &stairs, 0.3, None, None), [stairs[0], stairs[39]]);
    }

    #[test]
    fn a_cut_is_as_clear_as_what_it_replaces() {
        let space = space(&[(30, 30)]);
        let wide = [Point2::new(1.0, 3.0), Point2::new(3.0, 4.5), Point2::new(5.0, 3.0)];
        let least = |path: &[Point2<f64>]| {
            path.windows(2)
                .map(|pair| space.segment_clearance(pair[0], pair[1]))
                .fold(f64::INFINITY, f64::min)
        };
        let comfortable = shortcut(&space, &wide, 0.4, None, None);
        assert!(least(&comfortable) >= 0.7 && comfortable.len() >= 3);
        let short = shortcut(&space, &wide, 0.0, None, None);
        assert!(least(&short) > 0.3 && least(&short) < 0.7);
    }

    #[test]
    fn nothing_much_stays_nothing_much() {
        assert!(shortcut(&space(&[]), &[], 0.3, None, None).is_empty());
        assert_eq!(
            shortcut(&space(&[]), &[Point2::origin()], 0.3, None, None),
            [Point2::origin()]
        );
    }
}
