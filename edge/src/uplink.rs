//! Uplink. How much of its sensor data may the robot send? All of it, or the share that a narrow link carries without a queue.
//!
//! Messages beyond a link's capacity wait in a queue, and with them the few messages that a mission needs to drive the robot. The queueing
//! delay is the round trip of the heartbeats less the least one of late: the idea of LEDBAT (RFC 6817), here with increase and decrease in
//! turn, because the queue must empty now and then for its length to be known. The growth rate of the round trip gives the capacity: the
//! share of the data sent that does not add to the queue. A queue longer than any lease lasts is met with next to no data until it has drained.

use std::time::Duration;

use zenav_protocol::lease::LONGEST_ROUND_TRIP;
use zenav_protocol::time::Stamp;

use crate::settings::UplinkSettings;

/// Window over which the least round trip is taken, s: a delay of single heartbeats (a plan under way, a link that stalled) is not a queue.
const WINDOW: f64 = 1.0;
/// A least round trip that has grown counts as a change of the link after one to two of these, s.
const MEMORY: f64 = 60.0;
/// Share of the capacity used after a window that found a queue: the rest drains it.
const DECREASE: f64 = 0.6;
/// Fastest growth of the round trip that is believed, s/s: then a tenth of the data gets through.
const STEEPEST: f64 = 0.9;
/// Growth factor of the share for each window without a queue.
const INCREASE: f64 = 1.1;
/// The least share: one scan per 5 s of a lidar of 10 Hz.
const LEAST: f64 = 0.02;
/// After this many windows in a row with the same delay, to within this share of it, although less was sent, the delay is not a queue: the
/// link has become longer.
const SAME: (u32, f64) = (3, 0.2);
/// After this long without a measurement the share grows again, s: an operator who drives by hand sends no heartbeat echoes.
const UNMEASURED: f64 = 5.0;
/// The same after a queue was found, s: it has to drain first.
const DRAINED: f64 = 60.0;

/// The share of its sensors' messages that the robot sends.
#[derive(Clone, Debug)]
pub struct Uplink {
    settings: UplinkSettings,
    share: f64,
    /// Start of the present period, and the least round trip in it and in the period before, s.
    base: Option<(Stamp, f64, f64)>,
    window: Option<RoundTripWindow>,
    /// Earliest start of the next window.
    not_before: Stamp,
    /// The lease holder of the measurements: another one is reached over another path.
    holder: String,
    /// The run of windows that found a queue.
    full: Option<Full>,
    /// Time of the last measurement.
    last: Stamp,
    /// Earliest time at which the share grows without a measurement.
    grows_at: Stamp,
}

/// A run of windows that found a queue.
#[derive(Clone, Copy, Debug)]
struct Full {
    /// How many of them found the same delay.
    same: u32,
    wait: f64,
    /// The share before the first.
    share: f64,
}

/// The round trips of the last second.
#[derive(Clone, Copy, Debug)]
struct RoundTripWindow {
    begun: Stamp,
    first: f64,
    least: f64,
}

impl Uplink {
    /// A link that carries everything, until it is known to be narrower.
    #[must_use]
    pub fn new(settings: &UplinkSettings) -> Self {
        Self {
            settings: settings.clone(),
            share: 1.0,
            base: None,
            window: None,
            not_before: Stamp::ZERO,
            holder: String::new(),
            full: None,
            last: Stamp::ZERO,
            grows_at: Stamp::ZERO,
        }
    }

    /// The share of messages to send, above 0 to 1.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Advances time: without measurements the share grows again.
    pub fn elapse(&mut self, now: Stamp) {
        let silence = if self.full.is_some() { DRAINED } else { UNMEASURED };
        if self.share < 1.0 && now.secs_since(self.last) >= silence && now >= self.grows_at {
            self.share = (INCREASE * self.share).min(1.0);
            self.grows_at = now.plus_secs(WINDOW);
        }
    }

