//! Mission status. What is the behaviour tree doing, and who is each component?

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
    /// Name of the orchestrator, as it stands in the lease.
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
    /// Stores of the standbys that hold every goal and can take over at once. Empty: the orchestrator has no standby.
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
    /// The node's own words on its status.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub feedback: String,
    /// What the node answered last, as in `status`: stays when its parent resets it. Empty before its first answer.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub last: String,
    /// Of a node that has run: its ports and what is on them, in words.
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
    /// Version of the component's message schema ([`SCHEMA_VERSION`](crate::SCHEMA_VERSION)); a client with another one refuses to start.
    pub schema: u32,
    /// The robot that the component serves.
    pub robot: String,
    /// From an edge: its present start and time.
    pub boot: Option<BasedOn>,
    /// From a mission: name of the store that keeps its goals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub store: Option<String>,
    /// From a mission: whether it keeps the robot's goals, or will unless the robot says otherwise.
    #[serde(default)]
    pub leads: bool,
    /// From an edge: the robot's footprint, limits and sensors.
    #[cfg_attr(feature = "schema", schemars(with = "Option<serde_json::Value>"))]
    pub model: Option<RobotModel>,
    /// From an edge: timing of its control loop.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pacing: Option<Pacing>,
    /// The process that the component runs in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub process: Option<ProcessInfo>,
    /// The settings by which its results can be computed again, by section of the deployment file: `mapping` and `poses` of mapping,
    /// `motion` of a motion worker.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub settings: BTreeMap<String, serde_json::Value>,
}

/// Where a component runs, and what its process takes. What the system does not tell is zero.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProcessInfo {
    /// Name of the component's session, such as `mapping-tiago`.
    pub part: String,
    /// Name of the machine.
    pub host: String,
    /// Id of the process on it.
    pub pid: u32,
    /// Drawn at its start: tells apart what has one id on one machine, as containers have.
    #[serde(default)]
    pub instance: u32,
    /// Time since the start of the process, s.
    pub uptime_secs: f64,
    /// Processor time since the start, s.
    pub cpu_secs: f64,
    /// Resident memory, bytes.
    pub memory_bytes: u64,
    /// The machine's wall clock at the answer, s of UNIX time: for a person who compares logs; nothing is decided by it.
    pub unix_secs: f64,
}

/// Loop timing: how late control ticks began, since the start.
///
/// Lateness counts from the tick's deadline; where the body sets the pace, from one body tick after the tick before.
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
