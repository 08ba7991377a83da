//! Way round. A shorter way is barred by what may leave: is it sooner to wait, or to drive round?
//!
//! The robot waits while the way round costs more time than the expected wait, which is as long as the obstacle has stood there so far. Of
//! an obstacle that the robot saw arrive, this is the rule of the ski rental problem: wait for as long as the other choice costs. The time
//! lost is then at most twice that of the best choice in hindsight, and no deterministic rule guarantees less (Karlin, Manasse, Rudolph
//! and Sleator, "Competitive snoopy caching", Algorithmica 3, 1988). An obstacle that had stood there before is waited for less.
//!
//! A moving robot drives on meanwhile, up to where it keeps its distance from the obstacle; if it cannot stop there any more, it drives round
//! at once. On the way round, the short way is searched again when part of the obstacle has left.
//!
//! What the robot touched while driving is driven round at once: no beam shows it, so none would see it leave.

use nalgebra::Point2;
use zenav_protocol::messages::GoalPoint;
use zenav_smoothing::Limits;

use super::approach::PLAN_STEP;
use super::barred::{RETRY, path_of, patience};
use super::waiting::{Waiting, reach};
use super::{Route, Search, Searching, Stage};
use crate::context::Context;
use crate::io::{Answer, NoAnswer};
use crate::leaves::path;
use crate::motion::{BLOCKED_WITHIN, Recheck};
use crate::transient::TransientCell;

/// A route that takes less than this longer than the rest of the plan in force is as long, s.
const LONGER: f64 = 0.5;
/// The way round is taken while it leads to the goal before its deadline, with this share of its duration to spare.
const SPARE: f64 = 0.2;

impl Search {
    /// Takes a route, unless it is much longer than necessary: then asks what the way would be without the obstacles that may leave.
    pub(super) fn unless_waiting_is_sooner(&mut self, ctx: &mut Context, route: Box<Route>) -> Searching {
        let is_given = self.goes_round || self.request.past_others || !self.may_wait(ctx);
        if is_given || !is_long(ctx, &self.request.via, &route) {
            return self.takes(route);
        }
        if let Some(splice) = route.plan.splice {
            return self.weigh_in_motion(ctx, route, splice.time);
        }
        let places: Vec<Point2<f64>> = [route.begin.position()].into_iter().chain(barred_at(ctx)).collect();
        self.cleared = self.what_may_be_seen_to_leave(ctx, &places);
        match self.ask_without_what_may_leave(ctx, route.begin) {
            Some(ticket) => {
                self.stage = Stage::Weighed(ticket, route);
                Searching::Wait("asks what bars the short way")
            }
            None => self.takes(route),
        }
    }

    /// The same for a moving robot. The short way is the rest of the plan in force, from plan time `from` on; only what has come onto it is
    /// waited for.
    fn weigh_in_motion(&mut self, ctx: &mut Context, route: Box<Route>, from: f64) -> Searching {
        if !self.replaces {
            let stands = self.waiting.as_ref().is_some_and(|waiting| waiting.now(ctx).is_some());
            if !stands || !self.may_approach || is_urgent(ctx, &route) {
                return self.takes(route);
            }
            // The plan in force is an approach: at its end, the robot weighs again.
            self.again_at(ctx.now.plus_secs(RETRY[1]));
            return Searching::Wait("is about to plan");
        }
        let barred = blocked_from(ctx, from);
        let (Some(barred), Some(plan)) = (barred, ctx.motion.trajectory()) else {
            return self.takes(route);
        };
        let cost = route.plan.trajectory.duration() - (plan.end_time() - from);
        let ahead: Vec<(f64, Point2<f64>)> = plan
            .spaced(from, PLAN_STEP, f64::INFINITY)
            .map(|point| (point.t, point.position()))
            .collect();
        let beyond = ahead.iter().filter(|(t, _)| *t >= barred);
        let beyond: Vec<Point2<f64>> = beyond.map(|(_, place)| *place).collect();
        let beyond = path::part(&beyond, 0.0, BLOCKED_WITHIN);
        let mut cells = self.what_may_be_seen_to_leave(ctx, beyond.get(..1).unwrap_or_default());
        cells.retain(|cell| cell.since.is_some());
        let least = ctx.config.settings.least_wait;
        let waiting = Waiting::on(&beyond, &cells, reach(ctx), ctx.now).filter(|_| cost > least);
        let Some(mut waiting) = waiting else {
            return self.takes(route);
        };
        waiting.way = ahead.into_iter().map(|(_, place)| place).collect();
        waiting.keeps_off = true;
        let waits = self.waiting.as_ref().is_some_and(|waiting| waiting.keeps_off);
        if !waits && !waiting.may_be_kept_off(ctx) {
            // In front of the obstacle the robot may have no room to set out again.
            ctx.goal.avoided = Some(waiting);
            return self.takes(route);
        }
        self.wait_or_go_round(ctx, route, waiting, cost)
    }

    /// Transient cells near these places and the goals, without those that the robot felt.
    fn what_may_be_seen_to_leave(&self, ctx: &Context, places: &[Point2<f64>]) -> Vec<TransientCell> {
        let mut cells = self.what_may_leave(ctx, places);
        cells.retain(|cell| !cell.since.is_some_and(|since| ctx.robot.has_felt(cell.center, since)));
        cells
    }

