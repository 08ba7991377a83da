//! How does a standby come to hold what its leader has acknowledged? It joins; then every write of the leader's store is handed to it.
//!
//! Primary and backup with an arbiter of membership, which is the robot: Lin et al., "PacificA: Replication in Log-Based Distributed
//! Storage Systems", Microsoft Research 2008.

use serde::{Deserialize, Serialize};

use super::GoalRequest;
use crate::time::Stamp;

/// A standby's wish to be handed all that the leader holds, and what it writes from then on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JoinRequest {
    /// Name of its store.
    pub store: String,
    /// Names what is to be handed over, anew for every wish: the standby takes nothing that is sent for another.
    pub session: String,
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

/// Writes of a leader's store for one standby.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JournalEntry {
    /// Name of the leader's store.
    pub leader: String,
    /// Epoch under which it leads.
    pub epoch: u64,
    /// The session of the standby's join.
    pub session: String,
    /// Number of the entry in the session, from one: the first begins with an empty store. One without writes repeats the number before.
    pub position: u64,
    /// The leader's time, by which stored stamps are to be read.
    pub now: Stamp,
    /// What is written, all or nothing; none says that the leader is there.
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

/// The standby's word that an entry is on its disk.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JournalReply {
    /// Number of the newest entry that it holds, with all before.
    pub position: u64,
}
