//! How does a goal become a motion? A way is asked of a planning worker, a trajectory of a smoothing worker.
//!
//! A robot that drives is planned for from the state predicted on its motion, one latency budget ahead; one that stands
//! from where it stands; one that moves otherwise is waited for. Smoothing never fails a plan: without it the way goes
//! out with a safe time law.

mod begin;
mod request;
mod room;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::*;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use super::context::Context;
use super::io::{Answer, Ask, NoAnswer, Ticket};
use super::leaves::path;
use super::motion::ActivePlan;
use begin::{Begin, predicted};
use request::Legs;
use room::Room;
use zenav_smoothing::PERIOD;
use zenav_smoothing::unsmoothed;

pub use request::RouteRequest;

/// Nav2's codes of why there is no path.
pub mod error_code {
    /// There is one.
    pub const NONE: i64 = 0;
    /// Something else.
    pub const UNKNOWN: i64 = 200;
    /// There is no such planner.
    pub const INVALID_PLANNER: i64 = 201;
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
    /// What is to be published.
    pub course: ActivePlan,
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
    /// Goals that it passes on the way, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub via: Vec<GoalPoint>,
    /// The place that the goal is, where it was named.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
}

/// Why there is no route.
#[derive(Clone, Debug, PartialEq)]
pub struct NoRoute {
    /// Nav2's code.
    pub code: i64,
    /// In words.
    pub reason: String,
}

