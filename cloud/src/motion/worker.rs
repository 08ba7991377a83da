//! Motion worker. Which path can the robot drive, and what is its trajectory?
//!
//! Pure: a request, a copy of the map, a clock for the statistics, and flags that end a phase early, in; a reply out.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::Point2;
use zenav_planning::{Budget, PlanOptions, Planned, Planner, PlanningSettings, Replanner, Searcher};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::map_replica::MapReplica;
use zenav_protocol::messages::{
    MotionReply, MotionRequest, PlanOrigin, PlanOutcome, PlanReply, PlanRequest, PlanStatistics, Refusal, SmoothReply,
    SmoothRequest, TrajectoryReply, TrajectoryRequest,
};
use zenav_protocol::robot::{Footprint, RobotModel};
use zenav_protocol::trajectory::Trajectory;
use zenav_smoothing::{SAMPLE_PERIOD, SmoothQuery, SmoothingSettings, smooth};
use zenav_space::{ConfigurationSpace, SpaceCache, UnknownPolicy, Zones};

use super::via::{pieces, sum};

/// Robots and maps that searches are kept for.
const MAX_REPLANNERS: usize = 4;
/// Most corner points of a given path, and most poses to pass.
const MAX_POINTS: usize = 100_000;
const MAX_VIA: usize = 1000;

/// Settings of a motion worker's libraries.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MotionSettings {
    /// How paths are planned.
    pub planning: PlanningSettings,
    /// How they become trajectories.
    pub smoothing: SmoothingSettings,
}

/// Ends the phases of an answer early. The worker knows no time: whoever runs it sets these.
#[derive(Debug, Default)]
pub struct Cancel {
    /// Ends searches: there is no path then.
    pub search: AtomicBool,
    /// Ends smoothing: the path goes out unsmoothed then.
    pub smoothing: AtomicBool,
}

impl Cancel {
    /// Ends both.
    pub fn all(&self) {
        self.search.store(true, Ordering::Relaxed);
        self.smoothing.store(true, Ordering::Relaxed);
    }
}

/// Answers motion requests one after the other; keeps the configuration spaces and searches that it prepared.
#[derive(Debug, Default)]
pub struct MotionWorker {
    spaces: SpaceCache,
    settings: MotionSettings,
    /// The one used last comes first.
    replanners: VecDeque<Kept>,
    /// Whether the last answer was searched for.
    searched: bool,
}

/// What is kept of a map for a footprint.
#[derive(Debug)]
struct Kept {
    map: String,
    footprint: Footprint,
    policy: UnknownPolicy,
    replanner: Replanner,
}

/// What an answer is worked out with.
struct Given<'a> {
    map: Option<&'a MapReplica>,
    clock: &'a mut dyn FnMut() -> f64,
    cancel: &'a Cancel,
}

impl MotionWorker {
    /// A worker for maps with these zones.
    #[must_use]
    pub fn new(zones: Arc<Zones>, settings: MotionSettings) -> Self {
        Self {
            spaces: SpaceCache::new(zones),
            settings,
            ..Self::default()
        }
    }

    /// Edges of the trees that the last search grew, map frame, m, at most `limit` of them; none after a search on the grid.
    #[must_use]
    pub fn tree(&self, limit: usize) -> Vec<[Point2<f64>; 2]> {
        let last = self.replanners.front().filter(|_| self.searched);
        last.map(|kept| kept.replanner.tree(limit)).unwrap_or_default()
    }

    /// Answers a request on a copy of the robot's map. `clock` (s) tells times for the statistics only.
    ///
    /// # Errors
    /// [`Refusal::BadRequest`] for numbers that are not finite, too many points, a robot that cannot be, and a planner that there is
    /// not; [`Refusal::NotFound`] where a path is to be smoothed without a map.
    pub fn answer(
        &mut self,
        map: Option<&MapReplica>,
        request: &MotionRequest,
        clock: &mut dyn FnMut() -> f64,
        cancel: &Cancel,
    ) -> Result<MotionReply, Refusal> {
        let mut given = Given {
            map: map.filter(|map| !map.grid().spec().is_empty()),
            clock,
            cancel,
        };
        Ok(match request {
            MotionRequest::Plan(request) => MotionReply::Plan(self.plan(&mut given, request)?),
            MotionRequest::Smooth(request) => MotionReply::Smooth(self.smooth(&mut given, request)?),
            MotionRequest::Trajectory(request) => MotionReply::Trajectory(self.trajectory(&mut given, request)?),
        })
    }

