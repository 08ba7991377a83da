//! How does a part join the others, and what becomes of it when the router is away?
//!
//! Without an endpoint of its own a part is a Zenoh **client** of the router. With `listen` it is a **router** that links to the
//! others: it starts without them, keeps looking for them in the background, and whoever connects straight to it reaches its
//! topics and asks while they are gone. (A Zenoh client refuses other clients, and opens only once connected; to a peer a
//! router would carry nothing from other peers, which is what Zenoh's own tools and bindings are by default.)
//! Multicast and gossip are off: nobody is found that was not named. The lease and retry times make a cut link
//! resume about one second after it heals.

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;
use tokio::time::sleep;
use zenoh::config::WhatAmI;
use zenoh::{Config, Session};

use crate::messages::exit_code;

/// Zenoh's own port: where the router is unless told otherwise.
const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// A silent link is dead after this long, ms.
const LEASE_MS: u64 = 2000;
/// The largest message taken from a link, bytes: somewhat more than the largest of the key table.
const MAX_MESSAGE: usize = 128 * 1024 * 1024;
/// The longest wait between two tries to connect.
const MAX_RETRY: Duration = Duration::from_secs(1);
/// The shortest.
const MIN_RETRY: Duration = Duration::from_millis(200);
/// Zenoh's routers look at who came and went 0.1 s after somebody did: one that comes within that of another's leaving is taken for it,
/// and is told nothing of what the others declared. A part that was started anew at once lets that time pass before it links.
const AFTER_ANOTHER: Duration = Duration::from_millis(150);
/// How long a close may take.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(3);

/// How to join.
#[derive(Clone, Debug)]
pub struct BusConfig {
    /// Routers to connect to, one of them is enough: `tcp/127.0.0.1:7447`.
    pub connect: Vec<String>,
    /// Endpoints of one's own; port 0 takes a free one (see [`Bus::endpoints`]).
    pub listen: Vec<String>,
    /// Shown to who inspects the network.
    pub name: String,
    /// Without a router: wait for one (true), or fail at once (false). A part that listens never waits.
    pub retry: bool,
}

impl Default for BusConfig {
    fn default() -> Self {
        Self {
            connect: vec![DEFAULT_ENDPOINT.to_owned()],
            listen: Vec::new(),
            name: "zenav".to_owned(),
            retry: true,
        }
    }
}

impl BusConfig {
    /// A service of the router at `endpoint`: waits for it.
    #[must_use]
    pub fn service(name: &str, endpoint: &str) -> Self {
        Self {
            connect: vec![endpoint.to_owned()],
            name: name.to_owned(),
            ..Self::default()
        }
    }

    /// A command at `endpoint`: fails at once when nobody is there.
    #[must_use]
    pub fn command(name: &str, endpoint: &str) -> Self {
        Self {
            retry: false,
            ..Self::service(name, endpoint)
        }
    }
}

/// Why there is no link.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum BusError {
    /// Nobody answers there.
    #[error("cannot connect to {endpoint}")]
    CannotConnect {
        /// Where, several separated by commas.
        endpoint: String,
    },
    /// The endpoint is taken, or not this machine's.
    #[error("cannot listen on {endpoint}: {reason}")]
    CannotListen {
        /// Where, several separated by commas.
        endpoint: String,
        /// Zenoh's words.
        reason: String,
    },
    /// Not an endpoint, or neither one to connect to nor one to listen on.
    #[error("bad bus configuration: {reason}")]
    Config {
        /// Zenoh's words.
        reason: String,
    },
    /// Not a key.
    #[error("bad key {key}: {reason}")]
    Key {
        /// The key.
        key: String,
        /// Zenoh's words.
        reason: String,
    },
    /// The bus was closed.
    #[error("the bus is closed")]
    Closed,
}

impl BusError {
    /// The exit code of a command line that has no link.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::CannotConnect { .. } | Self::Closed => exit_code::CANNOT_CONNECT,
            Self::CannotListen { .. } => exit_code::FAILED,
            Self::Config { .. } | Self::Key { .. } => exit_code::USAGE,
        }
    }
}

/// A part's link to the others. Clones share it; it closes with [`Bus::close`] or with its last clone.
#[derive(Clone, Debug)]
pub struct Bus {
    pub(super) session: Session,
    name: Arc<str>,
}

