//! What is the mission doing? Every node's status, and who leads.

use serde::{Deserialize, Serialize};

use super::{BasedOn, GoalFeedback};
use crate::robot::RobotModel;
use crate::time::Stamp;

/// Renews the lease.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Heartbeat {
    /// Who.
    pub holder: String,
    /// Under which grant.
    pub epoch: u64,
    /// Counts the holder's heartbeats: a replayed or re-ordered one renews nothing.
    pub counter: u64,
}

/// What a mission does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MissionStatus {
    /// When.
    pub stamp: Stamp,
    /// Name of the orchestrator.
    pub holder: String,
    /// Whether it holds the robot's lease.
    pub leads: bool,
    /// The lease's epoch, zero without one.
    pub epoch: u64,
    /// The goal that runs.
    #[serde(default)]
    pub goal_id: Option<String>,
    /// Name of the tree that runs.
    #[serde(default)]
    pub tree: Option<String>,
    /// Its nodes, in document order.
    #[serde(default)]
    pub nodes: Vec<NodeStatus>,
    /// How the goal goes.
    #[serde(default)]
    pub feedback: GoalFeedback,
    /// Goals that wait.
    #[serde(default)]
    pub queued: u64,
    /// Stores of other orchestrators that hold all goals and can take over at once; without one, it works alone.
    #[serde(default)]
    pub standbys: Vec<String>,
}

/// One node of a behaviour tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NodeStatus {
    /// Number in document order.
    pub uid: u32,
    /// Number of its parent; `None` for the root.
    #[serde(default)]
    pub parent: Option<u32>,
    /// Instance name.
    pub name: String,
    /// Registration id, such as `Sequence`.
    pub id: String,
    /// `IDLE`, `RUNNING`, `SUCCESS`, `FAILURE` or `SKIPPED`.
    pub status: String,
    /// What it says of itself.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub feedback: String,
}

/// Asks a component who it is.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct InfoRequest {}

/// Who a component is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InfoReply {
    /// `edge`, `mapping`, `mission`, `planning`.
    pub component: String,
    /// Version of the program.
    pub version: String,
    /// Version of the messages; a mismatch refuses to start.
    pub schema: u32,
    /// The robot it serves.
    pub robot: String,
    /// Its present boot and time, for an edge.
    #[serde(default)]
    pub boot: Option<BasedOn>,
    /// Name of the store, from a mission that keeps goals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub store: Option<String>,
    /// Whether it keeps the robot's goals, or will unless the robot says otherwise.
    #[serde(default)]
    pub leads: bool,
    /// The robot's footprint, limits and sensors, from an edge.
    #[serde(default)]
    pub model: Option<RobotModel>,
    /// How punctual its control loop is, from an edge.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pacing: Option<Pacing>,
}

/// How late control ticks began, since start: after their deadline, or longer after the tick before than the body's pace, where that
/// gives it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pacing {
    /// Ticks counted.
    pub ticks: u64,
    /// Median, ms.
    pub late_p50_ms: f64,
    /// What one tick in a hundred exceeds, ms.
    pub late_p99_ms: f64,
    /// The worst, ms.
    pub late_max_ms: f64,
}
