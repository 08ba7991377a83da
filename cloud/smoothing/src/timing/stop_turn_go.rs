//! Stop, turn, go. The safe trajectory: stop, turn towards the next corner, go straight, stop; the unsmoothed path with a time law of its
//! own.
//!
//! It needs no map and no solver, and never leaves the path's straight lines: what was free for the search stays free. A moving robot
//! brakes first, along its present arc, and then returns to the nearest point of the path.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::polygon::Edge;

use super::limits::Limits;
use super::path::{GeometricPath, SpeedLimit};
use super::trajectory::PiecewiseTrajectory;

/// Points of a path closer together than this are the same, m.
const SAME_PLACE: f64 = 1e-3;
/// Distance between samples on a straight line, m.
const STEP: f64 = 0.02;
/// A leg whose direction differs from the heading by less than this is started at speed, rad.
const ALIGNED: f64 = 0.02;

/// The unsmoothed path (corner points, map frame, the start included or not) as stop, turn and go, at rest at its end, within the speed
/// limits of the map's zones.
///
/// Non-finite points are left out. Empty only if there is nothing to drive or to turn, or if the start is not finite.
///
/// ```
/// use std::f64::consts::FRAC_PI_2;
/// use nalgebra::Point2;
/// use zenav_protocol::geometry::{Pose2, Twist2};
/// use zenav_smoothing::{Limits, UNRESTRICTED, stop_turn_go};
///
/// # let limits = Limits { wheel_speed: 0.6, wheel_acceleration: 0.75, half_separation: 0.2, speed: 0.5, lateral_acceleration: 0.5,
/// #     yaw_rate: 2.5, jerk: None };
/// // At most 0.5 m/s, 0.75 m/s² and 1.5 rad/s.
/// let path = [Point2::new(2.0, 0.0), Point2::new(2.0, 1.0)];
/// let trajectory = stop_turn_go(&path, Pose2::IDENTITY, Twist2::ZERO, None, &limits, UNRESTRICTED);
/// let (drives, turn) = (2.0 / 0.5 + 1.0 / 0.5 + 2.0 * 0.5 / 0.75, FRAC_PI_2 / 1.5 + 1.5 * 0.2 / 0.75);
/// assert!((trajectory.duration() - drives - turn).abs() < 0.05);
/// assert!((trajectory.at(trajectory.duration()).point.yaw - FRAC_PI_2).abs() < 1e-9);
/// ```
#[must_use]
pub fn stop_turn_go(
    path: &[Point2<f64>],
    start: Pose2,
    velocity: Twist2,
    goal_yaw: Option<f64>,
    limits: &Limits,
    speed_limit: SpeedLimit<'_>,
) -> PiecewiseTrajectory {
    let mut trajectory = PiecewiseTrajectory::new();
    if !start.is_finite() {
        return trajectory;
    }
    let velocity = if velocity.is_finite() { velocity } else { Twist2::ZERO };
    let mut corners = corners_from(start.position(), path);
    let mut speed = 0.0;
    let mut at = start;
    if limits.braking_time(velocity) > 1e-6 {
        if begins_at_speed(start, velocity, &corners, limits) {
            speed = velocity.v;
        } else {
            at = trajectory.brake(start, velocity, limits);
            corners = rejoined(at.position(), &corners);
        }
    }
    for to in corners.into_iter().skip(1) {
        let Some(leg) = GeometricPath::straight(at.position(), to, STEP) else {
            continue;
        };
        let yaw = leg.points()[0].yaw;
        if speed == 0.0 {
            trajectory.spin(at, wrap_angle(yaw - at.yaw), limits);
        }
        let followed = trajectory.follow(leg.limited(speed_limit), speed, limits);
        debug_assert!(followed.is_ok(), "a straight line from rest can always be followed");
        speed = 0.0;
        at = Pose2::new(to.x, to.y, yaw);
    }
    if let Some(yaw) = goal_yaw.filter(|yaw| yaw.is_finite()) {
        trajectory.spin(at, wrap_angle(yaw - at.yaw), limits);
    }
    trajectory
}

/// The start, and the path's points without repetitions and non-finite ones.
pub(crate) fn corners_from(start: Point2<f64>, path: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let mut corners = vec![start];
    for &point in path {
        let last = corners[corners.len() - 1];
        if point.x.is_finite() && point.y.is_finite() && (point - last).norm() > SAME_PLACE {
            corners.push(point);
        }
    }
    corners
}

/// Whether the first leg can be started without a stop: it lies ahead, the robot does not turn, and it can stop at the leg's end.
fn begins_at_speed(start: Pose2, velocity: Twist2, corners: &[Point2<f64>], limits: &Limits) -> bool {
    let [from, to, ..] = corners else { return false };
    let leg = to - from;
    let ahead = wrap_angle(leg.y.atan2(leg.x) - start.yaw).abs() < ALIGNED;
    let stops = velocity.v * velocity.v < 2.0 * 0.9 * limits.wheel_acceleration * leg.norm();
    ahead && velocity.v > 0.0 && velocity.v <= limits.speed && velocity.w.abs() < 2.0 * ALIGNED && stops
}