    /// A round trip to the holder of a lease was measured.
    pub fn measured(&mut self, now: Stamp, round_trip: Duration, holder: &str) {
        let round_trip = round_trip.as_secs_f64();
        self.last = now;
        if holder != self.holder {
            self.holder = holder.to_owned();
            (self.base, self.window, self.full) = (None, None, None);
        }
        let (since, least, before) = match self.base {
            Some((since, least, _)) if now.secs_since(since) > MEMORY => (now, round_trip, least),
            Some((since, least, before)) => (since, least.min(round_trip), before),
            None => (now, round_trip, f64::INFINITY),
        };
        self.base = Some((since, least, before));
        if now < self.not_before {
            return;
        }
        let window = self.window.get_or_insert(RoundTripWindow {
            begun: now,
            first: round_trip,
            least: round_trip,
        });
        window.least = window.least.min(round_trip);
        let secs = now.secs_since(window.begun);
        if secs < WINDOW {
            return;
        }
        let window = *window;
        self.window = None;
        // A link of that length carries no lease, whatever is sent: only a queue can become shorter.
        let is_hopeless = window.least >= LONGEST_ROUND_TRIP.as_secs_f64();
        let queued = if is_hopeless {
            f64::INFINITY
        } else {
            window.least - least.min(before)
        };
        if queued <= self.settings.longest_queue {
            self.full = None;
            self.share = (INCREASE * self.share).min(1.0);
            return;
        }
        let share = self.share;
        let full = self.full.get_or_insert(Full {
            same: 0,
            wait: queued,
            share,
        });
        let is_same = full.wait.is_finite() && (queued - full.wait).abs() <= SAME.1 * full.wait;
        (full.same, full.wait) = if is_same {
            (full.same + 1, full.wait)
        } else {
            (0, queued)
        };
        if full.same > SAME.0 {
            self.share = full.share;
            self.base = Some((now, window.least, f64::INFINITY));
            self.full = None;
            return;
        }
        let growth = ((round_trip - window.first) / secs).clamp(0.0, STEEPEST);
        // Data sent before still has to pass.
        self.not_before = now.plus_secs(round_trip);
        let kept = if is_hopeless { 0.0 } else { DECREASE * (1.0 - growth) };
        self.share = (kept * share).max(LEAST);
    }
}

/// Lets a share of messages through, evenly.
#[derive(Clone, Copy, Debug)]
pub struct Sieve(f64);

impl Default for Sieve {
    /// The first one passes.
    fn default() -> Self {
        Self(1.0)
    }
}

