//! Rates. Which messages come faster than their key allows?
//!
//! The key table states how often a writer publishes on a key at most. A receiver tolerates [`TOLERANCE`] times that rate, and [`STALL`]
//! seconds of it at once; further messages are dropped. There is a [`TokenBucket`] for each source of each key: a flood costs another
//! source of the same key nothing, unless it claims to be that source.
//!
//! Time is passed in: the receiver's wall time, or simulated time where that runs faster ([`FasterTime`]), so that a simulation at twenty
//! times real time loses nothing.

use std::collections::HashMap;
use std::hash::Hash;
use std::time::Duration;

use super::clock::Follower;
use crate::time::Stamp;
use crate::token_bucket::TokenBucket;

/// A source may exceed the rate of its key by this factor all the time.
const TOLERANCE: f64 = 4.0;
/// Messages of this time at the key's rate may come at once, as from a link that was stalled, s. A source that is silent for as long may
/// lose its bucket to another.
const STALL: f64 = 10.0;
/// Most sources of a key with a bucket of their own; further ones share one.
const MAX_SOURCES: usize = 8;
/// Most keys with buckets of their own; further ones share one.
const MAX_KEYS: usize = 4096;
/// Least time between two searches for keys that can be forgotten.
const SWEEP: Duration = Duration::from_secs(1);
/// Least wall time over which wall time and simulated time are compared: a link delivers several stamps at once.
const STRETCH: Duration = Duration::from_millis(100);

/// What happens to a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// It is passed on.
    Passes,
    /// It is dropped.
    TooFast {
        /// Whether the source had kept to its rate until now.
        is_first: bool,
    },
}

/// Limits the sources `S` of all keys `K` of one subscription.
#[derive(Debug)]
pub(super) struct RateLimit<K, S> {
    limit: Limit,
    keys: HashMap<K, Vec<(Option<S>, Bucket)>>,
    /// Of all keys beyond [`MAX_KEYS`].
    others: Bucket,
    next_sweep: Duration,
}

/// Size of a bucket and its inflow, messages and messages a second.
#[derive(Clone, Copy, Debug)]
struct Limit {
    burst: f64,
    per_sec: f64,
}

#[derive(Clone, Copy, Debug)]
struct Bucket {
    tokens: TokenBucket,
    /// Whether a message was dropped since the bucket was last full.
    is_over: bool,
}

impl Bucket {
    fn full(limit: Limit, now: Duration) -> Self {
        Self {
            tokens: TokenBucket::full(limit.per_sec, limit.burst, now),
            is_over: false,
        }
    }

    /// Whether it is as good as a new one, and its source has been silent for a while.
    fn is_idle(&self, now: Duration) -> bool {
        self.tokens.silence(now).as_secs_f64() >= STALL && self.tokens.is_full(now)
    }

    fn take(&mut self, now: Duration) -> Admission {
        if self.tokens.is_full(now) {
            self.is_over = false;
        }
        if self.tokens.take(now) {
            return Admission::Passes;
        }
        let is_first = !std::mem::replace(&mut self.is_over, true);
        Admission::TooFast { is_first }
    }
}

impl<K: Hash + Eq, S: PartialEq> RateLimit<K, S> {
    /// Limits each source to a multiple of `rate` messages a second on each key; `kept` further ones may come at once, from the writer's
    /// cache.
    pub(super) fn new(rate: u16, kept: usize) -> Self {
        let rate = f64::from(rate);
        let limit = Limit {
            burst: STALL * rate + kept as f64,
            per_sec: TOLERANCE * rate,
        };
        Self {
            limit,
            keys: HashMap::new(),
            others: Bucket::full(limit, Duration::ZERO),
            next_sweep: Duration::ZERO,
        }
    }

