//! Approach. The obstacle on the way is out of sight, so its departure would go unnoticed: from which place along the way is it visible,
//! and how does the robot get there?
//!
//! The robot drives there by a separate plan, checked and renewed like any other, while the search continues. A goal has a limited number
//! of tries, with growing pauses; while the obstacle is out of sight, the time that it has been there does not count.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::Occupancy;
use zenav_protocol::messages::{GoalPoint, MotionReply, MotionRequest, PlanOutcome, PlanRequest, TrajectoryRequest};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;
use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};

use super::answer::route;
use super::begin::{Begin, predicted};
use super::waiting::Waiting;
use super::{Route, Search};
use crate::context::Context;
use crate::io::{Answer, NoAnswer, Ticket};
use crate::leaves::path::{self, DrivenPath};
use crate::motion::{PlanStatus, Recheck};

/// A lidar sees an obstacle within this share of its range, and within this distance, m: farther away there is less than one beam per cell.
const SEEN: (f64, f64) = (0.7, 12.0);
/// Cells this near to the obstacle belong to it and do not hide it, m.
const ITSELF: f64 = 0.4;
/// Step along a line of sight, m, and number of the obstacle's cells that are checked.
const SIGHT_STEP: f64 = 0.05;
const SIGHTS: usize = 8;
/// Spacing of the places checked along the way, m; also the least distance worth driving.
const STEP: f64 = 0.25;
const MOST_PLACES: usize = 2000;
/// Distance that the robot keeps from the obstacle, beyond its circumscribed radius, m: the obstacle must be able to leave.
const KEPT: f64 = 0.5;
/// Spacing of the places of a plan that are compared with an obstacle, m.
pub(super) const PLAN_STEP: f64 = 0.05;
/// Greatest distance of the robot from the start of its plan when it sets out, m.
const BEGINS: f64 = 0.15;
/// Most tries of a goal; each waits this much longer than the one before, s.
const MOST_TRIES: u32 = 12;
const LATER: f64 = 1.0;

/// Number of approaches made for a goal, and earliest time of the next.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Tries {
    count: u32,
    after: Stamp,
}

impl Tries {
    /// Whether any tries are left.
    pub(super) fn are_left(&self) -> bool {
        self.count < MOST_TRIES
    }
}

/// State of an approach.
#[derive(Clone, Debug)]
pub(super) enum Approach {
    Asked(Ticket, Begin, GoalPoint),
    /// The trajectory that leads there; checked on a map revision and a count of zone changes.
    Driving {
        id: u64,
        revision: u64,
        zones: u64,
    },
}

impl Search {
    /// Continues the approach to a place where the obstacle is in sight; returns a route to drive, once there is one. Otherwise `None`.
    pub(super) fn come_nearer(&mut self, ctx: &mut Context, waiting: &Waiting) -> Option<Box<Route>> {
        match self.approach.take()? {
            Approach::Asked(ticket, begin, goal) => match ctx.asks.take(ticket) {
                None => {
                    self.approach = Some(Approach::Asked(ticket, begin, goal));
                    None
                }
                Some(answer) => approach(ctx, begin, goal, answer),
            },
            Approach::Driving { id, revision, zones } => {
                if self.is_driving(ctx, id) && !waiting.is_in_sight(ctx) {
                    self.approach = keep_up(ctx, id, (revision, zones));
                } else if self.is_driving(ctx, id) {
                    // Near enough.
                    ctx.hold();
                }
                None
            }
        }
    }

    fn is_driving(&self, ctx: &Context, id: u64) -> bool {
        ctx.motion.id() == Some(id)
            && !ctx.motion.is_held()
            && matches!(ctx.motion.status(), Some(PlanStatus::Sent | PlanStatus::Taken))
    }

    /// Whether an approach is under way.
    pub(super) fn is_approaching(&self) -> bool {
        self.approach.is_some()
    }

