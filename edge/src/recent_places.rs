//! Recent places. Where was something last seen, and when? A bounded list of places some distance apart; the oldest is dropped first.

use std::collections::VecDeque;

use nalgebra::{Point2, Vector2};
use zenav_protocol::time::Stamp;

/// Where something was, and when.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecentPlace {
    /// In the odometry frame.
    pub place: Point2<f64>,
    /// When it was there last.
    pub stamp: Stamp,
    /// How fast it moves at most, m/s.
    pub speed: f64,
    /// Whether it was so near that it may touch the robot at once.
    pub is_near: bool,
    /// Radius of the disc that it is at least, m.
    pub radius: f64,
    /// Whose it is.
    pub of: u64,
}

impl RecentPlace {
    /// Whether another place (odometry frame) is within a distance, m.
    #[must_use]
    pub fn is_within(&self, distance: f64, place: Point2<f64>) -> bool {
        (self.place - place).norm_squared() <= distance * distance
    }
}

/// A bounded list of recent places.
#[derive(Clone, Debug)]
pub struct RecentPlaces {
    places: VecDeque<RecentPlace>,
    most: usize,
    /// Least distance between two places, m.
    spacing: f64,
}

impl RecentPlaces {
    /// Empty, for at most `most` places at least `spacing` m apart.
    #[must_use]
    pub fn new(most: usize, spacing: f64) -> Self {
        Self {
            places: VecDeque::new(),
            most,
            spacing,
        }
    }

    /// Something is at a place now; the newest of neighbouring places of the same one counts.
    pub fn note(&mut self, seen: RecentPlace) {
        let spacing = self.spacing;
        if let Some(known) = self
            .places
            .iter_mut()
            .find(|known| known.of == seen.of && known.is_within(spacing, seen.place))
        {
            let is_near = known.is_near || seen.is_near;
            *known = RecentPlace { is_near, ..seen };
            return;
        }
        if self.places.len() == self.most {
            let oldest = (0..self.places.len()).min_by_key(|nth| self.places[*nth].stamp);
            oldest.and_then(|nth| self.places.remove(nth));
        }
        self.places.push_back(seen);
    }

    /// Keeps the places that `keeps` is true for.
    pub fn retain(&mut self, keeps: impl FnMut(&RecentPlace) -> bool) {
        self.places.retain(keeps);
    }

    /// All places.
    pub fn iter(&self) -> impl Iterator<Item = &RecentPlace> + '_ {
        self.places.iter()
    }

    /// Whether any is within a distance (m) of a place (odometry frame).
    #[must_use]
    pub fn any_within(&self, distance: f64, place: Point2<f64>) -> bool {
        self.places.iter().any(|known| known.is_within(distance, place))
    }

    /// Lower-left and upper-right corner of the box around all places, grown by a distance, m.
    #[must_use]
    pub fn bounds(&self, distance: f64) -> (Point2<f64>, Point2<f64>) {
        let nowhere = (Point2::from([f64::INFINITY; 2]), Point2::from([f64::NEG_INFINITY; 2]));
        let (low, high) = self.places.iter().fold(nowhere, |(low, high), known| {
            (low.inf(&known.place), high.sup(&known.place))
        });
        let wide = Vector2::new(distance, distance);
        (low - wide, high + wide)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, secs: f64) -> RecentPlace {
        RecentPlace {
            place: Point2::new(x, 0.0),
            stamp: Stamp::from_secs(secs),
            speed: 1.0,
            is_near: true,
            radius: 0.0,
            of: 0,
        }
    }

    #[test]
    fn the_newest_of_neighbours_is_kept_and_the_first_of_too_many_is_not() {
        let mut places = RecentPlaces::new(2, 0.1);
        for (x, secs) in [(0.0, 1.0), (0.05, 2.0), (1.0, 3.0)] {
            places.note(at(x, secs));
        }
        assert_eq!(places.iter().count(), 2);
        assert!(places.iter().all(|known| known.stamp >= Stamp::from_secs(2.0)));
        assert!(places.any_within(0.2, Point2::new(1.1, 0.1)));
        assert!(!places.any_within(0.2, Point2::new(0.5, 0.0)));
        assert_eq!(places.bounds(0.2).1, Point2::new(1.2, 0.2));
        places.note(at(2.0, 4.0));
        assert!(!places.any_within(0.2, Point2::new(0.0, 0.0)));
        // What was near once stays near.
        places.note(RecentPlace {
            is_near: false,
            ..at(2.0, 5.0)
        });
        assert!(places.iter().all(|known| known.is_near));
    }
}
