//! Annotations. How are places and zones added to a robot's map, and how is the robot's pose set?

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use nalgebra::Point2;
use serde::Deserialize;
use serde_json::json;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{AnnotateAction, Annotations, GoalPoint, Zone, ZoneRule};

use super::error::ApiError;
use super::extract::{JsonBody, Named, RobotAnd};
use super::goals::in_radians;
use super::robots::{BY, known};
use super::{App, Shared};

/// A place on the map.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlaceBody {
    x: f64,
    y: f64,
    #[serde(default)]
    yaw: Option<f64>,
}

/// The robot's pose.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PoseBody {
    x: f64,
    y: f64,
    yaw: f64,
}

/// A zone; its name is in the URL path.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ZoneBody {
    rule: ZoneRule,
    points: Vec<[f64; 2]>,
}

pub(super) async fn set_pose(
    State(shared): App,
    Named([robot]): Named<1>,
    JsonBody(PoseBody { x, y, yaw }): JsonBody<PoseBody>,
) -> Result<Response, ApiError> {
    known(&shared, &robot)?;
    in_radians(yaw)?;
    let reply = shared.operator.set_pose(&robot, Pose2::new(x, y, yaw), BY).await?;
    Ok(super::json(StatusCode::OK, &reply))
}

async fn annotate(shared: &Shared, robot: &str, action: AnnotateAction) -> Result<Annotations, ApiError> {
    known(shared, robot)?;
    Ok(shared.operator.annotate(robot, action).await?)
}

/// Carries out a change; the reply contains all annotations after it.
async fn change(shared: &Shared, robot: &str, action: AnnotateAction) -> Result<Response, ApiError> {
    let annotations = annotate(shared, robot, action).await?;
    Ok(super::json(StatusCode::OK, &annotations))
}

pub(super) async fn places(State(shared): App, Named([robot]): Named<1>) -> Result<Response, ApiError> {
    let annotations = annotate(&shared, &robot, AnnotateAction::Get).await?;
    Ok(super::json(StatusCode::OK, &json!({ "places": annotations.places })))
}

pub(super) async fn put_place(
    State(shared): App,
    RobotAnd(robot, name): RobotAnd,
    JsonBody(PlaceBody { x, y, yaw }): JsonBody<PlaceBody>,
) -> Result<Response, ApiError> {
    let at = GoalPoint { x, y, yaw };
    change(&shared, &robot, AnnotateAction::AddPlace { name, at }).await
}

pub(super) async fn delete_place(State(shared): App, RobotAnd(robot, name): RobotAnd) -> Result<Response, ApiError> {
    change(&shared, &robot, AnnotateAction::RemovePlace { name }).await
}

pub(super) async fn zones(State(shared): App, Named([robot]): Named<1>) -> Result<Response, ApiError> {
    let annotations = annotate(&shared, &robot, AnnotateAction::Get).await?;
    Ok(super::json(StatusCode::OK, &json!({ "zones": annotations.zones })))
}

pub(super) async fn put_zone(
    State(shared): App,
    RobotAnd(robot, name): RobotAnd,
    JsonBody(ZoneBody { rule, points }): JsonBody<ZoneBody>,
) -> Result<Response, ApiError> {
    let points = points.into_iter().map(Point2::from).collect();
    let zone = Zone { name, rule, points };
    change(&shared, &robot, AnnotateAction::AddZone { zone }).await
}

pub(super) async fn delete_zone(State(shared): App, RobotAnd(robot, name): RobotAnd) -> Result<Response, ApiError> {
    change(&shared, &robot, AnnotateAction::RemoveZone { name }).await
}
