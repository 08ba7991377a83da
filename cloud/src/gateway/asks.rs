//! Asks. Each request from a browser runs in its own task, with a deadline, so it completes even after the browser is gone.

use std::sync::Arc;
use std::time::Duration;

use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::sync::Semaphore;
use zenav_gateway::{Answer, AskFailure, Drive, Hub, Operator};
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    AnnotateAction, AnnotateRequest, Annotations, CancelRequest, GoalReply, GoalRequest, GoalsReply, GoalsRequest,
    LocaliseAction, LocaliseReply, LocaliseRequest, MapReply, MapRequest, MoveGoalRequest, PauseRequest, ResumeRequest,
    StopReply, StopRequest,
};
use zenav_protocol::topics::{ANNOTATE, Ask, CANCEL, GOAL, GOALS, LOCALISE, MAP, MOVE_GOAL, PAUSE, RESUME, STOP};

use super::drive;
use crate::operator;

/// Longest wait for an answer.
const ASK_WITHIN: Duration = Duration::from_secs(8);
/// Longest wait for a robot to confirm its stop; the page retries.
const STOP_WITHIN: Duration = Duration::from_secs(3);
/// Most requests in flight; stops do not count.
const MAX_ASKS: usize = 64;

/// Sends requests over the bus.
#[derive(Debug)]
pub(super) struct BusOperator {
    bus: Bus,
    hub: Arc<Hub>,
    room: Arc<Semaphore>,
}

impl BusOperator {
    pub(super) fn new(bus: Bus, hub: Arc<Hub>) -> Self {
        Self {
            bus,
            hub,
            room: Arc::new(Semaphore::new(MAX_ASKS)),
        }
    }

    /// Sends a request unless too many are in flight.
    fn ask<Q, R>(&self, ask: &'static Ask<Q, R>, robot: &str, request: Q) -> Answer<R>
    where
        Q: Serialize + Send + Sync + 'static,
        R: DeserializeOwned + Send + 'static,
    {
        self.admit(|| self.ask_at_once(ask, robot, request, ASK_WITHIN))
    }

    /// Starts a request unless too many are in flight.
    fn admit<R: Send + 'static>(&self, begin: impl FnOnce() -> Answer<R>) -> Answer<R> {
        match Arc::clone(&self.room).try_acquire_owned() {
            Ok(room) => {
                let answer = begin();
                Box::pin(async move {
                    let _room = room;
                    answer.await
                })
            }
            Err(_) => Box::pin(std::future::ready(Err(AskFailure::Unavailable {
                reason: format!("{MAX_ASKS} requests are under way"),
            }))),
        }
    }

    fn ask_at_once<Q, R>(&self, ask: &'static Ask<Q, R>, robot: &str, request: Q, within: Duration) -> Answer<R>
    where
        Q: Serialize + Send + Sync + 'static,
        R: DeserializeOwned + Send + 'static,
    {
        let (bus, robot) = (self.bus.clone(), robot.to_owned());
        spawned(async move { bus.ask(ask, &[&robot], &request, within).await })
    }
}

/// Runs a request in its own task.
fn spawned<R: Send + 'static>(asking: impl Future<Output = Result<R, AskError>> + Send + 'static) -> Answer<R> {
    let task = tokio::spawn(asking);
    Box::pin(async move {
        match task.await {
            Ok(answer) => answer.map_err(failure),
            Err(error) => Err(AskFailure::Unavailable {
                reason: error.to_string(),
            }),
        }
    })
}

/// Changes the annotations under the lease in force; a driving robot keeps driving.
async fn annotate(bus: Bus, robot: String, action: AnnotateAction) -> Result<Annotations, AskError> {
    let is_read = action == AnnotateAction::Get;
    let request = AnnotateRequest {
        action,
        request_id: Some(format!("annotate-{}", Id::unique())),
        epoch: None,
    };
    if is_read {
        return bus.ask(&ANNOTATE, &[&robot], &request, ASK_WITHIN).await;
    }
    let (bus, robot) = (&bus, robot.as_str());
    let ask = |epoch| {
        let request = AnnotateRequest {
            epoch,
            ..request.clone()
        };
        async move { bus.ask(&ANNOTATE, &[robot], &request, ASK_WITHIN).await }
    };
    operator::in_force(bus, robot, ASK_WITHIN, ask).await
}

/// Sets the robot's pose under a temporary operator lease, so that the robot stands still meanwhile.
async fn set_pose(bus: Bus, robot: String, pose: Pose2, by: String) -> Result<LocaliseReply, AskError> {
    let (bus, robot) = (&bus, robot.as_str());
    let ask = |epoch| async move {
        let request = LocaliseRequest {
            action: LocaliseAction::At,
            pose: Some(pose),
            epoch,
        };
        bus.ask(&LOCALISE, &[robot], &request, ASK_WITHIN).await
    };
    operator::at_rest(bus, robot, &by, ASK_WITHIN, ask).await
}

/// Translates a bus error for a browser.
pub(super) fn failure(error: AskError) -> AskFailure {
    match error {
        AskError::Refused(refusal) => AskFailure::Refused(refusal),
        AskError::Timeout { key } => AskFailure::Timeout { key },
        other => AskFailure::Unavailable {
            reason: other.to_string(),
        },
    }
}

impl Operator for BusOperator {
    fn submit(&self, robot: &str, goal: GoalRequest) -> Answer<GoalReply> {
        self.ask(&GOAL, robot, goal)
    }

    fn cancel(&self, robot: &str, request: CancelRequest) -> Answer<GoalReply> {
        self.ask(&CANCEL, robot, request)
    }

    fn pause(&self, robot: &str, request: PauseRequest) -> Answer<GoalReply> {
        self.ask(&PAUSE, robot, request)
    }

    fn goals(&self, robot: &str, request: GoalsRequest) -> Answer<GoalsReply> {
        self.ask(&GOALS, robot, request)
    }

    fn move_goal(&self, robot: &str, request: MoveGoalRequest) -> Answer<GoalReply> {
        self.ask(&MOVE_GOAL, robot, request)
    }

    fn annotate(&self, robot: &str, action: AnnotateAction) -> Answer<Annotations> {
        let (bus, robot) = (self.bus.clone(), robot.to_owned());
        self.admit(|| spawned(annotate(bus, robot, action)))
    }

    fn set_pose(&self, robot: &str, pose: Pose2, by: &str) -> Answer<LocaliseReply> {
        let (bus, robot, by) = (self.bus.clone(), robot.to_owned(), by.to_owned());
        self.admit(|| spawned(set_pose(bus, robot, pose, by)))
    }

    fn stop(&self, robot: &str, by: &str) -> Answer<StopReply> {
        self.ask_at_once(&STOP, robot, StopRequest::new(by), STOP_WITHIN)
    }

    fn resume(&self, robot: &str, request: ResumeRequest) -> Answer<StopReply> {
        self.ask(&RESUME, robot, request)
    }

    fn map(&self, robot: &str) -> Answer<MapReply> {
        self.ask(&MAP, robot, MapRequest::default())
    }

    fn drive(&self, robot: &str, by: &str) -> Answer<Drive> {
        let (bus, hub) = (self.bus.clone(), Arc::clone(&self.hub));
        let (robot, by) = (robot.to_owned(), by.to_owned());
        Box::pin(async move { drive::begin(bus, hub, robot, by).await })
    }
}
