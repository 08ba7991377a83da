//! Tracking. Where on its path is the robot, and how closely does it follow?

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::wrap_angle;
use zenav_protocol::messages::GoalPoint;
use zenav_protocol::time::Stamp;

use super::path;
use crate::context::Context;
use crate::route::RouteData;
use zenav_behaviour_tree::{LeafIo, Value};

/// How far ahead on the path the robot is searched, m.
const AHEAD: f64 = 2.0;
/// Distance before a goal on the way at which it counts as passed, m.
const AT_VIA: f64 = 0.1;
/// Period of the tracking feedback, s.
const PERIOD: f64 = 0.1;

/// Nav2's TrackingFeedback, as IsWithinPathTrackingBounds reads it.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct TrackingFeedback {
    /// Distance from the path, m; positive to the left of it.
    pub position_tracking_error: f64,
    /// Heading relative to the one in which the path is driven, rad.
    pub heading_tracking_error: f64,
    /// Straight distance to the goal, m.
    #[serde(default)]
    pub distance_to_goal: f64,
    /// Path left, m.
    #[serde(default)]
    pub remaining_path_length: f64,
    /// Forward speed, m/s.
    #[serde(default)]
    pub speed: f64,
}

/// The followed path, and how much of it is behind the robot.
#[derive(Debug, Default)]
pub struct Tracking {
    path: Option<RouteData>,
    behind: f64,
    told: Stamp,
}

impl Tracking {
    /// Follows a path from where the robot is on it. Returns whether it differs from the previous one.
    pub fn follow(&mut self, data: RouteData) -> bool {
        // The same path with more of it behind the robot is no other one.
        let (driven, data) = (data.driven, RouteData { driven: 0.0, ..data });
        let other = self.path.as_ref() != Some(&data);
        if other {
            (self.path, self.behind) = (Some(data), driven);
        }
        other
    }

    /// Follows a path from the robot's present position on it.
    pub fn take_up(&mut self, data: RouteData, ctx: &Context) {
        let pose = ctx.robot.pose();
        let near = pose.and_then(|pose| path::nearest(&data.points, pose.position(), 0.0, f64::INFINITY));
        self.behind = near.map_or(0.0, |near| near.along);
        self.path = Some(RouteData { driven: 0.0, ..data });
    }

    /// Carries the path over to the present frame of the map.
    pub fn settle(&mut self, from: u64, ctx: &Context) {
        self.path = self.path.take().and_then(|data| {
            let data = RouteData {
                frame: Some(from),
                ..data
            };
            data.settled(&ctx.frames)
        });
    }

    /// Updates the robot's position, and writes it to the port if connected.
    pub fn observe(&mut self, io: &mut LeafIo<'_>, ctx: &Context) {
        let (Some(pose), Some(data)) = (ctx.robot.pose(), &self.path) else {
            return;
        };
        let whole = path::length(&data.points);
        let (from, to) = (self.behind, self.behind + AHEAD);
        let Some(near) = path::nearest(&data.points, pose.position(), from, to.min(whole)) else {
            return;
        };
        self.behind = near.along;
        if !io.is_writable("tracking_feedback") || ctx.now.secs_since(self.told) < PERIOD {
            return;
        }
        self.told = ctx.now;
        let reversed = if data.backwards.contains(&near.leg) { PI } else { 0.0 };
        let feedback = TrackingFeedback {
            position_tracking_error: near.left,
            heading_tracking_error: wrap_angle(pose.yaw - near.heading - reversed),
            distance_to_goal: pose.distance(&data.goal.pose()),
            remaining_path_length: whole - near.along,
            speed: ctx.robot.velocity().v,
        };
        // A tree with another type of entry on this port gets no feedback.
        if let Ok(value) = Value::data(&feedback) {
            let _ = io.set_fleeting("tracking_feedback", value);
        }
    }

    /// Goals on the path that the robot has not passed yet.
    #[must_use]
    pub fn goals_ahead(&self) -> Vec<GoalPoint> {
        let Some(data) = &self.path else { return Vec::new() };
        let is_ahead = |goal: &&GoalPoint| {
            path::nearest(&data.points, goal.position(), self.behind, f64::INFINITY)
                .is_some_and(|near| near.along > self.behind + AT_VIA)
        };
        data.via.iter().filter(is_ahead).copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;

    use super::super::path::DrivenPath;
    use super::*;

    #[test]
    fn the_same_path_with_more_of_it_behind_the_robot_is_no_other_one() {
        let path = RouteData::of(
            DrivenPath::forwards(vec![Point2::origin(), Point2::new(9.0, 0.0)]),
            None,
        );
        let after = |driven: f64| RouteData { driven, ..path.clone() };
        let mut tracking = Tracking::default();
        assert!(tracking.follow(after(2.0)));
        assert!(!tracking.follow(after(3.0)));
        assert_eq!(tracking.behind, 2.0);
    }
}
