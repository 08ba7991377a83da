//! How punctual is the control loop? The lateness of every tick in a histogram of fixed size, so that it can be kept for ever.

use std::time::Duration;

use zenav_protocol::messages::Pacing;

/// Width of a bucket.
const BUCKET: Duration = Duration::from_micros(20);
/// Buckets; the last one takes everything later.
const BUCKETS: usize = 1000;

/// Lateness of all ticks since start.
#[derive(Clone, Debug)]
pub struct LoopTiming {
    counts: Vec<u64>,
    ticks: u64,
    latest: Duration,
}

impl Default for LoopTiming {
    fn default() -> Self {
        Self {
            counts: vec![0; BUCKETS],
            ticks: 0,
            latest: Duration::ZERO,
        }
    }
}

impl LoopTiming {
    /// Counts a tick that began this much too late.
    pub fn note(&mut self, late: Duration) {
        let bucket = usize::try_from(late.as_nanos() / BUCKET.as_nanos()).unwrap_or(BUCKETS);
        if let Some(count) = self.counts.get_mut(bucket.min(BUCKETS - 1)) {
            *count += 1;
        }
        self.ticks += 1;
        self.latest = self.latest.max(late);
    }

    /// What has been counted.
    #[must_use]
    pub fn pacing(&self) -> Pacing {
        Pacing {
            ticks: self.ticks,
            late_p50_ms: self.percentile(0.5),
            late_p99_ms: self.percentile(0.99),
            late_max_ms: millis(self.latest),
        }
    }

    /// The lateness that a share of the ticks does not exceed, to a bucket's upper end, ms.
    fn percentile(&self, share: f64) -> f64 {
        let wanted = (share * self.ticks as f64).ceil() as u64;
        let mut counted = 0;
        for (bucket, count) in (1_u32..).zip(&self.counts) {
            counted += count;
            if counted >= wanted && bucket < BUCKETS as u32 {
                return millis((BUCKET * bucket).min(self.latest));
            }
        }
        millis(self.latest)
    }
}

fn millis(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_hundred_ticks_one_may_be_late_and_the_worst_is_told_exactly() {
        let mut punctuality = LoopTiming::default();
        for tick in 0..1000 {
            let late = if tick % 100 == 0 { 5_000 } else { 310 };
            punctuality.note(Duration::from_micros(late));
        }
        let pacing = punctuality.pacing();
        assert_eq!((pacing.ticks, pacing.late_max_ms), (1000, 5.0));
        assert!((pacing.late_p50_ms - 0.32).abs() < 1e-9 && (pacing.late_p99_ms - 0.32).abs() < 1e-9);
        (0..10).for_each(|_| punctuality.note(Duration::from_secs(3600)));
        assert_eq!(punctuality.pacing().late_max_ms, 3.6e6);
        assert!((punctuality.pacing().late_p99_ms - 5.02).abs() < 1e-9);
    }

    #[test]
    fn nothing_counted_is_nothing_late() {
        assert_eq!(LoopTiming::default().pacing().late_p99_ms, 0.0);
    }
}
