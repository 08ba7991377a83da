//! Router. Where do all components meet? At a Zenoh router, which any process can open.

use zenoh::Session;
use zenoh::config::WhatAmI;

use super::session::{BusError, endpoints, link_settings};

/// Configuration of a router.
#[derive(Clone, Debug)]
pub struct RouterConfig {
    /// Endpoints to listen on; port 0 picks a free one (see [`Router::endpoints`]).
    pub listen: Vec<String>,
    /// Other routers to link to; the router keeps trying in the background.
    pub connect: Vec<String>,
    /// Name shown by tools that inspect the network.
    pub name: String,
}

impl Default for RouterConfig {
    fn default() -> Self {
        Self {
            listen: vec!["tcp/127.0.0.1:7447".to_owned()],
            connect: Vec::new(),
            name: "zenav-router".to_owned(),
        }
    }
}

/// A running router with a readable admin space. It stops on [`Router::close`], or when dropped.
#[derive(Debug)]
pub struct Router {
    session: Session,
}

impl Router {
    /// Starts a router that listens on the configured endpoints.
    ///
    /// # Errors
    /// [`BusError::CannotListen`] when an endpoint is in use; [`BusError::Config`] for text that is no endpoint.
    pub async fn open(config: &RouterConfig) -> Result<Self, BusError> {
        let zenoh = link_settings(WhatAmI::Router, &config.connect, &config.listen, &config.name)?;
        let session = zenoh::open(zenoh).await.map_err(|error| BusError::CannotListen {
            endpoint: config.listen.join(", "),
            reason: error.to_string(),
        })?;
        Ok(Self { session })
    }

    /// Endpoints that the router listens on, with the ports picked for 0.
    pub async fn endpoints(&self) -> Vec<String> {
        endpoints(&self.session).await
    }

    /// Stops the router and closes every link.
    pub async fn close(self) {
        if let Err(error) = self.session.close().await {
            tracing::warn!(%error, "closing the router failed");
        }
    }
}
