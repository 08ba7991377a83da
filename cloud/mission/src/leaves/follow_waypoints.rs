//! FollowWaypoints: passes places in order with the robot's waypoint law, without a planner or a map.
//!
//! The collision monitor keeps the robot from obstacles. SUCCESS at the last place; FAILURE when the robot makes no progress or refuses the
//! plan, or when its scans deny that it is there. After a loss of the lease or a restart it continues with the first place not yet passed.

use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use zenav_protocol::messages::{GoalPhase, GoalPoint, PlanStatistics};

use super::follow_path::error_code;
use super::path;
use super::ports::parse_points;
use super::progress::Progress;
use super::{abort, fail, no_error, remember, step};
use crate::context::Context;
use crate::motion::{PlanDraft, PlanStatus};
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// Drives through `waypoints`, `laps` times.
#[derive(Default)]
pub struct FollowWaypoints {
    points: Vec<Point2<f64>>,
    progress: Progress,
    refusals: u32,
    not_before: zenav_protocol::time::Stamp,
}

/// State that must survive a restart.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Memory {
    /// Places passed before the motion in force began.
    base: usize,
    /// Places passed by now.
    passed: usize,
    motion: Option<u64>,
}

impl Leaf<Context> for FollowWaypoints {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        *self = Self::default();
        if let Err(why) = self.read(io, ctx) {
            return fail(io, ctx, Some(error_code::UNKNOWN), why);
        }
        ctx.motion.clear();
        let goal = self.points.last().map(|last| GoalPoint::at(last.x, last.y));
        ctx.begin_leg(io.name(), goal, path::length(&self.points));
        remember(io, &Memory::default());
        self.tick(io, ctx)
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        if let Err(why) = self.read(io, ctx) {
            return abort(io, ctx, error_code::UNKNOWN, why);
        }
        let memory: Memory = io.recall().unwrap_or_default();
        if memory.motion.is_none() || memory.motion != ctx.motion.id() {
            ctx.motion.clear();
        }
        self.tick(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let mut memory: Memory = io.recall().unwrap_or_default();
        if let Some(why) = ctx.obstacle_to_driving() {
            self.progress.reset();
            return step(io, ctx, &why);
        }
        if self.progress.is_stuck(ctx) {
            let why = format!("no progress within {:.0} s", ctx.config.settings.progress.timeout);
            return abort(io, ctx, error_code::FAILED_TO_MAKE_PROGRESS, why);
        }
        match ctx.motion.status().cloned() {
            Some(PlanStatus::Sent | PlanStatus::Taken) => {
                if let Some((waypoint, length)) = ctx.progress().map(|plan| (plan.waypoint, plan.distance_left)) {
                    let passed = memory.base + waypoint;
                    ctx.goal.feedback.distance_left = Some(length);
                    if passed > memory.passed {
                        self.refusals = 0;
                        memory.passed = passed.min(self.points.len());
                        remember(io, &memory);
                    }
                }
                if ctx.motion.age(ctx.now) >= ctx.config.settings.renew_period || ctx.motion.is_held() {
                    ctx.renew();
                }
                let what = format!(
                    "driving to waypoint {} of {}",
                    (memory.passed + 1).min(self.points.len()),
                    self.points.len()
                );
                step(io, ctx, &what)
            }
            Some(PlanStatus::Finished) => self.succeed(io, ctx),
            Some(PlanStatus::Refused(why)) => {
                self.refusals += 1;
                tracing::info!(goal = ctx.goal.id, why, "the robot rejected waypoints");
                if self.refusals > ctx.config.settings.retries.refusals {
                    let why = format!("the robot rejects the waypoints: {why}");
                    return abort(io, ctx, error_code::NO_VALID_CONTROL, why);
                }
                ctx.motion.clear();
                self.not_before = ctx.now.plus_secs(ctx.config.settings.retries.refusal_wait);
                step(io, ctx, "retrying")
            }
            Some(PlanStatus::Void(_)) | None if ctx.now < self.not_before => step(io, ctx, "retrying"),
            Some(PlanStatus::Void(_)) | None => self.begin(io, ctx, memory),
        }
    }

    fn halt(&mut self, _io: &mut LeafIo<'_>, ctx: &mut Context) {
        ctx.end_leg(GoalPhase::Canceled, None);
    }
}

impl FollowWaypoints {
    fn read(&mut self, io: &LeafIo<'_>, ctx: &Context) -> Result<(), String> {
        let laps = io.get_optional("laps")?.unwrap_or(1);
        self.points = parse_points(io.value("waypoints")?, laps, &ctx.config.places)?;
        Ok(())
    }

    fn begin(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, mut memory: Memory) -> Status {
        let rest: Vec<Point2<f64>> = self.points.iter().skip(memory.passed).copied().collect();
        if rest.is_empty() {
            return self.succeed(io, ctx);
        }
        let statistics = PlanStatistics {
            planner: "waypoints".to_owned(),
            status: "waypoints".to_owned(),
            length: path::length(&rest),
            ..PlanStatistics::default()
        };
        let map = ctx.map.newest().unwrap_or_default();
        ctx.drive(PlanDraft {
            map,
            waypoints: rest,
            statistics,
            ..PlanDraft::default()
        });
        memory.base = memory.passed;
        memory.motion = ctx.motion.id();
        remember(io, &memory);
        step(io, ctx, "starting")
    }

    fn succeed(&self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        if let Some(why) = ctx.robot.has_not_arrived(ctx.now) {
            return abort(io, ctx, error_code::TF_ERROR, why);
        }
        no_error(io);
        io.say("all waypoints passed");
        ctx.end_leg(GoalPhase::Succeeded, None);
        Status::Success
    }
}
