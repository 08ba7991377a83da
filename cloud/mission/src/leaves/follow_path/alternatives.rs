//! Alternatives. When does the robot leave the path that it drives for another one? For one that the tree offers, one past the robots
//! that it gives way to, or the short way when what bars it leaves.

use zenav_behaviour_tree::{LeafIo, Status};

use super::{FollowPath, Memory};
use crate::context::Context;
use crate::leaves::ports::path_on;
use crate::leaves::remember;
use crate::motion::{PlanStatus, Recheck};
use crate::route::{Route, RouteData, RouteRequest, Search, Searching, is_long, short_way_opens};

/// Another path is taken if it saves at least this much time over the driven one, waits for other robots included, s; time between two
/// searches for one, s.
const WORTH_IT: f64 = 1.0;
const LOOK_PERIOD: f64 = 0.4;
/// That time doubles after every fourth search, so often at most.
const MOST_DOUBLED: u32 = 3;
/// A search for such a path is given up after this, s: the other robots are elsewhere by then.
const OTHER_SECS: f64 = 2.0;

impl FollowPath {
    /// The tree may write a newer path to the port while this one is driven.
    pub(super) fn look_for_offer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, memory: &mut Memory) {
        let sequence = io.sequence("path");
        if sequence == self.path_sequence {
            return;
        }
        self.path_sequence = sequence;
        if let Ok(data) = path_on(io, "path")
            && !data.points.is_empty()
            && let Some(data) = data.settled(&ctx.frames)
        {
            let route = ctx.route(data.route);
            if let Some(route) = &route
                && memory.goal == data.goal
                && self.weighs(ctx, &data, route)
            {
                return;
            }
            self.offered = route;
            if memory.goal != data.goal {
                memory.goal = data.goal;
                remember(io, memory);
            }
            if self.tracking.follow(data.clone()) && self.offered.is_none() {
                self.follow_points(ctx, &data);
            }
        }
    }

    /// Whether an offered route is left to this leaf's own search: one through the same goals, much longer than the plan in force, while
    /// something blocks that. The search weighs it against waiting.
    fn weighs(&mut self, ctx: &mut Context, data: &RouteData, route: &Route) -> bool {
        let is_same_way = data.via == self.tracking.goals_ahead();
        if ctx.config.settings.patience <= 0.0 || !is_same_way || !is_long(ctx, &data.via, route) {
            return false;
        }
        if let Some(search) = &self.search {
            return search.is_waiting() || self.blocked_at.is_some();
        }
        match ctx.recheck_rest() {
            Ok(Recheck::Blocked(ahead)) if ctx.motion.status() == Some(&PlanStatus::Taken) => {
                if self.needs_replan(ctx, ahead) {
                    self.replan(ctx, data.goal, ahead);
                }
                true
            }
            _ => false,
        }
    }

    /// Searches for another path: past the robots that this one gives way to, or the short way when what bars it leaves. Takes it if the
    /// robot arrives sooner than on the driven one.
    pub(super) fn look_for_sooner(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, memory: Memory) -> Option<Status> {
        let Some(mut search) = self.other.take() else {
            if ctx.now < self.next_other || !self.tracking.goals_ahead().is_empty() {
                return None;
            }
            let opens = short_way_opens(ctx);
            if ctx.yields().is_none() {
                self.others = 0;
                if !opens {
                    return None;
                }
            }
            let request = RouteRequest {
                past_others: !opens,
                ..RouteRequest::to(memory.goal)
            };
            self.other = Some(Search::new(ctx, request, None, ctx.now).standing());
            self.others = self.others.saturating_add(1);
            return None;
        };
        // The longer the wait lasts, the less often.
        let doubled = f64::from(1 << (self.others / 4).min(MOST_DOUBLED));
        self.next_other = ctx.now.plus_secs(LOOK_PERIOD * doubled);
        match search.step(ctx) {
            Searching::Wait(_) if search.age(ctx.now) < OTHER_SECS + 2.0 * ctx.latency_budget() => {
                self.other = Some(search)
            }
            Searching::Wait(_) => {
                search.watch_short_way(ctx);
                search.cancel(ctx);
            }
            Searching::Found(route) => {
                let left = ctx.progress().map(|plan| plan.time_left);
                let waits = ctx.yields().map_or(0.0, |yields| yields.wait_secs);
                let arrival = route.arrival_secs.unwrap_or_else(|| route.plan.trajectory.duration());
                if left.is_some_and(|left| arrival + ctx.latency_budget() + WORTH_IT < left + waits)
                    && route.goal == memory.goal
                    && self.fits(ctx, &route)
                    && ctx.recheck_new(&route.plan.trajectory) == Ok(Recheck::Free)
                {
                    ctx.goal.avoided = None;
                    return Some(self.drive(io, ctx, memory, &route));
                }
                search.watch_short_way(ctx);
            }
            Searching::Blocked(_) | Searching::Nearer(_) | Searching::Failed(_) => {
                search.watch_short_way(ctx);
                search.cancel(ctx);
            }
        }
        None
    }

    pub(super) fn stop_other(&mut self, ctx: &mut Context) {
        if let Some(other) = self.other.take() {
            other.cancel(ctx);
        }
    }
}
