//! Layout. Which part runs on which host, where it listens, and what it dials. Pure: computed from a deployment alone.
//!
//! Robots dial out, to the routers of the cloud (or of their site); a robot is dialled only to stop it. A part beside a router dials that
//! router first, and the others when it is gone. Of two routers with one role the second by name dials the first.

use std::net::IpAddr;
use std::path::{Path, PathBuf};

use zenav_protocol::config_text::OutOfBounds;

use super::part::Part;
use super::problems;
use crate::config::{Deployment, Profile, RobotSection, Role};

/// Zenoh's default port, where routers listen.
pub const ROUTER_PORT: u16 = 7447;
/// Port of a served world, for the robots in it.
pub const WORLD_PORT: u16 = 7446;
/// Zenoh's port for scouting.
pub const SCOUTING_PORT: u16 = 7446;
/// Port of the own endpoint of a host's first robot; further robots take the next ports.
pub const EDGE_PORT: u16 = 7450;
/// Port of the health endpoint of a host's first part; further parts take the next ports.
pub const METRICS_PORT: u16 = 9464;

/// A deployment laid out on its hosts.
#[derive(Clone, Debug)]
pub struct Layout<'d> {
    /// The deployment.
    pub deployment: &'d Deployment,
    /// How links are protected.
    pub profile: Profile,
    /// Its hosts, by name.
    pub hosts: Vec<Host>,
}

/// A host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Host {
    /// Name of the host.
    pub name: String,
    /// Purpose of the host.
    pub role: Role,
    /// Name or address at which other hosts reach it.
    pub address: String,
    /// Parts that run on it, in the order of the file.
    pub parts: Vec<Part>,
    /// Hosts whose routers its parts dial, the preferred one first.
    pub routers: Vec<String>,
}

impl Host {
    /// Whether a part of this kind runs on it.
    #[must_use]
    pub fn runs(&self, kind: &str) -> bool {
        self.parts.iter().any(|part| part.kind() == kind)
    }

    /// Port of this host for a part's Zenoh link, if the part listens.
    #[must_use]
    pub fn port(&self, deployment: &Deployment, part: &Part) -> Option<u16> {
        match part {
            Part::Router => Some(ROUTER_PORT),
            Part::World => Some(WORLD_PORT),
            Part::Edge(robot) => {
                let named = deployment
                    .robots
                    .get(robot.as_str())
                    .and_then(|robot| port_of(&robot.listen));
                let edges = self.parts.iter().filter(|part| part.kind() == "edge");
                let place = edges.take_while(|other| *other != part).count();
                named.or_else(|| u16::try_from(place).ok().map(|place| EDGE_PORT + place))
            }
            Part::Mapping(_) | Part::Motion | Part::Mission(_) | Part::Gateway => None,
        }
    }

    /// Port of this host for a part's health endpoint.
    #[must_use]
    pub fn metrics_port(&self, part: &Part) -> u16 {
        let place = self.parts.iter().take_while(|other| *other != part).count();
        METRICS_PORT + u16::try_from(place).unwrap_or_default()
    }
}

