//! Optimal reciprocal collision avoidance. Which velocity avoids everybody, if everybody takes half of the avoidance?
//!
//! Van den Berg, Guy, Lin and Manocha, "Reciprocal n-Body Collision Avoidance" (2011), for a body that cannot move sideways as in Snape,
//! van den Berg, Guy and Manocha, "Smooth and Collision-Free Navigation for Multiple Robots Under Differential-Drive Constraints" (2010):
//! a point ahead of the axle is steered, and a disc around it covers the outline. It is steered in the direction from the axle to the goal,
//! so that the axle arrives there. Walls are kept off a disc around the axle, which moves straight ahead or back only.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::robot::{Footprint, RobotModel};
use zenav_sim::Truth;
use zenav_sim::manners::{Manners, Neighbour, Walker};

use crate::cost_to_go::CostToGo;
use crate::driver::Person;
use crate::field::Field;
use crate::task::DrivingTask;
use crate::window::stopping_speed;

/// Distance of the steered point ahead of the axle, m.
const AHEAD: f64 = 0.15;
/// Walls farther away are ignored, m.
const SIGHT: f64 = 1.5;
/// Shortest step towards a wall, and distance at which somebody touches the robot, m.
const STEP: f64 = 0.02;
/// Distance kept from walls, m.
const BERTH: f64 = 0.03;
/// The robot gets no nearer to a wall than in this time, s.
const HORIZON: f64 = 0.5;

/// Steers one robot.
pub(crate) struct Orca<'a> {
    model: &'a RobotModel,
    goal: Point2<f64>,
    field: &'a Field,
    /// Radius of a disc around the steered point that covers the outline, m.
    radius: f64,
}

impl<'a> Orca<'a> {
    pub(crate) fn new(task: &DrivingTask<'a>, field: &'a Field) -> Self {
        let ahead = Vector2::new(AHEAD, 0.0);
        let radius = match &task.model.footprint {
            Footprint::Radius(radius) => radius + AHEAD,
            Footprint::Polygon(corners) => {
                let distances = corners.iter().map(|corner| (corner.coords - ahead).norm());
                distances.fold(0.0, f64::max)
            }
        };
        Self {
            model: task.model,
            goal: task.goal,
            field,
            radius,
        }
    }

    /// The twist among these people for the next `secs` seconds.
    pub(crate) fn choose(&self, truth: &Truth, people: &[Person], to_go: &CostToGo, secs: f64) -> Twist2 {
        let (pose, drive) = (truth.map_from_base, &self.model.drive);
        let (axle, heading) = (pose.position(), pose.heading());
        let left = Vector2::new(-heading.y, heading.x);
        let point = axle + heading * AHEAD;
        let top = drive.top_speed();
        let walker = Walker {
            velocity: heading * truth.twist.v + left * (AHEAD * truth.twist.w),
            wanted: to_go.way(axle) * top.min(stopping_speed(drive, (self.goal - axle).norm())),
            radius: self.radius,
            // No faster than the robot's own top speed.
            speed: top / Manners::Orca.top_speed(1.0),
        };
        let others: Vec<Neighbour> = people
            .iter()
            .map(|person| Neighbour {
                offset: person.at - point,
                velocity: person.velocity,
                radius: person.radius,
            })
            .collect();
        let [back, ahead] = [-heading, heading].map(|direction| self.room(axle, direction, people));
        let walls = [-heading * (self.radius + back), heading * (self.radius + ahead)];
        let chosen = Manners::Orca.velocity(&walker, &others, &walls, secs);
        // Among people too close on all sides some bound is broken: never these.
        let v = chosen.dot(&heading).clamp(-back / HORIZON, ahead / HORIZON);
        Twist2::new(v, chosen.dot(&left) / AHEAD)
    }

    /// How far the disc around the axle can move in a direction before it meets a wall, m; not at all towards somebody who touches it. What
    /// is too near already must not come nearer.
    fn room(&self, axle: Point2<f64>, direction: Vector2<f64>, people: &[Person]) -> f64 {
        let reach = self.model.footprint.circumscribed_radius();
        let is_pushed = |person: &Person| {
            let offset = person.at - axle;
            offset.norm() < reach + person.radius + STEP && offset.dot(&direction) > 0.0
        };
        if people.iter().any(is_pushed) {
            return 0.0;
        }
        let kept = (reach + BERTH).min(self.field.clearance(axle)) - 1e-4;
        let mut room = 0.0;
        while room < SIGHT {
            let free = self.field.clearance(axle + direction * (room + STEP)) - kept;
            if free < 0.0 {
                return room;
            }
            room += free.max(STEP);
        }
        SIGHT
    }
}
