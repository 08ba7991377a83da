//! Simulation. What would a tree do if its leaves answered in a given way? The tree is ticked against a script, in simulated time, without
//! a robot.
//!
//! The script defines how each leaf answers, by registration id or by `name`: which of its starts fail, how long a start takes, what a
//! failure writes. Actions not named in it succeed at once; conditions that depend only on the blackboard or the simulated time are
//! evaluated; all other conditions fail.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use super::leaf::{Leaf, LeafIo};
use super::registry::{Category, Registry};
use super::status::Status;
use super::tree::Tree;
use super::value::Value;
use super::xml::{Include, TreeErrors, build};

/// How the leaves of a tree answer.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Script {
    /// Simulated time between two ticks, ms; at least 1.
    #[serde(deserialize_with = "tick_period")]
    pub tick_period_ms: u64,
    /// Simulated time after which a running tree is stopped, ms.
    pub timeout_ms: u64,
    /// Leaves by registration id or by `name`; the name takes precedence.
    pub leaves: BTreeMap<String, LeafScript>,
    /// Entries of the root blackboard before the first tick.
    pub blackboard: BTreeMap<String, serde_json::Value>,
    /// Writes to the blackboard triggered by a leaf's start.
    pub events: Vec<Event>,
}

impl Default for Script {
    fn default() -> Self {
        Script {
            tick_period_ms: 10,
            timeout_ms: 60_000,
            leaves: BTreeMap::new(),
            blackboard: BTreeMap::new(),
            events: Vec::new(),
        }
    }
}

/// A tick period; 0 would stop the time.
fn tick_period<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
    match u64::deserialize(deserializer)? {
        0 => Err(D::Error::custom("`tick_period_ms` is 0: expected at least 1")),
        period => Ok(period),
    }
}

/// How one leaf answers.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LeafScript {
    /// Starts that end in `Failure`: inclusive ranges, counted from 1.
    pub fail: Vec<(u64, u64)>,
    /// How long a start stays `Running`, ms.
    pub run_ms: u64,
    /// Output ports to write on failure.
    pub set: BTreeMap<String, serde_json::Value>,
    /// Result of the other starts, `Success` by default; `RUNNING` never ends.
    pub status: Option<Status>,
}

/// A write to the blackboard that happens once.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Event {
    /// Its trigger.
    pub when: When,
    /// Entries of the root blackboard to set.
    pub set: BTreeMap<String, serde_json::Value>,
}

/// The nth start of a leaf.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct When {
    /// The leaf, by registration id or by `name`.
    pub leaf: String,
    /// Number of the start, from 1.
    pub starts: u64,
}

/// Result of a simulation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// The root's last answer; `RUNNING` after a time-out, `FAILURE` after an error.
    pub status: Status,
    /// How often the tree was ticked.
    pub ticks: u64,
    /// Simulated time from the first tick to the last, ms.
    pub sim_time_ms: u64,
    /// How often each leaf was started (entered from a status other than `Running`), by registration id; leaves that the script calls by
    /// `name` also by name.
    pub counts: BTreeMap<String, u64>,
    /// Whether the simulated time ran out.
    pub timed_out: bool,
    /// The node error that ended the tree, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// Parts of the script that had no effect.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

/// The context of the scripted leaves.
#[derive(Debug, Default)]
pub struct Simulation {
    script: Script,
    by_id: BTreeMap<String, u64>,
    by_name: BTreeMap<String, u64>,
    happened: Vec<bool>,
    warnings: Vec<String>,
}

/// Nodes whose leaves follow a script: the built-in ones, Nav2's (feature `nav2`), and any leaf named in a tree.
pub fn registry() -> Registry<Simulation> {
    let mut registry = unscripted::registry();
    registry.invent_unknown_leaves(|site| {
        Box::new(Scripted {
            condition: site.spec.category == Category::Condition,
            inner: unscripted::condition(site.id),
            ports: site.spec.ports.iter().map(|port| port.name.clone()).collect(),
        })
    });
    registry
}

/// Behaviour of nodes not named in the script.
#[cfg(feature = "nav2")]
mod unscripted {
    pub(super) use crate::nav2::{scripted_condition as condition, scripted_registry as registry, succeed};
}

