//! Lease. Who may command a robot, and which mission keeps its goals?

use serde::{Deserialize, Serialize};

use crate::time::Stamp;

/// In which role somebody commands a robot.
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
    /// Whether the leader was heard lately, also while an operator holds the lease.
    #[serde(default)]
    pub leader_live: bool,
}

/// Leadership record: which mission keeps the robot's goals, by the robot's own word.
///
/// The leader is the mission with a store that was granted the lease last. An operator's lease, or a lapsed one, leaves the record as it
/// is, unless the leader falls silent meanwhile and a mission that has caught up asks for the lease.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Leader {
    /// Name of the leader's store.
    pub store: String,
    /// Epoch of the leader's grant.
    pub epoch: u64,
    /// Stores that hold everything the leader has acknowledged, its own among them. Only these may lead next.
    pub caught_up: Vec<String>,
    /// Number of the leader's latest report on who has caught up; an older report that arrives late changes nothing.
    #[serde(default)]
    pub revision: u64,
}

/// Asks for the lease, gives it back, or reports who has caught up.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeaseRequest {
    /// Name of the asker.
    pub holder: String,
    /// Role of the asker.
    pub role: LeaseRole,
    /// What is asked; without it, the lease.
    #[serde(default)]
    pub action: LeaseAction,
    /// Identifies the request: a repeated one gets the first answer.
    pub request_id: String,
    /// Name of the store in which a mission keeps the robot's goals. A mission without a store does not lead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub store: Option<String>,
    /// For [`LeaseAction::CaughtUp`]: the epoch under which the mission leads, and the stores that have caught up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leads: Option<Leader>,
    /// The robot's time as the asker knows it: the stamp of the newest state that came, and the time since then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub echo: Option<Stamp>,
}

impl LeaseRequest {
    /// A request of somebody who keeps no goals.
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
    /// Give the lease back.
    Release,
    /// A leader's report on which stores hold everything it has acknowledged; needs no live lease.
    CaughtUp,
    /// An operator gives up the goals of the last leader and of those that had caught up: any mission may lead next.
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
    /// Round trip to the robot and back, s, by the request's echo; `None` where it had none.
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
    /// Number of this heartbeat: a replayed or reordered one renews nothing.
    pub counter: u64,
    /// The robot's time as the holder knows it: the stamp of the newest state that came, and the time since then. So the robot measures
    /// the round trip on its own clock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub echo: Option<Stamp>,
}
