//! ComputePathToPose: a way to the goal, planned and smoothed by workers, put on the blackboard.

use zenav_protocol::messages::GoalPoint;

use super::ports::parse_goal;
use super::{fail, no_error, step};
use crate::behaviour_tree::{Leaf, LeafIo, Status, Value};
use crate::mission::context::Context;
use crate::mission::route::{RouteData, Search, Searching, error_code};

/// Plans to `goal`; `path` gets the way, `error_code_id` and `error_msg` why there is none.
#[derive(Default)]
pub struct ComputePath {
    search: Option<Search>,
    /// Where to, and how often in a row it has been tried without a way.
    tried: Option<(GoalPoint, u32)>,
}

impl Leaf<Context> for ComputePath {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let goal: GoalPoint = match io.value("goal").map_err(|error| error.to_string()).and_then(parse_goal) {
            Ok(goal) => goal,
            Err(why) => return fail(io, ctx, Some(error_code::UNKNOWN), why),
        };
        let planner = io.get_optional("planner_id").ok().flatten();
        if let Some(old) = self.search.take() {
            old.cancel(ctx);
        }
        self.search = Some(Search::new(ctx, goal, planner, ctx.now));
        if self.tried.is_none_or(|(to, _)| to != goal) {
            self.tried = Some((goal, 0));
        }
        self.tick(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let Some(search) = &mut self.search else {
            return self.start(io, ctx);
        };
        match search.step(ctx) {
            Searching::Wait(what) => step(io, ctx, what),
            Searching::Found(route) => {
                self.search = None;
                let (goal, points, length) = (route.goal, route.path.clone(), route.length);
                let data = RouteData {
                    route: ctx.keep_route(*route),
                    goal,
                    points,
                    length,
                };
                let written = Value::data(&data)
                    .map_err(|error| error.to_string())
                    .and_then(|value| io.set("path", value).map_err(|error| error.to_string()));
                if let Err(why) = written {
                    return fail(io, ctx, Some(error_code::UNKNOWN), why);
                }
                self.tried = None;
                no_error(io);
                io.say(format!("{length:.2} m"));
                Status::Success
            }
            Searching::Failed(no_route) => {
                self.search = None;
                let times = self.tried.as_mut().map_or(1, |(_, times)| {
                    *times = times.saturating_add(1);
                    *times
                });
                let tries = if times > 1 {
                    format!(", after {times} tries")
                } else {
                    String::new()
                };
                fail(io, ctx, Some(no_route.code), format!("{}{tries}", no_route.reason))
            }
        }
    }

    /// What was asked before a restart is asked anew: an answer that is late moves nobody.
    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.start(io, ctx)
    }

    fn halt(&mut self, _io: &mut LeafIo<'_>, ctx: &mut Context) {
        if let Some(search) = self.search.take() {
            search.cancel(ctx);
        }
    }
}
