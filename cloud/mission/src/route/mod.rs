//! Route. How does a goal become a plan? A motion worker computes a path and its trajectory in a single request.
//!
//! For a robot that follows a trajectory, the route starts from the state predicted on it, one latency budget ahead; for a robot at rest,
//! from where it stands; a robot that moves otherwise is waited for.
//!
//! If there is no path, the worker is asked again as if the transient obstacles (`transient`) had left. If there is a
//! path then, the search waits for them: it asks again when one of them leaves, and each second. If the path round them is much longer
//! than the one through them, it waits, too, as long as that is likely to be sooner. A moving robot waits on the plan in force.

mod answer;
mod approach;
mod barred;
mod begin;
mod covered_goal;
mod request;
mod waiting;
mod way_round;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    GoalPoint, KnownCourse, MapRef, MotionRequest, PlanRequest, SmoothRequest, TrajectoryRequest,
};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use super::context::Context;
use super::frames::{MapFrames, moved_points};
use super::io::Ticket;
use super::leaves::path::DrivenPath;
use super::motion::PlanDraft;
use super::transient::TransientCell;
use approach::Approach;
use begin::{Begin, predicted};

pub(crate) use approach::Tries;
pub(crate) use request::RouteRequest;
pub(crate) use waiting::{InSight, Waiting, look_at};
pub(crate) use way_round::{is_long, short_way_opens};

/// Nav2's error codes of path planning.
pub(crate) mod error_code {
    /// Any other reason.
    pub const UNKNOWN: i64 = 200;
    /// The robot's pose is unknown.
    pub const TF_ERROR: i64 = 202;
    /// The planner does not exist.
    pub const INVALID_PLANNER: i64 = 201;
    /// The start is outside the map.
    pub const OUTSIDE_MAP: i64 = 204;
    /// The robot does not fit where it stands.
    pub const START_OCCUPIED: i64 = 205;
    /// The robot does not fit at the goal.
    pub const GOAL_OCCUPIED: i64 = 206;
    /// The search took too long.
    pub const TIMEOUT: i64 = 207;
    /// Start and goal are not connected.
    pub const NO_VALID_PATH: i64 = 208;
}

/// A robot that does not fit at its goal may end this near to it, as a share of the goal's tolerance.
pub(crate) const NEARBY: f64 = 0.8;
/// State of a search without an answering motion worker.
const NO_WORKER: &str = "waits for a motion worker";

/// A path and its trajectory.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// Identifies the route.
    pub id: u64,
    /// Goal of the route.
    pub goal: GoalPoint,
    /// The planned path, including start and goal.
    pub path: DrivenPath,
    /// Length of the path, m.
    pub length: f64,
    /// Start pose.
    pub begin: Pose2,
    /// The plan to publish.
    pub plan: PlanDraft,
    /// Predicted time of arrival of a path past other robots, waits for them included, s.
    pub arrival_secs: Option<f64>,
}

/// A route as stored on the blackboard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RouteData {
    /// Id of the route; unknown after a restart.
    pub route: u64,
    /// Goal of the route.
    pub goal: GoalPoint,
    /// Corner points, map frame.
    pub points: Vec<Point2<f64>>,
    /// Legs driven backwards, each by the index of its first corner, ascending.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub backwards: Vec<usize>,
    /// Length, m.
    pub length: f64,
    /// Goals on the way, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub via: Vec<GoalPoint>,
    /// Name of the goal's place, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
    /// Frame of the map that the coordinates are in; without it, the present one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u64>,
    /// How much of the path is behind the robot, m: where a path leads back over itself, its place does not tell.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub driven: f64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl RouteData {
    /// The same in the present frame of the map: the path moved with the robot's surroundings, the goals with theirs. `None` if its frame
    /// is too old.
    #[must_use]
    pub fn settled(self, frames: &MapFrames) -> Option<Self> {
        let from = self.frame.unwrap_or(frames.at());
        if from == frames.at() {
            return Some(self);
        }
        let moved = frames.robot(from)?;
        Some(Self {
            goal: frames.place(from, self.goal),
            points: moved_points(&self.points, moved),
            via: self.via.iter().map(|goal| frames.place(from, *goal)).collect(),
            frame: Some(frames.at()),
            ..self
        })
    }
}

/// Why there is no route.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NoRoute {
    /// Nav2's code.
    pub code: i64,
    /// The reason as text.
    pub reason: String,
}

