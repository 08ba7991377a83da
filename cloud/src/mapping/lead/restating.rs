//! Restating. What does the leader do when somebody else publishes on its keys?

use std::time::{Duration, Instant};

use super::Leadership;

/// Time from a foreign message on a key of this service to its own again.
const RESTATE_AFTER: Duration = Duration::from_secs(1);
/// Interval of later repetitions.
const RESTATE_EVERY: Duration = Duration::from_secs(10);

impl Leadership {
    /// Hears what stands on a key of this service; `is_other`: it is not what this service published last. The service then repeats it, no
    /// more often than once a second: two services of one robot do not flood the bus.
    pub(super) fn doubt(&mut self, is_other: bool) {
        let soon = Instant::now() + RESTATE_AFTER;
        if is_other && self.restate_at.is_none_or(|at| at > soon) {
            if self.restate_at.is_none() {
                tracing::warn!(
                    robot = self.config.robot,
                    "somebody else publishes on the keys of this robot's mapping"
                );
            }
            self.restate_at = Some(soon);
        }
    }

    /// Publishes what others may have been told otherwise, now and from time to time: a subscriber who comes later may be told both.
    pub(super) fn restate(&mut self) {
        self.restate_at = Some(Instant::now() + RESTATE_EVERY);
        self.outbox.frames.put(&self.frame);
        self.outbox.annotations.put(self.annotations.now());
        if let Some(localisation) = self.core.by_the_robot(&self.boot_id) {
            self.outbox.localisation.put(&localisation);
        }
    }
}
