//! Dynamic window. Chooses the best reachable twist, after Fox, Burgard and Thrun, "The Dynamic Window Approach to Collision Avoidance"
//! (1997): constant twists are rolled out, those with contact are dropped.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::robot::RobotModel;
use zenav_sim::Truth;

use super::Field;

/// Time between two poses of a rollout, s.
const STEP: f64 = 0.1;
/// Time in which the wheels must be able to reach a twist, s.
const REACH: f64 = 0.25;
/// Number of speeds and of yaw rates tried.
const TRIED: [u32; 2] = [9, 17];
/// Largest reverse speed, as a share of the top speed.
const BACKWARDS: f64 = 0.3;
/// Clearance of a rollout, m.
const MARGIN: f64 = 0.04;
/// Cost of proximity, and its decay length, m.
const NEAR: [f64; 2] = [0.5, 0.15];
/// The heading counts through a point so far ahead, m.
const NOSE: f64 = 0.3;

/// The dynamic window of a robot among obstacles.
pub(super) struct Window<'a> {
    model: &'a RobotModel,
    field: &'a Field,
    reach: f64,
}

impl<'a> Window<'a> {
    pub(super) fn new(model: &'a RobotModel, field: &'a Field) -> Self {
        let reach = model.footprint.circumscribed_radius();
        Self { model, field, reach }
    }

    /// The twist with the cheapest rollout; `predict` gives the discs at a time from now (s).
    pub(super) fn choose(
        &self,
        truth: &Truth,
        horizon: f64,
        predict: impl Fn(f64) -> Vec<(Point2<f64>, f64)>,
        cost: impl Fn(&[Pose2]) -> f64,
    ) -> Twist2 {
        let drive = &self.model.drive;
        let steps = (horizon / STEP).round() as u32;
        let discs: Vec<Vec<(Point2<f64>, f64)>> = (1..=steps).map(|step| predict(STEP * f64::from(step))).collect();
        let (top, turn) = (drive.top_speed(), drive.top_yaw_rate());
        let gain = drive.acceleration() * REACH;
        let spin = 2.0 * gain / drive.wheel_separation;
        // Sampled more finely around the present twist.
        let tried = |now: f64, gain: f64, low: f64, high: f64, count: u32| {
            let share = move |index| 2.0 * f64::from(index) / f64::from(count - 1) - 1.0;
            (0..count).map(move |index| (now + gain * share(index) * share(index).abs()).clamp(low, high))
        };
        // Any rollout without contact beats one with contact; of those, the latest contact wins.
        let mut best = (f64::INFINITY, Twist2::ZERO);
        for v in tried(truth.twist.v, gain, -BACKWARDS * top, top, TRIED[0]) {
            for w in tried(truth.twist.w, spin, -turn, turn, TRIED[1]) {
                let twist = Twist2::new(v, w);
                let total = match self.roll_out(truth.map_from_base, twist, &discs) {
                    Ok((poses, clearance)) => cost(&poses) + NEAR[0] * (-clearance / NEAR[1]).exp(),
                    Err(touch) => 1e6 - f64::from(touch),
                };
                if total < best.0 {
                    best = (total, twist);
                }
            }
        }
        best.1
    }

    /// The poses of a twist and its least clearance (m), or the step of its first contact.
    fn roll_out(
        &self,
        from: Pose2,
        twist: Twist2,
        discs: &[Vec<(Point2<f64>, f64)>],
    ) -> Result<(Vec<Pose2>, f64), u32> {
        let mut pose = from;
        let mut clearance = f64::INFINITY;
        let mut poses = Vec::with_capacity(discs.len());
        for (step, discs) in discs.iter().enumerate() {
            pose = pose.advance(twist, STEP);
            let base_from_map = pose.inverse();
            let to_disc = |(at, radius): &(Point2<f64>, f64)| {
                self.model.footprint.distance(base_from_map.transform_point(*at)) - radius
            };
            let standing = self.field.clearance(pose.position()) - self.reach;
            let least = discs.iter().map(to_disc).fold(standing, f64::min);
            if least < MARGIN {
                return Err(step as u32);
            }
            clearance = clearance.min(least);
            poses.push(pose);
        }
        Ok((poses, clearance))
    }
}

/// Cost of a rollout towards the goal of a field: its mean distance from the goal, m.
pub(super) fn approach(poses: &[Pose2], field: &Field) -> f64 {
    let cost = |pose: &Pose2| {
        let nose = NOSE.min((pose.position() - field.goal()).norm());
        field.to_goal(pose.position() + pose.heading() * nose)
    };
    poses.iter().map(cost).sum::<f64>() / poses.len().max(1) as f64
}

/// Cost of a rollout along positions at given times (s): its mean distance from them, m.
pub(super) fn follow(poses: &[Pose2], reference: impl Fn(f64) -> Point2<f64>) -> f64 {
    let cost = |(step, pose): (usize, &Pose2)| {
        let off = reference(STEP * (step + 1) as f64) - pose.position();
        let aside = if off.norm() > 0.1 {
            wrap_angle(off.y.atan2(off.x) - pose.yaw).abs()
        } else {
            0.0
        };
        off.norm() + NOSE * aside * off.norm().min(0.5)
    };
    poses.iter().enumerate().map(cost).sum::<f64>() / poses.len().max(1) as f64
}
