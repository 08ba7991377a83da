//! Waiting. What that may leave bars the way, and is it still worth waiting for?

use nalgebra::Point2;
use zenav_protocol::geometry::wrap_angle;
use zenav_protocol::grid::Occupancy;
use zenav_protocol::messages::{
    BehaviourAction, BehaviourRequest, Blockage, MotionReply, MotionRequest, PlanOutcome, PlanReply, PlanRequest,
};
use zenav_protocol::time::Stamp;

use super::begin::Begin;
use super::{NoRoute, Search, Searching, Stage, error_code, named};
use crate::context::Context;
use crate::io::{Answer, Ask, NoAnswer};
use crate::leaves::path;
use crate::transient::TransientCell;

/// Time between two tries while something is waited for, s: at least, when it gives way, and at most.
const RETRY: [f64; 2] = [0.2, 1.0];
/// What gives way leaves traces for a while: a path that is not there yet is asked for so much longer, s.
const TRACES: f64 = 5.0;
/// So much inside the border of its view a lidar sees what is waited for, rad; the robot turns to it at most so often, s.
const VIEW: (f64, f64) = (0.3, 10.0);
/// What bumped into the robot within this time, s, and leans on it for so long, s, is made room for: this much clearance, m, within so far, m.
const BUMPED: f64 = 60.0;
const LEANS: f64 = 6.0;
const ROOM: (f64, f64) = (0.3, 2.0);
/// Most goals that things are looked for around.
const MAX_GOALS: usize = 8;
/// From so near a lidar tells a person or a robot from a wall, m.
const TOLD_WITHIN: f64 = 3.0;
/// What may touch a robot beyond its circumscribed disc, m: some cells.
const BESIDE: f64 = 0.08;
/// Cells this near to one another bar the way as one thing, m.
pub(super) const ONE_THING: f64 = 0.8;
/// A blockage this near to the one before is the same, m …
pub(super) const SAME_PLACE: f64 = 1.0;
/// … unless it was not waited for in so long, s.
const FORGOTTEN: f64 = 10.0;

/// What a search waits for.
#[derive(Clone, Debug)]
pub(super) struct Waiting {
    pub(super) blockage: Blockage,
    /// Its cells, map frame, m.
    pub(super) cells: Vec<Point2<f64>>,
    /// The way that it bars.
    pub(super) way: Vec<Point2<f64>>,
    /// From farther away nobody can tell what it is, m.
    pub(super) told_within: f64,
    /// How many of them were occupied when a path was asked for last.
    occupied: usize,
}

impl Waiting {
    /// What bars a path that is there only without these cells, for a robot that touches what is nearer to its middle than `radius`, m:
    /// the first thing on the way.
    pub(super) fn on(path: &[Point2<f64>], cells: &[TransientCell], radius: f64, now: Stamp) -> Option<Self> {
        let touched = cells.iter().filter_map(|cell| {
            let near = path::nearest(path, cell.center, 0.0, f64::INFINITY)?;
            (near.distance <= radius).then_some((near.along, cell))
        });
        let touched: Vec<(f64, &TransientCell)> = touched.collect();
        let (_, first) = touched.iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
        let thing = touched
            .iter()
            .filter(|(_, cell)| (cell.center - first.center).norm() <= ONE_THING);
        let thing: Vec<&TransientCell> = thing.map(|(_, cell)| *cell).collect();
        let sum = thing
            .iter()
            .fold([0.0; 2], |[x, y], cell| [x + cell.center.x, y + cell.center.y]);
        let [x, y] = sum.map(|sum| sum / thing.len() as f64);
        // Its cells come one after the other: the one in the middle tells when.
        let mut since: Vec<Stamp> = thing.iter().filter_map(|cell| cell.since).collect();
        since.sort_unstable();
        let since = since.get(since.len() / 2).copied().unwrap_or(now);
        Some(Self {
            blockage: Blockage { x, y, since },
            cells: thing.iter().map(|cell| cell.center).collect(),
            way: path.to_vec(),
            told_within: f64::INFINITY,
            occupied: thing.len(),
        })
    }

    /// Notes in the goal that this is waited for. What stood there when it was waited for before still does.
    pub(super) fn note(&mut self, ctx: &mut Context) {
        let goal = &mut ctx.goal;
        if let Some((before, last)) = goal.waited
            && (before.x - self.blockage.x).hypot(before.y - self.blockage.y) <= SAME_PLACE
            && ctx.now.secs_since(last) <= FORGOTTEN
        {
            self.blockage.since = self.blockage.since.min(before.since);
        }
        goal.waited = Some((self.blockage, ctx.now));
    }

