//! Answers of motion workers. Is there a route, a reason why there is none, or something to wait for?

use zenav_protocol::messages::{
    GoalPoint, MapRef, MotionReply, PlanOutcome, PlanReply, PlanStatistics, check_backwards,
};
use zenav_protocol::trajectory::Trajectory;

use super::begin::Begin;
use super::{NO_WORKER, NoRoute, Route, Search, Searching, Stage, error_code, failed};
use crate::context::Context;
use crate::io::{Answer, NoAnswer};
use crate::leaves::path::{self, DrivenPath};
use crate::motion::PlanDraft;

/// A path shorter than this counts as being at the goal, m.
const AT_GOAL: f64 = 0.05;

impl Search {
    /// Handles a worker's path, and its trajectory if one was asked for.
    pub(super) fn answered(&mut self, ctx: &mut Context, begin: Begin, answer: Result<Answer, NoAnswer>) -> Searching {
        self.unanswered = matches!(answer, Err(NoAnswer::Silent(_)));
        let reply = match answer {
            Ok(Answer::Motion(reply)) => *reply,
            Err(NoAnswer::Refused(refusal)) => {
                return failed(error_code::UNKNOWN, format!("the motion worker refuses: {refusal}"));
            }
            Err(NoAnswer::Silent(_)) => {
                // Bounded by the goal's own deadline.
                return self.again(ctx, NO_WORKER);
            }
            Ok(_) => return off_topic(),
        };
        let (plan, smooth) = match reply {
            MotionReply::Plan(plan) if self.request.from.is_some() => (plan, None),
            MotionReply::Trajectory(reply) if self.request.from.is_none() => {
                self.arrival_secs = reply.arrival_secs;
                (reply.plan, reply.smooth)
            }
            _ => return off_topic(),
        };
        if plan.map.frame != ctx.frames.at() || self.frame != ctx.frames.at() {
            return self.again(ctx, "plans anew: the map has moved");
        }
        let points = match plan.outcome {
            PlanOutcome::Found { ref path, .. } => path.clone(),
            PlanOutcome::NoMap if ctx.now.secs_since(self.begun) < ctx.config.settings.retries.map_wait => {
                return self.again(ctx, "waits until the motion worker has the map");
            }
            _ if self.request.past_others => {
                return failed(
                    error_code::NO_VALID_PATH,
                    "no path leads past the other robots".to_owned(),
                );
            }
            _ => return self.no_path(ctx, &begin, &plan),
        };
        let is_finite = points.iter().all(|p| p.x.is_finite() && p.y.is_finite());
        if points.len() < 2 || !is_finite || check_backwards(&plan.backwards, points.len()).is_err() {
            return failed(error_code::UNKNOWN, "the planner returned an invalid path".to_owned());
        }
        if !self.request.past_others
            && let Some(waits) = self.until_the_goal_is_uncovered(ctx, &begin, &points)
        {
            return waits;
        }
        if plan.escapes {
            tracing::info!(
                goal = ctx.goal.id,
                x = points[1].x,
                y = points[1].y,
                "leaves an obstacle"
            );
            ctx.goal.feedback.recoveries += 1;
        }
        let (planner, search_ms) = (self.planner.clone(), plan.search_ms);
        let statistics = |found: PlanStatistics| PlanStatistics {
            planner,
            search_ms,
            ..found
        };
        let backwards = plan.backwards;
        let path = DrivenPath { points, backwards };
        match smooth {
            None if self.request.from.is_some() => {
                let statistics = statistics(PlanStatistics::default());
                self.found(begin, path, plan.map, Trajectory::default(), statistics)
            }
            None => off_topic(),
            // If there is nothing to drive, the goal is the only waypoint.
            Some(smooth) if smooth.trajectory.is_empty() && path::length(&path.points) >= AT_GOAL => {
                let goal = named(&self.request.goal);
                let reason = format!("the path to {goal} cannot be driven: {}", smooth.statistics.status);
                let code = error_code::UNKNOWN;
                self.unless_an_end_is_taken(ctx, &begin, &path.points, NoRoute { code, reason })
            }
            Some(smooth) => {
                let statistics = statistics(smooth.statistics);
                let route = self.route(begin, path, smooth.map, smooth.trajectory, statistics);
                self.unless_waiting_is_sooner(ctx, route)
            }
        }
    }

