//! Session. How does a component connect to the others, and what happens while the router is away?
//!
//! Without an endpoint of its own, a component is a Zenoh **client** of the router. With `listen` it is a **router** that links to the
//! others: it starts without them, keeps trying to reach them in the background, and a client connected directly to it can use its topics
//! and asks meanwhile. (A Zenoh client refuses other clients, and opens only once connected; and a router does not forward messages of
//! peers to a peer, which is the default mode of Zenoh's own tools and bindings.) Scouting and gossip are off: a session links only to
//! configured endpoints. Zenoh's admin space shows every component with its name (`@/*/*`). With these lease and retry times a cut link
//! resumes about one second after it heals. On a slow link the handshake alone may take longer than an attempt on a cut link should: longer
//! limits are tried if the endpoint accepts connections but the link does not come up.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use serde_json::{Value, json};
use thiserror::Error;
use tokio::time::{Instant, sleep};
use zenav_observability::{Condition, Readiness};
use zenoh::config::WhatAmI;
use zenoh::{Config, Session};

use super::limiter::Pace;
use super::link::{self, SETTLING};
use super::probe::Probing;
use super::repeat::Repeats;
use super::rights::{Denied, Rights};
use super::security::{Security, certificates};

/// Default endpoint of the router: Zenoh's own port.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";
/// Default endpoint of a robot: it can be stopped there without a router.
pub const ROBOT_ENDPOINT: &str = "tcp/127.0.0.1:7450";

/// A silent link counts as dead after this time, ms.
pub(super) const LEASE_MS: u64 = 2000;
/// Time limits of a link's handshake, ms, tried in order. A handshake takes three round trips, and four at most with certificates; the last limit
/// is for a round trip of 5 s. The shortest comes first: on a cut link each attempt takes this long, which also delays reconnection after
/// the link heals.
const HANDSHAKES_MS: [u64; 3] = [1000, 3000, 20_000];
/// As above, for commands, which do not wait forever.
const COMMAND_HANDSHAKES_MS: [u64; 2] = [1000, 8000];
/// The same over QUIC, where a handshake continues by itself when a link heals.
const QUIC_HANDSHAKES_MS: [u64; 2] = [3000, 20_000];
const QUIC_COMMAND_HANDSHAKES_MS: [u64; 1] = [3000];
/// Time limit of a handshake beyond which the link counts as slow, ms.
const SLOW_MS: u64 = 3000;
/// Time limit of a handshake between routers, ms, and of an incoming handshake as seen by the accepting side.
pub(super) const ROUTER_HANDSHAKE_MS: u64 = 2000;
const ACCEPTED_MS: u64 = 20_000;
/// Most incoming handshakes at a time.
const ACCEPTED: u64 = 1000;
/// Size of the TCP send buffer of a link that may be narrow, bytes; Linux doubles it, and a fifth is its own. What waits there leaves in order,
/// whatever its priority, and by itself Linux lets megabytes wait: a minute's worth on a link of 256 kbit/s, two seconds' with this limit. It
/// passes 0.4 Mbit/s over a round trip of 1 s.
const NARROW_SEND_BUFFER: u32 = 32 * 1024;
/// Time after which a client's router is probed.
const PROBED: Duration = Duration::from_millis(500);
/// Time until a link is reported, on top of the handshake limit.
const SHOWS: Duration = Duration::from_millis(600);
/// Largest message accepted from a link, bytes: more than the largest of the key table.
const MAX_MESSAGE: usize = 128 * 1024 * 1024;
/// Longest pause between two attempts to connect, ms.
const MAX_RETRY_MS: u64 = 400;
/// Shortest pause between two attempts to connect, ms.
const MIN_RETRY_MS: u64 = 200;
/// Longest time until the endpoint of a closed session is free again: over QUIC whoever is linked to it takes leave first.
const FREED: Duration = Duration::from_secs(15);
/// Time limit for closing a session.
pub(super) const CLOSE_TIMEOUT: Duration = Duration::from_secs(3);

/// Configuration of a session.
#[derive(Clone, Debug)]
pub struct BusConfig {
    /// Endpoints of routers, such as `tcp/127.0.0.1:7447`; a link to one of them is enough.
    pub connect: Vec<String>,
    /// Endpoints to listen on; port 0 picks a free one (see [`Bus::endpoints`]).
    pub listen: Vec<String>,
    /// Name shown by tools that inspect the network.
    pub name: String,
    /// Whether to wait for a router instead of failing at once. A component that listens never waits.
    pub retry: bool,
    /// How the links are protected.
    pub security: Security,
    /// Zenoh's prefix for every key of this session, such as `site1`; empty for none. Sessions in other namespaces are not visible.
    pub namespace: String,
    /// Whether its links may be narrow, as a robot's: little then waits in the send buffer of a TCP link. It carries some 50 kB per round trip.
    pub is_narrow: bool,
}

