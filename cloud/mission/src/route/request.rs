//! Route request. Which route is wanted: to a goal, possibly through others, from the robot or from elsewhere, or along a given path?

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::GoalPoint;

use crate::leaves::path;

/// Greatest distance of a given path from the robot at which it is joined, m.
const JOIN: f64 = 0.5;
/// Distance below which points of a given path are merged, m.
const APART: f64 = 1e-3;

/// The requested route.
#[derive(Clone, Debug, PartialEq)]
pub struct RouteRequest {
    /// Goals on the way, in order.
    pub via: Vec<GoalPoint>,
    /// Final goal.
    pub goal: GoalPoint,
    /// Start pose other than the robot's: gives a path without a trajectory.
    pub from: Option<Pose2>,
    /// An existing path: it is driven if it passes the robot and is drivable.
    pub given: Vec<Point2<f64>>,
    /// Whether the path is to lead past the robots that the robot gives way to.
    pub past_others: bool,
}

impl RouteRequest {
    /// To a goal, from the robot's position.
    #[must_use]
    pub fn to(goal: GoalPoint) -> Self {
        Self {
            via: Vec::new(),
            goal,
            from: None,
            given: Vec::new(),
            past_others: false,
        }
    }

    /// The given path from the robot's predicted position; a path that does not pass there is dropped.
    pub(super) fn join_given(&mut self, here: Point2<f64>) -> Option<Vec<Point2<f64>>> {
        let whole = path::length(&self.given);
        let near = path::nearest(&self.given, here, 0.0, whole).filter(|near| near.distance <= JOIN);
        let Some(near) = near else {
            self.given.clear();
            return None;
        };
        let mut joined = vec![here];
        for point in path::part(&self.given, near.along, whole) {
            if joined.last().is_none_or(|last| (point - last).norm() > APART) {
                joined.push(point);
            }
        }
        if joined.len() == 1 {
            // The robot is at its end.
            joined.push(here);
        }
        Some(joined)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_given_path_is_joined_where_it_is_near_and_dropped_where_it_is_not() {
        let goal = GoalPoint {
            x: 3.0,
            y: 0.0,
            yaw: None,
        };
        let mut request = RouteRequest {
            given: vec![Point2::new(0.0, 0.0), Point2::new(3.0, 0.0)],
            ..RouteRequest::to(goal)
        };
        let joined = [(1.0, 0.2), (1.0, 0.0), (3.0, 0.0)].map(|(x, y)| Point2::new(x, y));
        assert_eq!(request.join_given(joined[0]).as_deref(), Some(&joined[..]));
        assert_eq!(request.join_given(Point2::new(1.0, 1.0)), None);
        assert!(request.given.is_empty());
    }
}
