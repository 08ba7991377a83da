//! Sections of a deployment of many hosts. Which machines are there, and what runs on each?

use serde::{Deserialize, Serialize};
use zenav_protocol::settings;

/// What a host is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// On a robot: its edge.
    Robot,
    /// At a site, near its robots: a router of the site, and services.
    EdgeSite,
    /// Anywhere: the fleet's routers, and services.
    Cloud,
    /// A person's machine.
    Operator,
}

settings! {
    /// A machine of the deployment.
    pub struct HostSection {
        /// What it is for: `robot`, `edge_site`, `cloud` or `operator`.
        pub role: Option<Role> = None;
        /// Name or IP address at which the others reach it, without a port.
        pub address: String = String::new();
        /// The parts that run there: `router`, `world`, `mapping`, `motion`, `mission`, `gateway`, `edge:ROBOT`; `mapping:ROBOT` and
        /// `mission:ROBOT` serve one robot only.
        pub runs: Vec<String> = Vec::new();
        /// Hosts whose routers it dials; none: those of the cloud, or of the edge sites where the cloud has none.
        pub connect: Vec<String> = Vec::new();
    }
}
