//! Zenoh's settings. For programs on a host that are no part of zenav: the driver of a robot, a program that carries out a tree's actions, Zenoh's
//! own tools.

use std::collections::BTreeSet;
use std::path::Path;

use zenav_protocol::bus::client_settings;

use super::command_line::{Addresses, IDENTITY, endpoint};
use super::layout::{Host, Layout};
use super::part::Part;
use crate::config::{Profile, Role};

/// Settings for each member of the fleet in whose name a program may run on a host, by the member: a client of the routers that the host's
/// parts dial. A robot's member, such as its driver, is a client of the robot's own edge instead: readings and wheel speeds do not pass through
/// the cloud. Nobody but a router has a router's rights.
pub(super) fn of_host(layout: &Layout<'_>, host: &Host) -> Vec<(String, String)> {
    let of_parts = host.parts.iter().map(|part| layout.identity(host, part));
    let operator = (host.role == Role::Operator).then(|| format!("operator.{}", host.name));
    let members: BTreeSet<String> = of_parts
        .filter(|member| !member.starts_with("router."))
        .chain(operator)
        .collect();
    let routers = host.routers.iter().filter_map(|name| layout.host(name));
    let routers: Vec<String> = routers
        .map(|router| endpoint(layout, router, &Part::Router, Addresses::Hosts))
        .collect();
    let dialled = |member: &str| {
        let is_own = |part: &&Part| matches!(part, Part::Edge(_)) && layout.identity(host, part) == member;
        match host.parts.iter().find(is_own) {
            Some(edge) => vec![endpoint(layout, host, edge, Addresses::Hosts)],
            None => routers.clone(),
        }
    };
    let text = |member: &str| {
        let folder = Path::new(IDENTITY).join(member);
        let identity = (layout.profile == Profile::Mtls).then_some(folder.as_path());
        let mut settings = client_settings(&dialled(member), member, identity);
        let namespace = &layout.deployment.bus.namespace;
        if !namespace.is_empty() {
            settings["namespace"] = namespace.as_str().into();
        }
        format!("// Written by `zenav deploy render`: change the deployment file, and render again.\n{settings:#}\n")
    };
    members
        .into_iter()
        .map(|member| {
            let text = text(&member);
            (member, text)
        })
        .collect()
}
