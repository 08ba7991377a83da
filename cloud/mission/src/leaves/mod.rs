//! Leaves. What can a tree do with a robot? One file per family of leaves; a leaf acts on the [`Context`].
//!
//! A module of its own, because what it makes public is the language of the leaves' ports: how a goal, a list of goals and a path are written
//! in a tree.
//!
//! | file | leaves |
//! |---|---|
//! | `ports`, `path` | how goals, lists of goals and paths are written in a tree; geometry of a path |
//! | `compute_path` | ComputePathToPose, ComputePathThroughPoses |
//! | `smooth_path` | SmoothPath |
//! | `follow_path`, `tracking` | FollowPath, and the robot's position on its path |
//! | `follow_waypoints` | FollowWaypoints |
//! | `mapping` | DoesMapExist, MapEnvironment, SaveMap and other actions on a map |
//! | `localisation` | ReinitializeGlobalLocalization, IsLocalised, WaitForLocalisation |
//! | `behaviours` | Spin, BackUp, DriveOnHeading, DriveToFree |
//! | `simple` | Wait, GoalReached, IsBatteryLow |
//! | `conditions` | DistanceTraveled, IsStuck, CheckStopStatus, TransformAvailable |
//! | `path_leaves` | ValidatePath, IsGoalNearby, TruncatePath, TruncatePathLocal, GetPoseFromPath, ConcatenatePaths, … |
//! | `goal_leaves` | RemovePassedGoals, RemoveInCollisionGoals, AppendGoalPoseToGoals, GetNextFewGoals, ArePosesNear, … |
//! | `selectors` | PlannerSelector, ControllerSelector, … |
//! | `services` | ClearEntireCostmap, CancelControl, …, ToggleCollisionMonitor |
//! | `remote` | RemoteAction: an action of another program |
//! | `navigate` | NavigateToPose, NavigateThroughPoses |
//! | `missing` | DockRobot, ComputeRoute, …: nodes without a counterpart in this stack |
//!
//! Names and ports are Nav2's where Nav2 has the node, so that every Nav2 tree loads. A node that this stack cannot serve fails when ticked
//! and names what is missing.

#[cfg(test)]
mod backwards;
mod behaviours;
mod compute_path;
mod conditions;
mod follow_path;
mod follow_waypoints;
mod goal_leaves;
mod localisation;
mod mapping;
mod missing;
mod navigate;
pub(crate) mod path;
mod path_leaves;
mod ports;
mod progress;
mod remote;
mod selectors;
#[cfg(test)]
mod semantics;
mod services;
mod simple;
mod smooth_path;
mod tracking;

use serde::Serialize;

use super::context::Context;
use zenav_behaviour_tree::nav2::{self, Measure, Travel};
use zenav_behaviour_tree::{DuplicateNode, Leaf, LeafIo, LeafSite, NodeSpec, PortType, Registry, Status, Value};
use zenav_protocol::messages::GoalPhase;

pub use path::DrivenPath;
pub use ports::{Places, goal_text, goals_value, parse_goal, parse_goals, parse_path, parse_points};

/// The nodes available to a mission's trees: BehaviorTree.CPP's, Nav2's and this stack's.
#[must_use]
pub(crate) fn registry() -> Registry<Context> {
    let mut registry = nav2::registry();
    if let Err(duplicate) = fill(&mut registry) {
        // Ids are constants: a duplicate is an error in the table below, which a test catches.
        tracing::error!(%duplicate, "two leaves of one name");
    }
    registry
}

