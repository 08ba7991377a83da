//! Which twist drives through a list of waypoints? The proportional wheel law of the classic two-wheel exercise:
//! `left = -p_alpha * alpha + p_rho * rho`, `right = p_alpha * alpha + p_rho * rho`, with the bearing `alpha` and the
//! distance `rho` of the next waypoint, clamped to the wheels' limit.
//!
//! Three changes make it drive well. The clamp takes from the distance term, never from the turn. The distance term
//! fades as `alpha` grows, so that the robot turns first instead of swinging wide. And `rho` reaches beyond a waypoint
//! that is passed straight on, so that the robot slows down for corners and the end only.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::robot::{ControllerGains, Drive};

use super::{Progress, Rail, Timeline, Tracker, View};
use crate::limiter::wheel_surface_speed;

/// Bearing beyond which the robot turns on the spot, rad.
const TURN_FIRST: f64 = 1.0;
/// Where the last waypoint counts as reached, m: it is a place to be at, the others are passed.
const FINAL_THRESHOLD: f64 = 0.1;
/// Least `rho` on the way, m: the law alone would creep towards every waypoint.
const LEAST_RHO: f64 = 0.6;
/// At rest: wheel surface speed, m/s.
const AT_REST: f64 = 0.02;

/// Follows waypoints.
#[derive(Clone, Debug)]
pub struct WaypointTracker {
    drive: Drive,
    waypoints: Vec<Point2<f64>>,
    next: usize,
    finished: bool,
    /// Where a plan with a trajectory has the robot.
    rail: Option<Rail>,
}

impl WaypointTracker {
    /// From the first waypoint on.
    #[must_use]
    pub fn new(drive: &Drive, waypoints: Vec<Point2<f64>>) -> Self {
        Self {
            drive: drive.clone(),
            waypoints,
            next: 0,
            finished: false,
            rail: None,
        }
    }

    /// The same for a plan with a trajectory.
    #[must_use]
    pub fn on(mut self, rail: Rail) -> Self {
        self.rail = Some(rail);
        self
    }

    /// The waypoint being driven to, map frame.
    #[must_use]
    pub fn waypoint(&self) -> Option<Point2<f64>> {
        self.waypoints.get(self.next).copied()
    }

    /// The distance that the law sees: to the next waypoint, and on beyond it as far as the way goes straight on.
    fn effective_distance(&self, here: Point2<f64>) -> f64 {
        let mut rho = 0.0;
        let mut weight = 1.0;
        let mut from = here;
        let mut direction: Option<nalgebra::Vector2<f64>> = None;
        // Farther ahead than this the speed limit rules anyway.
        for target in self.waypoints.iter().skip(self.next).take(8) {
            let leg = target - from;
            if let Some(before) = direction {
                let cos = before.dot(&leg) / (before.norm() * leg.norm()).max(1e-9);
                weight *= 0.5 * (1.0 + cos.clamp(-1.0, 1.0));
            }
            rho += weight * leg.norm();
            (direction, from) = (Some(leg), *target);
        }
        rho
    }
}

impl Tracker for WaypointTracker {
    fn step(&mut self, view: &View, gains: &ControllerGains) -> Twist2 {
        if let Some(rail) = &mut self.rail {
            rail.advance(&view.map_from_base);
        }
        let here = view.map_from_base.position();
        while let Some(target) = self.waypoint() {
            let last = self.next + 1 == self.waypoints.len();
            let threshold = if last {
                gains.waypoint_threshold.min(FINAL_THRESHOLD)
            } else {
                gains.waypoint_threshold
            };
            if (target - here).norm() >= threshold {
                break;
            }
            self.next += 1;
        }
        let Some(target) = self.waypoint() else {
            self.finished |= wheel_surface_speed(&self.drive, view.velocity) < AT_REST;
            return Twist2::ZERO;
        };
        let limit = self.drive.max_wheel_speed.min(view.speed_cap / self.drive.wheel_radius);
        let alpha = bearing(&view.map_from_base, target);
        let rho = self.effective_distance(here).max(LEAST_RHO);
        let turn = (gains.heading_gain * alpha).clamp(-limit, limit);
        let fade = (1.0 - alpha.abs() / TURN_FIRST).max(0.0);
        let forward = (gains.distance_gain * rho * fade)
            .min(limit * fade)
            .min(limit - turn.abs());
        self.drive.twist([forward - turn, forward + turn])
    }

