//! How does a robot that has lost everybody come back to where it started? The way that it came, backwards: it had room there.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::robot::RobotModel;

use crate::trackers::{Tracker, TrackerInput, through_waypoints};

/// Spacing of the places kept of the way, m; a way that comes as near to itself has gone round, and the round is forgotten.
const SPACING: f64 = 0.2;
/// Places kept at most: of a longer way every other one is forgotten.
const MOST: usize = 4096;

/// The way back.
#[derive(Clone, Debug)]
pub struct ReturnHome {
    /// Where the robot was, from its start on, map frame.
    trail: Vec<Point2<f64>>,
    spacing: f64,
    /// Follows it back.
    tracker: Option<Box<dyn Tracker>>,
}

impl Default for ReturnHome {
    fn default() -> Self {
        Self {
            trail: Vec::new(),
            spacing: SPACING,
            tracker: None,
        }
    }
}

impl ReturnHome {
    /// Keeps where the robot is on its way out, and ends a way back.
    pub fn note(&mut self, place: Point2<f64>) {
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

    /// The wanted twist on the way back.
    pub fn step(&mut self, view: &TrackerInput, model: &RobotModel) -> Twist2 {
        if self.trail.len() < 2 {
            return Twist2::ZERO;
        }
        let back = || {
            let kind = model.controller.tracker;
            let way = self.trail.iter().rev().copied().collect();
            through_waypoints(kind, &model.drive, view.map_from_base, way)
        };
        let tracker = self.tracker.get_or_insert_with(back);
        tracker.step(view, &model.controller)
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
    fn rounds_are_forgotten_and_a_long_way_is_thinned() {
        let mut homing = ReturnHome::default();
        for step in 0..100 {
            homing.note(Point2::new(0.05 * f64::from(step), 0.0));
        }
        assert!((20..=25).contains(&homing.trail.len()), "{:?}", homing.trail);
        for step in 0..100 {
            let angle = 0.0628 * f64::from(step);
            homing.note(Point2::new(4.95, 1.0) + nalgebra::Vector2::new(angle.sin(), -angle.cos()));
        }
        assert!(homing.trail.len() <= 30, "{:?}", homing.trail);
        for step in 0..4_200 {
            homing.note(Point2::new(0.0, 1.0 + 0.3 * f64::from(step)));
        }
        assert!(homing.trail.len() <= MOST && homing.trail[0] == Point2::origin());
    }
}