impl Sieve {
    /// Whether the next message is sent, where `share` (0 to 1) of them are.
    pub fn lets_through(&mut self, share: f64) -> bool {
        let credit = self.0 + share;
        let passes = credit >= 1.0;
        self.0 = if passes { (credit - 1.0).min(1.0) } else { credit };
        passes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A link that carries `rate` times the robot's full data, with a round trip of `delay` s, from a time (s) on: the share and the queue,
    /// s, at each beat of 0.1 s.
    fn drive(uplink: &mut Uplink, from: f64, link: (f64, f64), secs: f64) -> Vec<(f64, f64)> {
        drive_behind(uplink, from, link, 0.0, secs)
    }

    /// The same with a queue, s, at the beginning.
    fn drive_behind(
        uplink: &mut Uplink,
        from: f64,
        (rate, delay): (f64, f64),
        begun: f64,
        secs: f64,
    ) -> Vec<(f64, f64)> {
        let mut found: Vec<(f64, f64)> = Vec::new();
        for beat in 0..(10.0 * secs) as usize {
            let queue = found.last().map_or(begun, |(_, queue)| *queue);
            found.push((uplink.share(), (queue + 0.1 * (uplink.share() - rate) / rate).max(0.0)));
            // A beat shows the queue that the newest message to come through had ahead of it.
            let came = |(said, (_, queue)): &(usize, &(f64, f64))| 0.1 * (beat - said) as f64 + 1e-9 >= queue + delay;
            let newest = found.iter().enumerate().rev().find(came);
            if let Some((_, (_, queue))) = newest {
                let now = Stamp::from_secs(from + 0.1 * beat as f64);
                let round_trip = Duration::from_secs_f64(delay + queue).min(LONGEST_ROUND_TRIP);
                uplink.measured(now, round_trip, "mission");
            }
        }
        found
    }

    fn uplink() -> Uplink {
        Uplink::new(&UplinkSettings::default())
    }

    #[test]
    fn a_link_that_carries_everything_gets_everything_however_long_it_is() {
        for delay in [0.0, 0.3, 1.0, 5.0] {
            let found = drive(&mut uplink(), 0.0, (1.1, delay), 120.0);
            assert!(found.iter().all(|(share, _)| *share == 1.0), "{delay}");
        }
    }

    #[test]
    fn a_narrow_link_gets_what_it_carries_and_its_queue_stays_short() {
        for (rate, delay) in [(0.25, 0.01), (0.25, 0.3), (0.1, 0.05), (0.7, 0.1)] {
            let found = drive(&mut uplink(), 0.0, (rate, delay), 200.0);
            let settled = &found[600..];
            let mean = |of: fn(&(f64, f64)) -> f64| settled.iter().map(of).sum::<f64>() / settled.len() as f64;
            let (share, queue) = (mean(|found| found.0), mean(|found| found.1));
            assert!((0.6 * rate..1.05 * rate).contains(&share), "{rate} {delay}: {share}");
            assert!(queue < 0.3, "{rate} {delay}: {queue} s");
        }
    }

    #[test]
    fn a_queue_longer_than_any_lease_drains() {
        let mut uplink = uplink();
        // It was filled while nobody measured, and grows until the first message behind it comes through.
        let found = drive_behind(&mut uplink, 0.0, (0.28, 0.6), 30.0, 300.0);
        assert!(found[500].1 > 90.0);
        assert!(found[2000..].iter().all(|(_, queue)| *queue < 3.0));
        let share = found[2000..].iter().map(|(share, _)| share).sum::<f64>() / 1000.0;
        assert!(share > 0.15, "{share}");
    }

    #[test]
    fn a_long_queue_that_drains_is_no_longer_link() {
        let mut uplink = uplink();
        let mut now = 0.0;
        let mut window = |uplink: &mut Uplink, round_trip: f64| {
            for _ in 0..12 {
                now += 0.1;
                uplink.measured(Stamp::from_secs(now), Duration::from_secs_f64(round_trip), "mission");
            }
            // What was sent before has passed.
            now += round_trip;
            uplink.share()
        };
        assert_eq!(window(&mut uplink, 0.05), 1.0);
        // The first of these windows began before.
        window(&mut uplink, 10.0);
        for round_trip in [10.0, 9.0, 7.0, 5.0, 4.0, 3.0] {
            assert_eq!(window(&mut uplink, round_trip), LEAST, "{round_trip}");
        }
    }

    #[test]
    fn after_a_queue_the_share_waits_for_a_measurement() {
        let mut uplink = uplink();
        for beat in 0..30_u32 {
            let now = Stamp::from_secs(0.1 * f64::from(beat));
            uplink.measured(now, LONGEST_ROUND_TRIP, "mission");
        }
        assert_eq!(uplink.share(), LEAST);
        uplink.elapse(Stamp::from_secs(50.0));
        assert_eq!(uplink.share(), LEAST);
        uplink.elapse(Stamp::from_secs(70.0));
        assert!(uplink.share() > LEAST);
    }

    #[test]
    fn a_link_that_widens_is_used_again() {
        let mut uplink = uplink();
        drive(&mut uplink, 0.0, (0.2, 0.05), 60.0);
        assert!(uplink.share() < 0.5);
        drive(&mut uplink, 60.0, (2.0, 0.05), 60.0);
        assert!((uplink.share() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_link_that_becomes_longer_is_not_taken_for_a_queue() {
        let mut uplink = uplink();
        drive(&mut uplink, 0.0, (2.0, 0.005), 30.0);
        let found = drive(&mut uplink, 30.0, (2.0, 0.4), 40.0);
        assert!(found[150..].iter().all(|(share, _)| *share == 1.0), "{:?}", found[150]);
        // Another lease holder is reached over another path, from the first message on.
        for beat in 0..50_u32 {
            uplink.measured(
                Stamp::from_secs(80.0 + 0.1 * f64::from(beat)),
                Duration::from_secs(2),
                "another",
            );
            assert!((uplink.share() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn without_measurements_the_share_grows_again() {
        let mut uplink = uplink();
        drive(&mut uplink, 0.0, (0.1, 0.05), 60.0);
        let before = uplink.share();
        let grown = |uplink: &mut Uplink, secs: u32| {
            (0..50 * secs).for_each(|tick| uplink.elapse(Stamp::from_secs(60.0 + 0.02 * f64::from(tick))));
            uplink.share()
        };
        assert_eq!(grown(&mut uplink, 4), before);
        assert!((grown(&mut uplink, 130) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn heartbeats_that_were_held_up_once_mean_nothing() {
        let mut uplink = uplink();
        for beat in 0..600_u32 {
            let late = if beat % 50 < 4 { 2.0 } else { 0.05 };
            uplink.measured(
                Stamp::from_secs(0.1 * f64::from(beat)),
                Duration::from_secs_f64(late),
                "mission",
            );
            assert!((uplink.share() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn a_sieve_lets_its_share_through() {
        for share in [1.0, 0.5, 0.3, 0.02] {
            let mut sieve = Sieve::default();
            let passed = (0..1000).filter(|_| sieve.lets_through(share)).count() as f64;
            assert!((passed - 1000.0 * share).abs() <= 2.0, "{share}: {passed}");
        }
        let mut first = Sieve::default();
        assert!(first.lets_through(0.02));
    }
}
