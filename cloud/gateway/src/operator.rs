//! Operator. What may the gateway do to robots, and who carries it out?
//!
//! A trait, so that this library knows no network: in `zenav` the service in `zenav-cloud` asks over the bus. Every answer has a deadline of
//! its own, and a request goes on when the browser that made it is gone.

use std::future::Future;
use std::pin::Pin;

use thiserror::Error;
use tokio::sync::watch;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    AnnotateAction, Annotations, CancelRequest, GoalReply, GoalRequest, GoalsReply, GoalsRequest, LocaliseReply,
    MapReply, MoveGoalRequest, PauseRequest, Refusal, StopReply,
};

use crate::hold::Hold;

/// Why there is no answer.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum AskFailure {
    /// Whoever was asked refused.
    #[error("{0}")]
    Refused(Refusal),
    /// Nobody answered in time.
    #[error("no answer from {key} in time")]
    Timeout {
        /// What was asked.
        key: String,
    },
    /// It could not be asked: the bus is closed, too much is asked already.
    #[error("{reason}")]
    Unavailable {
        /// What stands against it.
        reason: String,
    },
}

/// An answer to come.
pub type Answer<T> = Pin<Box<dyn Future<Output = Result<T, AskFailure>> + Send>>;

/// Carries out what people want of robots.
pub trait Operator: Send + Sync + 'static {
    /// Submits a goal.
    fn submit(&self, robot: &str, goal: GoalRequest) -> Answer<GoalReply>;
    /// Cancels a goal.
    fn cancel(&self, robot: &str, request: CancelRequest) -> Answer<GoalReply>;
    /// Pauses a goal, or lets it go on.
    fn pause(&self, robot: &str, request: PauseRequest) -> Answer<GoalReply>;
    /// Lists goals.
    fn goals(&self, robot: &str, request: GoalsRequest) -> Answer<GoalsReply>;
    /// Moves a waiting goal to another place in the queue.
    fn move_goal(&self, robot: &str, request: MoveGoalRequest) -> Answer<GoalReply>;
    /// Answers with the places and zones of the robot's map, after a change of them: under the lease in force, so that a robot that drives
    /// goes on.
    fn annotate(&self, robot: &str, action: AnnotateAction) -> Answer<Annotations>;
    /// Tells the robot where it is, `map_from_base`: under an operator's lease, which is given back at once. The robot drops its plan.
    fn set_pose(&self, robot: &str, pose: Pose2, by: &str) -> Answer<LocaliseReply>;
    /// Stops the robot until it is resumed.
    fn stop(&self, robot: &str, by: &str) -> Answer<StopReply>;
    /// Lifts a stop: the newest that the robot has told of (`EdgeState::stops`), and none that came after it.
    fn resume(&self, robot: &str, stop: Option<u64>, by: &str) -> Answer<StopReply>;
    /// Gets the whole map.
    fn map(&self, robot: &str) -> Answer<MapReply>;
    /// Takes the operator's lease, to drive by hand.
    fn drive(&self, robot: &str, by: &str) -> Answer<Drive>;
}

/// A robot that is driven by hand: it obeys the newest [`Hold`] until this is dropped.
#[derive(Debug)]
pub struct Drive {
    /// Commands, of which the newest counts.
    pub commands: watch::Sender<Option<Hold>>,
    /// Why the drive has ended, once it has.
    pub ended: watch::Receiver<Option<String>>,
}