    fn progress(&self, map_from_base: &Pose2) -> Progress {
        let ahead = self.waypoints.iter().skip(self.next);
        let (distance_left, _) = ahead.fold((0.0, map_from_base.position()), |(sum, from), to| {
            (sum + (to - from).norm(), *to)
        });
        Progress {
            time: self.rail.as_ref().map_or(0.0, Rail::time),
            waypoint: self.next,
            distance_left,
            time_left: distance_left / self.drive.top_speed(),
            finished: self.finished,
        }
    }

    fn target(&self) -> Option<(&'static str, Point2<f64>)> {
        self.waypoint().map(|place| ("waypoint", place))
    }

    fn motion(&self) -> Option<(&Timeline, f64)> {
        self.rail.as_ref().map(Rail::motion)
    }

    fn off_track(&self) -> f64 {
        self.rail.as_ref().map_or(0.0, Rail::off_track)
    }

    fn boxed(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }
}

/// Direction of a point relative to the robot's heading, rad.
pub(super) fn bearing(map_from_base: &Pose2, target: Point2<f64>) -> f64 {
    let to = target - map_from_base.position();
    wrap_angle(to.y.atan2(to.x) - map_from_base.yaw)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::robot::{RobotModel, shipped};

    #[test]
    fn the_wheels_get_what_the_law_says() {
        let model = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
        let mut tracker = WaypointTracker::new(&model.drive, vec![Point2::new(1.0, 0.0)]);
        let view = View {
            dt: 0.02,
            map_from_base: Pose2::IDENTITY,
            velocity: Twist2::ZERO,
            speed_cap: f64::INFINITY,
        };
        let wheels = model.drive.wheels(tracker.step(&view, &model.controller));
        assert!(
            (wheels[0] - 2.0).abs() < 1e-9 && (wheels[1] - 2.0).abs() < 1e-9,
            "2 rad/s for a metre ahead: {wheels:?}"
        );
        let aside = View {
            map_from_base: Pose2::new(0.0, 0.0, -1.2),
            ..view
        };
        let wheels = model.drive.wheels(tracker.step(&aside, &model.controller));
        assert!(
            (wheels[1] - 4.8).abs() < 1e-9 && (wheels[0] + 4.8).abs() < 1e-9,
            "turns first: {wheels:?}"
        );
    }

    #[test]
    fn waypoints_are_passed_within_the_threshold_and_the_last_one_is_reached() {
        let model = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
        let mut tracker = WaypointTracker::new(
            &model.drive,
            vec![Point2::new(1.0, 0.0), Point2::new(1.5, 1.0), Point2::new(0.0, 1.0)],
        );
        let mut pose = Pose2::IDENTITY;
        let mut limiter = crate::limiter::Limiter::new(&model.drive);
        for _ in 0..3000 {
            let view = View {
                dt: 0.02,
                map_from_base: pose,
                velocity: limiter.twist(),
                speed_cap: f64::INFINITY,
            };
            let wanted = tracker.step(&view, &model.controller);
            let wheels = limiter.limit(wanted, 0.02, crate::limiter::Braking::Normal);
            limiter.set(wheels);
            pose = pose.advance(limiter.twist(), 0.02);
        }
        assert!(tracker.progress(&pose).finished);
        assert!(pose.distance(&Pose2::new(0.0, 1.0, 0.0)) < 0.15, "{pose:?}");
    }
}
