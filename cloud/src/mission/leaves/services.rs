//! ClearEntireCostmap and its kin, Cancel*, ToggleCollisionMonitor: Nav2's services to other parts, as far as they have a
//! meaning here.

use zenav_protocol::messages::MapAction;

use super::mapping::{Acting, Action};
use super::{AtOnce, fail, step};
use crate::behaviour_tree::{Leaf, LeafIo, Status};
use crate::mission::context::Context;

/// A costmap is thrown away and filled anew. What this stack has of the global one is the map: mapping takes for gone what may
/// only have passed by, and what is still there is seen again; what lasts is kept. A local one there is not: the robot's guard
/// goes by the newest scan alone, so that nothing old is left to clear.
#[derive(Default)]
pub struct ClearCostmap {
    action: Action,
}

impl Leaf<Context> for ClearCostmap {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let service: Option<String> = io.get_optional("service_name").ok().flatten();
        if service.is_some_and(|name| name.contains("local_costmap")) {
            io.say("the robot's guard keeps nothing: it goes by the newest scan");
            return Status::Success;
        }
        self.action.begin(io, ctx);
        // The ask follows in the next tick, when the execution's id is stored.
        step(io, ctx, "clears the map")
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        match self.action.step(io, ctx, MapAction::Forget) {
            Acting::Busy => step(io, ctx, "clears the map"),
            Acting::Failed(why) => fail(io, ctx, None, why),
            Acting::Done => {
                io.say("what may have passed is gone");
                Status::Success
            }
        }
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.action.resume(ctx);
        self.tick(io, ctx)
    }

    fn halt(&mut self, _io: &mut LeafIo<'_>, ctx: &mut Context) {
        self.action.forget(ctx);
    }
}

/// Ends what leaves of a registration id are doing elsewhere in the tree; SUCCESS also where none is.
pub struct Cancel(pub &'static str);

/// Which leaf each of Nav2's cancelling actions ends.
#[must_use]
pub fn canceled_by(id: &str) -> Option<&'static str> {
    Some(match id {
        "CancelControl" => "FollowPath",
        "CancelBackUp" => "BackUp",
        "CancelDriveOnHeading" => "DriveOnHeading",
        "CancelSpin" => "Spin",
        "CancelWait" => "Wait",
        _ => return None,
    })
}

impl AtOnce for Cancel {
    fn answer(&mut self, _: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        ctx.cancel(self.0);
        Ok(Status::Success)
    }
}

/// The robot's guard is always on: SUCCESS to switch it on.
pub struct ToggleCollisionMonitor;

impl AtOnce for ToggleCollisionMonitor {
    fn answer(&mut self, io: &mut LeafIo<'_>, _: &mut Context) -> Result<Status, String> {
        match io.get_optional("enable") {
            Ok(Some(false)) => Err("the robot's guard cannot be switched off".to_owned()),
            Ok(_) => Ok(Status::Success),
            Err(wrong) => Err(wrong.to_string()),
        }
    }
}
