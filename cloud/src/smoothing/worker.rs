//! How is one smoothing request answered? On a copy of the map; a way that cannot be smoothed still gets a safe trajectory.

use std::sync::Arc;

use zenav_protocol::messages::{PlanStatistics, Refusal, SmoothReply, SmoothRequest};

use zenav_protocol::map_replica::MapReplica;
use zenav_smoothing::{SmoothQuery, SmoothSettings, smooth};
use zenav_space::{SpaceCache, UnknownPolicy, Zones};

/// Most corner points of a way.
const MAX_POINTS: usize = 100_000;

/// Answers smoothing requests one after the other; keeps what it prepared.
#[derive(Debug, Default)]
pub struct SmoothWorker {
    spaces: SpaceCache,
}

impl SmoothWorker {
    /// A worker for maps with these zones.
    #[must_use]
    pub fn new(zones: Arc<Zones>) -> Self {
        Self {
            spaces: SpaceCache::new(zones),
        }
    }

    /// Answers a request on a copy of the robot's map. `clock` (s) tells times for the statistics only.
    ///
    /// # Errors
    /// [`Refusal::BadRequest`] for numbers that are not finite, too many points, and a robot that cannot be;
    /// [`Refusal::NotFound`] without a map.
    pub fn answer(
        &mut self,
        map: Option<&MapReplica>,
        request: &SmoothRequest,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<SmoothReply, Refusal> {
        let finite = request.start.is_finite()
            && request.start_velocity.is_finite()
            && request.goal_yaw.is_none_or(f64::is_finite)
            && request
                .path
                .iter()
                .all(|point| point.x.is_finite() && point.y.is_finite());
        if !finite || request.path.len() > MAX_POINTS {
            return Err(Refusal::bad_request(format!(
                "expected finite numbers and at most {MAX_POINTS} points"
            )));
        }
        let model = request
            .model
            .clone()
            .checked("model")
            .map_err(|error| Refusal::bad_request(error.to_string()))?;
        let Some(map) = map.filter(|map| !map.grid().spec().is_empty()) else {
            return Err(Refusal::NotFound {
                what: format!("a map of {}", request.robot),
            });
        };
        let policy = if request.unknown_is_free {
            UnknownPolicy::Free
        } else {
            UnknownPolicy::Blocked
        };
        let space = self.spaces.get(map, &model.footprint, policy);
        let query = SmoothQuery {
            way: &request.path,
            start: request.start,
            start_velocity: request.start_velocity,
            goal_yaw: request.goal_yaw,
        };
        let settings = SmoothSettings {
            profile: request.profile,
            ..SmoothSettings::default()
        };
        let smoothed = smooth(&space, &query, &model, &settings, clock);
        let trajectory = smoothed.trajectory(zenav_smoothing::PERIOD);
        let statistics: PlanStatistics = smoothed.statistics;
        Ok(SmoothReply {
            map: map.map().clone(),
            trajectory,
            statistics,
        })
    }
}
