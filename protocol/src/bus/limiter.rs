//! Limiter. Which samples of a subscription are dropped because they come too fast? Applies [`RateLimit`] to Zenoh's samples.
//!
//! A source is the session that stamped the sample: its publisher, or the first router for a publisher that stamps nothing, or whose clock
//! leads that router's by more than Zenoh tolerates (such publishers share a source). The source is the publisher's claim: a program that
//! copies another's can cost it its messages. Where access is controlled, only the members that may write the key can do so.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use zenoh::key_expr::KeyExpr;
use zenoh::sample::Sample;
use zenoh::time::TimestampId;
use zenoh::{Session, Wait};

use super::Bus;
use super::publish::kept;
use super::rate::{Admission, FasterTime, RateLimit};
use super::subscribe::decode_sample;
use crate::messages::SimClock;
use crate::topics::{SIM_CLOCK, Untyped};

/// The time of a session by which rates are limited: wall time, or simulated time where it runs faster.
#[derive(Debug)]
pub(super) struct Pace {
    start: Instant,
    simulated: Mutex<FasterTime>,
    is_following: AtomicBool,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            start: Instant::now(),
            simulated: Mutex::default(),
            is_following: AtomicBool::new(false),
        }
    }
}

impl Pace {
    fn now(&self) -> Duration {
        lock(&self.simulated).at(self.start.elapsed())
    }

    /// Follows the simulated time on the bus until the session ends.
    fn follow(self: &Arc<Self>, session: &Session) {
        if self.is_following.swap(true, Ordering::Relaxed) {
            return;
        }
        let pace = Arc::clone(self);
        let heard = move |sample: Sample| {
            if let Ok(SimClock { stamp }) = decode_sample(&sample, SIM_CLOCK.decode, SIM_CLOCK.max_bytes) {
                lock(&pace.simulated).hear(pace.start.elapsed(), stamp);
            }
        };
        let followed = session
            .declare_subscriber(SIM_CLOCK.key(&[]))
            .callback(heard)
            .background()
            .wait();
        if let Err(error) = followed {
            tracing::debug!(%error, "the simulated time is not followed");
        }
    }
}

/// Limits the rates of one subscription.
pub(super) struct Limiter {
    limit: Mutex<RateLimit<KeyExpr<'static>, TimestampId>>,
    rate: u16,
    pace: Arc<Pace>,
}

impl Limiter {
    /// The limiter of a topic; `None` if it is never limited.
    pub(super) fn of(bus: &Bus, topic: Untyped) -> Option<Self> {
        let rate = topic.rate?;
        bus.pace.follow(&bus.session);
        Some(Self {
            limit: Mutex::new(RateLimit::new(rate, kept(topic.qos))),
            rate,
            pace: Arc::clone(&bus.pace),
        })
    }

    /// Whether a sample is in time; the first of a burst that is not is logged. A sample on a key with wildcards never is: the sender could
    /// make up any number of such keys, each with a bucket of its own.
    pub(super) fn admits(&self, sample: &Sample) -> bool {
        if sample.key_expr().as_str().contains('*') {
            return false;
        }
        let source = sample.timestamp().map(|stamp| *stamp.get_id());
        let admission = lock(&self.limit).admit(sample.key_expr().clone(), source, self.pace.now());
        if admission == (Admission::TooFast { is_first: true }) {
            let source = source.map(|id| id.to_string()).unwrap_or_default();
            tracing::warn!(
                key = %sample.key_expr(),
                source,
                rate = self.rate,
                "messages come far faster than the rate of their key: dropped"
            );
        }
        admission == Admission::Passes
    }
}

/// Locks, also after a panic of another holder.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
