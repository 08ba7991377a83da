//! Shutdown. How does a service learn that it must stop?

use std::sync::Arc;

use tokio::sync::watch;

use super::service_manager;

/// Waits for Ctrl-C, or for the service manager's request to stop.
pub async fn interrupted() {
    asked_to_end().await;
    service_manager::stopping();
}

async fn asked_to_end() {
    #[cfg(unix)]
    if let Ok(mut terminate) = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
        tokio::select! {
            _ = tokio::signal::ctrl_c() => return,
            _ = terminate.recv() => return,
        }
    }
    let _ = tokio::signal::ctrl_c().await;
}

/// A shutdown signal. Clones share it.
///
/// ```
/// use zenav_protocol::bus::Shutdown;
///
/// let shutdown = Shutdown::new();
/// let of_the_service = shutdown.clone();
/// shutdown.trigger();
/// assert!(of_the_service.is_set());
/// ```
#[derive(Clone, Debug)]
pub struct Shutdown(Arc<watch::Sender<bool>>);

impl Default for Shutdown {
    fn default() -> Self {
        Self::new()
    }
}

impl Shutdown {
    /// A signal that is not triggered yet.
    #[must_use]
    pub fn new() -> Self {
        Self(Arc::new(watch::Sender::new(false)))
    }

    /// Triggers the shutdown; further calls have no effect.
    pub fn trigger(&self) {
        self.0.send_replace(true);
    }

    /// A signal triggered by Ctrl-C, or by the service manager's request to stop. Must be called in a Tokio runtime.
    #[must_use]
    pub fn on_interrupt() -> Self {
        let shutdown = Self::new();
        let ender = shutdown.clone();
        tokio::spawn(async move {
            interrupted().await;
            ender.trigger();
        });
        shutdown
    }

    /// Whether the shutdown was triggered.
    #[must_use]
    pub fn is_set(&self) -> bool {
        *self.0.borrow()
    }

    /// Waits until the shutdown is triggered.
    pub async fn wait(&self) {
        // The sender lives in `self`, so this cannot fail.
        let _ = self.0.subscribe().wait_for(|set| *set).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn whoever_waits_learns_it_early_or_late() {
        let shutdown = Shutdown::new();
        assert!(!shutdown.is_set());
        let early = tokio::spawn({
            let shutdown = shutdown.clone();
            async move { shutdown.wait().await }
        });
        tokio::task::yield_now().await;
        shutdown.trigger();
        assert!(early.await.is_ok());
        shutdown.wait().await;
        assert!(shutdown.is_set());
    }
}
