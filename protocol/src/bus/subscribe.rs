//! Subscriptions. How does a component receive a topic: only its newest value, or all values in order?
//!
//! [`Latest`] and [`Subscription`] decode in the reader, not in Zenoh's thread: a skipped value is never decoded. A payload over the
//! topic's size, and one that comes far faster than its rate, is dropped at once and counted.

use std::fmt;
use std::sync::{Arc, Weak};
use std::time::Duration;

use serde::de::DeserializeOwned;
use tokio::runtime::Handle;
use zenav_observability::trace::Context;
use zenoh::key_expr::KeyExpr;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};
use zenoh_ext::{AdvancedSubscriber, AdvancedSubscriberBuilderExt, HistoryConfig, RecoveryConfig};

use super::flow::Arrivals;
use super::inbox::{Complaints, Inbox, Newest, Queue, Slot, Store};
use super::limiter::Limiter;
use super::publish::kept;
use super::{Bus, BusError};
use crate::codec::{CodecError, Encoding};
use crate::topics::{Decode, Qos, Topic, Untyped};

/// Time limit for fetching a publisher's past samples; newer samples wait meanwhile.
pub(super) const HISTORY_TIMEOUT: Duration = Duration::from_secs(2);

/// Time for which the key of an ended subscription stays declared: longer than routers take to agree on their net anew.
const LINGER: Duration = Duration::from_secs(5);

/// A value, and the named chunks of the key it came on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Received<T> {
    /// The chunks in the order of the pattern's names: `["tiago"]` for `zenav/tiago/edge/scan`.
    pub chunks: Vec<String>,
    /// The published value.
    pub message: T,
    /// The trace that it belongs to, if its publisher attached one.
    pub trace: Option<Context>,
}

/// Keeps a subscription alive.
#[expect(dead_code, reason = "held for their drop, which undeclares")]
pub(super) enum Carrier {
    Plain(zenoh::pubsub::Subscriber<()>),
    Advanced(AdvancedSubscriber<()>),
}

type NewestSamples = Newest<KeyExpr<'static>, Sample>;
type AllSamples = Queue<Sample>;

/// The part of a subscription that does not depend on the type of its messages: it is compiled once, not for each type.
struct Intake {
    unreadable: Arc<Complaints>,
    flow: Arrivals,
    // Before the subscription ends.
    _lingering: Lingering,
    _carrier: Carrier,
}

/// The key of a subscription, which stays declared for [`LINGER`] after its end, without a reader.
///
/// A part that gives up leading ends its subscriptions, and begins the same ones again. Between Zenoh's routers the end may then arrive after
/// the beginning: while routers are replaced, the two take different ways. The key would count as unwanted for good, and nobody would say so.
struct Lingering {
    session: Weak<Session>,
    key: KeyExpr<'static>,
}

impl Drop for Lingering {
    fn drop(&mut self) {
        let (Ok(runtime), Some(session)) = (Handle::try_current(), self.session.upgrade()) else {
            return;
        };
        if session.is_closed() {
            return;
        }
        if let Ok(unread) = session.declare_subscriber(&self.key).callback(drop).wait() {
            runtime.spawn(async move {
                tokio::time::sleep(LINGER).await;
                drop(unread);
            });
        }
    }
}

/// Decodes samples, and counts those that cannot be decoded.
struct Reader<T> {
    topic: Topic<T>,
    intake: Intake,
}

impl<T> Reader<T> {
    fn read(&self, sample: &Sample) -> Option<T> {
        match decode_sample(sample, self.topic.decode, self.topic.max_bytes) {
            Ok(message) => Some(message),
            Err(error) => {
                complain(&self.intake.unreadable, &self.intake.flow, sample.key_expr(), &error);
                None
            }
        }
    }

    /// The message of a sample, with its key's chunks.
    fn received(&self, sample: &Sample) -> Option<Received<T>> {
        Some(Received {
            message: self.read(sample)?,
            chunks: self.topic.chunks(sample.key_expr().as_str()),
            trace: trace_of(sample),
        })
    }
}

fn trace_of(sample: &Sample) -> Option<Context> {
    let attached = sample.attachment()?;
    Context::parse(&attached.to_bytes())
}

