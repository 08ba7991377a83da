//! Rate limit. May this request be carried out now? A token bucket.

/// Lets a number of requests pass per second, with bursts of up to one second's worth.
#[derive(Debug)]
pub(crate) struct TokenBucket {
    per_sec: f64,
    tokens: f64,
    at: f64,
}

impl TokenBucket {
    /// A full bucket.
    pub(crate) fn new(per_sec: f64) -> Self {
        Self {
            per_sec,
            tokens: per_sec.max(1.0),
            at: 0.0,
        }
    }

    /// Takes a token at `now` (s); `false` if there is none.
    pub(crate) fn take(&mut self, now: f64) -> bool {
        let passed = (now - self.at).max(0.0);
        self.at = self.at.max(now);
        self.tokens = (self.tokens + passed * self.per_sec).min(self.per_sec.max(1.0));
        let passes = self.tokens >= 1.0;
        if passes {
            self.tokens -= 1.0;
        }
        passes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_s_worth_passes_at_once_and_then_so_many_a_second() {
        let mut bucket = TokenBucket::new(5.0);
        let at_once = (0..100).filter(|_| bucket.take(10.0)).count();
        assert_eq!(at_once, 5);
        let later = (1..=100)
            .filter(|step| bucket.take(10.0 + f64::from(*step) * 0.02))
            .count();
        assert_eq!(later, 10, "5 a second for 2 s");
        assert!(!bucket.take(1.0), "a clock that goes back gives nothing");
    }
}
