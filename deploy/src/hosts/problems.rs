//! Problems. Errors in the hosts of a deployment: each with its key, and what was expected.

use std::collections::{BTreeMap, BTreeSet};
use std::net::IpAddr;

use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::id::Id;

use super::layout::{EDGE_PORT, Host, ROUTER_PORT, SCOUTING_PORT, host_of, is_loopback, port_of, routers};
use super::part::{Part, is_label};
use crate::config::{Deployment, HostSection, Role, RouterSection};
use crate::keys::is_host_name;
use crate::output::listed;

/// Most letters of a host's and a part's name together: Kubernetes appends eleven, and a label holds 63.
const MOST_LETTERS: usize = 52;

/// All problems, in the order of the file's sections.
pub(super) fn of(deployment: &Deployment) -> Vec<OutOfBounds> {
    let mut found = Found(Vec::new());
    if deployment.hosts.is_empty() {
        found.add("hosts", "is missing: expected at least one section [hosts.NAME]");
        return found.0;
    }
    let mut parsed = BTreeMap::new();
    for (name, section) in &deployment.hosts {
        found.of_host(deployment, name, section);
        parsed.insert(name.as_str(), found.parts(deployment, name, section));
    }
    found.of_names(&parsed);
    found.of_places(deployment, &parsed);
    found.of_ports(deployment, &parsed);
    found.of_routers(deployment, &parsed);
    found.of_robots(deployment, &parsed);
    found.0
}

type Parsed<'d> = BTreeMap<&'d str, Vec<Part>>;

struct Found(Vec<OutOfBounds>);

impl Found {
    fn add(&mut self, key: impl Into<String>, problem: impl Into<String>) {
        self.0.push(OutOfBounds {
            key: key.into(),
            problem: problem.into(),
        });
    }

    fn of_host(&mut self, deployment: &Deployment, name: &str, section: &HostSection) {
        let key = |field: &str| format!("hosts.{name}.{field}");
        if !is_label(name) {
            self.add(
                format!("hosts.{name}"),
                "is no name of a host: expected 1 to 30 of a-z 0-9 -, which every target can use",
            );
        }
        if section.role.is_none() {
            self.add(key("role"), "is missing: expected robot, edge_site, cloud or operator");
        }
        let address = &section.address;
        let ip = address.parse::<IpAddr>().ok();
        if address.is_empty() {
            self.add(
                key("address"),
                "is missing: expected a name or an IPv4 address at which the other hosts reach it",
            );
        } else if !(ip.is_some_and(|ip| ip.is_ipv4()) || is_host_name(address)) {
            self.add(
                key("address"),
                format!("is `{address}`: expected a name or an IPv4 address, without a port"),
            );
        } else if ip.is_some_and(is_nobody_s) || (is_loopback(address) && has_others(deployment, name)) {
            self.add(
                key("address"),
                format!(
                    "is `{address}`, where no other host reaches it: expected its name or IPv4 address in their network"
                ),
            );
        }
        for (place, router) in section.connect.iter().enumerate() {
            let problem = match deployment.hosts.get(router) {
                None => "no such host",
                Some(_) if section.connect.iter().take(place).any(|earlier| earlier == router) => "a second time",
                Some(_) if router == name => "this host itself, whose router comes first anyway",
                Some(host) if !host.runs.iter().any(|part| part == "router") => "a host that runs no router",
                Some(_) => continue,
            };
            self.add(key("connect"), format!("names `{router}`: {problem}"));
        }
    }

    fn parts(&mut self, deployment: &Deployment, name: &str, section: &HostSection) -> Vec<Part> {
        let key = format!("hosts.{name}.runs");
        let mut parts = Vec::new();
        for entry in &section.runs {
            match entry.parse::<Part>() {
                Err(problem) => self.add(&key, problem),
                Ok(part) if parts.iter().any(|other: &Part| other.name() == part.name()) => {
                    let more = if part == Part::Motion {
                        ": `planning.workers` says how many workers it has"
                    } else {
                        ""
                    };
                    self.add(&key, format!("has `{entry}` twice{more}"));
                }
                Ok(part) => {
                    if let Some(robot) = part
                        .robot()
                        .filter(|robot| !deployment.robots.contains_key(robot.as_str()))
                    {
                        let known = listed(deployment.robots.keys());
                        self.add(&key, format!("has `{entry}`: no robot `{robot}`; there is {known}"));
                    }
                    let length = name.len() + 1 + part.name().len();
                    if length > MOST_LETTERS {
                        self.add(
                            &key,
                            format!("has `{entry}`, which is called {name}-{} in a cluster: {length} letters, expected at most {MOST_LETTERS}", part.name()),
                        );
                    }
                    parts.push(part);
                }
            }
        }
        let misplaced = parts.iter().find(|part| match section.role {
            Some(Role::Robot) => !matches!(part, Part::Edge(_) | Part::Router),
            Some(Role::Operator) => **part != Part::Gateway,
            _ => false,
        });
        if let Some(part) = misplaced {
            let (role, expected) = match section.role {
                Some(Role::Robot) => ("robot", "edge:ROBOT or router"),
                _ => ("operator", "gateway, or nothing"),
            };
            self.add(
                key,
                format!("has `{part}` on a host of role {role}: expected {expected}"),
            );
        }
        parts
    }

