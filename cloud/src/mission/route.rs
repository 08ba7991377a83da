//! How does a goal become a motion? A way is asked of a planning worker, a trajectory of a smoothing worker.
//!
//! A robot that drives is planned for from the state predicted on its motion, one latency budget ahead; one that stands
//! from where it stands; one that moves otherwise is waited for. Smoothing never fails a plan: without it the way goes
//! out with a safe time law.

use nalgebra::{Point2, Vector2};
use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::GridSpec;
use zenav_protocol::messages::*;
use zenav_protocol::time::Stamp;

use super::context::Context;
use super::exchange::{Answer, Ask, NoAnswer, Ticket};
use super::motion::{Course, Standing};
use crate::smoothing::unsmoothed;
use crate::smoothing::worker::PERIOD;

/// Nav2's codes of why there is no path.
pub mod error_code {
    /// There is one.
    pub const NONE: i64 = 0;
    /// Something else.
    pub const UNKNOWN: i64 = 200;
    /// The start lies outside the map.
    pub const OUTSIDE_MAP: i64 = 204;
    /// The robot does not fit where it stands.
    pub const START_OCCUPIED: i64 = 205;
    /// It does not fit where it is to go.
    pub const GOAL_OCCUPIED: i64 = 206;
    /// The search took too long.
    pub const TIMEOUT: i64 = 207;
    /// Start and goal are not connected.
    pub const NO_VALID_PATH: i64 = 208;
}

/// Wait before a worker is asked again, s.
const RETRY: f64 = 0.5;
/// Time to wait for a map that the worker does not have, s.
const MAP_PATIENCE: f64 = 20.0;
/// Time to wait for the robot to stand, s.
const REST_PATIENCE: f64 = 10.0;
/// Less than this left of a motion is driven to its end before the next begins, s.
const SHORT_REST: f64 = 0.4;
/// Nearer to the border of the map than this nothing is gained by going on, m.
const LEAST_STEP: f64 = 0.15;
/// A way shorter than this is none, m.
const AT_GOAL: f64 = 0.05;
/// A start that the map has occupied may be left by this much, m.
const ESCAPE: f64 = 0.6;

/// A found way and its trajectory.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// Its name.
    pub id: u64,
    /// Where to.
    pub goal: GoalPoint,
    /// Corner points, start and goal included.
    pub path: Vec<Point2<f64>>,
    /// Length of the way, m.
    pub length: f64,
    /// Where it begins.
    pub begin: Pose2,
    /// It ends where the map does: the goal lies beyond.
    pub partial: bool,
    /// What is to be published.
    pub course: Course,
}

/// A route as it stands on the blackboard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RouteData {
    /// Name of the route; unknown after a restart.
    pub route: u64,
    /// Where to.
    pub goal: GoalPoint,
    /// Corner points, map frame.
    pub points: Vec<Point2<f64>>,
    /// Length, m.
    pub length: f64,
}

/// Why there is no route.
#[derive(Clone, Debug, PartialEq)]
pub struct NoRoute {
    /// Nav2's code.
    pub code: i64,
    /// In words.
    pub reason: String,
}

/// How a search stands.
#[derive(Clone, Debug, PartialEq)]
pub enum Searching {
    /// Not done; what it waits for.
    Wait(&'static str),
    /// Found.
    Found(Box<Route>),
    /// Not found.
    Failed(NoRoute),
}

/// The state that a route begins in.
#[derive(Clone, Debug, PartialEq)]
struct Begin {
    pose: Pose2,
    twist: Twist2,
    splice: Option<Splice>,
}

#[derive(Clone, Debug)]
enum Stage {
    /// Until this time nothing is asked.
    Idle(Stamp),
    Plan(Ticket, Begin),
    Smooth(Ticket, Begin, MapRef, Vec<Point2<f64>>, PlanStatistics),
}

/// A search for a route.
#[derive(Clone, Debug)]
pub struct Search {
    goal: GoalPoint,
    planner: String,
    unknown_is_free: bool,
    stage: Stage,
    begun: Stamp,
    /// The planner has said that the start is occupied, and where it is not.
    escape: Option<Point2<f64>>,
    /// Only from where the robot stands.
    from_rest: bool,
    /// Where the way leads while the goal lies outside the map.
    aim: Option<Point2<f64>>,
    /// The aim was occupied; this is the nearest place that is not.
    near_aim: Option<Point2<f64>>,
}

impl Search {
    /// Begins at `from` (now, or later).
    #[must_use]
    pub fn new(ctx: &Context, goal: GoalPoint, planner: Option<String>, from: Stamp) -> Self {
        Self {
            goal,
            planner: planner
                .filter(|name| !name.is_empty())
                .unwrap_or_else(|| ctx.config.planner.clone()),
            unknown_is_free: ctx.config.unknown_is_free,
            stage: Stage::Idle(from),
            begun: from,
            escape: None,
            from_rest: false,
            aim: None,
            near_aim: None,
        }
    }

