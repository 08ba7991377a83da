//! Free place. Which place with enough clearance to every known obstacle is reached soonest, and how? By one turn on the spot and
//! one straight drive, forwards or backwards, each checked with the swept footprint.

use std::f64::consts::{PI, TAU};

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::robot::Footprint;

use crate::field_of_view::rigid;
use crate::local_obstacles::LocalObstacles;

/// Number of directions tried.
const DIRECTIONS: u32 = 16;
/// Spacing of the poses checked along a drive, m.
const PLACES: f64 = 0.1;
/// Slowest assumed speed, rad/s and m/s.
const SLOWEST: f64 = 1e-3;
/// Spacing of the candidate places along a direction, m.
const STEP: f64 = 0.05;

/// A turn (rad, counter-clockwise) and a straight drive after it (m, negative is backwards).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Escape {
    /// Turn on the spot, rad.
    pub turn: f64,
    /// Distance, m.
    pub distance: f64,
}

/// Speeds on the way to a free place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Forwards and backwards, m/s.
    pub speeds: [f64; 2],
    /// Turning on the spot, rad/s.
    pub turning: f64,
}

/// The soonest path to a place within `within` m at which every point is at least `clearance` m away from the footprint; `None` if there is
/// none.
///
/// `points` are in the base frame; `is_free` tells whether the robot, placed at a pose in its present base frame, can move with a twist
/// for so many seconds.
#[must_use]
pub fn free_place(
    footprint: &Footprint,
    points: &[Point2<f64>],
    clearance: f64,
    within: f64,
    pace: Pace,
    is_free: impl Fn(Pose2, Twist2, f64) -> bool,
) -> Option<Escape> {
    // NaN counts as zero.
    let within = within.max(0.0);
    let reach = within + clearance + footprint.circumscribed_radius();
    let near: Vec<&Point2<f64>> = points.iter().filter(|point| point.coords.norm() <= reach).collect();
    let is_valid = |pose: Pose2| {
        let inverse = pose.inverse();
        near.iter()
            .all(|point| footprint.distance(inverse.transform_point(**point)) >= clearance)
    };
    if is_valid(Pose2::IDENTITY) {
        return Some(Escape {
            turn: 0.0,
            distance: 0.0,
        });
    }
    let headings = (0..DIRECTIONS)
        .map(|index| TAU * f64::from(index) / f64::from(DIRECTIONS))
        .flat_map(|direction| [(wrap_angle(direction), 1.0), (wrap_angle(direction + PI), -1.0)]);
    let after = |turn: f64| Pose2::new(0.0, 0.0, turn);
    let can_turn = |turn: f64| turn == 0.0 || is_free(Pose2::IDENTITY, Twist2::new(0.0, turn.signum()), turn.abs());
    let secs = |turn: f64, distance: f64| {
        let speed = pace.speeds[usize::from(distance < 0.0)];
        turn.abs() / pace.turning.max(SLOWEST) + distance.abs() / speed.max(SLOWEST)
    };
    let mut soonest: Option<(f64, Escape)> = None;
    for (turn, sign) in headings {
        let drive = Twist2::new(sign, 0.0);
        let lengths = (1..=(within / STEP).floor() as u32).map(|step| STEP * f64::from(step));
        let is_sooner = |length: &f64| soonest.is_none_or(|(best, _)| secs(turn, sign * length) < best - 1e-9);
        let found = lengths
            .take_while(is_sooner)
            .find(|length| is_valid(after(turn).advance(drive, *length)));
        if let Some(length) = found
            && can_turn(turn)
            && is_free(after(turn), drive, length)
        {
            let distance = sign * length;
            soonest = Some((secs(turn, distance), Escape { turn, distance }));
        }
    }
    soonest.map(|(_, escape)| escape)
}

/// Whether a straight drive from `odom_from_there` goes into the blind spot over floor that is not known to be free up to `clearance` m
/// around the outline: the collision monitor would stop it.
#[must_use]
pub fn drives_into_unknown(
    footprint: &Footprint,
    obstacles: &LocalObstacles,
    clearance: f64,
    odom_from_there: Pose2,
    twist: Twist2,
    secs: f64,
) -> bool {
    let (floor, odom_from_there) = (obstacles.blind_spots(), rigid(odom_from_there));
    if !floor.leads_into_blind_spot(twist.v) {
        return false;
    }
    let reach = footprint.circumscribed_radius() + clearance;
    let places = (secs * twist.v.abs() / PLACES).ceil().clamp(1.0, 100.0);
    (1..=places as u32).any(|place| {
        let there = Pose2::IDENTITY.advance(twist, secs * f64::from(place) / places);
        (0..DIRECTIONS).any(|index| {
            let direction = Pose2::new(0.0, 0.0, TAU * f64::from(index) / f64::from(DIRECTIONS)).heading();
            // Only the leading side of the outline is on new floor.
            direction.x * twist.v > 0.0
                && floor.is_unknown(&odom_from_there, there.transform_point(Point2::from(direction * reach)))
        })
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const DISC: Footprint = Footprint::Radius(0.2);
    const PACE: Pace = Pace {
        speeds: [0.1, 0.1],
        turning: 1.0,
    };

    fn everything(_: Pose2, _: Twist2, _: f64) -> bool {
        true
    }

    #[test]
    fn with_enough_clearance_already_nothing_is_done() {
        let way = free_place(&DISC, &[Point2::new(0.5, 0.0)], 0.1, 1.0, PACE, everything);
        assert_eq!(way.map(|way| (way.turn, way.distance)), Some((0.0, 0.0)));
    }

    #[test]
    fn from_a_wall_ahead_it_backs_up_just_as_far_as_is_needed() {
        let wall: Vec<_> = (-20..=20).map(|i| Point2::new(0.22, 0.05 * f64::from(i))).collect();
        let way = free_place(&DISC, &wall, 0.095, 1.0, PACE, everything).unwrap();
        assert!(way.turn == 0.0 && (way.distance + 0.1).abs() < 1e-9, "{way:?}");
    }

    #[test]
    fn where_it_backs_up_slowly_it_turns_round_and_drives_ahead() {
        let wall: Vec<_> = (-20..=20).map(|i| Point2::new(0.22, 0.05 * f64::from(i))).collect();
        let slow = Pace {
            speeds: [0.1, 0.008],
            ..PACE
        };
        let way = free_place(&DISC, &wall, 0.295, 1.0, slow, everything).unwrap();
        assert!(way.distance > 0.0 && way.turn.abs() > 2.0, "{way:?}");
    }

    #[test]
    fn a_blocked_path_is_not_taken_and_without_any_there_is_none() {
        let point = [Point2::new(0.22, 0.0)];
        let not_back = |_: Pose2, twist: Twist2, _: f64| twist.v >= 0.0;
        let way = free_place(&DISC, &point, 0.1, 1.0, PACE, not_back).unwrap();
        assert!(way.distance > 0.0 && way.turn.abs() > 0.5, "{way:?}");
        assert_eq!(free_place(&DISC, &point, 0.1, 1.0, PACE, |_, _, _| false), None);
        assert_eq!(free_place(&DISC, &point, 2.0, 0.5, PACE, everything), None, "too far");
        assert_eq!(free_place(&DISC, &point, 0.1, f64::NAN, PACE, everything), None);
    }
}
