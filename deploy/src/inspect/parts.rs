//! Parts. Every part of a deployment, from its answer to `info`: edges and missions have their own asks, all other parts share one.

use std::collections::BTreeMap;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::Serialize;
use zenav_protocol::bus::Bus;
use zenav_protocol::messages::{InfoReply, InfoRequest, ProcessInfo};
use zenav_protocol::topics;

use crate::failure::Failure;

/// Longest wait for answers; parts that have not answered by then are not listed.
const ANSWER_WITHIN: Duration = Duration::from_millis(1500);
/// Time over which the load is measured.
const LOAD_OVER: Duration = Duration::from_secs(1);

/// A part of a deployment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Part {
    /// Name of its session.
    pub(super) part: String,
    /// `edge`, `mapping`, `motion`, `mission`, …
    pub(super) component: String,
    /// Robot or group that it serves; empty: all.
    pub(super) robot: String,
    /// Mission only: whether it is the leader.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) leads: Option<bool>,
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

/// Asks all parts twice: the load is the difference.
///
/// # Errors
/// When the bus is closed.
pub(super) async fn parts(bus: &Bus) -> Result<Vec<Part>, Failure> {
    let before = all(bus).await?;
    tokio::time::sleep(LOAD_OVER).await;
    let after = all(bus).await?;
    Ok(joined(&before, after))
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

/// One row per part, sorted by host; `before` are the earlier answers. A part of an older version does not report its process.
fn joined(before: &[Told], after: Vec<Told>) -> Vec<Part> {
    let earlier: BTreeMap<(&str, u32, u32), &ProcessInfo> = before
        .iter()
        .filter_map(|told| told.info.process.as_ref())
        .map(|process| (identity(process), process))
        .collect();
    let mut parts: Vec<Part> = after
        .into_iter()
        .map(|Told { info, between }| {
            let leads = (info.component == "mission").then_some(info.leads);
            let process = info.process.unwrap_or_default();
            let then = earlier.get(&identity(&process));
            let load = then.and_then(|then| {
                let seconds = process.uptime_secs - then.uptime_secs;
                (seconds > 0.0).then(|| ((process.cpu_secs - then.cpu_secs) / seconds).max(0.0))
            });
            let middle = f64::midpoint(between[0], between[1]);
            Part {
                part: process.part,
                component: info.component,
                robot: info.robot,
                leads,
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
        .collect();
    parts.sort_by(|a, b| (&a.host, a.pid, &a.part, &a.robot).cmp(&(&b.host, b.pid, &b.part, &b.robot)));
    parts
}

/// Unique key of a process.
fn identity(process: &ProcessInfo) -> (&str, u32, u32) {
    (process.host.as_str(), process.pid, process.instance)
}

impl Part {
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
        let parts = joined(&before, vec![told("mapping-a", 3.5, 102.0, 15.0, [9.9, 10.1])]);
        let part = &parts[0];
        assert_eq!((part.load, part.leads), (Some(0.25), None));
        assert!((part.clock_ahead_secs - 5.0).abs() < 1e-9 && (part.clock_uncertainty_secs - 0.1).abs() < 1e-9);
        assert!(part.clock_is_off(1.0) && !part.clock_is_off(5.0));
    }

    #[test]
    fn a_part_that_has_just_come_has_no_load_yet_and_an_old_one_no_process() {
        let mut old = told("edge-b", 0.0, 0.0, 0.0, [0.0, 0.0]);
        old.info.process = None;
        let parts = joined(&[], vec![told("mapping-a", 3.5, 102.0, 15.0, [9.9, 10.1]), old]);
        assert!(parts.iter().all(|part| part.load.is_none()));
        assert!(!parts[0].clock_is_off(0.0) && parts[0].host.is_empty());
    }
}
