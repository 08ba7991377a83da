//! Missing capabilities. Which of Nav2's nodes need something that this stack does not have? They may be in a tree; when ticked, they fail
//! and name what is missing.

use super::fail;
use crate::context::Context;
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// Nav2's error code for an unreachable server.
pub const SEND_GOAL_FAILURE: i64 = 2;
/// Nav2's error code for a route server without a graph: no recovery helps.
const NO_VALID_GRAPH: i64 = 402;

/// A Nav2 node whose capability this stack does not have.
pub struct Missing;

/// The capability that a node with this registration id needs.
fn capability(id: &str) -> (&'static str, i64) {
    match id {
        "ComputeRoute" | "ComputeAndTrackRoute" | "CancelComputeAndTrackRoute" | "ExtractRouteNodesAsGoals" => {
            ("a route server with a graph of the place", NO_VALID_GRAPH)
        }
        "DockRobot" | "UndockRobot" => ("docking", SEND_GOAL_FAILURE),
        "FollowObject" | "CancelFollowObject" => ("following an object", SEND_GOAL_FAILURE),
        "AssistedTeleop" | "CancelAssistedTeleop" => (
            "teleoperation within a tree: an operator takes the lease for it",
            SEND_GOAL_FAILURE,
        ),
        "IsBatteryCharging" => ("word from the robot whether it charges", SEND_GOAL_FAILURE),
        _ => ("a server for it", SEND_GOAL_FAILURE),
    }
}

impl Leaf<Context> for Missing {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let (what, code) = capability(io.id());
        let why = format!("this stack does not have {what}");
        fail(io, ctx, Some(code), why)
    }
}
