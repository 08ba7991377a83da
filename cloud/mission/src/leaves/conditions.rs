//! DistanceTraveled, IsStuck, CheckStopStatus, TransformAvailable: leaves that watch the clock or the robot.

use nalgebra::Point2;

use super::SyncLeaf;
use super::ports::robot_pose;
use crate::context::Context;
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// FAILURE until the robot is `distance` (straight) from its position at activation, then SUCCESS once, and again from there.
#[derive(Default)]
pub struct DistanceTraveled {
    from: Option<Point2<f64>>,
}

impl SyncLeaf for DistanceTraveled {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let (here, distance) = (robot_pose(ctx)?.position(), io.number_or("distance", 1.0)?);
        let from = self.from.filter(|_| io.previous().is_active());
        let traveled = from.is_some_and(|from| (here - from).norm() >= distance);
        if traveled || from.is_none() {
            self.from = Some(here);
        }
        Ok(Status::from_truth(traveled))
    }
}

/// SUCCESS for a while (`bump_memory`) after the robot touched something. Nav2 detects this from a jolt in the odometry.
pub struct IsStuck;

impl SyncLeaf for IsStuck {
    fn answer(&mut self, _: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let bumped = ctx.robot.was_bumped_within(ctx.now, ctx.config.settings.bump_memory);
        Ok(Status::from_truth(bumped))
    }
}

/// SUCCESS while the robot reports its pose in the map: the only transform between components.
pub struct TransformAvailable;

impl SyncLeaf for TransformAvailable {
    fn answer(&mut self, _: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let available = ctx.robot.is_heard(ctx.now) && ctx.robot.pose().is_some();
        Ok(Status::from_truth(available))
    }
}

/// RUNNING while the robot has been slower than `velocity_threshold` for less than `duration_stopped`, then SUCCESS; FAILURE if it moves.
#[derive(Default)]
pub struct CheckStopStatus {
    since: Option<f64>,
}

impl CheckStopStatus {
    fn look(&mut self, io: &LeafIo<'_>, ctx: &Context) -> Result<Status, String> {
        let threshold = io.number_or("velocity_threshold", 0.01)?;
        let duration = io.number_or("duration_stopped", 1000.0)? * 1e-3;
        let (now, twist) = (io.now().as_secs_f64(), ctx.robot.velocity());
        if twist.v.abs() >= threshold || twist.w.abs() >= threshold {
            return Ok(Status::Failure);
        }
        let since = *self.since.get_or_insert(now);
        Ok(if now - since >= duration {
            Status::Success
        } else {
            Status::Running
        })
    }
}

impl Leaf<Context> for CheckStopStatus {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.since = None;
        self.tick(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.look(io, ctx).unwrap_or_else(|why| io.fail(why))
    }
}
