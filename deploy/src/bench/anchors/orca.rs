//! Optimal reciprocal collision avoidance. Chooses the velocity that avoids everybody, if everybody takes half of the avoidance.
//!
//! Van den Berg, Guy, Lin and Manocha, "Reciprocal n-Body Collision Avoidance" (2011), for a body that cannot move sideways as in Snape,
//! van den Berg, Guy and Manocha, "Smooth and Collision-Free Navigation for Multiple Robots Under Differential-Drive Constraints" (2010):
//! a point ahead of the axle is steered, and a disc around it covers the outline.

use std::f64::consts::TAU;

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::robot::{Footprint, RobotModel};
use zenav_sim::Truth;
use zenav_sim::manners::{Manners, Neighbour, Walker};

use super::{Field, Walker as Person};

/// Distance of the steered point ahead of the axle, m.
const AHEAD: f64 = 0.15;
/// Number of directions sampled for the descent to the goal and for the nearest wall.
const DIRECTIONS: u32 = 32;
/// Sampling distance, m.
const STEP: f64 = 0.3;

/// Steers one robot.
pub(super) struct Orca<'a> {
    model: &'a RobotModel,
    field: &'a Field,
    /// Radius of a disc around the steered point that covers the outline, m.
    radius: f64,
}

impl<'a> Orca<'a> {
    pub(super) fn new(model: &'a RobotModel, field: &'a Field) -> Self {
        let ahead = Vector2::new(AHEAD, 0.0);
        let radius = match &model.footprint {
            Footprint::Radius(radius) => radius + AHEAD,
            Footprint::Polygon(corners) => {
                let distances = corners.iter().map(|corner| (corner.coords - ahead).norm());
                distances.fold(0.0, f64::max)
            }
        };
        Self { model, field, radius }
    }

    /// The twist for the next `secs` seconds among these people.
    pub(super) fn choose(&self, truth: &Truth, people: &[Person], secs: f64) -> Twist2 {
        let (pose, drive) = (truth.map_from_base, &self.model.drive);
        let heading = pose.heading();
        let left = Vector2::new(-heading.y, heading.x);
        let point = pose.position() + heading * AHEAD;
        let walker = Walker {
            velocity: heading * truth.twist.v + left * (AHEAD * truth.twist.w),
            wanted: self.towards_goal(point) * drive.top_speed(),
            radius: self.radius,
            speed: drive.top_speed(),
        };
        let others: Vec<Neighbour> = people
            .iter()
            .map(|person| Neighbour {
                offset: person.at - point,
                velocity: person.velocity,
                radius: person.radius,
            })
            .collect();
        let chosen = Manners::Orca.velocity(&walker, &others, &[self.to_wall(point)], secs);
        Twist2::new(chosen.dot(&heading), chosen.dot(&left) / AHEAD)
    }

    /// Direction of steepest descent of the distance to the goal.
    fn towards_goal(&self, from: Point2<f64>) -> Vector2<f64> {
        let straight = self.field.goal() - from;
        if straight.norm() < STEP {
            return straight / STEP;
        }
        least(|direction| self.field.to_goal(from + direction * STEP))
    }

    /// Vector from a place to the nearest static obstacle, m.
    fn to_wall(&self, from: Point2<f64>) -> Vector2<f64> {
        least(|direction| self.field.clearance(from + direction * STEP)) * self.field.clearance(from)
    }
}

/// The direction with the least value.
fn least(value: impl Fn(Vector2<f64>) -> f64) -> Vector2<f64> {
    let directions = (0..DIRECTIONS).map(|nth| {
        let (sin, cos) = (TAU * f64::from(nth) / f64::from(DIRECTIONS)).sin_cos();
        Vector2::new(cos, sin)
    });
    directions
        .min_by(|a, b| value(*a).total_cmp(&value(*b)))
        .unwrap_or_default()
}
