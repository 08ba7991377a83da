//! Dynamic window. Which reachable twist is best?
//!
//! Fox, Burgard and Thrun, "The Dynamic Window Approach to Collision Avoidance" (1997): reachable twists are rolled out under the limits of
//! wheels and base, those that come too near to something are dropped, and the twist with the cheapest rollout is taken. As in Brock and
//! Khatib, "High-speed navigation using the global dynamic window approach" (1999), the way to the goal leads around obstacles.

use std::f64::consts::PI;

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::robot::{Drive, RobotModel};
use zenav_sim::{Truth, World};

use crate::cost_to_go::CostToGo;
use crate::driver::Disc;
use crate::field::Field;
use crate::task::DrivingTask;

/// Time between two poses of a rollout, s.
const STEP: f64 = 0.1;
/// Twists are tried that the robot can reach in this time, s.
const REACH: f64 = 0.5;
/// Number of speeds and of yaw rates tried.
const TRIED: [u32; 2] = [7, 13];
/// A twist is kept for so long, or to the end of the rollout; then the robot brakes, s.
const KEPT: f64 = 0.5;
/// Clearance of a rollout, m. What is nearer already must not come nearer still.
const MARGIN: f64 = 0.04;
/// Tolerance of that, m.
const ROUNDING: f64 = 1e-6;
/// Beyond this distance from the disc around the outline, the outline itself need not be looked at, m.
const FAR: f64 = 1.0;
/// Error of interpolated clearances, m.
const ROUGH: f64 = 0.05;
/// Cost of touching somebody, as a share of what driving at top speed gains, and its decay length, m.
const NEAR: (f64, f64) = (0.5, 0.2);
/// Cost of facing away from the way, as such a share; it decreases over the last so many metres.
const FACING: (f64, f64) = (1.0, 0.5);
/// Cost of a rollout with contact.
const CONTACT: f64 = 1e6;
/// Time from a decision until the wheels brake, s.
const LATE: f64 = 0.1;

/// The dynamic window of a robot in a world.
pub(crate) struct Window<'a> {
    model: &'a RobotModel,
    world: &'a World,
    goal: Point2<f64>,
    field: &'a Field,
    reach: f64,
}

/// How far a rollout is from where it should be, m, and how far its last pose faces away from there, rad.
pub(crate) struct Off {
    metres: f64,
    facing: f64,
}

/// Clearances that a rollout must keep, m: from walls, and from everybody; with their present discs.
struct Limits {
    walls: f64,
    discs: Vec<(Disc, f64)>,
}

impl<'a> Window<'a> {
    pub(crate) fn new(task: &DrivingTask<'a>, field: &'a Field) -> Self {
        Self {
            model: task.model,
            world: task.world,
            goal: task.goal,
            field,
            reach: task.model.footprint.circumscribed_radius(),
        }
    }

    /// The twist with the cheapest rollout; `predict` gives everybody's disc at a time from now (s).
    ///
    /// If every rollout ends in contact, the one with the latest contact is taken.
    pub(crate) fn choose(
        &self,
        truth: &Truth,
        horizon: f64,
        predict: impl Fn(f64) -> Vec<Disc>,
        off: impl Fn(&[Pose2]) -> Off,
    ) -> Twist2 {
        let steps = (horizon / STEP).round() as u32;
        let discs: Vec<Vec<Disc>> = (1..=steps).map(|step| predict(STEP * f64::from(step))).collect();
        let limits = self.limits(truth.map_from_base, &predict(0.0));
        // Mean distance that a robot at top speed gains over a rollout.
        let gain = 0.5 * self.model.drive.top_speed() * horizon;
        let mut best = (f64::INFINITY, Twist2::ZERO);
        for twist in self.reachable(truth) {
            for kept in [horizon, KEPT] {
                let cost = match self.roll_out(truth, twist, kept, &limits, &discs) {
                    Ok((poses, clearance)) => {
                        let Off { metres, facing } = off(&poses);
                        metres / gain + FACING.0 * facing / PI + NEAR.0 * (-clearance / NEAR.1).exp()
                    }
                    Err((step, clearance)) => CONTACT - step as f64 - clearance,
                };
                if cost < best.0 {
                    best = (cost, twist);
                }
            }
        }
        best.1
    }

    /// Rest, and twists within reach: the nearer to the present one, the more finely sampled.
    fn reachable(&self, truth: &Truth) -> Vec<Twist2> {
        let drive = &self.model.drive;
        let now = truth.twist;
        let (gain, loss) = (drive.acceleration() * REACH, drive.hard_braking * REACH);
        let (down, up) = if now.v < 0.0 { (gain, loss) } else { (loss, gain) };
        let spin = 2.0 * gain / drive.wheel_separation;
        let left = (truth.map_from_base.position() - self.goal).norm();
        let top = drive.top_speed().min(stopping_speed(drive, left));
        let speeds = samples(now.v, [now.v - down, now.v + up], top, TRIED[0]);
        let mut rates = samples(now.w, [now.w - spin, now.w + spin], drive.top_yaw_rate(), TRIED[1]);
        rates.push(0.0);
        let mut twists = vec![Twist2::ZERO];
        for v in speeds {
            twists.extend(rates.iter().map(|w| Twist2::new(v, *w)));
        }
        twists
    }

    /// The margin, or less from what is nearer at the beginning.
    fn limits(&self, from: Pose2, discs: &[Disc]) -> Limits {
        let kept = |clearance: f64| MARGIN.min(clearance) - ROUNDING;
        Limits {
            walls: kept(self.world.clearance(&self.model.footprint, from)).max(0.0),
            discs: discs
                .iter()
                .map(|disc| (*disc, kept(self.clearance(from, disc))))
                .collect(),
        }
    }

