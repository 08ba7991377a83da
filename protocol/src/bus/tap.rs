//! Tap. Which samples arrive on the bus, byte for byte, and when? For recorders; also publishes recorded samples again.
//!
//! Samples of plain topics are taken as they arrive. `Events` and `State` topics are subscribed to as their readers do: with the samples
//! kept for late joiners, in order, and with missing ones requested again. (One such subscription for all keys does not work: Zenoh drops a
//! sample without a sequence number if its time stamp is older than that of the last one from the same router, as happens between
//! priorities.)

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::time::Instant;

use zenoh::Wait;
use zenoh::bytes::{Encoding as WireEncoding, ZBytes};
use zenoh::key_expr::KeyExpr;
use zenoh::sample::Sample;
use zenoh_ext::{AdvancedSubscriberBuilderExt, HistoryConfig, RecoveryConfig};

use super::inbox::{Inbox, Slot, Store};
use super::publish::{self, kept};
use super::subscribe::{Carrier, HISTORY_TIMEOUT};
use super::{Bus, BusError, RawSample};
use crate::codec::Encoding;
use crate::topics::{self, Qos, TABLE};

/// Whether a key matches a key expression of Zenoh: `*` is one chunk, `**` any number, `$*` any letters of a chunk.
///
/// ```
/// use zenav_protocol::bus::matches;
///
/// assert!(matches("zenav/*/edge/**", "zenav/a/edge/scan/rear") && matches("zenav/*/edge/**", "zenav/a/edge"));
/// assert!(matches("**/pose", "zenav/a/edge/pose") && !matches("zenav/*/edge/pose", "zenav/a/cloud/pose"));
/// assert!(matches("zenav/rob$*/edge", "zenav/robot1/edge") && !matches("zenav/rob$*/edge", "zenav/bob/edge"));
/// ```
#[must_use]
pub fn matches(pattern: &str, key: &str) -> bool {
    let (pattern, key) = (KeyExpr::autocanonize(pattern.to_owned()), KeyExpr::new(key));
    pattern.is_ok_and(|pattern| key.is_ok_and(|key| pattern.includes(&key)))
}

/// A sample with its attachment and arrival time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tapped {
    /// Key, payload, encoding and stamp, as they came.
    pub sample: RawSample,
    /// Attachment by its publisher.
    pub attachment: Option<Vec<u8>>,
    /// Time of arrival in this process.
    pub arrived: Instant,
}

/// Queued samples, bounded by their size in bytes: a sample that does not fit is dropped.
struct Backlog {
    items: VecDeque<(Instant, Sample)>,
    bytes: usize,
    capacity: usize,
}

/// Approximate size of a queued sample beside its payload, bytes.
const OVERHEAD: usize = 256;

fn weight(sample: &Sample) -> usize {
    let attached = sample.attachment().map_or(0, ZBytes::len);
    sample.payload().len() + attached + OVERHEAD
}

impl Store for Backlog {
    type Item = (Instant, Sample);

    fn put(&mut self, item: Self::Item) -> bool {
        let weight = weight(&item.1);
        // A sample larger than the whole capacity still passes if the queue is empty.
        let fits = self.items.is_empty() || self.bytes + weight <= self.capacity;
        if fits {
            self.bytes += weight;
            self.items.push_back(item);
        }
        fits
    }

    fn pop(&mut self) -> Option<Self::Item> {
        let item = self.items.pop_front()?;
        self.bytes = self.bytes.saturating_sub(weight(&item.1));
        Some(item)
    }

    fn len(&self) -> usize {
        self.items.len()
    }
}

/// A subscription to all samples on some keys.
pub struct Tap {
    inbox: Arc<Inbox<Backlog>>,
    _carriers: Vec<Carrier>,
}

impl fmt::Debug for Tap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Tap").finish_non_exhaustive()
    }
}

impl Tap {
    /// Waits for the next sample; `None` after the bus was closed. Cancel-safe.
    pub async fn next(&mut self) -> Option<Tapped> {
        let (arrived, sample) = self.inbox.next().await?;
        Some(tapped(arrived, &sample))
    }

    /// The next sample, if one is queued.
    pub fn try_next(&mut self) -> Option<Tapped> {
        let (arrived, sample) = self.inbox.try_next()?;
        Some(tapped(arrived, &sample))
    }

    /// Number of samples dropped because the reader was too slow.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.inbox.dropped()
    }
}

fn tapped(arrived: Instant, sample: &Sample) -> Tapped {
    Tapped {
        attachment: sample.attachment().map(|bytes| bytes.to_bytes().into_owned()),
        sample: sample.into(),
        arrived,
    }
}

