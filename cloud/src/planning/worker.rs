//! How is one plan request answered? On a copy of the map, by the planner asked for, within a budget.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use nalgebra::Point2;
use zenav_protocol::messages::{PlanOutcome, PlanReply, PlanRequest, Refusal};

use super::{Budget, PlanOptions, Planner, Searcher, plan};
use crate::mapping::MapMirror;
use crate::space::{ConfigurationSpace, SpaceCache, UnknownPolicy, Zones};

/// Nodes that a search may expand for a robot: some seconds' worth.
const MAX_EXPANSIONS: u64 = 50_000_000;
/// Samples that a planner may draw for a robot: some tenths of a second's worth. What a way would gain by more is less than the wait costs.
const MAX_SAMPLES: u64 = 20_000;

/// Answers plan requests one after the other; keeps what it prepared.
#[derive(Debug, Default)]
pub struct PlanWorker {
    spaces: SpaceCache,
    prepared: Option<(Arc<ConfigurationSpace>, Searcher)>,
    /// Whether the last search grew trees.
    grew: bool,
}

impl PlanWorker {
    /// A worker for maps with these zones.
    #[must_use]
    pub fn new(zones: Arc<Zones>) -> Self {
        Self {
            spaces: SpaceCache::new(zones),
            ..Self::default()
        }
    }

    /// Edges of the trees that the last search grew, map frame, m, at most `limit` of them; none after a search on the grid.
    #[must_use]
    pub fn tree(&self, limit: usize) -> Vec<[Point2<f64>; 2]> {
        let Some((space, searcher)) = self.prepared.as_ref().filter(|_| self.grew) else {
            return Vec::new();
        };
        let edges = searcher.tree(limit);
        edges.map(|edge| edge.map(|end| space.spec().from_cells(end))).collect()
    }

    /// Answers a request on a copy of the robot's map, without the time it took. `cancel` ends the search soon after it is set.
    ///
    /// # Errors
    /// [`Refusal::BadRequest`] for numbers that are not finite, a robot that cannot be, and a planner that there is not.
    pub fn answer(
        &mut self,
        map: Option<&MapMirror>,
        request: &PlanRequest,
        cancel: Option<&AtomicBool>,
    ) -> Result<PlanReply, Refusal> {
        let planner: Planner = request
            .planner
            .parse()
            .map_err(|error: super::planner::UnknownPlanner| Refusal::bad_request(error.to_string()))?;
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
            });
        };
        let policy = if request.unknown_is_free {
            UnknownPolicy::Free
        } else {
            UnknownPolicy::Blocked
        };
        let space = self.spaces.get(map, &model.footprint, policy);
        if !self.prepared.as_ref().is_some_and(|(of, _)| Arc::ptr_eq(of, &space)) {
            let searcher = Searcher::new(space.free()).map_err(|error| Refusal::Internal {
                reason: error.to_string(),
            })?;
            self.prepared = Some((Arc::clone(&space), searcher));
        }
        self.grew = planner.grows_trees();
        let Some((space, searcher)) = &mut self.prepared else {
            return Err(Refusal::Internal {
                reason: "no searcher".to_owned(),
            });
        };
        let options = PlanOptions {
            planner,
            ..PlanOptions::default()
        };
        let planned = plan(
            space,
            searcher,
            request.start,
            request.goal,
            &options,
            Budget {
                max_expansions: if planner.grows_trees() { MAX_SAMPLES } else { MAX_EXPANSIONS },
                cancel,
            },
        );
        Ok(PlanReply {
            map: map.map().clone(),
            outcome: planned.outcome,
            search_ms: 0.0,
            expansions: planned.expansions,
        })
    }
}
