//! Worker pool. Chooses which of several workers is asked, and when a second one is asked as well.
//!
//! - **Affinity.** A robot's requests go to the same worker as long as that worker answers, because it holds a copy of the robot's map and
//!   its configuration space. Rendezvous hashing (Thaler and Ravishankar, "Using name-based mappings to increase hit rates", IEEE/ACM ToN
//!   1998) spreads robots evenly over workers, and moves few of them when a worker joins or leaves.
//! - **Hedging.** When an answer takes longer than 95 % of the recent ones, a second worker is asked as well, and the first answer counts
//!   (Dean and Barroso, "The tail at scale", CACM 2013). So a dead, frozen or slow worker costs little, and no goal.
//! - **Back-off.** A worker that failed, or lost to the second one, is asked after all others for a while that doubles.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

/// Number of recent answer times kept, and the least number for a p95.
const RECENT: usize = 128;
const ENOUGH: usize = 8;
/// A second worker is asked no sooner than this: below it, network jitter looks like a slow worker.
const SOONEST: Duration = Duration::from_millis(30);
/// And after this time while too few answer times are known.
const UNKNOWN: Duration = Duration::from_millis(500);
/// Back-off of a worker after its first failure, and at most.
const FIRST_BACK_OFF: Duration = Duration::from_secs(1);
const LONGEST_BACK_OFF: Duration = Duration::from_secs(60);

/// A live worker.
#[derive(Clone, Copy, Debug, Default)]
struct Worker {
    /// Failures since its last answer.
    failures: u32,
    avoided_until: Duration,
}

/// The workers of a service, as seen by one of its clients. All times count from one fixed instant.
#[derive(Debug, Default)]
pub(super) struct WorkerPool {
    workers: BTreeMap<String, Worker>,
    recent: VecDeque<Duration>,
}

impl WorkerPool {
    /// A worker joined or left. A restarted worker starts with a clean record.
    pub(super) fn set_live(&mut self, worker: &str, is_live: bool) {
        if is_live {
            self.workers.insert(worker.to_owned(), Worker::default());
        } else {
            self.workers.remove(worker);
        }
    }

    /// Number of workers.
    pub(super) fn len(&self) -> usize {
        self.workers.len()
    }

    /// The worker to ask for a robot, none of those tried already: the robot's own, or the next one while that is backed off.
    pub(super) fn choose(&self, robot: &str, tried: &BTreeSet<String>, now: Duration) -> Option<&str> {
        let others = self.workers.iter().filter(|(name, _)| !tried.contains(*name));
        let (name, _) = others.max_by_key(|(name, worker)| (worker.avoided_until <= now, weight(robot, name)))?;
        Some(name)
    }

    /// How long to wait for an answer before another worker is asked as well.
    pub(super) fn hedge_after(&self) -> Duration {
        if self.recent.len() < ENOUGH {
            return UNKNOWN;
        }
        let mut sorted: Vec<Duration> = self.recent.iter().copied().collect();
        sorted.sort_unstable();
        let p95 = sorted[(sorted.len() * 95).div_ceil(100) - 1];
        p95.max(SOONEST)
    }

    /// A worker answered after this time.
    pub(super) fn answered(&mut self, worker: &str, took: Duration) {
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(took);
        if let Some(worker) = self.workers.get_mut(worker) {
            *worker = Worker::default();
        }
    }

    /// A worker did not answer, or answered later than another.
    pub(super) fn failed(&mut self, worker: &str, now: Duration) {
        if let Some(worker) = self.workers.get_mut(worker) {
            let doubled = FIRST_BACK_OFF.saturating_mul(1 << worker.failures.min(6));
            worker.avoided_until = now + doubled.min(LONGEST_BACK_OFF);
            worker.failures += 1;
        }
    }
}

/// Rank of a worker for a robot: FNV-1a over both names (Fowler, Noll, Vo), the same on every machine.
fn weight(robot: &str, worker: &str) -> u64 {
    let bytes = robot.bytes().chain([b'/']).chain(worker.bytes());
    let hash = bytes.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    // FNV's high bits hardly depend on the last bytes: spread them (the finaliser of MurmurHash3).
    let hash = (hash ^ (hash >> 33)).wrapping_mul(0xff51_afd7_ed55_8ccd);
    hash ^ (hash >> 33)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn pool(names: &[&str]) -> WorkerPool {
        let mut pool = WorkerPool::default();
        names.iter().for_each(|name| pool.set_live(name, true));
        pool
    }

    fn at(secs: f64) -> Duration {
        Duration::from_secs_f64(secs)
    }

    fn own(pool: &WorkerPool, robot: &str) -> String {
        pool.choose(robot, &BTreeSet::new(), at(0.0)).unwrap().to_owned()
    }

    #[test]
    fn robots_spread_over_workers_and_stay_with_theirs_when_one_comes() {
        let robots: Vec<String> = (0..300).map(|nth| format!("robot-{nth}")).collect();
        let mut pool = pool(&["a", "b"]);
        let before: Vec<String> = robots.iter().map(|robot| own(&pool, robot)).collect();
        let first = before.iter().filter(|worker| *worker == "a").count();
        assert!((100..200).contains(&first), "{first} of 300 with one of two workers");
        pool.set_live("c", true);
        let after: Vec<String> = robots.iter().map(|robot| own(&pool, robot)).collect();
        let moved = before.iter().zip(&after).filter(|(before, after)| before != after);
        assert!(moved.clone().all(|(_, after)| after == "c"));
        assert!((60..150).contains(&moved.count()));
    }

    #[test]
    fn a_worker_that_failed_is_asked_last_for_a_while_that_doubles_until_it_answers() {
        let mut pool = pool(&["a", "b"]);
        let worker = own(&pool, "tiago");
        let chosen = |pool: &WorkerPool, now: f64| pool.choose("tiago", &BTreeSet::new(), at(now)).unwrap() == worker;
        pool.failed(&worker, at(10.0));
        assert!(!chosen(&pool, 10.9));
        assert!(chosen(&pool, 11.1));
        pool.failed(&worker, at(11.1));
        assert!(!chosen(&pool, 13.0));
        assert!(chosen(&pool, 13.2));
        pool.answered(&worker, at(0.01));
        pool.failed(&worker, at(20.0));
        assert!(chosen(&pool, 21.1), "an answer ends it");
        let tried = BTreeSet::from(["a".to_owned(), "b".to_owned()]);
        assert_eq!(pool.choose("tiago", &tried, at(30.0)), None);
    }

    #[test]
    fn alone_it_is_asked_however_often_it_failed() {
        let mut pool = pool(&["a"]);
        for _ in 0..40 {
            pool.failed("a", at(0.0));
        }
        assert_eq!(pool.choose("tiago", &BTreeSet::new(), at(1.0)), Some("a"));
    }

    #[test]
    fn a_second_worker_is_asked_after_the_p95_of_the_recent_answers() {
        let mut pool = pool(&["a"]);
        assert_eq!(pool.hedge_after(), UNKNOWN);
        for nth in 1..=100 {
            pool.answered("a", Duration::from_millis(nth));
        }
        assert_eq!(pool.hedge_after(), Duration::from_millis(95));
        for _ in 0..RECENT {
            pool.answered("a", Duration::from_millis(2));
        }
        assert_eq!(pool.hedge_after(), SOONEST);
    }
}