/// Decodes a sample by its own encoding.
pub(super) fn decode_sample<T>(sample: &Sample, decode: Decode<T>, max_bytes: usize) -> Result<T, CodecError> {
    decode(&sample.payload().to_bytes(), encoding_of(sample.encoding()), max_bytes)
}

/// The sample's encoding; avoids building its name for the two encodings in use.
pub(super) fn encoding_of(encoding: &zenoh::bytes::Encoding) -> Encoding {
    use zenoh::bytes::Encoding as Wire;
    if *encoding == Wire::APPLICATION_JSON {
        Encoding::Json
    } else if encoding.id() == Wire::APPLICATION_CBOR.id() {
        Encoding::Cbor
    } else {
        Encoding::of(&encoding.to_string())
    }
}

fn complain(complaints: &Complaints, flow: &Arrivals, key: &KeyExpr<'_>, error: &CodecError) {
    flow.refused(error);
    if let Some(count) = complaints.add() {
        tracing::warn!(%key, %error, count, "payload ignored");
    }
}

impl Bus {
    /// Subscribes to the newest value of the topic on the key with these chunks; a chunk may be `*`.
    ///
    /// # Errors
    /// [`BusError::Key`] for chunks that do not form a key, [`BusError::Closed`] after the bus was closed.
    pub fn latest<T>(&self, topic: &Topic<T>, chunks: &[&str]) -> Result<Latest<T>, BusError> {
        let (inbox, intake) = self.newest_samples(topic.untyped(), chunks)?;
        Ok(Latest {
            inbox,
            reader: Reader { topic: *topic, intake },
            current: None,
        })
    }

    fn newest_samples(&self, topic: Untyped, chunks: &[&str]) -> Result<(Arc<Inbox<NewestSamples>>, Intake), BusError> {
        let flow = Arrivals::new(self, topic.pattern);
        let (inbox, slot) = Inbox::gauged(Newest::new(), flow.waiting.clone());
        let intake = self.intake(topic, chunks, (slot, flow), |sample| {
            (sample.key_expr().clone(), sample)
        })?;
        Ok((inbox, intake))
    }

    /// Subscribes to all values of the topic on the key with these chunks (a chunk may be `*`), in order for each publisher. At most
    /// `capacity` values are queued; then the oldest are dropped and counted.
    ///
    /// # Errors
    /// [`BusError::Key`] for chunks that do not form a key, [`BusError::Closed`] after the bus was closed.
    pub fn subscribe<T>(
        &self,
        topic: &Topic<T>,
        chunks: &[&str],
        capacity: usize,
    ) -> Result<Subscription<T>, BusError> {
        let (inbox, intake) = self.all_samples(topic.untyped(), chunks, capacity)?;
        Ok(Subscription {
            inbox,
            reader: Reader { topic: *topic, intake },
        })
    }

    fn all_samples(
        &self,
        topic: Untyped,
        chunks: &[&str],
        capacity: usize,
    ) -> Result<(Arc<Inbox<AllSamples>>, Intake), BusError> {
        let flow = Arrivals::new(self, topic.pattern);
        let (inbox, slot) = Inbox::gauged(Queue::new(capacity), flow.waiting.clone());
        let intake = self.intake(topic, chunks, (slot, flow), |sample| sample)?;
        Ok((inbox, intake))
    }

