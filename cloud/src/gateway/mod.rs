//! Gateway service. Feeds the browser view from the bus and carries operators' requests to the robots.
//!
//! Thin: [`Hub`] keeps and serves the view; this module feeds it and forwards requests. What every browser shows (state, pose, events) is
//! taken from all robots; details (mission, goals, scans, plan, map, search tree) only from robots that a browser watches.
//!
//! | file | subject |
//! |---|---|
//! | `feed` | topics of all robots into the view, `live_hz` times a second |
//! | `detail` | topics, map and round trip of a watched robot |
//! | `asks` | goals, stop, resume: requests with deadlines |
//! | `drive` | hand control under an operator's lease |

mod asks;
mod detail;
mod drive;
mod feed;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;
use tokio::net::TcpListener;
use zenav_gateway::{Access, GatewaySettings, Hub};
use zenav_protocol::bus::{Bus, BusError, Shutdown};
use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::messages::GoalPoint;
use zenav_protocol::settings::Settings as _;

use asks::BusOperator;

/// Time for open connections to close.
const DRAIN: Duration = Duration::from_secs(2);
/// Largest token file that is read, bytes.
const MAX_TOKEN: u64 = 4096;

/// Configuration of a gateway.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GatewayConfig {
    /// Address, access, limits.
    pub settings: GatewaySettings,
    /// Named places, shown to everybody as goals.
    pub places: BTreeMap<String, GoalPoint>,
}

/// Why the gateway cannot run.
#[derive(Debug, Error)]
pub enum GatewayError {
    /// A setting is out of bounds.
    #[error("gateway: {0}")]
    Settings(#[from] OutOfBounds),
    /// The address needs a token that is missing, or the token cannot be used.
    #[error("gateway: {0}")]
    Access(String),
    /// The address cannot be listened on.
    #[error("gateway: cannot listen on {address}: {error}")]
    Listen {
        /// The requested address.
        address: String,
        /// The error of the operating system.
        error: std::io::Error,
    },
    /// The bus was closed, or a key could not be declared.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Connections can no longer be accepted.
    #[error("gateway: {0}")]
    Serve(std::io::Error),
}

/// A gateway that is bound to its address but does not serve yet.
#[derive(Debug)]
pub struct Gateway {
    listener: TcpListener,
    access: Access,
    hub: Arc<Hub>,
    address: String,
}

impl Gateway {
    /// Binds the address of the settings after checking that it is allowed; port 0 picks a free port.
    ///
    /// # Errors
    /// [`GatewayError`] for settings out of bounds, an unreadable token file, an address that other machines reach without a token, or an
    /// address in use.
    pub async fn bind(config: GatewayConfig) -> Result<Self, GatewayError> {
        let settings = config.settings;
        settings.check()?;
        let listen = |error| GatewayError::Listen {
            address: settings.listen.clone(),
            error,
        };
        let (listener, address) = zenav_gateway::listen(&settings.listen).await.map_err(listen)?;
        let token = settings.token_file.as_deref().map(read_token).transpose()?;
        let access = Access::new(address, token, settings.origins.clone()).map_err(GatewayError::Access)?;
        Ok(Self {
            listener,
            access,
            hub: Hub::new(settings, config.places),
            address: format!("http://{address}/"),
        })
    }

    /// Address of the page, such as `http://127.0.0.1:7480/`.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Serves until shutdown, or until the bus is closed.
    ///
    /// # Errors
    /// [`GatewayError`] when a key cannot be declared or connections cannot be accepted.
    pub async fn run(self, bus: Bus, shutdown: Shutdown) -> Result<(), GatewayError> {
        let operator = Arc::new(BusOperator::new(bus.clone(), Arc::clone(&self.hub)));
        let router = zenav_gateway::router(Arc::clone(&self.hub), operator, self.access);
        let ended = {
            let (hub, shutdown) = (Arc::clone(&self.hub), shutdown.clone());
            async move {
                shutdown.wait().await;
                hub.end();
            }
        };
        let mut serving = tokio::spawn(zenav_gateway::serve(self.listener, router, ended));
        bus.serve_info("gateway", "", BTreeMap::new())?;
        bus.started();
        let details = tokio::spawn(detail::follow(bus.clone(), Arc::clone(&self.hub), shutdown.clone()));
        let fed = tokio::select! {
            fed = feed::run(bus, &self.hub, &shutdown) => fed.map_err(GatewayError::from),
            served = &mut serving => match served {
                Ok(Err(error)) => Err(GatewayError::Serve(error)),
                _ => Ok(()),
            },
        };
        self.hub.end();
        details.abort();
        // Connections that browsers keep open are aborted.
        if !serving.is_finished() && tokio::time::timeout(DRAIN, &mut serving).await.is_err() {
            serving.abort();
        }
        fed
    }

    /// Waits until the first message of a robot.
    pub fn first_robot(&self) -> impl Future<Output = ()> + Send + 'static {
        let hub = Arc::clone(&self.hub);
        async move { hub.first_robot().await }
    }
}

/// The first line of a token file.
fn read_token(path: &Path) -> Result<String, GatewayError> {
    let wrong = |error: String| GatewayError::Access(format!("{}: {error}", path.display()));
    let length = std::fs::metadata(path).map_err(|error| wrong(error.to_string()))?.len();
    if length > MAX_TOKEN {
        return Err(wrong(format!("expected a token of at most {MAX_TOKEN} bytes")));
    }
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    Ok(text.lines().next().unwrap_or_default().trim().to_owned())
}
