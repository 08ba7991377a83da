//! Event log. What happened on the robot, in order? Events, numbered within one boot.

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
    /// Empty; the first event gets sequence number one.
    #[must_use]
    pub fn new(boot_id: String) -> Self {
        Self {
            boot_id,
            sequence: 0,
            pending: Vec::new(),
        }
    }

    /// Records an event.
    pub fn record(&mut self, now: Stamp, kind: EventKind) {
        self.sequence += 1;
        self.pending.push(Event {
            stamp: now,
            boot_id: self.boot_id.clone(),
            sequence: self.sequence,
            kind,
        });
    }

    /// Id of this boot.
    #[must_use]
    pub fn boot_id(&self) -> &str {
        &self.boot_id
    }

    /// Takes the events since the last call.
    pub fn take(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.pending)
    }
}
