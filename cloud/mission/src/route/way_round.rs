//! Way round. A shorter way is barred by what may leave: is it sooner to wait, or to drive round?
//!
//! The robot waits while the way round costs more time than the expected wait, which is as long as the obstacle has stood there so far. Of
//! an obstacle that the robot saw arrive, this is the rule of the ski rental problem: wait for as long as the other choice costs. The time
//! lost is then at most twice that of the best choice in hindsight, and no deterministic rule guarantees less (Karlin, Manasse, Rudolph
//! and Sleator, "Competitive snoopy caching", Algorithmica 3, 1988). An obstacle that had stood there before is waited for less.
//!
//! On the way round, the short way is searched again when part of the obstacle has left.

use nalgebra::Point2;
use zenav_smoothing::Limits;

use super::waiting::{RETRY, Waiting, path_of, patience, reach};
use super::{Route, Search, Searching, Stage};
use crate::context::Context;
use crate::io::{Answer, NoAnswer};
use crate::leaves::path;
use crate::motion::Recheck;

/// Least expected wait, s: a way round that costs less is taken at once.
const LEAST_WAIT: f64 = 5.0;
/// A route that takes less than this longer than the rest of the plan in force is as long, s.
const LONGER: f64 = 0.5;
/// The way round is taken while it leads to the goal before its deadline, with this share of its duration to spare.
const SPARE: f64 = 0.2;

impl Search {
    /// Takes a route, unless it is much longer than necessary: then asks what the way would be without the obstacles that may leave.
    pub(super) fn unless_waiting_is_sooner(&mut self, ctx: &mut Context, route: Box<Route>) -> Searching {
        // A moving robot goes on: in front of the obstacle it may have no room to set out again.
        let is_moving = route.plan.splice.is_some();
        let is_given = is_moving || self.goes_round || self.request.past_others || !self.may_wait(ctx);
        if is_given || !self.is_long(ctx, &route) {
            return self.takes(route);
        }
        let places: Vec<Point2<f64>> = [route.begin.position()].into_iter().chain(barred_at(ctx)).collect();
        self.cleared = self.what_may_leave(ctx, &places);
        match self.ask_without_what_may_leave(ctx, route.begin) {
            Some(ticket) => {
                self.stage = Stage::Weighed(ticket, route);
                Searching::Wait("asks what bars the short way")
            }
            None => self.takes(route),
        }
    }

    /// Whether a route takes much longer than a straight line at top speed, and longer than the rest of the plan in force.
    fn is_long(&self, ctx: &Context, route: &Route) -> bool {
        let goals = self.request.via.iter().chain([&self.request.goal]);
        let goals = goals.map(|goal| Point2::new(goal.x, goal.y));
        let corners: Vec<Point2<f64>> = [route.begin.position()].into_iter().chain(goals).collect();
        let speed = ctx.robot.model().map_or(f64::INFINITY, |model| Limits::of(model).speed);
        let straight = path::length(&corners) / speed;
        let left = ctx.goal.feedback.time_left.unwrap_or(0.0);
        let secs = route.plan.trajectory.duration();
        secs > straight + LEAST_WAIT && secs > left + LONGER
    }

    /// The answer to that request: waits for the first obstacle on the short way, or drives round it.
    pub(super) fn weigh(
        &mut self,
        ctx: &mut Context,
        route: Box<Route>,
        answer: Result<Answer, NoAnswer>,
    ) -> Searching {
        let (short, cells) = (path_of(answer), std::mem::take(&mut self.cleared));
        let round = route.plan.trajectory.duration();
        // At the same mean speed.
        let cost = round * (1.0 - path::length(&short) / route.length);
        let Some(mut waiting) = Waiting::on(&short, &cells, reach(ctx), ctx.now).filter(|_| cost > LEAST_WAIT) else {
            return self.takes_after_asking(ctx, route);
        };
        self.doubts = false;
        waiting.note(ctx);
        ctx.goal.avoided = Some(waiting.clone());
        let stood = waiting.stood(ctx.now);
        let left = ctx.goal.deadline.map(|deadline| deadline.secs_since(ctx.now));
        // The next attempt comes after a pause and two requests.
        let attempt = RETRY[1] + 2.0 * ctx.latency_budget();
        let is_urgent = left.is_some_and(|left| is_last_chance(round, left, attempt));
        if is_worth_waiting(cost, stood) && stood <= patience(ctx) && !is_urgent {
            return self.wait_for(ctx, waiting);
        }
        tracing::info!(goal = ctx.goal.id, stood, cost, "drives round what may leave");
        self.takes_after_asking(ctx, route)
    }

