//! Keyed publisher. How are the last values of many short-lived keys published without a declaration for each?
//!
//! A router permanently keeps a few kilobytes for every key on which something was ever declared, even after the declaration ended: a key
//! for every goal would fill it. So a [`KeyedPublisher`] declares once, on the pattern, what an advanced publisher declares for its key (a
//! cache that can be queried, and a token that announces it to late subscribers), and puts on the concrete keys. On the wire each key is a
//! source of its own, with its own sequence numbers: an advanced subscriber gets the last value of each key, in order, and requests a lost
//! one again.

use std::collections::VecDeque;
use std::fmt;
use std::sync::{Arc, Mutex, Weak};

use serde::Serialize;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{Query, Queryable};
use zenoh::sample::SourceInfo;
use zenoh::session::{EntityGlobalId, EntityId, ZenohId};
use zenoh::time::Timestamp;
use zenoh::{Session, Wait};

use super::flow::Departures;
use super::inbox::Complaints;
use super::limiter::lock;
use super::repeat::{Numbered, Repeats, announced};
use super::{Bus, BusError};
use crate::codec::{self, CodecError, Encoding};
use crate::topics::{Encode, Topic, Untyped};

/// The number of a key's last value is repeated in periods 2, 4, 8, …, and at last in this one: after 1, 2, 4, … s and two minutes. A router
/// compares a message on a key that nobody declared with the keys of all robots, so these are few, and in real time none while a robot
/// drives: its goal's progress is told twice a second.
const LAST_PERIOD: u32 = 256;

/// Publishes on the keys of a topic that match a pattern, and keeps the last values of the newest keys.
pub struct KeyedPublisher<T> {
    outlet: Outlet,
    encode: Encode<T>,
}

/// The part of a keyed publisher that does not depend on the type of its messages.
struct Outlet {
    session: Session,
    topic: Untyped,
    kept: Arc<Mutex<Kept>>,
    failures: Complaints,
    flow: Departures,
    _cache: Queryable<()>,
    _token: LivelinessToken,
}

/// The newest keys and their last values.
struct Kept {
    values: VecDeque<Value>,
    most: usize,
    ids: Arc<Repeats>,
}

/// The last value of a key.
#[derive(Clone)]
struct Value {
    key: KeyExpr<'static>,
    /// Key of its cache, where advanced subscribers query it; contains the source id.
    cache_key: KeyExpr<'static>,
    source: EntityId,
    number: u32,
    /// When it was put, and by which session.
    stamp: Timestamp,
    bytes: ZBytes,
    /// Periods since the value was put.
    periods: u32,
}

impl<T> fmt::Debug for KeyedPublisher<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("KeyedPublisher")
            .field("pattern", &self.outlet.topic.pattern)
            .finish_non_exhaustive()
    }
}

impl Bus {
    /// A publisher on all keys of a topic with these chunks, the last of which is `*`; the last values of the `most` newest keys are kept
    /// for late joiners. Only in a Tokio runtime.
    ///
    /// # Errors
    /// [`BusError::Key`] for chunks that do not form a key, [`BusError::Closed`] after the bus was closed.
    pub fn keyed_publisher<T>(
        &self,
        topic: &Topic<T>,
        chunks: &[&str],
        most: usize,
    ) -> Result<KeyedPublisher<T>, BusError> {
        Ok(KeyedPublisher {
            outlet: self.keyed_outlet(topic.untyped(), chunks, most)?,
            encode: topic.encode,
        })
    }

    fn keyed_outlet(&self, topic: Untyped, chunks: &[&str], most: usize) -> Result<Outlet, BusError> {
        let zid = self.session.zid();
        let kept = Arc::new(Mutex::new(Kept {
            values: VecDeque::new(),
            most: most.max(1),
            ids: Arc::clone(&self.repeats),
        }));
        let pattern = topic.key(chunks);
        let all = Self::key(format!("{pattern}/@adv/pub/{zid}/**"))?;
        let token_key = Self::key(announced(&pattern, zid, self.repeats.id()))?;
        let answer = {
            let (kept, token_key, encoding) = (Arc::clone(&kept), token_key.clone(), topic.encoding);
            let elsewhere = tokio::runtime::Handle::current();
            move |query: Query| {
                let (kept, token_key) = (Arc::clone(&kept), token_key.clone());
                // A reply may block until the link has room, which is not allowed on a receiving thread.
                elsewhere.spawn_blocking(move || {
                    let asked = lock(&kept).asked(&query, &token_key);
                    answer(&query, &asked, zid, encoding);
                });
            }
        };
        let cache = self.declared(self.session.declare_queryable(all).callback(answer).wait())?;
        let token = self.declared(self.session.liveliness().declare_token(token_key).wait())?;
        let source: Weak<Mutex<Kept>> = Arc::downgrade(&kept);
        self.repeats.add(source);
        Ok(Outlet {
            session: (*self.session).clone(),
            topic,
            kept,
            failures: Complaints::default(),
            flow: Departures::new(self, topic.pattern),
            _cache: cache,
            _token: token,
        })
    }
}

