//! What is the robot to achieve? Goals as people and programs submit them, and what became of them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::DrivingProfile;
use crate::time::Stamp;

/// A place to be at, map frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoalPoint {
    /// Map x, m.
    pub x: f64,
    /// Map y, m.
    pub y: f64,
    /// Heading, rad, where one is wanted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub yaw: Option<f64>,
}

/// A goal: exactly one of (`x`, `y`), `place`, `waypoints`, or a `tree`, alone or with one of them: the tree then finds it in
/// its entry `goal`, or `goals`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GoalRequest {
    /// Name of the goal, made by the asker: a repeated id is the same goal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// Map x, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x: Option<f64>,
    /// Map y, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y: Option<f64>,
    /// Heading wanted at the end, rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub yaw: Option<f64>,
    /// A named place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
    /// Places to pass in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub waypoints: Vec<GoalPoint>,
    /// A behaviour tree: the name of a shipped one, or XML.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tree: Option<String>,
    /// Entries of the tree's blackboard.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub blackboard: BTreeMap<String, serde_json::Value>,
    /// What to do when another goal runs.
    #[serde(default)]
    pub on_busy: OnBusy,
    /// Of goals that wait the one with the greatest has its turn first, then the oldest.
    #[serde(default)]
    pub priority: i32,
    /// Time after which the goal is given up, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline_secs: Option<f64>,
    /// Distance that counts as reached, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// What its motions are to be good at; without it the deployment's choice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile: Option<DrivingProfile>,
}

/// What to do with a goal when another one runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OnBusy {
    /// Wait for its turn.
    #[default]
    Queue,
    /// Cancel the running goal.
    Preempt,
    /// Refuse.
    Reject,
}

/// Where a goal stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum GoalPhase {
    /// Stored; waits for its turn.
    Accepted,
    /// Being driven.
    Active,
    /// Held by a pause.
    Paused,
    /// Reached.
    Succeeded,
    /// Given up, with a reason.
    Aborted,
    /// Canceled by someone.
    Canceled,
    /// Refused after it had been stored.
    Rejected,
}

impl GoalPhase {
    /// Whether nothing comes after it.
    #[must_use]
    pub const fn is_end(self) -> bool {
        matches!(self, Self::Succeeded | Self::Aborted | Self::Canceled | Self::Rejected)
    }
}

/// Answer to a goal, cancel or pause.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoalReply {
    /// The goal's name.
    pub id: String,
    /// Where it stands.
    pub state: GoalPhase,
    /// Why, for an end that is not success.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// The robot that took it, where a group was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
}

/// A goal and what became of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoalState {
    /// The goal's name.
    pub id: String,
    /// The robot that it is for.
    pub robot: String,
    /// Where it stands.
    pub state: GoalPhase,
    /// Why, for an end that is not success.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// When it was accepted.
    pub accepted: Stamp,
    /// When driving began.
    #[serde(default)]
    pub started: Option<Stamp>,
    /// When it ended.
    #[serde(default)]
    pub ended: Option<Stamp>,
    /// How it goes.
    #[serde(default)]
    pub feedback: GoalFeedback,
    /// Its drives, in order; only the newest where there are many.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub legs: Vec<Leg>,
    /// What was asked for.
    pub request: GoalRequest,
}

/// One drive of a goal: a path or a list of waypoints, followed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Leg {
    /// Name of the tree's node that drove.
    pub name: String,
    /// Where to, where it is one place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goal: Option<GoalPoint>,
    /// `Active`, `Succeeded`, `Aborted` or `Canceled`.
    pub state: GoalPhase,
    /// Why, for an end that is not success.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// When driving began.
    pub started: Stamp,
    /// When it ended.
    #[serde(default)]
    pub ended: Option<Stamp>,
    /// Motions published for it.
    #[serde(default)]
    pub plans: u64,
    /// Motions that replaced a blocked, lost or refused one.
    #[serde(default)]
    pub replans: u64,
    /// Length of its first way as planned, m.
    #[serde(default)]
    pub planned_length: f64,
}

/// How a goal goes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GoalFeedback {
    /// What the tree is at, in words.
    pub step: String,
    /// Way left, m.
    #[serde(default)]
    pub distance_left: Option<f64>,
    /// Time left, s.
    #[serde(default)]
    pub time_left: Option<f64>,
    /// Plans published for it.
    #[serde(default)]
    pub plans: u64,
    /// Plans that replaced a blocked or lost one.
    #[serde(default)]
    pub replans: u64,
    /// Recoveries tried.
    #[serde(default)]
    pub recoveries: u64,
}

/// Cancels a goal; without an id, the running one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CancelRequest {
    /// Which goal.
    #[serde(default)]
    pub id: Option<String>,
    /// The same request is answered with the first answer.
    #[serde(default)]
    pub request_id: Option<String>,
}

/// Holds the running goal, or lets it go on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PauseRequest {
    /// Which goal; without an id, the running one.
    #[serde(default)]
    pub id: Option<String>,
    /// `false` holds, `true` lets it go on.
    #[serde(default)]
    pub resume: bool,
    /// The same request is answered with the first answer.
    #[serde(default)]
    pub request_id: Option<String>,
}

/// Asks for goals.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GoalsRequest {
    /// Only this goal.
    #[serde(default)]
    pub id: Option<String>,
    /// Only goals in these states; empty means all.
    #[serde(default)]
    pub states: Vec<GoalPhase>,
    /// At most so many, newest first.
    #[serde(default)]
    pub limit: Option<usize>,
}

/// Goals, newest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GoalsReply {
    /// The goals.
    pub goals: Vec<GoalState>,
}
