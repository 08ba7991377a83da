//! Where is the robot to be at which time? A trajectory's points, with the way along them.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::TrajectoryPoint;
use zenav_protocol::robot::Drive;

/// Points on a straight leg are this far apart, m.
const LEG_STEP: f64 = 0.05;

/// Trajectory points with the way along them. Time may begin below zero: what is left of the motion before a splice.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReferenceTrajectory {
    points: Vec<TrajectoryPoint>,
    lengths: Vec<f64>,
}

impl ReferenceTrajectory {
    /// From points in the order of time.
    #[must_use]
    pub fn new(points: Vec<TrajectoryPoint>) -> Self {
        let mut length = 0.0;
        let mut lengths = Vec::with_capacity(points.len());
        let mut last: Option<Pose2> = None;
        for point in &points {
            length += last.map_or(0.0, |last| last.distance(&point.pose()));
            lengths.push(length);
            last = Some(point.pose());
        }
        Self { points, lengths }
    }

    /// The part of this motion from `now` up to `until`, then `next`, whose time zero is `until` here.
    #[must_use]
    pub fn spliced(&self, now: f64, until: f64, next: &[TrajectoryPoint]) -> Self {
        let mut points = Vec::with_capacity(next.len() + 64);
        if now < until {
            let first = self.sample(now);
            let rest = self.points.iter().filter(|point| point.t > now && point.t < until);
            points.extend(std::iter::once(&first).chain(rest).map(|point| TrajectoryPoint {
                t: point.t - until,
                ..*point
            }));
        }
        points.extend_from_slice(next);
        Self::new(points)
    }

    /// The points.
    #[must_use]
    pub fn points(&self) -> &[TrajectoryPoint] {
        &self.points
    }

    /// When it begins, s.
    #[must_use]
    pub fn start(&self) -> f64 {
        self.points.first().map_or(0.0, |point| point.t)
    }

    /// When it ends, s.
    #[must_use]
    pub fn end(&self) -> f64 {
        self.points.last().map_or(0.0, |point| point.t)
    }

    /// Where the robot is to be at a time; held at both ends.
    #[must_use]
    pub fn sample(&self, t: f64) -> TrajectoryPoint {
        let after = self.points.partition_point(|point| point.t <= t);
        let (Some(from), to) = (self.points.get(after.saturating_sub(1)), self.points.get(after)) else {
            return TrajectoryPoint::default();
        };
        let Some(to) = to.filter(|_| after > 0) else {
            return TrajectoryPoint { t, ..*from };
        };
        let share = (t - from.t) / (to.t - from.t);
        let between = |a: f64, b: f64| a + share * (b - a);
        TrajectoryPoint {
            t,
            x: between(from.x, to.x),
            y: between(from.y, to.y),
            yaw: wrap_angle(from.yaw + share * wrap_angle(to.yaw - from.yaw)),
            v: between(from.v, to.v),
            w: between(from.w, to.w),
        }
    }

    /// Way from a time to the end, m.
    #[must_use]
    pub fn length_left(&self, t: f64) -> f64 {
        let after = self.points.partition_point(|point| point.t <= t);
        let Some((to, length)) = self.points.get(after).zip(self.lengths.get(after)) else {
            return 0.0;
        };
        self.lengths.last().copied().unwrap_or(0.0) - length + self.sample(t).pose().distance(&to.pose())
    }

    /// Straight legs from a robot at `map_from_base` through waypoints, at the robot's top speed throughout.
    #[must_use]
    pub fn through(drive: &Drive, map_from_base: Pose2, waypoints: &[Point2<f64>]) -> Self {
        let mut points: Vec<TrajectoryPoint> = Vec::with_capacity(waypoints.len() * 8);
        let (mut from, mut t) = (map_from_base.position(), 0.0);
        for to in waypoints {
            let leg = to - from;
            let length = leg.norm();
            if length < 1e-6 {
                continue;
            }
            let steps = (length / LEG_STEP).ceil().clamp(1.0, 100_000.0) as u32;
            let first = u32::from(!points.is_empty());
            for step in first..=steps {
                let share = f64::from(step) / f64::from(steps);
                let place = from + leg * share;
                points.push(TrajectoryPoint {
                    t: t + share * length / drive.top_speed(),
                    x: place.x,
                    y: place.y,
                    yaw: leg.y.atan2(leg.x),
                    v: drive.top_speed(),
                    w: 0.0,
                });
            }
            (from, t) = (*to, t + length / drive.top_speed());
        }
        Self::new(points)
    }

    /// Places along the way, `spacing` (m) apart, and the last; the first is left out.
    #[must_use]
    pub fn places(&self, spacing: f64) -> Vec<Point2<f64>> {
        let mut places = Vec::new();
        let mut next = spacing;
        for (point, length) in self.points.iter().zip(&self.lengths) {
            if *length >= next {
                places.push(point.pose().position());
                next = length + spacing;
            }
        }
        places.extend(self.points.last().map(|point| point.pose().position()));
        places
    }

    /// Index of the last point at or before a time.
    #[must_use]
    pub(super) fn index(&self, t: f64) -> usize {
        self.points.partition_point(|point| point.t <= t).saturating_sub(1)
    }

    /// Way from the start to each point, m.
    #[must_use]
    pub(super) fn lengths(&self) -> &[f64] {
        &self.lengths
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::robot::{RobotModel, shipped};

    fn straight() -> ReferenceTrajectory {
        let model = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
        ReferenceTrajectory::through(
            &model.drive,
            Pose2::IDENTITY,
            &[Point2::new(3.0, 0.0), Point2::new(3.0, 1.0)],
        )
    }

    #[test]
    fn a_splice_keeps_the_old_motion_until_the_new_one_begins() {
        let old = straight();
        let next: Vec<_> = old
            .points()
            .iter()
            .filter(|p| p.t >= 3.0)
            .map(|p| TrajectoryPoint { t: p.t - 3.0, ..*p })
            .collect();
        let merged = old.spliced(2.5, 3.0, &next);
        assert!((merged.start() + 0.5).abs() < 1e-12 && (merged.end() - (old.end() - 3.0)).abs() < 1e-9);
        let before = merged.sample(-0.25);
        assert!(before.pose().distance(&old.sample(2.75).pose()) < 1e-9);
        assert!(merged.points().windows(2).all(|pair| pair[0].t < pair[1].t));
    }

    #[test]
    fn the_way_through_waypoints_is_as_long_as_its_legs() {
        let timeline = straight();
        assert!((timeline.length_left(0.0) - 4.0).abs() < 1e-9);
        let places = timeline.places(0.5);
        assert!(places.len() >= 8 && *places.last().unwrap() == Point2::new(3.0, 1.0));
    }
}
