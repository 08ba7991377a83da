//! Return to home. How does a robot whose link is lost get back to where it started? Back along its recorded trail, where it had room.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::robot::{ControllerGains, RobotModel};

use crate::settings::ReturnHomeSettings;
use crate::trackers::{Law, Tracker, TrackerInput};

/// Most places recorded: a longer trail keeps every other place.
const MOST: usize = 4096;

/// The recorded trail, and the tracker that follows it back.
#[derive(Clone, Debug)]
pub struct ReturnHome {
    /// Places of the robot since its start, map frame.
    trail: Vec<Point2<f64>>,
    spacing: f64,
    /// Follows the trail back.
    tracker: Option<Box<dyn Tracker>>,
}

impl ReturnHome {
    /// No trail yet.
    #[must_use]
    pub fn new(settings: &ReturnHomeSettings) -> Self {
        Self {
            trail: Vec::new(),
            spacing: settings.spacing,
            tracker: None,
        }
    }

    /// Records the robot's position while another source moves it; ends a return.
    pub fn record(&mut self, place: Point2<f64>) {
        self.tracker = None;
        let near = |known: &Point2<f64>| (known - place).norm() < self.spacing;
        if let Some(known) = self.trail.iter().position(near) {
            self.trail.truncate(known + 1);
            return;
        }
        if self.trail.len() == MOST {
            let mut kept = 0..;
            self.trail
                .retain(|_| kept.next().is_some_and(|nth: usize| nth.is_multiple_of(2)));
            self.spacing *= 2.0;
        }
        self.trail.push(place);
    }

    /// Forgets the trail: it was recorded under a wrong pose estimate.
    pub fn forget(&mut self) {
        self.trail.clear();
        self.tracker = None;
    }

    /// Carries the trail over to another map frame.
    pub fn moved(&mut self, new_from_old: Pose2) {
        for place in &mut self.trail {
            *place = new_from_old.transform_point(*place);
        }
        if let Some(tracker) = &mut self.tracker {
            tracker.moved(new_from_old);
        }
    }

    /// The wanted twist of the return.
    pub fn step(&mut self, view: &TrackerInput, model: &RobotModel, gains: &ControllerGains) -> Twist2 {
        if self.trail.len() < 2 {
            return Twist2::ZERO;
        }
        let back = || {
            let path = self.trail.iter().rev().copied().collect();
            Law::of(&model.controller).through_waypoints(&model.drive, view.map_from_base, path)
        };
        let tracker = self.tracker.get_or_insert_with(back);
        tracker.step(view, gains)
    }

    /// Whether the robot is where it started.
    #[must_use]
    pub fn is_home(&self, map_from_base: &Pose2) -> bool {
        self.trail.len() < 2
            || self
                .tracker
                .as_ref()
                .is_some_and(|tracker| tracker.progress(map_from_base).finished)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loops_are_cut_off_and_a_long_trail_is_thinned() {
        let mut return_home = ReturnHome::new(&ReturnHomeSettings::default());
        for step in 0..100 {
            return_home.record(Point2::new(0.05 * f64::from(step), 0.0));
        }
        assert!((20..=25).contains(&return_home.trail.len()), "{:?}", return_home.trail);
        for step in 0..100 {
            let angle = 0.0628 * f64::from(step);
            return_home.record(Point2::new(4.95, 1.0) + nalgebra::Vector2::new(angle.sin(), -angle.cos()));
        }
        assert!(return_home.trail.len() <= 30, "{:?}", return_home.trail);
        for step in 0..4_200 {
            return_home.record(Point2::new(0.0, 1.0 + 0.3 * f64::from(step)));
        }
        assert!(return_home.trail.len() <= MOST && return_home.trail[0] == Point2::origin());
    }
}
