//! Doubt. Decides from the scans whether the robot is where the map says, elsewhere, or in a changed world.
//!
//! A badly fitting scan shows something new, something changed, or another place. New sights continue, so a node waits for several such
//! scans in a row, unless the robot goes far meanwhile. A scan whose beams go through known walls contradicts the map and becomes no node, since it would confirm the next one.
//! After several of these the robot is lost, until a scan fits or the world is declared changed. It is lost at once if it was carried: if a
//! scan shows other surroundings than the one a moment before.

use serde::{Deserialize, Serialize};

/// Scans that contradict the map, with no fitting scan between them, before the robot is lost.
const LOST: u32 = 5;
/// Badly fitting scans in a row before one becomes a node anyway.
const POOR: u32 = 5;
/// A scan with fewer points is no evidence.
const LEAST_POINTS: usize = 40;

/// Evidence of the last scans on the robot's place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Doubt {
    /// Contradicting scans since the last fitting one.
    contradictions: u32,
    /// Badly fitting scans in a row.
    poor: u32,
    /// Whether the world has changed: until a scan fits well, nothing contradicts the map.
    accepts: bool,
    /// Whether the robot was carried, and no scan has fitted since.
    #[serde(default)]
    was_carried: bool,
}

impl Doubt {
    pub(crate) fn is_lost(&self) -> bool {
        self.contradictions >= LOST
    }

    /// Whether the world has changed, so that nothing contradicts the map.
    pub(crate) fn accepts(&self) -> bool {
        self.accepts
    }

    /// Whether the robot was carried, and no scan has fitted since.
    pub(crate) fn was_carried(&self) -> bool {
        self.was_carried
    }

    /// Whether beams through walls count as evidence for a scan of this many points.
    pub(crate) fn heeds(&self, points: usize) -> bool {
        points >= LEAST_POINTS && !self.accepts
    }

    /// Whether a badly fitting scan must wait before it becomes a node.
    pub(crate) fn waits(&self, points: usize) -> bool {
        self.heeds(points) && self.poor < POOR
    }

    /// The robot has gone so far since the last node that the next scans may share nothing with the map: none waits.
    pub(crate) fn wait_no_more(&mut self) {
        self.poor = self.poor.max(POOR);
    }

    /// Takes in how well a scan of this many points was matched.
    pub(crate) fn match_well(&mut self, is_well: bool, points: usize) {
        if is_well {
            (self.poor, self.accepts) = (0, false);
        } else if points >= LEAST_POINTS {
            self.poor = self.poor.saturating_add(1);
        }
    }

    /// Takes in whether a scan fits the map, contradicts it, or neither.
    pub(crate) fn take(&mut self, fits: bool, contradicts: bool) {
        if fits {
            (self.contradictions, self.was_carried) = (0, false);
        } else if contradicts {
            self.contradictions = self.contradictions.saturating_add(1);
        }
    }

    /// Declares the robot's place right and the world changed.
    pub(crate) fn accept(&mut self) {
        (self.contradictions, self.accepts, self.was_carried) = (0, true, false);
    }

    /// Declares the robot lost.
    pub(crate) fn lose(&mut self) {
        (self.contradictions, self.accepts) = (LOST, false);
    }

    /// Declares that the robot was carried: it is lost.
    pub(crate) fn carry(&mut self) {
        self.lose();
        self.was_carried = true;
    }
}
