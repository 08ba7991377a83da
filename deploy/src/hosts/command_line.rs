//! Command line of a part. The `zenav` arguments on a host, in a container, in a pod. Pure.
//!
//! Settings come from the deployment file, which is the same everywhere; flags hold what differs between hosts.

use std::net::IpAddr;

use super::layout::{Host, Layout, METRICS_PORT, host_of, is_loopback};
use super::part::Part;
use crate::config::Profile;

/// Folder of the deployment file and the files that it names.
pub(super) const CONFIG: &str = "/etc/zenav";
/// Data folder of a part in a container.
pub(super) const DATA: &str = "/var/lib/zenav";
/// Folder of a part's identity in a container, or of all identities on a host. Separate from that of the deployment file, which every
/// container sees.
pub(super) const IDENTITY: &str = "/etc/zenav-identity";

/// File of the page's token in a container.
pub(super) const TOKEN: &str = "/etc/zenav-page/token";

/// Where a part runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// How it dials other parts.
    pub(super) addresses: Addresses,
    /// Its data folder.
    pub(super) data: String,
    /// Folder of its identity.
    pub(super) identity: String,
    /// File of the page's token, if the page requires one.
    pub(super) token: String,
    /// Address and port of its health and metrics.
    pub(super) metrics: String,
    /// Name of its motion workers.
    pub(super) worker: String,
}

/// How parts are dialled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Addresses {
    /// By the address of its host.
    Hosts,
    /// By the name of the container or service: each has its own address.
    Names,
}

impl Place {
    /// A separate container or pod called `name`.
    pub(super) fn container(name: &str) -> Self {
        Self {
            addresses: Addresses::Names,
            data: DATA.to_owned(),
            identity: IDENTITY.to_owned(),
            token: TOKEN.to_owned(),
            metrics: format!("0.0.0.0:{METRICS_PORT}"),
            worker: name.to_owned(),
        }
    }
}

/// Unique name of a part in a deployment, for its container, service or pod.
pub(super) fn name(host: &Host, part: &Part) -> String {
    format!("{}-{}", host.name, part.name())
}

/// The endpoint at which a part that listens is dialled.
pub(super) fn endpoint(layout: &Layout<'_>, host: &Host, part: &Part, addresses: Addresses) -> String {
    let address = match addresses {
        Addresses::Hosts => host.address.clone(),
        Addresses::Names => name(host, part),
    };
    let port = host.port(layout.deployment, part).unwrap_or_default();
    format!("{}/{address}:{port}", layout.protocol())
}

/// The arguments of `zenav` for a part.
pub(super) fn arguments(layout: &Layout<'_>, host: &Host, part: &Part, place: &Place) -> Vec<String> {
    let mut line = Line(Vec::new());
    let own_host = match (part, place.addresses) {
        // A robot may listen on one of its host's addresses only.
        (Part::Edge(_), Addresses::Hosts) => layout
            .robot(part)
            .map(|robot| host_of(&robot.listen))
            .filter(|named| named.parse::<IpAddr>().is_ok_and(|address| !address.is_loopback())),
        _ => None,
    };
    let own_host = match own_host.unwrap_or("0.0.0.0") {
        address if address.contains(':') => format!("[{address}]"),
        address => address.to_owned(),
    };
    let listen = host
        .port(layout.deployment, part)
        .map(|port| format!("{}/{own_host}:{port}", layout.protocol()));
    let dial = |host: &Host, part: &Part| endpoint(layout, host, part, place.addresses);
    let routers: Vec<String> = host
        .routers
        .iter()
        .filter_map(|name| layout.host(name))
        .map(|router| dial(router, &Part::Router))
        .collect();
    let service = |line: &mut Line, words: &[&str]| {
        line.words(words);
        line.flag("--deployment", format!("{CONFIG}/deployment.toml"));
        line.flag("--connect", routers.join(","));
    };
    match part {
        Part::Router => {
            line.words(&["router"]);
            for other in layout.dialled_by_router(host) {
                line.flag("--connect", dial(other, &Part::Router));
            }
            let router = &layout.deployment.router;
            for other in &router.connect {
                line.flag("--connect", other.clone());
            }
            if !router.rest.is_empty() {
                line.flag("--rest", router.rest.clone());
            }
            if router.scouting {
                line.words(&["--scouting"]);
            }
        }
        Part::World => {
            let simulation = &layout.deployment.simulation;
            line.words(&["sim", "serve"]);
            line.flag("--world", simulation.world.clone());
            line.flag("--speed", simulation.speed.to_string());
            line.flag("--seed", simulation.seed.to_string());
            if !layout.deployment.bus.namespace.is_empty() {
                line.flag("--namespace", layout.deployment.bus.namespace.clone());
            }
            for router in &routers {
                line.flag("--connect", router.clone());
            }
        }
        Part::Edge(_) => {
            service(&mut line, &["edge"]);
            if let Some(world) = layout.world().filter(|_| layout.attaches(part)) {
                line.flag("--attach-to", dial(world, &Part::World));
            }
        }
        Part::Mapping(_) => service(&mut line, &["cloud", "mapping"]),
        Part::Motion => {
            service(&mut line, &["cloud", "motion"]);
            line.flag("--worker", place.worker.clone());
        }
        Part::Mission(_) => {
            service(&mut line, &["cloud", "mission"]);
            line.flag("--holder", host.name.clone());
        }
        Part::Gateway => {
            service(&mut line, &["gateway"]);
            if layout.token_file().is_some() {
                line.flag("--token-file", place.token.clone());
            }
        }
    }
    if let Some(robot) = part.robot() {
        line.flag("--robot", robot.to_string());
    }
    if part.keeps_data() {
        line.flag("--data", place.data.clone());
    }
    let is_reachable = listen.is_some() || !is_loopback(&place.metrics);
    if let Some(listen) = listen {
        line.flag("--listen", listen);
    }
    match layout.profile {
        Profile::Open if is_reachable => line.words(&["--insecure"]),
        Profile::Open => {}
        Profile::Mtls => line.flag("--identity", place.identity.clone()),
    }
    line.flag("--metrics", place.metrics.clone());
    line.0
}

struct Line(Vec<String>);

impl Line {
    fn words(&mut self, words: &[&str]) {
        self.0.extend(words.iter().map(|word| (*word).to_owned()));
    }

    fn flag(&mut self, flag: &str, value: String) {
        self.0.extend([flag.to_owned(), value]);
    }
}
