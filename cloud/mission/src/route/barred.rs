//! Barred ways. There is no path, or none that can be driven: does the search wait for what may leave, and for how long?

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{GoalPoint, MotionReply, MotionRequest, PlanOutcome, PlanReply, PlanRequest};

use super::answer::named;
use super::begin::Begin;
use super::waiting::{InSight, Waiting, reach};
use super::{NoRoute, Search, Searching, Stage, error_code};
use crate::context::Context;
use crate::io::{Answer, NoAnswer, Ticket};
use crate::transient::TransientCell;

/// Time between two attempts while waiting, s: at least, used when the obstacle gives way, and at most.
pub(super) const RETRY: [f64; 2] = [0.2, 1.0];
/// A departing obstacle leaves traces in the map for a while: for this long a missing path is requested again, s.
const TRACES: f64 = 5.0;
/// Most goals around which transient obstacles are searched.
const MAX_GOALS: usize = 8;
/// Distance within which a lidar can tell a person or a robot from a wall, m.
const TOLD_WITHIN: f64 = 3.0;
/// Centres nearer to each other than this are of one cell, m.
const SAME_CELL: f64 = 1e-3;

impl Search {
    /// Whether this search waits for anything.
    pub(super) fn may_wait(&self, ctx: &Context) -> bool {
        ctx.config.settings.patience > 0.0 && self.request.from.is_none()
    }

    /// Whether the obstacle gives way.
    pub(super) fn may_go_on(&self, ctx: &Context) -> bool {
        let due = ctx.now.secs_since(self.asked) >= RETRY[0];
        due && self.waiting.as_ref().is_some_and(|waiting| waiting.gives_way(ctx))
    }

    /// No path was found: asks whether there would be one without the transient obstacles.
    pub(super) fn unless_it_leaves(&mut self, ctx: &mut Context, begin: &Begin, no_route: NoRoute) -> Searching {
        let may_pass = [error_code::GOAL_OCCUPIED, error_code::NO_VALID_PATH].contains(&no_route.code);
        if !may_pass || !self.may_wait(ctx) {
            return self.given_up(ctx, no_route);
        }
        self.cleared = self.what_may_leave(ctx, &[begin.pose.position()]);
        // One or two beam returns near a goal far away are not enough to tell what they hit.
        let goal = self.request.goal.position();
        let near = reach(ctx);
        let is_far = (goal - begin.pose.position()).norm() > TOLD_WITHIN + near;
        self.doubts = no_route.code == error_code::GOAL_OCCUPIED && is_far && ctx.goal.tries.are_left();
        if self.doubts {
            self.cleared.extend(ctx.map.lone(goal, near));
        }
        let Some(ticket) = self.ask_without_what_may_leave(ctx, begin.pose) else {
            return self.given_up(ctx, no_route);
        };
        self.stage = Stage::Cleared(ticket, no_route);
        Searching::Wait("asks what bars the way")
    }

    /// Transient cells near these places and the goals.
    pub(super) fn what_may_leave(&self, ctx: &Context, places: &[Point2<f64>]) -> Vec<TransientCell> {
        let goals = self.request.via.iter().chain([&self.request.goal]);
        let goals = goals.map(GoalPoint::position).take(MAX_GOALS);
        let near: Vec<Point2<f64>> = places.iter().copied().chain(goals).collect();
        let mut cells = ctx.map.transient(&near);
        // What may leave may still do so when the robot sees another side of it.
        if let Some(avoided) = &ctx.goal.avoided {
            let since = Some(avoided.blockage.since);
            let is_new = |center: &&Point2<f64>| cells.iter().all(|cell| (cell.center - **center).norm() > SAME_CELL);
            let more: Vec<&Point2<f64>> = avoided.standing(ctx).filter(is_new).collect();
            cells.extend(more.into_iter().map(|center| TransientCell { center: *center, since }));
        }
        cells
    }

    /// Asks for a path as if the transient cells had left; `None` if there are none.
    pub(super) fn ask_without_what_may_leave(&self, ctx: &mut Context, start: Pose2) -> Option<Ticket> {
        let (model, map) = (ctx.robot.model().cloned()?, ctx.map.newest()?);
        if self.cleared.is_empty() {
            return None;
        }
        let request = PlanRequest {
            cleared: self.cleared.iter().map(|cell| cell.center).collect(),
            ..self.plan_request(ctx, model, map, start)
        };
        Some(ctx.asks.ask_motion(MotionRequest::Plan(request)))
    }

    /// The answer to that request.
    pub(super) fn without_what_may_leave(
        &mut self,
        ctx: &mut Context,
        no_route: NoRoute,
        answer: Result<Answer, NoAnswer>,
    ) -> Searching {
        let cells = std::mem::take(&mut self.cleared);
        self.wait(ctx, &path_of(answer), &cells, no_route)
    }

