//! Motion worker. Computes a path that the robot can drive, and its trajectory.
//!
//! Pure: a request, a copy of the map, a clock for the statistics, and flags that end a phase early go in; a reply comes out.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use zenav_planning::{Budget, PlanOptions, Planned, Planner, PlanningSettings, Replanner, Searcher};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::map_replica::MapReplica;
use zenav_protocol::messages::{
    MotionReply, MotionRequest, PlanOrigin, PlanOutcome, PlanReply, PlanRequest, Refusal, SmoothReply, SmoothRequest,
    TrajectoryReply, TrajectoryRequest, check_backwards,
};
use zenav_protocol::robot::{Footprint, RobotModel};
use zenav_protocol::trajectory::Trajectory;
use zenav_smoothing::{Cuts, FreePolygon, SAMPLE_PERIOD, SmoothQuery, SmoothingSettings, smooth_pieces};
use zenav_space::{ConfigurationSpace, Fit, SpaceCache, UnknownPolicy, Zones};

mod past_others;

/// Most robots and maps whose searches are kept.
const MAX_REPLANNERS: usize = 4;
/// Most corner points of a given path, and most poses to pass.
const MAX_POINTS: usize = 100_000;
const MAX_VIA: usize = 1000;
/// Farthest that a robot may be told to move out of an obstacle, or to end beside its goal, m.
const FARTHEST: f64 = 10.0;
/// Most polygons of a corridor in an answer: all of a longer one are left out, so that no answer exceeds its key's size for the sake of a
/// picture.
const MAX_POLYGONS: usize = 256;
/// Longest path that is smoothed, m.
const LONGEST: f64 = 20_000.0;
/// Wheel speeds above this multiple of the top speed, plus a margin (m/s), are taken for an error.
const TOO_FAST: (f64, f64) = (2.0, 0.5);

/// Settings of a motion worker's libraries.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionSettings {
    /// How paths are planned.
    pub planning: PlanningSettings,
    /// How they become trajectories.
    pub smoothing: SmoothingSettings,
}

/// Ends the phases of an answer early. The worker has no clock for this: its host sets the flags.
#[derive(Debug, Default)]
pub struct Cancel {
    /// Ends searches: the answer then has no path.
    pub search: AtomicBool,
    /// Ends smoothing: the answer then has the path unsmoothed.
    pub smoothing: AtomicBool,
}

impl Cancel {
    /// Ends both.
    pub fn all(&self) {
        self.search.store(true, Ordering::Relaxed);
        self.smoothing.store(true, Ordering::Relaxed);
    }

    /// Whether a phase of this request was cancelled, or would have been if it were still running.
    #[must_use]
    pub fn has_cut_short(&self, request: &MotionRequest) -> bool {
        let searches = !matches!(request, MotionRequest::Smooth(_));
        searches && self.search.load(Ordering::Relaxed) || self.smoothing.load(Ordering::Relaxed)
    }
}

/// Answers motion requests one after the other; keeps the configuration spaces and searches it has prepared.
#[derive(Debug, Default)]
pub struct MotionWorker {
    spaces: SpaceCache,
    settings: MotionSettings,
    /// Most recently used first.
    replanners: VecDeque<Kept>,
    /// Whether the last answer came from a search.
    searched: bool,
}

/// The search kept for a map and a footprint.
#[derive(Debug)]
struct Kept {
    map: String,
    footprint: Footprint,
    policy: UnknownPolicy,
    fit: Fit,
    replanner: Replanner,
}

