//! How does a standby come to hold what its leader has acknowledged? It joins; then every write of the leader's store is handed to it.
//!
//! Primary and backup with an arbiter of membership, which is the robot: Lin et al., "PacificA: Replication in Log-Based Distributed
//! Storage Systems", Microsoft Research 2008.

use serde::{Deserialize, Serialize};

use super::GoalRequest;

/// A standby's wish to be handed what the leader writes, and the sign that it still is there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JoinRequest {
    /// Name of its store.
    pub store: String,
    /// Whether it was handed everything so far; else the leader begins with all that it has.
    #[serde(default)]
    pub follows: bool,
    /// Goals that it took before any mission of the robot led; they become the leader's.
    #[serde(default)]
    pub goals: Vec<GoalRequest>,
}

/// What a leader answers to who joins.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JoinReply {
    /// Name of the leader's store.
    pub leader: String,
}

/// One batch of writes of a leader's store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JournalEntry {
    /// Name of the leader's store.
    pub leader: String,
    /// Epoch of its grant: an entry of an older one than was seen is refused.
    pub epoch: u64,
    /// Number of the batch since this leader began.
    pub position: u64,
    /// Whether this is all there is, instead of what comes after the entry before.
    #[serde(default)]
    pub whole: bool,
    /// What is written, all or nothing; none keeps the standby from believing that it was forgotten.
    pub writes: Vec<JournalWrite>,
}

/// One record of a store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JournalWrite {
    /// Which kind of record.
    pub table: String,
    /// Its name.
    pub key: String,
    /// Its text; none removes it.
    #[serde(default)]
    pub value: Option<String>,
}

/// The standby's word that a batch is on its disk.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JournalReply {
    /// Number of the newest batch that it holds, with all before.
    pub position: u64,
}
