//! Goals. How are they submitted, listed, cancelled and paused?

use std::collections::BTreeMap;

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use serde_json::Value;
use zenav_protocol::config_text::Expected;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    CancelRequest, DrivingProfile, GoalPoint, GoalRequest, GoalsRequest, MoveGoalRequest, OnBusy, PauseRequest,
};

use super::App;
use super::error::ApiError;
use super::extract::{JsonBody, Named};
use super::robots::known;

/// Most goals in a list.
const MAX_LISTED: usize = 200;

/// A submitted goal.
#[derive(Debug, Deserialize)]
#[serde(transparent)]
pub(super) struct GoalBody(#[serde(with = "GoalFields")] GoalRequest);

/// The goal's fields; an unknown one is an error, so that typing mistakes do not pass unnoticed.
#[derive(Deserialize)]
#[serde(remote = "GoalRequest", deny_unknown_fields)]
struct GoalFields {
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
    #[serde(default, deserialize_with = "whole")]
    priority: i32,
    deadline_secs: Option<f64>,
    tolerance: Option<f64>,
    profile: Option<DrivingProfile>,
}

/// Accepts a whole number in any notation: JSON has no integers.
fn whole<'de, D: Deserializer<'de>>(from: D) -> Result<i32, D::Error> {
    let number = f64::deserialize(from)?;
    if number.fract() == 0.0 && (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&number) {
        Ok(number as i32)
    } else {
        Err(D::Error::custom(format_args!(
            "`priority` is {number}: expected a whole number of 32 bits"
        )))
    }
}

impl GoalBody {
    fn request(self) -> Result<GoalRequest, ApiError> {
        let mut goal = self.0;
        let id = match goal.id {
            Some(id) => Id::new(id)
                .map_err(|error| ApiError::bad_request(format!("`id`: {error}")))?
                .into(),
            None => format!("goal-{}", Id::unique()),
        };
        goal.id = Some(id);
        let mut yaws = goal.waypoints.iter().filter_map(|point| point.yaw).chain(goal.yaw);
        yaws.try_for_each(in_radians)?;
        if goal.waypoints.len() > GoalRequest::MAX_WAYPOINTS {
            return Err(ApiError::bad_request(format!(
                "`waypoints`: expected at most {}",
                GoalRequest::MAX_WAYPOINTS
            )));
        }
        Ok(goal)
    }
}

/// A heading in degrees is probably a mistake.
pub(super) fn in_radians(yaw: f64) -> Result<(), ApiError> {
    let checked = Expected::Angle.check(yaw).map(drop);
    checked.map_err(|why| ApiError::bad_request(format!("`yaw` is {why}")))
}

/// New position of a goal in the queue.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MoveBody {
    #[serde(default)]
    before: Option<String>,
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

pub(super) async fn move_in_queue(
    State(shared): App,
    Named([robot, goal]): Named<2>,
    JsonBody(MoveBody { before }): JsonBody<MoveBody>,
) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    let request = MoveGoalRequest {
        id: goal,
        before,
        request_id: fresh(),
    };
    let reply = shared.operator.move_goal(&robot, request).await?;
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
