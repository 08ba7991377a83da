//! Last word. How long has a copy heard nothing of the leader, and how old is its map?

use std::time::{Duration, Instant};

/// A copy that has heard no leader for this time says what it waits for: with a robot it would have taken over.
const UNLED: Duration = Duration::from_secs(15);

/// When a copy last heard of the leader.
pub(super) struct LastWord {
    heard: Instant,
    /// When it last held everything that it had heard of the leader's map.
    held: Instant,
    /// Whether it was said that nobody leads.
    is_told: bool,
}

impl LastWord {
    /// A copy that begins to follow has heard nothing yet.
    pub(super) fn new(now: Instant) -> Self {
        Self {
            heard: now,
            held: now,
            is_told: false,
        }
    }

    /// The leader was heard; `is_behind`: it has more than this copy holds.
    pub(super) fn heard(&mut self, now: Instant, is_behind: bool) {
        (self.heard, self.is_told) = (now, false);
        if !is_behind {
            self.held = now;
        }
    }

    /// Age of the copy: the time since it last held everything that it had heard of the leader's map.
    pub(super) fn age(&self, now: Instant) -> Duration {
        now.saturating_duration_since(self.held)
    }

    /// Whether it is to be said that nobody leads, once for each silence.
    pub(super) fn is_newly_overdue(&mut self, now: Instant) -> bool {
        let is_new = !self.is_told && now.saturating_duration_since(self.heard) >= UNLED;
        self.is_told |= is_new;
        is_new
    }
}
