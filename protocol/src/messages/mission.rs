//! Mission status. What is the behaviour tree doing, and what is each component's identity?

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{BasedOn, GoalFeedback};
use crate::robot::RobotModel;
use crate::time::Stamp;

/// Status of a robot's mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MissionStatus {
    /// Time of the status, on the mission's clock.
    pub stamp: Stamp,
    /// Name of the orchestrator, as used in the lease.
    pub holder: String,
    /// Whether the orchestrator holds the robot's lease.
    pub leads: bool,
    /// Epoch of the orchestrator's lease; zero without one.
    pub epoch: u64,
    /// The goal being executed.
    pub goal_id: Option<String>,
    /// Name of the behaviour tree being executed.
    pub tree: Option<String>,
    /// The tree's nodes, in document order.
    #[serde(default)]
    pub nodes: Vec<NodeStatus>,
    /// Progress on the goal.
    #[serde(default)]
    pub feedback: GoalFeedback,
    /// Number of goals in the queue.
    #[serde(default)]
    pub queued: u64,
    /// Stores of the standbys that hold every goal and can take over at once. Empty without a standby.
    #[serde(default)]
    pub standbys: Vec<String>,
}

/// One node of a behaviour tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct NodeStatus {
    /// The node's number in document order.
    pub uid: u32,
    /// Number of the node's parent; `None` for the root.
    pub parent: Option<u32>,
    /// The node's instance name.
    pub name: String,
    /// The node's registration id, such as `Sequence`.
    pub id: String,
    /// `IDLE`, `RUNNING`, `SUCCESS`, `FAILURE` or `SKIPPED`.
    pub status: String,
    /// The node's own description of its status.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub feedback: String,
    /// The node's last result, as in `status`; kept when its parent resets it. Empty before its first result.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub last: String,
    /// Ports of a node that has run, and their values as text.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub ports: BTreeMap<String, String>,
}

/// Asks a component for its name, version and robot.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct InfoRequest {}

/// A component's name, version and robot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct InfoReply {
    /// Kind of component: `edge`, `mapping`, `mission`, `motion`, `gateway`, `router`, `sim`.
    pub component: String,
    /// Version of the component's program.
    pub version: String,
    /// Version of the component's message schema ([`SCHEMA_VERSION`](crate::SCHEMA_VERSION)). A component refuses the requests of programs
    /// that tell another one, except a stop and the request for this.
    pub schema: u32,
    /// The robot that the component serves.
    pub robot: String,
    /// From an edge: its current boot and time.
    pub boot: Option<BasedOn>,
    /// From a mission: name of the store that keeps its goals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub store: Option<String>,
    /// From a mission: whether it keeps the robot's goals, or will do so unless the robot names another leader. From a mapping service:
    /// whether it writes the robot's map.
    #[serde(default)]
    pub leads: bool,
    /// From a mission: why it can store nothing (its disk is full or read-only). It then acknowledges nothing and does not lead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_stored: Option<String>,
    /// From an edge: the robot's footprint, limits and sensors.
    pub model: Option<RobotModel>,
    /// From an edge: timing of its control loop.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pacing: Option<Pacing>,
    /// The process that the component runs in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub process: Option<ProcessInfo>,
    /// Settings needed to reproduce its results, by section of the deployment file: `mapping` and `poses` from mapping, `motion` from a
    /// motion worker.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub settings: BTreeMap<String, serde_json::Value>,
}

/// Where a component runs, and the resources of its process. Values that the system does not provide are zero.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProcessInfo {
    /// Name of the component's session, such as `mapping-tiago`.
    pub part: String,
    /// Name of the machine.
    pub host: String,
    /// Process id on that machine.
    pub pid: u32,
    /// Random number drawn at start: distinguishes processes with the same id on one machine name, as in containers.
    #[serde(default)]
    pub instance: u32,
    /// Time since the process started, s.
    pub uptime_secs: f64,
    /// Processor time used since the start, s.
    pub cpu_secs: f64,
    /// Resident memory, bytes.
    pub memory_bytes: u64,
    /// The machine's wall clock at the answer, s of UNIX time: only for comparing logs; no decision depends on it.
    pub unix_secs: f64,
}

/// Loop timing: how late control ticks began, since the start.
///
/// Lateness is measured from the tick's deadline; if the body sets the pace, from one body tick after the previous tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Pacing {
    /// Number of ticks.
    pub ticks: u64,
    /// Median lateness, ms.
    pub late_p50_ms: f64,
    /// 99th percentile of the lateness, ms.
    pub late_p99_ms: f64,
    /// Largest lateness, ms.
    pub late_max_ms: f64,
}
