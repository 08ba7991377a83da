//! Localised. Does the robot know where it is in the map, and what does it do when it does not?
//!
//! Scans are compared with the map off board. While they contradict it, or match several places, no plan made in the map may move the
//! robot: it brakes, drops its plan, accepts no other, and does not return home. Teleop and maneuvers need no map and continue. A robot
//! found anew somewhere else also drops its plan and its trail home: they were made for another place.

use std::mem::discriminant;

use zenav_protocol::messages::{Correction, EventKind, Localisation};
use zenav_protocol::time::Stamp;

use super::Pilot;

impl Pilot {
    /// Takes the localisation reports that came since the last tick.
    pub(super) fn receive_health(&mut self, now: Stamp, said: Vec<Localisation>, corrections: &[Correction]) {
        let boot_id = self.events.boot_id();
        let newest = said.into_iter().rfind(|said| said.boot_id == boot_id);
        let is_elsewhere = self.is_elsewhere(corrections);
        if let Some(Localisation { health, .. }) = newest {
            let both_trusted = health.is_trusted() && self.health.is_trusted();
            if discriminant(&health) != discriminant(&self.health) && !both_trusted {
                self.events
                    .record(now, EventKind::Localisation { health: health.clone() });
            }
            self.health = health;
        }
        if !self.health.is_trusted() {
            self.discard_plan(now, "it is not known where the robot is");
        } else if is_elsewhere {
            self.discard_plan(now, "the robot was found somewhere else");
        }
        if is_elsewhere {
            self.return_home.forget();
        }
    }

    /// Whether a tick's corrections say that the robot is somewhere else than it believed: one that found it anew, even too late to be used,
    /// or the last of several that contradicted its estimate.
    pub(super) fn is_elsewhere(&self, corrections: &[Correction]) -> bool {
        self.estimator.was_replaced() || corrections.iter().any(|correction| correction.is_found_anew)
    }
}
