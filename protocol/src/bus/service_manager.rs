//! Service manager. How does it learn that a process is ready, still works, or is stopping?
//!
//! Through systemd notifications (sd_notify(3)) to the socket named by `NOTIFY_SOCKET`; without the variable nothing is sent.

use std::sync::atomic::{AtomicBool, Ordering};

use sd_notify::NotifyState;

/// Whether the process has reported that it is ready.
static READY: AtomicBool = AtomicBool::new(false);

/// Reports that the process is ready, and from then on, at twice the requested rate, that its runtime is still alive. Must be called in a
/// Tokio runtime; further calls have no effect.
pub fn ready() {
    if READY.swap(true, Ordering::Relaxed) {
        return;
    }
    say(NotifyState::Ready);
    if let Some(limit) = sd_notify::watchdog_enabled() {
        tokio::spawn(async move {
            let mut beat = tokio::time::interval(limit / 2);
            loop {
                beat.tick().await;
                say(NotifyState::Watchdog);
            }
        });
    }
}

/// Reports that the process is stopping on purpose.
pub(super) fn stopping() {
    say(NotifyState::Stopping);
}

fn say(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::warn!(%error, "the service manager cannot be told");
    }
}
