//! Trajectory tracker. Which twist follows a time-stamped trajectory? Feed-forward plus feedback on the pose error, after
//! Kanayama, Kimura, Miyazaki, Noguchi, "A stable tracking control method for an autonomous mobile robot", ICRA 1990,
//! with the cross-track term of Samson and Ait-Abderrahim (`v * sin(e)/e * error`).
//!
//! Plan time advances with progress: its rate falls below one when the robot lags behind, must brake for the plan's expiry, or still speeds
//! up from rest. Lost time is never caught up.

use nalgebra::Point2;
use zenav_protocol::gains::TimeLawGains;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::robot::{ControllerGains, Drive};
use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};

use super::{AT_REST, Progress, Tracker, TrackerInput, capped};
use crate::passive_safety::GENTLE;

/// A robot that left the trajectory comes back to it this far ahead at most, m.
const REJOIN_WINDOW: f64 = 1.5;

/// Follows a trajectory.
#[derive(Clone, Debug)]
pub struct TrajectoryTracker {
    drive: Drive,
    trajectory: Trajectory,
    time: f64,
    settling: f64,
    finished: bool,
    off: f64,
}

impl TrajectoryTracker {
    /// From plan time `time` on.
    #[must_use]
    pub fn new(drive: &Drive, trajectory: Trajectory, time: f64) -> Self {
        let time = time.clamp(
            trajectory.start_time(),
            trajectory.end_time().max(trajectory.start_time()),
        );
        Self {
            drive: drive.clone(),
            trajectory,
            time,
            settling: 0.0,
            finished: false,
            off: 0.0,
        }
    }

    /// Where the robot should be now.
    #[must_use]
    pub fn reference(&self) -> TrajectoryPoint {
        self.trajectory.sample(self.time)
    }

    /// Plan time by which the robot has rolled ahead, as after a hard stop: the reference moves up to it, so that the robot never drives
    /// back.
    fn run_ahead(&self, view: &TrackerInput, goal: &TrajectoryPoint, error: &Pose2, law: &TimeLawGains) -> f64 {
        let lead = -goal.v.signum() * error.x - law.lead;
        if lead > 0.0 && goal.v.abs() > 0.05 {
            (lead / goal.v.abs()).min(4.0 * view.dt)
        } else {
            0.0
        }
    }

    /// How fast plan time runs, 0 to 1.
    fn rate(&self, view: &TrackerInput, goal: &TrajectoryPoint, error: &Pose2, law: &TimeLawGains) -> f64 {
        let falling = |value: f64, (full, none): (f64, f64)| ((none - value) / (none - full)).clamp(0.0, 1.0);
        let direction = if goal.v < 0.0 { -1.0 } else { 1.0 };
        let turn_lag = if goal.v.abs() < 0.05 {
            error.yaw * goal.w.signum()
        } else {
            error.yaw.abs()
        };
        let lagging = falling(direction * error.x, (law.lag, law.lag_stop))
            .min(falling(error.y.abs(), (law.cross, law.cross_stop)))
            .min(falling(turn_lag, (law.turn, law.turn_stop)));
        let planned = self.drive.surface_speed(goal.twist());
        if planned < 1e-6 {
            return lagging;
        }
        // From rest, or after a slowdown, the reference speeds up only as fast as the robot can.
        let reachable = self.drive.surface_speed(view.velocity)
            + self.drive.acceleration() * (self.drive.motor_lag + 4.0 * view.dt)
            + 0.02;
        lagging.min(view.speed_cap / planned).min(reachable / planned)
    }

    /// At the end: closes the remaining error along the path and in heading; a differential drive cannot close a sideways error.
    fn settle(&mut self, view: &TrackerInput, error: &Pose2, gains: &ControllerGains) -> Twist2 {
        let law = &gains.time_law;
        self.settling += view.dt;
        let near = error.x.abs() < law.settle_distance && error.yaw.abs() < law.settle_angle;
        let at_rest = self.drive.surface_speed(view.velocity) < AT_REST;
        if near || self.settling > law.settle_secs {
            self.finished = at_rest;
            return Twist2::ZERO;
        }
        let wanted = Twist2::new(
            onwards((gains.along_gain * error.x).min(law.settle_speed), 0.0),
            gains.spin_gain * error.yaw,
        );
        capped(&self.drive, wanted, view.speed_cap)
    }
}

