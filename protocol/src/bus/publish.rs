//! Publisher. How does a value reach every reader without waiting for a slow one?
//!
//! `Events` and `State` topics use Zenoh's advanced publisher: it numbers its samples and keeps the last ones, so that late joiners get
//! them and readers request missing ones again (dropped under congestion, or lost while a link was down). So even these topics are sent
//! with congestion control "drop", and a frozen reader cannot block a robot. Only bulk messages (CBOR) block until there is room, because
//! one lost fragment would cost the whole message.
//!
//! Repeated samples from a cache also block until there is room, whatever the topic's quality of service (Zenoh 1.10 gives a reply the
//! quality of service of its request), and they do so on a receiving thread. So only few bulk samples are kept, and a process has more
//! receiving threads than by default ([`threads`]).
//!
//! No message is "express": each of those takes a whole buffer of its queue, of which a link has two, and the third of a burst is dropped. So
//! the heartbeats of a process with several missions would not all arrive. Others share a buffer, and an idle link sends them at once too.

use std::fmt;
use std::sync::{Arc, Weak};

use serde::Serialize;
use zenav_observability::trace::Context;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::qos::{CongestionControl, Priority};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

use super::flow::Departures;
use super::inbox::Complaints;
use super::repeat::{LastNumber, announced};
use super::{Bus, BusError, threads};
use crate::codec::{self, CodecError, Encoding};
use crate::topics::{Encode, Qos, Topic, Untyped};

/// Publishes on one key of a topic.
pub struct Publisher<T> {
    outlet: Outlet,
    encode: Encode<T>,
}

/// The part of a publisher that does not depend on the type of its messages: it is compiled once, not for each type.
struct Outlet {
    carrier: Carrier,
    encoding: Encoding,
    max_bytes: usize,
    key: String,
    failures: Complaints,
    flow: Departures,
}

pub(super) enum Carrier {
    Plain(zenoh::pubsub::Publisher<'static>),
    Advanced(Box<AdvancedPublisher<'static>>, Arc<LastNumber>),
}

impl<T> fmt::Debug for Publisher<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Publisher")
            .field("key", &self.outlet.key)
            .finish_non_exhaustive()
    }
}

impl Bus {
    /// A publisher on the topic's key with these chunks; no chunk may be a wildcard.
    ///
    /// # Errors
    /// [`BusError::Key`] for chunks that do not form a key, [`BusError::Closed`] after the bus was closed.
    pub fn publisher<T>(&self, topic: &Topic<T>, chunks: &[&str]) -> Result<Publisher<T>, BusError> {
        Ok(Publisher {
            outlet: self.outlet(topic.untyped(), chunks)?,
            encode: topic.encode,
        })
    }

    fn outlet(&self, topic: Untyped, chunks: &[&str]) -> Result<Outlet, BusError> {
        let key = topic.key(chunks);
        Ok(Outlet {
            carrier: self.carrier(&key, topic.qos, topic.encoding)?,
            encoding: topic.encoding,
            max_bytes: topic.max_bytes,
            key,
            failures: Complaints::default(),
            flow: Departures::new(self, topic.pattern),
        })
    }

    /// A publisher on a key without wildcards, with the quality of service of a topic.
    pub(super) fn carrier(&self, key: &str, qos: Qos, encoding: Encoding) -> Result<Carrier, BusError> {
        let key_expr = Self::key(key.to_owned())?;
        if key_expr.is_wild() {
            return Err(BusError::Key {
                key: key.to_owned(),
                reason: "expected a key without wildcards to publish on".into(),
            });
        }
        let congestion = match encoding {
            Encoding::Json => CongestionControl::Drop,
            Encoding::Cbor => CongestionControl::Block,
        };
        let priority = match (qos, encoding) {
            (Qos::RealTime, _) => Priority::RealTime,
            (_, Encoding::Cbor) => Priority::DataLow,
            (Qos::Latest, _) => Priority::Data,
            (Qos::Events { .. } | Qos::State, _) => Priority::DataHigh,
        };
        let plain = self
            .session
            .declare_publisher(key_expr)
            .encoding(zenoh::bytes::Encoding::from(encoding.mime()))
            .congestion_control(congestion)
            .priority(priority);
        Ok(match qos {
            Qos::Latest | Qos::RealTime => Carrier::Plain(self.declared(plain.wait())?),
            Qos::Events { .. } | Qos::State => {
                let advanced = plain
                    .cache(CacheConfig::default().max_samples(kept(qos)))
                    .sample_miss_detection(MissDetectionConfig::default())
                    .publisher_detection();
                let publisher = self.declared(advanced.wait())?;
                let id = publisher.id();
                let repeated = Self::key(announced(key, id.zid(), id.eid()))?;
                let last = LastNumber::new(self.declared(self.session.declare_publisher(repeated).wait())?);
                let source: Weak<LastNumber> = Arc::downgrade(&last);
                self.repeats.add(source);
                Carrier::Advanced(Box::new(publisher), last)
            }
        })
    }
}

