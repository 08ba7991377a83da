//! What does the robot say of itself, and what can it be asked, with or without a cloud?

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::Revision;
use crate::geometry::Twist2;
use crate::time::Stamp;

/// Age of the lease's last renewal, in words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Link {
    /// Renewed lately.
    Connected,
    /// Not renewed for a while (default 0.5 s).
    Stale,
    /// Not renewed for long (default 3 s), or never.
    #[default]
    Lost,
}

/// What decides the motion now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// At rest, nothing to do.
    #[default]
    Idle,
    /// Follows an accepted plan.
    Follow,
    /// Driven by hand.
    Teleop,
    /// A behaviour of the edge's own (spin, back up, …) runs.
    Behaviour,
    /// Follows walls on its own, without a cloud.
    WallFollow,
    /// Drives back to where it started, without a cloud.
    ReturnHome,
    /// Stopped by hand until resumed.
    Stopped,
}

/// Where the wall follower stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WallFollowerState {
    /// Turns towards the nearest wall.
    #[default]
    WallSearch,
    /// Drives up to it.
    Approach,
    /// Turns until the way ahead is clear.
    Turn,
    /// Drives along it.
    WallFollow,
    /// Has touched something: waits until an operator drives it away.
    Bump,
}

impl WallFollowerState {
    /// Its name on the wire.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::WallSearch => "wall_search",
            Self::Approach => "approach",
            Self::Turn => "turn",
            Self::WallFollow => "wall_follow",
            Self::Bump => "bump",
        }
    }
}

/// How near something is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GuardZone {
    /// Nothing in the way.
    #[default]
    Clear,
    /// Slowed down.
    Slow,
    /// Stopped by the guard.
    Stop,
}

/// The plan being driven.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanProgress {
    /// The goal it serves.
    pub goal_id: String,
    /// Its epoch.
    pub epoch: u64,
    /// Its revision.
    pub revision: Revision,
    /// Its motion.
    pub trajectory_id: u64,
    /// Plan time reached, s.
    pub time: f64,
    /// Next waypoint, counted from zero.
    pub waypoint: usize,
    /// Way left, m.
    pub distance_left: f64,
    /// Time left by the plan, s.
    pub time_left: f64,
    /// Time until the plan expires, s.
    pub valid_for: f64,
    /// Whether the end was reached and the robot is at rest there.
    pub finished: bool,
}

/// Who may command the robot.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseState {
    /// Who, if anybody.
    pub holder: Option<String>,
    /// As what.
    pub role: Option<LeaseRole>,
    /// The current epoch.
    pub epoch: u64,
    /// Whether it has been renewed within its time to live.
    pub live: bool,
    /// Who keeps the robot's goals, if anybody ever did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leader: Option<Leader>,
    /// Whether the leader was heard lately, also while an operator has the lease.
    #[serde(default)]
    pub leader_live: bool,
}

/// Who keeps a robot's goals, by the robot's own word: the mission with a store that was granted the lease last. A lease of an operator, or
/// a lapsed one, changes nothing in it, unless the leader falls silent meanwhile and one that has caught up asks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leader {
    /// Name of its store.
    pub store: String,
    /// Epoch of its grant.
    pub epoch: u64,
    /// All stores that hold whatever it has acknowledged, its own among them: only they may lead next.
    pub caught_up: Vec<String>,
    /// Grows with every word of the leader's on who has caught up: an older one that comes late changes nothing.
    #[serde(default)]
    pub revision: u64,
}

/// State of a robot, ten times a second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EdgeState {
    /// When.
    pub stamp: Stamp,
    /// New at every start of the edge.
    pub boot_id: String,
    /// What decides the motion.
    pub mode: Mode,
    /// How the link is.
    pub link: Link,
    /// Who may command.
    pub lease: LeaseState,
    /// The accepted plan.
    #[serde(default)]
    pub plan: Option<PlanProgress>,
    /// Velocity in the base frame.
    pub velocity: Twist2,
    /// How near something is.
    pub guard: GuardZone,
    /// Charge left, 0 to 1.
    pub battery: f64,
    /// The behaviour that runs or ran last.
    #[serde(default)]
    pub behaviour: Option<BehaviourReport>,
    /// Where the wall follower stands, on a robot that follows walls when nobody commands it.
    #[serde(default)]
    pub wall_follower: Option<WallFollowerState>,
    /// Control ticks that came too late, since start.
    #[serde(default)]
    pub missed_ticks: u64,
}

