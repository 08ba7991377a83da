//! What goes into a mission's step, and what comes out? Already typed, already decoded: no bus in here.

use thiserror::Error;
use zenav_protocol::messages::*;
use zenav_protocol::topics::{MissionReply, MissionRequest};

use super::records::Record;

/// Names an ask of the mission's, so that its answer finds the way back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub struct Ticket(pub u64);

/// Names a client's request until it is answered; chosen by whoever feeds the mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Client(pub u64);

/// What arrived since the last step.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    /// The newest state of the robot, if there is a new one.
    pub state: Option<EdgeState>,
    /// The newest estimate of where it is, if there is a new one.
    pub pose: Option<PoseEstimate>,
    /// What happened on the robot, in order.
    pub events: Vec<Event>,
    /// The newest description of the map, if there is a new one.
    pub map_info: Option<MapInfo>,
    /// Changes of the map, in order.
    pub map_patches: Vec<MapPatch>,
    /// Answers to asks.
    pub answers: Vec<(Ticket, Result<Answer, NoAnswer>)>,
    /// What clients ask for.
    pub requests: Vec<(Client, MissionRequest)>,
}

/// A question of the mission's.
#[derive(Clone, Debug, PartialEq)]
pub enum Ask {
    /// To the robot: may I command?
    Lease(LeaseRequest),
    /// To the robot: who are you?
    EdgeInfo(InfoRequest),
    /// To the robot: a motion of its own.
    Behaviour(BehaviourRequest),
    /// To a motion worker.
    Motion(Box<MotionRequest>),
    /// To mapping.
    Map(MapRequest),
    /// To a program that does an action, on its key.
    Remote(String, Box<RemoteRequest>),
}

impl Ask {
    /// For how long whoever carries the ask out tries to get an answer, s of wall time.
    #[must_use]
    pub fn patience_secs(&self) -> f64 {
        match self {
            Self::Lease(_) => 1.0,
            Self::EdgeInfo(_) | Self::Behaviour(_) | Self::Remote(..) => 2.0,
            // Long enough for a second worker when the first one is silent.
            Self::Motion(request) => 2.0 + 2.0 * request.budget().as_secs_f64(),
            Self::Map(_) => 5.0,
        }
    }
}

/// The answer to an [`Ask`] of the same name.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// A lease.
    Lease(LeaseReply),
    /// The robot.
    EdgeInfo(Box<InfoReply>),
    /// How a behaviour goes.
    Behaviour(BehaviourReply),
    /// A path, a trajectory, or both; or why there is none.
    Motion(Box<MotionReply>),
    /// A map.
    Map(Box<MapReply>),
    /// How an action goes.
    Remote(Box<RemoteReply>),
}

/// Why an ask has no answer.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoAnswer {
    /// The server said no.
    #[error("{0}")]
    Refused(Refusal),
    /// Nobody answered in time, or nothing that could be read.
    #[error("{0}")]
    Silent(String),
}

/// What a step gave, in order. Whoever carries effects out stores what is to be stored, here and in the stores of those that have caught up,
/// **before** anything else of the step but the sign of life, which promises nothing.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Store, all or nothing. At most one a step, and the first.
    Persist(Vec<Record>),
    /// Publish the sign of life.
    Heartbeat(Heartbeat),
    /// Publish the plan.
    Plan(Box<Plan>),
    /// Publish what the mission does.
    Status(Box<MissionStatus>),
    /// Publish a goal's state.
    Goal(Box<GoalState>),
    /// Ask.
    Ask(Ticket, Ask),
    /// Answer a client.
    Reply(Client, Result<MissionReply, Refusal>),
    /// Another mission leads: this one is to be dropped, and what its leader stores to be taken in, until it may lead again.
    StandBy,
    /// Stop for good: this mission and the robot do not speak the same language.
    Fatal(String),
}
