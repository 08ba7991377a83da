//! Operator. Which operations on robots does the gateway offer, and how are they carried out?
//!
//! A trait, so that this library does not depend on a network: in `zenav` the service in `zenav-cloud` sends the requests over the bus.
//! Every answer has its own deadline, and a request continues after its browser has disconnected.

use std::future::Future;
use std::pin::Pin;

use thiserror::Error;
use tokio::sync::watch;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    AnnotateAction, Annotations, CancelRequest, GoalReply, GoalRequest, GoalsReply, GoalsRequest, LocaliseReply,
    MapReply, MoveGoalRequest, PauseRequest, Refusal, ResumeRequest, StopReply,
};

use crate::hold::Hold;

/// Why there is no answer.
///
/// ```
/// use zenav_gateway::AskFailure;
/// use zenav_protocol::messages::Refusal;
///
/// let late = AskFailure::Timeout { key: "zenav/tiago/ask/edge/stop".into() };
/// assert_eq!(late.to_string(), "no answer from zenav/tiago/ask/edge/stop in time");
/// let refused = AskFailure::Refused(Refusal::rejected("the goal is in a wall"));
/// assert_eq!(refused.to_string(), "rejected: the goal is in a wall");
/// ```
#[derive(Clone, Debug, PartialEq, Error)]
pub enum AskFailure {
    /// The server refused.
    #[error("{0}")]
    Refused(Refusal),
    /// There was no answer in time.
    #[error("no answer from {key} in time")]
    Timeout {
        /// The requested key.
        key: String,
    },
    /// The request could not be sent: the bus is closed, or too many requests are pending.
    #[error("{reason}")]
    Unavailable {
        /// What prevents it.
        reason: String,
    },
}

/// The reply to a request, or why there is none.
pub type Answer<T> = Pin<Box<dyn Future<Output = Result<T, AskFailure>> + Send>>;

/// Carries out requests of people to robots.
pub trait Operator: Send + Sync + 'static {
    /// Submits a goal; it is stored before the reply.
    fn submit(&self, robot: &str, goal: GoalRequest) -> Answer<GoalReply>;
    /// Cancels a goal, waiting or active.
    fn cancel(&self, robot: &str, request: CancelRequest) -> Answer<GoalReply>;
    /// Pauses a goal, or resumes it.
    fn pause(&self, robot: &str, request: PauseRequest) -> Answer<GoalReply>;
    /// Lists goals.
    fn goals(&self, robot: &str, request: GoalsRequest) -> Answer<GoalsReply>;
    /// Moves a waiting goal to another position in the queue.
    fn move_goal(&self, robot: &str, request: MoveGoalRequest) -> Answer<GoalReply>;
    /// Changes the places and zones of the robot's map, and answers with all of them: under the lease in force, so that a driving robot
    /// continues.
    fn annotate(&self, robot: &str, action: AnnotateAction) -> Answer<Annotations>;
    /// Sets the robot's pose, `map_from_base`: under an operator's lease, which is released at once. The robot drops its plan.
    fn set_pose(&self, robot: &str, pose: Pose2, by: &str) -> Answer<LocaliseReply>;
    /// Stops the robot until it is resumed.
    fn stop(&self, robot: &str, by: &str) -> Answer<StopReply>;
    /// Lifts the stops up to the one that the request names, but none after it.
    fn resume(&self, robot: &str, request: ResumeRequest) -> Answer<StopReply>;
    /// Gets the whole map.
    fn map(&self, robot: &str) -> Answer<MapReply>;
    /// Takes the operator's lease, to drive by hand.
    fn drive(&self, robot: &str, by: &str) -> Answer<Drive>;
}

/// A robot driven by hand: it obeys the newest [`Hold`] until this is dropped.
///
/// ```
/// use tokio::sync::watch;
/// use zenav_gateway::{Drive, Hold};
/// use zenav_protocol::geometry::Twist2;
///
/// let (commands, newest) = watch::channel(None);
/// let (_end, ended) = watch::channel(None::<String>);
/// let drive = Drive { commands, ended };
/// for v in [0.1, 0.2] {
///     drive.commands.send_replace(Some(Hold::new(Twist2::new(v, 0.0), 5.0)));
/// }
/// assert_eq!(newest.borrow().map(|hold| hold.twist(5.1).v), Some(0.2), "only the newest counts");
/// ```
#[derive(Debug)]
pub struct Drive {
    /// Commands; only the newest counts.
    pub commands: watch::Sender<Option<Hold>>,
    /// Why the drive has ended, once it has.
    pub ended: watch::Receiver<Option<String>>,
}
