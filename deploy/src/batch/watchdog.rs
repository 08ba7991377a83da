//! Watchdog. Ends a search at its time limit, although the search knows no clock: a thread sets its cancel flag.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use zenav_planning::{Budget, PlanningSettings};

/// Sets the cancel flags of searches that take longer than a time limit.
pub(super) struct Watchdog {
    limit: Duration,
    watched: Sender<Option<Watched>>,
}

/// A search: its deadline, and its cancel flag.
type Watched = (Instant, Arc<AtomicBool>);

impl Watchdog {
    /// A watchdog with this time limit.
    fn new(limit: Duration) -> Self {
        let (watched, searches) = mpsc::channel();
        std::thread::spawn(move || watch(&searches));
        Self { limit, watched }
    }

    /// A watchdog with a time limit in ms; `None` if the limit is too large to be represented.
    pub(super) fn of_millis(ms: f64) -> Option<Self> {
        Duration::try_from_secs_f64(ms * 1e-3).ok().map(Self::new)
    }

    /// Starts the time limit of a search now; returns the search's cancel flag.
    fn arm(&self) -> Arc<AtomicBool> {
        let cancel = Arc::default();
        let deadline = Instant::now().checked_add(self.limit);
        // The thread lives as long as this sender.
        let _ = self
            .watched
            .send(deadline.map(|deadline| (deadline, Arc::clone(&cancel))));
        cancel
    }

    /// Stops the time limit.
    fn disarm(&self) {
        let _ = self.watched.send(None);
    }
}

/// Watches one search after another until the watchdog is dropped.
fn watch(searches: &Receiver<Option<Watched>>) {
    let mut search: Option<Watched> = None;
    loop {
        let next = match &search {
            Some((deadline, _)) => searches.recv_timeout(deadline.saturating_duration_since(Instant::now())),
            None => searches.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match (next, search.take()) {
            (Ok(next), _) => search = next,
            (Err(RecvTimeoutError::Timeout), Some((_, cancel))) => cancel.store(true, Ordering::Relaxed),
            (Err(_), _) => return,
        }
    }
}

/// Runs a search within the time limit; returns its answer and its own time, µs. Without a time limit, a search draws as many samples as a
/// motion worker's.
pub(super) fn timed<T>(watchdog: Option<&Watchdog>, search: impl FnOnce(Budget<'_>) -> T) -> (T, f64) {
    let cancel = watchdog.map(Watchdog::arm);
    let budget = Budget {
        max_samples: watchdog.map_or_else(|| PlanningSettings::default().max_samples, |_| u64::MAX),
        cancel: cancel.as_deref(),
        ..Budget::UNLIMITED
    };
    let begin = Instant::now();
    let answer = search(budget);
    let micros = begin.elapsed().as_secs_f64() * 1e6;
    watchdog.inspect(|watchdog| watchdog.disarm());
    (answer, micros)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_is_limited_by_samples_or_by_time() {
        let samples = |watchdog: Option<&Watchdog>| timed(watchdog, |budget| budget.max_samples).0;
        assert_eq!(samples(None), PlanningSettings::default().max_samples);
        assert_eq!(samples(Some(&Watchdog::new(Duration::from_secs(3600)))), u64::MAX);
    }

    #[test]
    fn an_armed_watchdog_cancels_each_search_at_its_limit() {
        let dog = Watchdog::new(Duration::from_millis(1));
        for _ in 0..2 {
            let cancel = dog.arm();
            let end = Instant::now() + Duration::from_secs(10);
            while !cancel.load(Ordering::Relaxed) {
                assert!(Instant::now() < end, "never cancelled");
                std::thread::yield_now();
            }
        }
        let slow = Watchdog::new(Duration::from_secs(3600));
        assert!(!slow.arm().load(Ordering::Relaxed));
    }
}
