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
    ///
    /// ```
    /// use zenav_edge::event_log::EventLog;
    /// use zenav_protocol::{messages::EventKind, time::Stamp};
    ///
    /// let mut events = EventLog::new("boot-1".into());
    /// events.record(Stamp::from_secs(0.02), EventKind::Started);
    /// let taken = events.take();
    /// assert_eq!((taken[0].sequence, taken[0].boot_id.as_str()), (1, "boot-1"));
    /// assert!(events.take().is_empty());
    /// ```
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