/// The inputs of an answer besides the request.
struct Given<'a> {
    map: Option<&'a MapReplica>,
    /// Space to smooth in instead of the map's own.
    around: Option<Arc<ConfigurationSpace>>,
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

    /// Sets the zones of all further maps.
    pub fn set_zones(&mut self, zones: Arc<Zones>) {
        self.spaces.set_zones(zones);
    }

    /// Edges of the trees grown by the last search, map frame, m, at most `limit` of them; none after a search on the grid.
    #[must_use]
    pub fn tree(&self, limit: usize) -> Vec<[Point2<f64>; 2]> {
        let last = self.replanners.front().filter(|_| self.searched);
        last.map(|kept| kept.replanner.tree(limit)).unwrap_or_default()
    }

    /// Answers a request on a copy of the robot's map. `clock` (s) is used for the statistics only.
    ///
    /// # Errors
    /// [`Refusal::BadRequest`] for numbers that are not finite, too many points, `backwards` that are no legs, an impossible robot, and an
    /// unknown planner; [`Refusal::NotFound`] for smoothing without a map.
    pub fn answer(
        &mut self,
        map: Option<&MapReplica>,
        request: &MotionRequest,
        clock: &mut dyn FnMut() -> f64,
        cancel: &Cancel,
    ) -> Result<MotionReply, Refusal> {
        let mut given = Given {
            map: map.filter(|map| !map.grid().spec().is_empty()),
            around: None,
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
        if !request.plan.yield_to.is_empty() {
            return self.past_others(given, request);
        }
        let mut plan = self.plan(given, &request.plan)?;
        let mut smooth = self.smooth_found(given, request, &plan)?;
        // The planner checks straight legs and turns on the spot. The heading at the goal, or the robot's speed at the start, may need more
        // room in the end; a path for a larger disc has it.
        for radius in larger_discs(&request.plan.model.footprint) {
            let is_late = given.cancel.smoothing.load(Ordering::Relaxed);
            if is_late || !smooth.as_ref().is_some_and(|reply| reply.trajectory.is_empty()) {
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
        Ok(TrajectoryReply {
            plan,
            smooth,
            arrival_secs: None,
        })
    }

    /// The trajectory along the path of an answer; `None` if there is no path.
    fn smooth_found(
        &mut self,
        given: &mut Given<'_>,
        request: &TrajectoryRequest,
        plan: &PlanReply,
    ) -> Result<Option<SmoothReply>, Refusal> {
        match &plan.outcome {
            PlanOutcome::Found { path, .. } => {
                let request = request.smooth(plan.map.clone(), path.clone(), plan.backwards.clone());
                self.smooth(given, &request).map(Some)
            }
            _ => Ok(None),
        }
    }

    /// A path through all requested poses.
    fn plan(&mut self, given: &mut Given<'_>, request: &PlanRequest) -> Result<PlanReply, Refusal> {
        let map = given.map;
        let planner: Planner = request.planner.parse().map_err(Refusal::bad_request)?;
        let poses: Vec<Pose2> = [request.start]
            .into_iter()
            .chain(request.via.iter().copied())
            .chain([request.goal])
            .collect();
        let is_near = |metres: f64| (0.0..=FARTHEST).contains(&metres);
        if !is_near(request.escape) || !is_near(request.goal_tolerance) {
            return Err(Refusal::bad_request(format!(
                "`escape` and `goal_tolerance`: expected 0 to {FARTHEST} m"
            )));
        }
        if request.via.len() > MAX_VIA || !poses.iter().all(Pose2::is_finite) {
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
        let planned_on = map.map_or(&request.map, MapReplica::map).clone();
        let mut reply = PlanReply::without_path(planned_on, PlanOutcome::NoMap);
        let Some(map) = map else { return Ok(reply) };
        let began = (given.clock)();
        let (mut whole, mut total): (Vec<Point2<f64>>, f64) = (Vec::new(), 0.0);
        let policy = UnknownPolicy::of(request.unknown_is_free);
        // A modified copy of the robot's map, so nothing of it is kept.
        let without = (!cleared.is_empty()).then(|| self.spaces.cleared(map, &model.footprint, policy, cleared));
        for (leg, ends) in poses.windows(2).enumerate() {
            let [start, goal] = [ends[0], ends[1]];
            let options = PlanOptions {
                seed: request.seed,
                settings: self.settings.planning.clone(),
                escape: if leg == 0 { request.escape } else { 0.0 },
                goal_tolerance: if leg == request.via.len() {
                    request.goal_tolerance
                } else {
                    0.0
                },
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
            // Each leg ends where the next begins.
            let before = whole.len().saturating_sub(1);
            reply
                .backwards
                .extend(planned.backwards.iter().map(|corner| before + corner));
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

    /// A path between two poses for the full footprint, or for the shrunk one of tight places if there is none.
    fn leg(
        &mut self,
        map: &MapReplica,
        model: &RobotModel,
        policy: UnknownPolicy,
        ends: (Pose2, Pose2),
        options: &PlanOptions,
        cancel: &Cancel,
    ) -> Result<Planned, Refusal> {
        let full = self.leg_that_fits(Fit::Full, map, model, policy, ends, options, cancel)?;
        if matches!(full.outcome, PlanOutcome::Found { .. } | PlanOutcome::TimedOut) {
            return Ok(full);
        }
        let tight = self.leg_that_fits(Fit::Tight, map, model, policy, ends, options, cancel)?;
        Ok(Planned {
            expansions: full.expansions + tight.expansions,
            ..tight
        })
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "what a path is searched in, from where to where, and how"
    )]
    fn leg_that_fits(
        &mut self,
        fit: Fit,
        map: &MapReplica,
        model: &RobotModel,
        policy: UnknownPolicy,
        (start, goal): (Pose2, Pose2),
        options: &PlanOptions,
        cancel: &Cancel,
    ) -> Result<Planned, Refusal> {
        let space = self.spaces.get(map, &model.footprint, policy, fit);
        let same = |kept: &Kept| {
            kept.map == map.map().id && (kept.policy, kept.fit) == (policy, fit) && kept.footprint == model.footprint
        };
        let at = self.replanners.iter().position(same);
        let mut kept = match at.and_then(|at| self.replanners.remove(at)) {
            Some(kept) => kept,
            None => Kept {
                map: map.map().id.clone(),
                footprint: model.footprint.clone(),
                policy,
                fit,
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
        check_backwards(&request.backwards, request.path.len()).map_err(Refusal::bad_request)?;
        let model = checked(&request.model)?;
        let length: f64 = request.path.windows(2).map(|leg| (leg[1] - leg[0]).norm()).sum();
        let (times, bit) = TOO_FAST;
        let speed = model.drive.surface_speed(request.start_velocity);
        if length > LONGEST || speed > times * model.drive.max_wheel_speed * model.drive.wheel_radius + bit {
            return Err(Refusal::bad_request(format!(
                "a path of {length:.0} m from {speed:.2} m/s: expected at most {LONGEST} m, and no more than the robot drives"
            )));
        }
        let Some(map) = given.map else {
            return Err(Refusal::NotFound {
                what: format!("a map of {}", request.robot),
            });
        };
        let full = self.smooth_that_fits(Fit::Full, map, given, &model, request);
        if full.trajectory.is_empty() && given.around.is_none() {
            return Ok(self.smooth_that_fits(Fit::Tight, map, given, &model, request));
        }
        Ok(full)
    }

    fn smooth_that_fits(
        &mut self,
        fit: Fit,
        map: &MapReplica,
        given: &mut Given<'_>,
        model: &RobotModel,
        request: &SmoothRequest,
    ) -> SmoothReply {
        let policy = UnknownPolicy::of(request.unknown_is_free);
        let space = match &given.around {
            Some(space) => Arc::clone(space),
            None => self.spaces.get(map, &model.footprint, policy, fit),
        };
        let query = SmoothQuery {
            path: &request.path,
            start: request.start,
            start_velocity: request.start_velocity,
            goal_yaw: request.goal_yaw,
            profile: request.profile,
        };
        let cuts = Cuts {
            backwards: &request.backwards,
            via: &request.via,
        };
        let smoothed = smooth_pieces(
            &space,
            &query,
            &cuts,
            model,
            &self.settings.smoothing,
            Some(&given.cancel.smoothing),
            &mut *given.clock,
        );
        // Each piece is thinned on its own: the points where the robot stops are kept.
        let pieces = smoothed
            .pieces
            .iter()
            .map(|piece| piece.sampled(SAMPLE_PERIOD).thinned());
        let trajectory = pieces.fold(Trajectory::default(), |whole, piece| whole.then(&piece));
        SmoothReply {
            map: map.map().clone(),
            trajectory: trajectory.rounded(),
            statistics: smoothed.statistics,
            corridor: corners(&smoothed.corridor),
        }
    }
}

/// The corners of a corridor's polygons, rounded to millimetres.
fn corners(corridor: &[FreePolygon]) -> Vec<Vec<Point2<f64>>> {
    if corridor.len() > MAX_POLYGONS {
        return Vec::new();
    }
    let milli = |value: f64| (1e3 * value).round() / 1e3 + 0.0;
    let polygons = corridor
        .iter()
        .map(FreePolygon::corners)
        .filter(|corners| !corners.is_empty());
    polygons
        .map(|corners| corners.iter().map(|corner| corner.map(milli)).collect())
        .collect()
}

/// Radii of the discs to plan for when a polygon's path cannot be driven: halfway to the circumscribed radius, then the circumscribed
/// radius, m.
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
mod tests;
