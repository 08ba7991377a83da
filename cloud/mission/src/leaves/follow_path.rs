//! FollowPath: drives a path to its end; rechecks and renews the plan as the map grows, and replans when it is blocked or when a shorter
//! way opens.
//!
//! SUCCESS at the goal, within its tolerance; FAILURE when the robot makes no progress, when no path leads round an obstacle, when the
//! robot refuses plan after plan, when its scans deny that it is at the goal, or leave that too uncertain. Without the lease, or while the
//! robot is stopped or driven by hand, it waits.

mod alternatives;

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{GoalPhase, GoalPoint};
use zenav_protocol::time::Stamp;

use super::ports::{OLD_FRAME, path_on};
use super::progress::Progress;
use super::selectors::Choice;
use super::tracking::Tracking;
use super::{abort, fail, no_error, remember, step};
use crate::context::Context;
use crate::motion::{PlanStatus, Recheck};
use crate::route::{Route, RouteData, RouteRequest, Search, Searching, is_long};
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// Nav2's error codes of path following.
pub mod error_code {
    pub const UNKNOWN: i64 = 100;
    pub const INVALID_CONTROLLER: i64 = 101;
    pub const TF_ERROR: i64 = 102;
    pub const INVALID_PATH: i64 = 103;
    pub const FAILED_TO_MAKE_PROGRESS: i64 = 105;
    pub const NO_VALID_CONTROL: i64 = 106;
}

/// Wait before searching again after a route could not be checked, s.
const AFTER_UNCHECKED: f64 = 1.0;
/// Greatest distance of the robot from the start of a route from rest, m.
const BEGIN_DISTANCE: f64 = 0.15;

/// Ports that choose how a path is followed, and their choices.
const CHOICES: [(&str, Choice); 4] = [
    ("controller_id", Choice::Controller),
    ("goal_checker_id", Choice::GoalChecker),
    ("progress_checker_id", Choice::ProgressChecker),
    ("path_handler_id", Choice::PathHandler),
];
/// Motion of a goal relative to the robot's surroundings above which it is planned to again, m.
const PARTED: f64 = 0.01;
/// Distance from the goal at which a robot at rest has arrived, as a share of the tolerance.
const THERE: f64 = 0.5;
/// Time at rest at the goal after which a robot that is too uncertain of its position fails, s: a robot at rest is corrected every 10 s.
const UNSURE: f64 = 12.0;

/// Drives `path`.
#[derive(Default)]
pub struct FollowPath {
    progress: Progress,
    search: Option<Search>,
    /// Search for a sooner path than the driven one, and the earliest time of the next one.
    other: Option<Search>,
    next_other: Stamp,
    /// Searches since the robot last gave way to nobody.
    others: u32,
    refusals: u32,
    misses: u32,
    path_sequence: u64,
    tracking: Tracking,
    cancels: u64,
    rechecked: u64,
    /// Count of zone changes known to the motion in force.
    zone_changes: u64,
    /// A better route than the driven one, from the tree.
    offered: Option<Arc<Route>>,
    /// Plan time at which an obstacle blocks the motion in force, s.
    blocked_at: Option<f64>,
    /// Until then, obstacles far ahead need no replanning.
    gathered: Stamp,
    /// Since when the robot has been at rest at the goal by an estimate that is too uncertain.
    unsure_since: Option<Stamp>,
    /// Frame of the map that its coordinates are in.
    frame: u64,
}

/// State that must survive a restart.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Memory {
    goal: GoalPoint,
    motion: Option<u64>,
    /// Frame of the map that the goal's coordinates are in.
    #[serde(default)]
    frame: u64,
}

/// Whether the robot stands at a goal without a heading.
fn is_there(ctx: &Context, goal: &GoalPoint) -> bool {
    let near = |pose: Pose2| pose.distance(&goal.pose()) <= THERE * ctx.goal.tolerance;
    goal.yaw.is_none() && ctx.robot.is_at_rest() && ctx.robot.pose().is_some_and(near)
}

/// Why the robot is too uncertain of its position in the known map to be said to have arrived, if so. A map that has parts is drawn by SLAM
/// on the way: it shares the robot's error, which the covariance includes.
fn unsure(ctx: &Context) -> Option<String> {
    let is_known_map = !ctx.frames.is_known(ctx.frames.at());
    ctx.robot
        .is_unsure_within(ctx.goal.tolerance, ctx.now)
        .filter(|_| is_known_map)
}

