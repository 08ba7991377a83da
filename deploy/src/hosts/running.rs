//! Running deployment. Which of its parts run, by what they announce on the bus, and what runs that it does not name? Pure.
//!
//! By liveliness: a frozen part is seen until its link ends. Gateways announce nothing.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::layout::{Host, Layout};
use super::part::Part;

/// What is seen on the bus.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Seen {
    /// Hosts whose routers answer.
    pub routers: BTreeSet<String>,
    /// The components of each robot: `edge`, `mapping`, `mission`.
    pub robots: BTreeMap<String, BTreeSet<String>>,
    /// Names of the workers of each service: `motion`, `world`.
    pub workers: BTreeMap<String, BTreeSet<String>>,
    /// Orchestrators of each robot: the one that leads, and its standbys.
    pub orchestrators: BTreeMap<String, usize>,
}

/// Whether something is as it was meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// It runs.
    Runs,
    /// It does not show.
    Missing,
    /// It runs, and the deployment does not name it.
    Unnamed,
    /// It announces nothing.
    NotAnnounced,
}

/// What was found of one part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// The host; `-` for what is on none.
    pub host: String,
    /// The part.
    pub part: String,
    /// Whether it is as it was meant.
    pub state: State,
    /// What was seen, where that tells more.
    pub detail: String,
}

/// Compares a deployment with what is seen of it.
#[must_use]
pub fn compare(layout: &Layout<'_>, seen: &Seen) -> Vec<Finding> {
    let mut findings: Vec<Finding> = layout
        .parts()
        .map(|(host, part)| judge(layout, host, part, seen))
        .collect();
    let unnamed = |part: String| Finding {
        host: "-".to_owned(),
        part,
        state: State::Unnamed,
        detail: String::new(),
    };
    for robot in seen.robots.keys() {
        if !layout.deployment.robots.contains_key(robot) {
            findings.push(unnamed(format!("edge:{robot}")));
        }
    }
    for worker in seen.workers.get("motion").into_iter().flatten() {
        if host_of_worker(layout, worker).is_none() {
            findings.push(unnamed(format!("motion worker {worker}")));
        }
    }
    findings
}

fn judge(layout: &Layout<'_>, host: &Host, part: &Part, seen: &Seen) -> Finding {
    let robots: Vec<&str> = layout
        .deployment
        .robots
        .keys()
        .map(String::as_str)
        .filter(|robot| part.serves(robot))
        .collect();
    let shows = |component: &str, robot: &str| {
        seen.robots
            .get(robot)
            .is_some_and(|components| components.contains(component))
    };
    let without = |component: &str| -> Vec<&str> {
        robots
            .iter()
            .copied()
            .filter(|robot| !shows(component, robot))
            .collect()
    };
    let of_robots = |missing: Vec<&str>| match missing.is_empty() {
        true => (State::Runs, String::new()),
        false => (State::Missing, format!("not of {}", missing.join(", "))),
    };
    let (state, detail) = match part {
        Part::Router if seen.routers.contains(&host.name) => (State::Runs, String::new()),
        Part::Router => (State::Missing, format!("no answer at {}", host.address)),
        Part::World => match seen.workers.get("world").is_some_and(|worlds| !worlds.is_empty()) {
            true => (State::Runs, String::new()),
            false => (State::Missing, String::new()),
        },
        Part::Edge(_) => of_robots(without("edge")),
        Part::Mapping(_) => of_robots(without("mapping")),
        Part::Mission(_) => {
            let orchestrators = |robot: &str| {
                let missions = layout
                    .parts()
                    .filter(|(_, part)| part.kind() == "mission" && part.serves(robot));
                (
                    seen.orchestrators.get(robot).copied().unwrap_or_default(),
                    missions.count(),
                )
            };
            // Which one a standby is cannot be seen: of two both may be the missing one.
            let short: Vec<String> = robots
                .iter()
                .map(|robot| (robot, orchestrators(robot)))
                .filter(|(_, (there, meant))| there < meant)
                .map(|(robot, (there, meant))| format!("{robot} has {there} of {meant} orchestrators"))
                .collect();
            match short.is_empty() {
                true => (State::Runs, String::new()),
                false => (State::Missing, short.join(", ")),
            }
        }
        Part::Motion => {
            let workers = seen.workers.get("motion").into_iter().flatten();
            let own = workers
                .filter(|worker| host_of_worker(layout, worker) == Some(&host.name))
                .count();
            match own {
                0 => (State::Missing, String::new()),
                1 => (State::Runs, "1 worker".to_owned()),
                several => (State::Runs, format!("{several} workers")),
            }
        }
        Part::Gateway => (State::NotAnnounced, String::new()),
    };
    Finding {
        host: host.name.clone(),
        part: part.to_string(),
        state,
        detail,
    }
}

/// The host whose name a worker's begins with, the longest of several.
fn host_of_worker<'l>(layout: &'l Layout<'_>, worker: &str) -> Option<&'l String> {
    let hosts = layout
        .hosts
        .iter()
        .filter(|host| host.runs("motion"))
        .map(|host| &host.name);
    hosts
        .filter(|host| {
            worker
                .strip_prefix(host.as_str())
                .is_some_and(|rest| rest.starts_with('-'))
        })
        .max_by_key(|host| host.len())
}