    /// Takes a message that arrived at a time; without a source, all such messages of the key count as one source's.
    pub(super) fn admit(&mut self, key: K, source: Option<S>, now: Duration) -> Admission {
        let limit = self.limit;
        if self.keys.len() >= MAX_KEYS && now >= self.next_sweep && !self.keys.contains_key(&key) {
            self.next_sweep = now + SWEEP;
            self.keys
                .retain(|_, sources| !sources.iter().all(|(_, bucket)| bucket.is_idle(now)));
        }
        if self.keys.len() >= MAX_KEYS && !self.keys.contains_key(&key) {
            return self.others.take(now);
        }
        let sources = self.keys.entry(key).or_default();
        let own = sources.iter().position(|(known, _)| *known == source);
        let place = own.unwrap_or_else(|| place_for(sources, source, limit, now));
        sources[place].1.take(now)
    }
}

/// The place of a new source's bucket: its own, or the shared one.
fn place_for<S: PartialEq>(
    sources: &mut Vec<(Option<S>, Bucket)>,
    source: Option<S>,
    limit: Limit,
    now: Duration,
) -> usize {
    if sources.len() >= MAX_SOURCES {
        sources.retain(|(_, bucket)| !bucket.is_idle(now));
    }
    let source = source.filter(|_| sources.len() < MAX_SOURCES);
    let shared = sources.iter().position(|(known, _)| *known == source);
    shared.unwrap_or_else(|| {
        sources.push((source, Bucket::full(limit, now)));
        sources.len() - 1
    })
}

/// Time that has passed: in each stretch, the longer of wall time and simulated time.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FasterTime {
    follower: Follower,
    /// Wall time and simulated time at which the present stretch began.
    since: Option<(Duration, Stamp)>,
    /// The newest simulated time.
    simulated: Stamp,
    /// Lead of simulated time over wall time in all earlier stretches.
    ahead: Duration,
}

impl FasterTime {
    /// Takes a stamp of the simulation that arrived at a wall time.
    pub(super) fn hear(&mut self, wall: Duration, stamp: Stamp) {
        let Some(now) = self.follower.follow(stamp) else {
            return;
        };
        self.simulated = now;
        let is_over = |(then, _): (Duration, Stamp)| wall.saturating_sub(then) >= STRETCH;
        if self.since.is_none_or(is_over) {
            self.ahead = self.ahead.saturating_add(self.lead(wall));
            self.since = Some((wall, now));
        }
    }

    /// The time that has passed when this much wall time has.
    pub(super) fn at(&self, wall: Duration) -> Duration {
        wall.saturating_add(self.ahead).saturating_add(self.lead(wall))
    }

    /// Lead of simulated time in the present stretch.
    fn lead(&self, wall: Duration) -> Duration {
        let Some((then, before)) = self.since else {
            return Duration::ZERO;
        };
        self.simulated.since(before).saturating_sub(wall.saturating_sub(then))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "zenav/r1/edge/state";
    /// Messages a second.
    const RATE: u16 = 10;

    fn limit() -> RateLimit<&'static str, u8> {
        RateLimit::new(RATE, 0)
    }

    /// Number of messages that pass when a source sends `rate` a second from one time to another, s.
    fn passed(limit: &mut RateLimit<&'static str, u8>, source: u8, rate: u32, (from, to): (u32, u32)) -> usize {
        (from * rate..to * rate)
            .map(|message| Duration::from_secs_f64(f64::from(message) / f64::from(rate)))
            .filter(|now| limit.admit(KEY, Some(source), *now) == Admission::Passes)
            .count()
    }

    #[test]
    fn a_flood_of_ten_times_the_rate_is_cut_to_four_times_and_another_source_loses_nothing() {
        let mut limit = limit();
        let mut counts = [0, 0];
        for second in 0..100 {
            counts[0] += passed(&mut limit, 0, 100, (second, second + 1));
            counts[1] += passed(&mut limit, 1, 10, (second, second + 1));
        }
        // 10 s at the key's rate, and four times the rate for 100 s.
        let tolerated = 10 * 10 + 4 * 10 * 100;
        assert!((tolerated - 5..=tolerated).contains(&counts[0]), "{counts:?}");
        assert_eq!(counts[1], 1000);
    }