    /// Drives the approach that was found.
    pub fn approaches(&mut self, ctx: &mut Context, route: Route) {
        let before = ctx.motion.id();
        ctx.drive(route.plan);
        let Some(id) = ctx.motion.id().filter(|id| Some(*id) != before) else {
            return;
        };
        tracing::info!(goal = ctx.goal.id, "drives to where it sees what bars the way");
        (self.from_rest, self.replaces) = (false, false);
        self.approach = Some(Approach::Driving {
            id,
            revision: ctx.map.revision(),
            zones: ctx.map.zone_changes(),
        });
    }

    /// Ends the approach: the robot comes to rest on its plan.
    pub(super) fn end_approach(&mut self, ctx: &mut Context) {
        match self.approach.take() {
            Some(Approach::Asked(ticket, ..)) => ctx.asks.forget(ticket),
            Some(Approach::Driving { id, .. }) if ctx.motion.id() == Some(id) => {
                ctx.hold();
                ctx.motion.clear();
            }
            _ => {}
        }
    }

    /// Requests a path to a place where the obstacle is in sight; returns whether it did.
    pub(super) fn ask_for_approach(&mut self, ctx: &mut Context, waiting: &Waiting) -> bool {
        let (Some(model), Some(map)) = (ctx.robot.model().cloned(), ctx.map.newest()) else {
            return false;
        };
        let tries = ctx.goal.tries;
        let may = tries.are_left() && ctx.now >= tries.after && self.may_approach;
        if !may || !may_set_out(ctx) {
            return false;
        }
        ctx.goal.tries = Tries {
            count: tries.count + 1,
            after: ctx.now.plus_secs(LATER * f64::from(tries.count + 1)),
        };
        let Some(place) = waiting.seen_from(ctx, &model) else {
            return false;
        };
        let Ok(begin) = predicted(ctx, true) else { return false };
        let goal = GoalPoint::at(place.x, place.y);
        let plan = PlanRequest {
            via: Vec::new(),
            goal: goal.pose(),
            ..self.plan_request(ctx, model, map, begin.pose)
        };
        let request = TrajectoryRequest {
            plan,
            start_velocity: begin.twist,
            goal_yaw: None,
            profile: ctx.goal.profile,
        };
        let ticket = ctx.asks.ask_motion(MotionRequest::Trajectory(request));
        self.approach = Some(Approach::Asked(ticket, begin, goal));
        true
    }
}

impl Waiting {
    /// Whether part of the obstacle is in sight from the robot's position, in any direction.
    pub(super) fn is_in_sight(&self, ctx: &Context) -> bool {
        let (Some(pose), Some(model)) = (ctx.robot.pose(), ctx.robot.model()) else {
            return true;
        };
        self.is_seen_from(ctx, model, pose.position())
    }

    fn is_seen_from(&self, ctx: &Context, model: &RobotModel, place: Point2<f64>) -> bool {
        let range = model.all_lidars().map(|(_, lidar)| lidar.range_max).fold(0.0, f64::max);
        let within = (SEEN.0 * range).min(SEEN.1).min(self.told_within);
        let every = self.cells.len().div_ceil(SIGHTS).max(1);
        self.cells.iter().step_by(every).any(|cell| {
            let off = cell - place;
            let distance = off.norm();
            let steps = ((distance - ITSELF) / SIGHT_STEP).max(0.0) as u32;
            distance <= within
                && (1..=steps).all(|step| {
                    let between = place + off * (SIGHT_STEP * f64::from(step) / distance);
                    ctx.map.occupancy(between) != Some(Occupancy::Occupied)
                })
        })
    }

    /// The first place on the way from which part of the obstacle is in sight; `None` if it is too near to the obstacle, or the robot is
    /// already there.
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

    /// Plan time at which the robot, on the plan in force, comes nearer to the obstacle than the distance that it keeps, s.
    pub(super) fn kept_off_until(&self, ctx: &Context) -> Option<f64> {
        let kept = ctx.robot.model()?.footprint.circumscribed_radius() + KEPT;
        comes_near(ctx.motion.trajectory()?, ctx.plan_time()?, &self.cells, kept)
    }

    /// Whether the moving robot can still stop at that distance.
    pub(super) fn may_be_kept_off(&self, ctx: &Context) -> bool {
        let times = self.kept_off_until(ctx).zip(ctx.plan_time()).zip(ctx.stopping_time());
        times.is_some_and(|((until, time), stopping)| until - time >= stopping)
    }
}

