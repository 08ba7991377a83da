//! Robots. Which robots are there, what is their state, and how are they stopped?

use std::time::Duration;

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use serde_json::{Value, json};
use tokio::task::JoinSet;
use zenav_protocol::messages::ResumeRequest;

use super::error::ApiError;
use super::extract::Named;
use super::{App, Shared, json_text};

/// Name under which the gateway stops and resumes robots.
pub(super) const BY: &str = "gateway";
/// Silence after which a robot no longer counts as present, s.
const SILENT: f64 = 3.0;
/// Longest wait for a robot's state after a stop, s, and how often it is looked for.
const STATE_WITHIN: f64 = 1.0;
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// Checks that there is a robot of this name.
pub(super) fn known(shared: &Shared, robot: &str) -> Result<(), ApiError> {
    let view = shared.hub.view();
    if view.knows(robot) {
        return Ok(());
    }
    let names: Vec<&str> = view.robots().take(20).collect();
    let there = if names.is_empty() {
        "no robot shows here".to_owned()
    } else {
        format!("there is {}", names.join(", "))
    };
    Err(ApiError::not_found(format!("no robot `{robot}`: {there}")))
}

pub(super) async fn health(State(shared): App) -> Response {
    let hub = &shared.hub;
    super::json(
        StatusCode::OK,
        &json!({
            "version": env!("CARGO_PKG_VERSION"), "connected": hub.is_connected(), "clients": hub.clients(),
            "robots": hub.view().robots().count(),
        }),
    )
}

pub(super) async fn places(State(shared): App) -> Response {
    super::json(StatusCode::OK, shared.hub.places())
}

pub(super) async fn list(State(shared): App) -> Response {
    let (now, view) = (shared.hub.now(), shared.hub.view());
    let row = |robot: &str| {
        let channel = |name: &str| {
            let (text, age) = view.channel(robot, name, now)?;
            Some((serde_json::from_str::<Value>(text).ok()?, age))
        };
        let state = channel("state");
        let of_state = |field: &str| state.as_ref().map(|(state, _)| state[field].clone());
        let age = state.as_ref().map(|(_, age)| *age);
        json!({
            "robot": robot, "age": age, "present": age.is_some_and(|age| age < SILENT),
            "mode": of_state("mode"), "link": of_state("link"), "battery": of_state("battery"), "guard": of_state("guard"),
            "pose": channel("pose").map(|(pose, _)| pose), "parts": channel("parts").map(|(parts, _)| parts),
        })
    };
    let rows: Vec<Value> = view.robots().map(row).collect();
    drop(view);
    super::json(StatusCode::OK, &json!({ "robots": rows }))
}

pub(super) async fn one(State(shared): App, Named([robot]): Named<1>) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    let text = shared.hub.view().robot_json(&robot, shared.hub.now());
    Ok(json_text(StatusCode::OK, text.unwrap_or_else(|| "{}".to_owned())))
}

pub(super) async fn events(State(shared): App, Named([robot]): Named<1>) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    let events = shared.hub.view().events(&robot).collect::<Vec<_>>().join(",");
    Ok(json_text(StatusCode::OK, format!("{{\"events\":[{events}]}}")))
}

pub(super) async fn map(State(shared): App, Named([robot]): Named<1>) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    let map = shared.operator.map(&robot).await?;
    Ok(super::json(StatusCode::OK, &map))
}

pub(super) async fn stop(State(shared): App, Named([robot]): Named<1>) -> Result<Response, ApiError> {
    // Not looked up first: a robot may receive a stop even if it was not heard recently.
    match shared.operator.stop(&robot, BY).await {
        Ok(reply) => {
            shared.hub.view().forget_stops(&robot);
            Ok(super::json(StatusCode::OK, &reply))
        }
        Err(failure) => {
            known(&shared, &robot)?;
            Err(failure.into())
        }
    }
}

pub(super) async fn resume(State(shared): App, Named([robot]): Named<1>) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    let (boot_id, stops) = reported_stops(&shared, &robot).await?;
    let reply = shared
        .operator
        .resume(&robot, ResumeRequest::new(BY, boot_id, stops))
        .await?;
    Ok(super::json(StatusCode::OK, &reply))
}

/// The robot's boot and its number of stops, as reported since this gateway last stopped it.
async fn reported_stops(shared: &Shared, robot: &str) -> Result<(String, u64), ApiError> {
    let end = shared.hub.now() + STATE_WITHIN;
    loop {
        if let Some(stops) = shared.hub.view().stops(robot) {
            return Ok(stops);
        }
        if shared.hub.now() >= end {
            let reason =
                format!("{robot} has not reported its state since it was stopped: look at it, and resume it again");
            return Err(ApiError::new(StatusCode::SERVICE_UNAVAILABLE, "Unavailable", reason));
        }
        tokio::time::sleep(LOOK_AGAIN).await;
    }
}

pub(super) async fn stop_all(State(shared): App) -> Response {
    let robots: Vec<String> = shared.hub.view().robots().map(str::to_owned).collect();
    let mut asking = JoinSet::new();
    for robot in robots {
        let answer = shared.operator.stop(&robot, BY);
        asking.spawn(async move { (robot, answer.await) });
    }
    let mut rows = Vec::new();
    while let Some(answered) = asking.join_next().await {
        rows.push(match answered {
            Ok((robot, Ok(reply))) => {
                shared.hub.view().forget_stops(&robot);
                json!({ "robot": robot, "stopped": reply.stopped })
            }
            Ok((robot, Err(error))) => json!({ "robot": robot, "stopped": false, "reason": error.to_string() }),
            Err(error) => json!({ "stopped": false, "reason": error.to_string() }),
        });
    }
    rows.sort_by(|a, b| a["robot"].as_str().cmp(&b["robot"].as_str()));
    let failure = if !rows.iter().all(|row| row["stopped"] == true) {
        Some((
            StatusCode::GATEWAY_TIMEOUT,
            "Timeout",
            "not every robot confirmed its stop",
        ))
    } else if rows.is_empty() {
        let reason = "no robot is known to this gateway: nothing was stopped";
        Some((StatusCode::SERVICE_UNAVAILABLE, "Unavailable", reason))
    } else if !shared.hub.is_connected() {
        let reason = "the gateway does not reach the router: there may be robots that it does not know";
        Some((StatusCode::SERVICE_UNAVAILABLE, "Unavailable", reason))
    } else {
        None
    };
    let mut body = json!({ "robots": rows });
    let Some((status, error, reason)) = failure else {
        return super::json(StatusCode::OK, &body);
    };
    body["error"] = error.into();
    body["reason"] = reason.into();
    super::json(status, &body)
}
