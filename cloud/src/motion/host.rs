//! Request host. Runs one request away from the async threads and within its budget.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use zenav_protocol::bus::Shutdown;
use zenav_protocol::messages::Refusal;

use super::worker::Cancel;

/// Runs `work` on a thread that may block. Searches are cancelled after the first budget, smoothing after the second, both by a shutdown;
/// the work then ends soon. `work` is given a clock, s.
///
/// # Errors
/// [`Refusal::Internal`] when the work panics.
pub(super) async fn within<T: Send + 'static>(
    [search, whole]: [Duration; 2],
    shutdown: &Shutdown,
    work: impl FnOnce(&mut dyn FnMut() -> f64, &Cancel) -> T + Send + 'static,
) -> Result<T, Refusal> {
    let cancel = Arc::new(Cancel::default());
    let flags = Arc::clone(&cancel);
    let began = Instant::now();
    let mut working = tokio::task::spawn_blocking(move || work(&mut || began.elapsed().as_secs_f64(), &flags));
    let ends = async {
        tokio::time::sleep(search).await;
        cancel.search.store(true, Ordering::Relaxed);
        tokio::time::sleep(whole.saturating_sub(search)).await;
    };
    let done = tokio::select! {
        done = &mut working => done,
        () = async { tokio::select! { () = ends => {} () = shutdown.wait() => {} } } => {
            cancel.all();
            working.await
        }
    };
    done.map_err(Refusal::internal)
}

#[cfg(test)]
#[allow(clippy::panic, reason = "tests")]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    fn spin(until: &AtomicBool) {
        while !until.load(Ordering::Relaxed) {
            std::thread::yield_now();
        }
    }

    #[tokio::test]
    async fn a_phase_ends_with_its_budget_and_all_with_the_run() {
        let (shutdown, soon, never) = (Shutdown::new(), Duration::from_millis(5), Duration::from_secs(600));
        let searched = within([soon, never], &shutdown, |_, cancel| {
            spin(&cancel.search);
            cancel.smoothing.load(Ordering::Relaxed)
        });
        assert_eq!(searched.await, Ok(false), "smoothing goes on");
        let both = within([soon, soon], &shutdown, |clock, cancel| {
            spin(&cancel.smoothing);
            clock() > 0.0
        });
        assert_eq!(both.await, Ok(true));
        shutdown.trigger();
        let ended = within([never, never], &shutdown, |_, cancel| {
            spin(&cancel.search);
            spin(&cancel.smoothing);
        });
        assert_eq!(ended.await, Ok(()));
    }

    #[tokio::test]
    async fn work_that_panics_is_refused() {
        let budgets = [Duration::from_secs(1); 2];
        let broken = within(budgets, &Shutdown::new(), |_, _| -> () { panic!("broken") }).await;
        assert!(matches!(broken, Err(Refusal::Internal { .. })), "{broken:?}");
    }
}
