//! What of a sweep moves? What stands where earlier sweeps saw free floor.
//!
//! No tracking and no model of what moves: a return that lies well inside the range of an earlier sweep's beams past the
//! same place is an intruder, whatever it is (visibility-based detection, after Pomerleau et al., "Long-term 3D map
//! maintenance in dynamic environments", ICRA 2014). How fast it may go is for the guard to assume.

use std::collections::VecDeque;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::LidarModel;
use zenav_protocol::time::Stamp;

use crate::surroundings::View;

/// Returns farther off than this do not matter yet, m.
const RANGE: f64 = 3.5;
/// Sweeps looked back at, and the time between two of them at least, s.
const LOOKS: (usize, f64) = (5, 0.19);
/// An intruder lies this much nearer than the earlier beams went, beyond the noise of ranges, m.
const DEPTH: f64 = 0.03;
/// The same in standard deviations of a range.
const DEPTH_SIGMAS: f64 = 4.0;
/// And for each metre of range: heading errors and the beams' spacing.
const DEPTH_PER_METRE: f64 = 0.01;
/// Earlier beams on either side that must all have gone farther.
const NEIGHBOURS: usize = 2;
/// An intruder is at least this wide, m, and so many times as wide as the beams lie apart where it is: an earlier sweep may
/// have missed what is thinner.
const WIDTH: (f64, f64) = (0.04, 2.5);

/// Returns on what moves.
#[derive(Clone, Debug)]
pub struct Intruders {
    lidar: LidarModel,
    view: View,
    looks: VecDeque<Look>,
    /// Points of the newest sweep, odometry frame.
    points: Vec<Point2<f64>>,
}

#[derive(Clone, Debug)]
struct Look {
    stamp: Stamp,
    laser_from_odom: Pose2,
    ranges: Vec<f32>,
}

impl Intruders {
    /// None yet.
    #[must_use]
    pub fn new(lidar: &LidarModel) -> Self {
        Self {
            lidar: lidar.clone(),
            view: View::new(lidar),
            looks: VecDeque::new(),
            points: Vec::new(),
        }
    }

    /// Takes a sweep with the lidar's number of beams, and the robot's odometry at its stamp.
    pub fn insert(&mut self, sweep: &Sweep, odom_from_base: Pose2) {
        let odom_from_laser = odom_from_base * self.lidar.mount;
        self.points.clear();
        let mut begun = 0;
        for (beam, range) in sweep.ranges.iter().enumerate() {
            let range = f64::from(*range);
            let valid = range >= self.lidar.range_min && range <= RANGE.min(self.lidar.range_max);
            let angle = self.lidar.angle_min() + beam as f64 * self.lidar.angle_increment();
            let point = odom_from_laser.transform_point(Point2::new(range * angle.cos(), range * angle.sin()));
            if valid && self.intrudes(point) {
                self.points.push(point);
            } else {
                self.end_run(&mut begun, odom_from_laser.position());
            }
        }
        self.end_run(&mut begun, odom_from_laser.position());
        self.look(sweep, odom_from_laser);
    }

    /// Drops a run of neighbouring returns that is too narrow to be trusted.
    fn end_run(&mut self, begun: &mut usize, laser: Point2<f64>) {
        if let [first, .., last] = self.points.get(*begun..).unwrap_or_default() {
            let least = WIDTH
                .0
                .max(WIDTH.1 * self.lidar.angle_increment() * (first - laser).norm());
            if (last - first).norm() >= least {
                *begun = self.points.len();
            }
        }
        self.points.truncate(*begun);
    }

    /// Whether an earlier look went past this place.
    fn intrudes(&self, point: Point2<f64>) -> bool {
        self.looks.iter().any(|look| {
            let local = look.laser_from_odom.transform_point(point).coords;
            if self.view.is_blind(local) {
                return false;
            }
            let distance = local.norm();
            let beam = (local.y.atan2(local.x) - self.lidar.angle_min()) / self.lidar.angle_increment();
            let beam = beam.round().max(0.0) as usize;
            let beams = beam.saturating_sub(NEIGHBOURS)..=beam + NEIGHBOURS;
            let depth = DEPTH + DEPTH_SIGMAS * self.lidar.noise + DEPTH_PER_METRE * distance;
            beams.clone().all(|beam| {
                // Written so that no return counts as far.
                look.ranges
                    .get(beam)
                    .is_none_or(|range| f64::from(*range) > distance + depth)
            }) && look.ranges.len() > *beams.start()
        })
    }

    fn look(&mut self, sweep: &Sweep, odom_from_laser: Pose2) {
        let due = self
            .looks
            .back()
            .is_none_or(|last| sweep.stamp.secs_since(last.stamp) >= LOOKS.1);
        if !due {
            return;
        }
        let mut ranges = if self.looks.len() == LOOKS.0 {
            self.looks.pop_front().map(|look| look.ranges).unwrap_or_default()
        } else {
            Vec::new()
        };
        ranges.clear();
        ranges.extend_from_slice(&sweep.ranges);
        self.looks.push_back(Look {
            stamp: sweep.stamp,
            laser_from_odom: odom_from_laser.inverse(),
            ranges,
        });
    }

    /// What moves, in the base frame of a robot at `odom_from_base`.
    pub fn in_base(&self, odom_from_base: Pose2) -> impl Iterator<Item = Point2<f64>> + '_ {
        let base_from_odom = odom_from_base.inverse();
        self.points
            .iter()
            .map(move |point| base_from_odom.transform_point(*point))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::robot::{RobotModel, shipped};

    fn lidar() -> LidarModel {
        RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap().lidar
    }

    /// A wall across the way at `wall`, and a post of some beams at `post`, both in the odometry frame.
    fn sweep(lidar: &LidarModel, secs: f64, base: Pose2, post: Option<f64>) -> Sweep {
        let laser = base * lidar.mount;
        let range = |beam: usize| {
            let angle = lidar.angle_min() + beam as f64 * lidar.angle_increment();
            let wall = if angle.cos() > 0.2 {
                (3.0 - laser.x) / angle.cos()
            } else {
                f64::INFINITY
            };
            let before = post.filter(|_| angle.abs() < 0.05).map_or(wall, |at| at - laser.x);
            wall.min(before) as f32
        };
        Sweep {
            stamp: Stamp::from_secs(secs),
            ranges: (0..lidar.beams).map(range).collect(),
        }
    }

    #[test]
    fn what_comes_nearer_intrudes_and_what_stands_does_not() {
        let lidar = lidar();
        let mut still = Intruders::new(&lidar);
        let mut moving = Intruders::new(&lidar);
        for step in 0..20 {
            let secs = 0.1 * f64::from(step);
            // The robot drives and turns: what stands still stands.
            let base = Pose2::new(0.05 * f64::from(step), 0.0, 0.0);
            still.insert(&sweep(&lidar, secs, base, Some(2.0)), base);
            moving.insert(&sweep(&lidar, secs, base, Some(2.4 - 0.03 * f64::from(step))), base);
        }
        assert_eq!(still.in_base(Pose2::IDENTITY).count(), 0);
        assert!(moving.in_base(Pose2::IDENTITY).count() > 5);
    }
}