/// First time from plan time `from` on at which a trajectory is `kept` (m) or less away from one of these cells, s.
fn comes_near(trajectory: &Trajectory, from: f64, cells: &[Point2<f64>], kept: f64) -> Option<f64> {
    let is_near = |point: &TrajectoryPoint| cells.iter().any(|cell| (cell - point.position()).norm() <= kept);
    let mut places = trajectory.spaced(from, PLAN_STEP, f64::INFINITY);
    places.find(is_near).map(|point| point.t)
}

/// Whether the robot is at rest, and nothing prevents driving.
fn may_set_out(ctx: &Context) -> bool {
    ctx.robot.is_at_rest()
        && ctx.obstacle_to_driving().is_none()
        && ctx.frames.is_settled()
        && ctx.robot.frame() == ctx.frames.at()
}

/// The route of an answer, if it can be driven now.
fn approach(ctx: &mut Context, begin: Begin, goal: GoalPoint, answer: Result<Answer, NoAnswer>) -> Option<Box<Route>> {
    let Ok(Answer::Motion(reply)) = answer else { return None };
    let MotionReply::Trajectory(reply) = *reply else {
        return None;
    };
    let (PlanOutcome::Found { path, .. }, Some(smooth)) = (reply.plan.outcome, reply.smooth) else {
        return None;
    };
    let is_there = |pose: Pose2| pose.distance(&begin.pose) < BEGINS;
    let is_driven = path.len() >= 2
        && !smooth.trajectory.is_empty()
        && smooth.map.frame == ctx.frames.at()
        && may_set_out(ctx)
        && ctx.robot.pose().is_some_and(is_there);
    let is_free = is_driven && ctx.recheck_new(&smooth.trajectory) == Ok(Recheck::Free);
    is_free.then(|| {
        Box::new(route(
            begin,
            goal,
            DrivenPath {
                points: path,
                backwards: reply.plan.backwards,
            },
            smooth.map,
            smooth.trajectory,
            smooth.statistics,
        ))
    })
}

/// Renews the plan in force when due and free; if an obstacle has come into its way, the robot brakes, and the approach ends.
fn keep_up(ctx: &mut Context, id: u64, (revision, zones): (u64, u64)) -> Option<Approach> {
    let newest = ctx.map.revision();
    let checked = Approach::Driving {
        id,
        revision: newest,
        zones: ctx.map.zone_changes(),
    };
    let is_due = ctx.motion.age(ctx.now) >= ctx.config.settings.renew_period;
    if !is_due && newest == revision && ctx.map.zone_changes() == zones {
        return Some(checked);
    }
    match ctx.recheck_rest() {
        Ok(Recheck::Free) if is_due => ctx.renew(),
        Ok(Recheck::Blocked(ahead)) => {
            ctx.hold_within(ahead);
            return None;
        }
        // A plan that cannot be checked runs out.
        Ok(Recheck::Free) | Err(_) => {}
    }
    Some(checked)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_comes_near_an_obstacle_at_its_distance_before_it() {
        let at = |t: f64, x: f64, y: f64| TrajectoryPoint {
            t,
            x,
            y,
            ..TrajectoryPoint::default()
        };
        // 5 m along the x axis at 0.5 m/s, and back at a distance.
        let plan = Trajectory::new(vec![
            at(0.0, 0.0, 0.0),
            at(10.0, 5.0, 0.0),
            at(14.0, 5.0, 2.0),
            at(24.0, 0.0, 2.0),
        ]);
        let near = |from, x, y| comes_near(&plan, from, &[Point2::new(x, y)], 0.75);
        let is = |found: Option<f64>, secs: f64| found.is_some_and(|found| (found - secs).abs() < 0.11);
        assert!(is(near(0.0, 4.0, 0.0), 6.5));
        assert!(is(near(7.0, 4.0, 0.0), 7.0), "it is there");
        assert!(is(near(0.0, 4.0, 2.5), 14.9), "on the way back");
        assert_eq!(near(0.0, 2.5, -1.0), None);
        assert_eq!(near(10.0, 3.0, 0.0), None, "it has passed");
    }
}
