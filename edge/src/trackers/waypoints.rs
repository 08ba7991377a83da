//! Waypoint follower. How does a law drive through waypoints? This file tracks which waypoint is next and whether the last was reached; the
//! law only determines how to drive at the next one.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::robot::{ControllerGains, Drive};
use zenav_protocol::trajectory::Trajectory;

use super::{AT_REST, PathProjection, Progress, Tracker, TrackerInput};

/// A law that drives at a waypoint.
pub trait WaypointLaw: Clone + std::fmt::Debug + Send + Sync + 'static {
    /// A waypoint nearer than this is passed, m.
    fn threshold(&self, gains: &ControllerGains) -> f64;

    /// One tick towards `target`, the first of the remaining waypoints.
    fn twist(
        &self,
        drive: &Drive,
        target: Point2<f64>,
        left: &[Point2<f64>],
        view: &TrackerInput,
        gains: &ControllerGains,
    ) -> Twist2;
}

/// Follows waypoints by a law.
#[derive(Clone, Debug)]
pub struct ThroughWaypoints<L> {
    law: L,
    drive: Drive,
    waypoints: Vec<Point2<f64>>,
    next: usize,
    finished: bool,
    projection: Option<PathProjection>,
}

impl<L: WaypointLaw> ThroughWaypoints<L> {
    /// From the first waypoint on; `projection` where the plan has a trajectory.
    #[must_use]
    pub fn new(law: L, drive: &Drive, waypoints: Vec<Point2<f64>>, projection: Option<PathProjection>) -> Self {
        Self {
            law,
            drive: drive.clone(),
            waypoints,
            next: 0,
            finished: false,
            projection,
        }
    }
}

impl<L: WaypointLaw> Tracker for ThroughWaypoints<L> {
    fn step(&mut self, view: &TrackerInput, gains: &ControllerGains) -> Twist2 {
        if let Some(projection) = &mut self.projection {
            projection.advance(&view.map_from_base);
        }
        let here = view.map_from_base.position();
        let threshold = self.law.threshold(gains);
        while let [target, rest @ ..] = &self.waypoints[self.next..] {
            let reached = if rest.is_empty() {
                threshold.min(gains.last_waypoint)
            } else {
                threshold
            };
            if (target - here).norm() >= reached {
                return self
                    .law
                    .twist(&self.drive, *target, &self.waypoints[self.next..], view, gains);
            }
            self.next += 1;
        }
        self.finished |= self.drive.surface_speed(view.velocity) < AT_REST;
        Twist2::ZERO
    }

    fn progress(&self, map_from_base: &Pose2) -> Progress {
        let ahead = self.waypoints.iter().skip(self.next);
        let (distance_left, _) = ahead.fold((0.0, map_from_base.position()), |(sum, from), to| {
            (sum + (to - from).norm(), *to)
        });
        Progress {
            time: self.projection.as_ref().map_or(0.0, PathProjection::time),
            waypoint: self.next,
            distance_left,
            time_left: distance_left / self.drive.top_speed(),
            finished: self.finished,
        }
    }

    fn target(&self) -> Option<(&'static str, Point2<f64>)> {
        self.waypoints.get(self.next).map(|place| ("waypoint", *place))
    }

    fn followed(&self) -> Option<(&Trajectory, f64)> {
        self.projection.as_ref().map(PathProjection::followed)
    }

    fn rejoin(&mut self, map_from_base: &Pose2) {
        if let Some(projection) = &mut self.projection {
            projection.advance(map_from_base);
        }
    }

    fn off_track(&self) -> f64 {
        self.projection.as_ref().map_or(0.0, PathProjection::off_track)
    }

    fn moved(&mut self, new_from_old: Pose2) {
        for waypoint in &mut self.waypoints {
            *waypoint = new_from_old.transform_point(*waypoint);
        }
        if let Some(projection) = &mut self.projection {
            projection.moved(new_from_old);
        }
    }

    fn boxed(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::super::{OriginalWheelLaw, WheelLaw};
    use super::*;

    #[test]
    fn the_wheels_get_what_the_law_says() {
        let model = zenav_fixtures::robot("tiago");
        let mut tracker = ThroughWaypoints::new(WheelLaw, &model.drive, vec![Point2::new(1.0, 0.0)], None);
        let view = TrackerInput {
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
        let aside = TrackerInput {
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
        reaches_the_last_waypoint(WheelLaw);
        reaches_the_last_waypoint(OriginalWheelLaw);
    }

    fn reaches_the_last_waypoint(law: impl WaypointLaw) {
        let model = zenav_fixtures::robot("tiago");
        let mut tracker = ThroughWaypoints::new(
            law,
            &model.drive,
            vec![Point2::new(1.0, 0.0), Point2::new(1.5, 1.0), Point2::new(0.0, 1.0)],
            None,
        );
        let mut pose = Pose2::IDENTITY;
        let mut limiter = crate::limiter::Limiter::new(&model.drive);
        for _ in 0..3000 {
            let view = TrackerInput {
                dt: 0.02,
                map_from_base: pose,
                velocity: limiter.twist(),
                speed_cap: f64::INFINITY,
            };
            let wanted = tracker.step(&view, &model.controller);
            let wheels = limiter.limit(wanted, 0.02, crate::limiter::Braking::Normal);
            limiter.set(wheels, 0.02);
            pose = pose.advance(limiter.twist(), 0.02);
        }
        assert!(tracker.progress(&pose).finished);
        assert!(pose.distance(&Pose2::new(0.0, 1.0, 0.0)) < 0.05, "{pose:?}");
    }
}
