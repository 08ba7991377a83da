//! Step I/O. What are the inputs and outputs of a mission's step? Typed and decoded, without a bus.

use thiserror::Error;
use zenav_protocol::lease::LONGEST_ROUND_TRIP;
use zenav_protocol::messages::{
    Annotations, BehaviourReply, BehaviourRequest, EdgeState, Event, GoalState, Heartbeat, InfoReply, InfoRequest,
    LeaseReply, LeaseRequest, Localisation, LocaliseReply, LocaliseRequest, MapFrame, MapInfo, MapPatch, MapReply,
    MapRequest, MappingLeader, MissionStatus, MotionReply, MotionRequest, Plan, PoseEstimate, Refusal, RemoteReply,
    RemoteRequest, Yield,
};
use zenav_protocol::topics::{MissionReply, MissionRequest};

use super::records::Record;

/// Identifies a request of the mission, to match its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub struct Ticket(pub u64);

/// Identifies a client's request until it is answered; chosen by the caller of [`Mission::step`](crate::Mission::step).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Client(pub u64);

/// Inputs since the last step.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    /// The robot's newest state, if new.
    pub state: Option<EdgeState>,
    /// The robot's newest pose estimate, if new.
    pub pose: Option<PoseEstimate>,
    /// The newest report of the robots that the robot gives way to, if new.
    pub yields: Option<Yield>,
    /// The robot's events, in order.
    pub events: Vec<Event>,
    /// The newest map description, if new.
    pub map_info: Option<MapInfo>,
    /// Map patches, in order.
    pub map_patches: Vec<MapPatch>,
    /// The newest beat of the mapping service that leads, if new.
    pub mapping_leader: Option<MappingLeader>,
    /// Whether mapping is silent: nothing that it publishes has come for so long that its beats should have.
    pub is_mapping_silent: bool,
    /// Whether the robot's pose can be trusted, if new.
    pub localisation: Option<Localisation>,
    /// The frame of the map and the poses of its parts, if new.
    pub map_frame: Option<MapFrame>,
    /// The places and zones of the map, if new.
    pub annotations: Option<Annotations>,
    /// Whether the mapper is alive, if changed; it counts as alive until reported gone.
    pub mapper_alive: Option<bool>,
    /// Answers to the mission's requests.
    pub answers: Vec<(Ticket, Result<Answer, NoAnswer>)>,
    /// Requests of clients, in the order of arrival.
    pub requests: Vec<(Client, MissionRequest)>,
}

/// A request of the mission to another component.
#[derive(Clone, Debug, PartialEq)]
pub enum Ask {
    /// To the robot: the lease.
    Lease(LeaseRequest),
    /// To the robot: its identity and model.
    EdgeInfo(InfoRequest),
    /// To the robot: a maneuver.
    Behaviour(BehaviourRequest),
    /// To a motion worker.
    Motion(Box<MotionRequest>),
    /// To mapping.
    Map(MapRequest),
    /// To mapping: the robot's pose.
    Localise(LocaliseRequest),
    /// To a program that runs a remote action, on its key.
    Remote(String, Box<RemoteRequest>),
}

impl Ask {
    /// How long the service waits for an answer, s of wall time.
    ///
    /// ```
    /// use zenav_mission::Ask;
    /// use zenav_protocol::messages::{InfoRequest, MapRequest};
    ///
    /// assert_eq!(Ask::Map(MapRequest::default()).patience_secs(), 5.0);
    /// assert!(Ask::EdgeInfo(InfoRequest {}).patience_secs() > 2.0, "the link may be slow");
    /// ```
    #[must_use]
    pub fn patience_secs(&self) -> f64 {
        match self {
            Self::Lease(_) | Self::EdgeInfo(_) | Self::Behaviour(_) => 2.0 + LONGEST_ROUND_TRIP.as_secs_f64(),
            Self::Remote(..) => 2.0,
            // Long enough for a second worker if the first one does not answer.
            Self::Motion(request) => 2.0 + 2.0 * request.budget().as_secs_f64(),
            Self::Map(_) | Self::Localise(_) => 5.0,
        }
    }
}

/// The answer to an [`Ask`] of the same name.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// The robot's answer about its lease.
    Lease(LeaseReply),
    /// The robot's identity and model.
    EdgeInfo(Box<InfoReply>),
    /// A maneuver's progress.
    Behaviour(BehaviourReply),
    /// A path, a trajectory, or both; or why there is none.
    Motion(Box<MotionReply>),
    /// The map, or the answer to an action on it.
    Map(Box<MapReply>),
    /// Whether the robot's pose can be trusted.
    Localised(LocaliseReply),
    /// A remote action's progress.
    Remote(Box<RemoteReply>),
}

/// Why a request has no answer.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoAnswer {
    /// The server refused.
    #[error("{0}")]
    Refused(Refusal),
    /// No server gave a decodable answer in time.
    #[error("{0}")]
    Silent(String),
}

/// Effects of a step for the caller to carry out, in order. [`Persist`](Effect::Persist) must be on disk, here and on every standby that
/// has caught up, **before** any other effect of the step, except the heartbeat, which makes no promises.
#[derive(Clone, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "a step has few effects, and each is moved once"
)]
pub enum Effect {
    /// Store all or nothing. At most one per step, and the first.
    Persist(Vec<Record>),
    /// Publish the heartbeat.
    Heartbeat(Heartbeat),
    /// Publish the plan.
    Plan(Box<Plan>),
    /// Publish the mission's status.
    Status(Box<MissionStatus>),
    /// Publish a goal's state.
    Goal(Box<GoalState>),
    /// Send a request.
    Ask(Ticket, Ask),
    /// Answer a client.
    Reply(Client, Result<MissionReply, Refusal>),
    /// Another mission leads: drop this one, and follow the leader's journal until this store may lead again.
    StandBy,
}