    /// A path, and its trajectory.
    fn trajectory(&mut self, given: &mut Given<'_>, request: &TrajectoryRequest) -> Result<TrajectoryReply, Refusal> {
        let mut plan = self.plan(given, &request.plan)?;
        let mut smooth = self.smooth_found(given, request, &plan)?;
        // The planner looks at straight legs and turns on the spot; in the end the goal's heading, or what the robot's speed asks of the
        // start, may need more room than that: a path with room for a larger disc gives it.
        for radius in larger_discs(&request.plan.model.footprint) {
            if !smooth.as_ref().is_some_and(|reply| reply.trajectory.is_empty()) {
                break;
            }
            let mut roomier = request.plan.clone();
            roomier.model.footprint = Footprint::Radius(radius);
            let other = self.plan(given, &roomier)?;
            if matches!(other.outcome, PlanOutcome::Found { .. }) {
                smooth = self.smooth_found(given, request, &other)?;
                plan = other;
            }
        }
        Ok(TrajectoryReply { plan, smooth })
    }

    /// The trajectory along the path of an answer; `None` where there is no path.
    fn smooth_found(
        &mut self,
        given: &mut Given<'_>,
        request: &TrajectoryRequest,
        plan: &PlanReply,
    ) -> Result<Option<SmoothReply>, Refusal> {
        match &plan.outcome {
            PlanOutcome::Found { path, .. } => {
                let request = request.smooth(plan.map.clone(), path.clone());
                self.smooth(given, &request).map(Some)
            }
            _ => Ok(None),
        }
    }

    /// A path through all poses that are to be passed.
    fn plan(&mut self, given: &mut Given<'_>, request: &PlanRequest) -> Result<PlanReply, Refusal> {
        let map = given.map;
        let planner: Planner = request.planner.parse().map_err(Refusal::bad_request)?;
        let poses: Vec<Pose2> = [request.start]
            .into_iter()
            .chain(request.via.iter().copied())
            .chain([request.goal])
            .collect();
        if request.via.len() > MAX_VIA || !request.escape.is_finite() || !poses.iter().all(Pose2::is_finite) {
            return Err(Refusal::bad_request(format!(
                "start, goal and at most {MAX_VIA} poses between: expected finite numbers"
            )));
        }
        let cleared = &request.cleared;
        if cleared.len() > MAX_POINTS || !cleared.iter().all(|point| point.x.is_finite() && point.y.is_finite()) {
            return Err(Refusal::bad_request(format!(
                "`cleared`: expected at most {MAX_POINTS} points of finite numbers"
            )));
        }
        let model = checked(&request.model)?;
        let mut reply = PlanReply {
            map: map.map_or_else(|| request.map.clone(), |map| map.map().clone()),
            outcome: PlanOutcome::NoMap,
            leg: 0,
            escapes: false,
            search_ms: 0.0,
            expansions: 0,
            origin: PlanOrigin::Searched,
        };
        let Some(map) = map else { return Ok(reply) };
        let began = (given.clock)();
        let (mut whole, mut total): (Vec<Point2<f64>>, f64) = (Vec::new(), 0.0);
        let policy = UnknownPolicy::of(request.unknown_is_free);
        // Another map than the robot's: nothing of it is kept.
        let without = (!cleared.is_empty()).then(|| self.spaces.cleared(map, &model.footprint, policy, cleared));
        for (leg, ends) in poses.windows(2).enumerate() {
            let [start, goal] = [ends[0], ends[1]];
            let options = PlanOptions {
                seed: request.seed,
                settings: self.settings.planning.clone(),
                escape: if leg == 0 { request.escape } else { 0.0 },
                ..PlanOptions::new(planner)
            };
            let planned = match &without {
                Some(space) => self.leg_on(space, (start, goal), &options, given.cancel)?,
                None => self.leg(map, &model, policy, (start, goal), &options, given.cancel)?,
            };
            reply.expansions += planned.expansions;
            reply.escapes |= planned.escapes;
            reply.origin = planned.origin;
            let PlanOutcome::Found { path, length } = planned.outcome else {
                (reply.outcome, reply.leg) = (planned.outcome, leg);
                reply.search_ms = ((given.clock)() - began) * 1e3;
                return Ok(reply);
            };
            // One leg ends where the next begins.
            whole.extend(path.into_iter().skip(usize::from(leg > 0)));
            total += length;
        }
        reply.outcome = PlanOutcome::Found {
            path: whole,
            length: total,
        };
        reply.search_ms = ((given.clock)() - began) * 1e3;
        Ok(reply)
    }

