//! Router. Where do all parts of a deployment meet? At Zenoh's router, embedded, so that one binary is all there is to install.

use zenav_protocol::bus::{BusError, Router, RouterConfig, Shutdown};

/// Runs a router until the shutdown.
///
/// # Errors
/// [`BusError::CannotListen`] when an endpoint is taken, [`BusError::Config`] when it is not one.
pub async fn run(config: RouterConfig, shutdown: Shutdown) -> Result<(), BusError> {
    let router = Router::open(&config).await?;
    tracing::info!(endpoints = ?router.endpoints().await, "router up");
    shutdown.wait().await;
    router.close().await;
    Ok(())
}
