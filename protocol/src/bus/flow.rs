//! Flow. How much traffic does a topic carry, and how much is lost? Counters of one component's side of a topic, for the metrics.

use zenav_observability::metrics::{
    BUS_DISCARDED, BUS_PUBLISHED, BUS_PUBLISHED_BYTES, BUS_RECEIVED, BUS_RECEIVED_BYTES, BUS_WAITING,
};
use zenav_observability::{IntCounter, IntGauge};

use super::Bus;
use crate::codec::CodecError;

/// Counters of what arrives on a topic or an ask.
#[derive(Clone, Debug)]
pub(super) struct Arrivals {
    received: IntCounter,
    bytes: IntCounter,
    dropped: IntCounter,
    too_fast: IntCounter,
    too_large: IntCounter,
    undecodable: IntCounter,
    pub(super) waiting: IntGauge,
}

impl Arrivals {
    /// Counters of a key pattern at a component.
    pub(super) fn new(bus: &Bus, pattern: &str) -> Self {
        let part = bus.kind();
        let discarded = |reason: &str| BUS_DISCARDED.with_label_values(&[part, pattern, reason]);
        Self {
            received: BUS_RECEIVED.with_label_values(&[part, pattern]),
            bytes: BUS_RECEIVED_BYTES.with_label_values(&[part, pattern]),
            dropped: discarded("dropped"),
            too_fast: discarded("rate"),
            too_large: discarded("too_large"),
            undecodable: discarded("undecodable"),
            waiting: BUS_WAITING.with_label_values(&[part, pattern]),
        }
    }

    /// Counts a received payload of this size.
    pub(super) fn received(&self, bytes: usize) {
        self.received.inc();
        self.bytes.inc_by(bytes as u64);
    }

    /// Counts a sample dropped because the reader is too slow.
    pub(super) fn dropped(&self) {
        self.dropped.inc();
    }

    /// Counts a sample dropped because it came far faster than the rate of its key.
    pub(super) fn too_fast(&self) {
        self.too_fast.inc();
    }

    /// Counts a payload that was not decoded.
    pub(super) fn refused(&self, error: &CodecError) {
        match error {
            CodecError::TooLarge { .. } => self.too_large.inc(),
            _ => self.undecodable.inc(),
        }
    }
}

/// Counters of what is published on a topic.
#[derive(Clone, Debug)]
pub(super) struct Departures {
    published: IntCounter,
    bytes: IntCounter,
    unpublished: IntCounter,
}

impl Departures {
    /// Counters of a key pattern at a component.
    pub(super) fn new(bus: &Bus, pattern: &str) -> Self {
        let part = bus.kind();
        Self {
            published: BUS_PUBLISHED.with_label_values(&[part, pattern]),
            bytes: BUS_PUBLISHED_BYTES.with_label_values(&[part, pattern]),
            unpublished: BUS_DISCARDED.with_label_values(&[part, pattern, "unpublished"]),
        }
    }

    /// Counts a published payload of this size.
    pub(super) fn published(&self, bytes: usize) {
        self.published.inc();
        self.bytes.inc_by(bytes as u64);
    }

    /// Counts a value that could not be published.
    pub(super) fn failed(&self) {
        self.unpublished.inc();
    }
}