impl Default for BusConfig {
    fn default() -> Self {
        Self {
            connect: vec![DEFAULT_ENDPOINT.to_owned()],
            listen: Vec::new(),
            name: "zenav".to_owned(),
            retry: true,
            security: Security::default(),
            namespace: String::new(),
            is_narrow: false,
        }
    }
}

impl BusConfig {
    /// For a service: waits until the router at `endpoint` is available; of several endpoints, separated by commas, one is enough.
    #[must_use]
    pub fn service(name: &str, endpoint: &str) -> Self {
        Self {
            connect: endpoint.split(',').map(|one| one.trim().to_owned()).collect(),
            name: name.to_owned(),
            ..Self::default()
        }
    }

    /// The same configuration in a namespace; empty for none.
    #[must_use]
    pub fn within(self, namespace: &str) -> Self {
        Self {
            namespace: namespace.to_owned(),
            ..self
        }
    }

    /// For a command: fails at once if there is no router at `endpoint`.
    #[must_use]
    pub fn command(name: &str, endpoint: &str) -> Self {
        Self {
            retry: false,
            ..Self::service(name, endpoint)
        }
    }
}

/// Why a session or a declaration failed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum BusError {
    /// No router answers at the endpoint.
    #[error("cannot connect to {endpoint}")]
    CannotConnect {
        /// The endpoints, separated by commas.
        endpoint: String,
    },
    /// The endpoint is in use, or belongs to another machine.
    #[error("cannot listen on {endpoint}: {reason}")]
    CannotListen {
        /// The endpoints, separated by commas.
        endpoint: String,
        /// What Zenoh reports.
        reason: String,
    },
    /// Other machines could reach an unprotected endpoint.
    #[error(
        "{endpoint} can be reached by other machines, which could then command every robot: expected an identity (`--identity FOLDER`, made by `zenav keys`), an address of loopback, or `--insecure`"
    )]
    Exposed {
        /// The endpoint that was to be opened.
        endpoint: String,
    },
    /// An endpoint is malformed, does not match the identity, or none is configured.
    #[error("{reason}")]
    Config {
        /// What Zenoh reports.
        reason: String,
    },
    /// The text is not a valid key.
    #[error("bad key {key}: {reason}")]
    Key {
        /// The invalid text.
        key: String,
        /// What Zenoh reports.
        reason: String,
    },
    /// This process's member of the fleet may not use the key.
    #[error(transparent)]
    Denied(#[from] Denied),
    /// The bus was closed.
    #[error("the bus is closed")]
    Closed,
}

/// A component's session. Clones share it; it closes with [`Bus::close`] or with its last clone.
#[derive(Clone, Debug)]
pub struct Bus {
    pub(super) session: Arc<Session>,
    pub(super) name: Arc<str>,
    pub(super) readiness: Readiness,
    /// Rights of this process; `None` if its links are not controlled.
    pub(super) rights: Option<Arc<Rights>>,
    /// The time by which rates are limited.
    pub(super) pace: Arc<Pace>,
    /// The sources of the session whose last numbers are repeated.
    pub(super) repeats: Arc<Repeats>,
}

