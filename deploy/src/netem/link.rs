//! Impaired link. Computes when bytes sent now arrive.
//!
//! One direction of a link: everything arrives in order, `delay` plus jitter after it was sent, limited by the rate, and not while the link
//! stalls. Bytes of a connection wait for the end of a cut, and before a full queue; datagrams are lost there. Deterministic for a given seed
//! and sequence of calls.

use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// Longest queueing time before a rate-limited link; typical of token buckets configured with `tc`.
const LONGEST_QUEUE: Duration = Duration::from_millis(400);

/// Impairment of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Impairment {
    /// Delay each way.
    pub delay: Duration,
    /// Largest additional delay, drawn for each piece from a uniform distribution.
    pub jitter: Duration,
    /// Bytes per second; `None`: unlimited.
    pub rate: Option<f64>,
    /// Share of the datagrams that are lost, 0 to 1.
    pub loss: f64,
    /// Length of a stall, in which nothing passes...
    pub stall: Duration,
    /// ...and the mean time between stalls (exponential). `None`: no stalls.
    pub every: Option<Duration>,
}

/// A cut: start, and length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cut {
    pub at: Duration,
    pub lasts: Duration,
}

/// A change of the impairment, with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Change {
    pub at: Duration,
    pub to: Impairment,
}

/// One direction of a link. All times count from the start of the program.
#[derive(Clone, Debug)]
pub(super) struct Link {
    /// In order of time, the first at zero.
    changes: Vec<Change>,
    cuts: Vec<Cut>,
    rng: Pcg64Mcg,
    /// When the last byte left the queue, and when it arrives.
    entered: Duration,
    arrived: Duration,
    /// Start of the next stall.
    next_stall: Option<Duration>,
}

impl Link {
    pub(super) fn new(changes: Vec<Change>, cuts: Vec<Cut>, seed: u64) -> Self {
        Self {
            changes,
            cuts,
            rng: Pcg64Mcg::seed_from_u64(seed),
            entered: Duration::ZERO,
            arrived: Duration::ZERO,
            next_stall: None,
        }
    }

    /// Arrival time of bytes sent now.
    pub(super) fn arrival(&mut self, now: Duration, bytes: usize) -> Duration {
        if self.arrived == Duration::MAX {
            // Nothing arrives behind bytes held by an endless cut.
            return Duration::MAX;
        }
        let uncut = self.arrival_without_cuts(now, bytes);
        self.arrived = self.after_cuts(uncut);
        self.arrived
    }

    /// Arrival time of a datagram sent now; `None` if it is lost: at random, before a full queue, or in a cut.
    pub(super) fn datagram_arrival(&mut self, now: Duration, bytes: usize) -> Option<Duration> {
        let is_lost = self.rng.random::<f64>() < self.impairment(now).loss;
        if is_lost || self.is_cut(now) || !self.full_for(now).is_zero() {
            return None;
        }
        let arrival = self.arrival_without_cuts(now, bytes);
        if self.is_cut(arrival) {
            return None;
        }
        self.arrived = arrival;
        Some(arrival)
    }

    fn arrival_without_cuts(&mut self, now: Duration, bytes: usize) -> Duration {
        let impairment = self.impairment(now);
        let takes = impairment.rate.map_or(0.0, |rate| bytes as f64 / rate.max(1.0));
        self.entered = self.entered.max(now) + Duration::from_secs_f64(takes);
        let jitter = impairment.jitter.mul_f64(self.rng.random::<f64>());
        let arrival = (self.entered + impairment.delay + jitter).max(self.arrived);
        self.after_stalls(arrival, &impairment)
    }

    /// Time until the queue before the link has room again; until then the sender is blocked, as by any full buffer.
    pub(super) fn full_for(&self, now: Duration) -> Duration {
        self.entered.saturating_sub(now + LONGEST_QUEUE)
    }

    /// Most bytes to take at once: what passes within a quarter of the longest queue.
    pub(super) fn piece(&self, now: Duration, most: usize) -> usize {
        let rate = self.impairment(now).rate.unwrap_or(f64::INFINITY);
        ((0.25 * LONGEST_QUEUE.as_secs_f64() * rate) as usize).clamp(1, most)
    }

    fn impairment(&self, now: Duration) -> Impairment {
        let last = self.changes.iter().rev().find(|change| change.at <= now);
        last.map(|change| change.to).unwrap_or_default()
    }

    /// The first time, from `from` on, at which the link is not cut.
    fn after_cuts(&self, from: Duration) -> Duration {
        let mut at = from;
        // A cut may end within another one.
        for _ in 0..=self.cuts.len() {
            let Some(cut) = self.cut(at) else { break };
            at = cut.at.saturating_add(cut.lasts);
        }
        at
    }

    fn is_cut(&self, at: Duration) -> bool {
        self.cut(at).is_some()
    }

    fn cut(&self, at: Duration) -> Option<&Cut> {
        self.cuts.iter().find(|cut| at >= cut.at && at - cut.at < cut.lasts)
    }

    fn after_stalls(&mut self, from: Duration, impairment: &Impairment) -> Duration {
        let Some(every) = impairment.every.filter(|every| !every.is_zero()) else {
            self.next_stall = None;
            return from;
        };
        loop {
            let begins = match self.next_stall {
                Some(begins) => begins,
                None => from + self.pause(every),
            };
            self.next_stall = Some(begins);
            if from < begins {
                return from;
            }
            let ends = begins + impairment.stall;
            if from < ends {
                return ends;
            }
            self.next_stall = Some(ends + self.pause(every));
        }
    }

