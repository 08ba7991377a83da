//! Route request. Which route is wanted: to a goal, possibly through others, from the robot or from elsewhere, or along a given path?

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::GoalPoint;

use crate::leaves::path::{self, DrivenPath};

/// Greatest distance of a given path from the robot at which it is joined, m.
const JOIN: f64 = 0.5;
/// Distance below which points of a given path are merged, m.
const APART: f64 = 1e-3;

/// The requested route.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RouteRequest {
    /// Goals on the way, in order.
    pub via: Vec<GoalPoint>,
    /// Final goal.
    pub goal: GoalPoint,
    /// Start pose other than the robot's: gives a path without a trajectory.
    pub from: Option<Pose2>,
    /// An existing path: it is driven if it passes the robot and is drivable.
    pub given: DrivenPath,
    /// How much of that is behind the robot, m.
    pub driven: f64,
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
            given: DrivenPath::default(),
            driven: 0.0,
            past_others: false,
        }
    }

    /// The given path from the robot's predicted position; a path that does not pass there is dropped.
    pub(super) fn join_given(&mut self, here: Point2<f64>) -> Option<DrivenPath> {
        let whole = path::length(&self.given.points);
        let near = self
            .given
            .nearest(here, 0.0, whole, self.driven)
            .filter(|near| near.distance <= JOIN);
        let Some(near) = near else {
            self.given = DrivenPath::default();
            return None;
        };
        let rest = self.given.part(near.along, whole);
        // The robot joins the path in the direction in which it goes on: another one would be a change of direction beside the path.
        let mut is_first_backwards = rest.backwards.first() == Some(&0);
        let mut joined = DrivenPath::forwards(vec![here]);
        for (point, is_backwards) in rest.corners() {
            let goes_backwards = is_backwards || std::mem::take(&mut is_first_backwards);
            if joined.points.last().is_none_or(|last| (point - last).norm() > APART) {
                joined.push(point, goes_backwards);
            }
        }
        if joined.points.len() == 1 {
            // The robot is at its end.
            joined.push(here, false);
        }
        Some(joined)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_given_path_is_joined_where_it_is_near_and_dropped_where_it_is_not() {
        let goal = GoalPoint::at(3.0, 0.0);
        let mut request = RouteRequest {
            given: DrivenPath::forwards(vec![Point2::new(0.0, 0.0), Point2::new(3.0, 0.0)]),
            ..RouteRequest::to(goal)
        };
        let joined = [(1.0, 0.2), (1.0, 0.0), (3.0, 0.0)].map(|(x, y)| Point2::new(x, y));
        let expected = DrivenPath::forwards(joined.to_vec());
        assert_eq!(request.join_given(joined[0]), Some(expected));
        assert_eq!(request.join_given(Point2::new(1.0, 1.0)), None);
        assert!(request.given.points.is_empty());
    }

    #[test]
    fn a_given_path_is_joined_in_the_direction_in_which_it_is_driven_there() {
        let goal = GoalPoint::at(0.0, 0.0);
        let given = DrivenPath {
            points: [(0.0, 0.0), (4.0, 0.0), (4.0, -3.0), (0.0, -3.0)]
                .map(|(x, y)| Point2::new(x, y))
                .to_vec(),
            backwards: vec![1],
        };
        let joins = |x: f64, y: f64| {
            let mut request = RouteRequest {
                given: given.clone(),
                ..RouteRequest::to(goal)
            };
            let joined = request.join_given(Point2::new(x, y)).unwrap();
            (joined.points.len() - 1, joined.backwards)
        };
        assert_eq!(joins(4.0, -1.0), (2, vec![0]), "on the reverse leg");
        assert_eq!(joins(4.2, -1.0), (3, vec![0, 1]), "beside it");
        assert_eq!(joins(1.0, 0.2), (4, vec![2]), "before it");
        assert_eq!(joins(1.0, -3.2), (2, vec![]), "after it");
        assert_eq!(joins(0.0, -3.0), (1, vec![]), "at the end");
    }

    #[test]
    fn a_given_path_that_begins_with_a_reverse_leg_is_joined_on_it_although_the_next_one_passes_nearer() {
        let given = DrivenPath {
            points: [0.0, -1.0, 12.0].map(|x| Point2::new(x, 0.0)).to_vec(),
            backwards: vec![0],
        };
        let mut request = RouteRequest {
            given,
            ..RouteRequest::to(GoalPoint::at(12.0, 0.0))
        };
        let joined = request.join_given(Point2::new(0.02, 0.0)).unwrap();
        let along: Vec<f64> = joined.points.iter().map(|point| point.x).collect();
        assert_eq!((along, joined.backwards), (vec![0.02, 0.0, -1.0, 12.0], vec![0, 1]));
        // Once that leg is driven, it is not driven again.
        request.driven = 1.5;
        let joined = request.join_given(Point2::new(-0.5, 0.0)).unwrap();
        let along: Vec<f64> = joined.points.iter().map(|point| point.x).collect();
        assert_eq!((along, joined.backwards), (vec![-0.5, 12.0], vec![]));
    }
}
