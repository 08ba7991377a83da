//! Which twist drives through a list of waypoints, turning first? The go-to-goal law of the classic exercise:
//! `w = Kw * alpha`, and `v = Kv * rho` once the bearing `alpha` is within a tenth of a radian; a waypoint nearer than 0.2 m is
//! reached.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::robot::{ControllerGains, Drive};

use super::waypoints::bearing;
use super::{Progress, Rail, Timeline, Tracker, View, capped};
use crate::limiter::{wheel_surface_speed, within_speed};

/// Bearing within which the robot drives, rad.
const ALIGNED: f64 = 0.1;
/// A waypoint nearer than this is reached, m.
const TOLERANCE: f64 = 0.2;
/// The last one is a place to be at, m.
const FINAL_TOLERANCE: f64 = 0.1;
/// At rest: wheel surface speed, m/s.
const AT_REST: f64 = 0.02;

/// Turns, then drives.
#[derive(Clone, Debug)]
pub struct HeadingFirst {
    drive: Drive,
    waypoints: Vec<Point2<f64>>,
    next: usize,
    finished: bool,
    rail: Option<Rail>,
}

impl HeadingFirst {
    /// From the first waypoint on; `rail` where the plan has a trajectory.
    #[must_use]
    pub fn new(drive: &Drive, waypoints: Vec<Point2<f64>>, rail: Option<Rail>) -> Self {
        Self {
            drive: drive.clone(),
            waypoints,
            next: 0,
            finished: false,
            rail,
        }
    }
}

impl Tracker for HeadingFirst {
    fn step(&mut self, view: &View, gains: &ControllerGains) -> Twist2 {
        if let Some(rail) = &mut self.rail {
            rail.advance(&view.map_from_base);
        }
        let here = view.map_from_base.position();
        while let Some(target) = self.waypoints.get(self.next) {
            let last = self.next + 1 == self.waypoints.len();
            if (target - here).norm() >= if last { FINAL_TOLERANCE } else { TOLERANCE } {
                break;
            }
            self.next += 1;
        }
        let Some(target) = self.waypoints.get(self.next) else {
            self.finished |= wheel_surface_speed(&self.drive, view.velocity) < AT_REST;
            return Twist2::ZERO;
        };
        let alpha = bearing(&view.map_from_base, *target);
        let ahead = if alpha.abs() > ALIGNED {
            0.0
        } else {
            (target - here).norm()
        };
        let wanted = Twist2::new(gains.go_gain * ahead, gains.turn_gain * alpha);
        capped(&self.drive, within_speed(&self.drive, wanted), view.speed_cap)
    }

    fn progress(&self, map_from_base: &Pose2) -> Progress {
        let ahead = self.waypoints.iter().skip(self.next);
        let (distance_left, _) = ahead.fold((0.0, map_from_base.position()), |(sum, from), to| {
            (sum + (to - from).norm(), *to)
        });
        Progress {
            time: self.rail.as_ref().map_or(0.0, Rail::time),
            waypoint: self.next,
            distance_left,
            time_left: distance_left / self.drive.top_speed(),
            finished: self.finished,
        }
    }

    fn target(&self) -> Option<(&'static str, Point2<f64>)> {
        self.waypoints.get(self.next).map(|place| ("waypoint", *place))
    }

    fn motion(&self) -> Option<(&Timeline, f64)> {
        self.rail.as_ref().map(Rail::motion)
    }

    fn off_track(&self) -> f64 {
        self.rail.as_ref().map_or(0.0, Rail::off_track)
    }

    fn boxed(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }
}
