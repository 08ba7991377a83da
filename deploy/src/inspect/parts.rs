//! Parts. Every part of a deployment, from its answer to `info`: edges and missions have their own asks, all other parts share one.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::Serialize;
use zenav_protocol::bus::Bus;
use zenav_protocol::messages::{InfoReply, InfoRequest, ProcessInfo};
use zenav_protocol::topics;

use crate::connect::{self, LinkArgs};
use crate::failure::Failure;

/// Longest wait for answers.
const ANSWER_WITHIN: Duration = Duration::from_millis(1500);
/// Ends the name of the liveliness token of a copy: `mapping-standby`.
const STANDBY: &str = "-standby";
/// Time over which the load is measured.
const LOAD_OVER: Duration = Duration::from_secs(1);

/// Why a member gets no answer at all, and what helps.
pub(super) const NOT_ADMITTED: &str = "it was revoked (`zenav keys list`), or the router's members.txt does not name it yet: copy that file to the router again";

/// A part of a deployment.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct PartStatus {
    /// Name of its session.
    pub(super) part: String,
    /// `edge`, `mapping`, `motion`, `mission`, …
    pub(super) component: String,
    /// Robot or group that it serves; empty: all.
    pub(super) robot: String,
    /// Whether it answered in time; otherwise only its component and its robot are known, by its liveliness token.
    pub(super) answers: bool,
    /// Mission and mapping only: whether it leads.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) leads: Option<bool>,
    /// Mission only: why it can store nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) not_stored: Option<String>,
    pub(super) host: String,
    pub(super) pid: u32,
    #[serde(skip)]
    pub(super) instance: u32,
    pub(super) version: String,
    pub(super) schema: u32,
    pub(super) uptime_secs: f64,
    /// Processor time of its process per second, measured over the last one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) load: Option<f64>,
    pub(super) memory_bytes: u64,
    /// Offset of its host's wall clock ahead of this one, s, and its uncertainty.
    pub(super) clock_ahead_secs: f64,
    pub(super) clock_uncertainty_secs: f64,
}

/// An answer, and the interval of this machine's time (s, UNIX) in which it was given.
#[derive(Clone, Debug)]
struct Told {
    info: InfoReply,
    between: [f64; 2],
}

/// Asks all parts twice: the load is the difference. Robots' components that show and did not answer are listed too.
///
/// # Errors
/// When the bus is closed.
pub(super) async fn parts(bus: &Bus) -> Result<Vec<PartStatus>, Failure> {
    let before = all(bus).await?;
    tokio::time::sleep(LOAD_OVER).await;
    let after = all(bus).await?;
    Ok(joined(&before, after, &connect::robots(bus).await?))
}

async fn all(bus: &Bus) -> Result<Vec<Told>, Failure> {
    let ask = |ask, chunks: &'static [&'static str]| async move {
        let sent = now();
        let answers = bus.ask_all(&ask, chunks, &InfoRequest {}, ANSWER_WITHIN).await?;
        let between = [sent, now()];
        let told = answers.into_iter().filter_map(|answer| answer.result.ok());
        Ok::<_, Failure>(told.map(|info| Told { info, between }).collect::<Vec<_>>())
    };
    let (edges, missions, others) = tokio::join!(
        ask(topics::EDGE_INFO, &["*"]),
        ask(topics::CLOUD_INFO, &["*"]),
        ask(topics::PART_INFO, &["*"])
    );
    Ok([edges?, missions?, others?].concat())
}

fn now() -> f64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default()
        .as_secs_f64()
}