fn arrived(io: &mut LeafIo<'_>) -> Status {
    no_error(io);
    io.say("arrived");
    Status::Success
}

impl Leaf<Context> for FollowPath {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        *self = Self::default();
        self.cancels = ctx.cancels(io.id());
        self.zone_changes = ctx.map.zone_changes();
        for (port, choice) in CHOICES {
            if let Err(why) = choice.check(io.get_optional(port).ok().flatten()) {
                return fail(io, ctx, Some(error_code::INVALID_CONTROLLER), why);
            }
        }
        let data = match path_on(io, "path") {
            Ok(data) if !data.points.is_empty() => data,
            Ok(_) => return fail(io, ctx, Some(error_code::INVALID_PATH), "the path is empty"),
            Err(why) => return fail(io, ctx, Some(error_code::INVALID_PATH), why),
        };
        let Some(data) = data.settled(&ctx.frames) else {
            return fail(io, ctx, Some(error_code::INVALID_PATH), OLD_FRAME);
        };
        self.frame = ctx.frames.at();
        self.path_sequence = io.sequence("path");
        if is_there(ctx, &data.goal) {
            // A path whose end stays near the robot, as when it follows something.
            if let Some(why) = ctx.robot.has_not_arrived(ctx.now) {
                return fail(io, ctx, Some(error_code::TF_ERROR), why);
            }
            if unsure(ctx).is_none() {
                return arrived(io);
            }
            self.unsure_since = Some(ctx.now);
        }
        self.offered = ctx.route(data.route);
        // A robot that approached the obstacle continues from there.
        let goes_on = |route: &Arc<Route>| {
            let splice = route.plan.splice.as_ref();
            splice.is_some_and(|splice| Some(splice.trajectory_id) == ctx.motion.id())
        };
        if !self.offered.as_ref().is_some_and(goes_on) {
            ctx.motion.clear();
        }
        // A drive is named after its node, or, if the node has no name, after its destination.
        let named = data.place.as_deref().filter(|_| io.name() == io.id());
        ctx.begin_leg(named.unwrap_or(io.name()), Some(data.goal), data.length);
        let memory = Memory {
            goal: data.goal,
            motion: None,
            frame: self.frame,
        };
        remember(io, &memory);
        if self.offered.is_none() {
            self.follow_points(ctx, &data);
        }
        self.tracking.follow(data);
        self.tick(io, ctx)
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.cancels = ctx.cancels(io.id());
        self.zone_changes = ctx.map.zone_changes();
        self.path_sequence = io.sequence("path");
        if let Ok(data) = path_on(io, "path") {
            self.tracking.take_up(data, ctx);
        }
        let memory: Option<Memory> = io.recall();
        if memory.is_none_or(|memory| memory.motion.is_none() || memory.motion != ctx.motion.id()) {
            ctx.motion.clear();
        }
        self.tick(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let Some(mut memory) = io.recall::<Memory>() else {
            return self.end(io, ctx, error_code::INVALID_PATH, "the goal was not stored".to_owned());
        };
        if ctx.cancels(io.id()) != self.cancels {
            self.stop_search(ctx);
            ctx.end_leg(GoalPhase::Canceled, None);
            io.say("canceled by the tree");
            return Status::Success;
        }
        if let Some(why) = ctx.robot.lost() {
            return self.end(io, ctx, error_code::TF_ERROR, why);
        }
        if memory.frame != ctx.frames.at() && !self.settle(io, ctx, &mut memory) {
            return self.end(io, ctx, error_code::INVALID_PATH, OLD_FRAME.to_owned());
        }
        if self.unsure_since.is_some() && is_there(ctx, &memory.goal) {
            return self.arrive(io, ctx);
        }
        self.look_for_offer(io, ctx, &mut memory);
        self.tracking.observe(io, ctx);
        if let Some(why) = ctx.obstacle_to_driving() {
            self.progress.reset();
            self.stop_search(ctx);
            return step(io, ctx, &why);
        }
        if self.progress.is_stuck(ctx) {
            let why = format!("no progress within {:.0} s", ctx.config.settings.progress.timeout);
            return self.end(io, ctx, error_code::FAILED_TO_MAKE_PROGRESS, why);
        }
        if let Some(route) = self.offered.take() {
            if self.fits(ctx, &route) {
                return self.drive(io, ctx, memory, &route);
            }
            if memory.motion != ctx.motion.id() {
                // The motion that the route was to continue from.
                ctx.hold();
                ctx.motion.clear();
            }
        }
        if let Some(PlanStatus::Refused(why)) = ctx.motion.status().cloned()
            && let Some(failure) = self.refused(io, ctx, memory.goal, &why)
        {
            return failure;
        }
        if self.search.is_none() {
            match ctx.motion.status().cloned() {
                None => self.begin_search(ctx, memory.goal, 0.0),
                Some(PlanStatus::Void(why)) => {
                    tracing::info!(goal = ctx.goal.id, why, "replanning");
                    self.begin_search(ctx, memory.goal, 0.0);
                }
                Some(PlanStatus::Finished) => {
                    if let Some(end) = self.finished(io, ctx, memory.goal) {
                        return end;
                    }
                }
                Some(PlanStatus::Sent | PlanStatus::Taken | PlanStatus::Refused(_)) => {
                    return self.supervise(io, ctx, memory);
                }
            }
        }
        self.search(io, ctx, memory)
    }