/// Something that happened on the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// When.
    pub stamp: Stamp,
    /// The boot it belongs to.
    pub boot_id: String,
    /// Counts the boot's events from one.
    pub sequence: u64,
    /// What.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum EventKind {
    /// The edge has started.
    Started,
    /// A plan is driven from now on.
    PlanAccepted {
        /// The goal it serves.
        goal_id: String,
        /// Its revision.
        revision: Revision,
        /// Its motion.
        trajectory_id: u64,
    },
    /// A plan was refused; an older one stays in force while valid.
    PlanRejected {
        /// The goal it serves.
        goal_id: String,
        /// Its revision.
        revision: Revision,
        /// Its motion.
        trajectory_id: u64,
        /// Why.
        reason: String,
    },
    /// The end of a plan was reached.
    PlanFinished {
        /// The goal it serves.
        goal_id: String,
        /// Its motion.
        trajectory_id: u64,
    },
    /// The plan ran out; the robot is at rest.
    PlanExpired {
        /// The goal it served.
        goal_id: String,
    },
    /// The plan was thrown away.
    PlanDiscarded {
        /// The goal it served.
        goal_id: String,
        /// Why.
        reason: String,
    },
    /// Contact.
    Bumped,
    /// The battery's charge fell below what the robot's file calls low.
    BatteryLow {
        /// Charge left, 0 to 1.
        charge: f64,
    },
    /// Sensors said something that could not count for the pose; told every ten seconds at most.
    InputsDropped {
        /// Inputs since the start that came when their time was no longer kept.
        too_late: u64,
        /// Inputs since the start that were no numbers, no covariance, or of a time yet to come.
        broken: u64,
    },
    /// A twist by hand did not count; told for each cause every ten seconds at most.
    TeleopDropped {
        /// Why.
        reason: String,
    },
    /// The guard changed its mind.
    Guard {
        /// The zone from now on.
        zone: GuardZone,
        /// Why.
        reason: String,
    },
    /// Somebody else may command.
    Lease {
        /// Who, or nobody.
        holder: Option<String>,
        /// Current epoch.
        epoch: u64,
        /// What happened.
        reason: String,
    },
    /// The link changed.
    LinkChanged {
        /// From now on.
        link: Link,
    },
    /// Stopped by hand.
    Stopped {
        /// By whom.
        by: String,
    },
    /// Let go by hand.
    Resumed {
        /// By whom.
        by: String,
    },
    /// A behaviour ended.
    BehaviourDone {
        /// Which and how.
        report: BehaviourReport,
    },
    /// A behaviour's own state changed.
    Transition {
        /// The behaviour.
        behaviour: String,
        /// From this state.
        from: String,
        /// To this one.
        to: String,
        /// Why.
        reason: String,
    },
}

/// Shapes to draw.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Marker {
    /// When.
    pub stamp: Stamp,
    /// What it shows, such as `waypoint`.
    pub name: String,
    /// Corner points, map frame; a single one is a point.
    pub points: Vec<Point2<f64>>,
}

/// As what somebody commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LeaseRole {
    /// An orchestrator.
    Mission,
    /// A person: outranks a mission.
    Operator,
}

/// Asks for the right to command a robot, or gives it back.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseRequest {
    /// Who asks.
    pub holder: String,
    /// As what.
    pub role: LeaseRole,
    /// Take or give back.
    #[serde(default)]
    pub action: LeaseAction,
    /// The same request is answered with the first answer.
    pub request_id: String,
    /// Name of the store in which a mission keeps the robot's goals; who keeps none does not lead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub store: Option<String>,
    /// For [`LeaseAction::CaughtUp`]: the epoch under which the mission leads, and all stores that hold what it has acknowledged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leads: Option<Leader>,
}

impl LeaseRequest {
    /// A request of somebody who keeps no goals.
    #[must_use]
    pub fn new(holder: impl Into<String>, role: LeaseRole, action: LeaseAction, request_id: impl Into<String>) -> Self {
        Self {
            holder: holder.into(),
            role,
            action,
            request_id: request_id.into(),
            store: None,
            leads: None,
        }
    }
}