/// One row per part, sorted by host; `before` are the earlier answers, `alive` the components of each robot that show. A part of an older
/// version does not report its process.
fn joined(before: &[Told], mut after: Vec<Told>, alive: &BTreeMap<String, BTreeSet<String>>) -> Vec<PartStatus> {
    let mut silent = Vec::new();
    for (robot, component) in alive
        .iter()
        .flat_map(|(robot, all)| all.iter().map(move |one| (robot, one)))
    {
        let is_its = |told: &&Told| told.info.robot == *robot && is_token_of(component, &told.info);
        if after.iter().any(|told| is_its(&told)) {
            continue;
        }
        let answers = after.len();
        after.extend(before.iter().filter(is_its).cloned());
        if after.len() == answers {
            silent.push(PartStatus {
                component: component.clone(),
                robot: robot.clone(),
                ..PartStatus::default()
            });
        }
    }
    let earlier: BTreeMap<(&str, u32, u32), &ProcessInfo> = before
        .iter()
        .filter_map(|told| told.info.process.as_ref())
        .map(|process| (identity(process), process))
        .collect();
    let mut parts: Vec<PartStatus> = after
        .into_iter()
        .map(|Told { info, between }| {
            let has_copies = matches!(info.component.as_str(), "mission" | "mapping");
            let leads = has_copies.then_some(info.leads);
            let process = info.process.unwrap_or_default();
            let then = earlier.get(&identity(&process));
            let load = then.and_then(|then| {
                let seconds = process.uptime_secs - then.uptime_secs;
                (seconds > 0.0).then(|| ((process.cpu_secs - then.cpu_secs) / seconds).max(0.0))
            });
            let middle = f64::midpoint(between[0], between[1]);
            PartStatus {
                part: process.part,
                component: info.component,
                robot: info.robot,
                answers: true,
                leads,
                not_stored: info.not_stored,
                clock_ahead_secs: process.unix_secs - middle,
                clock_uncertainty_secs: (between[1] - between[0]) / 2.0,
                host: process.host,
                pid: process.pid,
                instance: process.instance,
                version: info.version,
                schema: info.schema,
                uptime_secs: process.uptime_secs,
                load,
                memory_bytes: process.memory_bytes,
            }
        })
        .chain(silent)
        .collect();
    parts.sort_by(|a, b| (&a.host, a.pid, &a.part, &a.robot).cmp(&(&b.host, b.pid, &b.part, &b.robot)));
    parts
}

/// Whether edges answer, and nothing else does: the endpoint is a robot's own, or nothing but robots runs.
pub(super) fn only_robots_answer(parts: &[PartStatus]) -> bool {
    let mut answering = parts.iter().filter(|part| part.answers).peekable();
    answering.peek().is_some() && answering.all(|part| part.component == "edge")
}

/// Checks that a part answers this process's identity, if it has one. What an endpoint denies, it drops without a word: a member that it
/// does not admit finds nothing, as if nothing ran.
///
/// # Errors
/// [`exit_code::TIMEOUT`](crate::exit_code::TIMEOUT).
pub(crate) fn check_admitted(link: &LinkArgs, somebody_answers: bool) -> Result<(), Failure> {
    match &link.identity.identity {
        Some(folder) if !somebody_answers => Err(Failure::timeout(format!(
            "nobody answers the identity {}, not even the router: {NOT_ADMITTED}",
            folder.display()
        ))),
        _ => Ok(()),
    }
}

/// Whether a liveliness token is that of the part that gave this answer.
fn is_token_of(component: &str, info: &InfoReply) -> bool {
    match component.strip_suffix(STANDBY) {
        Some(component) => info.component == component && !info.leads,
        None => info.component == component,
    }
}

/// Unique key of a process.
fn identity(process: &ProcessInfo) -> (&str, u32, u32) {
    (process.host.as_str(), process.pid, process.instance)
}