impl Bus {
    /// Opens a session with the configured endpoints.
    ///
    /// # Errors
    /// [`BusError::CannotConnect`] unless `retry` is set; with it, this waits until a router is available (drop the future to give up).
    /// [`BusError::CannotListen`], [`BusError::Exposed`] and [`BusError::Config`] at once.
    pub async fn open(mut config: BusConfig) -> Result<Self, BusError> {
        config.connect = config.security.endpoints(&config.connect);
        config.listen = config.security.endpoints(&config.listen);
        let mode = match (config.listen.is_empty(), config.connect.is_empty()) {
            (true, true) => {
                return Err(BusError::Config {
                    reason: "expected an endpoint to connect to, or one to listen on".into(),
                });
            }
            (true, false) => WhatAmI::Client,
            (false, _) => WhatAmI::Router,
        };
        if mode == WhatAmI::Router && !config.connect.is_empty() {
            // It may just have been restarted.
            sleep(SETTLING).await;
        }
        let is_part = config.is_part();
        let readiness = if is_part {
            Readiness::new(&config.name)
        } else {
            Readiness::unlisted(&config.name)
        };
        let linked = (!config.connect.is_empty()).then(|| readiness.expects_silently("a router is linked"));
        let mut wait_ms = MIN_RETRY_MS;
        let limits = config.handshakes(mode);
        let (mut limit, mut was_doubted) = (0, false);
        let mut closed = None::<Instant>;
        loop {
            let handshake = limits.get(limit).copied().unwrap_or(SLOW_MS);
            // A client that links at once needs no probe.
            let after = if mode == WhatAmI::Router {
                Duration::ZERO
            } else {
                PROBED
            };
            let mut probing = Probing::begin(&config.connect, limit + 1 < limits.len(), after);
            let began = Instant::now();
            let opened = zenoh::open(config.settings(mode, handshake)?).await;
            let is_slow = began.elapsed() >= Duration::from_millis(handshake);
            match opened {
                // The session listens, and links in the background. If the endpoint answers but the link is not up yet, the link is slow.
                Ok(session)
                    if mode == WhatAmI::Router
                        && probing.has_answer().await
                        && !is_linked(&session, Duration::from_millis(handshake) + SHOWS).await =>
                {
                    let _ = tokio::time::timeout(CLOSE_TIMEOUT, session.close()).await;
                    closed = Some(Instant::now());
                    limit += 1;
                    tracing::info!(
                        part = config.name,
                        limit_ms = limits[limit],
                        "the link is slow: a handshake may take longer"
                    );
                }
                // Not the link was slow, but this machine or the router's, for a moment.
                Ok(session) if limit > 0 && !was_doubted && is_linked_since(began, &session, limits[0]).await => {
                    let _ = tokio::time::timeout(CLOSE_TIMEOUT, session.close()).await;
                    closed = Some(Instant::now());
                    (limit, was_doubted) = (0, true);
                }
                Ok(session) => {
                    if let Some(linked) = linked.filter(|_| is_part) {
                        link::watch_routers(&session, mode, &readiness, linked);
                    }
                    let session = Arc::new(session);
                    return Ok(Self {
                        repeats: Repeats::begin(&session),
                        session,
                        rights: Rights::of(&config.security),
                        pace: Arc::default(),
                        name: config.name.into(),
                        readiness,
                    });
                }
                Err(_) if mode == WhatAmI::Router && closed.is_some_and(|closed| closed.elapsed() < FREED) => {
                    sleep(Duration::from_millis(MIN_RETRY_MS)).await;
                }
                Err(error) if mode == WhatAmI::Router => {
                    return Err(BusError::CannotListen {
                        endpoint: config.listen.join(", "),
                        reason: in_words(&error),
                    });
                }
                Err(error) if config.retry => {
                    if wait_ms == MIN_RETRY_MS {
                        tracing::info!(
                            part = config.name,
                            endpoints = config.connect.join(", "),
                            "waits for a router"
                        );
                    }
                    tracing::debug!(endpoints = ?config.connect, %error, "no router yet");
                    limit = if is_slow && probing.has_answer().await {
                        limit + 1
                    } else {
                        0
                    };
                    sleep(Duration::from_millis(wait_ms)).await;
                    wait_ms = (wait_ms * 2).min(MAX_RETRY_MS);
                }
                Err(_) if is_slow && limit + 1 < limits.len() => limit += 1,
                Err(error) => {
                    tracing::debug!(endpoints = ?config.connect, %error, "cannot connect");
                    return Err(BusError::CannotConnect {
                        endpoint: config.connect.join(", "),
                    });
                }
            }
        }
    }

    /// The component's name, as configured.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The kind of component: its name up to the first `-`, such as `mapping` of `mapping-tiago`.
    pub(super) fn kind(&self) -> &str {
        self.name.split('-').next().unwrap_or_default()
    }

    /// From now on this component is not ready until a condition is met; `what` states it, such as `its map is loaded`.
    #[must_use]
    pub fn expects(&self, what: &str) -> Condition {
        self.readiness.expects(what)
    }

    /// Call this after the component has declared its servers and subscriptions and named its conditions; once all conditions are met, it
    /// is `ready`.
    pub fn started(&self) {
        self.readiness.started();
    }

    /// This session's Zenoh id, as the admin space shows it.
    #[must_use]
    pub fn zid(&self) -> String {
        self.session.zid().to_string()
    }

    /// Endpoints that this component listens on, with the ports picked for 0.
    pub async fn endpoints(&self) -> Vec<String> {
        endpoints(&self.session).await
    }

    /// Whether there is a link to a router now.
    pub async fn is_connected(&self) -> bool {
        self.session.info().routers_zid().await.next().is_some()
    }

