//! Asks. How does what people want reach the robots? Each ask in a task of its own, with a deadline, so that it goes on when the browser that
//! made it is gone.

use std::sync::Arc;
use std::time::Duration;

use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::sync::Semaphore;
use zenav_gateway::{Answer, AskFailure, Drive, Hub, Operator};
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{
    CancelRequest, GoalReply, GoalRequest, GoalsReply, GoalsRequest, MapReply, MapRequest, PauseRequest, ResumeRequest,
    StopReply, StopRequest,
};
use zenav_protocol::topics::{Ask, CANCEL, GOAL, GOALS, MAP, PAUSE, RESUME, STOP};

use super::drive;

/// Longest wait for an answer.
const ASK_WITHIN: Duration = Duration::from_secs(8);
/// Longest wait for a robot to confirm its stop: the page tries again.
const STOP_WITHIN: Duration = Duration::from_secs(3);
/// Most asks under way at the same time; a stop is not counted.
const MAX_ASKS: usize = 64;

/// Asks over the bus.
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

    /// Asks, unless too much is asked already.
    fn ask<Q, R>(&self, ask: &'static Ask<Q, R>, robot: &str, request: Q) -> Answer<R>
    where
        Q: Serialize + Send + Sync + 'static,
        R: DeserializeOwned + Send + 'static,
    {
        match Arc::clone(&self.room).try_acquire_owned() {
            Ok(room) => {
                let answer = self.ask_at_once(ask, robot, request, ASK_WITHIN);
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
        let task = tokio::spawn(async move { bus.ask(ask, &[&robot], &request, within).await });
        Box::pin(async move {
            match task.await {
                Ok(answer) => answer.map_err(failure),
                Err(error) => Err(AskFailure::Unavailable {
                    reason: error.to_string(),
                }),
            }
        })
    }
}

/// What an error of the bus is to a browser.
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

    fn stop(&self, robot: &str, by: &str) -> Answer<StopReply> {
        let by = Some(by.to_owned());
        self.ask_at_once(&STOP, robot, StopRequest { by }, STOP_WITHIN)
    }

    fn resume(&self, robot: &str, by: &str) -> Answer<StopReply> {
        let by = Some(by.to_owned());
        self.ask(&RESUME, robot, ResumeRequest { by })
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