    fn halt(&mut self, _io: &mut LeafIo<'_>, ctx: &mut Context) {
        self.stop_search(ctx);
        ctx.end_leg(GoalPhase::Canceled, None);
    }
}

impl FollowPath {
    /// The robot has rejected the plan in force: another one is searched. After too many, the failure.
    fn refused(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, goal: GoalPoint, why: &str) -> Option<Status> {
        self.refusals += 1;
        tracing::info!(goal = ctx.goal.id, why, "the robot rejected a plan");
        if self.refusals > ctx.config.settings.retries.refusals {
            let why = format!("the robot rejects the plan: {why}");
            return Some(self.end(io, ctx, error_code::NO_VALID_CONTROL, why));
        }
        if !ctx.motion.revert() {
            ctx.motion.clear();
        }
        self.begin_search(ctx, goal, ctx.config.settings.retries.refusal_wait);
        None
    }

    /// The robot is at rest at the end of its plan: at the goal, the answer; elsewhere another plan is searched, a few times.
    fn finished(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, goal: GoalPoint) -> Option<Status> {
        let left = ctx
            .robot
            .pose()
            .map_or(f64::INFINITY, |pose| pose.distance(&goal.pose()));
        if left <= ctx.goal.tolerance {
            return Some(self.arrive(io, ctx));
        }
        self.unsure_since = None;
        self.misses += 1;
        if self.misses > ctx.config.settings.retries.misses {
            let tolerance = ctx.goal.tolerance;
            let why = format!("ended {left:.2} m from the goal; the tolerance is {tolerance:.2} m");
            return Some(self.end(io, ctx, error_code::NO_VALID_CONTROL, why));
        }
        ctx.motion.clear();
        self.begin_search(ctx, goal, 0.0);
        None
    }

    /// The robot is at rest at the goal by its own estimate: success, unless its scans deny that, or have left it too uncertain for some time.
    fn arrive(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        if let Some(why) = ctx.robot.has_not_arrived(ctx.now) {
            return self.end(io, ctx, error_code::TF_ERROR, why);
        }
        if let Some(why) = unsure(ctx) {
            let since = *self.unsure_since.get_or_insert(ctx.now);
            if ctx.now.secs_since(since) >= UNSURE {
                return self.end(io, ctx, error_code::TF_ERROR, why);
            }
            self.progress.reset();
            return step(io, ctx, &format!("waiting: {why}"));
        }
        self.stop_search(ctx);
        ctx.end_leg(GoalPhase::Succeeded, None);
        arrived(io)
    }

    /// Switches to the present frame of the map. The plan in force continues; if its goal has moved relative to the robot's surroundings, a
    /// new route to the goal is searched meanwhile. `false` if the goal's frame is too old.
    fn settle(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, memory: &mut Memory) -> bool {
        let Some(moved) = ctx.frames.robot(memory.frame) else {
            return false;
        };
        let (before, along) = (memory.frame, memory.goal.moved(moved));
        memory.goal = ctx.frames.place(before, memory.goal);
        memory.frame = ctx.frames.at();
        self.frame = memory.frame;
        remember(io, memory);
        self.tracking.settle(before, ctx);
        self.offered = None;
        self.stop_other(ctx);
        let parted = along.pose().distance(&memory.goal.pose()) > PARTED;
        let is_blocked = self.blocked_at.is_some() || self.search.as_ref().is_some_and(Search::is_waiting);
        if self.search.is_some() || parted {
            self.begin_search(ctx, memory.goal, 0.0);
        }
        if !is_blocked {
            self.search = self.search.take().map(Search::at_once);
        }
        true
    }