    fn pause(&mut self, mean: Duration) -> Duration {
        let uniform: f64 = self.rng.random();
        mean.mul_f64(-(1.0 - uniform).max(1e-12_f64).ln())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(millis: u64) -> Duration {
        Duration::from_millis(millis)
    }

    fn link(to: Impairment, cuts: &[Cut]) -> Link {
        let begins = Change { at: Duration::ZERO, to };
        Link::new(vec![begins], cuts.to_vec(), 7)
    }

    #[test]
    fn everything_arrives_in_order_after_the_delay_and_at_most_the_jitter_more() {
        let slow = Impairment {
            delay: ms(80),
            jitter: ms(20),
            ..Impairment::default()
        };
        let (mut link, mut twin) = (link(slow, &[]), link(slow, &[]));
        let mut last = Duration::ZERO;
        for nth in 0..1000 {
            let now = ms(nth);
            let arrival = link.arrival(now, 100);
            assert!(arrival >= now + ms(80) && arrival <= now + ms(100) && arrival >= last);
            assert_eq!(arrival, twin.arrival(now, 100), "the same from the same seed");
            last = arrival;
        }
    }

    #[test]
    fn behind_a_cut_without_an_end_nothing_arrives_whatever_else_the_link_does() {
        let stalls = Impairment {
            stall: ms(500),
            every: Some(ms(10)),
            ..Impairment::default()
        };
        let cut = Cut {
            at: ms(100),
            lasts: Duration::MAX,
        };
        let mut link = link(stalls, &[cut]);
        let arrivals: Vec<Duration> = (0..20).map(|nth| link.arrival(ms(100 + nth), 100)).collect();
        assert_eq!(arrivals, [Duration::MAX; 20]);
    }

    #[test]
    fn a_rate_lets_so_many_bytes_a_second_through() {
        let narrow = Impairment {
            rate: Some(32_000.0),
            ..Impairment::default()
        };
        let mut link = link(narrow, &[]);
        let arrivals: Vec<Duration> = (0..10).map(|_| link.arrival(Duration::ZERO, 3200)).collect();
        assert_eq!((arrivals[0], arrivals[9]), (ms(100), ms(1000)));
        assert_eq!(link.full_for(ms(100)), ms(500), "900 ms of bytes wait, 400 ms fit");
        assert_eq!(link.full_for(ms(700)), ms(0));
        assert_eq!(link.arrival(ms(5000), 3200), ms(5100), "what was not used is not kept");
        assert_eq!(
            link.piece(ms(5000), 16_384),
            3200,
            "pieces do not make the queue much longer"
        );
    }

    #[test]
    fn nothing_passes_during_a_cut_and_everything_after_it() {
        let cuts = [(1000, 500), (1500, 100)].map(|(at, lasts)| Cut {
            at: ms(at),
            lasts: ms(lasts),
        });
        let mut link = link(Impairment::default(), &cuts);
        let arrivals = [999, 1000, 1400, 1599, 1600].map(|now| link.arrival(ms(now), 1));
        assert_eq!(arrivals, [999, 1600, 1600, 1600, 1600].map(ms));
    }

    #[test]
    fn datagrams_are_lost_at_random_before_a_full_queue_and_in_cuts() {
        let lossy = Impairment {
            loss: 0.2,
            ..Impairment::default()
        };
        let mut random = link(lossy, &[]);
        let lost = (0..10_000)
            .filter(|now| random.datagram_arrival(ms(*now), 100).is_none())
            .count();
        // Standard deviation of 40.
        assert!((1800..2200).contains(&lost), "{lost}");

        let narrow = Impairment {
            rate: Some(10_000.0),
            ..Impairment::default()
        };
        let mut full = link(narrow, &[]);
        let arrived = (0..20).filter(|_| full.datagram_arrival(ms(0), 1000).is_some()).count();
        assert_eq!(arrived, 5, "400 ms of bytes fit, and one more datagram");

        let slow = Impairment {
            delay: ms(100),
            ..Impairment::default()
        };
        let cut = Cut {
            at: ms(1000),
            lasts: ms(500),
        };
        let mut cut = link(slow, &[cut]);
        let arrivals = [899, 900, 1000, 1499, 1500].map(|now| cut.datagram_arrival(ms(now), 1));
        assert_eq!(arrivals, [Some(ms(999)), None, None, None, Some(ms(1600))]);
    }

    #[test]
    fn stalls_last_as_long_as_they_should_and_come_as_often() {
        let stalling = Impairment {
            stall: ms(200),
            every: Some(ms(2000)),
            ..Impairment::default()
        };
        let mut link = link(stalling, &[]);
        let late = (0..1_000_000_u64)
            .filter(|now| link.arrival(ms(*now), 1) > ms(*now))
            .count();
        // 200 ms of every 2.2 s: 91,000, with a standard deviation of 4,200.
        assert!((78_000..104_000).contains(&late), "{late}");
    }

    #[test]
    fn a_script_changes_the_link_at_its_time() {
        let changes = [(0, 10), (1000, 500)].map(|(at, delay)| Change {
            at: ms(at),
            to: Impairment {
                delay: ms(delay),
                ..Impairment::default()
            },
        });
        let mut link = Link::new(changes.to_vec(), Vec::new(), 1);
        assert_eq!(link.arrival(ms(999), 1), ms(1009));
        assert_eq!(link.arrival(ms(1000), 1), ms(1500));
    }
}
