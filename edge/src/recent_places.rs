//! Where was something last, and when? A few places, some way apart, that are forgotten one by one.

use std::collections::VecDeque;

use nalgebra::{Point2, Vector2};
use zenav_protocol::time::Stamp;

/// Places are no nearer together than this, m.
const APART: f64 = 0.1;

/// Where something was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecentPlace {
    /// Odometry frame.
    pub place: Point2<f64>,
    /// When.
    pub stamp: Stamp,
}

impl RecentPlace {
    /// Whether a place (odometry frame) is no farther off than a distance, m.
    #[must_use]
    pub fn is_within(&self, distance: f64, place: Point2<f64>) -> bool {
        (self.place - place).norm_squared() <= distance * distance
    }
}

/// Some of them.
#[derive(Clone, Debug)]
pub struct RecentPlaces {
    traces: VecDeque<RecentPlace>,
    most: usize,
}

impl RecentPlaces {
    /// None yet; of more than `most`, the first is forgotten.
    #[must_use]
    pub fn new(most: usize) -> Self {
        Self {
            traces: VecDeque::new(),
            most,
        }
    }

    /// Something was at a place (odometry frame).
    pub fn note(&mut self, place: Point2<f64>, stamp: Stamp) {
        if let Some(known) = self.traces.iter_mut().find(|trace| trace.is_within(APART, place)) {
            *known = RecentPlace { place, stamp };
            return;
        }
        if self.traces.len() == self.most {
            self.traces.pop_front();
        }
        self.traces.push_back(RecentPlace { place, stamp });
    }

    /// Keeps those for which `keeps` holds.
    pub fn retain(&mut self, keeps: impl FnMut(&RecentPlace) -> bool) {
        self.traces.retain(keeps);
    }

    /// All.
    pub fn iter(&self) -> impl Iterator<Item = &RecentPlace> + '_ {
        self.traces.iter()
    }

    /// Whether any is within a distance (m) of a place (odometry frame).
    #[must_use]
    pub fn any_within(&self, distance: f64, place: Point2<f64>) -> bool {
        self.traces.iter().any(|trace| trace.is_within(distance, place))
    }

    /// The lower-left and upper-right corners of the box of all places within a distance (m) of any.
    #[must_use]
    pub fn bounds(&self, distance: f64) -> (Point2<f64>, Point2<f64>) {
        let nowhere = (Point2::from([f64::INFINITY; 2]), Point2::from([f64::NEG_INFINITY; 2]));
        let (low, high) = self.traces.iter().fold(nowhere, |(low, high), trace| {
            (low.inf(&trace.place), high.sup(&trace.place))
        });
        let wide = Vector2::new(distance, distance);
        (low - wide, high + wide)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_of_neighbours_is_kept_and_the_first_of_too_many_is_not() {
        let mut traces = RecentPlaces::new(2);
        for (x, secs) in [(0.0, 1.0), (0.05, 2.0), (1.0, 3.0)] {
            traces.note(Point2::new(x, 0.0), Stamp::from_secs(secs));
        }
        assert_eq!(traces.iter().count(), 2);
        assert!(traces.iter().all(|trace| trace.stamp >= Stamp::from_secs(2.0)));
        assert!(traces.any_within(0.2, Point2::new(1.1, 0.1)));
        assert!(!traces.any_within(0.2, Point2::new(0.5, 0.0)));
        assert_eq!(traces.bounds(0.2).1, Point2::new(1.2, 0.2));
        traces.note(Point2::new(2.0, 0.0), Stamp::from_secs(4.0));
        assert!(!traces.any_within(0.2, Point2::new(0.0, 0.0)));
    }
}
