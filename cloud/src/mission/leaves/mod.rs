//! What can a tree do with a robot? One file a family of leaves; what a leaf acts on is the [`Context`].
//!
//! | file | leaves |
//! |---|---|
//! | `ports` | how goals and lists of waypoints are written in a tree |
//! | `compute_path` | ComputePathToPose |
//! | `follow_path` | FollowPath |
//! | `follow_waypoints` | FollowWaypoints |
//! | `mapping` | DoesMapExist, MapEnvironment, SaveMap |
//! | `behaviours` | Spin, BackUp, DriveOnHeading |
//! | `simple` | Wait, GoalReached, IsBatteryLow |
//!
//! Names and ports are Nav2's where Nav2 has the node. Nav2's other nodes can stand in a tree too: those that only look
//! at the blackboard work, the rest fails and names what is missing.

mod behaviours;
mod compute_path;
mod follow_path;
mod follow_waypoints;
mod mapping;
mod ports;
mod progress;
mod simple;

use super::context::Context;
use crate::behaviour_tree::{
    DuplicateNode, Leaf, LeafIo, NodeSpec, PortType, Registry, Status, nav2_condition, nav2_nodes,
};

pub use ports::{goal_text, parse_goal, parse_points};

/// The nodes that a mission's trees may use.
#[must_use]
pub fn registry() -> Registry<Context> {
    let mut registry = Registry::new();
    if let Err(duplicate) = fill(&mut registry) {
        // Ids are constants: this is a slip of the table below, which a test catches.
        tracing::error!(%duplicate, "two leaves of one name");
    }
    registry
}

fn fill(registry: &mut Registry<Context>) -> Result<(), DuplicateNode> {
    use PortType::{Double, Text, Unsigned};
    let nav2 = nav2_nodes();
    let known = |id: &str, doc: &str| {
        let spec = nav2.iter().find(|spec| spec.id == id).cloned();
        NodeSpec {
            doc: doc.to_owned(),
            ..spec.unwrap_or_else(|| NodeSpec::action(id, ""))
        }
    };
    registry.leaf(
        known("ComputePathToPose", "Plans and smooths a way to the goal."),
        |_| Box::<compute_path::ComputePath>::default(),
    )?;
    registry.leaf(
        known(
            "FollowPath",
            "Drives a way, rechecks and renews it, replans when it is blocked.",
        ),
        |_| Box::<follow_path::FollowPath>::default(),
    )?;
    registry.leaf(
        NodeSpec::action(
            "FollowWaypoints",
            "Drives through places by the waypoint law; needs no map.",
        )
        .input("waypoints", Text, "places `x;y|x;y|…`, m, map frame")
        .input_or("laps", Unsigned, "1", "how often")
        .output("error_code_id", Unsigned, "why it failed; 0: it did not")
        .output("error_msg", Text, "why it failed, in words"),
        |_| Box::<follow_waypoints::FollowWaypoints>::default(),
    )?;
    registry.leaf(NodeSpec::action("DoesMapExist", "SUCCESS if a map is stored."), |_| {
        Box::<mapping::DoesMapExist>::default()
    })?;
    registry.leaf(
        NodeSpec::action(
            "MapEnvironment",
            "Begins a new map; RUNNING while it grows, until it is halted.",
        ),
        |_| Box::<mapping::MapEnvironment>::default(),
    )?;
    registry.leaf(NodeSpec::action("SaveMap", "Stores the map."), |_| {
        Box::<mapping::SaveMap>::default()
    })?;
    registry.leaf(known("Wait", "Waits, s."), |_| Box::new(simple::Wait))?;
    registry.leaf(
        known("GoalReached", "SUCCESS within the tolerance of the goal.").input_optional(
            "tolerance",
            Double,
            "m; without it, the goal's own",
        ),
        |_| Box::new(simple::GoalReached),
    )?;
    registry.leaf(known("IsBatteryLow", "SUCCESS below a share of the charge."), |_| {
        Box::new(simple::IsBatteryLow)
    })?;
    registry.leaf(known("Spin", "Turns on the spot."), |_| {
        Box::<behaviours::Behaviour>::default()
    })?;
    registry.leaf(known("BackUp", "Drives straight back."), |_| {
        Box::<behaviours::Behaviour>::default()
    })?;
    registry.leaf(known("DriveOnHeading", "Drives straight on."), |_| {
        Box::<behaviours::Behaviour>::default()
    })?;
    for spec in nav2_nodes() {
        if registry.spec(&spec.id).is_some() {
            continue;
        }
        if nav2_condition::<Context>(&spec.id).is_some() {
            registry.leaf(spec, |site| {
                nav2_condition(site.id).unwrap_or_else(|| Box::new(Missing))
            })?;
        } else if spec.category.is_leaf() {
            registry.leaf(spec, |_| Box::new(Missing))?;
        } else {
            registry.declare(spec);
        }
    }
    Ok(())
}

/// A node of Nav2 whose job nobody does here.
struct Missing;

impl Leaf<Context> for Missing {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let why = format!("{}: this stack does not have what the node stands for", io.id());
        fail(io, ctx, None, why)
    }
}

/// Fails with Nav2's code and a reason that the goal's end can tell.
fn fail(io: &mut LeafIo<'_>, ctx: &mut Context, code: Option<i64>, why: impl Into<String>) -> Status {
    let why = why.into();
    if let Some(code) = code {
        // A tree that has put something else on these ports gets no code; the reason stands in the feedback.
        let _ = io.set("error_code_id", code);
        let _ = io.set("error_msg", why.as_str());
    }
    ctx.goal.failure = Some(format!("{}: {why}", io.name()));
    io.fail(why)
}

/// Says that nothing has failed.
fn no_error(io: &mut LeafIo<'_>) {
    let _ = io.set("error_code_id", 0_i64);
    let _ = io.set("error_msg", "");
}

/// Says what the node does, in the tree and in the goal's feedback.
fn step(io: &mut LeafIo<'_>, ctx: &mut Context, what: &str) -> Status {
    io.say(what);
    let said = format!("{}: {what}", io.name());
    if ctx.goal.feedback.step != said {
        ctx.goal.feedback.step = said;
    }
    Status::Running
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn every_leaf_has_a_name_of_its_own() {
        fill(&mut Registry::new()).unwrap();
    }
}
