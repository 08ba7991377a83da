//! What goes into one control tick, and what comes out? Already typed, already decoded: no bus in here.

use std::mem::discriminant;

use zenav_protocol::messages::*;

/// Names an ask, so that its answer finds the way back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub u64);

/// What arrived since the last tick, in the order of arrival.
#[derive(Clone, Debug, Default)]
pub struct Inbox {
    /// Plans.
    pub plans: Vec<Plan>,
    /// Renewals of the lease.
    pub heartbeats: Vec<Heartbeat>,
    /// Twists by hand.
    pub teleops: Vec<Teleop>,
    /// Pose measurements made off board.
    pub corrections: Vec<Correction>,
    /// Asks that wait for an answer.
    pub questions: Vec<(Ticket, Question)>,
    /// Control ticks that came too late, since start.
    pub missed_ticks: u64,
    /// How much later than its deadline this tick began, where somebody measures it.
    pub late: Option<std::time::Duration>,
    /// Brake now, whatever else: the edge shuts down.
    pub halt: bool,
}

/// An ask to the edge.
#[derive(Clone, Debug, PartialEq)]
pub enum Question {
    /// Who may command.
    Lease(LeaseRequest),
    /// Stop and latch.
    Stop(StopRequest),
    /// Allow a new plan.
    Resume(ResumeRequest),
    /// Mode and policy.
    Mode(ModeRequest),
    /// Gains.
    Param(ParamRequest),
    /// Motions of the edge's own.
    Maneuver(BehaviourRequest),
    /// Who is there.
    Info(InfoRequest),
}

/// The answer to a [`Question`] of the same name.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// A lease.
    Lease(LeaseReply),
    /// Whether the stop is latched: to stop and resume.
    Stop(StopReply),
    /// Mode and policy.
    Mode(ModeReply),
    /// Gains.
    Param(ParamReply),
    /// How a behaviour goes.
    Maneuver(BehaviourReply),
    /// Who is there.
    Info(Box<InfoReply>),
}

/// What must outlive a restart of the edge.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Persisted {
    /// The greatest epoch that was ever granted.
    pub epoch: u64,
    /// Whether the robot is stopped by hand.
    pub stopped: bool,
    /// Who keeps the robot's goals.
    #[serde(default)]
    pub leader: Option<Leader>,
}

/// Something to publish.
#[derive(Clone, Debug, PartialEq)]
pub enum Publication {
    /// A sweep of the lidar of this name, with the poses at its own stamp.
    Scan(String, Scan),
    /// Dead reckoning.
    Odometry(Odometry),
    /// Gyro and compass.
    Imu(Imu),
    /// Position by satellites or beacons.
    Gps(Gps),
    /// Contact.
    Bump(Bump),
    /// Energy.
    Battery(Battery),
    /// The estimate.
    Pose(PoseEstimate),
    /// The state.
    State(Box<EdgeState>),
    /// Something that happened.
    Event(Event),
    /// Shapes to draw.
    Marker(Marker),
}

impl Publication {
    /// Whether nobody needs it any more who gets a newer one: markers of two names are two things, and scans of two lidars.
    #[must_use]
    pub fn is_replaced_by(&self, newer: &Self) -> bool {
        match (self, newer) {
            (Self::Marker(old), Self::Marker(new)) => old.name == new.name,
            (Self::Scan(old, _), Self::Scan(new, _)) => old == new,
            _ => discriminant(self) == discriminant(newer),
        }
    }
}

/// What one control tick gave.
#[derive(Clone, Debug, Default)]
pub struct Outbox {
    /// Wanted wheel speeds (left, right; rad/s).
    pub wheels: [f64; 2],
    /// What to publish, in order.
    pub publications: Vec<Publication>,
    /// What to store **before** the answers go out.
    pub persist: Option<Persisted>,
    /// Answers.
    pub answers: Vec<(Ticket, Result<Answer, Refusal>)>,
}
