//! RemovePassedGoals, RemoveInCollisionGoals, AppendGoalPoseToGoals, GetNextFewGoals, GetCurrentPose, ArePosesNear, CheckPoseOccupancy:
//! queries about goals, and operations on lists of goals.

use zenav_protocol::grid::Occupancy;
use zenav_protocol::messages::GoalPoint;

use super::ports::{flag, goal_on, goal_text, goals_on, goals_value, ground, robot_pose, write};
use super::{SyncLeaf, step};
use crate::context::Context;
use zenav_behaviour_tree::{LeafIo, Status, Value};

/// Nav2's statuses of a waypoint.
const COMPLETED: u64 = 1;
const SKIPPED: u64 = 2;

/// Drops leading goals within `radius` of the robot, but never the last one.
pub struct RemovePassedGoals;

impl SyncLeaf for RemovePassedGoals {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let goals = goals_on(io, ctx, "input_goals")?;
        let (radius, pose) = (io.number_or("radius", 0.5)?, robot_pose(ctx)?);
        let is_passed = |goal: &&GoalPoint| goal.pose().distance(&pose) <= radius;
        let most = goals.len().saturating_sub(1);
        let passed = goals.iter().take(most).take_while(is_passed).count();
        let dropped: Vec<usize> = (0..passed).collect();
        mark(io, &dropped, COMPLETED)?;
        write(io, "output_goals", goals_value(goals.get(passed..).unwrap_or_default()))
    }
}

/// Drops goals where the robot does not fit according to the map.
pub struct RemoveInCollisionGoals;

impl SyncLeaf for RemoveInCollisionGoals {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let goals = goals_on(io, ctx, "input_goals")?;
        if ground(ctx).is_none() {
            return Ok(step(io, ctx, "waiting for the robot and its map"));
        }
        let (mut kept, mut dropped) = (Vec::new(), Vec::new());
        for (index, goal) in goals.iter().enumerate() {
            if fits(io, ctx, goal)? {
                kept.push(*goal);
            } else {
                dropped.push(index);
            }
        }
        mark(io, &dropped, SKIPPED)?;
        write(io, "output_goals", goals_value(&kept))
    }
}

/// SUCCESS if the robot does not fit at `pose` according to the map: the pose is occupied.
pub struct CheckPoseOccupancy;

impl SyncLeaf for CheckPoseOccupancy {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        if ground(ctx).is_none() {
            return Ok(step(io, ctx, "waiting for the robot and its map"));
        }
        let goal = goal_on(io, ctx, "pose")?;
        let free = fits(io, ctx, &goal)?;
        Ok(Status::from_truth(!free))
    }
}

/// Whether the robot fits at a goal: its footprint with `use_footprint`, otherwise its centre. Nav2's `cost_threshold` refers to the cost
/// values of its maps; here every obstacle counts.
fn fits(io: &LeafIo<'_>, ctx: &mut Context, goal: &GoalPoint) -> Result<bool, String> {
    let (model, space) = ground(ctx).ok_or("the robot or its map is not known")?;
    let pose = goal.pose();
    let seen = ctx.map.occupancy(pose.position()).ok_or("there is no map yet")?;
    if flag(io, "consider_unknown_as_obstacle", false) && seen == Occupancy::Unknown {
        return Ok(false);
    }
    if !flag(io, "use_footprint", true) {
        return Ok(seen != Occupancy::Occupied);
    }
    Ok(match goal.yaw {
        Some(_) => space.footprint_clearance(pose) > 0.0,
        // Without a given heading, the robot may choose one.
        None => space.clearance(pose.position()) > model.footprint.inscribed_radius(),
    })
}

/// Marks the waypoints of dropped goals, counted over those neither completed nor skipped, if the tree keeps statuses.
fn mark(io: &mut LeafIo<'_>, dropped: &[usize], status: u64) -> Result<(), String> {
    let Ok(mut statuses) = io.get_data::<Vec<serde_json::Value>>("input_waypoint_statuses") else {
        return Ok(());
    };
    let open = statuses.iter_mut().filter(|waypoint| {
        let now = waypoint.get("waypoint_status").and_then(serde_json::Value::as_u64);
        now.is_none_or(|now| now != COMPLETED && now != SKIPPED)
    });
    for (_, waypoint) in open.enumerate().filter(|(index, _)| dropped.contains(index)) {
        if let Some(fields) = waypoint.as_object_mut() {
            fields.insert("waypoint_status".to_owned(), status.into());
        }
    }
    let value = Value::data(&statuses).map_err(|error| error.to_string());
    write(io, "output_waypoint_statuses", value).map(|_| ())
}

/// Appends a goal to a list.
pub struct AppendGoalPoseToGoals;

impl SyncLeaf for AppendGoalPoseToGoals {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let mut goals = match io.value("input_goals") {
            Ok(_) => goals_on(io, ctx, "input_goals")?,
            Err(_) => Vec::new(),
        };
        goals.push(goal_on(io, ctx, "goal_pose")?);
        write(io, "output_goals", goals_value(&goals))
    }
}

/// The first `num_goals` of a list.
pub struct GetNextFewGoals;

impl SyncLeaf for GetNextFewGoals {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let goals = goals_on(io, ctx, "input_goals")?;
        let count: u64 = io.get("num_goals")?;
        let count = usize::try_from(count).unwrap_or(usize::MAX).min(goals.len());
        write(io, "output_goals", goals_value(goals.get(..count).unwrap_or_default()))
    }
}

/// The robot's pose.
pub struct GetCurrentPose;

impl SyncLeaf for GetCurrentPose {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let pose = GoalPoint::from(robot_pose(ctx)?);
        write(io, "current_pose", Ok(Value::text(goal_text(&pose))))
    }
}

/// SUCCESS if two poses are within `tolerance` of each other; the default of `ref_pose` is the robot's pose.
pub struct ArePosesNear;

impl SyncLeaf for ArePosesNear {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let reference = if io.is_set("ref_pose") {
            goal_on(io, ctx, "ref_pose")?.pose()
        } else {
            robot_pose(ctx)?
        };
        let target = goal_on(io, ctx, "target_pose")?.pose();
        let near = reference.distance(&target) <= io.number_or("tolerance", 0.5)?;
        Ok(Status::from_truth(near))
    }
}
