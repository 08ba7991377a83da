//! Path follower. How does a law without time follow a path? This file tracks the place on the path and whether the robot has arrived; the
//! law only determines how to get back to the path.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::robot::{ControllerGains, Drive};
use zenav_protocol::trajectory::Trajectory;

use super::{AT_REST, PathProjection, Progress, Tracker, TrackerInput, capped};
use crate::limiter::within_speed;

/// What a law wants.
#[derive(Clone, Copy, Debug)]
pub enum Wanted {
    /// To turn on the spot, by this angle, rad.
    Turn(f64),
    /// To drive with this twist.
    Drive(Twist2),
}

/// A law of feedback from a path.
pub trait PathLaw: Clone + std::fmt::Debug + Send + Sync + 'static {
    /// One tick, on the way.
    fn step(
        &mut self,
        projection: &PathProjection,
        drive: &Drive,
        view: &TrackerInput,
        gains: &ControllerGains,
    ) -> Wanted;

    /// The point that it drives at, map frame.
    fn target(&self, projection: &PathProjection) -> Point2<f64>;
}

/// Follows a path by a law.
#[derive(Clone, Debug)]
pub struct OnPath<L> {
    law: L,
    drive: Drive,
    projection: PathProjection,
    arrived: bool,
    finished: bool,
}

impl<L: PathLaw> OnPath<L> {
    /// Along a path.
    #[must_use]
    pub fn new(law: L, drive: &Drive, projection: PathProjection) -> Self {
        Self {
            law,
            drive: drive.clone(),
            projection,
            arrived: false,
            finished: false,
        }
    }
}

impl<L: PathLaw> Tracker for OnPath<L> {
    fn step(&mut self, view: &TrackerInput, gains: &ControllerGains) -> Twist2 {
        self.projection.advance(&view.map_from_base);
        let left = self.projection.left();
        let to_end = (self.projection.end().pose().position() - view.map_from_base.position()).norm();
        self.arrived |= left < gains.end_distance && to_end < 2.0 * gains.end_distance || left < 1e-6;
        if self.arrived {
            self.finished |= self.drive.surface_speed(view.velocity) < AT_REST;
            return Twist2::ZERO;
        }
        let wanted = match self.law.step(&self.projection, &self.drive, view, gains) {
            Wanted::Turn(by) => Twist2::new(0.0, gains.spin_gain * by),
            Wanted::Drive(twist) => twist,
        };
        capped(&self.drive, within_speed(&self.drive, wanted), view.speed_cap)
    }

    fn progress(&self, _: &Pose2) -> Progress {
        self.projection.progress(self.finished)
    }

    fn target(&self) -> Option<(&'static str, Point2<f64>)> {
        Some(("reference", self.law.target(&self.projection)))
    }

    fn followed(&self) -> Option<(&Trajectory, f64)> {
        Some(self.projection.followed())
    }

    fn rejoin(&mut self, map_from_base: &Pose2) {
        self.projection.advance(map_from_base);
    }

    fn off_track(&self) -> f64 {
        self.projection.off_track()
    }

    fn moved(&mut self, new_from_old: Pose2) {
        self.projection.moved(new_from_old);
    }

    fn boxed(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }
}