    fn intake<S>(
        &self,
        topic: Untyped,
        chunks: &[&str],
        (slot, flow): (Slot<S>, Arrivals),
        item: fn(Sample) -> S::Item,
    ) -> Result<Intake, BusError>
    where
        S: Store + Send + 'static,
        S::Item: Send,
    {
        let key = Self::key(topic.key(chunks))?;
        let unreadable = Arc::new(Complaints::default());
        let max_bytes = topic.max_bytes;
        let limiter = Limiter::of(self, topic);
        let callback = {
            let (unreadable, flow) = (Arc::clone(&unreadable), flow.clone());
            move |sample: Sample| {
                let got = sample.payload().len();
                flow.received(got);
                if got > max_bytes {
                    complain(
                        &unreadable,
                        &flow,
                        sample.key_expr(),
                        &CodecError::TooLarge { limit: max_bytes, got },
                    );
                } else if sample.kind() == SampleKind::Put {
                    if limiter.as_ref().is_some_and(|limiter| !limiter.admits(&sample)) {
                        flow.too_fast();
                    } else if !slot.fits(item(sample)) {
                        flow.dropped();
                    }
                }
            }
        };
        let plain = self.session.declare_subscriber(key.clone()).callback(callback);
        let lingering = Lingering {
            session: Arc::downgrade(&self.session),
            key,
        };
        let carrier = match topic.qos {
            Qos::Latest | Qos::RealTime => Carrier::Plain(self.declared(plain.wait())?),
            Qos::Events { .. } | Qos::State => {
                let advanced = plain
                    .history(
                        HistoryConfig::default()
                            .detect_late_publishers()
                            .max_samples(kept(topic.qos)),
                    )
                    .recovery(RecoveryConfig::default().heartbeat())
                    .query_timeout(HISTORY_TIMEOUT);
                Carrier::Advanced(self.declared(advanced.wait())?)
            }
        };
        Ok(Intake {
            unreadable,
            flow,
            _carrier: carrier,
            _lingering: lingering,
        })
    }
}

/// The newest value of a topic; with a wildcard, of each matching key. Usable from any thread.
pub struct Latest<T> {
    inbox: Arc<Inbox<NewestSamples>>,
    reader: Reader<T>,
    current: Option<T>,
}

impl<T> fmt::Debug for Latest<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Latest")
            .field("pattern", &self.reader.topic.pattern)
            .finish_non_exhaustive()
    }
}

impl<T: DeserializeOwned> Latest<T> {
    /// Takes the newest value, unless it was taken before; never waits. With a wildcard, the keys take turns.
    pub fn take(&mut self) -> Option<T> {
        loop {
            let (_, sample) = self.inbox.try_next()?;
            if let Some(message) = self.reader.read(&sample) {
                return Some(message);
            }
        }
    }

    /// As [`Self::take`], with the key's chunks.
    pub fn take_received(&mut self) -> Option<Received<T>> {
        loop {
            let (_, sample) = self.inbox.try_next()?;
            if let Some(received) = self.reader.received(&sample) {
                return Some(received);
            }
        }
    }

    /// The newest value, whether or not it was borrowed before; a value taken by [`Self::take`] is not returned again.
    pub fn borrow(&mut self) -> Option<&T> {
        while let Some(message) = self.take() {
            self.current = Some(message);
        }
        self.current.as_ref()
    }

    /// Waits until there is a value to take; `false` after the bus was closed. (The value may turn out to be unreadable.)
    pub async fn changed(&mut self) -> bool {
        self.inbox.filled().await
    }

    /// Waits for a value that was not taken yet; `None` after the bus was closed.
    pub async fn next(&mut self) -> Option<Received<T>> {
        loop {
            let (_, sample) = self.inbox.next().await?;
            if let Some(received) = self.reader.received(&sample) {
                return Some(received);
            }
        }
    }

    /// Number of payloads that were too large or could not be decoded.
    #[must_use]
    pub fn unreadable(&self) -> u64 {
        self.reader.intake.unreadable.count()
    }
}

/// All values of a topic, in order.
pub struct Subscription<T> {
    inbox: Arc<Inbox<AllSamples>>,
    reader: Reader<T>,
}

impl<T> fmt::Debug for Subscription<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Subscription")
            .field("pattern", &self.reader.topic.pattern)
            .finish_non_exhaustive()
    }
}

impl<T: DeserializeOwned> Subscription<T> {
    /// Waits for the next value; `None` after the bus was closed.
    pub async fn next(&mut self) -> Option<Received<T>> {
        loop {
            let sample = self.inbox.next().await?;
            if let Some(received) = self.reader.received(&sample) {
                return Some(received);
            }
        }
    }

    /// The next value, if there is one; never waits.
    pub fn try_next(&mut self) -> Option<Received<T>> {
        loop {
            let sample = self.inbox.try_next()?;
            if let Some(received) = self.reader.received(&sample) {
                return Some(received);
            }
        }
    }

    /// Number of values dropped because the reader was too slow.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.inbox.dropped()
    }

    /// Number of payloads that were too large or could not be decoded.
    #[must_use]
    pub fn unreadable(&self) -> u64 {
        self.reader.intake.unreadable.count()
    }
}
