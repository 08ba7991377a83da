//! Contact. When something has run into the robot, or leans on it, how near would a pose bring the outline to it?
//!
//! Grids and covering discs are too coarse in contact. While it lasts, the outline itself is compared with the points around it, and a
//! motion is judged by whether it leads nearer to them or away. An obstacle that leans on the robot cannot move on through it: it is
//! assumed to stay where it is seen.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Footprint;

use super::AvoidanceInput;
use crate::obstacle_tracks::Track;

/// A moving obstacle this near touches the robot; it has let go beyond the second distance, m.
const TOUCHES: f64 = 0.03;
const LET_GO: f64 = 0.08;
/// After this long the contact is left to the mission, s.
const LONGEST: f64 = 15.0;
/// Points this near to the outline count, m, thinned to the second distance, m.
const REACH: f64 = 0.5;
const SPACING: f64 = 0.02;
/// A motion may lead this much nearer, m: ranges are noisy.
const SLACK: f64 = 0.01;

/// The present contact and the points around it.
#[derive(Clone, Debug, Default)]
pub(super) struct Touched {
    /// Time since the contact began, s; `None` without one.
    since: Option<f64>,
    /// Points around the robot, in the base frame of the last update, and their distances from the outline, m; negative inside.
    points: Vec<(Point2<f64>, f64)>,
}

impl Touched {
    /// Updates the points around the robot. Only a moving obstacle begins a contact; the robot may drive along a wall.
    pub(super) fn update(&mut self, footprint: &Footprint, input: &AvoidanceInput<'_>) {
        let near = footprint.circumscribed_radius() + REACH;
        let (mut least, mut least_moving) = (f64::INFINITY, f64::INFINITY);
        self.points.clear();
        for point in input.obstacles.in_base(input.odom_from_base) {
            if point.coords.norm_squared() > near * near {
                continue;
            }
            let distance = off(footprint, point);
            least = least.min(distance);
            let on_track = || {
                input
                    .obstacles
                    .moving()
                    .tracks()
                    .at(input.odom_from_base.transform_point(point))
            };
            if distance < TOUCHES.min(least_moving) && on_track().is_some_and(|track| !track.is_robot()) {
                least_moving = distance;
            }
            let is_new = |(last, _): &(Point2<f64>, f64)| (point - last).norm_squared() >= SPACING * SPACING;
            if distance < REACH && self.points.last().is_none_or(is_new) {
                self.points.push((point, distance));
            }
        }
        self.since = match self.since {
            Some(since) if least < LET_GO && since < LONGEST => Some(since + input.dt),
            None if least_moving < TOUCHES => Some(0.0),
            _ => None,
        };
    }

    /// Whether a moving obstacle touches the robot.
    pub(super) fn is_so(&self) -> bool {
        self.since.is_some()
    }

    /// Distance of the outline from the points around it once the robot has moved by `base_from_there`, m; `None` if the move leads into
    /// one of them, or deeper into it.
    pub(super) fn distance(&self, footprint: &Footprint, base_from_there: Pose2) -> Option<f64> {
        let there_from_base = base_from_there.inverse();
        self.points.iter().try_fold(REACH, |least, (point, before)| {
            let distance = off(footprint, there_from_base.transform_point(*point));
            (distance >= before.min(TOUCHES) - SLACK).then_some(least.min(distance))
        })
    }

    /// Whether a track's disc touches the robot: the obstacle leans on it and does not move on.
    pub(super) fn leans(&self, footprint: &Footprint, base_from_odom: Pose2, track: &Track) -> bool {
        self.is_so() && footprint.distance(base_from_odom.transform_point(track.position)) < track.radius + LET_GO
    }

    /// Ends the contact.
    pub(super) fn reset(&mut self) {
        self.since = None;
    }
}

/// Distance of a point (base frame) from the outline, m; negative inside.
fn off(footprint: &Footprint, point: Point2<f64>) -> f64 {
    footprint.distance(point) - footprint.depth(point)
}