    /// Takes a route that was found before the short way was asked for: by now a moving robot may be past the point where it begins.
    fn takes_after_asking(&mut self, ctx: &Context, route: Box<Route>) -> Searching {
        if route.plan.splice.is_some() {
            self.goes_round = true;
            self.stage = Stage::Idle(ctx.now);
            return Searching::Wait("plans");
        }
        self.takes(route)
    }

    /// The same, without weighing a long route against waiting: for a plan in force that is free.
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

/// Whether to wait for an obstacle that has stood for some time, s, if the way round costs this much more time than the short way, s.
fn is_worth_waiting(cost: f64, stood: f64) -> bool {
    cost > stood.max(LEAST_WAIT)
}

/// Whether a way round, s, is in time only if the robot sets out now; `left` until the deadline and `attempt` until it is asked again, s.
fn is_last_chance(round: f64, left: f64, attempt: f64) -> bool {
    (round..(1.0 + SPARE) * round + attempt).contains(&left)
}

/// Where the plan in force is blocked.
fn barred_at(ctx: &mut Context) -> Option<Point2<f64>> {
    let time = ctx.motion.time(ctx.robot.state()?, 0.0, 0.0)?;
    let space = ctx.space_now().ok()?;
    match ctx.motion.recheck(&space, time, ctx.config.settings.escape) {
        Recheck::Blocked(ahead) => Some(ctx.motion.here()?.sample(time + ahead).position()),
        Recheck::Free => None,
    }
}

/// Whether part of the obstacle that the driven way leads round has left.
pub(crate) fn short_way_opens(ctx: &Context) -> bool {
    ctx.goal.avoided.as_ref().is_some_and(|avoided| avoided.gives_way(ctx))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Time lost over a free short way, s: by waiting for an obstacle that leaves after some time, and by the way round if that is taken.
    fn lost(cost: f64, leaves: f64) -> f64 {
        let waits = |secs: &f64| is_worth_waiting(cost, *secs) && *secs < leaves;
        let waited = (0..).map(|tick| 0.1 * f64::from(tick)).find(|secs| !waits(secs));
        let waited = waited.unwrap_or(f64::INFINITY);
        if waited < leaves { waited + cost } else { waited }
    }

    #[test]
    fn waiting_and_driving_round_lose_at_most_twice_as_much_as_the_better_of_the_two() {
        for cost in [6.0, 10.0, 40.0, 110.0] {
            for leaves in [1.0, 4.0, 9.9, 10.1, 35.0, 60.0, 300.0] {
                let best = f64::min(cost, leaves);
                assert!(
                    lost(cost, leaves) <= 2.0 * best + 0.2,
                    "{cost} {leaves}: {}",
                    lost(cost, leaves)
                );
            }
        }
    }

    #[test]
    fn a_short_way_round_is_taken_at_once() {
        assert!(!is_worth_waiting(4.9, 0.0));
        assert!(is_worth_waiting(5.1, 0.0) && is_worth_waiting(30.0, 29.0));
        assert!(!is_worth_waiting(30.0, 31.0), "what has stood for long stays");
    }

    #[test]
    fn the_way_round_is_taken_while_it_is_in_time_and_not_when_it_would_be_late_anyway() {
        assert!(!is_last_chance(50.0, 61.0, 0.5));
        assert!(is_last_chance(50.0, 55.0, 0.5));
        assert!(is_last_chance(5.0, 8.0, 3.0), "the next attempt would come too late");
        assert!(!is_last_chance(50.0, 49.0, 0.5));
    }
}