impl Bus {
    /// Joins.
    ///
    /// # Errors
    /// [`BusError::CannotConnect`] without `retry`; with it this waits until a router is there (drop the future to give up).
    /// [`BusError::CannotListen`] and [`BusError::Config`] at once.
    pub async fn open(config: BusConfig) -> Result<Self, BusError> {
        let mode = match (config.listen.is_empty(), config.connect.is_empty()) {
            (true, true) => {
                return Err(BusError::Config {
                    reason: "neither an endpoint to connect to nor one to listen on".into(),
                });
            }
            (true, false) => WhatAmI::Client,
            (false, _) => WhatAmI::Router,
        };
        let zenoh = link_settings(mode, &config.connect, &config.listen, &config.name)?;
        if mode == WhatAmI::Router && !config.connect.is_empty() {
            sleep(AFTER_ANOTHER).await;
        }
        let mut wait = MIN_RETRY;
        loop {
            match zenoh::open(zenoh.clone()).await {
                Ok(session) => {
                    return Ok(Self {
                        session,
                        name: config.name.into(),
                    });
                }
                Err(error) if mode == WhatAmI::Router => {
                    return Err(BusError::CannotListen {
                        endpoint: config.listen.join(", "),
                        reason: error.to_string(),
                    });
                }
                Err(error) if config.retry => {
                    tracing::debug!(endpoints = ?config.connect, %error, "no router yet");
                    sleep(wait).await;
                    wait = (wait * 2).min(MAX_RETRY);
                }
                Err(error) => {
                    tracing::debug!(endpoints = ?config.connect, %error, "cannot connect");
                    return Err(BusError::CannotConnect {
                        endpoint: config.connect.join(", "),
                    });
                }
            }
        }
    }

    /// The name given at the start.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// This session's Zenoh id, as the admin space shows it.
    #[must_use]
    pub fn zid(&self) -> String {
        self.session.zid().to_string()
    }

    /// The endpoints this part listens on, with the ports that were taken for 0.
    pub async fn endpoints(&self) -> Vec<String> {
        endpoints(&self.session).await
    }

    /// Whether a router is linked now.
    pub async fn is_connected(&self) -> bool {
        self.session.info().routers_zid().await.next().is_some()
    }

    /// Sends what is queued and leaves. What was declared on any clone ends; whoever waits on it gets its end.
    pub async fn close(&self) {
        if tokio::time::timeout(CLOSE_TIMEOUT, self.session.close()).await.is_err() {
            tracing::warn!(name = %self.name, "the bus did not close in time");
        }
    }

    /// The key, or what is wrong with it.
    pub(super) fn key(key: String) -> Result<zenoh::key_expr::KeyExpr<'static>, BusError> {
        zenoh::key_expr::KeyExpr::new(key.clone()).map_err(|error| BusError::Key {
            key,
            reason: error.to_string(),
        })
    }

    /// The result of a declaration: it fails on a closed session only, the key was checked before.
    pub(super) fn declared<T>(&self, result: zenoh::Result<T>) -> Result<T, BusError> {
        result.map_err(|error| {
            if !self.session.is_closed() {
                tracing::warn!(%error, "Zenoh refused a declaration");
            }
            BusError::Closed
        })
    }
}

/// The endpoints of a session that listens.
pub(super) async fn endpoints(session: &Session) -> Vec<String> {
    session
        .info()
        .locators()
        .await
        .into_iter()
        .map(|locator| locator.to_string())
        .collect()
}

/// The settings that all sessions share, router and tests included.
pub(super) fn link_settings(
    mode: WhatAmI,
    connect: &[String],
    listen: &[String],
    name: &str,
) -> Result<Config, BusError> {
    let mut text = String::from("{");
    let mut set = |key: &str, value: String| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{key}: {value}, ");
    };
    let json = |value: &[String]| serde_json::Value::from(value).to_string();
    set("mode", format!("\"{mode}\""));
    set("metadata", serde_json::json!({ "name": name }).to_string());
    // A client tries once, and `Bus::open` loops; reconnecting after a loss is Zenoh's own. The others try for ever in the background.
    let timeout_ms = if mode == WhatAmI::Client { 0 } else { -1 };
    set(
        "connect",
        format!(
            "{{ endpoints: {}, timeout_ms: {timeout_ms}, exit_on_failure: false, retry: {{ period_init_ms: {}, period_max_ms: {}, period_increase_factor: 2 }} }}",
            json(connect),
            MIN_RETRY.as_millis(),
            MAX_RETRY.as_millis()
        ),
    );
    set(
        "listen",
        format!(
            "{{ endpoints: {}, timeout_ms: 0, exit_on_failure: true }}",
            json(listen)
        ),
    );
    set(
        "open",
        "{ return_conditions: { connect_scouted: false, declares: false } }".into(),
    );
    set(
        "scouting",
        "{ delay: 0, multicast: { enabled: false }, gossip: { enabled: false } }".into(),
    );
    // The advanced publishers' caches need time stamps.
    set("timestamping", "{ enabled: true }".into());
    set(
        "transport",
        format!(
            "{{ unicast: {{ open_timeout: 1000, accept_timeout: 2000 }}, link: {{ tx: {{ lease: {LEASE_MS} }}, rx: {{ max_message_size: {MAX_MESSAGE} }} }} }}"
        ),
    );
    if mode == WhatAmI::Router {
        set(
            "adminspace",
            "{ enabled: true, permissions: { read: true, write: false } }".into(),
        );
    }
    text.push('}');
    Config::from_json5(&text).map_err(|error| BusError::Config {
        reason: error.to_string(),
    })
}