    /// The poses of a twist that is kept for a time (s), and its least clearance from anybody (m); or step and clearance of its first
    /// contact. It slows down for the goal.
    fn roll_out(
        &self,
        truth: &Truth,
        twist: Twist2,
        kept: f64,
        limits: &Limits,
        discs: &[Vec<Disc>],
    ) -> Result<(Vec<Pose2>, f64), (usize, f64)> {
        let drive = &self.model.drive;
        let wanted = drive.bounded(drive.wheels(twist));
        let speed = drive.twist(wanted).v.abs();
        let (mut pose, mut wheels) = (truth.map_from_base, drive.wheels(truth.twist));
        let mut poses = Vec::with_capacity(discs.len());
        let mut least = f64::INFINITY;
        for (step, discs) in discs.iter().enumerate() {
            let share = if STEP * step as f64 >= kept {
                0.0
            } else if speed > 0.0 {
                (stopping_speed(drive, (pose.position() - self.goal).norm()) / speed).min(1.0)
            } else {
                1.0
            };
            let next = [0, 1].map(|side| after_step(drive, wheels[side], share * wanted[side]));
            let mean = [0, 1].map(|side| 0.5 * (wheels[side] + next[side]));
            pose = pose.advance(drive.twist(mean), STEP);
            wheels = next;
            if !self.is_off_walls(pose, limits.walls) {
                // A wall does not make way.
                return Err((step, -FAR));
            }
            for (disc, (now, limit)) in discs.iter().zip(&limits.discs) {
                let mut clearance = self.clearance(pose, disc);
                if step == 0 {
                    // Somebody who leaves during this step is still here at its beginning.
                    clearance = clearance.min(self.clearance(pose, now));
                }
                if clearance < *limit {
                    return Err((step, clearance));
                }
                least = least.min(clearance);
            }
            poses.push(pose);
        }
        Ok((poses, least))
    }

    /// Whether the footprint is farther than a distance from all static obstacles, m.
    fn is_off_walls(&self, pose: Pose2, distance: f64) -> bool {
        self.field.clearance(pose.position()) - self.reach > distance + ROUGH
            || self.world.clearance(&self.model.footprint, pose) > distance
    }

    /// Distance between the footprint and a disc, m; far away that of the disc around the outline.
    fn clearance(&self, pose: Pose2, (at, radius): &Disc) -> f64 {
        let around = (at - pose.position()).norm() - self.reach - radius;
        if around > FAR {
            around
        } else {
            self.model.footprint.distance(pose.inverse().transform_point(*at)) - radius
        }
    }
}

/// Values within reach of the present one and within a largest one, closer together near the present one.
fn samples(now: f64, reach: [f64; 2], most: f64, count: u32) -> Vec<f64> {
    let [now, low, high] = [now, reach[0], reach[1]].map(|value| value.clamp(-most, most));
    let sample = |index: u32| {
        let share = 2.0 * f64::from(index) / f64::from(count - 1) - 1.0;
        now + share * share * if share < 0.0 { low - now } else { high - now }
    };
    (0..count).map(sample).collect()
}

/// Speed of a wheel that is to turn at another speed, after a step, rad/s.
fn after_step(drive: &Drive, now: f64, wanted: f64) -> f64 {
    let slower = wanted * now < 0.0 || wanted.abs() < now.abs();
    let most = STEP
        * if slower {
            drive.wheel_braking()
        } else {
            drive.max_wheel_acceleration
        };
    now + (wanted - now).clamp(-most, most)
}

/// Speed from which a robot comes to rest within a distance (m), m/s.
pub(crate) fn stopping_speed(drive: &Drive, distance: f64) -> f64 {
    let rate = drive.acceleration();
    rate * ((LATE * LATE + 2.0 * distance / rate).sqrt() - LATE).max(0.0)
}

/// How far a pose faces away from a direction, rad; less over the last metres.
fn facing_away(pose: &Pose2, direction: Vector2<f64>, left: f64) -> f64 {
    wrap_angle(direction.y.atan2(direction.x) - pose.yaw).abs() * (left / FACING.1).min(1.0)
}

/// Driving to the goal: the mean cost to go of a rollout.
pub(crate) fn approach(poses: &[Pose2], to_go: &CostToGo) -> Off {
    let sum: f64 = poses.iter().map(|pose| to_go.at(pose.position())).sum();
    let facing = poses.last().map_or(0.0, |last| {
        let at = last.position();
        facing_away(last, to_go.way(at), to_go.at(at))
    });
    Off {
        metres: sum / poses.len().max(1) as f64,
        facing,
    }
}

/// Following positions at given times (s): the mean distance of a rollout from them.
pub(crate) fn follow(poses: &[Pose2], reference: impl Fn(f64) -> Point2<f64>) -> Off {
    let off = |(step, pose): (usize, &Pose2)| reference(STEP * (step + 1) as f64) - pose.position();
    let sum: f64 = poses.iter().enumerate().map(|each| off(each).norm()).sum();
    let last = poses.iter().enumerate().next_back();
    Off {
        metres: sum / poses.len().max(1) as f64,
        facing: last.map_or(0.0, |each| facing_away(each.1, off(each), off(each).norm())),
    }
}

/// Getting away from a place, in any direction, as in a recovery.
pub(crate) fn escape(poses: &[Pose2], from: Point2<f64>) -> Off {
    Off {
        metres: poses.last().map_or(0.0, |last| -(last.position() - from).norm()),
        facing: 0.0,
    }
}