    /// A path between two poses.
    fn leg(
        &mut self,
        map: &MapReplica,
        model: &RobotModel,
        policy: UnknownPolicy,
        (start, goal): (Pose2, Pose2),
        options: &PlanOptions,
        cancel: &Cancel,
    ) -> Result<Planned, Refusal> {
        let space = self.spaces.get(map, &model.footprint, policy);
        let same = |kept: &Kept| kept.map == map.map().id && kept.policy == policy && kept.footprint == model.footprint;
        let at = self.replanners.iter().position(same);
        let mut kept = match at.and_then(|at| self.replanners.remove(at)) {
            Some(kept) => kept,
            None => Kept {
                map: map.map().id.clone(),
                footprint: model.footprint.clone(),
                policy,
                replanner: Replanner::new(&space).map_err(Refusal::internal)?,
            },
        };
        let planned = kept
            .replanner
            .plan(&space, start, goal, options, budget(options, cancel));
        self.replanners.push_front(kept);
        self.replanners.truncate(MAX_REPLANNERS);
        let planned = planned.map_err(Refusal::internal)?;
        self.searched = planned.origin == PlanOrigin::Searched;
        Ok(planned)
    }

    /// A path between two poses in a space that is not kept.
    fn leg_on(
        &mut self,
        space: &ConfigurationSpace,
        (start, goal): (Pose2, Pose2),
        options: &PlanOptions,
        cancel: &Cancel,
    ) -> Result<Planned, Refusal> {
        let mut searcher = Searcher::new(space.free()).map_err(Refusal::internal)?;
        self.searched = false;
        let budget = budget(options, cancel);
        Ok(zenav_planning::plan(space, &mut searcher, start, goal, options, budget))
    }

    /// The trajectory along a path; a path that cannot be smoothed still gets a safe one.
    fn smooth(&mut self, given: &mut Given<'_>, request: &SmoothRequest) -> Result<SmoothReply, Refusal> {
        let finite = request.start.is_finite()
            && request.start_velocity.is_finite()
            && request.goal_yaw.is_none_or(f64::is_finite)
            && request
                .path
                .iter()
                .chain(&request.via)
                .all(|point| point.x.is_finite() && point.y.is_finite());
        if !finite || request.path.len() > MAX_POINTS || request.via.len() > MAX_VIA {
            return Err(Refusal::bad_request(format!(
                "expected finite numbers, at most {MAX_POINTS} points, and at most {MAX_VIA} to stop at"
            )));
        }
        let model = checked(&request.model)?;
        let Some(map) = given.map else {
            return Err(Refusal::NotFound {
                what: format!("a map of {}", request.robot),
            });
        };
        let space = self
            .spaces
            .get(map, &model.footprint, UnknownPolicy::of(request.unknown_is_free));
        let mut reply = SmoothReply {
            map: map.map().clone(),
            trajectory: Trajectory::default(),
            statistics: PlanStatistics::default(),
        };
        let (mut start, mut start_velocity) = (request.start, request.start_velocity);
        let pieces = pieces(&request.path, &request.via);
        for (index, path) in pieces.iter().enumerate() {
            let query = SmoothQuery {
                path,
                start,
                start_velocity,
                goal_yaw: request.goal_yaw.filter(|_| index + 1 == pieces.len()),
                profile: request.profile,
            };
            let settings = &self.settings.smoothing;
            let smoothed = smooth(
                &space,
                &query,
                &model,
                settings,
                Some(&given.cancel.smoothing),
                &mut *given.clock,
            );
            let trajectory = smoothed.sampled(SAMPLE_PERIOD);
            reply.statistics = sum(reply.statistics, smoothed.statistics);
            let Some(last) = trajectory.last() else {
                reply.trajectory = trajectory;
                return Ok(reply);
            };
            (start, start_velocity) = (last.pose(), Twist2::ZERO);
            reply.trajectory = reply.trajectory.then(&trajectory);
        }
        Ok(reply)
    }
}

/// Radii of the discs to plan for where the path of a polygon cannot be driven: halfway to the circumscribed one, and that one, m.
fn larger_discs(footprint: &Footprint) -> Vec<f64> {
    match footprint {
        Footprint::Radius(_) => Vec::new(),
        Footprint::Polygon(_) => {
            let (inner, outer) = (footprint.inscribed_radius(), footprint.circumscribed_radius());
            vec![0.5 * (inner + outer), outer]
        }
    }
}

