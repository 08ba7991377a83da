//! ClearEntireCostmap and similar, Cancel*, ToggleCollisionMonitor: Nav2's services to other components, as far as they have a meaning
//! here.

use super::SyncLeaf;
use super::mapping::OnMap;
use crate::context::Context;
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// Clears a costmap, to be filled again. The counterpart of the global costmap is the map ([`OnMap::forget`]). There is no local costmap:
/// the robot's collision monitor uses the newest scan only, so there is nothing to clear.
pub struct ClearCostmap(OnMap);

impl Default for ClearCostmap {
    fn default() -> Self {
        Self(OnMap::forget())
    }
}

impl Leaf<Context> for ClearCostmap {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let service: Option<String> = io.get_optional("service_name").ok().flatten();
        if service.is_some_and(|name| name.contains("local_costmap")) {
            io.say("the robot's collision monitor keeps nothing: it goes by the newest scan");
            return Status::Success;
        }
        self.0.start(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.0.tick(io, ctx)
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.0.resume(io, ctx)
    }

    fn halt(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) {
        self.0.halt(io, ctx);
    }
}

/// Ends the work of all leaves of a registration id in the tree; SUCCESS also if there is none.
pub struct Cancel(pub &'static str);

/// The leaf that each of Nav2's cancelling actions ends.
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

impl SyncLeaf for Cancel {
    fn answer(&mut self, _: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        ctx.cancel(self.0);
        Ok(Status::Success)
    }
}

/// The robot's collision monitor is always on: SUCCESS to switch it on.
pub struct ToggleCollisionMonitor;

impl SyncLeaf for ToggleCollisionMonitor {
    fn answer(&mut self, io: &mut LeafIo<'_>, _: &mut Context) -> Result<Status, String> {
        match io.get_optional("enable")? {
            Some(false) => Err("the robot's collision monitor cannot be switched off".to_owned()),
            _ => Ok(Status::Success),
        }
    }
}