impl NoRoute {
    /// Whether neither another position of the robot nor another attempt on the same map would help.
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

/// State of a search.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Searching {
    /// Not finished; what it waits for.
    Wait(&'static str),
    /// A transient obstacle blocks the way: where, and for how long.
    Blocked(String),
    /// The obstacle is out of sight, and this route leads to where it is visible: drive it with [`Search::approaches`] meanwhile.
    Nearer(Box<Route>),
    /// Found.
    Found(Box<Route>),
    /// Not found.
    Failed(NoRoute),
}

#[derive(Clone, Debug)]
enum Stage {
    /// No request before this time.
    Idle(Stamp),
    Asked(Ticket, Begin),
    /// Why there is no path; asked whether there would be one without the transient obstacles.
    Cleared(Ticket, NoRoute),
    /// A route round what may leave; asked how long the way would be without that.
    Weighed(Ticket, Box<Route>),
    /// The trajectory along the given path, joined from the robot's position.
    Given(Ticket, Begin, DrivenPath),
}

/// A search for a route.
#[derive(Clone, Debug)]
pub(crate) struct Search {
    request: RouteRequest,
    planner: String,
    stage: Stage,
    begun: Stamp,
    /// Plan only from rest.
    from_rest: bool,
    /// Whether its route replaces the plan in force: then a moving robot may wait on that one.
    replaces: bool,
    /// Transient cells of the last request.
    cleared: Vec<TransientCell>,
    /// Whether some of them are one or two beam returns near a goal far away.
    doubts: bool,
    waiting: Option<Waiting>,
    /// Whether the next route is taken although it leads round what may leave.
    goes_round: bool,
    /// The approach to where the obstacle is in sight; whether the robot may be driven there.
    approach: Option<Approach>,
    may_approach: bool,
    /// Time of the last path request.
    asked: Stamp,
    /// Frame of the map of that request.
    frame: u64,
    /// Whether the last request was not answered by any motion worker.
    unanswered: bool,
    /// Predicted time of arrival in the last answer, of a path past other robots, s.
    arrival_secs: Option<f64>,
}

impl Search {
    /// Starts at `from` (now, or later).
    #[must_use]
    pub fn new(ctx: &Context, request: RouteRequest, planner: Option<String>, from: Stamp) -> Self {
        let planner = planner
            .filter(|name| !name.is_empty())
            .unwrap_or_else(|| ctx.config.planner.clone());
        Self {
            request,
            planner,
            stage: Stage::Idle(from),
            begun: from,
            from_rest: false,
            replaces: false,
            cleared: Vec::new(),
            doubts: false,
            waiting: None,
            goes_round: false,
            approach: None,
            may_approach: true,
            asked: from,
            frame: ctx.frames.at(),
            unanswered: false,
            arrival_secs: None,
        }
    }

    /// Does not drive the robot anywhere while it waits: another leaf drives it.
    #[must_use]
    pub fn standing(self) -> Self {
        Self {
            may_approach: false,
            ..self
        }
    }

    /// Replaces the plan in force, on the way to the same goal.
    #[must_use]
    pub(crate) fn replacing(self) -> Self {
        Self { replaces: true, ..self }
    }

    /// Waits until the robot is at rest, and plans from there.
    #[must_use]
    pub fn once_at_rest(self) -> Self {
        Self {
            from_rest: true,
            ..self
        }
    }

    /// Cancels the search.
    pub fn cancel(mut self, ctx: &mut Context) {
        self.end_approach(ctx);
        if self.waiting.is_some() {
            ctx.goal.feedback.blockage = None;
        }
        match self.stage {
            Stage::Asked(ticket, _)
            | Stage::Cleared(ticket, _)
            | Stage::Weighed(ticket, _)
            | Stage::Given(ticket, ..) => ctx.asks.forget(ticket),
            Stage::Idle(_) => {}
        }
    }

    /// Tries again from a time on.
    pub fn again_at(&mut self, from: Stamp) {
        (self.stage, self.begun) = (Stage::Idle(from), from);
    }

    /// Advances as far as the available answers allow.
    pub fn step(&mut self, ctx: &mut Context) -> Searching {
        let state = self.advance(ctx);
        match (state, self.waiting.take()) {
            (Searching::Wait(_), Some(waiting)) => {
                ctx.goal.feedback.blockage = Some(waiting.blockage);
                let nearer = self.waits(ctx, &waiting);
                let said = waiting.said(ctx.now);
                self.waiting = Some(waiting);
                nearer.map_or(Searching::Blocked(said), Searching::Nearer)
            }
            (state, waiting) => {
                ctx.goal.feedback.blockage = None;
                self.waiting = waiting;
                state
            }
        }
    }

    /// What the robot does while waiting: it makes room, approaches the obstacle, or turns towards it. Returns a route for an approach,
    /// once there is one.
    fn waits(&mut self, ctx: &mut Context, waiting: &Waiting) -> Option<Box<Route>> {
        if self.is_approaching() {
            return self.come_nearer(ctx, waiting);
        }
        let done = waiting.make_room(ctx) || !waiting.is_in_sight(ctx) && self.ask_for_approach(ctx, waiting);
        if !done {
            look_at(ctx, waiting.blockage.position());
        }
        None
    }

    fn advance(&mut self, ctx: &mut Context) -> Searching {
        match self.stage.clone() {
            Stage::Idle(from) if ctx.now < from && !self.may_go_on(ctx) => {
                Searching::Wait(if self.unanswered { NO_WORKER } else { "is about to plan" })
            }
            Stage::Idle(_) => self.ask(ctx),
            Stage::Cleared(ticket, no_route) => match ctx.asks.take(ticket) {
                None => Searching::Wait("asks what bars the way"),
                Some(answer) => self.without_what_may_leave(ctx, no_route, answer),
            },
            Stage::Weighed(ticket, route) => match ctx.asks.take(ticket) {
                None => Searching::Wait("asks what bars the short way"),
                Some(answer) => self.weigh(ctx, route, answer),
            },
            Stage::Asked(ticket, begin) => match ctx.asks.take(ticket) {
                None => self.awaits(ctx, "plans"),
                Some(answer) => self.answered(ctx, begin, answer),
            },
            Stage::Given(ticket, begin, path) => match ctx.asks.take(ticket) {
                None => self.awaits(ctx, "smooths"),
                Some(answer) => self.smoothed(ctx, begin, path, answer),
            },
        }
    }

