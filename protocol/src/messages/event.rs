//! Events. What happened on the robot?

use serde::{Deserialize, Serialize};

use super::{BehaviourReport, GuardZone, Health, Link, Revision};
use crate::time::Stamp;

/// One entry of the robot's event log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Event {
    /// Time of the event, on the robot's clock.
    pub stamp: Stamp,
    /// Start of the edge that the event belongs to.
    pub boot_id: String,
    /// Number of the event within that start, from one.
    pub sequence: u64,
    /// What happened; its name is in the field `event`.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum EventKind {
    /// The edge started.
    Started,
    /// The robot accepted a plan and follows it.
    PlanAccepted {
        /// The goal that the plan serves.
        goal_id: String,
        /// The plan's revision.
        revision: Revision,
        /// The plan's trajectory.
        trajectory_id: u64,
    },
    /// The robot refused a plan; a valid older plan stays in force.
    PlanRejected {
        /// The goal that the plan serves.
        goal_id: String,
        /// The plan's revision.
        revision: Revision,
        /// The plan's trajectory.
        trajectory_id: u64,
        /// Which check the plan failed.
        reason: String,
    },
    /// The robot reached the end of a plan.
    PlanFinished {
        /// The goal that the plan serves.
        goal_id: String,
        /// The plan's trajectory.
        trajectory_id: u64,
    },
    /// The plan expired; the robot is at rest.
    PlanExpired {
        /// The goal that the plan served.
        goal_id: String,
    },
    /// The robot discarded its plan.
    PlanDiscarded {
        /// The goal that the plan served.
        goal_id: String,
        /// Why the plan was discarded.
        reason: String,
    },
    /// The contact sensor was pressed.
    Bumped,
    /// The battery's charge fell below the low mark of the robot file.
    BatteryLow {
        /// Charge left, 0 to 1.
        charge: f64,
    },
    /// The pose estimator dropped measurements; reported at most every ten seconds.
    InputsDropped {
        /// Measurements since the start that were older than the measurement buffer.
        too_late: u64,
        /// Measurements since the start that were not finite, had no covariance, or came from the future.
        broken: u64,
    },
    /// The off-board verdict on the robot's pose changed; while the pose is not trusted, the robot brakes and accepts no plan.
    Localisation {
        /// The new verdict.
        health: Health,
    },
    /// A teleop command was dropped; reported at most every ten seconds for each cause.
    TeleopDropped {
        /// Why the command was dropped.
        reason: String,
    },
    /// The collision monitor's verdict changed.
    Guard {
        /// The new verdict.
        zone: GuardZone,
        /// What the verdict is based on.
        reason: String,
    },
    /// The lease changed hands, lapsed or was released.
    Lease {
        /// The new holder, if there is one.
        holder: Option<String>,
        /// The current epoch.
        epoch: u64,
        /// What happened to the lease.
        reason: String,
    },
    /// The link state changed.
    LinkChanged {
        /// The new link state.
        link: Link,
    },
    /// An operator stopped the robot.
    Stopped {
        /// Who stopped it.
        by: String,
    },
    /// An operator lifted the stop.
    Resumed {
        /// Who lifted it.
        by: String,
    },
    /// A maneuver ended.
    BehaviourDone {
        /// Which maneuver it was, and how it ended.
        report: BehaviourReport,
    },
    /// A state machine on the robot changed its state.
    Transition {
        /// The state machine, such as `wall_follow`.
        behaviour: String,
        /// The state before.
        from: String,
        /// The state after.
        to: String,
        /// What caused the change.
        reason: String,
    },
}
