//! ClearEntireCostmap and its kin, Cancel*, ToggleCollisionMonitor: Nav2's services to other parts, as far as they have a
//! meaning here.

use super::{AtOnce, fail, step};
use crate::behaviour_tree::{Leaf, LeafIo, Status};
use crate::mission::context::Context;
use zenav_protocol::time::Stamp;

/// For so long a map is waited for, s.
const PATIENCE: f64 = 5.0;

/// A costmap is thrown away and filled anew. The global one is the mission's copy of the map: it is fetched whole again
/// (what mapping takes for passing fades there by itself). A local one there is not: the robot's guard looks at the newest
/// scan alone, so that nothing old is left to clear.
#[derive(Default)]
pub struct ClearCostmap {
    since: Stamp,
}

impl Leaf<Context> for ClearCostmap {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let service: Option<String> = io.get_optional("service_name").ok().flatten();
        if service.is_some_and(|name| name.contains("local_costmap")) {
            io.say("the robot's guard keeps nothing: it goes by the newest scan");
            return Status::Success;
        }
        self.since = ctx.now;
        ctx.map.refresh();
        step(io, ctx, "fetches the map")
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        if !ctx.map.is_refreshing() {
            io.say("the map is new");
            return Status::Success;
        }
        if ctx.now.secs_since(self.since) > PATIENCE {
            return fail(io, ctx, None, "mapping does not answer");
        }
        step(io, ctx, "fetches the map")
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.start(io, ctx)
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
