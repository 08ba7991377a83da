//! Intent. Where is a robot about to drive, for the other robots around it?

use std::cmp::Ordering;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use crate::geometry::{Pose2, Twist2};
use crate::time::Stamp;

/// Present and future positions of a robot. Published a few times a second until the robot has been stationary without a goal for a while;
/// other robots then treat it as a plain obstacle. All robots that receive each other's intents share one map frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Intent {
    /// Time that the pose is for, on the robot's clock.
    pub stamp: Stamp,
    /// The robot's name.
    pub robot: String,
    /// Radius of the disc around the base that contains the whole footprint, m.
    pub radius: f64,
    /// Pose in the map.
    pub map_from_base: Pose2,
    /// Velocity in the base frame.
    pub velocity: Twist2,
    /// Time between two of the `places`, s.
    pub step: f64,
    /// Predicted positions, `step` apart, beginning at the stamp; the robot stays at the last one. Map frame, m.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub places: Vec<Point2<f64>>,
    /// Positions along its plan after that, `later_step` apart, so that another robot can wait before the paths meet. Map frame, m.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub later: Vec<Point2<f64>>,
    /// Time between two of the `later` positions, s.
    #[serde(default, skip_serializing_if = "crate::drive::is_zero")]
    pub later_step: f64,
    /// Whether the robot has somewhere to go. A robot without a goal cannot make way.
    pub driving: bool,
    /// Whether the robot has found no place to make way to.
    pub trapped: bool,
    /// Planned duration of its whole path, fixed when it set out, s: the robot with the longer one goes first.
    pub way_secs: f64,
}

impl Intent {
    /// Right of way over another robot, decided by the first difference: a robot that cannot make way, then one that found no place to make
    /// way to, then the one with the longer path, then by name. This is a total order, so no cycle of robots waits for each other; both
    /// robots compute the same result from the two messages alone.
    #[must_use]
    pub fn goes_before(&self, other: &Self) -> bool {
        let order = self.driving.cmp(&other.driving);
        let order = order.then(other.trapped.cmp(&self.trapped));
        let order = order.then(other.way_secs.total_cmp(&self.way_secs));
        order.then_with(|| self.robot.cmp(&other.robot)) == Ordering::Less
    }

    /// Whether all numbers are plausible.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let places = self
            .places
            .iter()
            .chain(&self.later)
            .all(|place| place.coords.iter().all(|at| at.is_finite()));
        places
            && (1..=MOST_PLACES).contains(&self.places.len())
            && (0.02..=2.0).contains(&self.step)
            && self.later.len() <= MOST_LATER
            && (0.0..=10.0).contains(&self.later_step)
            && (0.01..=5.0).contains(&self.radius)
            && self.way_secs.is_finite()
            && self.map_from_base.is_finite()
            && self.velocity.is_finite()
    }
}

/// The robots that a robot gives way to, published some times a second while it waits for them on its plan or will have to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Yield {
    /// Time that the times of the courses are relative to, on the robot's clock.
    pub stamp: Stamp,
    /// The trajectory on which the robot waits.
    pub trajectory_id: u64,
    /// Number of the map frame that the courses are in.
    #[serde(default)]
    pub frame: u64,
    /// Time that the robot will lose by waiting, s.
    pub wait_secs: f64,
    /// Courses of the robots with right of way.
    pub courses: Vec<KnownCourse>,
}

/// The known course of another robot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct KnownCourse {
    /// Radius of the disc around its outline, m.
    pub radius: f64,
    /// Where the robot will be, in order of time; after the last of them it counts as gone.
    pub places: Vec<CoursePlace>,
}

/// A place on a course.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CoursePlace {
    /// Time from now, s.
    pub secs: f64,
    /// Map frame, m.
    pub x: f64,
    /// Map frame, m.
    pub y: f64,
}

impl CoursePlace {
    /// The place, map frame.
    #[must_use]
    pub fn at(&self) -> Point2<f64> {
        Point2::new(self.x, self.y)
    }
}

impl KnownCourse {
    /// Most places of a course.
    pub const MOST_PLACES: usize = MOST_PLACES + MOST_LATER;
    /// Most courses that a path gives way to.
    pub const MOST: usize = 32;
    /// Bounds of times, s, and coordinates, m.
    const FARTHEST: (f64, f64) = (600.0, 1e6);

    /// Whether all numbers are within bounds, and the times in order.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let (secs, metres) = Self::FARTHEST;
        let bounded = |place: &CoursePlace| {
            place.secs.abs() <= secs && [place.x, place.y].iter().all(|value| value.abs() <= metres)
        };
        (0.01..=5.0).contains(&self.radius)
            && (1..=Self::MOST_PLACES).contains(&self.places.len())
            && self.places.iter().all(bounded)
            && self.places.is_sorted_by(|a, b| a.secs <= b.secs)
    }
}

/// Most `places` in an intent, and most `later` positions.
const MOST_PLACES: usize = 64;
const MOST_LATER: usize = 32;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_robots_exactly_one_has_right_of_way() {
        let mut all = Vec::new();
        for (nth, robot) in ["anna", "bert"].into_iter().enumerate() {
            for bits in 0..8_u32 {
                all.push(Intent {
                    robot: format!("{robot}{bits}"),
                    driving: bits & 1 > 0,
                    trapped: bits & 2 > 0,
                    way_secs: if bits & 4 > 0 { 10.0 + nth as f64 } else { 5.0 },
                    ..Intent::default()
                });
            }
        }
        for a in &all {
            for b in all.iter().filter(|b| b.robot != a.robot) {
                assert_ne!(a.goes_before(b), b.goes_before(a), "{a:?} {b:?}");
                for c in all.iter().filter(|c| c.robot != a.robot && c.robot != b.robot) {
                    assert!(!(a.goes_before(b) && b.goes_before(c) && c.goes_before(a)));
                }
            }
        }
        let standing = &all[0];
        assert!(
            all.iter()
                .filter(|other| other.driving)
                .all(|other| standing.goes_before(other))
        );
    }
}