impl Tracker for TrajectoryTracker {
    fn step(&mut self, view: &TrackerInput, gains: &ControllerGains) -> Twist2 {
        let goal = self.trajectory.sample(self.time);
        let error = view.map_from_base.inverse() * goal.pose();
        self.off = error.x.hypot(error.y);
        if self.finished {
            return Twist2::ZERO;
        }
        let ended = self.time >= self.trajectory.end_time();
        if ended {
            return self.settle(view, &error, gains);
        }
        let law = &gains.time_law;
        let rate = self.rate(view, &goal, &error, law);
        self.time =
            (self.time + rate * view.dt + self.run_ahead(view, &goal, &error, law)).min(self.trajectory.end_time());

        // The motors lag: command the speed of the moment at which they will reach it.
        let ahead = self.trajectory.sample(self.time + self.drive.motor_lag * rate);
        let (v, w) = (rate * ahead.v, rate * ahead.w);
        let sinc = if error.yaw.abs() < 1e-3 {
            1.0
        } else {
            error.yaw.sin() / error.yaw
        };
        let spin = (gains.yaw_gain * v.abs()).max(gains.spin_gain);
        let wanted = Twist2::new(
            onwards(v * error.yaw.cos() + gains.along_gain * error.x, goal.v),
            w + gains.cross_gain * v * sinc * error.y + spin * error.yaw,
        );
        capped(&self.drive, wanted, view.speed_cap)
    }

    fn progress(&self, _: &Pose2) -> Progress {
        let end = self.trajectory.end_time();
        Progress {
            time: self.time,
            waypoint: 0,
            distance_left: self.trajectory.length_left(self.time),
            time_left: (end - self.time).max(0.0),
            finished: self.finished,
        }
    }

    fn target(&self) -> Option<(&'static str, Point2<f64>)> {
        Some(("reference", self.reference().pose().position()))
    }

    fn followed(&self) -> Option<(&Trajectory, f64)> {
        Some((&self.trajectory, self.time))
    }

    fn rejoin(&mut self, map_from_base: &Pose2) {
        let nearest = self
            .trajectory
            .nearest_ahead(self.time, map_from_base.position(), REJOIN_WINDOW);
        self.time = self.time.max(nearest.t);
        self.off = nearest.distance;
    }

    fn off_track(&self) -> f64 {
        self.off
    }

    fn moved(&mut self, new_from_old: Pose2) {
        self.trajectory = self.trajectory.moved(new_from_old);
    }

    fn boxed(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }
}