    /// Waits until the robot stands, and begins there.
    #[must_use]
    pub fn from_rest(self) -> Self {
        Self {
            from_rest: true,
            ..self
        }
    }

    /// Gives the search up.
    pub fn cancel(self, ctx: &mut Context) {
        match self.stage {
            Stage::Plan(ticket, _) | Stage::Smooth(ticket, ..) => ctx.asks.forget(ticket),
            Stage::Idle(_) => {}
        }
    }

    /// Goes on as far as the answers that are there allow.
    pub fn step(&mut self, ctx: &mut Context) -> Searching {
        match self.stage.clone() {
            Stage::Idle(from) if ctx.now < from => Searching::Wait("is about to plan"),
            Stage::Idle(_) => self.ask_plan(ctx),
            Stage::Plan(ticket, begin) => match ctx.asks.take(ticket) {
                None => Searching::Wait("plans"),
                Some(answer) => self.planned(ctx, begin, answer),
            },
            Stage::Smooth(ticket, begin, map, path, statistics) => match ctx.asks.take(ticket) {
                None => Searching::Wait("smooths"),
                Some(answer) => self.smoothed(ctx, begin, map, path, statistics, answer),
            },
        }
    }

    fn ask_plan(&mut self, ctx: &mut Context) -> Searching {
        let Some(model) = ctx.robot.model().cloned() else {
            return Searching::Wait("waits for the robot's description");
        };
        let Some(map) = ctx.map.newest() else {
            return Searching::Wait("waits for a map");
        };
        let begin = match predicted(ctx, self.from_rest) {
            Ok(begin) => begin,
            Err(why) if ctx.now.secs_since(self.begun) < REST_PATIENCE => return Searching::Wait(why),
            Err(why) => return self.failed(error_code::UNKNOWN, format!("{why}, and it did not")),
        };
        self.aim = match ctx
            .map
            .spec()
            .filter(|spec| spec.cell_at(Point2::new(self.goal.x, self.goal.y)).is_none())
        {
            Some(spec) if self.unknown_is_free => {
                let inset = model.footprint.circumscribed_radius() + 2.0 * spec.resolution;
                match self.near_aim.or_else(|| {
                    border(
                        &spec,
                        begin.pose.position(),
                        Point2::new(self.goal.x, self.goal.y),
                        inset,
                    )
                }) {
                    Some(aim) => Some(aim),
                    None => return self.failed(error_code::OUTSIDE_MAP, "the goal lies outside the map".to_owned()),
                }
            }
            _ => None,
        };
        let aim = self.aim.unwrap_or_else(|| Point2::new(self.goal.x, self.goal.y));
        let start = self
            .escape
            .map_or(begin.pose, |free| Pose2::new(free.x, free.y, begin.pose.yaw));
        let request = PlanRequest {
            robot: ctx.config.robot.to_string(),
            model,
            map,
            start,
            goal: Pose2::new(aim.x, aim.y, self.goal.yaw.unwrap_or(0.0)),
            planner: self.planner.clone(),
            unknown_is_free: self.unknown_is_free,
            budget_ms: ctx.config.search_budget_ms,
        };
        self.stage = Stage::Plan(ctx.asks.ask(Ask::Plan(Box::new(request))), begin);
        Searching::Wait("plans")
    }

