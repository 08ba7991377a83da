//! Shared by the tests of the services: the router of their sessions.

use zenav_protocol::bus::{Router, RouterConfig};

/// A router on a free port, and its endpoint.
pub(crate) async fn router() -> (Router, String) {
    let config = RouterConfig {
        listen: vec!["tcp/127.0.0.1:0".into()],
        ..RouterConfig::default()
    };
    let router = Router::open(&config).await.unwrap();
    let endpoint = router.endpoints().await.remove(0);
    (router, endpoint)
}