/// The path from a place beside it: to its nearest point, and on from there.
pub(crate) fn rejoined(at: Point2<f64>, corners: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let mut nearest = (f64::INFINITY, 0, corners[0]);
    for (i, pair) in corners.windows(2).enumerate() {
        let leg = Edge { a: pair[0], b: pair[1] };
        let point = leg.nearest(at);
        let distance = (at - point).norm();
        if distance < nearest.0 {
            nearest = (distance, i + 1, point);
        }
    }
    let (_, next, point) = nearest;
    let rest: Vec<_> = std::iter::once(point)
        .chain(corners.iter().copied().skip(next.max(1)))
        .collect();
    corners_from(at, &rest)
}

#[cfg(test)]
mod tests {
    use super::super::UNRESTRICTED;
    use super::*;
    use proptest::prelude::*;
    use zenav_protocol::robot::RobotModel;
    use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};

    const PERIOD: f64 = 0.05;

    fn safe_trajectory(
        path: &[Point2<f64>],
        start: Pose2,
        velocity: Twist2,
        goal_yaw: Option<f64>,
        model: &RobotModel,
    ) -> Trajectory {
        stop_turn_go(path, start, velocity, goal_yaw, &Limits::of(model), UNRESTRICTED).sampled(PERIOD)
    }

    fn tiago() -> RobotModel {
        zenav_fixtures::robot("tiago")
    }

    /// Every step obeys the drive's limits and is no longer than the top speed allows.
    fn assert_drivable(points: &[TrajectoryPoint], model: &RobotModel) {
        for pair in points.windows(2) {
            let dt = pair[1].t - pair[0].t;
            assert!(dt > 0.0 && dt <= PERIOD + 1e-9);
            let [before, after] = [0, 1].map(|i| model.drive.wheels(pair[i].twist()));
            for wheel in 0..2 {
                assert!(after[wheel].abs() <= 0.95 * model.drive.max_wheel_speed + 1e-6);
                let acceleration = (after[wheel] - before[wheel]) / dt;
                assert!(
                    acceleration.abs() <= 0.95 * model.drive.max_wheel_acceleration + 1e-6,
                    "{acceleration} at {}",
                    pair[0].t
                );
            }
            let moved = pair[0].pose().distance(&pair[1].pose());
            assert!(
                moved <= 0.95 * model.drive.top_speed() * dt + 1e-6,
                "moved {moved} in {dt}"
            );
        }
    }

    #[test]
    fn a_corner_is_turned_on_the_spot_and_the_end_is_at_rest() {
        let path = [Point2::new(0.0, 0.0), Point2::new(2.0, 0.0), Point2::new(2.0, 1.0)];
        let points = safe_trajectory(&path, Pose2::new(0.0, 0.0, 1.0), Twist2::ZERO, Some(0.5), &tiago());
        assert_drivable(&points, &tiago());
        let last = points.last().unwrap();
        assert!(last.pose().distance(&Pose2::new(2.0, 1.0, 0.0)) < 1e-9 && (last.yaw - 0.5).abs() < 1e-9);
        assert_eq!((last.v, last.w), (0.0, 0.0));
        assert!(points.iter().all(|p| p.y.abs() < 1e-9 || (p.x - 2.0).abs() < 1e-9));
    }

    #[test]
    fn nothing_to_drive_is_an_empty_trajectory() {
        let here = Point2::new(1.0, 1.0);
        let still = Pose2::new(1.0, 1.0, 0.0);
        assert!(safe_trajectory(&[], still, Twist2::ZERO, None, &tiago()).is_empty());
        assert!(safe_trajectory(&[here, here], still, Twist2::ZERO, None, &tiago()).is_empty());
        assert!(
            safe_trajectory(
                &[Point2::new(f64::NAN, 0.0)],
                still,
                Twist2::ZERO,
                Some(f64::NAN),
                &tiago()
            )
            .is_empty()
        );
        assert!(safe_trajectory(&[here], Pose2 { x: f64::NAN, ..still }, Twist2::ZERO, None, &tiago()).is_empty());
    }

    #[test]
    fn a_robot_at_speed_goes_straight_on_without_stopping() {
        let points = safe_trajectory(
            &[Point2::new(2.0, 0.0)],
            Pose2::IDENTITY,
            Twist2::new(0.5, 0.0),
            None,
            &tiago(),
        );
        assert_drivable(&points, &tiago());
        assert!((points[0].v - 0.5).abs() < 1e-9);
        assert!(points.iter().filter(|p| p.x < 1.0).all(|p| p.v >= 0.5 - 1e-9));
    }

    proptest! {
        #[test]
        fn any_way_from_any_state_is_drivable(
            raw in prop::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64), 0..6),
            yaw in -3.0..3.0_f64, v in -0.3..0.55_f64, w in -1.0..1.0_f64, goal_yaw in prop::option::of(-3.0..3.0_f64),
        ) {
            let path: Vec<_> = raw.into_iter().map(|(x, y)| Point2::new(x, y)).collect();
            let wheels = tiago().drive.wheels(Twist2::new(v, w));
            prop_assume!(wheels.iter().all(|speed| speed.abs() < 0.95 * tiago().drive.max_wheel_speed));
            let points = safe_trajectory(&path, Pose2::new(0.1, 0.2, yaw), Twist2::new(v, w), goal_yaw, &tiago());
            assert_drivable(&points, &tiago());
            if let (Some(last), Some(end)) = (points.last(), path.last()) {
                prop_assert!((last.pose().position() - end).norm() < 2.0 * SAME_PLACE);
                prop_assert!(last.v.abs() < 1e-9 && last.w.abs() < 1e-9);
            }
        }
    }
}
