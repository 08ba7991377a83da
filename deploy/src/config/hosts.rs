//! Sections of a deployment of many hosts. Which machines there are, and what runs on each.

use serde::{Deserialize, Serialize};
use zenav_protocol::settings;

/// Purpose of a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// On a robot: runs its edge.
    Robot,
    /// At a site, near its robots: runs the site's router, and services.
    EdgeSite,
    /// Anywhere: runs the fleet's routers, and services.
    Cloud,
    /// An operator's machine.
    Operator,
}

settings! {
    /// A machine of the deployment.
    pub struct HostSection {
        /// Purpose: `robot`, `edge_site`, `cloud` or `operator`.
        pub role: Option<Role> = None;
        /// Name or IPv4 address at which the other hosts reach it, without a port.
        pub address: String = String::new();
        /// Parts that run on it: `router`, `world`, `mapping`, `motion`, `mission`, `gateway`, `edge:ROBOT`; `mapping:ROBOT` and
        /// `mission:ROBOT` serve one robot only.
        pub runs: Vec<String> = Vec::new();
        /// Hosts whose routers it dials; empty: those of the cloud, or of the edge sites if there is no cloud host.
        pub connect: Vec<String> = Vec::new();
    }
}