impl NoRoute {
    /// Whether neither another place of the robot nor another try on the same map would help.
    #[must_use]
    pub fn is_final(&self) -> bool {
        [
            error_code::OUTSIDE_MAP,
            error_code::GOAL_OCCUPIED,
            error_code::NO_VALID_PATH,
        ]
        .contains(&self.code)
    }
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

#[derive(Clone, Debug)]
enum Stage {
    /// Until this time nothing is asked.
    Idle(Stamp),
    Plan(Ticket, Begin),
    Smooth(Ticket, Box<Smoothing>),
}

/// A way that is being smoothed.
#[derive(Clone, Debug)]
struct Smoothing {
    begin: Begin,
    /// The question.
    request: SmoothRequest,
    /// Length of the way, m.
    length: f64,
    /// What the planner said.
    planned: PlanStatistics,
}

/// A search for a route.
#[derive(Clone, Debug)]
pub struct Search {
    legs: Legs,
    planner: String,
    unknown_is_free: bool,
    stage: Stage,
    begun: Stamp,
    /// The planner has said that the start is occupied, and where it is not.
    escape: Option<Point2<f64>>,
    /// Only from where the robot stands.
    from_rest: bool,
    /// How large a disc stands for the robot.
    room: Room,
}

impl Search {
    /// Begins at `from` (now, or later).
    #[must_use]
    pub fn new(ctx: &Context, quest: RouteRequest, planner: Option<String>, from: Stamp) -> Self {
        let planner = planner
            .filter(|name| !name.is_empty())
            .unwrap_or_else(|| ctx.config.planner.clone());
        Self {
            legs: Legs::of(quest),
            unknown_is_free: ctx.config.unknown_is_free,
            stage: Stage::Idle(from),
            begun: from,
            escape: None,
            from_rest: false,
            room: Room::new(&planner),
            planner,
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
            Stage::Smooth(ticket, smoothing) => match ctx.asks.take(ticket) {
                None => Searching::Wait("smooths"),
                Some(answer) => self.smoothed(ctx, *smoothing, answer),
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
        let begin = self.legs.begin().map_or_else(|| predicted(ctx, self.from_rest), Ok);
        let begin = match begin {
            Ok(begin) => begin,
            Err(why) if ctx.now.secs_since(self.begun) < REST_PATIENCE => return Searching::Wait(why),
            Err(why) => return self.failed(error_code::UNKNOWN, format!("{why}, and it did not")),
        };
        if let Some(path) = self.legs.join(&begin) {
            return self.ask_smooth(ctx, model, begin, map, path, PlanStatistics::default());
        }
        let goal = self.legs.goal();
        let start = self
            .escape
            .map_or(begin.pose, |free| Pose2::new(free.x, free.y, begin.pose.yaw));
        let footprint = self.room.disc(&model.footprint);
        let request = PlanRequest {
            robot: ctx.config.robot.to_string(),
            model: RobotModel { footprint, ..model },
            map,
            start,
            goal: Pose2::new(goal.x, goal.y, goal.yaw.unwrap_or(0.0)),
            planner: self.planner.clone(),
            unknown_is_free: self.unknown_is_free,
            budget_ms: ctx.config.search_budget_ms,
            seed: 1,
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
                let Some(path) = self.legs.take(path) else {
                    self.escape = None;
                    return self.ask_plan(ctx);
                };
                if self.legs.is_only_a_way() {
                    return self.found(begin, path, reply.map, Trajectory::default(), statistics);
                }
                let Some(model) = ctx.robot.model().cloned() else {
                    return Searching::Wait("waits for the robot's description");
                };
                self.ask_smooth(ctx, model, begin, reply.map, path, statistics)
            }
            PlanOutcome::StartOccupied {
                nearest_free: Some(free),
            } if self.escape.is_none() && (free - begin.pose.position()).norm() < ESCAPE => {
                tracing::info!(
                    goal = ctx.goal.id,
                    x = free.x,
                    y = free.y,
                    "leaves an obstacle by the nearest free place"
                );
                ctx.goal.feedback.recoveries += 1;
                self.escape = Some(free);
                self.stage = Stage::Idle(ctx.now);
                Searching::Wait("plans from the nearest free place")
            }
            // Where a large disc has no way, a smaller one may; where the body did not fit through, no other way has more room.
            PlanOutcome::GoalOccupied { .. } | PlanOutcome::StartOccupied { .. } | PlanOutcome::NoPath
                if ctx
                    .robot
                    .model()
                    .is_some_and(|model| self.room.narrow(&model.footprint)) =>
            {
                self.begin_anew(ctx);
                Searching::Wait("plans a narrower way")
            }
            PlanOutcome::GoalOccupied { .. } | PlanOutcome::StartOccupied { .. } | PlanOutcome::NoPath
                if self.room.undrivable.is_some() =>
            {
                self.undrivable()
            }
            PlanOutcome::GoalOccupied { nearest_free } => {
                let near = nearest_free
                    .map(|p| format!("; the nearest free place is ({:.2}, {:.2})", p.x, p.y))
                    .unwrap_or_default();
                let why = format!("by the map of now the robot does not fit there{near}");
                self.failed(
                    error_code::GOAL_OCCUPIED,
                    format!("the goal {} is occupied: {why}", self.place()),
                )
            }
            PlanOutcome::StartOccupied { .. } => self.failed(
                error_code::START_OCCUPIED,
                "by the map the robot does not fit where it stands".to_owned(),
            ),
            PlanOutcome::NoPath => self.failed(
                error_code::NO_VALID_PATH,
                format!("no path: the goal {} is closed off from the robot", self.place()),
            ),
            PlanOutcome::OutOfMap => self.failed(
                error_code::OUTSIDE_MAP,
                format!("the robot or the goal {} lies outside the map", self.place()),
            ),
            PlanOutcome::TimedOut => self.failed(error_code::TIMEOUT, "the search took too long".to_owned()),
            PlanOutcome::NoMap if ctx.now.secs_since(self.begun) < MAP_PATIENCE => {
                self.again(ctx);
                Searching::Wait("waits until the planner has the map")
            }
            PlanOutcome::NoMap => self.failed(error_code::UNKNOWN, "the planner has no map of this robot".to_owned()),
        }
    }

    fn smoothed(&mut self, ctx: &mut Context, smoothing: Smoothing, answer: Result<Answer, NoAnswer>) -> Searching {
        let (map, trajectory, statistics) = match answer {
            // Where there is no way, none can be driven: the goal itself is the one waypoint.
            Ok(Answer::Smooth(reply)) if reply.trajectory.is_empty() && smoothing.length < AT_GOAL => {
                (reply.map, Trajectory::default(), smoothing.planned)
            }
            Ok(Answer::Smooth(reply)) if reply.trajectory.is_empty() && self.legs.drop_given() => {
                tracing::info!(
                    goal = ctx.goal.id,
                    why = reply.statistics.status,
                    "the given way cannot be driven"
                );
                self.begin_anew(ctx);
                return Searching::Wait("plans another way: the given one cannot be driven");
            }
            Ok(Answer::Smooth(reply)) if reply.trajectory.is_empty() => {
                self.room.undrivable = Some(reply.statistics.status);
                if !self.room.change(&smoothing.request.model.footprint) {
                    return self.undrivable();
                }
                self.begin_anew(ctx);
                return Searching::Wait("plans another way: the robot does not fit through");
            }
            Ok(Answer::Smooth(reply)) => {
                let statistics = PlanStatistics {
                    planner: smoothing.planned.planner,
                    search_ms: smoothing.planned.search_ms,
                    ..reply.statistics
                };
                (reply.map, reply.trajectory, statistics)
            }
            other => {
                let why = match other {
                    Err(NoAnswer::Refused(_)) => "fallback:smoother_refused",
                    _ => "fallback:no_smoother",
                };
                let (request, begin) = (&smoothing.request, &smoothing.begin);
                let safe = unsmoothed(
                    &request.path,
                    begin.pose,
                    begin.twist,
                    self.legs.last().yaw,
                    &request.model,
                );
                let statistics = PlanStatistics {
                    planner: smoothing.planned.planner,
                    search_ms: smoothing.planned.search_ms,
                    length: smoothing.length,
                    status: why.to_owned(),
                    ..safe.statistics
                };
                (request.map.clone(), safe.motion.trajectory(PERIOD), statistics)
            }
        };
        self.found(smoothing.begin, smoothing.request.path, map, trajectory, statistics)
    }

    fn ask_smooth(
        &mut self,
        ctx: &mut Context,
        model: RobotModel,
        begin: Begin,
        map: MapRef,
        path: Vec<Point2<f64>>,
        planned: PlanStatistics,
    ) -> Searching {
        let length = path::length(&path);
        let request = SmoothRequest {
            robot: ctx.config.robot.to_string(),
            model,
            map,
            path,
            start: begin.pose,
            start_velocity: begin.twist,
            goal_yaw: self.legs.last().yaw,
            unknown_is_free: self.unknown_is_free,
            profile: ctx.goal.profile,
        };
        let ticket = ctx.asks.ask(Ask::Smooth(Box::new(request.clone())));
        let smoothing = Smoothing {
            begin,
            request,
            length,
            planned,
        };
        self.stage = Stage::Smooth(ticket, Box::new(smoothing));
        Searching::Wait("smooths")
    }

    fn found(
        &self,
        begin: Begin,
        path: Vec<Point2<f64>>,
        map: MapRef,
        trajectory: Trajectory,
        statistics: PlanStatistics,
    ) -> Searching {
        let course = ActivePlan {
            map,
            waypoints: path.iter().skip(1).copied().collect(),
            trajectory,
            splice: begin.splice,
            statistics,
        };
        Searching::Found(Box::new(Route {
            id: 0,
            goal: self.legs.last(),
            length: path::length(&path),
            path,
            begin: begin.pose,
            course,
        }))
    }

    fn begin_anew(&mut self, ctx: &Context) {
        self.escape = None;
        self.legs.begin_anew();
        self.stage = Stage::Idle(ctx.now);
    }

    fn again(&mut self, ctx: &Context) {
        self.stage = Stage::Idle(ctx.now.plus_secs(RETRY));
    }

    fn undrivable(&mut self) -> Searching {
        let status = self.room.undrivable.take().unwrap_or_default();
        let why = format!("the way to {} cannot be driven: {status}", self.place());
        self.failed(error_code::UNKNOWN, why)
    }

    /// The goal, in words.
    fn place(&self) -> String {
        let goal = self.legs.goal();
        format!("({:.2}, {:.2})", goal.x, goal.y)
    }

    fn failed(&mut self, code: i64, reason: String) -> Searching {
        Searching::Failed(NoRoute { code, reason })
    }
}
