//! Router. How are all components connected? Through a Zenoh router, which any process can open.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use zenav_observability::{Readiness, declarations};
use zenoh::config::WhatAmI;
use zenoh::{Session, Wait};

use super::limiter::Pace;
use super::link;
use super::repeat::Repeats;
use super::rights::Rights;
use super::security::Security;
use super::session::{
    Bus, BusError, CLOSE_TIMEOUT, DEFAULT_ENDPOINT, LEASE_MS, ROUTER_HANDSHAKE_MS, endpoints, in_words, link_settings,
};
use super::threads;

/// Interval between two looks whether this process was suspended.
const LOOK: Duration = Duration::from_millis(500);
/// Time of a suspension after which others have given up on the router: their links have ended, and so has the shortest handshake after that.
const GIVEN_UP: Duration = Duration::from_millis(LEASE_MS + ROUTER_HANDSHAKE_MS);
/// Keys of asks to parts of robots, in any namespace.
const ASKS: &str = "**/zenav/*/ask/**";
/// A process that has started anew does not do so again for this time. On a machine without processor time to spare each start costs more
/// than it mends.
const ONCE_IN: Duration = Duration::from_secs(30);

/// Configuration of a router.
#[derive(Clone, Debug)]
pub struct RouterConfig {
    /// Endpoints to listen on; port 0 picks a free one (see [`Router::endpoints`]).
    pub listen: Vec<String>,
    /// Other routers to link to; the router retries in the background.
    pub connect: Vec<String>,
    /// Name shown by tools that inspect the network.
    pub name: String,
    /// Whether it answers Zenoh's multicast scouting. It never links by scouting itself.
    pub scouting: bool,
    /// How the links are protected.
    pub security: Security,
}

impl Default for RouterConfig {
    fn default() -> Self {
        Self {
            listen: vec![DEFAULT_ENDPOINT.to_owned()],
            connect: Vec::new(),
            name: "zenav-router".to_owned(),
            scouting: false,
            security: Security::default(),
        }
    }
}

/// A running router with a readable admin space. It stops on [`Router::close`], or when dropped.
#[derive(Debug)]
pub struct Router {
    session: Arc<Session>,
    readiness: Readiness,
    rights: Option<Arc<Rights>>,
    pace: Arc<Pace>,
    repeats: Arc<Repeats>,
}

impl Router {
    /// Starts a router that listens on the configured endpoints.
    ///
    /// # Errors
    /// [`BusError::CannotListen`] when an endpoint is in use; [`BusError::Exposed`] for an unprotected one; [`BusError::Config`] for text
    /// that is not an endpoint.
    pub async fn open(config: &RouterConfig) -> Result<Self, BusError> {
        let security = &config.security;
        let (connect, listen) = (security.endpoints(&config.connect), security.endpoints(&config.listen));
        let mut zenoh = link_settings(
            WhatAmI::Router,
            &connect,
            &listen,
            &config.name,
            security,
            ROUTER_HANDSHAKE_MS,
            None,
        )?;
        let scouting = zenoh.insert_json5("scouting/multicast/enabled", &config.scouting.to_string());
        scouting.map_err(|error| BusError::Config {
            reason: error.to_string(),
        })?;
        let session = zenoh::open(zenoh).await.map_err(|error| BusError::CannotListen {
            endpoint: listen.join(", "),
            reason: in_words(&error),
        })?;
        link::count(&session);
        pass_on_asks(&session);
        let readiness = Readiness::new(&config.name);
        // Links to other routers come and go: the router works for its own components without them.
        readiness.started();
        let session = Arc::new(session);
        let router = Self {
            repeats: Repeats::begin(&session),
            session,
            readiness,
            rights: Rights::of(security),
            pace: Arc::default(),
        };
        // Several routers differ by this key.
        let name = format!("router-{}", router.session.zid());
        router.bus(&name).serve_info("router", "", BTreeMap::new())?;
        Ok(router)
    }

    /// Endpoints that the router listens on, with the ports picked for 0.
    pub async fn endpoints(&self) -> Vec<String> {
        endpoints(&self.session).await
    }

    /// A bus on the router's own session: it needs no link, and ends with the router.
    #[must_use]
    pub fn bus(&self, name: &str) -> Bus {
        Bus {
            session: Arc::clone(&self.session),
            name: name.into(),
            readiness: self.readiness.clone(),
            rights: self.rights.clone(),
            pace: Arc::clone(&self.pace),
            repeats: Arc::clone(&self.repeats),
        }
    }

    /// Ends once this process was suspended (`SIGSTOP`, a paused container), or got no processor time, until others gave up on it. Over QUIC,
    /// Zenoh 1.10 waits half a minute for a handshake that was given up before it accepts the next link; only a new process
    /// ([`threads::restart`]) forgets these handshakes. Such a process ends this again only after half a minute. Never ends without an identity,
    /// because links over TCP do not wait for one another.
    pub async fn was_suspended(&self) {
        if self.rights.is_none() {
            return std::future::pending().await;
        }
        let begun = Instant::now();
        let mut looked = begun;
        while looked.elapsed() < GIVEN_UP || is_too_soon(begun.elapsed(), threads::was_restarted()) {
            looked = Instant::now();
            tokio::time::sleep(LOOK).await;
        }
    }

    /// Ends once Zenoh has dropped what another router declared ([`declarations`]): messages for that router's parts no longer reach them, until
    /// all links of this process are made anew. A process that was started anew ends this again only after half a minute.
    pub async fn is_deaf(&self) {
        let begun = Instant::now();
        declarations::dropped().await;
        while is_too_soon(begun.elapsed(), threads::was_restarted()) {
            tokio::time::sleep(LOOK).await;
        }
    }

    /// Stops the router and closes every link.
    pub async fn close(self) {
        match tokio::time::timeout(CLOSE_TIMEOUT, self.session.close()).await {
            Ok(Err(error)) => tracing::warn!(%error, "closing the router failed"),
            Err(_) => tracing::warn!("closing the router takes long"),
            Ok(Ok(())) => {}
        }
    }
}

/// Has the other routers send this one every ask to a robot's part, also those whose servers they do not know of.
///
/// Routers tell each other which keys their parts answer. Where two routers have a server of the same key each, and one of them ends, Zenoh 1.10.2
/// forgets to tell routers that come later of the other (`unregister_queryable` in its `hat/router/queries.rs`): parts of these routers could
/// not reach it. This router's own queryable does not answer, and is never withdrawn while its links last.
fn pass_on_asks(session: &Session) {
    if let Err(error) = session.declare_queryable(ASKS).callback(drop).background().wait() {
        tracing::warn!(%error, "asks from parts of other routers may not arrive");
    }
}

/// Whether a process that has run for `running` may not yet start anew; `was_restarted` if it already did.
fn is_too_soon(running: Duration, was_restarted: bool) -> bool {
    was_restarted && running < ONCE_IN
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_router_starts_anew_but_not_again_and_again() {
        let secs = Duration::from_secs;
        assert!(!is_too_soon(secs(6), false));
        assert!(is_too_soon(secs(6), true), "a machine without time for it");
        assert!(!is_too_soon(secs(400), true));
    }
}
