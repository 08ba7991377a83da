//! Token bucket. May this message pass now, or does it come too fast? (RFC 3290, appendix A.) Time is passed in.

use std::time::Duration;

/// Lets a number of messages pass per second, and a number of them at once.
///
/// ```
/// use std::time::Duration;
/// use zenav_protocol::token_bucket::TokenBucket;
///
/// let mut bucket = TokenBucket::full(5.0, 10.0, Duration::ZERO);
/// assert_eq!((0..100).filter(|_| bucket.take(Duration::ZERO)).count(), 10, "at once");
/// let millis = (0..2000).map(Duration::from_millis);
/// assert_eq!(millis.filter(|now| bucket.take(*now)).count(), 9, "in 2 s");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct TokenBucket {
    per_sec: f64,
    burst: f64,
    /// Messages that may come at once.
    tokens: f64,
    /// Time of the last inflow.
    at: Duration,
}

impl TokenBucket {
    /// A full bucket: `burst` messages may come at once, and `per_sec` a second from then on.
    #[must_use]
    pub fn full(per_sec: f64, burst: f64, now: Duration) -> Self {
        Self {
            per_sec,
            burst,
            tokens: burst,
            at: now,
        }
    }

    /// Whether as many messages may come at once as ever.
    #[must_use]
    pub fn is_full(&self, now: Duration) -> bool {
        self.tokens_at(now) >= self.burst
    }

    /// Time since a message last came.
    #[must_use]
    pub fn silence(&self, now: Duration) -> Duration {
        now.saturating_sub(self.at)
    }

    /// Takes a message; `false` if it comes too fast. A clock that goes back gives nothing.
    pub fn take(&mut self, now: Duration) -> bool {
        self.tokens = self.tokens_at(now);
        self.at = self.at.max(now);
        let passes = self.tokens >= 1.0;
        if passes {
            self.tokens -= 1.0;
        }
        passes
    }

    fn tokens_at(&self, now: Duration) -> f64 {
        (self.tokens + self.silence(now).as_secs_f64() * self.per_sec).min(self.burst)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_passes_at_once_and_then_so_many_a_second() {
        let mut bucket = TokenBucket::full(5.0, 5.0, Duration::ZERO);
        let begin = Duration::from_secs(10);
        assert_eq!((0..100).filter(|_| bucket.take(begin)).count(), 5);
        assert!(!bucket.is_full(begin + Duration::from_millis(900)) && bucket.is_full(begin + Duration::from_secs(1)));
        let later = (1..=80_u32).filter(|step| bucket.take(begin + *step * Duration::from_millis(25)));
        assert_eq!(later.count(), 10, "5 a second for 2 s");
        assert!(
            !bucket.take(Duration::from_secs(1)),
            "a clock that goes back gives nothing"
        );
    }
}
