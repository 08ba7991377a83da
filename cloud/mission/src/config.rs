//! Mission settings. What can be tuned? Every setting of the mission in one place.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use zenav_protocol::id::Id;
use zenav_protocol::messages::{DrivingProfile, GoalPoint};

use zenav_space::Zones;

/// How far ahead on the active plan a replan starts by default, s: the time from a request for a plan to its arrival at the robot.
pub const LATENCY_BUDGET: f64 = 0.3;

/// Settings of one robot's mission.
#[derive(Clone, Debug, PartialEq)]
pub struct MissionConfig {
    /// The robot.
    pub robot: Id,
    /// The orchestrator's name, as holder of the robot's lease; no two may share it.
    pub holder: String,
    /// Named goals, map frame.
    pub places: BTreeMap<String, GoalPoint>,
    /// Planner that is asked for (`astar`, …).
    pub planner: String,
    /// Time a search may take, ms.
    pub search_budget_ms: u64,
    /// Whether paths may lead through unknown cells; the robot replans when they turn out to be occupied.
    pub unknown_is_free: bool,
    /// How far outside a growing map a goal may be, m.
    pub explore: f64,
    /// How far ahead of the robot a replan begins, s.
    pub latency_budget: f64,
    /// Validity of a plan, s.
    pub plan_valid: f64,
    /// Age at which a plan is rechecked and renewed, s.
    pub renew_period: f64,
    /// Time without a live mapper after which plans are no longer renewed, s: the map says nothing new.
    pub map_patience: f64,
    /// Distance that counts as reached where a goal does not say, m.
    pub tolerance: f64,
    /// Driving profile where a goal does not say.
    pub profile: DrivingProfile,
    /// Progress (m or rad) that a drive must make …
    pub progress: (f64, f64),
    /// … within this time, s, or it fails.
    pub progress_secs: f64,
    /// Zones of the map.
    pub zones: Arc<Zones>,
    /// The store's file; used by the service alone.
    pub store: PathBuf,
}

impl MissionConfig {
    /// The defaults for a robot.
    #[must_use]
    pub fn new(robot: Id, holder: impl Into<String>, store: PathBuf) -> Self {
        Self {
            robot,
            holder: holder.into(),
            places: BTreeMap::new(),
            planner: "astar".to_owned(),
            search_budget_ms: 2000,
            unknown_is_free: true,
            explore: 20.0,
            latency_budget: LATENCY_BUDGET,
            plan_valid: 5.0,
            renew_period: 1.0,
            map_patience: 10.0,
            tolerance: 0.15,
            profile: DrivingProfile::default(),
            progress: (0.2, 0.2),
            progress_secs: 10.0,
            zones: Arc::default(),
            store,
        }
    }
}
