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
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_planning::{Budget, PlanOptions, Searcher, plan};
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::messages::PlanOutcome;
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 80 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// # (0..60).for_each(|y| map[Cell::new(50, y)] = Occupancy::OCCUPIED);
    /// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
    /// // By the map, a wall reaches 0.15 m into the robot.
    /// let ask = |escape| {
    ///     let options = PlanOptions { escape, ..PlanOptions::default() };
    ///     let (start, goal) = (Pose2::new(2.4, 1.0, 0.0), Pose2::new(1.0, 1.0, 0.0));
    ///     plan(&space, &mut Searcher::new(space.free()).unwrap(), start, goal, &options, Budget::UNLIMITED)
    /// };
    /// assert!(matches!(ask(0.0).outcome, PlanOutcome::StartOccupied { .. }));
    /// let planned = ask(0.3);
    /// assert!(planned.escapes && matches!(planned.outcome, PlanOutcome::Found { path, .. } if path[0] == Point2::new(2.4, 1.0)));
    /// ```
    pub escape: f64,
    /// How far a goal where the robot does not fit may be moved to the nearest free place, m (default 0: the plan is refused).
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_planning::{Budget, PlanOptions, Searcher, plan};
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::messages::PlanOutcome;
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 80 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// # (0..60).for_each(|y| map[Cell::new(50, y)] = Occupancy::OCCUPIED);
    /// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
    /// // The goal is 0.1 m from the wall; a robot of 0.25 m radius fits 0.175 m before it.
    /// let options = PlanOptions { goal_tolerance: 0.2, ..PlanOptions::default() };
    /// let (start, goal) = (Pose2::new(1.0, 1.0, 0.0), Pose2::new(2.4, 1.0, 0.0));
    /// let mut searcher = Searcher::new(space.free())?;
    /// let planned = plan(&space, &mut searcher, start, goal, &options, Budget::UNLIMITED);
    /// let PlanOutcome::Found { path, .. } = planned.outcome else { panic!("no path") };
    /// assert!((path[path.len() - 1].x - 2.225).abs() < 1e-9);
    /// # Ok::<(), zenav_planning::TooManyCells>(())
    /// ```
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
    ///
    /// ```
    /// use zenav_planning::{PlanOptions, Planner};
    ///
    /// let options = PlanOptions::shortest(Planner::AStar);
    /// assert_eq!(options.settings.clearance.weight, 0.0);
    /// assert_ne!(options, PlanOptions::default(), "A* that keeps clear of obstacles");
    /// ```
    #[must_use]
    pub fn shortest(planner: Planner) -> Self {
        let mut options = Self::new(planner);
        options.settings.clearance.weight = 0.0;
        options
    }
}
