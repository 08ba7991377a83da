//! Meter. Rate and size of the messages on a key, over a window. Pure: time is passed in.

use std::collections::VecDeque;
use std::time::Duration;

use serde::Serialize;

/// Arrivals of one key.
#[derive(Clone, Debug)]
pub(super) struct Meter {
    window: usize,
    arrivals: VecDeque<(Duration, usize)>,
    messages: u64,
    /// Arrival of the newest message.
    last: Option<Duration>,
}

/// Reading of a meter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Reading {
    /// Messages since the start.
    pub(super) messages: u64,
    /// Messages per second over the window; `None` before the second message.
    pub(super) hz: Option<f64>,
    /// Shortest interval in the window, s.
    pub(super) min_s: Option<f64>,
    /// Longest interval in the window, s.
    pub(super) max_s: Option<f64>,
    /// Standard deviation of the intervals, s.
    pub(super) std_s: Option<f64>,
    /// Bytes per second over the window.
    pub(super) bytes_per_s: Option<f64>,
    /// Bytes per message: least, mean, greatest.
    pub(super) bytes: [f64; 3],
}

impl Meter {
    /// Measures over the last `window` messages.
    pub(super) fn new(window: usize) -> Self {
        Self {
            window: window.max(2),
            arrivals: VecDeque::new(),
            messages: 0,
            last: None,
        }
    }

    /// Adds a message of so many bytes at `now` (time since the start).
    pub(super) fn add(&mut self, now: Duration, bytes: usize) {
        if self.arrivals.len() == self.window {
            self.arrivals.pop_front();
        }
        self.arrivals.push_back((now, bytes));
        self.messages += 1;
        self.last = Some(now);
    }

    /// Narrows the window: only messages from `start` on (time since the start) count for the rate.
    pub(super) fn forget_before(&mut self, start: Duration) {
        let older = self.arrivals.partition_point(|(at, _)| *at < start);
        self.arrivals.drain(..older);
    }

    /// Time since the newest message, at `now` (time since the start).
    pub(super) fn silence(&self, now: Duration) -> Option<Duration> {
        self.last.map(|last| now.saturating_sub(last))
    }

    /// For retained messages: their times say nothing about the rate, so only the newest message is counted.
    pub(super) fn forget_times(&mut self) {
        let older = self.arrivals.len().saturating_sub(1);
        self.arrivals.drain(..older);
        self.messages = self.arrivals.len() as u64;
    }

    /// Reading up to now.
    pub(super) fn read(&self) -> Reading {
        let intervals: Vec<f64> = self
            .arrivals
            .iter()
            .zip(self.arrivals.iter().skip(1))
            .map(|((a, _), (b, _))| b.saturating_sub(*a).as_secs_f64())
            .collect();
        let sizes: Vec<f64> = self.arrivals.iter().map(|(_, bytes)| *bytes as f64).collect();
        let total: f64 = intervals.iter().sum();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let least = |values: &[f64]| values.iter().copied().reduce(f64::min);
        let greatest = |values: &[f64]| values.iter().copied().reduce(f64::max);
        let deviation = |values: &[f64]| {
            let middle = mean(values);
            (!values.is_empty())
                .then(|| mean(&values.iter().map(|value| (value - middle).powi(2)).collect::<Vec<_>>()).sqrt())
        };
        let rate = |amount: f64| (total > 0.0).then(|| amount / total);
        Reading {
            messages: self.messages,
            hz: rate(intervals.len() as f64),
            min_s: least(&intervals),
            max_s: greatest(&intervals),
            std_s: deviation(&intervals),
            // The first message only starts the first interval.
            bytes_per_s: rate(sizes.iter().skip(1).sum()),
            bytes: [
                least(&sizes).unwrap_or_default(),
                mean(&sizes),
                greatest(&sizes).unwrap_or_default(),
            ],
        }
    }
}

/// A number of bytes, human-readable.
pub(super) fn bytes(count: f64) -> String {
    if count >= 1e6 {
        format!("{:.2} MB", count / 1e6)
    } else if count >= 1e3 {
        format!("{:.1} kB", count / 1e3)
    } else {
        format!("{count:.0} B")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_a_second_reads_as_ten_hertz() {
        let mut meter = Meter::new(100);
        for i in 0..31 {
            meter.add(Duration::from_millis(100 * i), 200);
        }
        let reading = meter.read();
        assert!((reading.hz.unwrap() - 10.0).abs() < 1e-9 && (reading.bytes_per_s.unwrap() - 2000.0).abs() < 1e-6);
        assert!(reading.std_s.unwrap() < 1e-9);
        assert_eq!((reading.messages, reading.bytes), (31, [200.0; 3]));
    }

    #[test]
    fn one_message_has_no_rate() {
        let mut meter = Meter::new(10);
        assert_eq!(meter.read().hz, None);
        meter.add(Duration::ZERO, 5);
        assert_eq!((meter.read().hz, meter.read().bytes_per_s), (None, None));
    }

    #[test]
    fn messages_that_were_kept_have_no_rate() {
        let mut meter = Meter::new(10);
        for bytes in [5, 6, 7] {
            meter.add(Duration::from_micros(bytes), 10 * bytes as usize);
        }
        meter.forget_times();
        let reading = meter.read();
        assert_eq!((reading.hz, reading.messages, reading.bytes), (None, 1, [70.0; 3]));
    }

    #[test]
    fn only_the_window_counts() {
        let mut meter = Meter::new(3);
        for at in [0, 10_000, 10_100, 10_200] {
            meter.add(Duration::from_millis(at), 1);
        }
        assert!((meter.read().hz.unwrap() - 10.0).abs() < 1e-9);
        assert_eq!(meter.read().messages, 4);
        meter.forget_before(Duration::from_millis(10_150));
        assert_eq!((meter.read().hz, meter.read().messages), (None, 4));
        meter.forget_before(Duration::from_secs(20));
        assert_eq!((meter.read().hz, meter.read().bytes), (None, [0.0; 3]));
        let silence = meter.silence(Duration::from_millis(12_200));
        assert_eq!(silence, Some(Duration::from_secs(2)));
    }
}
