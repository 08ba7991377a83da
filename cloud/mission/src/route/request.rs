//! What is a search for? A goal, perhaps through others, from where the robot is or from another place, or along a way that
//! is there already.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::GoalPoint;

use super::begin::Begin;
use crate::leaves::path;

/// A given way that is farther than this from the robot is not joined, m.
const JOIN: f64 = 0.5;
/// Points of a given way nearer together than this are one, m.
const APART: f64 = 1e-3;

/// What is to be found.
#[derive(Clone, Debug, PartialEq)]
pub struct RouteRequest {
    /// Goals to pass, in order.
    pub via: Vec<GoalPoint>,
    /// Where to.
    pub goal: GoalPoint,
    /// From there, not from where the robot is: there is a way then, and no motion along it.
    pub from: Option<Pose2>,
    /// A way that is there already: it is only made a motion, if it leads past the robot and can be driven.
    pub given: Vec<Point2<f64>>,
}

impl RouteRequest {
    /// To a goal, from where the robot is.
    #[must_use]
    pub fn to(goal: GoalPoint) -> Self {
        Self {
            via: Vec::new(),
            goal,
            from: None,
            given: Vec::new(),
        }
    }
}

/// How far a quest has come. Legs are planned from the last to the first, which begins where the robot will be by then.
#[derive(Clone, Debug)]
pub(super) struct Legs {
    quest: RouteRequest,
    /// Goals that are left to plan to, after the leg in hand.
    before: usize,
    /// The way from the end of the leg in hand.
    rest: Vec<Point2<f64>>,
}

impl Legs {
    pub(super) fn of(quest: RouteRequest) -> Self {
        Self {
            before: quest.via.len(),
            quest,
            rest: Vec::new(),
        }
    }

    /// The end of all legs.
    pub(super) fn last(&self) -> GoalPoint {
        self.quest.goal
    }

    /// Where the leg in hand leads.
    pub(super) fn goal(&self) -> GoalPoint {
        self.quest.via.get(self.before).copied().unwrap_or(self.quest.goal)
    }

    /// Where the leg in hand begins, if not where the robot is.
    pub(super) fn begin(&self) -> Option<Begin> {
        let stop = self.before.checked_sub(1).and_then(|before| self.quest.via.get(before));
        let pose = stop.map(|stop| Pose2::new(stop.x, stop.y, stop.yaw.unwrap_or(0.0)));
        pose.or(self.quest.from).map(|pose| Begin {
            pose,
            twist: Twist2::ZERO,
            splice: None,
        })
    }

    /// Whether only a way is wanted, no motion.
    pub(super) fn is_only_a_way(&self) -> bool {
        self.quest.from.is_some()
    }

    /// Takes the way of the leg in hand. `Some` is the whole way, `None`: there is another leg before.
    pub(super) fn take(&mut self, mut way: Vec<Point2<f64>>) -> Option<Vec<Point2<f64>>> {
        // One leg ends where the next begins.
        way.extend(self.rest.drain(..).skip(1));
        match self.before.checked_sub(1) {
            None => Some(way),
            Some(before) => {
                (self.before, self.rest) = (before, way);
                None
            }
        }
    }

    /// Every leg is to be planned again.
    pub(super) fn begin_anew(&mut self) {
        self.before = self.quest.via.len();
        self.rest.clear();
    }

    /// The given way is no good. Whether there was one.
    pub(super) fn drop_given(&mut self) -> bool {
        !std::mem::take(&mut self.quest.given).is_empty()
    }

    /// The given way from where the robot will be, if there is one that leads past there.
    pub(super) fn join(&mut self, begin: &Begin) -> Option<Vec<Point2<f64>>> {
        let (here, given) = (begin.pose.position(), &self.quest.given);
        let whole = path::length(given);
        let near = path::nearest(given, here, 0.0, whole).filter(|near| near.distance <= JOIN);
        let Some(near) = near else {
            self.drop_given();
            return None;
        };
        let mut way = vec![here];
        for point in path::part(given, near.along, whole) {
            if way.last().is_none_or(|last| (point - last).norm() > APART) {
                way.push(point);
            }
        }
        if way.len() == 1 {
            // The robot is there.
            way.push(here);
        }
        Some(way)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn at(x: f64) -> GoalPoint {
        GoalPoint { x, y: 0.0, yaw: None }
    }

    fn way(from: f64, to: f64) -> Vec<Point2<f64>> {
        vec![Point2::new(from, 0.0), Point2::new(to, 0.0)]
    }

    #[test]
    fn legs_are_planned_from_the_last_to_the_first_and_joined() {
        let mut legs = Legs::of(RouteRequest {
            via: vec![at(1.0), at(2.0)],
            ..RouteRequest::to(at(3.0))
        });
        assert_eq!((legs.begin().unwrap().pose.x, legs.goal()), (2.0, at(3.0)));
        assert_eq!(legs.take(way(2.0, 3.0)), None);
        assert_eq!((legs.begin().unwrap().pose.x, legs.goal()), (1.0, at(2.0)));
        assert_eq!(legs.take(way(1.0, 2.0)), None);
        assert!(legs.begin().is_none() && legs.goal() == at(1.0));
        let whole: Vec<f64> = legs.take(way(0.0, 1.0)).unwrap().iter().map(|point| point.x).collect();
        assert_eq!(whole, [0.0, 1.0, 2.0, 3.0]);
    }

    #[test]
    fn a_given_way_is_joined_where_it_is_near_and_dropped_where_it_is_not() {
        let quest = RouteRequest {
            given: way(0.0, 3.0),
            ..RouteRequest::to(at(3.0))
        };
        let begin = |y| Begin {
            pose: Pose2::new(1.0, y, 0.0),
            twist: Twist2::ZERO,
            splice: None,
        };
        let joined = Legs::of(quest.clone()).join(&begin(0.2)).unwrap();
        assert_eq!(
            joined,
            [Point2::new(1.0, 0.2), Point2::new(1.0, 0.0), Point2::new(3.0, 0.0)]
        );
        assert_eq!(Legs::of(quest).join(&begin(1.0)), None);
    }
}
