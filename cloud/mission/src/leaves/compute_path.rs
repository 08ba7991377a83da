//! ComputePathToPose, ComputePathThroughPoses: plan and smooth a path to the goal or through goals with a motion worker, and write it to
//! the blackboard. With `start` the path begins there instead of at the robot, and has no trajectory.

use zenav_protocol::messages::GoalPoint;

use super::path::DrivenPath;
use super::ports::{goal_on, goals_on, write};
use super::selectors::Choice;
use super::{fail, no_error, step};
use crate::context::Context;
use crate::route::{Route, RouteData, RouteRequest, Search, Searching, error_code, look_at};
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// Offset of Nav2's error codes for a path through poses.
const THROUGH_POSES: i64 = 100;
/// Greatest deviation of the path on the blackboard from the motion, m.
const EXACT: f64 = 0.01;
/// A recently started goal is not given up after this many failed tries; a path is then searched at this period, s.
const LOOKS: u32 = 2;
const LOOK_AGAIN: f64 = 0.5;
/// Nav2's error code of ComputePathThroughPoses for an empty list of goals.
const NO_VIAPOINTS_GIVEN: i64 = 309;

/// Plans; writes the path to `path`, or the reason for failure to `error_code_id` and `error_msg`.
#[derive(Default)]
pub struct ComputePath {
    search: Option<(Search, RouteRequest)>,
    /// Last goal, and number of consecutive tries without a path.
    tried: Option<(GoalPoint, u32)>,
    /// Frame of the map in which the goal was read.
    frame: u64,
}

/// This node's Nav2 error code for a reason.
fn code(io: &LeafIo<'_>, code: i64) -> i64 {
    if is_through(io) { code + THROUGH_POSES } else { code }
}

fn is_through(io: &LeafIo<'_>) -> bool {
    io.id() == "ComputePathThroughPoses"
}

/// The route requested by the ports, or an error code and reason.
fn route_request(io: &LeafIo<'_>, ctx: &Context) -> Result<RouteRequest, (i64, String)> {
    let unknown = |why: String| (code(io, error_code::UNKNOWN), why);
    let mut stops = if is_through(io) {
        goals_on(io, ctx, "goals").map_err(unknown)?
    } else {
        let mut stops = Vec::new();
        if io.is_set("viapoints") && io.value("viapoints").is_ok() {
            stops = goals_on(io, ctx, "viapoints").map_err(unknown)?;
        }
        stops.push(goal_on(io, ctx, "goal").map_err(unknown)?);
        stops
    };
    let Some(goal) = stops.pop() else {
        return Err((
            NO_VIAPOINTS_GIVEN,
            "there are no goals: expected at least one".to_owned(),
        ));
    };
    let use_start = io
        .get_optional::<bool>("use_start")
        .map_err(|error| unknown(error.to_string()))?;
    let from = if use_start != Some(false) && io.value("start").is_ok() {
        Some(goal_on(io, ctx, "start").map_err(unknown)?.pose())
    } else if use_start == Some(true) {
        return Err(unknown("`use_start` without a `start`".to_owned()));
    } else {
        None
    };
    Ok(RouteRequest {
        via: stops,
        from,
        ..RouteRequest::to(goal)
    })
}

/// The path as driven: the trajectory cuts the corners of the planner's path.
fn driven(route: &Route) -> DrivenPath {
    let trajectory = &route.plan.trajectory;
    if trajectory.is_empty() {
        return route.path.clone();
    }
    DrivenPath::of(trajectory, EXACT)
}

impl Leaf<Context> for ComputePath {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.frame = ctx.frames.at();
        let request = match route_request(io, ctx) {
            Ok(request) => request,
            Err((code, why)) => return fail(io, ctx, Some(code), why),
        };
        let planner = match Choice::Planner.check(io.get_optional("planner_id").ok().flatten()) {
            Ok(planner) => planner,
            Err(why) => {
                let code = code(io, error_code::INVALID_PLANNER);
                return fail(io, ctx, Some(code), why);
            }
        };
        if let Some((old, _)) = self.search.take() {
            old.cancel(ctx);
        }
        if self.tried.is_none_or(|(to, _)| to != request.goal) {
            self.tried = Some((request.goal, 0));
        }
        let mut search = Search::new(ctx, request.clone(), planner, ctx.now);
        if ctx.is_driving() {
            search = search.standing();
        }
        self.search = Some((search, request));
        self.tick(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        if let Some(why) = ctx.robot.lost() {
            self.halt(io, ctx);
            return fail(io, ctx, Some(code(io, error_code::TF_ERROR)), why);
        }
        if self.frame != ctx.frames.at() && self.search.is_some() {
            // The goal's coordinates have changed.
            return self.start(io, ctx);
        }
        let Some((search, request)) = &mut self.search else {
            return self.start(io, ctx);
        };
        match search.step(ctx) {
            Searching::Wait(what) => step(io, ctx, what),
            Searching::Blocked(what) => step(io, ctx, &what),
            Searching::Nearer(route) => {
                search.approaches(ctx, *route);
                step(io, ctx, "drives to where it sees what bars the way")
            }
            Searching::Found(route) => {
                let (via, only_a_path) = (std::mem::take(&mut request.via), request.from.is_some());
                self.search = None;
                let (goal, path, length) = (route.goal, driven(&route), route.length);
                let data = RouteData {
                    route: if only_a_path { 0 } else { ctx.keep_route(*route) },
                    goal,
                    points: path.points,
                    backwards: path.backwards,
                    length,
                    via,
                    frame: Some(ctx.frames.at()),
                    driven: 0.0,
                    place: io.get("goal").ok().filter(|name| ctx.config.places.contains_key(name)),
                };
                if let Err(why) = write(io, "path", data.value()) {
                    let code = code(io, error_code::UNKNOWN);
                    return fail(io, ctx, Some(code), why);
                }
                self.tried = None;
                no_error(io);
                io.say(format!("{length:.2} m"));
                Status::Success
            }
            Searching::Failed(no_route)
                if (no_route.code == error_code::GOAL_OCCUPIED && ctx.goal.waited.is_none()
                    || no_route.code == error_code::NO_VALID_PATH
                        && self.tried.is_some_and(|(_, times)| times >= LOOKS))
                    && ctx.now.secs_since(ctx.goal.started) < ctx.config.settings.linger =>
            {
                search.again_at(ctx.now.plus_secs(LOOK_AGAIN));
                look_at(ctx, request.goal.position());
                step(io, ctx, &format!("looks again: {}", no_route.reason))
            }
            Searching::Failed(no_route) => {
                if let Some((search, _)) = self.search.take() {
                    search.cancel(ctx);
                }
                let times = self.tried.as_mut().map_or(1, |(_, times)| {
                    *times = times.saturating_add(1);
                    *times
                });
                let tries = if times > 1 {
                    format!(", after {times} tries")
                } else {
                    String::new()
                };
                let code = code(io, no_route.code);
                fail(io, ctx, Some(code), format!("{}{tries}", no_route.reason))
            }
        }
    }

    /// A request from before a restart is sent again: a late answer moves no robot.
    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.start(io, ctx)
    }

    fn halt(&mut self, _io: &mut LeafIo<'_>, ctx: &mut Context) {
        if let Some((search, _)) = self.search.take() {
            search.cancel(ctx);
        }
    }
}
