//! Recheck. Does the footprint fit along the rest of a trajectory, according to the newest map?

use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::robot::Footprint;
use zenav_protocol::trajectory::Trajectory;
use zenav_space::ConfigurationSpace;

/// Spacing of the rechecked poses, m and rad: between two poses the check is exact at constant velocity.
const SPACING: (f64, f64) = (0.05, 0.1);
/// Distance travelled by a point of the outline before the recheck begins, m: obstacles nearer than that are left to the collision monitor.
const NEAR: f64 = 0.1;
/// Poses rechecked at once; the first block that collides gives the time.
const BLOCK: usize = 16;
/// The obstacle is touched at most this far behind the place that a recheck calls blocked, m: a block of poses up to twice their spacing apart.
pub(crate) const BLOCKED_WITHIN: f64 = 2.0 * SPACING.0 * BLOCK as f64;
/// A robot that leaves an obstacle comes this much nearer to its surroundings at most, m: it does not leave it through the obstacle.
const NEARER: f64 = 0.05;
/// Clearances above this are equivalent for a recheck, m.
const CONTACT: f64 = 2e-3;

/// Result of a recheck.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Recheck {
    /// Free according to the map.
    Free,
    /// An obstacle is on the path, this many seconds of plan time ahead.
    Blocked(f64),
}

/// Rechecks a trajectory from plan time `from` on, with the true footprint. A robot that stands in an obstacle according to the map may
/// leave it within `escape` m.
#[must_use]
pub(crate) fn recheck(trajectory: &Trajectory, space: &ConfigurationSpace, from: f64, escape: f64) -> Recheck {
    // A disc turns in place.
    let arm = match space.footprint() {
        Footprint::Radius(_) => 0.0,
        Footprint::Polygon(_) => space.footprint().circumscribed_radius(),
    };
    let mut poses: Vec<(f64, Pose2)> = Vec::new();
    let mut way = 0.0;
    let mut before: Option<Pose2> = None;
    let mut leaving = true;
    let mut begun: Option<f64> = None;
    for point in trajectory.spaced(from, SPACING.0, SPACING.1) {
        let pose = point.pose();
        if let Some(before) = before {
            way += before.distance(&pose) + arm * wrap_angle(pose.yaw - before.yaw).abs();
        }
        before = Some(pose);
        // A robot that stands in an obstacle according to the map must be able to leave it.
        leaving = leaving && way < escape && space.footprint_clearance(pose) <= 0.0 && {
            let clearance = space.clearance(pose.position());
            clearance >= *begun.get_or_insert(clearance) - NEARER
        };
        if leaving {
            continue;
        }
        let last = point.t >= trajectory.end_time();
        let spaced = poses.last().is_none_or(|(_, kept)| {
            kept.distance(&pose) >= SPACING.0 || wrap_angle(pose.yaw - kept.yaw).abs() >= SPACING.1
        });
        if way >= NEAR && (spaced || last) {
            poses.push((point.t, pose));
        }
    }
    // Blocks share their ends, so that nothing between them is missed.
    let mut first = 0;
    while first < poses.len() {
        let end = (first + BLOCK).min(poses.len());
        let Some(block) = poses.get(first..end) else { break };
        let sweep: Vec<Pose2> = block.iter().map(|(_, pose)| *pose).collect();
        if space.sweep_clearance_within(&sweep, CONTACT) <= 0.0 {
            return Recheck::Blocked((block.first().map_or(from, |(t, _)| *t) - from).max(0.0));
        }
        if end == poses.len() {
            break;
        }
        first = end - 1;
    }
    Recheck::Free
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
    use zenav_protocol::trajectory::TrajectoryPoint;
    use zenav_space::UnknownPolicy;

    use super::*;

    fn space(occupied: &[(f64, f64)]) -> ConfigurationSpace {
        space_of(occupied, &Footprint::Radius(0.25))
    }

    fn space_of(occupied: &[(f64, f64)], footprint: &Footprint) -> ConfigurationSpace {
        let spec = GridSpec {
            origin: Point2::new(-1.0, -1.0),
            resolution: 0.05,
            width: 200,
            height: 60,
        };
        let mut grid = OccupancyGrid::filled(spec, Occupancy::FREE);
        for (x, y) in occupied {
            grid[spec.cell_at(Point2::new(*x, *y)).unwrap()] = Occupancy::OCCUPIED;
        }
        ConfigurationSpace::new(&grid, footprint, UnknownPolicy::Free, 0.0)
    }

    #[test]
    fn a_turn_on_the_spot_is_rechecked_by_the_way_of_the_outline() {
        let outline = zenav_fixtures::footprint(&[(-0.3, -0.1), (0.3, -0.1), (0.3, 0.1), (-0.3, 0.1)]);
        let space = space_of(&[(0.0, 0.2)], &outline);
        let turn: Trajectory = (0..=30)
            .map(|i| TrajectoryPoint {
                t: 0.1 * f64::from(i),
                yaw: 0.05 * f64::from(i),
                w: 0.5,
                ..TrajectoryPoint::default()
            })
            .collect();
        assert!(matches!(recheck(&turn, &space, 0.0, 0.6), Recheck::Blocked(ahead) if ahead > 0.5));
    }

    /// Straight ahead at 0.5 m/s for 8 m.
    fn straight() -> Trajectory {
        (0..=320)
            .map(|i| f64::from(i) * 0.05)
            .map(|t| TrajectoryPoint {
                t,
                x: 0.5 * t,
                v: 0.5,
                ..TrajectoryPoint::default()
            })
            .collect()
    }

    #[test]
    fn what_lies_ahead_is_found_and_what_lies_behind_is_not() {
        let (path, space) = (straight(), space(&[(4.0, 0.2)]));
        let Recheck::Blocked(ahead) = recheck(&path, &space, 0.0, 0.6) else {
            panic!("missed")
        };
        assert!((5.5..7.6).contains(&ahead), "{ahead}");
        assert_eq!(recheck(&path, &space, 9.0, 0.6), Recheck::Free);
        assert_eq!(recheck(&path, &self::space(&[(4.0, 0.3)]), 0.0, 0.6), Recheck::Free);
    }

    #[test]
    fn a_robot_that_stands_in_something_is_let_out_of_it() {
        assert_eq!(recheck(&straight(), &space(&[(-0.1, 0.1)]), 0.0, 0.6), Recheck::Free);
        assert!(matches!(
            recheck(&straight(), &space(&[(-0.1, 0.1), (1.0, 0.0)]), 0.0, 0.6),
            Recheck::Blocked(_)
        ));
        assert!(matches!(
            recheck(&straight(), &space(&[(0.5, 0.0)]), 0.0, 0.6),
            Recheck::Blocked(_)
        ));
    }

    #[test]
    fn a_robot_that_stands_in_a_thin_wall_is_not_let_through_it() {
        let wall: Vec<(f64, f64)> = (-18..18).map(|y| (0.21, 0.05 * f64::from(y) + 0.01)).collect();
        assert!(matches!(
            recheck(&straight(), &space(&wall), 0.0, 0.6),
            Recheck::Blocked(_)
        ));
        let back: Trajectory = straight()
            .iter()
            .take_while(|point| point.x < 0.7)
            .map(|point| TrajectoryPoint {
                x: -point.x,
                v: -point.v,
                ..*point
            })
            .collect();
        assert_eq!(recheck(&back, &space(&wall), 0.0, 0.6), Recheck::Free);
    }
}
