//! Wait, GoalReached, IsBatteryLow: leaves that only read the clock and the robot's state.

use super::ports::goal_on;
use super::{fail, no_error, step};
use crate::context::Context;
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// Waits `wait_duration` seconds.
#[derive(Default)]
pub struct Wait {
    cancels: u64,
}

impl Leaf<Context> for Wait {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let secs = match io.get_optional::<f64>("wait_duration") {
            Ok(secs) => secs.unwrap_or(1.0),
            Err(error) => return fail(io, ctx, Some(0), error.to_string()),
        };
        if !secs.is_finite() {
            return fail(io, ctx, Some(0), "`wait_duration`: expected a finite number");
        }
        self.cancels = ctx.cancels(io.id());
        let until = io.now().as_secs_f64() + secs.max(0.0);
        if let Err(error) = io.remember(&until) {
            return fail(io, ctx, Some(0), error.to_string());
        }
        self.tick(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        if ctx.cancels(io.id()) != self.cancels {
            io.say("canceled by the tree");
            return Status::Success;
        }
        let left = io.recall::<f64>().unwrap_or(0.0) - io.now().as_secs_f64();
        if left <= 0.0 {
            no_error(io);
            return Status::Success;
        }
        step(io, ctx, &format!("waits {:.0} s", left.ceil()))
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.cancels = ctx.cancels(io.id());
        self.tick(io, ctx)
    }
}

/// SUCCESS while the robot is within the tolerance of `goal`.
pub struct GoalReached;

impl Leaf<Context> for GoalReached {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let goal = match goal_on(io, ctx, "goal") {
            Ok(goal) => goal,
            Err(why) => return fail(io, ctx, None, why),
        };
        let tolerance = io
            .get_optional("tolerance")
            .ok()
            .flatten()
            .unwrap_or(ctx.goal.tolerance);
        match ctx.robot.pose() {
            Some(pose) if pose.distance(&goal.pose()) <= tolerance => Status::Success,
            _ => Status::Failure,
        }
    }
}

/// SUCCESS while the charge is below `min_battery`, a share of 1.
pub struct IsBatteryLow;

impl Leaf<Context> for IsBatteryLow {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        if io.get_optional("is_voltage").ok().flatten() == Some(true) {
            return io.fail("robots tell the share of their charge: expected `is_voltage` to be false");
        }
        let least = io.get_optional("min_battery").ok().flatten().unwrap_or(0.2);
        match ctx.robot.state() {
            Some(state) if state.battery < least => Status::Success,
            _ => Status::Failure,
        }
    }
}