/// Behaviour of nodes not named in the script.
#[cfg(not(feature = "nav2"))]
mod unscripted {
    use super::{Leaf, LeafIo, Registry, Simulation, Status};

    pub(super) fn registry() -> Registry<Simulation> {
        Registry::new()
    }

    pub(super) fn condition(_: &str) -> Option<Box<dyn Leaf<Simulation>>> {
        None
    }

    pub(super) fn succeed(_: &mut LeafIo<'_>) -> Status {
        Status::Success
    }
}

/// Builds the tree of a file and simulates it with a script.
///
/// # Errors
/// All errors in the tree file.
///
/// ```
/// use zenav_behaviour_tree::Status;
/// use zenav_behaviour_tree::simulate::{Script, simulate};
///
/// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main">
///     <RetryUntilSuccessful num_attempts="3"><Grab/></RetryUntilSuccessful>
/// </BehaviorTree></root>"#;
/// // Every grab takes 200 ms; the first one fails.
/// let script: Script = serde_json::from_str(r#"{"leaves": {"Grab": {"run_ms": 200, "fail": [[1, 1]]}}}"#)?;
/// let outcome = simulate("grab.xml", text.as_bytes(), None, &script, &mut |_, _| Err("no includes".into()))?;
/// assert_eq!((outcome.status, outcome.counts["Grab"], outcome.sim_time_ms), (Status::Success, 2, 400));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn simulate(
    file: &str,
    bytes: &[u8],
    tree_id: Option<&str>,
    script: &Script,
    include: &mut Include<'_>,
) -> Result<Outcome, TreeErrors> {
    let mut tree = build(file, bytes, &registry(), tree_id, include)?;
    Ok(play(&mut tree, script))
}

/// Simulates a tree built over [`registry`] with a script.
pub fn play(tree: &mut Tree<Simulation>, script: &Script) -> Outcome {
    let mut simulation = Simulation::new(script.clone());
    for (key, value) in &script.blackboard {
        let written = Value::from_json(value).map(|value| tree.blackboard_mut().set(key, value));
        if let Some(Err(wrong)) = written {
            simulation.warnings.push(format!("blackboard `{key}`: {wrong}"));
        }
    }
    let (status, ticks, now, error) = run(tree, script, &mut simulation);
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    for node in tree.iter() {
        if !matches!(node.category.as_str(), "Action" | "Condition") {
            continue;
        }
        if node.name != node.id && script.leaves.contains_key(&node.name) {
            *counts.entry(node.name).or_default() += u64::from(node.starts);
        }
        *counts.entry(node.id).or_default() += u64::from(node.starts);
    }
    let mut warnings = simulation.warnings;
    for key in script
        .leaves
        .keys()
        .chain(script.events.iter().map(|event| &event.when.leaf))
    {
        let known = tree.iter().any(|node| node.name == *key || node.id == *key);
        if !known {
            warnings.push(format!("no leaf of the tree is called `{key}`"));
        }
    }
    warnings.dedup();
    let timed_out = status == Status::Running;
    Outcome {
        status,
        ticks,
        sim_time_ms: now,
        counts,
        timed_out,
        error,
        warnings,
    }
}

fn run(
    tree: &mut Tree<Simulation>,
    script: &Script,
    simulation: &mut Simulation,
) -> (Status, u64, u64, Option<String>) {
    let period = script.tick_period_ms.max(1);
    let (mut now, mut ticks) = (0_u64, 0);
    loop {
        ticks += 1;
        match tree.tick(Duration::from_millis(now), simulation) {
            Err(error) => return (Status::Failure, ticks, now, Some(error.to_string())),
            Ok(Status::Running) if now.saturating_add(period) <= script.timeout_ms => now += period,
            Ok(status) => {
                // A script that fails while halting no longer changes the outcome.
                let halted = tree.halt(Duration::from_millis(now), simulation);
                return (status, ticks, now, halted.err().map(|error| error.to_string()));
            }
        }
    }
}

/// A leaf that answers according to the script.
struct Scripted {
    condition: bool,
    inner: Option<Box<dyn Leaf<Simulation>>>,
    /// The ports in its specification.
    ports: Vec<String>,
}