    fn ask(&mut self, ctx: &mut Context) -> Searching {
        let Some(model) = ctx.robot.model().cloned() else {
            return Searching::Wait("waits for the robot's description");
        };
        let Some(map) = ctx.map.newest() else {
            return Searching::Wait("waits for a map");
        };
        if !ctx.frames.is_settled() || ctx.robot.frame() != ctx.frames.at() {
            return Searching::Wait("waits until robot and map are in one frame");
        }
        self.frame = ctx.frames.at();
        let begin = match self.request.from {
            Some(pose) => Ok(Begin::at_rest(pose)),
            None => predicted(ctx, self.from_rest),
        };
        let begin = match begin {
            Ok(begin) => begin,
            Err(why) if ctx.now.secs_since(self.begun) < ctx.config.settings.retries.rest_wait => {
                return Searching::Wait(why);
            }
            Err(why) => return failed(error_code::UNKNOWN, format!("{why}, and it did not")),
        };
        if self.request.past_others && ctx.yields().is_none() {
            return failed(
                error_code::NO_VALID_PATH,
                "the robot gives way to nobody any more".to_owned(),
            );
        }
        self.asked = ctx.now;
        if let Some(waiting) = &mut self.waiting {
            waiting.asked(ctx);
        }
        let goal_yaw = self.request.goal.yaw;
        if let Some(path) = self.request.join_given(begin.pose.position()) {
            let request = SmoothRequest {
                robot: ctx.config.robot.to_string(),
                model,
                map,
                path: path.points.clone(),
                via: self.request.via.iter().map(GoalPoint::position).collect(),
                backwards: path.backwards.clone(),
                start: begin.pose,
                start_velocity: begin.twist,
                goal_yaw,
                unknown_is_free: ctx.config.settings.unknown_is_free,
                profile: ctx.goal.profile,
            };
            let ticket = ctx.asks.ask_motion(MotionRequest::Smooth(request));
            self.stage = Stage::Given(ticket, begin, path);
            return self.awaits(ctx, "smooths");
        }
        let plan = self.plan_request(ctx, model, map, begin.pose);
        let request = if self.request.from.is_some() {
            MotionRequest::Plan(plan)
        } else {
            MotionRequest::Trajectory(TrajectoryRequest {
                plan,
                start_velocity: begin.twist,
                goal_yaw,
                profile: ctx.goal.profile,
            })
        };
        self.stage = Stage::Asked(ctx.asks.ask_motion(request), begin);
        self.awaits(ctx, "plans")
    }

    /// Waits for an answer. After the time limit of a search, the motion worker counts as missing.
    fn awaits(&self, ctx: &Context, what: &'static str) -> Searching {
        let late = ctx.now.secs_since(self.asked) > ctx.config.settings.search_budget;
        Searching::Wait(if late || self.unanswered { NO_WORKER } else { what })
    }

    fn plan_request(&self, ctx: &Context, model: RobotModel, map: MapRef, start: Pose2) -> PlanRequest {
        PlanRequest {
            robot: ctx.config.robot.to_string(),
            model,
            map,
            start,
            via: self.request.via.iter().map(GoalPoint::pose).collect(),
            goal: self.request.goal.pose(),
            planner: self.planner.clone(),
            unknown_is_free: ctx.config.settings.unknown_is_free,
            cleared: Vec::new(),
            yield_to: self.yield_to(ctx),
            escape: ctx.config.settings.escape,
            goal_tolerance: NEARBY * ctx.goal.tolerance,
            budget_ms: (1e3 * ctx.config.settings.search_budget) as u64,
            seed: 1,
        }
    }

    /// The courses of the robots to pass, with times relative to the start of the path.
    fn yield_to(&self, ctx: &Context) -> Vec<KnownCourse> {
        let yields = ctx.yields().filter(|_| self.request.past_others);
        let mut courses = yields.map(|yields| yields.courses).unwrap_or_default();
        for place in courses.iter_mut().flat_map(|course| &mut course.places) {
            place.secs -= ctx.latency_budget();
        }
        courses
    }

    /// Time since the search began, s.
    #[must_use]
    pub fn age(&self, now: Stamp) -> f64 {
        now.secs_since(self.begun)
    }

    fn again(&mut self, ctx: &Context, why: &'static str) -> Searching {
        self.stage = Stage::Idle(ctx.now.plus_secs(ctx.config.settings.retries.worker_wait));
        Searching::Wait(why)
    }
}

fn failed(code: i64, reason: String) -> Searching {
    Searching::Failed(NoRoute { code, reason })
}