    /// Whether an obstacle this far ahead on the plan in force, s, needs a replan: just after the last one only if it is near.
    fn needs_replan(&self, ctx: &Context, ahead: f64) -> bool {
        ahead <= ctx.config.settings.obstacle.far || ctx.now >= self.gathered
    }

    /// Searches a motion along a path that came without one.
    fn follow_points(&mut self, ctx: &mut Context, data: &RouteData) {
        self.cancel_search(ctx);
        let request = RouteRequest {
            given: data.driven(),
            driven: data.driven,
            via: data.via.clone(),
            ..RouteRequest::to(data.goal)
        };
        self.search = Some(Search::new(ctx, request, None, ctx.now));
    }

    /// Whether a route begins where the robot will be.
    fn fits(&self, ctx: &Context, route: &Route) -> bool {
        if route.plan.map.frame != ctx.frames.at() {
            return false;
        }
        match route.plan.splice {
            Some(splice) => {
                ctx.motion.id() == Some(splice.trajectory_id) && ctx.motion.status() == Some(&PlanStatus::Taken)
            }
            None => {
                ctx.robot.is_at_rest()
                    && ctx
                        .robot
                        .pose()
                        .is_some_and(|pose| pose.distance(&route.begin) < BEGIN_DISTANCE)
            }
        }
    }

    /// Puts a route into force if it is free on the newest map.
    fn drive(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, mut memory: Memory, route: &Route) -> Status {
        match ctx.recheck_new(&route.plan.trajectory) {
            Ok(Recheck::Free) => {}
            Ok(Recheck::Blocked(_)) => {
                // The map has changed since.
                self.begin_search(ctx, memory.goal, ctx.config.settings.retries.refusal_wait);
                return step(io, ctx, "replanning: the map has changed");
            }
            Err(why) => {
                self.begin_search(ctx, memory.goal, AFTER_UNCHECKED);
                return step(io, ctx, &format!("waiting: the path cannot be checked: {why}"));
            }
        }
        self.stop_search(ctx);
        ctx.drive(route.plan.clone());
        self.gathered = ctx.now.plus_secs(ctx.config.settings.obstacle.gather);
        memory.motion = ctx.motion.id();
        remember(io, &memory);
        step(io, ctx, "driving")
    }

    /// Supervises the plan in force: rechecked once a period, and sooner when the map changes; renewed while it is free.
    fn supervise(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, memory: Memory) -> Status {
        let taken = ctx.motion.status() == Some(&PlanStatus::Taken);
        if taken && !ctx.motion.is_held() {
            self.refusals = 0;
        }
        if let Some((length, secs)) = ctx.progress().map(|plan| (plan.distance_left, plan.time_left)) {
            ctx.goal.feedback.distance_left = Some(length);
            ctx.goal.feedback.time_left = Some(secs);
        }
        if let Some(status) = self.look_for_sooner(io, ctx, memory) {
            return status;
        }
        let due = ctx.motion.age(ctx.now) >= ctx.config.settings.renew_period || ctx.motion.is_held();
        let revision = ctx.map.revision();
        let zone_changes = ctx.map.zone_changes();
        let rezoned = std::mem::replace(&mut self.zone_changes, zone_changes) != zone_changes;
        if due || rezoned || revision != self.rechecked {
            self.rechecked = revision;
            match ctx.recheck_rest() {
                // Speed limits may have changed, or the path may be shorter: this motion continues until there is a better one.
                Ok(Recheck::Free) if rezoned => {
                    self.begin_search(ctx, memory.goal, 0.0);
                    self.search = self.search.take().map(Search::at_once);
                    return step(io, ctx, "replanning: the zones of the map have changed");
                }
                Ok(Recheck::Free) if due => ctx.renew(),
                Ok(Recheck::Free) => {}
                // The plan runs out: the robot is at rest by its expiry, and continues once the plan can be checked again.
                Err(why) => return step(io, ctx, &format!("plan not renewed, it cannot be checked: {why}")),
                Ok(Recheck::Blocked(ahead)) if !self.needs_replan(ctx, ahead) => {}
                Ok(Recheck::Blocked(ahead)) => {
                    tracing::debug!(goal = ctx.goal.id, ahead, "the path is blocked");
                    self.replan(ctx, memory.goal, ahead);
                    return step(io, ctx, "replanning: the path is blocked");
                }
            }
        }
        let what = if taken {
            "driving"
        } else {
            "waiting for the robot to accept the plan"
        };
        step(io, ctx, what)
    }

