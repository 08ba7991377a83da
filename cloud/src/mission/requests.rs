//! Requests. Where do requests of clients and of other missions arrive, and how is each answered?

use zenav_protocol::bus::{Bus, BusError, Request as Query, Server};
use zenav_protocol::messages::*;
use zenav_protocol::topics;

use zenav_mission::io::{Request, Response};

/// The servers of a mission's keys.
pub(super) struct RequestServers {
    goal: Server<GoalRequest, GoalReply>,
    cancel: Server<CancelRequest, GoalReply>,
    pause: Server<PauseRequest, GoalReply>,
    goals: Server<GoalsRequest, GoalsReply>,
    info: Server<InfoRequest, InfoReply>,
    join: Server<JoinRequest, JoinReply>,
}

/// A request that waits for its answer.
pub(super) enum Pending {
    Goal(Query<GoalRequest, GoalReply>),
    Cancel(Query<CancelRequest, GoalReply>),
    Pause(Query<PauseRequest, GoalReply>),
    Goals(Query<GoalsRequest, GoalsReply>),
    Info(Query<InfoRequest, InfoReply>),
    Join(Query<JoinRequest, JoinReply>),
}

impl RequestServers {
    /// Serves a robot's keys.
    pub(super) fn open(bus: &Bus, robot: &str) -> Result<Self, BusError> {
        let name = [robot];
        Ok(Self {
            goal: bus.serve(&topics::GOAL, &name)?,
            cancel: bus.serve(&topics::CANCEL, &name)?,
            pause: bus.serve(&topics::PAUSE, &name)?,
            goals: bus.serve(&topics::GOALS, &name)?,
            info: bus.serve(&topics::CLOUD_INFO, &name)?,
            join: bus.serve(&topics::JOIN, &name)?,
        })
    }

    /// The next request; `None` when the bus was closed.
    pub(super) async fn next(&mut self) -> Option<Pending> {
        tokio::select! {
            request = self.goal.next() => request.map(Pending::Goal),
            request = self.cancel.next() => request.map(Pending::Cancel),
            request = self.pause.next() => request.map(Pending::Pause),
            request = self.goals.next() => request.map(Pending::Goals),
            request = self.info.next() => request.map(Pending::Info),
            request = self.join.next() => request.map(Pending::Join),
        }
    }
}

impl Pending {
    pub(super) fn request(&self) -> Request {
        match self {
            Self::Goal(query) => Request::Goal(Box::new(query.body.clone())),
            Self::Cancel(query) => Request::Cancel(query.body.clone()),
            Self::Pause(query) => Request::Pause(query.body.clone()),
            Self::Goals(query) => Request::Goals(query.body.clone()),
            Self::Info(query) => Request::Info(query.body.clone()),
            Self::Join(query) => Request::Join(query.body.clone()),
        }
    }

    pub(super) fn answer(self, answer: Result<Response, Refusal>) {
        match (self, answer) {
            (Self::Goal(query), Ok(Response::Goal(reply))) => query.reply(&reply),
            (Self::Cancel(query), Ok(Response::Goal(reply))) => query.reply(&reply),
            (Self::Pause(query), Ok(Response::Goal(reply))) => query.reply(&reply),
            (Self::Goals(query), Ok(Response::Goals(reply))) => query.reply(&reply),
            (Self::Info(query), Ok(Response::Info(reply))) => query.reply(&reply),
            (Self::Join(query), Ok(Response::Join(reply))) => query.reply(&reply),
            (pending, answer) => {
                let refusal = answer.err().unwrap_or_else(|| Refusal::Internal {
                    reason: "an answer of another kind".to_owned(),
                });
                match pending {
                    Self::Goal(query) => query.refuse(&refusal),
                    Self::Cancel(query) => query.refuse(&refusal),
                    Self::Pause(query) => query.refuse(&refusal),
                    Self::Goals(query) => query.refuse(&refusal),
                    Self::Info(query) => query.refuse(&refusal),
                    Self::Join(query) => query.refuse(&refusal),
                }
            }
        }
    }
}
