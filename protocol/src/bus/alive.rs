//! Liveliness. Which components are present?
//!
//! Zenoh's liveliness tokens, for discovery only and never for authority: a frozen process keeps its token until its link times out.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use zenoh::Wait;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use super::inbox::{Inbox, Newest};
use super::{Bus, BusError};

/// A declared token: others see the component until the token is dropped or the process dies.
#[derive(Debug)]
pub struct AliveToken {
    _token: LivelinessToken,
}

/// A watch for tokens that appear and disappear.
pub struct AliveWatch {
    inbox: Arc<Inbox<Newest<KeyExpr<'static>, bool>>>,
    _subscriber: Subscriber<()>,
}

impl fmt::Debug for AliveWatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("AliveWatch").finish_non_exhaustive()
    }
}

impl Bus {
    /// Declares a token at a key (see [`crate::topics::alive_key`]).
    ///
    /// # Errors
    /// [`BusError::Key`], [`BusError::Closed`].
    pub fn declare_alive(&self, key: String) -> Result<AliveToken, BusError> {
        let key = Self::key(key)?;
        Ok(AliveToken {
            _token: self.declared(self.session.liveliness().declare_token(key).wait())?,
        })
    }

    /// Watches the tokens that match a pattern; existing tokens are reported first.
    ///
    /// # Errors
    /// [`BusError::Key`], [`BusError::Closed`].
    pub fn watch_alive(&self, pattern: String) -> Result<AliveWatch, BusError> {
        let pattern = Self::key(pattern)?;
        let (inbox, slot) = Inbox::new(Newest::new());
        let callback = move |sample: Sample| slot.put((sample.key_expr().clone(), sample.kind() == SampleKind::Put));
        let subscriber = self
            .session
            .liveliness()
            .declare_subscriber(pattern)
            .history(true)
            .callback(callback)
            .wait();
        Ok(AliveWatch {
            inbox,
            _subscriber: self.declared(subscriber)?,
        })
    }

    /// Lists the tokens that match a pattern at present, sorted; takes at most `timeout`.
    ///
    /// Do not use a session that watches the same tokens: Zenoh 1.10 sometimes reports none to it.
    ///
    /// # Errors
    /// [`BusError::Key`], [`BusError::Closed`].
    pub async fn list_alive(&self, pattern: String, timeout: Duration) -> Result<Vec<String>, BusError> {
        let pattern = Self::key(pattern)?;
        let (inbox, slot) = Inbox::new(Newest::new());
        let ask = self
            .session
            .liveliness()
            .get(pattern)
            .timeout(timeout)
            .callback(move |reply| {
                if let Ok(sample) = reply.result() {
                    slot.put((sample.key_expr().clone(), ()));
                }
            });
        self.declared(ask.wait())?;
        let mut keys = Vec::new();
        while let Some((key, ())) = inbox.next().await {
            keys.push(key.to_string());
        }
        keys.sort_unstable();
        // A robot's own endpoint reports the router's tokens twice.
        keys.dedup();
        Ok(keys)
    }
}

impl AliveWatch {
    /// Waits for the next change: a key, and whether its token exists now. Unread changes are merged by key, and a change may be reported
    /// twice. `None` after the bus was closed.
    pub async fn next(&mut self) -> Option<(String, bool)> {
        let (key, up) = self.inbox.next().await?;
        Some((key.to_string(), up))
    }

    /// The next change, if there is one; never waits.
    pub fn try_next(&mut self) -> Option<(String, bool)> {
        let (key, up) = self.inbox.try_next()?;
        Some((key.to_string(), up))
    }
}