/// What is asked about a lease.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LeaseAction {
    /// Take.
    #[default]
    Acquire,
    /// Give back.
    Release,
    /// A leader's word on who holds all that it has acknowledged; needs no live lease.
    CaughtUp,
    /// An operator's word that the goals of the last leader, and of those that had caught up, are given up: any mission may lead next.
    Forget,
}

/// A lease.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeaseReply {
    /// The epoch that every command must carry.
    pub epoch: u64,
    /// Time to live without a heartbeat, s.
    pub ttl_secs: f64,
    /// The edge's boot.
    pub boot_id: String,
}

/// Stops a robot: no lease needed, latches, discards the plan.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StopRequest {
    /// Who.
    #[serde(default)]
    pub by: Option<String>,
}

/// Allows a new plan after a stop.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResumeRequest {
    /// Who.
    #[serde(default)]
    pub by: Option<String>,
}

/// Whether a robot is stopped.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StopReply {
    /// Latched.
    pub stopped: bool,
}

/// Asks for the mode, or for another policy of what to do when the lease is lost.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModeRequest {
    /// The policy from now on.
    #[serde(default)]
    pub on_lost: Option<LostPolicy>,
    /// Lease epoch, to change something.
    #[serde(default)]
    pub epoch: Option<u64>,
}

/// What to do with an accepted plan when the lease has expired.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LostPolicy {
    /// Follow it to its expiry, at rest by then.
    #[default]
    FinishHorizon,
    /// Brake now.
    Stop,
    /// As `finish_horizon`; once the link is lost and no plan is left, follow walls.
    WallFollow,
    /// As `finish_horizon`; once the link is lost and no plan is left, drive back to the start the way that it came.
    ReturnHome,
}

/// The mode.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModeReply {
    /// What decides the motion.
    pub mode: Mode,
    /// The policy in force.
    pub on_lost: LostPolicy,
}

/// Reads parameters, or changes one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParamRequest {
    /// Which; without a name, all.
    #[serde(default)]
    pub name: Option<String>,
    /// Its new value.
    #[serde(default)]
    pub value: Option<f64>,
    /// Lease epoch, to change something.
    #[serde(default)]
    pub epoch: Option<u64>,
}

/// Parameters.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParamReply {
    /// Names and values.
    pub params: std::collections::BTreeMap<String, f64>,
}

/// Starts, cancels or reports a motion of the edge's own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BehaviourRequest {
    /// The execution: a repeated id starts nothing again.
    pub id: String,
    /// What to do.
    pub action: BehaviourAction,
    /// Lease epoch, to change something.
    #[serde(default)]
    pub epoch: Option<u64>,
}

/// What to do with a behaviour.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BehaviourAction {
    /// Turn on the spot by an angle, rad.
    Spin {
        /// Counter-clockwise positive, rad.
        angle: f64,
    },
    /// Drive straight; negative is backwards.
    Drive {
        /// m.
        distance: f64,
        /// m/s, positive.
        speed: f64,
    },
    /// Drive to the nearest place that keeps a distance from everything seen: one turn, one straight drive.
    ToFree {
        /// Distance of the footprint from everything there, m.
        clearance: f64,
        /// The place is searched within this distance, m.
        within: f64,
    },
    /// Stay.
    Wait {
        /// s.
        secs: f64,
    },
    /// End it.
    Cancel,
    /// Only report.
    Report,
}

/// How a behaviour goes or went.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BehaviourReport {
    /// The execution.
    pub id: String,
    /// Where it stands.
    pub state: BehaviourState,
    /// Why, for a failure.
    #[serde(default)]
    pub reason: Option<String>,
}

/// Where a behaviour stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BehaviourState {
    /// Under way.
    Running,
    /// Done.
    Succeeded,
    /// Could not be done.
    Failed,
    /// Ended by somebody.
    Canceled,
}

/// Answer to a behaviour request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BehaviourReply {
    /// The execution asked for, or none when there never was such.
    pub report: Option<BehaviourReport>,
}

/// A twist by hand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Teleop {
    /// Lease epoch.
    pub epoch: u64,
    /// Wanted velocity.
    pub twist: Twist2,
    /// Stamp of the newest message of the edge that the operator has seen, such as its state or odometry. The twist acts until this is
    /// a dead-man's time old (0.3 s); of several messages with one echo the first counts, and a stop.
    pub echo: Stamp,
}