/// A start in progress: its time, ns, and its number.
type Begun = (u64, u64);

impl Leaf<Simulation> for Scripted {
    fn start(&mut self, io: &mut LeafIo<'_>, simulation: &mut Simulation) -> Status {
        let count = |counts: &mut BTreeMap<String, u64>, key: &str| {
            let starts = counts.entry(key.to_owned()).or_default();
            *starts += 1;
            *starts
        };
        let by_id = count(&mut simulation.by_id, io.id());
        let by_name = match io.name() == io.id() {
            true => by_id,
            false => count(&mut simulation.by_name, io.name()),
        };
        simulation.trigger(io, by_id, by_name);
        let start = if simulation.script.leaves.contains_key(io.name()) {
            by_name
        } else {
            by_id
        };
        if simulation.of(io).is_none() {
            return match &mut self.inner {
                Some(inner) => inner.start(io, simulation),
                None if self.condition => Status::Failure,
                None => unscripted::succeed(io),
            };
        }
        let now = super::node::nanos(io.now());
        simulation.check_ports(io, &self.ports);
        if let Err(wrong) = io.remember::<Begun>(&(now, start)) {
            return io.abort(wrong.to_string());
        }
        self.tick(io, simulation)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, simulation: &mut Simulation) -> Status {
        let (Some(script), Some((begun, start))) = (simulation.of(io), io.recall::<Begun>()) else {
            return io.abort("a leaf that the script does not name cannot be running");
        };
        let fails = script
            .fail
            .iter()
            .any(|(first, last)| (*first..=*last).contains(&start));
        let status = if fails {
            Status::Failure
        } else {
            script.status.unwrap_or(Status::Success)
        };
        let waited = super::node::nanos(io.now()).saturating_sub(begun) / 1_000_000;
        if waited < script.run_ms {
            return Status::Running;
        }
        match status {
            Status::Success => unscripted::succeed(io),
            Status::Failure => {
                let set = script.set.clone();
                for (port, value) in set {
                    let Some(value) = Value::from_json(&value) else {
                        continue;
                    };
                    if let Err(wrong) = io.set(&port, value) {
                        simulation.warn(format!("`{}`: {wrong}", io.name()));
                    }
                }
                Status::Failure
            }
            other => other,
        }
    }
}

impl Simulation {
    /// The context for leaves that follow this script; none has been started.
    pub fn new(script: Script) -> Simulation {
        Simulation {
            happened: vec![false; script.events.len()],
            script,
            ..Simulation::default()
        }
    }

    /// The script of a leaf.
    fn of(&self, io: &LeafIo<'_>) -> Option<&LeafScript> {
        self.script
            .leaves
            .get(io.name())
            .or_else(|| self.script.leaves.get(io.id()))
    }

    fn warn(&mut self, warning: String) {
        if !self.warnings.contains(&warning) {
            self.warnings.push(warning);
        }
    }

    /// Warns if the script sets ports that the leaf does not have.
    fn check_ports(&mut self, io: &LeafIo<'_>, ports: &[String]) {
        let named: Option<Vec<String>> = self.of(io).map(|script| script.set.keys().cloned().collect());
        for port in named.unwrap_or_default() {
            if !ports.contains(&port) && !io.ports().any(|known| known == port) {
                self.warn(format!("`{}` has no port `{port}`: nothing is set", io.name()));
            }
        }
    }

    /// Applies the writes of the events triggered by this start.
    fn trigger(&mut self, io: &mut LeafIo<'_>, by_id: u64, by_name: u64) {
        for (event, happened) in self.script.events.iter().zip(&mut self.happened) {
            let now = (event.when.leaf == io.name() && event.when.starts == by_name)
                || (event.when.leaf == io.id() && event.when.starts == by_id);
            if !now || *happened {
                continue;
            }
            *happened = true;
            for (key, value) in &event.set {
                let Some(value) = Value::from_json(value) else { continue };
                if let Err(wrong) = io.set_entry(&format!("@{key}"), value) {
                    self.warnings.push(format!("event sets `{key}`: {wrong}"));
                }
            }
        }
    }
}