    #[test]
    fn four_times_the_rate_passes_for_ever() {
        assert_eq!(passed(&mut limit(), 0, 40, (0, 1000)), 40_000);
    }

    #[test]
    fn what_a_stalled_link_delivers_at_once_passes_with_all_that_the_writer_kept() {
        let mut limit = RateLimit::<_, u8>::new(RATE, 256);
        let at_once = (0..1000).filter(|_| limit.admit(KEY, None, Duration::ZERO) == Admission::Passes);
        assert_eq!(at_once.count(), 100 + 256);
    }

    #[test]
    fn each_burst_is_told_once() {
        let mut limit = limit();
        let mut told = Vec::new();
        for message in 0..3_000_u64 {
            // 1000 a second, with a pause of 10 s after the first and the second 1000.
            let now = Duration::from_millis(message + 10_000 * (message / 1000));
            if limit.admit(KEY, Some(0), now) == (Admission::TooFast { is_first: true }) {
                told.push(message / 1000);
            }
        }
        assert_eq!(told, [0, 1, 2]);
    }

    #[test]
    fn sources_made_up_by_a_flood_share_a_bucket_and_known_ones_keep_theirs() {
        let mut limit = RateLimit::<_, u32>::new(RATE, 0);
        assert_eq!(limit.admit(KEY, Some(0), Duration::ZERO), Admission::Passes);
        let made_up =
            (1..100_000).filter(|source| limit.admit(KEY, Some(*source), Duration::ZERO) == Admission::Passes);
        // Seven spend one message each, and the rest share a bucket.
        assert_eq!(made_up.count(), 7 + 100);
        let own = (0..1000).filter(|_| limit.admit(KEY, Some(0), Duration::ZERO) == Admission::Passes);
        assert_eq!(own.count(), 99);
    }

    #[test]
    fn keys_from_outside_do_not_fill_the_memory_and_old_ones_are_forgotten() {
        let mut limit = RateLimit::<_, u8>::new(RATE, 0);
        let passes = (0..2 * MAX_KEYS).filter(|key| limit.admit(*key, None, Duration::ZERO) == Admission::Passes);
        assert_eq!(passes.count(), MAX_KEYS + 100);
        assert_eq!(limit.keys.len(), MAX_KEYS);
        assert_eq!(
            limit.admit(2 * MAX_KEYS, None, Duration::from_secs(60)),
            Admission::Passes
        );
        assert_eq!(limit.keys.len(), 1);
    }

    /// Time that has passed after ten seconds of wall time of a simulation at this speed, whose messages come `at_once` at a time, s.
    fn after_ten_seconds(speed: f64, at_once: u32) -> f64 {
        let mut time = FasterTime::default();
        for message in 0..=500_u32 {
            let wall = Duration::from_millis(20 * u64::from(message.next_multiple_of(at_once)));
            time.hear(wall, Stamp::from_secs(100.0 + 0.02 * speed * f64::from(message)));
        }
        time.at(Duration::from_secs(10)).as_secs_f64()
    }

    #[test]
    fn a_fast_simulation_leads_and_a_slow_one_does_not_hold_up() {
        for (speed, passed) in [(0.2, 10.0), (1.0, 10.0), (20.0, 200.0)] {
            let time = after_ten_seconds(speed, 1);
            assert!((time - passed).abs() < 0.05 * passed, "{speed}: {time}");
        }
        let jittery = after_ten_seconds(1.0, 4);
        assert!((10.0..12.0).contains(&jittery), "{jittery}");
    }

    #[test]
    fn a_single_stamp_of_the_far_future_raises_no_limit() {
        let mut time = FasterTime::default();
        for second in 0..10_u32 {
            time.hear(Duration::from_secs(second.into()), Stamp::from_secs(f64::from(second)));
            time.hear(Duration::from_secs(second.into()), Stamp::from_secs(1e9));
        }
        assert!(time.at(Duration::from_secs(10)) < Duration::from_secs(11));
    }
}