    /// Handles the trajectory along the given path; without one, another path is planned.
    pub(super) fn smoothed(
        &mut self,
        ctx: &mut Context,
        begin: Begin,
        path: DrivenPath,
        answer: Result<Answer, NoAnswer>,
    ) -> Searching {
        self.unanswered = matches!(answer, Err(NoAnswer::Silent(_)));
        let why = match answer {
            Ok(Answer::Motion(reply)) => match *reply {
                MotionReply::Smooth(reply) if reply.map.frame != ctx.frames.at() || self.frame != ctx.frames.at() => {
                    return self.again(ctx, "plans anew: the map has moved");
                }
                MotionReply::Smooth(reply) if !reply.trajectory.is_empty() || path::length(&path.points) < AT_GOAL => {
                    return self.found(begin, path, reply.map, reply.trajectory, reply.statistics);
                }
                MotionReply::Smooth(reply) => reply.statistics.status,
                _ => return off_topic(),
            },
            Err(NoAnswer::Refused(refusal)) => refusal.to_string(),
            Err(NoAnswer::Silent(_)) => return self.again(ctx, NO_WORKER),
            Ok(_) => return off_topic(),
        };
        tracing::info!(goal = ctx.goal.id, why, "the given path cannot be driven");
        self.request.given = DrivenPath::default();
        self.stage = Stage::Idle(ctx.now);
        Searching::Wait("plans another path: the given one cannot be driven")
    }

    /// Why there is no path, unless it can be waited for.
    fn no_path(&mut self, ctx: &mut Context, begin: &Begin, plan: &PlanReply) -> Searching {
        self.goes_round = false;
        let goal = named(self.request.via.get(plan.leg).unwrap_or(&self.request.goal));
        let (code, reason) = match &plan.outcome {
            PlanOutcome::GoalOccupied { nearest_free } => {
                let near = nearest_free
                    .map(|p| format!("; the nearest free place is ({:.2}, {:.2})", p.x, p.y))
                    .unwrap_or_default();
                let reason =
                    format!("the goal {goal} is occupied: by the map of now the robot does not fit there{near}");
                (error_code::GOAL_OCCUPIED, reason)
            }
            PlanOutcome::StartOccupied { .. } => (
                error_code::START_OCCUPIED,
                "by the map the robot does not fit where it stands".to_owned(),
            ),
            PlanOutcome::NoPath => (
                error_code::NO_VALID_PATH,
                format!("no path: the goal {goal} is closed off from the robot"),
            ),
            PlanOutcome::OutOfMap => (
                error_code::OUTSIDE_MAP,
                format!("the robot or the goal {goal} lies outside the map"),
            ),
            PlanOutcome::TimedOut => (error_code::TIMEOUT, "the search took too long".to_owned()),
            PlanOutcome::NoMap | PlanOutcome::Found { .. } => (
                error_code::UNKNOWN,
                "the motion worker has no map of this robot".to_owned(),
            ),
        };
        self.unless_it_leaves(ctx, begin, NoRoute { code, reason })
    }

    fn found(
        &mut self,
        begin: Begin,
        path: DrivenPath,
        map: MapRef,
        trajectory: Trajectory,
        statistics: PlanStatistics,
    ) -> Searching {
        let route = self.route(begin, path, map, trajectory, statistics);
        self.takes(route)
    }

    fn route(
        &self,
        begin: Begin,
        path: DrivenPath,
        map: MapRef,
        trajectory: Trajectory,
        statistics: PlanStatistics,
    ) -> Box<Route> {
        Box::new(Route {
            arrival_secs: self.arrival_secs,
            ..route(begin, self.request.goal, path, map, trajectory, statistics)
        })
    }

    pub(super) fn takes(&mut self, route: Box<Route>) -> Searching {
        self.waiting = None;
        Searching::Found(route)
    }
}

/// A route that is not yet kept, and so has no id.
pub(super) fn route(
    begin: Begin,
    goal: GoalPoint,
    path: DrivenPath,
    map: MapRef,
    trajectory: Trajectory,
    statistics: PlanStatistics,
) -> Route {
    let plan = PlanDraft {
        map,
        waypoints: path.points.iter().skip(1).copied().collect(),
        trajectory,
        splice: begin.splice,
        statistics,
    };
    Route {
        id: 0,
        goal,
        length: path::length(&path.points),
        path,
        begin: begin.pose,
        plan,
        arrival_secs: None,
    }
}

/// Text of a goal.
pub(super) fn named(goal: &GoalPoint) -> String {
    format!("({:.2}, {:.2})", goal.x, goal.y)
}

fn off_topic() -> Searching {
    let reason = "the motion worker answered another request".to_owned();
    failed(error_code::UNKNOWN, reason)
}