    /// Parts of two hosts that would have one name as containers: `mission-a` of `hall`, and `a` of `hall-mission`.
    fn of_names(&mut self, parsed: &Parsed<'_>) {
        let mut taken = BTreeMap::new();
        for (host, parts) in parsed {
            for part in parts {
                let name = format!("{host}-{}", part.name());
                if let Some((other, (of, first))) = taken.get_key_value(&name) {
                    let problem =
                        format!("has `{part}`, which is called {other} in a cluster, as is `{first}` of {of}");
                    self.add(
                        format!("hosts.{host}.runs"),
                        format!("{problem}: expected another name of the host"),
                    );
                } else {
                    taken.insert(name, (*host, part));
                }
            }
        }
    }

    /// Parts that run nowhere, or on two hosts where only one is allowed.
    fn of_places(&mut self, deployment: &Deployment, parsed: &Parsed<'_>) {
        let places = |wanted: &dyn Fn(&Part) -> bool| -> Vec<&str> {
            let hosts = parsed.iter().filter(|(_, parts)| parts.iter().any(wanted));
            hosts.map(|(name, _)| *name).collect()
        };
        for kind in ["router", "motion"] {
            if places(&|part| part.kind() == kind).is_empty() {
                self.add(
                    "hosts",
                    format!("run no {kind}: expected `{kind}` in the `runs` of a host"),
                );
            }
        }
        let worlds = places(&|part| *part == Part::World);
        let attached: Vec<&String> = deployment
            .robots
            .iter()
            .filter(|(_, robot)| robot.attach)
            .map(|(id, _)| id)
            .collect();
        match (&worlds[..], &attached[..]) {
            ([], [robot, ..]) => self.add(
                format!("robots.{robot}.attach"),
                "is set, and no host runs a `world` to attach to",
            ),
            ([host, ..], []) => self.add(
                format!("hosts.{host}.runs"),
                "has `world`, in which no robot is: expected `attach = true` of a robot",
            ),
            ([_, host, ..], _) => self.add(
                format!("hosts.{host}.runs"),
                format!("has `world`, which {} serves already: expected one world", worlds[0]),
            ),
            _ => {}
        }
        for robot in deployment.robots.keys() {
            let key = format!("robots.{robot}");
            let edges = places(&|part| part.kind() == "edge" && part.serves(robot));
            match edges[..] {
                [] => self.add(
                    &key,
                    format!("has no host: expected `edge:{robot}` in the `runs` of one"),
                ),
                [one] => {
                    let role = deployment.hosts.get(one).and_then(|host| host.role);
                    if deployment.robots[robot].driver && role != Some(Role::Robot) {
                        self.add(
                            format!("{key}.driver"),
                            format!("is set, and its edge runs on {one}: expected a host of role robot"),
                        );
                    }
                }
                [first, second, ..] => self.add(
                    format!("hosts.{second}.runs"),
                    format!("has `edge:{robot}`, which {first} runs already"),
                ),
            }
            if deployment.mapping.run.enabled
                && places(&|part| part.kind() == "mapping" && part.serves(robot)).is_empty()
            {
                self.add(&key, "is mapped nowhere: expected `mapping` in the `runs` of a host");
            }
            if deployment.mission.run.enabled
                && places(&|part| part.kind() == "mission" && part.serves(robot)).is_empty()
            {
                self.add(
                    &key,
                    "has no mission anywhere: expected `mission` in the `runs` of a host",
                );
            }
        }
    }

