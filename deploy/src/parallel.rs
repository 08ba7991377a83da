//! Parallel work. Independent jobs on several threads, with their results in the order of the jobs.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Number of threads that this machine can run at once.
#[must_use]
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Does jobs 0 to `count` on up to `threads` threads.
///
/// # Panics
/// When a job does.
pub fn in_order<T: Send>(count: usize, threads: usize, job: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut done = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                return done;
            }
            done.push((number, job(number)));
        }
    };
    let mut done: Vec<(usize, T)> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads.min(count)).map(|_| scope.spawn(work)).collect();
        let joined = threads.into_iter().map(|thread| thread.join());
        joined
            .flat_map(|done| done.unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect()
    });
    done.sort_unstable_by_key(|(number, _)| *number);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_job_is_done_once_and_the_results_are_in_order() {
        let squares: Vec<usize> = (0..100).map(|number| number * number).collect();
        for threads in [1, 3, 200] {
            assert_eq!(in_order(100, threads, |number| number * number), squares);
        }
        assert!(in_order(0, 4, |number| number).is_empty());
    }
}
