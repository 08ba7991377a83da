//! Lease. Who may command a robot, and which mission keeps its goals?

use serde::{Deserialize, Serialize};

use crate::time::Stamp;

/// Role in which the holder commands a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum LeaseRole {
    /// An orchestrator that executes goals.
    Mission,
    /// A person; outranks a mission.
    Operator,
}

/// The lease, as the robot's state shows it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeaseState {
    /// The holder, if there is one.
    pub holder: Option<String>,
    /// The holder's role.
    pub role: Option<LeaseRole>,
    /// The current epoch; every command must carry it.
    pub epoch: u64,
    /// Whether the lease was renewed within its time to live.
    pub live: bool,
    /// The mission that keeps the robot's goals, if any ever did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leader: Option<Leader>,
    /// Whether the leader was heard recently, also while an operator holds the lease.
    #[serde(default)]
    pub leader_live: bool,
}

/// Leadership record: which mission keeps the robot's goals, as recorded by the robot.
///
/// The leader is the mission with a store that last received the lease. An operator's lease or a lapse leaves the record unchanged, unless
/// the leader falls silent meanwhile and a mission that has caught up asks for the lease.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Leader {
    /// Name of the leader's store.
    pub store: String,
    /// Epoch of the leader's grant.
    pub epoch: u64,
    /// Stores that hold everything the leader has acknowledged, including its own. Only these may lead next.
    pub caught_up: Vec<String>,
    /// Number of the leader's latest report on which stores have caught up; an older report that arrives late is ignored.
    #[serde(default)]
    pub revision: u64,
}

/// Requests the lease, releases it, or reports which stores have caught up.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeaseRequest {
    /// Name of the requester.
    pub holder: String,
    /// Role of the requester.
    pub role: LeaseRole,
    /// The action; without it, the lease is requested.
    #[serde(default)]
    pub action: LeaseAction,
    /// Identifies the request: a repeated request gets the first answer.
    pub request_id: String,
    /// Name of the store in which a mission keeps the robot's goals. A mission without a store does not lead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub store: Option<String>,
    /// For [`LeaseAction::CaughtUp`]: the epoch under which the mission leads, and the stores that have caught up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leads: Option<Leader>,
    /// The robot's time as known to the requester: stamp of the newest state received, plus the time since then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub echo: Option<Stamp>,
}

impl LeaseRequest {
    /// A request from a holder that keeps no goals.
    #[must_use]
    pub fn new(holder: impl Into<String>, role: LeaseRole, action: LeaseAction, request_id: impl Into<String>) -> Self {
        Self {
            holder: holder.into(),
            role,
            action,
            request_id: request_id.into(),
            store: None,
            leads: None,
            echo: None,
        }
    }
}

/// What a lease request asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum LeaseAction {
    /// Take the lease.
    #[default]
    Acquire,
    /// Release the lease.
    Release,
    /// A leader's report on which stores hold everything it has acknowledged; no live lease is required.
    CaughtUp,
    /// An operator gives up the goals of the last leader and of the stores that had caught up: any mission may lead next.
    Forget,
}

/// A granted lease.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeaseReply {
    /// The epoch that every command must carry.
    pub epoch: u64,
    /// Time to live without a heartbeat, s.
    pub ttl_secs: f64,
    /// The start of the edge that granted the lease.
    pub boot_id: String,
    /// Round trip to the robot and back, s, from the request's echo; `None` without an echo.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub round_trip_secs: Option<f64>,
}

/// Renews the lease; sent ten times a second by its holder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Heartbeat {
    /// Name of the holder.
    pub holder: String,
    /// Epoch of the holder's grant.
    pub epoch: u64,
    /// Sequence number of the heartbeat: a replayed or reordered heartbeat does not renew the lease.
    pub counter: u64,
    /// The robot's time as known to the holder: stamp of the newest state received, plus the time since then. The robot measures the round
    /// trip from it on its own clock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub echo: Option<Stamp>,
}