fn fill(registry: &mut Registry<Context>) -> Result<(), DuplicateNode> {
    use PortType::{Double, Text, Unsigned};
    let declared: Vec<NodeSpec> = registry.declared().cloned().collect();
    let known = |id: &str, doc: &str| {
        let spec = declared.iter().find(|spec| spec.id == id).cloned();
        NodeSpec {
            doc: doc.to_owned(),
            ..spec.unwrap_or_else(|| NodeSpec::action(id, ""))
        }
    };
    registry.leaf(
        known("ComputePathToPose", "Plans and smooths a path to the goal."),
        leaf::<compute_path::ComputePath>,
    )?;
    registry.leaf(
        known(
            "FollowPath",
            "Follows a path: rechecks and renews the plan, replans when it is blocked.",
        ),
        leaf::<follow_path::FollowPath>,
    )?;
    registry.leaf(
        NodeSpec::action(
            "FollowWaypoints",
            "Follows waypoints by the waypoint law; needs no map.",
        )
        .input("waypoints", Text, "waypoints `x;y|x;y|…`, m, map frame")
        .input_or("laps", Unsigned, "1", "repetitions")
        .output("error_code_id", Unsigned, "error code; 0: none")
        .output("error_msg", Text, "error message"),
        leaf::<follow_waypoints::FollowWaypoints>,
    )?;
    registry.leaf(
        NodeSpec::action("DoesMapExist", "SUCCESS if a map is stored."),
        leaf::<mapping::DoesMapExist>,
    )?;
    registry.leaf(
        NodeSpec::action("MapEnvironment", "Starts a new map; RUNNING until it is halted."),
        leaf::<mapping::MapEnvironment>,
    )?;
    registry.leaf(NodeSpec::action("SaveMap", "Stores the map."), |_| {
        Box::new(mapping::OnMap::save())
    })?;
    registry.leaf(known("Wait", "Waits, s."), leaf::<simple::Wait>)?;
    registry.leaf(
        known("GoalReached", "SUCCESS within the tolerance of the goal.").input_optional(
            "tolerance",
            Double,
            "m; default: the goal's own",
        ),
        |_| Box::new(simple::GoalReached),
    )?;
    registry.leaf(known("IsBatteryLow", "SUCCESS below a share of the charge."), |_| {
        Box::new(simple::IsBatteryLow)
    })?;
    registry.leaf(known("Spin", "Turns in place."), leaf::<behaviours::Behaviour>)?;
    registry.leaf(known("BackUp", "Drives straight back."), leaf::<behaviours::Behaviour>)?;
    registry.leaf(
        known("DriveOnHeading", "Drives straight ahead."),
        leaf::<behaviours::Behaviour>,
    )?;
    registry.leaf(
        NodeSpec::action(
            "DriveToFree",
            "Drives to the nearest place with a clearance from everything seen.",
        )
        .input_or("clearance", Double, "0.1", "clearance of the footprint there, m")
        .input_or("within", Double, "1.0", "search radius, m")
        .input_or("time_allowance", Double, "10.0", "time allowance, s")
        .output("error_code_id", Unsigned, "error code; 0: none")
        .output("error_msg", Text, "error message"),
        leaf::<behaviours::Behaviour>,
    )?;
    registry.leaf(
        NodeSpec::condition("IsLocalised", "SUCCESS unless the robot is known to be lost."),
        |_| Box::new(localisation::IsLocalised),
    )?;
    registry.leaf(
        NodeSpec::action("WaitForLocalisation", "Waits until the robot knows where it is.").input_or(
            "time_allowance",
            Double,
            "5.0",
            "time allowance, s",
        ),
        leaf::<localisation::WaitForLocalisation>,
    )?;
    registry.leaf(remote::spec(), leaf::<remote::Remote>)?;
    let rest: Vec<NodeSpec> = registry
        .declared()
        .filter(|spec| spec.category.is_leaf())
        .cloned()
        .collect();
    for spec in rest {
        registry.leaf(spec, nav2_leaf)?;
    }
    Ok(())
}

/// A new leaf of a type.
fn leaf<T: Leaf<Context> + Default + 'static>(_: LeafSite<'_>) -> Box<dyn Leaf<Context>> {
    Box::<T>::default()
}

