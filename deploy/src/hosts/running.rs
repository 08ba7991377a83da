//! Running deployment. Compares a deployment with the parts announced on the bus, including those that it does not name. Pure.
//!
//! Parts are seen by liveliness: a frozen part is seen until its link ends. Gateways have no token, and the copies of a mission or of a mapping
//! service share one: they are seen by their answer to `info`.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::layout::{Host, Layout};
use super::part::Part;

/// Observations on the bus.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Seen {
    /// Hosts whose routers answer, with the number of routers that show there, itself included; 0: not known.
    pub routers: BTreeMap<String, usize>,
    /// The components of each robot: `edge`, `mapping`, `mission`.
    pub robots: BTreeMap<String, BTreeSet<String>>,
    /// Names of the workers of each service: `motion`, `world`.
    pub workers: BTreeMap<String, BTreeSet<String>>,
    /// Number of orchestrators of each robot that answer and have room for goals.
    pub orchestrators: BTreeMap<String, usize>,
    /// Number of mapping services of each robot that answer: the leader and its copies.
    pub mappers: BTreeMap<String, usize>,
    /// Number of gateways that answer.
    pub gateways: usize,
}

/// State of a part compared with the deployment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// It runs.
    Runs,
    /// It was not found.
    Missing,
    /// It runs, but not all routers that answer show there: the link between them is broken.
    CutOff,
    /// It runs, but the deployment does not name it.
    Unnamed,
}

/// Result for one part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Name of the host; `-` if on none.
    pub host: String,
    /// Name of the part.
    pub part: String,
    /// Its state.
    pub state: State,
    /// Observation, if it adds something.
    pub detail: String,
}

/// Compares a deployment with the observations.
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
    let missing_if = |is_missing: bool, detail: String| match is_missing {
        true => (State::Missing, detail),
        false => (State::Runs, String::new()),
    };
    // The host of a copy is unknown: if one of two is missing, it may be either.
    let of_copies = |kind: &str, counts: &BTreeMap<String, usize>, name: &str| {
        let copies = |robot: &str| {
            let meant = layout
                .parts()
                .filter(|(_, part)| part.kind() == kind && part.serves(robot));
            (counts.get(robot).copied().unwrap_or_default(), meant.count())
        };
        let short: Vec<String> = robots
            .iter()
            .map(|robot| (robot, copies(robot)))
            .filter(|(_, (there, meant))| there < meant)
            .map(|(robot, (there, meant))| format!("{robot} has {there} of {meant} {name}"))
            .collect();
        missing_if(!short.is_empty(), short.join(", "))
    };
    let (state, detail) = match part {
        Part::Router => match (seen.routers.get(&host.name), seen.routers.len()) {
            (None, _) => (State::Missing, format!("no answer at {}", host.address)),
            (Some(&sees), all) if (1..all).contains(&sees) => (
                State::CutOff,
                format!("sees {sees} of {all} routers: if the network between them is well, restart it"),
            ),
            _ => (State::Runs, String::new()),
        },
        Part::World => {
            let worlds = seen.workers.get("world");
            missing_if(worlds.is_none_or(BTreeSet::is_empty), String::new())
        }
        Part::Edge(robot) => {
            let components = seen.robots.get(robot.as_str());
            let shows = components.is_some_and(|components| components.contains("edge"));
            missing_if(!shows, format!("not of {robot}"))
        }
        Part::Mapping(_) => of_copies("mapping", &seen.mappers, "mapping services"),
        Part::Mission(_) => of_copies("mission", &seen.orchestrators, "orchestrators"),
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
        Part::Gateway => {
            // Whose gateway answers is unknown: if one of two is missing, it may be either.
            let meant = layout.parts().filter(|(_, part)| **part == Part::Gateway).count();
            let there = seen.gateways;
            missing_if(there < meant, format!("{there} of {meant} gateways answer"))
        }
    };
    Finding {
        host: host.name.clone(),
        part: part.to_string(),
        state,
        detail,
    }
}

/// The host whose name is a prefix of a worker's; of several the longest.
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