fn budget<'a>(options: &PlanOptions, cancel: &'a Cancel) -> Budget<'a> {
    Budget {
        max_expansions: options.settings.max_expansions,
        max_samples: options.settings.max_samples,
        cancel: Some(&cancel.search),
    }
}

fn checked(model: &RobotModel) -> Result<RobotModel, Refusal> {
    model.clone().checked("model").map_err(Refusal::bad_request)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
mod tests {
    use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
    use zenav_protocol::messages::{DrivingProfile, MapInfo, MapRef, MapReply};
    use zenav_protocol::time::Stamp;
    use zenav_protocol::trajectory::TrajectoryPoint;

    use super::*;

    /// A hall of 6 m by 4 m with a wall across that leaves a door of a width (m) between y = 2 m and there.
    fn hall(door: f64) -> MapReplica {
        let spec = GridSpec {
            origin: Point2::origin(),
            resolution: 0.05,
            width: 120,
            height: 80,
        };
        let mut grid = OccupancyGrid::filled(spec, Occupancy::FREE);
        for y in (0..80).filter(|y| !(2.0..2.0 + door).contains(&(0.05 * f64::from(*y) + 0.025))) {
            grid[Cell::new(60, y)] = Occupancy::OCCUPIED;
        }
        let info = MapInfo {
            stamp: Stamp::ZERO,
            map: MapRef {
                id: "hall".to_owned(),
                revision: 1,
            },
            spec,
            free: 0,
            occupied: 0,
            unknown: 0,
            scans: 0,
            stored: true,
        };
        let mut replica = MapReplica::new();
        replica.replace(&MapReply {
            info,
            values: grid.values().to_vec(),
            trajectory: Vec::new(),
        });
        replica
    }

    fn request(robot: &str, planner: &str) -> TrajectoryRequest {
        TrajectoryRequest {
            plan: PlanRequest {
                robot: "r".to_owned(),
                model: zenav_fixtures::robot(robot),
                map: MapRef::default(),
                start: Pose2::new(1.0, 1.0, 0.0),
                via: Vec::new(),
                goal: Pose2::new(5.0, 1.0, 0.0),
                planner: planner.to_owned(),
                unknown_is_free: false,
                cleared: Vec::new(),
                escape: 0.6,
                budget_ms: 5000,
                seed: 1,
            },
            start_velocity: Twist2::ZERO,
            goal_yaw: Some(0.0),
            profile: DrivingProfile::default(),
        }
    }

    fn ask(map: &MapReplica, request: &TrajectoryRequest, cancel: &Cancel) -> TrajectoryReply {
        let request = MotionRequest::Trajectory(request.clone());
        match MotionWorker::default().answer(Some(map), &request, &mut || 0.0, cancel) {
            Ok(MotionReply::Trajectory(reply)) => reply,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_trajectory_stops_at_the_poses_that_it_is_to_pass_and_cuts_no_corner_there() {
        let mut request = request("tiago", "astar");
        request.plan.via = vec![
            Pose2::new(1.0, 3.0, 0.0),
            Pose2::new(2.0, 3.0, 0.0),
            Pose2::new(2.0, 1.0, 0.0),
        ];
        let reply = ask(&hall(1.5), &request, &Cancel::default()).smooth.unwrap();
        let mut from = 0.0;
        for stop in request.plan.via.iter().chain([&request.plan.goal]) {
            let is_there = |point: &&TrajectoryPoint| {
                point.t > from && (point.position() - stop.position()).norm() < 1e-3 && point.v.abs() < 1e-6
            };
            from = reply
                .trajectory
                .iter()
                .find(is_there)
                .unwrap_or_else(|| panic!("{stop:?}"))
                .t;
        }
        assert!(reply.trajectory.windows(2).all(|pair| pair[0].t < pair[1].t));
        assert!((reply.statistics.duration - from).abs() < 0.2, "{:?}", reply.statistics);
    }

    #[test]
    fn one_answer_holds_the_path_and_its_trajectory_to_rest_at_the_goal() {
        let (map, request) = (hall(1.25), request("tiago", "astar"));
        let reply = ask(&map, &request, &Cancel::default());
        let PlanOutcome::Found { path, .. } = &reply.plan.outcome else {
            panic!("{:?}", reply.plan.outcome)
        };
        assert_eq!(path.first(), Some(&request.plan.start.position()));
        let smooth = reply.smooth.unwrap();
        assert_eq!(smooth.statistics.status, "smoothed");
        let last = smooth.trajectory.last().unwrap();
        assert!(last.pose().distance(&request.plan.goal) < 1e-6 && last.v == 0.0);
    }

    #[test]
    fn a_path_passes_the_poses_asked_for_and_a_leg_without_one_is_named() {
        let map = hall(1.25);
        let mut request = request("tiago", "astar");
        request.plan.via = vec![Pose2::new(1.0, 3.0, 0.0), Pose2::new(5.0, 3.0, 0.0)];
        let reply = ask(&map, &request, &Cancel::default());
        let PlanOutcome::Found { path, length } = &reply.plan.outcome else {
            panic!("{:?}", reply.plan.outcome)
        };
        for pose in &request.plan.via {
            assert!(path.contains(&pose.position()), "{path:?}");
        }
        assert!(*length > 8.0 && !reply.smooth.unwrap().trajectory.is_empty());
        request.plan.via[1] = Pose2::new(3.025, 1.0, 0.0);
        let reply = ask(&map, &request, &Cancel::default());
        assert!(matches!(reply.plan.outcome, PlanOutcome::GoalOccupied { .. }) && reply.plan.leg == 1);
        assert_eq!(reply.smooth, None);
    }

    #[test]
    fn a_robot_that_by_the_map_stands_in_something_leaves_it_if_it_may() {
        let map = hall(1.25);
        let mut request = request("tiago", "astar");
        request.plan.start = Pose2::new(2.95, 1.0, 0.0);
        let reply = ask(&map, &request, &Cancel::default());
        assert!(reply.plan.escapes && !reply.smooth.unwrap().trajectory.is_empty());
        request.plan.escape = 0.0;
        let reply = ask(&map, &request, &Cancel::default());
        assert!(matches!(reply.plan.outcome, PlanOutcome::StartOccupied { .. }));
    }

    #[test]
    fn a_path_without_what_may_leave_is_told_and_nothing_of_it_is_kept() {
        let (map, mut worker) = (hall(0.0), MotionWorker::default());
        let mut plan = request("tiago", "astar").plan;
        let mut ask = |plan: &PlanRequest| {
            let request = MotionRequest::Plan(plan.clone());
            match worker.answer(Some(&map), &request, &mut || 0.0, &Cancel::default()) {
                Ok(MotionReply::Plan(reply)) => Ok(reply.outcome),
                Err(refusal) => Err(refusal),
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(ask(&plan), Ok(PlanOutcome::NoPath));
        plan.cleared = (40..60)
            .map(|y| Point2::new(3.025, 0.05 * f64::from(y) + 0.025))
            .collect();
        assert!(matches!(ask(&plan), Ok(PlanOutcome::Found { .. })));
        plan.cleared.push(Point2::new(f64::NAN, 0.0));
        assert!(matches!(ask(&plan), Err(Refusal::BadRequest { .. })));
        plan.cleared.clear();
        assert_eq!(ask(&plan), Ok(PlanOutcome::NoPath));
    }

    #[test]
    fn a_body_that_no_disc_stands_for_gets_a_path_that_it_can_drive_by_every_planner() {
        for planner in ["astar", "theta", "jps", "rrt_connect"] {
            let reply = ask(&hall(0.8), &request("jackal", planner), &Cancel::default());
            let smooth = reply
                .smooth
                .unwrap_or_else(|| panic!("{planner}: {:?}", reply.plan.outcome));
            assert!(!smooth.trajectory.is_empty(), "{planner}: {}", smooth.statistics.status);
        }
    }

    #[test]
    fn a_search_out_of_time_has_no_path_and_a_smoother_out_of_time_a_safe_trajectory() {
        let (map, request) = (hall(1.25), request("tiago", "astar"));
        let over = || AtomicBool::new(true);
        let no_search = Cancel {
            search: over(),
            ..Cancel::default()
        };
        assert_eq!(ask(&map, &request, &no_search).plan.outcome, PlanOutcome::TimedOut);
        let no_smoothing = Cancel {
            smoothing: over(),
            ..Cancel::default()
        };
        let smooth = ask(&map, &request, &no_smoothing).smooth.unwrap();
        assert_eq!(smooth.statistics.status, "fallback:timed_out");
        assert!(smooth.trajectory.last().unwrap().pose().distance(&request.plan.goal) < 0.01);
    }
}
