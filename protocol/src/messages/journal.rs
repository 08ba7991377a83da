//! Replication. How does a standby come to hold everything that its leader has acknowledged?
//!
//! The standby joins; from then on the leader sends it every write to its store.
//!
//! Primary and backup with an arbiter of membership, which is the robot: Lin et al., "PacificA: Replication in Log-Based Distributed
//! Storage Systems", Microsoft Research 2008.

use serde::{Deserialize, Serialize};

use super::GoalRequest;
use crate::time::Stamp;

/// A standby asks for the content of the leader's store, and for every later write.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct JoinRequest {
    /// Name of the standby's store.
    pub store: String,
    /// Identifies this join; new for every join. The standby accepts entries of this session only.
    pub session: String,
    /// Goals that the standby took before any mission of the robot led; they become the leader's.
    #[serde(default)]
    pub goals: Vec<GoalRequest>,
}

/// A leader's answer to a standby that joins.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct JoinReply {
    /// Name of the leader's store.
    pub leader: String,
}

/// Writes to a leader's store, for one standby.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct JournalEntry {
    /// Name of the leader's store.
    pub leader: String,
    /// Epoch under which the leader leads.
    pub epoch: u64,
    /// Session of the standby's join.
    pub session: String,
    /// Number of the entry in the session, from one. Entry one begins with an empty store; an entry without writes repeats the number
    /// before.
    pub position: u64,
    /// The leader's time: stored stamps are relative to it.
    pub now: Stamp,
    /// The writes, to be applied all or not at all; an entry without any only shows that the leader is alive.
    pub writes: Vec<JournalWrite>,
}

/// One record of a store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct JournalWrite {
    /// Kind of record.
    pub table: String,
    /// The record's key.
    pub key: String,
    /// The record's JSON text; `None` removes the record.
    pub value: Option<String>,
}

/// A standby's acknowledgement that an entry is on its disk.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct JournalReply {
    /// Number of the newest entry that the standby holds, together with all before.
    pub position: u64,
}