/// Whether a tap receives the sample through the subscription that recovers lost ones.
fn is_numbered(sample: &Sample) -> bool {
    sample.source_info().is_some()
        && topics::row_of(sample.key_expr().as_str())
            .is_some_and(|row| matches!(row.qos, Some(Qos::Events { .. } | Qos::State)))
}

impl Bus {
    /// Subscribes to all samples on keys that match one of the patterns, each once, beginning with those kept for late joiners. At most
    /// `capacity` bytes are queued; samples beyond that are dropped and counted.
    ///
    /// # Errors
    /// [`BusError::Key`], [`BusError::Closed`].
    pub fn tap(&self, patterns: &[String], capacity: usize) -> Result<Tap, BusError> {
        let keys: Vec<KeyExpr<'static>> = patterns.iter().cloned().map(Self::key).collect::<Result<_, _>>()?;
        let keys = Arc::new(keys);
        let (inbox, slot) = Inbox::new(Backlog {
            items: VecDeque::new(),
            bytes: 0,
            capacity,
        });
        let slot = Arc::new(slot);
        let mut carriers = Vec::new();
        for (nth, key) in keys.iter().enumerate() {
            let (slot, all) = (Arc::clone(&slot), Arc::clone(&keys));
            let callback = move |sample: Sample| {
                let is_earlier = all
                    .iter()
                    .take(nth)
                    .any(|earlier| earlier.intersects(sample.key_expr()));
                if !is_earlier && !is_numbered(&sample) {
                    put(&slot, sample);
                }
            };
            let plain = self.session.declare_subscriber(key.clone()).callback(callback);
            carriers.push(Carrier::Plain(self.declared(plain.wait())?));
        }
        for row in TABLE {
            let Some(qos @ (Qos::Events { .. } | Qos::State)) = row.qos else {
                continue;
            };
            let key = Self::key(topics::alive_key(row.pattern, &[]))?;
            if !keys.iter().any(|pattern| pattern.intersects(&key)) {
                continue;
            }
            let (slot, all) = (Arc::clone(&slot), Arc::clone(&keys));
            let callback = move |sample: Sample| {
                if is_numbered(&sample) && all.iter().any(|pattern| pattern.intersects(sample.key_expr())) {
                    put(&slot, sample);
                }
            };
            let advanced = self
                .session
                .declare_subscriber(key)
                .callback(callback)
                .history(HistoryConfig::default().detect_late_publishers().max_samples(kept(qos)))
                .recovery(RecoveryConfig::default().heartbeat())
                .query_timeout(HISTORY_TIMEOUT)
                .wait();
            carriers.push(Carrier::Advanced(self.declared(advanced)?));
        }
        Ok(Tap {
            inbox,
            _carriers: carriers,
        })
    }

    /// A publisher of bytes on one key, with the quality of service that the key table assigns; a key outside the table is published
    /// plainly.
    ///
    /// # Errors
    /// [`BusError::Key`], also for a key with wildcards; [`BusError::Closed`].
    pub fn raw_publisher(&self, key: &str, encoding: &str) -> Result<RawPublisher, BusError> {
        let qos = topics::row_of(key).and_then(|row| row.qos).unwrap_or(Qos::Latest);
        Ok(RawPublisher {
            carrier: self.carrier(key, qos, Encoding::of(encoding))?,
            encoding: WireEncoding::from(encoding),
        })
    }
}

fn put(slot: &Slot<Backlog>, sample: Sample) {
    slot.put((Instant::now(), sample));
}

/// Publishes bytes on one key.
pub struct RawPublisher {
    carrier: publish::Carrier,
    encoding: WireEncoding,
}

impl fmt::Debug for RawPublisher {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RawPublisher").finish_non_exhaustive()
    }
}

impl RawPublisher {
    /// Publishes a value with its attachment.
    ///
    /// # Errors
    /// [`BusError::Closed`].
    pub fn put(&self, bytes: Vec<u8>, attachment: Option<Vec<u8>>) -> Result<(), BusError> {
        let attachment = attachment.map(ZBytes::from);
        self.carrier
            .put(bytes, Some(self.encoding.clone()), attachment)
            .map_err(|_| BusError::Closed)
    }

    /// Publishes that the key's value is deleted.
    ///
    /// # Errors
    /// [`BusError::Closed`].
    pub fn delete(&self) -> Result<(), BusError> {
        self.carrier.delete().map_err(|_| BusError::Closed)
    }
}