    /// How long it has stood there, s.
    pub(super) fn stood(&self, now: Stamp) -> f64 {
        now.secs_since(self.blockage.since).max(0.0)
    }

    /// Whether some of it has left since a path was asked for last.
    pub(super) fn gives_way(&self, ctx: &Context) -> bool {
        self.count(ctx) < self.occupied
    }

    /// A path is asked for with what stands there now.
    pub(super) fn asked(&mut self, ctx: &Context) {
        self.occupied = self.count(ctx);
    }

    fn count(&self, ctx: &Context) -> usize {
        let stands = |cell: &&Point2<f64>| ctx.map.occupancy(**cell) == Some(Occupancy::Occupied);
        self.cells.iter().filter(stands).count()
    }

    /// Drives a robot aside into which it has run, and on which it has leaned for a while: it waits for the robot, too. Says whether it did.
    pub(super) fn make_room(&self, ctx: &mut Context) -> bool {
        let (Some(pose), Some(model)) = (ctx.robot.pose(), ctx.robot.model()) else {
            return false;
        };
        let base_from_map = pose.inverse();
        let leans = |cell: &Point2<f64>| model.footprint.distance(base_from_map.transform_point(*cell)) <= BESIDE;
        if !ctx.robot.was_bumped_within(ctx.now, BUMPED) || !self.cells.iter().any(leans) {
            ctx.goal.leaned_on = None;
            return false;
        }
        let since = *ctx.goal.leaned_on.get_or_insert(ctx.now);
        let (clearance, within) = ROOM;
        let drives =
            ctx.now.secs_since(since) >= LEANS && ask_behaviour(ctx, BehaviourAction::ToFree { clearance, within });
        if drives {
            ctx.goal.leaned_on = Some(ctx.now);
        }
        drives
    }

    /// What is waited for, in words.
    pub(super) fn said(&self, now: Stamp) -> String {
        let Blockage { x, y, .. } = self.blockage;
        format!(
            "waits for what has stood at ({x:.2}, {y:.2}) for {:.0} s and may leave",
            self.stood(now).floor()
        )
    }

    /// Why it is waited for no longer.
    pub(super) fn given_up(&self, now: Stamp) -> String {
        let Blockage { x, y, .. } = self.blockage;
        format!(
            "something that came has stood at ({x:.2}, {y:.2}) for {:.0} s",
            self.stood(now)
        )
    }
}

impl Search {
    /// Whether what is waited for gives way.
    pub(super) fn may_go_on(&self, ctx: &Context) -> bool {
        let due = ctx.now.secs_since(self.asked) >= RETRY[0];
        due && self.waiting.as_ref().is_some_and(|waiting| waiting.gives_way(ctx))
    }

    /// There is no path. Would there be one without what may leave?
    pub(super) fn unless_it_leaves(&mut self, ctx: &mut Context, begin: &Begin, no_route: NoRoute) -> Searching {
        let may_pass = [error_code::GOAL_OCCUPIED, error_code::NO_VALID_PATH].contains(&no_route.code);
        let (Some(model), Some(map)) = (ctx.robot.model().cloned(), ctx.map.newest()) else {
            return self.given_up(ctx, no_route);
        };
        if !may_pass || self.request.from.is_some() || ctx.config.settings.patience <= 0.0 {
            return self.given_up(ctx, no_route);
        }
        let goals = self.request.via.iter().chain([&self.request.goal]);
        let near = goals.map(|goal| Point2::new(goal.x, goal.y)).take(MAX_GOALS);
        let near: Vec<Point2<f64>> = [begin.pose.position()].into_iter().chain(near).collect();
        self.cleared = ctx.map.transient(&near);
        // What a beam or two met at a goal far away may be anything.
        let goal = Point2::new(self.request.goal.x, self.request.goal.y);
        let reach = model.footprint.circumscribed_radius() + BESIDE;
        let is_far = (goal - begin.pose.position()).norm() > TOLD_WITHIN + reach;
        self.doubts = no_route.code == error_code::GOAL_OCCUPIED && is_far && ctx.goal.tries.are_left();
        if self.doubts {
            self.cleared.extend(ctx.map.lone(goal, reach));
        }
        if self.cleared.is_empty() {
            return self.given_up(ctx, no_route);
        }
        let request = PlanRequest {
            cleared: self.cleared.iter().map(|cell| cell.center).collect(),
            ..self.plan_request(ctx, model, map, begin.pose)
        };
        let ask = Ask::Motion(Box::new(MotionRequest::Plan(request)));
        self.stage = Stage::Cleared(ctx.asks.ask(ask), no_route);
        Searching::Wait("asks what bars the way")
    }