    /// Sends queued messages, and closes the session. All declarations of all clones end, and so does every wait on them.
    pub async fn close(&self) {
        if tokio::time::timeout(CLOSE_TIMEOUT, self.session.close()).await.is_err() {
            tracing::warn!(name = %self.name, "the bus did not close in time");
        }
    }

    /// Parses the text of a key.
    pub(super) fn key(key: String) -> Result<zenoh::key_expr::KeyExpr<'static>, BusError> {
        zenoh::key_expr::KeyExpr::new(key.clone()).map_err(|error| BusError::Key {
            key,
            reason: in_words(&error),
        })
    }

    /// The result of a declaration; it fails only on a closed session, because the key was parsed before.
    pub(super) fn declared<T>(&self, result: zenoh::Result<T>) -> Result<T, BusError> {
        result.map_err(|error| {
            if !self.session.is_closed() {
                tracing::warn!(%error, "Zenoh refused a declaration");
            }
            BusError::Closed
        })
    }
}

impl BusConfig {
    /// Whether the session belongs to a component: it waits for a router, or is one. Any other is a command's client.
    fn is_part(&self) -> bool {
        self.retry || !self.listen.is_empty()
    }

    /// Zenoh's settings of this session.
    fn settings(&self, mode: WhatAmI, handshake_ms: u64) -> Result<Config, BusError> {
        let mut zenoh = link_settings(
            mode,
            &self.connect,
            &self.listen,
            &self.name,
            &self.security,
            handshake_ms,
            self.is_narrow.then_some(NARROW_SEND_BUFFER),
        )?;
        if !self.is_part() {
            // Routers keep the keys of an admin space for ever, and every command would add its own.
            zenoh
                .insert_json5("adminspace/enabled", "false")
                .map_err(|error| BusError::Config {
                    reason: error.to_string(),
                })?;
        }
        if !self.namespace.is_empty() {
            let wrong = |reason: String| BusError::Config {
                reason: format!("namespace `{}`: {reason}", self.namespace),
            };
            let is_key = zenoh::key_expr::KeyExpr::new(self.namespace.as_str()).is_ok();
            // On encrypted links, a key that contains `zenav` twice is denied.
            let is_reserved = self.namespace.split('/').any(|name| name == "zenav");
            if !is_key || is_reserved || self.namespace.contains(['*', '$', '@', '{']) {
                return Err(wrong(
                    "expected plain names but `zenav`, such as `site1` or `acme/site1`".into(),
                ));
            }
            let text = Value::from(self.namespace.as_str()).to_string();
            zenoh
                .insert_json5("namespace", &text)
                .map_err(|error| wrong(error.to_string()))?;
        }
        Ok(zenoh)
    }

    /// Time limits of a handshake, ms, in the order in which they are tried.
    fn handshakes(&self, mode: WhatAmI) -> &'static [u64] {
        let is_tcp = self.connect.iter().all(|endpoint| endpoint.starts_with("tcp/"));
        let waits = mode == WhatAmI::Router || self.retry;
        match (is_tcp, waits) {
            (true, true) => &HANDSHAKES_MS,
            (true, false) => &COMMAND_HANDSHAKES_MS,
            (false, true) => &QUIC_HANDSHAKES_MS,
            (false, false) => &QUIC_COMMAND_HANDSHAKES_MS,
        }
    }
}

/// Whether a session links to a router within a time.
async fn is_linked(session: &Session, limit: Duration) -> bool {
    let end = Instant::now() + limit;
    while session.info().routers_zid().await.next().is_none() {
        if Instant::now() > end {
            return false;
        }
        sleep(Duration::from_millis(10)).await;
    }
    true
}

/// Whether a session that was begun then links to a router within this time, ms.
async fn is_linked_since(began: Instant, session: &Session, limit_ms: u64) -> bool {
    let left = Duration::from_millis(limit_ms).checked_sub(began.elapsed());
    match left {
        Some(left) => is_linked(session, left).await,
        None => false,
    }
}

/// Endpoints of a session that listens.
pub(super) async fn endpoints(session: &Session) -> Vec<String> {
    session
        .info()
        .locators()
        .await
        .into_iter()
        .map(|locator| locator.to_string())
        .collect()
}

/// Text of a Zenoh error, without its source location.
pub(super) fn in_words(error: &zenoh::Error) -> String {
    let text = error.to_string();
    text.split(" at /").next().unwrap_or_default().to_owned()
}

