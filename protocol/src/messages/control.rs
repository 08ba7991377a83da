//! Operator control. How does a person stop, resume or drive a robot, and configure what it does without a lease?

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Mode;
use crate::geometry::Twist2;
use crate::id::Id;
use crate::time::Stamp;

/// Stops a robot. Needs no lease, latches across restarts, and discards the plan.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StopRequest {
    /// Who stops the robot, for the event log.
    pub by: Option<String>,
    /// Chosen by the requester: a copy of a request that the network repeats counts as one stop.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request_id: Option<String>,
}

impl StopRequest {
    /// A new request.
    #[must_use]
    pub fn new(by: impl Into<String>) -> Self {
        Self {
            by: Some(by.into()),
            request_id: Some(Id::unique().to_string()),
        }
    }
}

/// Lifts a stop: the robot accepts plans again, from its present pose.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ResumeRequest {
    /// Who lifts the stop, for the event log.
    pub by: Option<String>,
    /// Number of the newest stop to lift, as counted in the robot's state: a later stop stays in force. Without it, any stop is lifted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stop: Option<u64>,
    /// Boot of the robot whose state had this number: stops are counted anew after a restart. Required with `stop`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boot_id: Option<String>,
    /// Chosen by the requester: a copy of a request that the network repeats lifts nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request_id: Option<String>,
}

impl ResumeRequest {
    /// A new request to lift the stops up to this one, as a state of the robot's boot counted them.
    #[must_use]
    pub fn new(by: impl Into<String>, boot_id: impl Into<String>, stop: u64) -> Self {
        Self {
            by: Some(by.into()),
            stop: Some(stop),
            boot_id: Some(boot_id.into()),
            request_id: Some(Id::unique().to_string()),
        }
    }
}

/// Answer to a stop or a resume.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StopReply {
    /// Whether the robot is stopped now.
    pub stopped: bool,
}

/// A velocity command from an operator who holds the lease.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Teleop {
    /// Lease epoch of the operator.
    pub epoch: u64,
    /// Requested velocity, base frame, m/s and rad/s.
    pub twist: Twist2,
    /// Dead-man's switch: stamp of the newest robot message that the operator has seen, such as its state or odometry. The command acts
    /// until this stamp is 0.3 s old. Of several commands with the same echo only the first is accepted, except for a stop.
    pub echo: Stamp,
}

/// Reads the mode, or changes what the robot does when the lease is lost.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ModeRequest {
    /// The new policy; without it, nothing changes.
    pub on_lost: Option<LostPolicy>,
    /// Lease epoch, required for a change.
    pub epoch: Option<u64>,
}

/// What the robot does with an accepted plan once the lease has expired.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum LostPolicy {
    /// Follow the plan until it expires, and be at rest by then.
    #[default]
    FinishHorizon,
    /// Brake at once.
    Stop,
    /// As `finish_horizon`; once the link is lost and no plan is left, follow walls.
    WallFollow,
    /// As `finish_horizon`; once the link is lost and no plan is left, drive back to the start along the path driven so far.
    ReturnHome,
}

/// Answer to a mode request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ModeReply {
    /// Which controller decides the motion.
    pub mode: Mode,
    /// The policy in force.
    pub on_lost: LostPolicy,
}

/// Reads parameters, or changes one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ParamRequest {
    /// Name of the parameter; without it, all are read.
    pub name: Option<String>,
    /// New value of the parameter.
    pub value: Option<f64>,
    /// Lease epoch, required for a change.
    pub epoch: Option<u64>,
}

/// Parameters of the robot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ParamReply {
    /// Values by name.
    pub params: BTreeMap<String, f64>,
}
