//! Remote action. How does a program in any language execute an action of a behaviour tree?
//!
//! The program, called the server here, answers queries on one Zenoh key. A query carries a [`RemoteRequest`] as JSON; the server replies
//! on the same key with a [`RemoteReply`] as JSON.
//!
//! * `run` with a new `execution` starts it; with a known one it only reports. The server replies at once, with `RUNNING` while the action
//!   continues. The mission asks again a few times a second until the reply is `SUCCESS` or `FAILURE`; from then on the reply stays the
//!   same.
//! * `cancel` stops a running execution; the server replies as to `run`. For an unknown execution it starts nothing and replies `FAILURE`.
//! * A request may arrive several times, also concurrently, and after a restart of either side. So an execution happens at least once, and
//!   exactly once if the server keeps the ids of the executions it has started.
//! * `epoch` is the lease epoch under which the mission commands its robot; it grows with every change of holder. Of two requests for one
//!   robot the server should obey the one with the higher epoch.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Starts an action, asks for its status, or stops it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RemoteRequest {
    /// Identifies the execution: the same in every request about it, and unique to it.
    pub execution: String,
    /// The requested action.
    pub action: RemoteAction,
    /// Name of the robot whose mission sends the request.
    pub robot: String,
    /// The goal that the action serves.
    pub goal: String,
    /// Name of the node in the tree.
    pub node: String,
    /// The mission's lease epoch.
    pub epoch: u64,
    /// Values of the node's input ports, except the ports that configure the key and the polling.
    #[serde(default)]
    pub inputs: BTreeMap<String, serde_json::Value>,
}

/// What a request asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum RemoteAction {
    /// Start the execution, or report on it.
    Run,
    /// Stop the execution.
    Cancel,
}

/// Status of an execution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RemoteReply {
    /// Identifies the execution.
    pub execution: String,
    /// The execution's status.
    pub status: RemoteStatus,
    /// What the server is doing, or why the action failed, for display.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub feedback: String,
    /// Values for the node's output ports; read once the execution has ended.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub outputs: BTreeMap<String, serde_json::Value>,
}

/// Status of an execution, as a behaviour tree node reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "UPPERCASE")]
pub enum RemoteStatus {
    /// The action continues.
    Running,
    /// The action succeeded.
    Success,
    /// The action failed or was cancelled.
    Failure,
}

#[cfg(test)]
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
