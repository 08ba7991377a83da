//! Doubt. Is the robot where the map says? If its scans say no: is it elsewhere, or has the world changed?
//!
//! A scan that fits badly is a new sight, a changed one, or one of another place. New sights go on, so a node waits for some of them in a row.
//! A scan whose beams go through known walls contradicts the map, and becomes no node: it would confirm the next one. After some of these
//! the robot is lost, until a scan fits, or somebody says that the world has changed.

use serde::{Deserialize, Serialize};

/// Scans that contradict the map, and none between them that fits, before the robot is lost.
const LOST: u32 = 5;
/// Scans in a row that fit badly, before one becomes a node all the same.
const POOR: u32 = 5;
/// A scan of fewer points says nothing.
const LEAST_POINTS: usize = 40;

/// What the last scans say of the robot's place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Doubt {
    /// Scans that contradict the map since one fitted.
    contradictions: u32,
    /// Scans in a row that fit badly.
    poor: u32,
    /// Whether the world has changed: nothing contradicts the map until a scan fits well.
    accepts: bool,
}

impl Doubt {
    pub(crate) fn is_lost(&self) -> bool {
        self.contradictions >= LOST
    }

    /// Whether nothing contradicts the map, for the world has changed.
    pub(crate) fn accepts(&self) -> bool {
        self.accepts
    }

    /// Whether a scan of so many points is evidence against the map where its beams go through walls.
    pub(crate) fn heeds(&self, points: usize) -> bool {
        points >= LEAST_POINTS && !self.accepts
    }

    /// Whether a node of a scan that fits badly has to wait.
    pub(crate) fn waits(&self, points: usize) -> bool {
        self.heeds(points) && self.poor < POOR
    }

    /// A scan of so many points was matched, well or badly.
    pub(crate) fn match_well(&mut self, is_well: bool, points: usize) {
        if is_well {
            (self.poor, self.accepts) = (0, false);
        } else if points >= LEAST_POINTS {
            self.poor = self.poor.saturating_add(1);
        }
    }

    /// A scan fits the map, or contradicts it, or neither.
    pub(crate) fn take(&mut self, fits: bool, contradicts: bool) {
        if fits {
            self.contradictions = 0;
        } else if contradicts {
            self.contradictions = self.contradictions.saturating_add(1);
        }
    }

    /// The robot is where it is held to be: the world has changed.
    pub(crate) fn accept(&mut self) {
        (self.contradictions, self.accepts) = (0, true);
    }

    /// Nobody knows where the robot is.
    pub(crate) fn lose(&mut self) {
        (self.contradictions, self.accepts) = (LOST, false);
    }
}
