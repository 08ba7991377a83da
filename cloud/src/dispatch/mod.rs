//! Dispatch. A group's goal goes to the nearest idle robot; when none is idle, to the robot with the shortest queue.
//!
//! Nothing is stored here. A goal's id is looked up among the robots' goals first, so a resent goal reaches the robot that already has it,
//! even after a restart. [`service`] asks the robots' missions and forwards the goal.

pub mod service;

use std::collections::BTreeMap;

use nalgebra::Point2;
use zenav_protocol::messages::{GoalPoint, GoalRequest, OnBusy, Refusal};

/// A robot that can be assigned a goal.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Its id.
    pub robot: String,
    /// Its position, m, if known.
    pub position: Option<Point2<f64>>,
    /// Active and queued goals.
    pub outstanding: usize,
}

/// Chooses the robot for a goal; the goal's position may be unknown.
///
/// # Errors
/// [`Refusal::Rejected`] without a candidate, or when none is idle and the goal must not be queued.
pub fn choose(candidates: &[Candidate], at: Option<Point2<f64>>, on_busy: OnBusy) -> Result<&Candidate, Refusal> {
    let away = |candidate: &Candidate| match (candidate.position, at) {
        (Some(position), Some(at)) => (at - position).norm(),
        (Some(_), None) => 0.0,
        (None, _) => f64::INFINITY,
    };
    let best = candidates
        .iter()
        .min_by(|a, b| a.outstanding.cmp(&b.outstanding).then(away(a).total_cmp(&away(b))))
        .ok_or_else(|| Refusal::rejected("no robot of the group answers"))?;
    if best.outstanding > 0 && on_busy == OnBusy::Reject {
        return Err(Refusal::rejected("every robot of the group is busy"));
    }
    Ok(best)
}

/// First position of a goal, if it has one.
#[must_use]
pub fn place_of(request: &GoalRequest, places: &BTreeMap<String, GoalPoint>) -> Option<Point2<f64>> {
    let named = request.place.as_ref().and_then(|name| places.get(name));
    let point = named
        .or(request.waypoints.first())
        .map(|point| Point2::new(point.x, point.y));
    point.or_else(|| Some(Point2::new(request.x?, request.y?)))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn candidate(robot: &str, x: f64, outstanding: usize) -> Candidate {
        Candidate {
            robot: robot.to_owned(),
            position: Some(Point2::new(x, 0.0)),
            outstanding,
        }
    }

    fn chosen(candidates: &[Candidate], x: f64) -> String {
        let at = Some(Point2::new(x, 0.0));
        choose(candidates, at, OnBusy::Queue).unwrap().robot.clone()
    }

    #[test]
    fn the_nearest_that_is_free_takes_a_goal_and_else_the_one_with_the_fewest() {
        let robots = [candidate("a", 0.0, 1), candidate("b", 3.0, 0), candidate("c", 9.0, 0)];
        assert_eq!(
            (chosen(&robots, 1.0), chosen(&robots, 8.0)),
            ("b".to_owned(), "c".to_owned())
        );
        let busy = [candidate("a", 0.0, 2), candidate("b", 5.0, 1)];
        assert_eq!(chosen(&busy, 0.0), "b");
        assert!(choose(&busy, None, OnBusy::Reject).is_err());
        assert!(choose(&[], None, OnBusy::Queue).is_err());
    }

    #[test]
    fn one_that_does_not_say_where_it_is_comes_last_among_the_free() {
        let lost = Candidate {
            position: None,
            ..candidate("a", 0.0, 0)
        };
        assert_eq!(chosen(&[lost, candidate("b", 50.0, 0)], 0.0), "b");
    }

    #[test]
    fn a_goal_begins_at_its_place_its_first_waypoint_or_its_point() {
        let at = |x, y| GoalPoint { x, y, yaw: None };
        let places = BTreeMap::from([("sink".to_owned(), at(1.0, 2.0))]);
        let place = GoalRequest {
            place: Some("sink".to_owned()),
            ..GoalRequest::default()
        };
        let waypoints = GoalRequest {
            waypoints: vec![at(3.0, 4.0), at(5.0, 6.0)],
            ..GoalRequest::default()
        };
        let point = GoalRequest {
            x: Some(7.0),
            y: Some(8.0),
            ..GoalRequest::default()
        };
        let found = [place, waypoints, point, GoalRequest::default()].map(|request| place_of(&request, &places));
        let expected = [(1.0, 2.0), (3.0, 4.0), (7.0, 8.0)].map(|(x, y)| Some(Point2::new(x, y)));
        assert_eq!((&found[..3], found[3]), (&expected[..], None));
    }
}