    /// There is a path, but it cannot be driven. Somebody seen from one side only may stand at one of its ends: at the goal, or so near to
    /// the robot that it has no room to set out.
    pub(super) fn unless_an_end_is_taken(
        &mut self,
        ctx: &mut Context,
        begin: &Begin,
        path: &[Point2<f64>],
        no_route: NoRoute,
    ) -> Searching {
        if !self.may_wait(ctx) {
            return self.given_up(ctx, no_route);
        }
        let ends = [begin.pose.position(), self.request.goal.position()];
        let cells = ctx.map.transient(&ends);
        self.doubts = false;
        self.wait(ctx, path, &cells, no_route)
    }

    /// There is a path, but a transient obstacle covers the goal: waits for it, unless it has been there for too long.
    pub(super) fn until_the_goal_is_uncovered(
        &mut self,
        ctx: &mut Context,
        begin: &Begin,
        path: &[Point2<f64>],
    ) -> Option<Searching> {
        let cells = self.covers_goal(ctx, begin.pose.position());
        // Where the path would touch it.
        let touches = cells.first()?.center;
        let path: Vec<Point2<f64>> = path.iter().copied().chain([touches]).collect();
        let goal = named(&self.request.goal);
        let no_route = NoRoute {
            code: error_code::GOAL_OCCUPIED,
            reason: format!("the goal {goal} is taken by what stands before it"),
        };
        self.doubts = false;
        let waits = self.wait(ctx, &path, &cells, no_route);
        (!matches!(waits, Searching::Failed(_))).then_some(waits)
    }

    /// Waits for the first transient obstacle on a path; gives up if there is none, or if it has been there for too long.
    fn wait(
        &mut self,
        ctx: &mut Context,
        path: &[Point2<f64>],
        cells: &[TransientCell],
        no_route: NoRoute,
    ) -> Searching {
        let Some(mut waiting) = Waiting::on(path, cells, reach(ctx), ctx.now) else {
            return self.given_up(ctx, no_route);
        };
        if self.doubts {
            waiting.told_within = TOLD_WITHIN;
        } else {
            waiting.note(ctx);
        }
        let approaches = self.is_approaching() || self.may_approach && ctx.goal.tries.are_left();
        let is_hidden = approaches && !waiting.is_in_sight(ctx);
        let in_sight = InSight::of(waiting.blockage, ctx.goal.in_sight, is_hidden, ctx.now);
        // Another obstacle in sight does not make it forgotten.
        ctx.goal.in_sight = in_sight.or(ctx.goal.in_sight);
        let seen = in_sight.map_or(f64::INFINITY, |seen| seen.secs);
        if waiting.stood(ctx.now).min(seen) > patience(ctx) {
            let reason = format!("{}; {}", no_route.reason, waiting.given_up(ctx.now));
            self.waiting = None;
            return Searching::Failed(NoRoute { reason, ..no_route });
        }
        self.wait_for(ctx, waiting)
    }

    /// Waits for an obstacle, until the next path request.
    pub(super) fn wait_for(&mut self, ctx: &Context, waiting: Waiting) -> Searching {
        if self.waiting.is_none() {
            tracing::info!(goal = ctx.goal.id, what = waiting.said(ctx.now), "the way is barred");
        }
        self.waiting = Some(waiting);
        self.again_at(ctx.now.plus_secs(RETRY[1]));
        Searching::Wait("is about to plan")
    }

    fn given_up(&mut self, ctx: &Context, no_route: NoRoute) -> Searching {
        let waited = ctx.goal.waited.filter(|_| self.waiting.is_some());
        if waited.is_some_and(|(_, last)| ctx.now.secs_since(last) <= TRACES) {
            self.again_at(ctx.now.plus_secs(RETRY[0]));
            return Searching::Wait("is about to plan");
        }
        self.waiting = None;
        Searching::Failed(no_route)
    }
}

/// How long an obstacle is waited for, s: until the goal's deadline, at which the goal ends; without one, as long as the setting says.
pub(super) fn patience(ctx: &Context) -> f64 {
    match ctx.goal.deadline {
        Some(_) => f64::INFINITY,
        None => ctx.config.settings.patience,
    }
}

/// The path of an answer; empty without one.
pub(super) fn path_of(answer: Result<Answer, NoAnswer>) -> Vec<Point2<f64>> {
    match answer {
        Ok(Answer::Motion(reply)) => match *reply {
            MotionReply::Plan(PlanReply {
                outcome: PlanOutcome::Found { path, .. },
                ..
            }) => path,
            _ => Vec::new(),
        },
        _ => Vec::new(),
    }
}