    /// The answer to that request: waits for the first obstacle on the short way, or drives round it.
    pub(super) fn weigh(
        &mut self,
        ctx: &mut Context,
        route: Box<Route>,
        answer: Result<Answer, NoAnswer>,
    ) -> Searching {
        let (short, cells) = (path_of(answer), std::mem::take(&mut self.cleared));
        // At the same mean speed.
        let cost = route.plan.trajectory.duration() * (1.0 - path::length(&short) / route.length);
        let least = ctx.config.settings.least_wait;
        match Waiting::on(&short, &cells, reach(ctx), ctx.now).filter(|_| cost > least) {
            Some(waiting) => self.wait_or_go_round(ctx, route, waiting, cost),
            None => self.takes(route),
        }
    }

    /// Waits for an obstacle, or takes the route round it, which costs this much more time than the short way, s.
    fn wait_or_go_round(&mut self, ctx: &mut Context, route: Box<Route>, mut waiting: Waiting, cost: f64) -> Searching {
        self.doubts = false;
        waiting.note(ctx);
        ctx.goal.avoided = Some(waiting.clone());
        let stood = waiting.stood(ctx.now);
        if is_worth_waiting(cost, stood, ctx.config.settings.least_wait)
            && stood <= patience(ctx)
            && !is_urgent(ctx, &route)
        {
            return self.wait_for(ctx, waiting);
        }
        tracing::info!(goal = ctx.goal.id, stood, cost, "drives round what may leave");
        self.takes(route)
    }

    /// Plan time at which a moving robot is to be at rest on the plan in force while it waits, s.
    pub(crate) fn stops_at(&self, ctx: &Context) -> Option<f64> {
        let waiting = self.waiting.as_ref().filter(|_| self.keeps_off())?;
        waiting.kept_off_until(ctx)
    }

    /// Whether a moving robot waits on the plan in force although there is a way round.
    pub(crate) fn keeps_off(&self) -> bool {
        self.replaces && self.waiting.as_ref().is_some_and(|waiting| waiting.keeps_off)
    }

    /// Whether it waits for an obstacle.
    pub(crate) fn is_waiting(&self) -> bool {
        self.waiting.is_some()
    }

    /// Takes a long route without weighing it against waiting: for a plan in force that is free.
    pub(crate) fn at_once(mut self) -> Self {
        self.goes_round = true;
        self
    }

    /// This search for the short way was in vain: the next one is due when part of what bars it now has left.
    pub(crate) fn watch_short_way(&self, ctx: &mut Context) {
        if !self.request.past_others {
            ctx.goal.avoided = ctx.goal.avoided.take().and_then(|avoided| avoided.now(ctx));
        }
    }
}

/// Whether a route takes much longer than a straight line at top speed through these goals, and longer than the rest of the plan in force.
pub(crate) fn is_long(ctx: &Context, via: &[GoalPoint], route: &Route) -> bool {
    let goals = via.iter().chain([&route.goal]);
    let goals = goals.map(GoalPoint::position);
    let corners: Vec<Point2<f64>> = [route.begin.position()].into_iter().chain(goals).collect();
    let speed = ctx.robot.model().map_or(f64::INFINITY, |model| Limits::of(model).speed);
    let straight = path::length(&corners) / speed;
    let left = ctx.goal.feedback.time_left.unwrap_or(0.0);
    let secs = route.plan.trajectory.duration();
    secs > straight + ctx.config.settings.least_wait && secs > left + LONGER
}

/// Whether to wait for an obstacle that has stood for some time, s, if the way round costs this much more time than the short way, s. The
/// least expected wait, s, holds of an obstacle that has just come.
fn is_worth_waiting(cost: f64, stood: f64, least: f64) -> bool {
    cost > stood.max(least)
}

/// Whether a way round leads to the goal before its deadline only if the robot takes it now.
fn is_urgent(ctx: &Context, route: &Route) -> bool {
    let left = ctx.goal.deadline.map(|deadline| deadline.secs_since(ctx.now));
    // The next attempt comes after a pause and two requests.
    let attempt = RETRY[1] + 2.0 * ctx.latency_budget();
    left.is_some_and(|left| is_last_chance(route.plan.trajectory.duration(), left, attempt))
}

/// Whether a way round, s, is in time only if the robot sets out now; `left` until the deadline and `attempt` until it is asked again, s.
fn is_last_chance(round: f64, left: f64, attempt: f64) -> bool {
    (round..(1.0 + SPARE) * round + attempt).contains(&left)
}

/// Where the plan in force is blocked.
fn barred_at(ctx: &mut Context) -> Option<Point2<f64>> {
    let time = ctx.plan_time()?;
    let barred = blocked_from(ctx, time)?;
    Some(ctx.motion.trajectory()?.sample(barred).position())
}

/// Plan time at which the rest of the plan in force is blocked, from a plan time on, s.
fn blocked_from(ctx: &mut Context, from: f64) -> Option<f64> {
    match ctx.recheck_from(from).ok()? {
        Recheck::Blocked(ahead) => Some(from + ahead),
        Recheck::Free => None,
    }
}

/// Whether part of the obstacle that the driven way leads round has left.
pub(crate) fn short_way_opens(ctx: &Context) -> bool {
    ctx.goal.avoided.as_ref().is_some_and(|avoided| avoided.gives_way(ctx))
}

#[cfg(test)]
mod tests;