    fn planned(&mut self, ctx: &mut Context, begin: Begin, answer: Result<Answer, NoAnswer>) -> Searching {
        let reply = match answer {
            Ok(Answer::Plan(reply)) => reply,
            Ok(_) => {
                return self.failed(
                    error_code::UNKNOWN,
                    "the planner's answer was about something else".to_owned(),
                );
            }
            Err(NoAnswer::Refused(refusal)) => {
                return self.failed(error_code::UNKNOWN, format!("the planner refuses: {refusal}"));
            }
            Err(NoAnswer::Silent(_)) => {
                // The goal's own deadline bounds this.
                self.again(ctx);
                return Searching::Wait("waits for a planning worker");
            }
        };
        let statistics = PlanStatistics {
            planner: self.planner.clone(),
            search_ms: reply.search_ms,
            ..PlanStatistics::default()
        };
        match reply.outcome {
            PlanOutcome::Found { mut path, .. } => {
                if self.escape.is_some() {
                    path.insert(0, begin.pose.position());
                }
                if path.len() == 1 {
                    // The robot is there.
                    path.insert(0, begin.pose.position());
                }
                if path.len() < 2 || !path.iter().all(|p| p.x.is_finite() && p.y.is_finite()) {
                    return self.failed(error_code::UNKNOWN, "the planner's way is not one".to_owned());
                }
                let Some(model) = ctx.robot.model().cloned() else {
                    return Searching::Wait("waits for the robot's description");
                };
                let request = SmoothRequest {
                    robot: ctx.config.robot.to_string(),
                    model,
                    map: reply.map.clone(),
                    path: path.clone(),
                    start: begin.pose,
                    start_velocity: begin.twist,
                    goal_yaw: self.goal.yaw.filter(|_| self.aim.is_none()),
                    unknown_is_free: self.unknown_is_free,
                };
                let ticket = ctx.asks.ask(Ask::Smooth(Box::new(request)));
                self.stage = Stage::Smooth(ticket, begin, reply.map, path, statistics);
                Searching::Wait("smooths")
            }
            PlanOutcome::GoalOccupied {
                nearest_free: Some(free),
            } if self.aim.is_some() && self.near_aim.is_none() => {
                self.near_aim = Some(free);
                self.stage = Stage::Idle(ctx.now);
                Searching::Wait("plans towards the goal")
            }
            PlanOutcome::GoalOccupied { nearest_free } => {
                let near = nearest_free
                    .map(|p| format!("; the nearest free place is {:.2}, {:.2}", p.x, p.y))
                    .unwrap_or_default();
                self.failed(error_code::GOAL_OCCUPIED, format!("the goal is occupied{near}"))
            }
            PlanOutcome::StartOccupied {
                nearest_free: Some(free),
            } if self.escape.is_none() && (free - begin.pose.position()).norm() < ESCAPE => {
                self.escape = Some(free);
                self.stage = Stage::Idle(ctx.now);
                Searching::Wait("plans from the nearest free place")
            }
            PlanOutcome::StartOccupied { .. } => self.failed(
                error_code::START_OCCUPIED,
                "by the map the robot does not fit where it stands".to_owned(),
            ),
            PlanOutcome::NoPath => self.failed(
                error_code::NO_VALID_PATH,
                "no path: start and goal are not connected".to_owned(),
            ),
            PlanOutcome::OutOfMap => {
                self.failed(error_code::OUTSIDE_MAP, "start or goal lie outside the map".to_owned())
            }
            PlanOutcome::TimedOut => self.failed(error_code::TIMEOUT, "the search took too long".to_owned()),
            PlanOutcome::NoMap if ctx.now.secs_since(self.begun) < MAP_PATIENCE => {
                self.again(ctx);
                Searching::Wait("waits until the planner has the map")
            }
            PlanOutcome::NoMap => self.failed(error_code::UNKNOWN, "the planner has no map of this robot".to_owned()),
        }
    }

    fn smoothed(
        &mut self,
        ctx: &mut Context,
        begin: Begin,
        map: MapRef,
        path: Vec<Point2<f64>>,
        planned: PlanStatistics,
        answer: Result<Answer, NoAnswer>,
    ) -> Searching {
        let length: f64 = path
            .windows(2)
            .map(|pair| pair.first().zip(pair.last()).map_or(0.0, |(a, b)| (b - a).norm()))
            .sum();
        let (map, trajectory, statistics) = match answer {
            // Where there is no way, none can be driven: the goal itself is the one waypoint.
            Ok(Answer::Smooth(reply)) if reply.trajectory.is_empty() && length < AT_GOAL => (map, Vec::new(), planned),
            Ok(Answer::Smooth(reply)) if reply.trajectory.is_empty() => {
                // The way itself is blocked by now.
                return self.failed(
                    error_code::NO_VALID_PATH,
                    format!("the way cannot be driven: {}", reply.statistics.status),
                );
            }
            Ok(Answer::Smooth(reply)) => {
                let statistics = PlanStatistics {
                    planner: planned.planner,
                    search_ms: planned.search_ms,
                    ..reply.statistics
                };
                (reply.map, reply.trajectory, statistics)
            }
            other => {
                let why = match other {
                    Err(NoAnswer::Refused(_)) => "fallback:smoother_refused",
                    _ => "fallback:no_smoother",
                };
                let Some(model) = ctx.robot.model() else {
                    return Searching::Wait("waits for the robot's description");
                };
                let safe = unsmoothed(&path, begin.pose, begin.twist, self.goal.yaw, model);
                let statistics = PlanStatistics {
                    planner: planned.planner,
                    search_ms: planned.search_ms,
                    length,
                    status: why.to_owned(),
                    ..safe.statistics
                };
                (map, safe.motion.trajectory(PERIOD), statistics)
            }
        };
        let course = Course {
            map,
            waypoints: path.iter().skip(1).copied().collect(),
            trajectory,
            splice: begin.splice,
            statistics,
        };
        Searching::Found(Box::new(Route {
            id: 0,
            goal: self.goal,
            path,
            length,
            begin: begin.pose,
            partial: self.aim.is_some(),
            course,
        }))
    }