/// Whether an endpoint is on loopback.
pub(super) fn is_loopback(endpoint: &str) -> bool {
    let host = host_of(endpoint);
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// The name or address in `PROTOCOL/HOST:PORT` or `HOST:PORT`, an IPv6 one without its brackets.
pub(super) fn host_of(endpoint: &str) -> &str {
    let address = endpoint.rsplit_once('/').map_or(endpoint, |(_, address)| address);
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    host.trim_start_matches('[').trim_end_matches(']')
}

/// The port of an endpoint; `None` for port 0.
pub(super) fn port_of(endpoint: &str) -> Option<u16> {
    let (_, port) = endpoint.rsplit_once(':')?;
    port.parse().ok().filter(|port| *port != 0)
}

impl<'d> Layout<'d> {
    /// Lays out a deployment.
    ///
    /// # Errors
    /// All problems with its hosts, by key.
    pub fn of(deployment: &'d Deployment) -> Result<Self, Vec<OutOfBounds>> {
        let problems = problems::of(deployment);
        if !problems.is_empty() {
            return Err(problems);
        }
        let hosts = deployment.hosts.iter().filter_map(|(name, section)| {
            Some(Host {
                name: name.clone(),
                role: section.role?,
                address: section.address.clone(),
                parts: section.runs.iter().filter_map(|entry| entry.parse().ok()).collect(),
                routers: routers(deployment, name),
            })
        });
        Ok(Self {
            deployment,
            profile: deployment.security.profile.unwrap_or(Profile::Mtls),
            hosts: hosts.collect(),
        })
    }

    /// All parts with their hosts.
    pub fn parts(&self) -> impl Iterator<Item = (&Host, &Part)> {
        self.hosts
            .iter()
            .flat_map(|host| host.parts.iter().map(move |part| (host, part)))
    }

    /// The host with this name.
    #[must_use]
    pub fn host(&self, name: &str) -> Option<&Host> {
        self.hosts.iter().find(|host| host.name == name)
    }

    /// The host that serves the world.
    #[must_use]
    pub fn world(&self) -> Option<&Host> {
        self.hosts.iter().find(|host| host.runs("world"))
    }

    /// Section of the robot whose edge the part is.
    #[must_use]
    pub fn robot(&self, part: &Part) -> Option<&'d RobotSection> {
        match part {
            Part::Edge(robot) => self.deployment.robots.get(robot.as_str()),
            _ => None,
        }
    }

    /// Whether the part is the edge of a robot in the served world.
    #[must_use]
    pub fn attaches(&self, part: &Part) -> bool {
        self.robot(part).is_some_and(|robot| robot.attach)
    }

    /// Hosts whose routers a host's router dials: if both ends of a link dialled each other, it would be made twice.
    #[must_use]
    pub fn dialled_by_router<'h>(&'h self, host: &'h Host) -> Vec<&'h Host> {
        let others = host.routers.iter().filter(|name| **name != host.name);
        others
            .filter_map(|name| self.host(name))
            .filter(|other| !other.routers.contains(&host.name) || other.name < host.name)
            .collect()
    }

    /// Common name required in a part's certificate.
    #[must_use]
    pub fn identity(&self, host: &Host, part: &Part) -> String {
        match part {
            Part::Router | Part::World => format!("router.{}", host.name),
            // A robot simulated in its own process publishes the simulated time to everybody, which no robot role may.
            Part::Edge(_) if self.is_simulated(part) => format!("router.{}", host.name),
            Part::Edge(robot) => format!("robot.{robot}"),
            Part::Gateway => format!("operator.{}", host.name),
            Part::Mapping(_) | Part::Motion | Part::Mission(_) => format!("service.{}", host.name),
        }
    }

    /// Whether the edge's own process simulates the robot's body.
    fn is_simulated(&self, part: &Part) -> bool {
        self.robot(part).is_some_and(|robot| !robot.attach && !robot.driver)
    }

    /// Files of a part's identity; a part that is dialled also needs the list of members.
    #[must_use]
    pub fn identity_files(&self, host: &Host, part: &Part) -> Vec<&'static str> {
        let mut files = vec!["ca.pem", "cert.pem", "key.pem"];
        if host.port(self.deployment, part).is_some() {
            files.push("members.txt");
        }
        files
    }

    /// File of the page's token on a host.
    #[must_use]
    pub fn token_file(&self) -> Option<PathBuf> {
        let file = self.deployment.gateway.settings.token_file.as_ref();
        file.map(|file| Path::new(super::command_line::CONFIG).join(file))
    }

    /// Port of the page, if other machines can reach it.
    #[must_use]
    pub fn page_port(&self) -> Option<u16> {
        let listen = &self.deployment.gateway.settings.listen;
        port_of(listen).filter(|_| self.token_file().is_some() && !is_loopback(listen))
    }

    /// Transport protocol of Zenoh's links, by its Kubernetes name.
    #[must_use]
    pub fn transport(&self) -> &'static str {
        match self.profile {
            Profile::Open => "TCP",
            Profile::Mtls => "UDP",
        }
    }

    /// `tcp` or `quic`.
    #[must_use]
    pub fn protocol(&self) -> &'static str {
        match self.profile {
            Profile::Open => "tcp",
            Profile::Mtls => "quic",
        }
    }
}

/// Hosts whose routers a host's parts dial.
pub(super) fn routers(deployment: &Deployment, name: &str) -> Vec<String> {
    let Some(section) = deployment.hosts.get(name) else {
        return Vec::new();
    };
    let has_router = |host: &&String| {
        let runs = deployment.hosts.get(*host).map(|host| &host.runs);
        runs.is_some_and(|runs| runs.iter().any(|part| part == "router"))
    };
    let of_role = |role: Role| -> Vec<String> {
        let hosts = deployment.hosts.iter().filter(|(_, host)| host.role == Some(role));
        hosts.map(|(name, _)| name).filter(has_router).cloned().collect()
    };
    let mut routers = section.connect.clone();
    if routers.is_empty() {
        routers = of_role(Role::Cloud);
    }
    if routers.is_empty() {
        routers = of_role(Role::EdgeSite);
    }
    routers.retain(|router| router != name);
    if has_router(&&name.to_owned()) {
        routers.insert(0, name.to_owned());
    }
    routers
}
