//! Plan requests. How is one answered? On a copy of the map, by the planner asked for, within a budget.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use nalgebra::Point2;
use zenav_protocol::messages::{PlanOrigin, PlanOutcome, PlanReply, PlanRequest, Refusal};
use zenav_protocol::robot::Footprint;

use zenav_planning::{Budget, PlanOptions, Planner, PlanningSettings, Replanner};
use zenav_protocol::map_replica::MapReplica;
use zenav_space::{SpaceCache, UnknownPolicy, Zones};

/// Robots and maps that answers are kept for.
const KEPT: usize = 4;

/// Answers plan requests one after the other; keeps what it prepared and what it found.
#[derive(Debug, Default)]
pub struct PlanWorker {
    spaces: SpaceCache,
    /// The one used last comes first.
    kept: VecDeque<Kept>,
    settings: PlanningSettings,
    /// Whether the last answer was searched for.
    searched: bool,
}

/// What is known of a map for a robot.
#[derive(Debug)]
struct Kept {
    map: String,
    footprint: Footprint,
    policy: UnknownPolicy,
    replanner: Replanner,
}

impl PlanWorker {
    /// A worker for maps with these zones.
    #[must_use]
    pub fn new(zones: Arc<Zones>, settings: PlanningSettings) -> Self {
        Self {
            spaces: SpaceCache::new(zones),
            settings,
            ..Self::default()
        }
    }

    /// Edges of the trees that the last search grew, map frame, m, at most `limit` of them; none after a search on the grid.
    #[must_use]
    pub fn tree(&self, limit: usize) -> Vec<[Point2<f64>; 2]> {
        let last = self.kept.front().filter(|_| self.searched);
        last.map(|kept| kept.replanner.tree(limit)).unwrap_or_default()
    }

    /// Answers a request on a copy of the robot's map, without the time it took. `cancel` ends the search soon after it is set.
    ///
    /// # Errors
    /// [`Refusal::BadRequest`] for numbers that are not finite, a robot that cannot be, and a planner that there is not.
    pub fn answer(
        &mut self,
        map: Option<&MapReplica>,
        request: &PlanRequest,
        cancel: Option<&AtomicBool>,
    ) -> Result<PlanReply, Refusal> {
        let planner: Planner = request
            .planner
            .parse()
            .map_err(|error: zenav_planning::UnknownPlanner| Refusal::bad_request(error.to_string()))?;
        if !(request.start.is_finite() && request.goal.is_finite()) {
            return Err(Refusal::bad_request("start and goal: expected finite numbers"));
        }
        let model = request
            .model
            .clone()
            .checked("model")
            .map_err(|error| Refusal::bad_request(error.to_string()))?;
        let Some(map) = map.filter(|map| !map.grid().spec().is_empty()) else {
            return Ok(PlanReply {
                map: request.map.clone(),
                outcome: PlanOutcome::NoMap,
                search_ms: 0.0,
                expansions: 0,
                origin: PlanOrigin::Searched,
            });
        };
        let policy = if request.unknown_is_free {
            UnknownPolicy::Free
        } else {
            UnknownPolicy::Blocked
        };
        let space = self.spaces.get(map, &model.footprint, policy);
        let internal = |error: &dyn std::fmt::Display| Refusal::Internal {
            reason: error.to_string(),
        };
        let known =
            |kept: &Kept| kept.map == map.map().id && kept.policy == policy && kept.footprint == model.footprint;
        let mut kept = match self.kept.iter().position(known).and_then(|at| self.kept.remove(at)) {
            Some(kept) => kept,
            None => Kept {
                map: map.map().id.clone(),
                footprint: model.footprint.clone(),
                policy,
                replanner: Replanner::new(&space).map_err(|error| internal(&error))?,
            },
        };
        let options = PlanOptions {
            seed: request.seed,
            settings: self.settings.clone(),
            ..PlanOptions::new(planner)
        };
        let budget = Budget {
            max_expansions: self.settings.max_expansions,
            max_samples: self.settings.max_samples,
            cancel,
        };
        let planned = kept
            .replanner
            .plan(&space, request.start, request.goal, &options, budget);
        self.kept.push_front(kept);
        self.kept.truncate(KEPT);
        let planned = planned.map_err(|error| internal(&error))?;
        self.searched = planned.origin == PlanOrigin::Searched;
        Ok(PlanReply {
            map: map.map().clone(),
            outcome: planned.outcome,
            search_ms: 0.0,
            expansions: planned.expansions,
            origin: planned.origin,
        })
    }
}
