//! Replication. How does a standby get everything its leader has acknowledged?
//!
//! The standby joins; from then on the leader sends it every write to its store.
//!
//! Primary and backup, with the robot as arbiter of membership: Lin et al., "PacificA: Replication in Log-Based Distributed Storage
//! Systems", Microsoft Research 2008.

use serde::{Deserialize, Serialize};

use super::GoalRequest;
use crate::time::Stamp;

/// A standby's request for the content of the leader's store and for every later write.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct JoinRequest {
    /// Name of the standby's store.
    pub store: String,
    /// Identifies this join; new for every join. The standby accepts entries of this session only.
    pub session: String,
    /// Goals that the standby accepted before the robot had a leader; the leader takes them over.
    #[serde(default)]
    pub goals: Vec<GoalRequest>,
}

/// The leader's answer to a standby that joins.
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
    /// Lease epoch of the leader.
    pub epoch: u64,
    /// Session of the standby's join.
    pub session: String,
    /// Number of the entry in the session, from one. Entry one starts with an empty store; an entry without writes repeats the previous
    /// number.
    pub position: u64,
    /// The leader's time, to which the stored stamps are relative.
    pub now: Stamp,
    /// Writes, applied all or none; an entry without writes only shows that the leader is alive.
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
    /// Number of the newest entry that the standby holds, along with all earlier ones.
    pub position: u64,
}
