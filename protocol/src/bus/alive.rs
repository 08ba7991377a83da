//! Who is there? Liveliness tokens: for discovery, never for authority (a frozen process keeps its token until its lease ends).

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

/// Says "I am here" until it is dropped, or its process dies.
#[derive(Debug)]
pub struct AliveToken {
    _token: LivelinessToken,
}

/// Tells who comes and goes.
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
    /// Declares that somebody is at this key (see [`crate::topics::alive_key`]).
    ///
    /// # Errors
    /// [`BusError::Key`], [`BusError::Closed`].
    pub fn declare_alive(&self, key: String) -> Result<AliveToken, BusError> {
        let key = Self::key(key)?;
        Ok(AliveToken {
            _token: self.declared(self.session.liveliness().declare_token(key).wait())?,
        })
    }

    /// Watches the tokens that match; those that are there already come first.
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

    /// The tokens that match now, in order; waits for `timeout` at most. A session that watches the same tokens is now and then told of none
    /// (Zenoh 1.10): ask in another.
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
        // A robot's own endpoint tells of the router's tokens twice.
        keys.dedup();
        Ok(keys)
    }
}

impl AliveWatch {
    /// Waits for the next change: the key, and whether it is there now. Changes that were not read yet are merged by key,
    /// and one may be told twice. `None` when the bus was closed.
    pub async fn next(&mut self) -> Option<(String, bool)> {
        let (key, up) = self.inbox.next().await?;
        Some((key.to_string(), up))
    }

    /// The next change if there is one. Never waits.
    pub fn try_next(&mut self) -> Option<(String, bool)> {
        let (key, up) = self.inbox.try_next()?;
        Some((key.to_string(), up))
    }
}
