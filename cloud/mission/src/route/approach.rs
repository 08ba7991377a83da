//! Approach. What bars the way is out of sight from here, and nobody would see it leave: where along the way is it seen, and how does the robot
//! get there?

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::Occupancy;
use zenav_protocol::messages::{GoalPoint, MotionReply, MotionRequest, PlanOutcome, PlanRequest, TrajectoryRequest};
use zenav_protocol::robot::RobotModel;

use super::begin::{Begin, predicted};
use super::waiting::Waiting;
use super::{Route, Search, route};
use crate::context::Context;
use crate::io::{Answer, Ask, NoAnswer, Ticket};
use crate::leaves::path;
use crate::motion::{PlanStatus, Recheck};

/// A lidar sees what is as near as this, as a share of its range: fewer beams than one a cell meet what is farther away.
const SEEN: f64 = 0.7;
/// So near to what is waited for nothing that belongs to it hides it, m.
const ITSELF: f64 = 0.4;
/// Line of sight is looked at so often, m.
const SIGHT_STEP: f64 = 0.05;
/// Places along the way are this far apart, m; nearer than this the robot need not go.
const STEP: f64 = 0.25;
const MOST_PLACES: usize = 2000;
/// The robot keeps this far away from what is waited for, beyond its circumscribed radius, m: it must be able to leave.
const KEPT: f64 = 0.5;

/// How far an approach is.
#[derive(Clone, Debug)]
pub(super) enum Approach {
    Asked(Ticket, Begin, GoalPoint),
    /// This trajectory leads there.
    Driving(u64),
}

impl Search {
    /// Brings the robot to where what it waits for is in sight; a route to be driven, once there is one.
    pub(super) fn come_nearer(&mut self, ctx: &mut Context, waiting: &Waiting) -> Option<Box<Route>> {
        match self.approach.take() {
            None => self.ask_for_approach(ctx, waiting),
            Some(Approach::Asked(ticket, begin, goal)) => match ctx.asks.take(ticket) {
                None => {
                    self.approach = Some(Approach::Asked(ticket, begin, goal));
                    None
                }
                Some(answer) => approach(begin, goal, answer),
            },
            Some(Approach::Driving(id)) => {
                let is_driven = ctx.motion.id() == Some(id)
                    && matches!(ctx.motion.status(), Some(PlanStatus::Sent | PlanStatus::Taken));
                if is_driven {
                    keep_up(ctx);
                    self.approach = Some(Approach::Driving(id));
                }
                None
            }
        }
    }

    /// Drives the approach that was found.
    pub fn approaches(&mut self, ctx: &mut Context, route: Route) {
        tracing::info!(goal = ctx.goal.id, "drives to where it sees what bars the way");
        ctx.drive(route.plan);
        self.from_rest = false;
        self.approach = ctx.motion.id().map(Approach::Driving);
    }

    fn ask_for_approach(&mut self, ctx: &mut Context, waiting: &Waiting) -> Option<Box<Route>> {
        let (Some(model), Some(map)) = (ctx.robot.model().cloned(), ctx.map.newest()) else {
            return None;
        };
        if !ctx.robot.is_at_rest() || ctx.obstacle_to_driving().is_some() {
            return None;
        }
        let place = waiting.seen_from(ctx, &model)?;
        let begin = predicted(ctx, true).ok()?;
        let goal = GoalPoint {
            x: place.x,
            y: place.y,
            yaw: None,
        };
        let plan = PlanRequest {
            via: Vec::new(),
            goal: Pose2::new(place.x, place.y, 0.0),
            ..self.plan_request(ctx, model, map, begin.pose)
        };
        let request = TrajectoryRequest {
            plan,
            start_velocity: begin.twist,
            goal_yaw: None,
            profile: ctx.goal.profile,
        };
        let ask = Ask::Motion(Box::new(MotionRequest::Trajectory(request)));
        self.approach = Some(Approach::Asked(ctx.asks.ask(ask), begin, goal));
        None
    }
}

impl Waiting {
    /// Whether some of what is waited for is in sight from where the robot is, whichever way it looks.
    pub(super) fn is_in_sight(&self, ctx: &Context) -> bool {
        let (Some(pose), Some(model)) = (ctx.robot.pose(), ctx.robot.model()) else {
            return true;
        };
        self.is_seen_from(ctx, model, pose.position())
    }

    fn is_seen_from(&self, ctx: &Context, model: &RobotModel, place: Point2<f64>) -> bool {
        let range = model.all_lidars().map(|(_, lidar)| lidar.range_max).fold(0.0, f64::max);
        self.cells.iter().any(|cell| {
            let off = cell - place;
            let distance = off.norm();
            let steps = ((distance - ITSELF) / SIGHT_STEP).max(0.0) as u32;
            distance <= self.told_within.min(SEEN * range)
                && (1..=steps).all(|step| {
                    let between = place + off * (SIGHT_STEP * f64::from(step) / distance);
                    ctx.map.occupancy(between) != Some(Occupancy::Occupied)
                })
        })
    }

    /// The first place on the way from which some of it is in sight; `None` where the robot would come too near to it, or is there.
    fn seen_from(&self, ctx: &Context, model: &RobotModel) -> Option<Point2<f64>> {
        let from = ctx.robot.pose()?.position();
        let kept = model.footprint.circumscribed_radius() + KEPT;
        let places = path::spaced(&self.way, STEP, MOST_PLACES);
        let place = places
            .into_iter()
            .map(|(place, _)| place)
            .take_while(|place| self.cells.iter().all(|cell| (cell - place).norm() > kept))
            .find(|place| self.is_seen_from(ctx, model, *place))?;
        ((place - from).norm() > STEP).then_some(place)
    }
}

/// The route of an answer.
fn approach(begin: Begin, goal: GoalPoint, answer: Result<Answer, NoAnswer>) -> Option<Box<Route>> {
    let Ok(Answer::Motion(reply)) = answer else { return None };
    let MotionReply::Trajectory(reply) = *reply else {
        return None;
    };
    let (PlanOutcome::Found { path, .. }, Some(smooth)) = (reply.plan.outcome, reply.smooth) else {
        return None;
    };
    let is_driven = path.len() >= 2 && !smooth.trajectory.is_empty();
    is_driven.then(|| {
        Box::new(route(
            begin,
            goal,
            path,
            smooth.map,
            smooth.trajectory,
            smooth.statistics,
        ))
    })
}

/// Renews the plan in force while it is free.
fn keep_up(ctx: &mut Context) {
    if ctx.motion.age(ctx.now) < ctx.config.settings.renew_period {
        return;
    }
    let time = ctx.robot.state().and_then(|state| ctx.motion.time(state, 0.0, 0.0));
    let escape = ctx.config.settings.escape;
    let free = ctx
        .space_now()
        .is_ok_and(|space| ctx.motion.recheck(&space, time.unwrap_or(0.0), escape) == Recheck::Free);
    if free {
        ctx.renew();
    }
}