    fn again(&mut self, ctx: &Context) {
        self.stage = Stage::Idle(ctx.now.plus_secs(RETRY));
    }

    fn failed(&mut self, code: i64, reason: String) -> Searching {
        Searching::Failed(NoRoute { code, reason })
    }
}

/// The state that the robot will be in when a plan made now comes into force.
fn predicted(ctx: &mut Context, from_rest: bool) -> Result<Begin, &'static str> {
    let (Some(pose), Some(state)) = (ctx.robot.pose(), ctx.robot.state()) else {
        return Err("waits for the robot");
    };
    // Also in the middle of a motion: something may hold the robot there.
    if ctx.robot.is_at_rest() {
        return Ok(Begin {
            pose,
            twist: Twist2::ZERO,
            splice: None,
        });
    }
    let ahead = ctx
        .motion
        .time(state, ctx.robot.state_age(ctx.now))
        .filter(|_| ctx.motion.standing() == Some(&Standing::Taken));
    // A motion that is held runs on to where the new one begins, if slower.
    let follows = state.mode == Mode::Follow && !from_rest;
    if let (Some(time), true, Some(plan)) = (ahead, follows, ctx.motion.plan()) {
        let time = (time + ctx.config.latency_budget).max(0.0);
        let end = plan.trajectory.last().map_or(0.0, |point| point.t);
        if time + SHORT_REST < end {
            let point = sample(&plan.trajectory, time);
            let splice = Splice {
                trajectory_id: plan.trajectory_id,
                time,
            };
            return Ok(Begin {
                pose: point.pose(),
                twist: point.twist(),
                splice: Some(splice),
            });
        }
    }
    Err("waits for the robot to stand")
}

/// Where a trajectory is at a time, linear between its points; held at both ends.
#[must_use]
pub fn sample(trajectory: &[TrajectoryPoint], t: f64) -> TrajectoryPoint {
    let after = trajectory.partition_point(|point| point.t <= t);
    let (Some(from), to) = (trajectory.get(after.saturating_sub(1)), trajectory.get(after)) else {
        return TrajectoryPoint::default();
    };
    let Some(to) = to.filter(|to| after > 0 && to.t > from.t) else {
        return *from;
    };
    let share = (t - from.t) / (to.t - from.t);
    let between = |a: f64, b: f64| a + share * (b - a);
    let turn = zenav_protocol::geometry::wrap_angle(to.yaw - from.yaw);
    TrajectoryPoint {
        t,
        x: between(from.x, to.x),
        y: between(from.y, to.y),
        yaw: zenav_protocol::geometry::wrap_angle(from.yaw + share * turn),
        v: between(from.v, to.v),
        w: between(from.w, to.w),
    }
}

/// The last place on the straight way to a goal outside the grid that lies at least `inset` (m) inside; `None` where the
/// robot is there already.
fn border(spec: &GridSpec, from: Point2<f64>, to: Point2<f64>, inset: f64) -> Option<Point2<f64>> {
    let size = Vector2::new(f64::from(spec.width), f64::from(spec.height)) * spec.resolution;
    let (low, high) = (
        spec.origin + Vector2::repeat(inset),
        spec.origin + size - Vector2::repeat(inset),
    );
    let way = to - from;
    let mut share: f64 = 1.0;
    for axis in 0..2 {
        let end = if way[axis] > 0.0 { high[axis] } else { low[axis] };
        if way[axis] != 0.0 {
            share = share.min((end - from[axis]) / way[axis]);
        }
    }
    (share.is_finite() && share * way.norm() > LEAST_STEP).then(|| from + way * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_goal_beyond_the_map_is_aimed_at_up_to_its_border() {
        let spec = GridSpec {
            origin: Point2::new(-2.0, -2.0),
            resolution: 0.1,
            width: 40,
            height: 40,
        };
        let aim = border(&spec, Point2::origin(), Point2::new(10.0, 5.0), 0.5);
        assert!(
            aim.is_some_and(|aim| (aim - Point2::new(1.5, 0.75)).norm() < 1e-9),
            "{aim:?}"
        );
        assert_eq!(border(&spec, Point2::new(1.45, 0.0), Point2::new(10.0, 0.0), 0.5), None);
        assert_eq!(border(&spec, Point2::new(1.9, 0.0), Point2::new(10.0, 0.0), 0.5), None);
    }

    #[test]
    fn a_trajectory_is_held_at_both_ends() {
        let points = [0.0, 1.0].map(|t| TrajectoryPoint {
            t,
            x: 2.0 * t,
            ..TrajectoryPoint::default()
        });
        assert!((sample(&points, 0.25).x - 0.5).abs() < 1e-12);
        assert_eq!(
            (sample(&points, -1.0).x, sample(&points, 5.0).x, sample(&[], 1.0).x),
            (0.0, 2.0, 0.0)
        );
    }
}
