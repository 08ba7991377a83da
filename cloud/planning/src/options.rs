//! Options of one plan. How is a path searched for?

use super::planners::Planner;
use super::settings::PlanningSettings;

/// How a path is searched for.
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
    /// The robot may begin with any heading, whatever the start says.
    pub any_heading: bool,
    /// A robot that stands in an obstacle of the map may go this far to the nearest free place, m (default 0: it is refused).
    pub escape: f64,
    /// A goal where the robot does not fit may be replaced by the nearest free place if that is this near, m (default 0: it is refused).
    pub goal_tolerance: f64,
    /// What can be tuned.
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
