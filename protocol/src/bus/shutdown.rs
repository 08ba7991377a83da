//! How does a service learn that it shall end? A handle that all clones of it share.

use std::sync::Arc;

use tokio::sync::watch;

/// The end of a run, once [`triggered`](Self::trigger). Clones share it.
#[derive(Clone, Debug)]
pub struct Shutdown(Arc<watch::Sender<bool>>);

impl Default for Shutdown {
    fn default() -> Self {
        Self::new()
    }
}

impl Shutdown {
    /// Not yet triggered.
    #[must_use]
    pub fn new() -> Self {
        Self(Arc::new(watch::Sender::new(false)))
    }

    /// Ends the run; a second time changes nothing.
    pub fn trigger(&self) {
        self.0.send_replace(true);
    }

    /// Whether the run shall end.
    #[must_use]
    pub fn is_set(&self) -> bool {
        *self.0.borrow()
    }

    /// Waits for the end of the run.
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
