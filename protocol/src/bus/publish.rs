//! How does a value reach everybody who wants it? By a publisher of its topic, which never waits for a slow reader.
//!
//! `Events` and `State` use Zenoh's advanced publication: the writer keeps the last samples and numbers them, so that a late
//! joiner gets them and a gap (dropped under congestion, or while a link was cut) is asked for again. That is why even they are sent
//! with "drop": no frozen reader can hold up a robot. Only bulk (CBOR) waits for room, since one lost fragment costs the whole of it.

use std::fmt;
use std::marker::PhantomData;
use std::time::Duration;

use serde::Serialize;
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

use super::inbox::Complaints;
use super::{Bus, BusError};
use crate::codec::{self, Encoding};
use crate::topics::{Qos, Topic};

/// How often an advanced publisher repeats the number of its last sample: a lost last sample is noticed this late.
const HEARTBEAT: Duration = Duration::from_millis(500);

/// Writes one key of a topic.
pub struct Publisher<T> {
    carrier: Carrier,
    encoding: Encoding,
    key: String,
    failures: Complaints,
    message: PhantomData<fn(&T)>,
}

enum Carrier {
    Plain(zenoh::pubsub::Publisher<'static>),
    Advanced(Box<AdvancedPublisher<'static>>),
}

impl<T> fmt::Debug for Publisher<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Publisher")
            .field("key", &self.key)
            .finish_non_exhaustive()
    }
}

impl Bus {
    /// A publisher of the topic's key with these chunks, none of them wild.
    ///
    /// # Errors
    /// [`BusError::Key`] when the chunks make no key, [`BusError::Closed`].
    pub fn publisher<T>(&self, topic: &Topic<T>, chunks: &[&str]) -> Result<Publisher<T>, BusError> {
        let key = topic.key(chunks);
        let key_expr = Self::key(key.clone())?;
        if key_expr.is_wild() {
            return Err(BusError::Key {
                key,
                reason: "a writer needs one key, not a pattern".into(),
            });
        }
        let congestion = match topic.encoding {
            Encoding::Json => CongestionControl::Drop,
            Encoding::Cbor => CongestionControl::Block,
        };
        let priority = match (topic.qos, topic.encoding) {
            (Qos::RealTime, _) => Priority::RealTime,
            (_, Encoding::Cbor) => Priority::DataLow,
            (Qos::Latest, _) => Priority::Data,
            (Qos::Events { .. } | Qos::State, _) => Priority::DataHigh,
        };
        let plain = self
            .session
            .declare_publisher(key_expr)
            .encoding(zenoh::bytes::Encoding::from(topic.encoding.mime()))
            .congestion_control(congestion)
            .priority(priority)
            .express(topic.qos == Qos::RealTime);
        let carrier = match topic.qos {
            Qos::Latest | Qos::RealTime => Carrier::Plain(self.declared(plain.wait())?),
            Qos::Events { .. } | Qos::State => {
                let advanced = plain
                    .cache(CacheConfig::default().max_samples(kept(topic.qos)))
                    .sample_miss_detection(MissDetectionConfig::default().heartbeat(HEARTBEAT))
                    .publisher_detection();
                Carrier::Advanced(Box::new(self.declared(advanced.wait())?))
            }
        };
        Ok(Publisher {
            carrier,
            encoding: topic.encoding,
            key,
            failures: Complaints::default(),
            message: PhantomData,
        })
    }
}

/// Samples kept by an advanced writer.
pub(super) fn kept(qos: Qos) -> usize {
    match qos {
        Qos::Events { cache } => cache.max(1),
        Qos::State | Qos::Latest | Qos::RealTime => 1,
    }
}

impl<T: Serialize> Publisher<T> {
    /// Sends the value, from any thread. Order is kept. A value that cannot be sent (the bus is closed, the type has no
    /// form in the encoding) is logged now and then.
    pub fn put(&self, message: &T) {
        let failure = match codec::encode(message, self.encoding) {
            Ok(bytes) => self.put_bytes(bytes).err().map(|error| error.to_string()),
            Err(error) => Some(error.to_string()),
        };
        if let Some(reason) = failure
            && let Some(count) = self.failures.add()
        {
            tracing::warn!(key = %self.key, reason, count, "not published");
        }
    }

    fn put_bytes(&self, bytes: Vec<u8>) -> zenoh::Result<()> {
        match &self.carrier {
            Carrier::Plain(publisher) => publisher.put(bytes).wait(),
            Carrier::Advanced(publisher) => publisher.put(bytes).wait(),
        }
    }
}

impl<T> Publisher<T> {
    /// The key it writes.
    #[must_use]
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Whether somebody may be listening, as far as this session knows. What is costly to make need not be made for nobody; a session
    /// that has just declared the publisher may not know of anybody yet.
    #[must_use]
    pub fn may_be_heard(&self) -> bool {
        let status = match &self.carrier {
            Carrier::Plain(publisher) => publisher.matching_status().wait(),
            Carrier::Advanced(publisher) => publisher.matching_status().wait(),
        };
        status.map_or(true, |status| status.matching())
    }

    /// Values that could not be sent.
    #[must_use]
    pub fn failures(&self) -> u64 {
        self.failures.count()
    }
}
