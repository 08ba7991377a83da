//! Repeated numbers. How does a subscriber notice that it lost the last value of a source?
//!
//! Advanced publishers number their values, so a gap shows with the next one. If there is no next one for long, only a repetition of the last
//! number shows that a value was lost. Zenoh's own publisher repeats it at a fixed period for as long as it lives, or once: with 300
//! robots that was a quarter of the router's work. Values are lost where a link is cut; a link that stays cut is closed, and a
//! new one brings all last values. So a number is repeated every [`PERIOD`] for longer than that takes, and every [`RARELY`] periods after that.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use zenoh::pubsub::Publisher;
use zenoh::session::EntityId;
use zenoh::{Session, Wait};

use super::limiter::lock;

/// Shortest pause between two repetitions: the delay until the loss of a last value is noticed.
const PERIOD: Duration = Duration::from_millis(500);
/// A number is repeated in each of these periods after its value: for twice the time after which a silent link is closed.
const EACH: u32 = 8;
/// After that in each of this many periods, every 8 s: in case a late subscriber was not told of the source.
const RARELY: u32 = 16;
/// Zenoh's own ids are below.
const FIRST_ID: EntityId = 1 << 31;

/// A source of numbered values.
pub(super) trait Numbered: Send + Sync {
    /// Advances by one period, and repeats the numbers that are due. A failure is harmless: they are repeated again.
    fn advance(&self, session: &Session);
}

/// The sources of a session. One task serves all of them.
#[derive(Debug, Default)]
pub(super) struct Repeats {
    sources: Mutex<Vec<Weak<dyn Numbered>>>,
    /// Number of ids given away by [`Self::id`].
    ids: AtomicU32,
}

impl Repeats {
    /// Begins to repeat the numbers of a session's sources, until the session is closed. Only in a Tokio runtime.
    pub(super) fn begin(session: &Arc<Session>) -> Arc<Self> {
        let repeats = Arc::new(Self::default());
        let (session, sources) = (Arc::downgrade(session), Arc::downgrade(&repeats));
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(PERIOD).await;
                let (Some(session), Some(sources)) = (session.upgrade(), sources.upgrade()) else {
                    return;
                };
                if session.is_closed() {
                    return;
                }
                for source in sources.alive() {
                    source.advance(&session);
                }
            }
        });
        repeats
    }

    /// An id for a source that Zenoh does not know, above those that it assigns itself. Unique in the session: advanced subscribers tell sources
    /// apart by session and id alone, whatever their keys.
    pub(super) fn id(&self) -> EntityId {
        let given = self.ids.fetch_add(1, Ordering::Relaxed);
        FIRST_ID | given
    }

    /// Adds a source for as long as it lives.
    pub(super) fn add(&self, source: Weak<dyn Numbered>) {
        lock(&self.sources).push(source);
    }

    fn alive(&self) -> Vec<Arc<dyn Numbered>> {
        let mut sources = lock(&self.sources);
        sources.retain(|source| source.strong_count() > 0);
        sources.iter().filter_map(Weak::upgrade).collect()
    }
}

/// The last number of an advanced publisher, and where its subscribers expect it repeated.
pub(super) struct LastNumber {
    publisher: Publisher<'static>,
    count: Mutex<Count>,
}

/// Number of values sent, and of periods since the last one.
#[derive(Default)]
struct Count {
    values: u32,
    periods: u32,
}

impl LastNumber {
    /// Of a source without values yet.
    pub(super) fn new(publisher: Publisher<'static>) -> Arc<Self> {
        Arc::new(Self {
            publisher,
            count: Mutex::default(),
        })
    }

    /// A value with the next number was sent.
    pub(super) fn sent(&self) {
        lock(&self.count).sent();
    }
}

impl Numbered for LastNumber {
    fn advance(&self, _: &Session) {
        let due = lock(&self.count).advance();
        if let Some(number) = due {
            let _ = self.publisher.put(zenoh_ext::z_serialize(&number)).wait();
        }
    }
}

impl Count {
    fn sent(&mut self) {
        self.values = self.values.wrapping_add(1);
        self.periods = 0;
    }

    /// Advances by one period; the last number, if it is repeated now.
    fn advance(&mut self) -> Option<u32> {
        let number = self.values.checked_sub(1)?;
        self.periods = self.periods.saturating_add(1);
        (self.periods <= EACH || self.periods.is_multiple_of(RARELY)).then_some(number)
    }
}

/// The key on which a source announces itself, is asked for its values, and repeats its numbers: that of Zenoh's advanced publishers.
pub(super) fn announced(key: &str, zid: impl std::fmt::Display, source: u32) -> String {
    format!("{key}/@adv/pub/{zid}/{source}/_")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::session::LEASE_MS;

    #[test]
    fn a_number_is_repeated_often_while_a_cut_link_may_heal_then_rarely_but_for_good() {
        let mut count = Count::default();
        let repeated = |count: &mut Count, periods: u32| -> Vec<(u32, u32)> {
            let one = |period| count.advance().map(|number| (period, number));
            (1..=periods).filter_map(one).collect()
        };
        assert!(PERIOD * EACH >= Duration::from_millis(2 * LEASE_MS));
        assert!(
            repeated(&mut count, 16).is_empty(),
            "without a value there is nothing to repeat"
        );
        for number in 0..2 {
            count.sent();
            let due = [1, 2, 3, 4, 5, 6, 7, 8, 16, 32, 48].map(|period| (period, number));
            assert_eq!(repeated(&mut count, 63), due);
        }
    }

    #[test]
    fn a_source_that_ended_is_forgotten() {
        struct Source;
        impl Numbered for Source {
            fn advance(&self, _: &Session) {}
        }
        let (repeats, source) = (Repeats::default(), Arc::new(Source));
        let weak: Weak<Source> = Arc::downgrade(&source);
        repeats.add(weak);
        assert_eq!(repeats.alive().len(), 1);
        drop(source);
        assert_eq!(repeats.alive().len(), 0);
        assert!(lock(&repeats.sources).is_empty());
    }
}