    fn search(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, memory: Memory) -> Status {
        self.brake_in_time(ctx);
        let Some(search) = &mut self.search else {
            return Status::Running;
        };
        let keeps_off = search.keeps_off();
        match search.step(ctx) {
            Searching::Wait(what) => step(io, ctx, what),
            Searching::Blocked(what) => {
                let stops_at = search.stops_at(ctx);
                self.progress.reset();
                if let Some(at) = stops_at.filter(|_| !ctx.motion.is_held()) {
                    self.drive_up_to(ctx, at);
                }
                step(io, ctx, &what)
            }
            Searching::Nearer(route) => {
                self.blocked_at = None;
                search.approaches(ctx, *route);
                step(io, ctx, "drives to where it sees what bars the way")
            }
            Searching::Found(route) => {
                self.search = None;
                if !self.fits(ctx, &route) {
                    self.begin_search(ctx, memory.goal, 0.0);
                    return step(io, ctx, "replanning: the robot is elsewhere by now");
                }
                let leads_round =
                    keeps_off && route.plan.splice.is_some() && is_long(ctx, &self.tracking.goals_ahead(), &route);
                if leads_round && ctx.recheck_rest() == Ok(Recheck::Free) {
                    // The plan in force is free again, though with less room than the planner wants.
                    self.stop_search(ctx);
                    return self.supervise(io, ctx, memory);
                }
                self.drive(io, ctx, memory, &route)
            }
            Searching::Failed(no_route)
                if !ctx.robot.is_at_rest() && ctx.motion.status() == Some(&PlanStatus::Taken) =>
            {
                // The failure may only apply at this speed.
                ctx.hold();
                self.begin_search(ctx, memory.goal, 0.0);
                self.search = self.search.take().map(Search::once_at_rest);
                step(io, ctx, &format!("stopping: {}", no_route.reason))
            }
            Searching::Failed(no_route) => {
                let code = if no_route.is_final() {
                    error_code::INVALID_PATH
                } else {
                    error_code::NO_VALID_CONTROL
                };
                self.end(io, ctx, code, format!("no path to continue: {}", no_route.reason))
            }
        }
    }

    /// Searches another path to the goal: the plan in force is blocked this far ahead, s.
    fn replan(&mut self, ctx: &mut Context, goal: GoalPoint, ahead: f64) {
        self.begin_search(ctx, goal, 0.0);
        self.blocked_at = Some(ctx.plan_time().unwrap_or(0.0) + ahead);
        self.brake_in_time(ctx);
    }

    /// Holds the motion in force once the obstacle on the trajectory comes near.
    fn brake_in_time(&mut self, ctx: &mut Context) {
        if let (Some(at), Some(stopping)) = (self.blocked_at, ctx.stopping_time()) {
            let ahead = at - ctx.plan_time().unwrap_or(0.0);
            if ahead < stopping {
                ctx.hold_within(ahead);
            }
        }
    }

    /// Drives on while it waits, until this plan time, s. The plan is renewed while all that it is valid for is free.
    fn drive_up_to(&mut self, ctx: &mut Context, at: f64) {
        self.blocked_at = Some(at);
        let (time, valid) = (ctx.plan_time().unwrap_or(0.0), ctx.plan_valid());
        if ctx.motion.age(ctx.now) < ctx.config.settings.renew_period || at - time <= valid {
            return;
        }
        let is_free = ctx.recheck_rest().is_ok_and(|recheck| match recheck {
            Recheck::Free => true,
            Recheck::Blocked(ahead) => ahead > valid,
        });
        if is_free {
            ctx.renew();
        }
    }

    fn begin_search(&mut self, ctx: &mut Context, goal: GoalPoint, wait: f64) {
        self.cancel_search(ctx);
        let from = ctx.now.plus_secs(wait);
        let request = RouteRequest {
            via: self.tracking.goals_ahead(),
            ..RouteRequest::to(goal)
        };
        self.search = Some(Search::new(ctx, request, None, from).replacing());
    }

    fn stop_search(&mut self, ctx: &mut Context) {
        self.blocked_at = None;
        self.cancel_search(ctx);
    }

    /// Ends the search for another one: what blocks the plan in force still does.
    fn cancel_search(&mut self, ctx: &mut Context) {
        self.stop_other(ctx);
        if let Some(search) = self.search.take() {
            search.cancel(ctx);
        }
    }

    fn end(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, code: i64, why: String) -> Status {
        self.stop_search(ctx);
        abort(io, ctx, code, why)
    }
}

#[cfg(test)]
mod tests;