/// Number of samples that an advanced publisher keeps.
pub(super) fn kept(qos: Qos) -> usize {
    match qos {
        Qos::Events { cache } => cache.max(1),
        Qos::State | Qos::Latest | Qos::RealTime => 1,
    }
}

impl Carrier {
    /// Publishes bytes; in the encoding of the publisher if there is no other.
    pub(super) fn put(
        &self,
        bytes: Vec<u8>,
        encoding: Option<zenoh::bytes::Encoding>,
        attachment: Option<ZBytes>,
    ) -> zenoh::Result<()> {
        match self {
            Self::Plain(publisher) => {
                let encoding = encoding.unwrap_or_else(|| publisher.encoding().clone());
                publisher.put(bytes).encoding(encoding).attachment(attachment).wait()
            }
            Self::Advanced(publisher, last) => {
                let encoding = encoding.unwrap_or_else(|| publisher.encoding().clone());
                let put = publisher.put(bytes).encoding(encoding).attachment(attachment).wait();
                last.sent();
                put
            }
        }
    }

    /// Publishes that the value is deleted.
    pub(super) fn delete(&self) -> zenoh::Result<()> {
        match self {
            Self::Plain(publisher) => publisher.delete().wait(),
            Self::Advanced(publisher, last) => {
                let deleted = publisher.delete().wait();
                last.sent();
                deleted
            }
        }
    }
}

impl<T: Serialize> Publisher<T> {
    /// Publishes a value, from any thread; the order is kept. Failures (the bus was closed, or the value cannot be encoded within the topic's
    /// size) are counted, and logged now and then.
    pub fn put(&self, message: &T) {
        self.put_in(None, message);
    }

    /// As [`Self::put`], with the trace of the value attached, if it has one.
    pub fn put_in(&self, trace: Option<Context>, message: &T) {
        self.outlet.put(trace, (self.encode)(message));
    }
}

impl Outlet {
    fn put(&self, trace: Option<Context>, encoded: Result<Vec<u8>, CodecError>) {
        let attachment = trace.map(|trace| ZBytes::from(trace.to_string()));
        let failure = match encoded.and_then(|bytes| codec::within(bytes, self.max_bytes)) {
            Ok(bytes) => {
                self.flow.published(bytes.len());
                self.put_bytes(bytes, attachment).err().map(|error| error.to_string())
            }
            Err(error) => Some(error.to_string()),
        };
        if let Some(reason) = failure {
            self.flow.failed();
            if let Some(count) = self.failures.add() {
                tracing::warn!(key = %self.key, reason, count, "not published");
            }
        }
    }

    fn put_bytes(&self, bytes: Vec<u8>, attachment: Option<ZBytes>) -> zenoh::Result<()> {
        let put = || self.carrier.put(bytes, None, attachment);
        if self.encoding == Encoding::Cbor {
            threads::waiting_for_room(put)
        } else {
            put()
        }
    }

    fn may_be_heard(&self) -> bool {
        let status = match &self.carrier {
            Carrier::Plain(publisher) => publisher.matching_status().wait(),
            Carrier::Advanced(publisher, _) => publisher.matching_status().wait(),
        };
        status.map_or(true, |status| status.matching())
    }
}

impl<T> Publisher<T> {
    /// The key of the publisher.
    #[must_use]
    pub fn key(&self) -> &str {
        &self.outlet.key
    }

    /// Whether there may be a subscriber, as far as this session knows: lets a writer skip costly computations without readers. Right after
    /// the declaration the session may not know of any subscriber yet.
    #[must_use]
    pub fn may_be_heard(&self) -> bool {
        self.outlet.may_be_heard()
    }

    /// Number of values that could not be published.
    #[must_use]
    pub fn failures(&self) -> u64 {
        self.outlet.failures.count()
    }
}
