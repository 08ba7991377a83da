//! Manoeuvres (Nav2's behaviors). How is the robot asked to spin, back up or wait, and how does it go?
//!
//! The robot executes them by itself, with its own collision monitor. A request is idempotent: a repeated `id` starts nothing again.

use serde::{Deserialize, Serialize};

/// Starts, cancels or reports a manoeuvre.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BehaviourRequest {
    /// Identifies the execution: a repeated id starts nothing again.
    pub id: String,
    /// What the robot is asked to do.
    pub action: BehaviourAction,
    /// Lease epoch; everything but a report needs it.
    pub epoch: Option<u64>,
}

/// What a robot is asked to do.
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
    /// Drive to the free place that is reached soonest: one turn and one straight drive.
    ToFree {
        /// Clearance of the footprint at that place, m.
        clearance: f64,
        /// Search radius, m.
        within: f64,
    },
    /// Stay at rest.
    Wait {
        /// Duration, s.
        secs: f64,
    },
    /// End the manoeuvre.
    Cancel,
    /// Only report.
    Report,
}

/// Report on a manoeuvre.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BehaviourReport {
    /// Identifies the execution.
    pub id: String,
    /// State of the manoeuvre.
    pub state: BehaviourState,
    /// Why the manoeuvre failed.
    pub reason: Option<String>,
}

/// State of a manoeuvre.
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
    /// Somebody ended it, or something of higher priority did.
    Canceled,
}

/// Answer to a manoeuvre request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BehaviourReply {
    /// The execution asked for; `None` when the robot knows no such execution.
    pub report: Option<BehaviourReport>,
}
