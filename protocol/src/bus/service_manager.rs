//! Service manager. How does it learn that a process is ready, that it still works, and that it ends?
//!
//! By the notifications of systemd (sd_notify(3)), to the socket that `NOTIFY_SOCKET` names; without one nothing is sent.

use std::sync::atomic::{AtomicBool, Ordering};

use sd_notify::NotifyState;

/// Whether the process is ready: it says so once.
static READY: AtomicBool = AtomicBool::new(false);

/// Says that the process is ready, and from then on, at twice the pace that is asked for, that its runtime still turns. Must be called in a
/// Tokio runtime; a second time changes nothing.
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

/// Says that the process ends, on purpose.
pub(super) fn stopping() {
    say(NotifyState::Stopping);
}

fn say(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::warn!(%error, "the service manager cannot be told");
    }
}
