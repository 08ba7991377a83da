//! Maneuvers (Nav2's behaviors). How is the robot told to spin, back up or wait, and how is the outcome reported?
//!
//! The robot executes them on its own, under its collision monitor. Requests are idempotent: a repeated `id` does not start a second
//! execution.

use serde::{Deserialize, Serialize};

/// Starts, cancels or reports a maneuver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BehaviourRequest {
    /// Identifies the execution: a repeated id does not start it again.
    pub id: String,
    /// What the robot is to do.
    pub action: BehaviourAction,
    /// Lease epoch; everything but a report needs it.
    pub epoch: Option<u64>,
}

/// What a robot is to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum BehaviourAction {
    /// Turn on the spot.
    Spin {
        /// Angle to turn by, rad, counter-clockwise positive.
        angle: f64,
    },
    /// Drive straight.
    Drive {
        /// Distance, m; negative is backwards.
        distance: f64,
        /// Speed, m/s, positive.
        speed: f64,
    },
    /// Drive to the free position that is reached soonest, by one turn and one straight drive.
    ToFree {
        /// Clearance of the footprint at that position, m.
        clearance: f64,
        /// Search radius, m.
        within: f64,
    },
    /// Stay at rest.
    Wait {
        /// Duration, s.
        secs: f64,
    },
    /// End the maneuver.
    Cancel,
    /// Report only.
    Report,
}

/// Report on a maneuver.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BehaviourReport {
    /// Identifies the execution.
    pub id: String,
    /// State of the maneuver.
    pub state: BehaviourState,
    /// Why the maneuver failed.
    pub reason: Option<String>,
}

/// State of a maneuver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum BehaviourState {
    /// The robot is executing it.
    Running,
    /// The robot finished it.
    Succeeded,
    /// The robot could not finish it.
    Failed,
    /// Cancelled by a request, or preempted by something of higher priority.
    Canceled,
}

/// Answer to a maneuver request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BehaviourReply {
    /// Report of the requested execution; `None` when the robot does not know it.
    pub report: Option<BehaviourReport>,
}
