//! Timing of sensors. When a sensor measures, which readings are lost, and when the others arrive.

use std::collections::VecDeque;

use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;
use zenav_protocol::time::Stamp;

use crate::faults::Fault;

/// Whether a reading is lost. A sensor without losses draws no random number.
pub(super) fn is_lost(rng: &mut Pcg64Mcg, dropout: f64, fault: &Fault) -> bool {
    let dropout = fault.dropout(dropout);
    fault.is_dead || (dropout > 0.0 && rng.random::<f64>() < dropout)
}

/// Readings in transit.
#[derive(Clone, Debug)]
pub struct Delay<T> {
    latency: f64,
    waiting: VecDeque<(Stamp, T)>,
}

impl<T> Delay<T> {
    /// Empty; every reading takes `latency` seconds.
    #[must_use]
    pub fn new(latency: f64) -> Self {
        Self {
            latency,
            waiting: VecDeque::new(),
        }
    }

    /// Sends a reading that was measured now, with a further delay of `late` seconds; returns the reading that arrives now, the latest if
    /// there are several. No reading overtakes an earlier one.
    pub fn pass(&mut self, now: Stamp, reading: Option<T>, late: f64) -> Option<T> {
        let latency = self.latency + late;
        if latency <= 0.0 && self.waiting.is_empty() {
            return reading;
        }
        if let Some(reading) = reading {
            self.waiting.push_back((now.plus_secs(latency), reading));
        }
        let mut arrived = None;
        while self.waiting.front().is_some_and(|(due, _)| *due <= now) {
            arrived = self.waiting.pop_front().map(|(_, reading)| reading);
        }
        arrived
    }
}

/// Schedule of a sensor: it measures at multiples of its period, at the first step at or after each.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    rate_hz: f64,
    next: Stamp,
}

impl Schedule {
    /// The first reading is at time zero.
    #[must_use]
    pub fn new(rate_hz: f64) -> Self {
        Self {
            rate_hz,
            next: Stamp::ZERO,
        }
    }

    /// Time at which the next reading is due.
    #[must_use]
    pub fn next(&self) -> Stamp {
        self.next
    }

    /// Whether a reading is due.
    pub fn due(&mut self, now: Stamp) -> bool {
        if now < self.next {
            return false;
        }
        // The small offset keeps a period that is a multiple of the step from slipping by rounding.
        let passed = (now.as_secs() * self.rate_hz + 1e-9).floor();
        self.next = Stamp::from_secs((passed + 1.0) / self.rate_hz);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_of_ten_hertz_gives_ten_readings_a_second() {
        let mut schedule = Schedule::new(10.0);
        let due: Vec<u64> = (0..100).filter(|tick| schedule.due(Stamp(tick * 20_000_000))).collect();
        assert_eq!(due, (0..20).map(|k| k * 5).collect::<Vec<_>>());
    }

    #[test]
    fn a_sensor_faster_than_the_step_reads_once_a_step() {
        let mut schedule = Schedule::new(1e6);
        assert!((0..100).all(|tick| schedule.due(Stamp(tick * 20_000_000))));
    }
}
