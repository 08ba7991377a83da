//! What does a tree's `RemoteAction` say to a program that does the action, and what does that answer?
//!
//! The protocol, for programs in any language: whoever does an action answers queries on one Zenoh key. A query carries a
//! [`RemoteRequest`] as JSON, the reply is a [`RemoteReply`] as JSON, on the same key.
//!
//! * `run` with an `execution` that is not known begins it; with one that is known it only tells how that goes. The reply comes
//!   at once, `RUNNING` while the action goes on: it is not the reply that waits for the action's end. Whoever asks, asks again
//!   a few times a second until the answer is `SUCCESS` or `FAILURE`, and after an end the answer stays the same.
//! * `cancel` stops an execution that runs, and is answered like `run`. Of one that is not known nothing is begun: `FAILURE`.
//! * A request may come more than once, also at the same time, and after a restart of either side: an execution is done at least
//!   once, and exactly once by a program that keeps the ids of what it has begun.
//! * `epoch` is the lease under which the mission commands its robot, greater after every change of hands: of two requests for
//!   one robot, a program that can should obey the greater.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Asks a program to do an action, how it goes, or to stop it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RemoteRequest {
    /// Name of the execution: the same for every request about it, and for no other.
    pub execution: String,
    /// What is asked.
    pub action: RemoteAction,
    /// The robot whose mission asks.
    pub robot: String,
    /// The goal that is served.
    pub goal: String,
    /// Name of the node in the tree.
    pub node: String,
    /// Lease epoch of the mission.
    pub epoch: u64,
    /// The node's ports that have a value, besides those that say where and how often to ask.
    #[serde(default)]
    pub inputs: BTreeMap<String, serde_json::Value>,
}

/// What is asked of an execution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RemoteAction {
    /// Begin it, or tell how it goes.
    Run,
    /// Stop it.
    Cancel,
}

/// How an execution goes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RemoteReply {
    /// Its name.
    pub execution: String,
    /// Where it stands.
    pub status: RemoteStatus,
    /// What it says of itself: what it is doing, or why it failed.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub feedback: String,
    /// Values for the node's ports that lead to blackboard entries; looked at once it has ended.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub outputs: BTreeMap<String, serde_json::Value>,
}

/// Where an execution stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum RemoteStatus {
    /// It goes on.
    Running,
    /// Its aim was reached.
    Success,
    /// It was not.
    Failure,
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_wire_is_what_other_languages_were_told() {
        let request = RemoteRequest {
            execution: "m-1-2".into(),
            action: RemoteAction::Run,
            robot: "tiago".into(),
            goal: "g".into(),
            node: "Grab".into(),
            epoch: 3,
            inputs: [("item".to_owned(), "cup".into())].into(),
        };
        assert_eq!(
            serde_json::to_string(&request).unwrap(),
            r#"{"execution":"m-1-2","action":"run","robot":"tiago","goal":"g","node":"Grab","epoch":3,"inputs":{"item":"cup"}}"#
        );
        let reply: RemoteReply = serde_json::from_str(r#"{"execution":"m-1-2","status":"RUNNING","more":1}"#).unwrap();
        assert_eq!(reply.status, RemoteStatus::Running);
    }
}