impl<T: Serialize> KeyedPublisher<T> {
    /// Publishes a value on the key with these chunks, from any thread; the order is kept. Failures are counted, and logged now and then.
    pub fn put(&self, chunks: &[&str], message: &T) {
        self.outlet.put(chunks, (self.encode)(message));
    }
}

impl Outlet {
    fn put(&self, chunks: &[&str], encoded: Result<Vec<u8>, CodecError>) {
        let Err(reason) = self.try_put(self.topic.key(chunks), encoded) else {
            return;
        };
        self.flow.failed();
        if let Some(count) = self.failures.add() {
            tracing::warn!(pattern = self.topic.pattern, reason, count, "not published");
        }
    }

    fn try_put(&self, key: String, encoded: Result<Vec<u8>, CodecError>) -> Result<(), String> {
        let bytes = encoded
            .and_then(|bytes| codec::within(bytes, self.topic.max_bytes))
            .map_err(|error| error.to_string())?;
        let key = Bus::key(key).map_err(|error| error.to_string())?;
        let (zid, size) = (self.session.zid(), bytes.len());
        // Held while sending, so that numbers leave in order.
        let mut kept = lock(&self.kept);
        let value = kept.set(key, zid, self.session.new_timestamp(), bytes.into())?;
        self.session
            .put(value.key, value.bytes)
            .encoding(zenoh::bytes::Encoding::from(self.topic.encoding.mime()))
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::DataHigh)
            .timestamp(value.stamp)
            .source_info(SourceInfo::new(EntityGlobalId::new(zid, value.source), value.number))
            .wait()
            .map_err(|error| error.to_string())?;
        self.flow.published(size);
        Ok(())
    }
}

impl Kept {
    /// Stores the newest value of a key.
    fn set(&mut self, key: KeyExpr<'static>, zid: ZenohId, stamp: Timestamp, bytes: ZBytes) -> Result<Value, String> {
        let (source, number) = match self.values.iter().position(|value| value.key == key) {
            Some(place) => {
                let before = self.values.remove(place).ok_or("no such value")?;
                (before.source, before.number.wrapping_add(1))
            }
            None => {
                if self.values.len() == self.most {
                    self.values.pop_front();
                }
                (self.ids.id(), 0)
            }
        };
        let value = Value {
            cache_key: Bus::key(announced(key.as_str(), zid, source)).map_err(|error| error.to_string())?,
            key,
            source,
            number,
            stamp,
            bytes,
            periods: 0,
        };
        self.values.push_back(value.clone());
        Ok(value)
    }

    /// Advances by one period: returns the values whose number is repeated now.
    fn repeated(&mut self) -> impl Iterator<Item = Value> {
        self.values.iter_mut().filter_map(|value| {
            value.periods = value.periods.saturating_add(1);
            is_due(value.periods).then(|| value.clone())
        })
    }

    /// The values requested by an advanced subscriber: a query on the token's own key requests all.
    fn asked(&self, query: &Query, token_key: &KeyExpr<'static>) -> Vec<Value> {
        let of_all = query.key_expr().as_str() == token_key.as_str();
        let range = query.parameters().get("_sn").map(numbers);
        let is_asked = |value: &&Value| {
            (of_all || query.key_expr().intersects(&value.cache_key))
                && range.is_none_or(|(from, to)| (from..=to).contains(&value.number))
        };
        self.values.iter().filter(is_asked).cloned().collect()
    }
}

/// Whether the number of a value is repeated in this period after it.
fn is_due(periods: u32) -> bool {
    periods.is_power_of_two() && (2..=LAST_PERIOD).contains(&periods)
}

impl Numbered for Mutex<Kept> {
    fn advance(&self, session: &Session) {
        let due: Vec<Value> = lock(self).repeated().collect();
        for value in due {
            let number = zenoh_ext::z_serialize(&value.number);
            let _ = session.put(value.cache_key, number).wait();
        }
    }
}

/// Answers an advanced subscriber.
fn answer(query: &Query, asked: &[Value], zid: ZenohId, encoding: Encoding) {
    for value in asked {
        let info = SourceInfo::new(EntityGlobalId::new(zid, value.source), value.number);
        let replied = query
            .reply(value.key.clone(), value.bytes.clone())
            .encoding(zenoh::bytes::Encoding::from(encoding.mime()))
            .timestamp(value.stamp)
            .source_info(info)
            .wait();
        if let Err(error) = replied {
            tracing::debug!(key = %value.key, %error, "its last value was asked for, and is not told");
        }
    }
}

/// The sequence numbers that a subscriber lacks: `3..7`, both ends included; either end may be omitted.
fn numbers(range: &str) -> (u32, u32) {
    let (from, to) = range.split_once("..").unwrap_or((range, range));
    (from.parse().unwrap_or(0), to.parse().unwrap_or(u32::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_a_goal_that_ended_is_repeated_ever_more_rarely_and_at_last_not_at_all() {
        let due: Vec<u32> = (1..2000).filter(|periods| is_due(*periods)).collect();
        assert_eq!(due, [2, 4, 8, 16, 32, 64, 128, 256]);
    }
}
