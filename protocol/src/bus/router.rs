//! Where do all parts meet? At a Zenoh router, in any process that opens one.

use zenoh::Session;
use zenoh::config::WhatAmI;

use super::session::{BusError, endpoints, link_settings};

/// How a router runs.
#[derive(Clone, Debug)]
pub struct RouterConfig {
    /// Endpoints to listen on; port 0 takes a free one (see [`Router::endpoints`]).
    pub listen: Vec<String>,
    /// Other routers to link to, looked for in the background.
    pub connect: Vec<String>,
    /// Shown to who inspects the network.
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

/// A running router, with its admin space readable; ends with [`Router::close`] or when dropped.
#[derive(Debug)]
pub struct Router {
    session: Session,
}

impl Router {
    /// Starts one.
    ///
    /// # Errors
    /// [`BusError::CannotListen`] when an endpoint is taken, [`BusError::Config`] when it is not one.
    pub async fn open(config: &RouterConfig) -> Result<Self, BusError> {
        let zenoh = link_settings(WhatAmI::Router, &config.connect, &config.listen, &config.name)?;
        let session = zenoh::open(zenoh).await.map_err(|error| BusError::CannotListen {
            endpoint: config.listen.join(", "),
            reason: error.to_string(),
        })?;
        Ok(Self { session })
    }

    /// The endpoints it listens on, with the ports that were taken for 0.
    pub async fn endpoints(&self) -> Vec<String> {
        endpoints(&self.session).await
    }

    /// Ends it: every link is closed.
    pub async fn close(self) {
        if let Err(error) = self.session.close().await {
            tracing::warn!(%error, "the router did not close well");
        }
    }
}
