//! Options of one plan. Planner, seed, tolerances and settings of one request.

use super::planners::Planner;
use super::settings::PlanningSettings;

/// How a path is planned.
///
/// ```
/// use zenav_planning::{PlanOptions, Planner};
///
/// let options = PlanOptions { seed: 7, ..PlanOptions::new(Planner::RrtStar) };
/// assert_eq!(options.planner.name(), "rrt_star");
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct PlanOptions {
    /// The planner that searches.
    pub planner: Planner,
    /// Seed of sampling planners.
    pub seed: u64,
    /// Whether the robot may start with any heading; the start pose's heading is then ignored.
    pub any_heading: bool,
    /// How far a robot that stands in an obstacle of the map may go to the nearest free place, m (default 0: the plan is refused).
    pub escape: f64,
    /// How far a goal where the robot does not fit may be moved to the nearest free place, m (default 0: the plan is refused).
    pub goal_tolerance: f64,
    /// Tuning.
    pub settings: PlanningSettings,
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self::new(Planner::default())
    }
}

impl PlanOptions {
    /// The defaults for a planner.
    #[must_use]
    pub fn new(planner: Planner) -> Self {
        Self {
            planner,
            seed: 1,
            any_heading: false,
            escape: 0.0,
            goal_tolerance: 0.0,
            settings: PlanningSettings::default(),
        }
    }

    /// The shortest path, whatever its clearance.
    #[must_use]
    pub fn shortest(planner: Planner) -> Self {
        let mut options = Self::new(planner);
        options.settings.clearance.weight = 0.0;
        options
    }
}