    /// The answer to that.
    pub(super) fn without_what_may_leave(
        &mut self,
        ctx: &mut Context,
        no_route: NoRoute,
        answer: Result<Answer, NoAnswer>,
    ) -> Searching {
        let path = match answer {
            Ok(Answer::Motion(reply)) => match *reply {
                MotionReply::Plan(PlanReply {
                    outcome: PlanOutcome::Found { path, .. },
                    ..
                }) => path,
                _ => Vec::new(),
            },
            _ => Vec::new(),
        };
        let cells = std::mem::take(&mut self.cleared);
        self.wait(ctx, &path, &cells, no_route)
    }

    /// There is a path, and it cannot be driven. Perhaps somebody stands at one of its ends, seen from one side only: at the goal, or so near
    /// to the robot that it has no room to set out.
    pub(super) fn unless_an_end_is_taken(
        &mut self,
        ctx: &mut Context,
        begin: &Begin,
        path: &[Point2<f64>],
        no_route: NoRoute,
    ) -> Searching {
        if ctx.config.settings.patience <= 0.0 || self.request.from.is_some() {
            return self.given_up(ctx, no_route);
        }
        let ends = [
            begin.pose.position(),
            Point2::new(self.request.goal.x, self.request.goal.y),
        ];
        let cells = ctx.map.transient(&ends);
        self.doubts = false;
        self.wait(ctx, path, &cells, no_route)
    }

    /// There is a path, and what may leave covers the goal: waits for it, unless it has stood there for too long.
    pub(super) fn until_the_goal_is_uncovered(
        &mut self,
        ctx: &mut Context,
        begin: &Begin,
        path: &[Point2<f64>],
    ) -> Option<Searching> {
        let cells = self.covers_goal(ctx, begin.pose.position());
        // Where the way would touch it.
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

    /// Waits for the first thing on a path that may leave; gives up if there is none, or if it has stood there for too long.
    fn wait(
        &mut self,
        ctx: &mut Context,
        path: &[Point2<f64>],
        cells: &[TransientCell],
        no_route: NoRoute,
    ) -> Searching {
        let model = ctx.robot.model();
        let radius = model.map_or(0.0, |model| model.footprint.circumscribed_radius());
        let Some(mut waiting) = Waiting::on(path, cells, radius + BESIDE, ctx.now) else {
            return self.given_up(ctx, no_route);
        };
        if self.doubts {
            waiting.told_within = TOLD_WITHIN;
        } else {
            waiting.note(ctx);
        }
        let approaches = self.is_approaching() || self.may_approach && ctx.goal.tries.are_left();
        if approaches && !waiting.is_in_sight(ctx) {
            ctx.goal.unseen_until = Some(ctx.now);
        }
        let seen = ctx
            .goal
            .unseen_until
            .map_or(f64::INFINITY, |until| ctx.now.secs_since(until));
        if waiting.stood(ctx.now).min(seen) > ctx.config.settings.patience {
            let reason = format!("{}; {}", no_route.reason, waiting.given_up(ctx.now));
            self.waiting = None;
            return Searching::Failed(NoRoute { reason, ..no_route });
        }
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

/// Turns a robot at rest to a place that none of its lidars sees: what leaves there would stay in the map.
pub(crate) fn look_at(ctx: &mut Context, place: Point2<f64>) {
    let looked = ctx.goal.looked.is_some_and(|at| ctx.now.secs_since(at) < VIEW.1);
    let (Some(pose), Some(model)) = (ctx.robot.pose(), ctx.robot.model()) else {
        return;
    };
    let bearing = wrap_angle((place.y - pose.y).atan2(place.x - pose.x) - pose.yaw);
    let is_seen = model
        .all_lidars()
        .any(|(_, lidar)| wrap_angle(bearing - lidar.mount.yaw).abs() <= 0.5 * lidar.field_of_view - VIEW.0);
    if !looked && !is_seen && ask_behaviour(ctx, BehaviourAction::Spin { angle: bearing }) {
        ctx.goal.looked = Some(ctx.now);
    }
}

/// Asks a robot at rest for a manoeuvre, if it may be asked. Whether it is done is seen by the robot's pose.
fn ask_behaviour(ctx: &mut Context, action: BehaviourAction) -> bool {
    let Some(epoch) = ctx.lease.epoch() else {
        return false;
    };
    if !ctx.robot.is_at_rest() || ctx.obstacle_to_driving().is_some() {
        return false;
    }
    let request = BehaviourRequest {
        id: ctx.execution_id(),
        action,
        epoch: Some(epoch),
    };
    let ticket = ctx.ask_maneuver(request);
    ctx.asks.forget(ticket);
    true
}
