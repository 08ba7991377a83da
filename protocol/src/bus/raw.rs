//! Raw access. What do tools without message types see? Keys, bytes and encodings, as on the wire.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use zenoh::Wait;
use zenoh::query::Selector;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{Sample, SampleKind};
use zenoh_ext::{AdvancedSubscriberBuilderExt, HistoryConfig};

use super::inbox::{Inbox, Queue};
use super::subscribe::{Carrier, HISTORY_TIMEOUT};
use super::{Bus, BusError};
use crate::time::Stamp;

/// Most replies kept per query.
const MAX_REPLIES: usize = 4096;

/// A sample as received.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawSample {
    /// Key of the sample.
    pub key: String,
    /// Payload of the sample.
    pub bytes: Vec<u8>,
    /// Name of the sample's encoding.
    pub encoding: String,
    /// Time at which the publisher's Zenoh session stamped the sample, UNIX time.
    pub stamp: Option<Stamp>,
    /// Whether the sample deletes its key.
    pub deleted: bool,
}

impl From<&Sample> for RawSample {
    fn from(sample: &Sample) -> Self {
        Self {
            key: sample.key_expr().to_string(),
            bytes: sample.payload().to_bytes().into_owned(),
            encoding: sample.encoding().to_string(),
            stamp: sample
                .timestamp()
                .map(|stamp| Stamp::ZERO + stamp.get_time().to_duration()),
            deleted: sample.kind() == SampleKind::Delete,
        }
    }
}

/// One reply to a raw query.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RawReply {
    /// A reply with a value.
    Ok(RawSample),
    /// A reply with an error.
    Err {
        /// Payload of the error reply.
        bytes: Vec<u8>,
        /// Name of the sample's encoding.
        encoding: String,
    },
}

/// A subscription to samples as they arrive.
pub struct RawSubscription {
    inbox: Arc<Inbox<Queue<Sample>>>,
    _carrier: Carrier,
}

impl fmt::Debug for RawSubscription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RawSubscription").finish_non_exhaustive()
    }
}

impl RawSubscription {
    /// Waits for the next sample; `None` after the bus was closed.
    pub async fn next(&mut self) -> Option<RawSample> {
        self.inbox.next().await.as_ref().map(RawSample::from)
    }

    /// Number of samples dropped because the reader was too slow.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.inbox.dropped()
    }
}

impl Bus {
    /// Subscribes to all new samples on matching keys; at most `capacity` are queued, then the oldest are dropped.
    ///
    /// # Errors
    /// [`BusError::Key`], [`BusError::Closed`].
    pub fn raw_subscribe(&self, pattern: &str, capacity: usize) -> Result<RawSubscription, BusError> {
        let key = Self::key(pattern.to_owned())?;
        let (inbox, slot) = Inbox::new(Queue::new(capacity));
        let subscriber = self
            .session
            .declare_subscriber(key)
            .callback(move |sample| slot.put(sample))
            .wait();
        Ok(RawSubscription {
            inbox,
            _carrier: Carrier::Plain(self.declared(subscriber)?),
        })
    }

    /// As [`Self::raw_subscribe`], preceded by the samples that publishers of `Events` and `State` topics keep for late joiners.
    ///
    /// # Errors
    /// [`BusError::Key`], [`BusError::Closed`].
    pub fn raw_subscribe_kept(&self, pattern: &str, capacity: usize) -> Result<RawSubscription, BusError> {
        let key = Self::key(pattern.to_owned())?;
        let (inbox, slot) = Inbox::new(Queue::new(capacity));
        let subscriber = self
            .session
            .declare_subscriber(key)
            .callback(move |sample| slot.put(sample))
            .history(HistoryConfig::default().detect_late_publishers())
            .query_timeout(HISTORY_TIMEOUT)
            .wait();
        Ok(RawSubscription {
            inbox,
            _carrier: Carrier::Advanced(self.declared(subscriber)?),
        })
    }

    /// Publishes bytes unchanged.
    ///
    /// # Errors
    /// [`BusError::Key`], [`BusError::Closed`].
    pub fn raw_put(&self, key: &str, bytes: Vec<u8>, encoding: &str) -> Result<(), BusError> {
        let key = Self::key(key.to_owned())?;
        self.declared(
            self.session
                .put(key, bytes)
                .encoding(zenoh::bytes::Encoding::from(encoding))
                .wait(),
        )
    }

    /// Queries a selector once (`zenav/tiago/ask/cloud/map?format=png`) and collects all replies; a payload, if any, is JSON.
    ///
    /// # Errors
    /// [`BusError::Key`], [`BusError::Closed`].
    pub async fn raw_query(
        &self,
        selector: &str,
        payload: Option<Vec<u8>>,
        timeout: Duration,
    ) -> Result<Vec<RawReply>, BusError> {
        let target = Selector::try_from(selector).map_err(|error| BusError::Key {
            key: selector.to_owned(),
            reason: error.to_string(),
        })?;
        let (inbox, slot) = Inbox::new(Queue::new(MAX_REPLIES));
        let mut query = self
            .session
            .get(target)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .timeout(timeout)
            .callback(move |reply| slot.put(reply));
        if let Some(payload) = payload {
            query = query
                .payload(payload)
                .encoding(zenoh::bytes::Encoding::APPLICATION_JSON);
        }
        self.declared(query.wait())?;
        let mut replies = Vec::new();
        while let Some(reply) = inbox.next().await {
            replies.push(match reply.result() {
                Ok(sample) => RawReply::Ok(sample.into()),
                Err(error) => RawReply::Err {
                    bytes: error.payload().to_bytes().into_owned(),
                    encoding: error.encoding().to_string(),
                },
            });
        }
        Ok(replies)
    }
}