    /// Two parts that listen on one port of one address.
    fn of_ports(&mut self, deployment: &Deployment, parsed: &Parsed<'_>) {
        let mut taken = BTreeMap::new();
        for (name, parts) in parsed {
            let Some(section) = deployment.hosts.get(*name) else {
                continue;
            };
            let host = Host {
                name: (*name).to_owned(),
                role: section.role.unwrap_or(Role::Cloud),
                address: section.address.clone(),
                parts: parts.clone(),
                routers: Vec::new(),
            };
            for part in parts {
                let listens = host.port(deployment, part);
                let page = port_of(&deployment.gateway.settings.listen).filter(|_| *part == Part::Gateway);
                let rest = port_of(&deployment.router.rest).filter(|_| *part == Part::Router);
                let scouting = (*part == Part::Router && deployment.router.scouting).then_some(SCOUTING_PORT);
                for port in [listens, page, rest, scouting, Some(host.metrics_port(part))]
                    .into_iter()
                    .flatten()
                {
                    let who = format!("`{part}` of {name}");
                    if let Some(other) = taken.insert((section.address.to_ascii_lowercase(), port), who.clone()) {
                        self.add(
                            format!("hosts.{name}.address"),
                            format!(
                                "is `{}`, where {other} and {who} would both listen on port {port}",
                                section.address
                            ),
                        );
                        return;
                    }
                }
            }
        }
    }

    /// Hosts whose parts dial no router, and settings of the router that cannot hold for the routers of all hosts.
    fn of_routers(&mut self, deployment: &Deployment, parsed: &Parsed<'_>) {
        let with_router: Vec<&str> = parsed
            .iter()
            .filter(|(_, parts)| parts.contains(&Part::Router))
            .map(|(name, _)| *name)
            .collect();
        for (name, parts) in parsed {
            let dials = parts.iter().find(|part| **part != Part::Router);
            if let (Some(part), Some(router)) = (dials, with_router.first())
                && routers(deployment, name).is_empty()
            {
                self.add(
                    format!("hosts.{name}.runs"),
                    format!(
                        "has `{part}`, and dials no router: that of a robot is dialled only by name; expected `connect = [\"{router}\"]`"
                    ),
                );
            }
        }
        let RouterSection {
            listen, connect, rest, ..
        } = &deployment.router;
        if *listen != RouterSection::default().listen {
            self.add(
                "router.listen",
                format!(
                    "is set: the router of a host listens on port {ROUTER_PORT} of all its addresses; expected none"
                ),
            );
        }
        for endpoint in connect {
            let is_it = |name: &str| deployment.hosts[name].address == host_of(endpoint);
            let mut routers = parsed.iter().filter(|(_, parts)| parts.contains(&Part::Router));
            if port_of(endpoint) == Some(ROUTER_PORT)
                && let Some((name, _)) = routers.find(|(name, _)| is_it(name))
            {
                self.add(
                    "router.connect",
                    format!(
                        "names `{endpoint}`, the router of {name}: expected routers that are not in the file; those that are link to one another"
                    ),
                );
            }
        }
        if !rest.is_empty() && !is_loopback(rest) {
            self.add(
                "router.rest",
                format!("is `{rest}`: expected an address of loopback, for this host's own programs"),
            );
        }
    }

    /// Robots whose own endpoint is on loopback, where nobody could reach it.
    fn of_robots(&mut self, deployment: &Deployment, parsed: &Parsed<'_>) {
        let edges: BTreeSet<&Id> = parsed
            .values()
            .flatten()
            .filter(|part| part.kind() == "edge")
            .filter_map(Part::robot)
            .collect();
        for (name, robot) in &deployment.robots {
            if is_loopback(&robot.listen)
                && port_of(&robot.listen).is_some()
                && edges.iter().any(|edge| edge.as_str() == name)
            {
                self.add(
                    format!("robots.{name}.listen"),
                    format!(
                        "is `{}`: on a host of its own nobody could stop it there; expected another address, or none (port {} and on)",
                        robot.listen,
                        EDGE_PORT
                    ),
                );
            }
        }
    }
}

/// Whether no host has this address.
fn is_nobody_s(address: IpAddr) -> bool {
    address.is_unspecified() || address.is_multicast() || address == IpAddr::from([255; 4])
}

/// Whether there are hosts that are not on loopback, as this one is.
fn has_others(deployment: &Deployment, name: &str) -> bool {
    let mut others = deployment.hosts.iter().filter(|(other, _)| *other != name);
    others.any(|(_, host)| !is_loopback(&host.address))
}
