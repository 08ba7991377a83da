//! What happened on the robot, in order? Events, numbered within one boot.

use zenav_protocol::messages::{Event, EventKind};
use zenav_protocol::time::Stamp;

/// Collects the events of a tick.
#[derive(Clone, Debug)]
pub struct EventLog {
    boot_id: String,
    sequence: u64,
    pending: Vec<Event>,
}

impl EventLog {
    /// The first event will be number one.
    #[must_use]
    pub fn new(boot_id: String) -> Self {
        Self {
            boot_id,
            sequence: 0,
            pending: Vec::new(),
        }
    }

    /// Notes what happened.
    pub fn tell(&mut self, now: Stamp, kind: EventKind) {
        self.sequence += 1;
        self.pending.push(Event {
            stamp: now,
            boot_id: self.boot_id.clone(),
            sequence: self.sequence,
            kind,
        });
    }

    /// This boot.
    #[must_use]
    pub fn boot_id(&self) -> &str {
        &self.boot_id
    }

    /// What happened since the last call.
    pub fn take(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.pending)
    }
}
