//! Goals. How are they submitted, listed, cancelled and paused?

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Deserialize;
use serde_json::Value;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    CancelRequest, DrivingProfile, GoalPoint, GoalRequest, GoalsRequest, OnBusy, PauseRequest,
};

use super::App;
use super::error::ApiError;
use super::extract::{JsonBody, Named};
use super::robots::known;

/// Most goals in a list.
const MAX_LISTED: usize = 200;
/// Most waypoints of a goal.
const MAX_WAYPOINTS: usize = 1000;

/// A goal as it is submitted; a field that is none of these is an error, not a slip that nobody sees.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GoalBody {
    id: Option<String>,
    x: Option<f64>,
    y: Option<f64>,
    yaw: Option<f64>,
    place: Option<String>,
    #[serde(default)]
    waypoints: Vec<GoalPoint>,
    tree: Option<String>,
    #[serde(default)]
    blackboard: BTreeMap<String, Value>,
    #[serde(default)]
    on_busy: OnBusy,
    #[serde(default)]
    priority: i32,
    deadline_secs: Option<f64>,
    tolerance: Option<f64>,
    profile: Option<DrivingProfile>,
}

impl GoalBody {
    fn request(self) -> Result<GoalRequest, ApiError> {
        let id = match self.id {
            Some(id) => Id::new(id)
                .map_err(|error| ApiError::bad_request(format!("`id`: {error}")))?
                .into(),
            None => format!("goal-{}", Id::unique()),
        };
        let yaws = self.waypoints.iter().filter_map(|point| point.yaw).chain(self.yaw);
        if let Some(yaw) = yaws.into_iter().find(|yaw| yaw.abs() > TAU) {
            return Err(ApiError::bad_request(format!(
                "`yaw` is {yaw}: expected radians, -6.283 to 6.283 (90° is 1.571)"
            )));
        }
        if self.waypoints.len() > MAX_WAYPOINTS {
            return Err(ApiError::bad_request(format!(
                "`waypoints`: expected at most {MAX_WAYPOINTS}"
            )));
        }
        Ok(GoalRequest {
            id: Some(id),
            x: self.x,
            y: self.y,
            yaw: self.yaw,
            place: self.place,
            waypoints: self.waypoints,
            tree: self.tree,
            blackboard: self.blackboard,
            on_busy: self.on_busy,
            priority: self.priority,
            deadline_secs: self.deadline_secs,
            tolerance: self.tolerance,
            profile: self.profile,
        })
    }
}

/// An id for a request that must not be carried out twice.
fn fresh() -> Option<String> {
    Some(format!("gateway-{}", Id::unique()))
}

pub(super) async fn submit(
    State(shared): App,
    Named([robot]): Named<1>,
    JsonBody(body): JsonBody<GoalBody>,
) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    let reply = shared.operator.submit(&robot, body.request()?).await?;
    Ok(super::json(StatusCode::ACCEPTED, &reply))
}

pub(super) async fn list(State(shared): App, Named([robot]): Named<1>) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    let request = GoalsRequest {
        limit: Some(MAX_LISTED),
        ..GoalsRequest::default()
    };
    let reply = shared.operator.goals(&robot, request).await?;
    Ok(super::json(StatusCode::OK, &reply))
}

pub(super) async fn one(State(shared): App, Named([robot, goal]): Named<2>) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    let request = GoalsRequest {
        id: Some(goal.clone()),
        ..GoalsRequest::default()
    };
    let reply = shared.operator.goals(&robot, request).await?;
    let found = reply.goals.first();
    let found = found.ok_or_else(|| ApiError::not_found(format!("{robot} has no goal `{goal}`")))?;
    Ok(super::json(StatusCode::OK, found))
}

pub(super) async fn cancel(State(shared): App, Named([robot, goal]): Named<2>) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    let request = CancelRequest {
        id: Some(goal),
        request_id: fresh(),
    };
    let reply = shared.operator.cancel(&robot, request).await?;
    Ok(super::json(StatusCode::OK, &reply))
}

pub(super) async fn pause(app: App, named: Named<2>) -> Result<Response, ApiError> {
    set_paused(app, named, false).await
}

pub(super) async fn resume(app: App, named: Named<2>) -> Result<Response, ApiError> {
    set_paused(app, named, true).await
}

async fn set_paused(State(shared): App, Named([robot, goal]): Named<2>, resume: bool) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    let request = PauseRequest {
        id: Some(goal),
        resume,
        request_id: fresh(),
    };
    let reply = shared.operator.pause(&robot, request).await?;
    Ok(super::json(StatusCode::OK, &reply))
}
