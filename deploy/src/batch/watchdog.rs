//! Watchdog. Ends a search at its time limit, although the search knows no clock: a thread sets its cancel flag.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use zenav_planning::{Budget, PlanningSettings};

/// Sets a flag at a time limit after being armed.
pub(super) struct Watchdog {
    limit: Duration,
    shared: Arc<Shared>,
}

struct Shared {
    cancel: AtomicBool,
    /// Deadline, and whether the thread must end.
    state: Mutex<(Option<Instant>, bool)>,
    changed: Condvar,
}

impl Watchdog {
    /// A watchdog with this time limit.
    fn new(limit: Duration) -> Self {
        let shared = Arc::new(Shared {
            cancel: AtomicBool::new(false),
            state: Mutex::new((None, false)),
            changed: Condvar::new(),
        });
        let watching = Arc::clone(&shared);
        std::thread::spawn(move || watching.watch());
        Self { limit, shared }
    }

    /// A watchdog with a time limit in ms; `None` if the limit is too large to be represented.
    pub(super) fn of_millis(ms: f64) -> Option<Self> {
        Duration::try_from_secs_f64(ms * 1e-3).ok().map(Self::new)
    }

    /// The cancel flag.
    fn cancel(&self) -> &AtomicBool {
        &self.shared.cancel
    }

    /// Starts the time limit now, and clears the flag.
    fn arm(&self) {
        self.set(Instant::now().checked_add(self.limit), false);
    }

    /// Stops the time limit.
    fn disarm(&self) {
        self.set(None, false);
    }

    fn set(&self, deadline: Option<Instant>, end: bool) {
        let mut state = self.shared.state.lock().unwrap_or_else(PoisonError::into_inner);
        // Cleared under the lock, so that an old deadline cannot set it again.
        self.shared.cancel.store(false, Ordering::Relaxed);
        *state = (deadline, end);
        self.shared.changed.notify_one();
    }
}

/// Runs a search within the time limit; returns its answer and its own time, µs. Without a time limit, a search draws as many samples as a
/// motion worker's.
pub(super) fn timed<T>(watchdog: Option<&Watchdog>, search: impl FnOnce(Budget<'_>) -> T) -> (T, f64) {
    let budget = Budget {
        max_samples: watchdog.map_or_else(|| PlanningSettings::default().max_samples, |_| u64::MAX),
        cancel: watchdog.map(Watchdog::cancel),
        ..Budget::UNLIMITED
    };
    watchdog.inspect(|watchdog| watchdog.arm());
    let begin = Instant::now();
    let answer = search(budget);
    let micros = begin.elapsed().as_secs_f64() * 1e6;
    watchdog.inspect(|watchdog| watchdog.disarm());
    (answer, micros)
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        self.set(None, true);
    }
}

impl Shared {
    fn watch(&self) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        while !state.1 {
            let left = state
                .0
                .map(|deadline| deadline.saturating_duration_since(Instant::now()));
            if left == Some(Duration::ZERO) {
                self.cancel.store(true, Ordering::Relaxed);
                state.0 = None;
                continue;
            }
            state = match left {
                Some(left) => {
                    self.changed
                        .wait_timeout(state, left)
                        .unwrap_or_else(PoisonError::into_inner)
                        .0
                }
                None => self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
            };
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_search_is_limited_by_samples_or_by_time() {
        let samples = |watchdog: Option<&Watchdog>| timed(watchdog, |budget| budget.max_samples).0;
        assert_eq!(samples(None), PlanningSettings::default().max_samples);
        assert_eq!(samples(Some(&Watchdog::new(Duration::from_secs(3600)))), u64::MAX);
    }

    #[test]
    fn an_armed_watchdog_cancels_and_a_new_search_begins_uncancelled() {
        let dog = Watchdog::new(Duration::from_millis(1));
        dog.arm();
        let end = Instant::now() + Duration::from_secs(10);
        while !dog.cancel().load(Ordering::Relaxed) {
            assert!(Instant::now() < end, "never cancelled");
            std::thread::yield_now();
        }
        let slow = Watchdog::new(Duration::from_secs(3600));
        slow.arm();
        assert!(!slow.cancel().load(Ordering::Relaxed));
        dog.disarm();
        assert!(!dog.cancel().load(Ordering::Relaxed));
    }
}