/// The leaf that implements one of Nav2's nodes.
fn nav2_leaf(site: LeafSite<'_>) -> Box<dyn Leaf<Context>> {
    fn sync<T: SyncLeaf + 'static>(leaf: T) -> Box<dyn Leaf<Context>> {
        Box::new(Sync(leaf))
    }
    if let Some(choice) = selectors::Choice::of_selector(site.id) {
        return sync(selectors::Selector(choice));
    }
    if let Some(id) = services::canceled_by(site.id) {
        return sync(services::Cancel(id));
    }
    match site.id {
        "ComputePathThroughPoses" => Box::<compute_path::ComputePath>::default(),
        "ReinitializeGlobalLocalization" => Box::<localisation::Reinitialize>::default(),
        "SmoothPath" => Box::<smooth_path::SmoothPath>::default(),
        "NavigateToPose" | "NavigateThroughPoses" => Box::<navigate::Navigate>::default(),
        // The node's name up to Nav2 Kilted.
        "ValidatePath" | "IsPathValid" => sync(path_leaves::ValidatePath),
        "IsGoalNearby" => sync(path_leaves::IsGoalNearby::default()),
        "TruncatePath" => sync(path_leaves::TruncatePath),
        "TruncatePathLocal" => sync(path_leaves::TruncatePathLocal::default()),
        "GetPoseFromPath" => sync(path_leaves::GetPoseFromPath),
        "ConcatenatePaths" => sync(path_leaves::ConcatenatePaths),
        "IsWithinPathTrackingBounds" => sync(path_leaves::IsWithinPathTrackingBounds),
        "RemovePassedGoals" => sync(goal_leaves::RemovePassedGoals),
        "RemoveInCollisionGoals" => sync(goal_leaves::RemoveInCollisionGoals),
        "AppendGoalPoseToGoals" => sync(goal_leaves::AppendGoalPoseToGoals),
        "GetNextFewGoals" => sync(goal_leaves::GetNextFewGoals),
        "GetCurrentPose" => sync(goal_leaves::GetCurrentPose),
        "ArePosesNear" => sync(goal_leaves::ArePosesNear),
        "CheckPoseOccupancy" => sync(goal_leaves::CheckPoseOccupancy),
        "DistanceTraveled" => sync(conditions::DistanceTraveled::default()),
        "IsStuck" => sync(conditions::IsStuck),
        "TransformAvailable" => sync(conditions::TransformAvailable),
        "CheckStopStatus" => Box::<conditions::CheckStopStatus>::default(),
        "ToggleCollisionMonitor" => sync(services::ToggleCollisionMonitor),
        "ClearEntireCostmap" | "ClearCostmapExceptRegion" | "ClearCostmapAroundRobot" | "ClearCostmapAroundPose" => {
            Box::<services::ClearCostmap>::default()
        }
        _ => Box::new(missing::Missing),
    }
}

/// A synchronous leaf (BehaviorTree.CPP's `SyncActionNode`): it finishes in the tick that starts it. An error is a failure.
trait SyncLeaf: Send {
    /// Its status, or why it fails.
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String>;
}

/// A [`SyncLeaf`] as a leaf.
struct Sync<T>(T);

impl<T: SyncLeaf> Leaf<Context> for Sync<T> {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        match self.0.answer(io, ctx) {
            Ok(status) => status,
            Err(why) => fail(io, ctx, None, why),
        }
    }
}

impl Travel for Context {
    fn position(&self) -> Option<[f64; 2]> {
        self.robot.pose().map(|pose| [pose.x, pose.y])
    }

    fn speed(&self) -> f64 {
        self.robot.velocity().v.abs()
    }

    fn measure(&self, path: &Value) -> Option<Measure> {
        let data = parse_path(path).ok()?;
        let pose = self.robot.pose()?;
        let length = path::length(&data.points);
        let near = path::nearest(&data.points, pose.position(), 0.0, f64::INFINITY)?;
        Some(Measure {
            end: [data.goal.x, data.goal.y],
            length,
            left: length - near.along,
        })
    }
}

/// Fails with Nav2's error code and a reason that the goal's end reports.
fn fail(io: &mut LeafIo<'_>, ctx: &mut Context, code: Option<i64>, why: impl Into<String>) -> Status {
    let why = why.into();
    if let Some(code) = code {
        // A tree with other types of entries on these ports gets no code; the reason is in the feedback.
        let _ = io.set("error_code_id", code);
        let _ = io.set("error_msg", why.as_str());
    }
    ctx.goal.failure = Some(format!("{}: {why}", io.name()));
    io.fail(why)
}

/// Ends the drive, and fails.
fn abort(io: &mut LeafIo<'_>, ctx: &mut Context, code: i64, why: String) -> Status {
    ctx.end_leg(GoalPhase::Aborted, Some(why.clone()));
    fail(io, ctx, Some(code), why)
}

/// Stores what must survive a restart. A leaf that cannot store it starts over after one.
fn remember(io: &mut LeafIo<'_>, memory: &impl Serialize) {
    if let Err(error) = io.remember(memory) {
        tracing::warn!(node = io.name(), %error, "the node's state cannot be serialised");
    }
}

/// Clears the error ports.
fn no_error(io: &mut LeafIo<'_>) {
    let _ = io.set("error_code_id", 0_i64);
    let _ = io.set("error_msg", "");
}

/// `Running`, with a description of what the node does as its feedback and the goal's.
fn step(io: &mut LeafIo<'_>, ctx: &mut Context, what: &str) -> Status {
    io.say(what);
    let said = format!("{}: {what}", io.name());
    if ctx.goal.feedback.step != said {
        tracing::debug!(goal = ctx.goal.id, now = ctx.now.as_secs(), "{said}");
        ctx.goal.feedback.step = said;
    }
    Status::Running
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_leaf_has_a_name_of_its_own() {
        fill(&mut nav2::registry()).unwrap();
    }
}