impl PartStatus {
    /// Whether the offset of its host's clock certainly exceeds `secs`.
    pub(super) fn clock_is_off(&self, secs: f64) -> bool {
        !self.host.is_empty() && self.clock_ahead_secs.abs() > self.clock_uncertainty_secs + secs
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    fn told(part: &str, cpu_secs: f64, uptime_secs: f64, unix_secs: f64, between: [f64; 2]) -> Told {
        let process = ProcessInfo {
            part: part.to_owned(),
            host: "site-1".to_owned(),
            pid: 7,
            instance: 0,
            uptime_secs,
            cpu_secs,
            memory_bytes: 1,
            unix_secs,
        };
        Told {
            info: InfoReply {
                component: "mapping".to_owned(),
                process: Some(process),
                ..InfoReply::default()
            },
            between,
        }
    }

    #[test]
    fn load_is_what_went_by_between_two_answers_and_a_clock_is_known_as_well_as_the_answer_was_quick() {
        let before = [told("mapping-a", 3.0, 100.0, 0.0, [0.0, 0.0])];
        let parts = joined(
            &before,
            vec![told("mapping-a", 3.5, 102.0, 15.0, [9.9, 10.1])],
            &BTreeMap::new(),
        );
        let part = &parts[0];
        assert_eq!((part.load, part.leads), (Some(0.25), Some(false)));
        assert!((part.clock_ahead_secs - 5.0).abs() < 1e-9 && (part.clock_uncertainty_secs - 0.1).abs() < 1e-9);
        assert!(part.clock_is_off(1.0) && !part.clock_is_off(5.0));
    }

    #[test]
    fn a_component_that_shows_is_listed_by_its_earlier_answer_or_as_one_without_an_answer() {
        let before = [told("mapping-a", 3.0, 100.0, 15.0, [14.9, 15.1])];
        let alive = BTreeMap::from([(String::new(), ["mapping", "mission"].map(str::to_owned).into())]);
        let parts = joined(&before, Vec::new(), &alive);
        let seen: Vec<_> = parts
            .iter()
            .map(|part| (part.component.as_str(), part.part.as_str(), part.answers))
            .collect();
        assert_eq!(seen, [("mission", "", false), ("mapping", "mapping-a", true)]);
        assert_eq!(
            joined(&before, before.to_vec(), &alive).len(),
            2,
            "no answer is taken twice"
        );
        assert!(
            joined(&before, Vec::new(), &BTreeMap::new()).is_empty(),
            "it has ended meanwhile"
        );
    }

    #[test]
    fn a_copy_of_mapping_shows_by_its_own_token_and_is_silent_only_if_no_copy_answers() {
        let alive = BTreeMap::from([(String::new(), ["mapping", "mapping-standby"].map(str::to_owned).into())]);
        let copy = told("mapping-a", 3.0, 100.0, 15.0, [14.9, 15.1]);
        let mut leader = copy.clone();
        leader.info.leads = true;
        let silent = |answers: Vec<Told>| {
            let parts = joined(&[], answers, &alive);
            let silent = parts.into_iter().filter(|part| !part.answers);
            silent.map(|part| part.component).collect::<Vec<_>>()
        };
        assert_eq!(silent(vec![leader.clone(), copy]), Vec::<String>::new());
        assert_eq!(silent(vec![leader]), ["mapping-standby"]);
    }

    #[test]
    fn who_finds_nobody_with_an_identity_is_told_that_it_is_not_admitted() {
        let link = |words: &[&str]| crate::cli::parsed::<LinkArgs>(words).unwrap();
        let (open, known) = (link(&[]), link(&["--identity", "issued/viewer.wall"]));
        assert!(check_admitted(&open, false).is_ok() && check_admitted(&known, true).is_ok());
        let failure = check_admitted(&known, false).unwrap_err();
        assert_eq!(failure.code, crate::exit_code::TIMEOUT);
        assert!(
            failure.message.contains("issued/viewer.wall") && failure.message.contains("members.txt"),
            "{failure}"
        );
    }

    #[test]
    fn a_robot_s_own_endpoint_is_known_by_who_answers_there() {
        let part = |component: &str, answers| PartStatus {
            component: component.to_owned(),
            answers,
            ..PartStatus::default()
        };
        let robot = [part("edge", true), part("mission", false)];
        assert!(only_robots_answer(&robot));
        let fleet = [part("edge", true), part("router", true)];
        assert!(!only_robots_answer(&fleet) && !only_robots_answer(&[part("edge", false)]));
    }

    #[test]
    fn a_part_that_has_just_come_has_no_load_yet_and_an_old_one_no_process() {
        let mut old = told("edge-b", 0.0, 0.0, 0.0, [0.0, 0.0]);
        old.info.process = None;
        let parts = joined(
            &[],
            vec![told("mapping-a", 3.5, 102.0, 15.0, [9.9, 10.1]), old],
            &BTreeMap::new(),
        );
        assert!(parts.iter().all(|part| part.load.is_none()));
        assert!(!parts[0].clock_is_off(0.0) && parts[0].host.is_empty());
    }
}
