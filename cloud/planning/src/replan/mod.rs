//! Replanning. Reuses or repairs an earlier answer after the map has changed or the robot has moved on.

mod disc;
mod span;
#[cfg(test)]
mod tests;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::GridSpec;
use zenav_protocol::messages::PlanOrigin;
use zenav_space::ConfigurationSpace;

use self::disc::DiscReplanner;
use super::budget::Budget;
use super::ends::End;
use super::grid_graph::TooManyCells;
use super::options::PlanOptions;
use super::plan::{FootprintSearch, Planned, answer};
use super::searcher::{NotFound, Searched};

/// Plans for one robot on one changing map: like [`plan`](super::plan()), but earlier answers are kept where they are still valid.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_planning::{Budget, PlanOptions, Replanner};
/// use zenav_protocol::geometry::Pose2;
/// use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
/// use zenav_protocol::messages::PlanOrigin;
/// use zenav_protocol::robot::Footprint;
/// use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 60, height: 40 };
/// let map = Grid::filled(spec, Occupancy::FREE);
/// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.3), UnknownPolicy::Blocked, 0.0);
/// let mut replanner = Replanner::new(&space)?;
/// let mut ask = |x| {
///     let (start, goal) = (Pose2::new(x, 2.05, 0.0), Pose2::new(5.05, 2.05, 0.0));
///     replanner.plan(&space, start, goal, &PlanOptions::default(), Budget::UNLIMITED)
/// };
/// assert_eq!(ask(1.05)?.origin, PlanOrigin::Searched);
/// assert_eq!(ask(2.05)?.origin, PlanOrigin::Reused, "the robot has driven a metre of it");
/// # Ok::<(), zenav_planning::TooManyCells>(())
/// ```
#[derive(Clone, Debug)]
pub struct Replanner {
    spec: GridSpec,
    /// One for each disc that was searched for, the latest first.
    discs: Vec<(FootprintSearch, DiscReplanner)>,
}

impl Replanner {
    /// Prepares a space: linear in its words.
    ///
    /// # Errors
    /// [`TooManyCells`].
    pub fn new(space: &ConfigurationSpace) -> Result<Self, TooManyCells> {
        let inscribed = DiscReplanner::new(space)?;
        Ok(Self {
            spec: *space.spec(),
            discs: vec![(FootprintSearch::Inscribed, inscribed)],
        })
    }

    /// Like [`plan`](super::plan()), on a later state of the space with the same footprint, policy and margin.
    ///
    /// # Errors
    /// [`TooManyCells`] if the map has grown.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_planning::{Budget, PlanOptions, Replanner};
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy, OccupancyGrid};
    /// # use zenav_protocol::messages::PlanOutcome;
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 60, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// let space = |map: &OccupancyGrid| ConfigurationSpace::new(map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
    /// let mut replanner = Replanner::new(&space(&map))?;
    /// let mut ask = |map: &OccupancyGrid| {
    ///     let (start, goal) = (Pose2::new(1.05, 2.05, 0.0), Pose2::new(5.05, 2.05, 0.0));
    ///     replanner.plan(&space(map), start, goal, &PlanOptions::default(), Budget::UNLIMITED)
    /// };
    /// assert!(matches!(ask(&map)?.outcome, PlanOutcome::Found { .. }));
    /// (0..40).for_each(|y| map[Cell::new(30, y)] = Occupancy::OCCUPIED);
    /// assert_eq!(ask(&map)?.outcome, PlanOutcome::NoPath);
    /// # Ok::<(), zenav_planning::TooManyCells>(())
    /// ```
    pub fn plan(
        &mut self,
        space: &ConfigurationSpace,
        start: Pose2,
        goal: Pose2,
        options: &PlanOptions,
        budget: Budget<'_>,
    ) -> Result<Planned, TooManyCells> {
        if *space.spec() != self.spec {
            *self = Self::new(space)?;
        }
        let mut find = |by: FootprintSearch, disc: &ConfigurationSpace, first: End, last: End| {
            self.disc(by, disc)
                .map(|replanner| replanner.find(disc, first, last, options, budget))
                // All discs have the map's own number of cells, which was accepted in `new`.
                .unwrap_or((Searched::failed(NotFound::OutOfMap), PlanOrigin::Searched))
        };
        Ok(answer(space, start, goal, options, budget, &mut find))
    }

    /// The replanner of a disc, updated to the present state of its space.
    fn disc(&mut self, by: FootprintSearch, space: &ConfigurationSpace) -> Result<&mut DiscReplanner, TooManyCells> {
        let known = self.discs.iter().position(|(known, _)| *known == by);
        let mut disc = match known.map(|at| self.discs.remove(at)) {
            Some(disc) => disc,
            None => (by, DiscReplanner::new(space)?),
        };
        disc.1.follow(space)?;
        self.discs.insert(0, disc);
        Ok(&mut self.discs[0].1)
    }

    /// Edges of the trees of the last search, m, map frame, at most `limit` of them; empty after a search without trees.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_planning::{Budget, PlanOptions, Planner, Replanner};
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 60, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// # (0..25).for_each(|y| map[Cell::new(30, y)] = Occupancy::OCCUPIED);
    /// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
    /// // A map of 6 m by 4 m with a wall between start and goal.
    /// let mut replanner = Replanner::new(&space)?;
    /// let [start, goal] = [1.0, 5.0].map(|x| Pose2::new(x, 1.0, 0.0));
    /// replanner.plan(&space, start, goal, &PlanOptions::new(Planner::Rrt), Budget::UNLIMITED)?;
    /// let edges = replanner.tree(1000);
    /// assert!(!edges.is_empty() && edges.iter().flatten().all(|end| end.x < 6.0 && end.y < 4.0));
    /// # Ok::<(), zenav_planning::TooManyCells>(())
    /// ```
    #[must_use]
    pub fn tree(&self, limit: usize) -> Vec<[Point2<f64>; 2]> {
        let edges = self.discs.first().map(|(_, disc)| disc.searcher.tree(limit));
        let edges = edges.into_iter().flatten();
        edges.map(|edge| edge.map(|end| self.spec.from_cells(end))).collect()
    }
}
