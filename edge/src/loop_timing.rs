//! Loop timing. How late are the control ticks? A histogram of fixed size over the lateness of every tick since start.

use std::time::Duration;

use zenav_protocol::messages::Pacing;

/// Width of a histogram bucket.
const BUCKET: Duration = Duration::from_micros(20);
/// Number of buckets; the last one takes everything later.
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
    /// Records a tick that began this late.
    ///
    /// ```
    /// use std::time::Duration;
    /// use zenav_edge::loop_timing::LoopTiming;
    ///
    /// let mut timing = LoopTiming::default();
    /// for late in [0, 5, 1000] {
    ///     timing.record(Duration::from_micros(late));
    /// }
    /// let pacing = timing.pacing();
    /// assert_eq!(pacing.ticks, 3);
    /// assert!((pacing.late_p50_ms - 0.02).abs() < 1e-9 && (pacing.late_max_ms - 1.0).abs() < 1e-9, "{pacing:?}");
    /// ```
    pub fn record(&mut self, late: Duration) {
        let bucket = usize::try_from(late.as_nanos() / BUCKET.as_nanos()).unwrap_or(BUCKETS);
        if let Some(count) = self.counts.get_mut(bucket.min(BUCKETS - 1)) {
            *count += 1;
        }
        self.ticks += 1;
        self.latest = self.latest.max(late);
    }

    /// Count, percentiles and maximum.
    #[must_use]
    pub fn pacing(&self) -> Pacing {
        Pacing {
            ticks: self.ticks,
            late_p50_ms: self.percentile(0.5),
            late_p99_ms: self.percentile(0.99),
            late_max_ms: millis(self.latest),
        }
    }

    /// The lateness that a share of the ticks does not exceed, rounded up to a bucket, ms.
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
    fn percentiles_are_rounded_up_to_a_bucket_and_the_maximum_is_exact() {
        let mut timing = LoopTiming::default();
        for tick in 0..1000 {
            let late = if tick % 100 == 0 { 5_000 } else { 310 };
            timing.record(Duration::from_micros(late));
        }
        let pacing = timing.pacing();
        assert_eq!((pacing.ticks, pacing.late_max_ms), (1000, 5.0));
        assert!((pacing.late_p50_ms - 0.32).abs() < 1e-9 && (pacing.late_p99_ms - 0.32).abs() < 1e-9);
        (0..10).for_each(|_| timing.record(Duration::from_secs(3600)));
        assert_eq!(timing.pacing().late_max_ms, 3.6e6);
        assert!((timing.pacing().late_p99_ms - 5.02).abs() < 1e-9);
    }

    #[test]
    fn without_a_tick_nothing_is_late() {
        assert_eq!(LoopTiming::default().pacing().late_p99_ms, 0.0);
    }
}