/// A robot that drives forwards does not back up by a few centimetres: its lidar may not see behind it.
fn onwards(speed: f64, planned: f64) -> f64 {
    if planned < 0.0 { speed } else { speed.max(-GENTLE) }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::limiter::{Braking, Limiter};
    use zenav_protocol::geometry::wrap_angle;
    use zenav_protocol::robot::RobotModel;

    fn model() -> RobotModel {
        zenav_fixtures::robot("tiago")
    }

    /// Rest, 0.5 m/s on a circle of 1 m radius, rest; 20 ms apart.
    fn curve() -> Trajectory {
        let mut points = Vec::new();
        let mut pose = Pose2::IDENTITY;
        for i in 0..=400 {
            let t = f64::from(i) * 0.02;
            let v = (0.5 * t).min(0.5).min(0.5 * (8.0 - t)).max(0.0);
            points.push(TrajectoryPoint {
                t,
                x: pose.x,
                y: pose.y,
                yaw: pose.yaw,
                v,
                w: v,
            });
            pose = pose.advance(Twist2::new(v, v), 0.02);
        }
        Trajectory::new(points)
    }

    /// Drives with a body that is perfect except for motor lag; returns the largest distance off the track and the last pose.
    fn drive(tracker: &mut dyn Tracker, mut pose: Pose2, ticks: usize, cap: impl Fn(usize) -> f64) -> (f64, Pose2) {
        let model = model();
        let mut limiter = Limiter::new(&model.drive);
        let mut velocity = Twist2::ZERO;
        let mut worst: f64 = 0.0;
        for tick in 0..ticks {
            let view = TrackerInput {
                dt: 0.02,
                map_from_base: pose,
                velocity,
                speed_cap: cap(tick),
            };
            let wheels = limiter.limit(tracker.step(&view, &model.controller), 0.02, Braking::Normal);
            limiter.set(wheels, 0.02);
            let (wanted, share) = (limiter.twist(), 0.02 / (model.drive.motor_lag + 0.02));
            velocity = Twist2::new(
                velocity.v + share * (wanted.v - velocity.v),
                velocity.w + share * (wanted.w - velocity.w),
            );
            pose = pose.advance(velocity, 0.02);
            worst = worst.max(tracker.off_track());
        }
        (worst, pose)
    }

    #[test]
    fn a_curve_is_followed_to_within_two_centimetres_and_ended_at_rest() {
        let trajectory = curve();
        let end = trajectory.sample(8.0).pose();
        let mut tracker = TrajectoryTracker::new(&model().drive, trajectory, 0.0);
        let (worst, pose) = drive(&mut tracker, Pose2::IDENTITY, 600, |_| f64::INFINITY);
        assert!(worst < 0.02, "{worst}");
        assert!(
            tracker.progress(&pose).finished
                && pose.distance(&end) < 0.02
                && wrap_angle(pose.yaw - end.yaw).abs() < 0.04,
            "{pose:?} {end:?}"
        );
    }

    #[test]
    fn a_curve_is_followed_backwards_as_it_is_forwards_by_whatever_law_the_robot_has() {
        let trajectory = curve().turned();
        let end = trajectory.sample(8.0).pose();
        for law in super::super::LAWS {
            let mut tracker = law.along_trajectory(&model().drive, trajectory.clone(), 0.0, &[]);
            let start = Pose2::new(0.03, 0.02, std::f64::consts::PI - 0.05);
            let (worst, pose) = drive(&mut *tracker, start, 700, |_| f64::INFINITY);
            assert!(worst < 0.05, "{}: {worst}", law.name);
            assert!(
                tracker.progress(&pose).finished && pose.distance(&end) < 0.03,
                "{}: {pose:?} {end:?}",
                law.name
            );
        }
    }

    #[test]
    fn an_offset_at_the_start_is_closed() {
        let mut tracker = TrajectoryTracker::new(&model().drive, curve(), 0.0);
        let (_, pose) = drive(&mut tracker, Pose2::new(-0.05, 0.1, 0.2), 700, |_| f64::INFINITY);
        assert!(pose.distance(&curve().sample(8.0).pose()) < 0.03, "{pose:?}");
    }

    #[test]
    fn after_a_halt_on_the_way_nothing_is_caught_up() {
        let mut tracker = TrajectoryTracker::new(&model().drive, curve(), 0.0);
        let halt = |tick: usize| if (150..300).contains(&tick) { 0.0 } else { f64::INFINITY };
        let (worst, pose) = drive(&mut tracker, Pose2::IDENTITY, 800, halt);
        // The robot rolls out ahead of the reference, which then moves up to it.
        assert!(worst < 0.22, "{worst}");
        assert!(tracker.progress(&pose).finished && pose.distance(&curve().sample(8.0).pose()) < 0.02);
    }

    #[test]
    fn a_turn_on_the_spot_is_followed() {
        let points = (0..=200).map(|i| {
            let t = f64::from(i) * 0.01;
            let w = (2.0 * t).min(1.0).min(2.0 * (2.0 - t)).max(0.0);
            (t, w)
        });
        let mut yaw = 0.0;
        let points = points
            .map(|(t, w)| {
                yaw += 0.01 * w;
                TrajectoryPoint {
                    t,
                    yaw,
                    w,
                    ..Default::default()
                }
            })
            .collect();
        let trajectory = Trajectory::new(points);
        let end = trajectory.sample(2.0).yaw;
        let mut tracker = TrajectoryTracker::new(&model().drive, trajectory, 0.0);
        let (_, pose) = drive(&mut tracker, Pose2::IDENTITY, 300, |_| f64::INFINITY);
        assert!(
            tracker.progress(&pose).finished && (pose.yaw - end).abs() < 0.03 && pose.x.hypot(pose.y) < 0.01,
            "{pose:?} {end}"
        );
    }
}
