//! Past others. A path past robots that have right of way and whose courses are known, its trajectory, and when the robot arrives.
//!
//! Everything about the other robots is in the request, so a recorded request gives the same answer again. The map is marked with the discs
//! that they occupy when this robot passes them, and the path is smoothed there.

use std::sync::Arc;

use zenav_planning::{Budget, SpaceTimeQuery, pulled, search_space_time};
use zenav_protocol::map_replica::MapReplica;
use zenav_protocol::messages::{KnownCourse, PlanOutcome, PlanReply, Refusal, TrajectoryReply, TrajectoryRequest};
use zenav_space::{Fit, UnknownPolicy};

use super::{Given, MotionWorker, checked};

/// Least room kept free beside a path past other robots, m.
const BESIDE: f64 = 0.05;

impl MotionWorker {
    /// A path past the robots of `yield_to`, and its trajectory. There is none if the request has poses to pass, or if every path leads
    /// through a place without room to turn.
    pub(super) fn past_others(
        &mut self,
        given: &mut Given<'_>,
        request: &TrajectoryRequest,
    ) -> Result<TrajectoryReply, Refusal> {
        let plan = &request.plan;
        if plan.yield_to.len() > KnownCourse::MOST || !plan.yield_to.iter().all(KnownCourse::is_sound) {
            return Err(Refusal::bad_request(format!(
                "`yield_to`: expected at most {} courses of 1 to {} places in order of time",
                KnownCourse::MOST,
                KnownCourse::MOST_PLACES
            )));
        }
        let model = checked(&plan.model)?;
        let began = (given.clock)();
        let mut reply = TrajectoryReply {
            plan: PlanReply::without_path(
                given.map.map_or(&plan.map, MapReplica::map).clone(),
                PlanOutcome::NoPath,
            ),
            smooth: None,
            arrival_secs: None,
        };
        let is_on = |map: &&MapReplica| {
            let ends = [plan.start.position(), plan.goal.position()];
            ends.iter().all(|end| map.grid().spec().cell_at(*end).is_some())
        };
        let Some(map) = given.map.filter(|_| plan.via.is_empty()).filter(is_on) else {
            return Ok(reply);
        };
        let policy = UnknownPolicy::of(plan.unknown_is_free);
        let radius = model.footprint.circumscribed_radius();
        let settings = self.settings.planning.space_time.clone();
        let query = SpaceTimeQuery {
            start: plan.start.position(),
            goal: plan.goal.position(),
            speed: settings.speed * model.drive.top_speed(),
            radius,
            courses: &plan.yield_to,
        };
        let space = self.spaces.get(map, &model.footprint, policy, Fit::Full);
        let space = space.for_disc(radius);
        let budget = Budget {
            max_expansions: self.settings.planning.max_expansions,
            max_samples: 0,
            cancel: Some(&given.cancel.search),
        };
        self.searched = false;
        let found = search_space_time(&space, &query, &settings, budget);
        reply.plan.search_ms = ((given.clock)() - began) * 1e3;
        let Some(found) = found.filter(|_| !budget.is_cancelled()) else {
            return Ok(reply);
        };
        reply.plan.expansions = found.expansions;
        let discs = found.meets(&query, &settings, BESIDE.max(map.grid().spec().resolution));
        let around = self.spaces.with_discs(map, &model.footprint, policy, &discs);
        let path = pulled(&around.for_disc(radius), &found);
        let length = path.windows(2).map(|leg| (leg[1] - leg[0]).norm()).sum();
        let on_path = PlanReply {
            outcome: PlanOutcome::Found { path, length },
            ..reply.plan.clone()
        };
        given.around = Some(Arc::new(around));
        let smooth = self.smooth_found(given, request, &on_path);
        given.around = None;
        if let Some(smooth) = smooth?.filter(|smooth| !smooth.trajectory.is_empty()) {
            // Waits are not in the trajectory: the robot makes them itself, where it gives way.
            let driven = smooth.trajectory.end_time() + found.waits;
            reply.arrival_secs = Some(found.arrival().max(driven) + found.in_the_way);
            (reply.plan, reply.smooth) = (on_path, Some(smooth));
        }
        Ok(reply)
    }
}