/// Zenoh's settings, the same for all sessions.
pub(super) fn link_settings(
    mode: WhatAmI,
    connect: &[String],
    listen: &[String],
    name: &str,
    security: &Security,
    handshake_ms: u64,
    send_buffer: Option<u32>,
) -> Result<Config, BusError> {
    security.check(connect, listen)?;
    let mut settings = plain_settings(mode, connect, listen, name, handshake_ms);
    settings["transport"]["link"]["tcp"] = json!({ "so_sndbuf": send_buffer });
    security.settings(mode, listen, &mut settings)?;
    Config::from_json5(&settings.to_string()).map_err(|error| BusError::Config {
        reason: format!("Zenoh's settings: {error}"),
    })
}

/// Zenoh's settings of a client of these routers that is no part of zenav, as JSON: it waits for a router, and its links have the times of
/// zenav's own. `identity`: the folder of its identity, on its own machine.
///
/// ```
/// use zenav_protocol::bus::client_settings;
///
/// let settings = client_settings(&["tcp/127.0.0.1:7447".to_owned()], "driver", None);
/// assert_eq!(settings["mode"], "client");
/// assert_eq!(settings["scouting"]["multicast"]["enabled"], false);
/// ```
#[must_use]
pub fn client_settings(connect: &[String], name: &str, identity: Option<&Path>) -> Value {
    let handshake_ms = match identity {
        Some(_) => QUIC_HANDSHAKES_MS[0],
        None => HANDSHAKES_MS[0],
    };
    let mut settings = plain_settings(WhatAmI::Client, connect, &[], name, handshake_ms);
    settings["connect"]["timeout_ms"] = json!(-1);
    // Routers keep the keys of an admin space for ever.
    settings["adminspace"]["enabled"] = json!(false);
    if let Some(folder) = identity {
        settings["transport"]["link"]["tls"] = certificates(folder);
    }
    settings
}

/// Zenoh's settings of a session without protection.
fn plain_settings(mode: WhatAmI, connect: &[String], listen: &[String], name: &str, handshake_ms: u64) -> Value {
    // A client tries once, and `Bus::open` repeats; Zenoh itself reconnects after a loss. A router retries forever in the background.
    let timeout_ms = if mode == WhatAmI::Client { 0 } else { -1 };
    // The other side receives nothing for one round trip, a third of a handshake, after it has accepted this side.
    let is_slow = handshake_ms > SLOW_MS;
    let lease_ms = if is_slow { LEASE_MS + handshake_ms / 3 } else { LEASE_MS };
    let mut settings = json!({
        "mode": mode.to_string(),
        "metadata": { "name": name },
        "connect": {
            "endpoints": connect,
            "timeout_ms": timeout_ms,
            "exit_on_failure": false,
            "retry": { "period_init_ms": MIN_RETRY_MS, "period_max_ms": MAX_RETRY_MS, "period_increase_factor": 2 },
        },
        "listen": { "endpoints": listen, "timeout_ms": 0, "exit_on_failure": true },
        "open": { "return_conditions": { "connect_scouted": false, "declares": false } },
        "scouting": { "delay": 0, "multicast": { "enabled": false, "autoconnect": { "router": [] } }, "gossip": { "enabled": false } },
        // The caches of advanced publishers need time stamps.
        "timestamping": { "enabled": true },
        "transport": {
            // Most of a link are map patches and scans, which shrink to a fifth. A side that cannot do it is sent plain batches.
            "unicast": {
                "open_timeout": handshake_ms,
                "accept_timeout": ACCEPTED_MS,
                "accept_pending": ACCEPTED,
                "compression": { "enabled": true },
            },
            "link": { "tx": { "lease": lease_ms }, "rx": { "max_message_size": MAX_MESSAGE } },
        },
        "adminspace": { "enabled": true, "permissions": { "read": true, "write": false } },
    });
    if is_slow {
        // A link begins with few bytes a round trip, which is no reason to close it.
        settings["transport"]["link"]["tx"]["queue"]["congestion_control"]["block"]["wait_before_close"] =
            json!(handshake_ms * 1000);
    }
    settings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn little_waits_in_the_send_buffer_of_a_narrow_link_and_other_links_have_the_system_s() {
        let buffer = |is_narrow| {
            let config = BusConfig {
                is_narrow,
                ..BusConfig::default()
            };
            let settings = config.settings(WhatAmI::Router, HANDSHAKES_MS[0]).unwrap();
            settings.get_json("transport/link/tcp/so_sndbuf").unwrap()
        };
        assert_eq!(buffer(true), NARROW_SEND_BUFFER.to_string());
        assert_eq!(buffer(false), "null");
    }
}
