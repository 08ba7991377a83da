//! Searches on one bitmap. A query is dispatched to its planner, and the memory is reused by later searches.

use nalgebra::Point2;
use zenav_protocol::grid::Cell;
use zenav_space::{BitGrid, LineOfSight};

use super::budget::Budget;
use super::cell_cost::CellCost;
use super::grid_graph::{GridGraph, GridPath, TooManyCells};
use super::node_table::Written;
use super::path::Path;
use super::planners::{Map, Planner, Searches, astar};
use super::settings::SamplingSettings;

/// Why a search ended without a path.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_planning::{Budget, NotFound, Planner, Query, Searcher};
/// use zenav_space::{BitGrid, PointLineOfSight};
///
/// // A wall with a gap at its upper end.
/// let free = BitGrid::from_fn(100, 100, |cell| cell.x != 50 || cell.y == 99);
/// let (sight, mut searcher) = (PointLineOfSight::new(&free), Searcher::new(&free)?);
/// let query = Query { start: Point2::new(10.5, 10.5), goal: Point2::new(90.5, 10.5), seed: 1 };
/// let budget = Budget { max_expansions: 100, ..Budget::UNLIMITED };
/// assert_eq!(searcher.search(Planner::AStar, &sight, &query, budget).result, Err(NotFound::TimedOut));
/// # Ok::<(), zenav_planning::TooManyCells>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotFound {
    /// The start or the goal is outside the map.
    OutOfMap,
    /// The start is not free.
    StartBlocked,
    /// The goal is not free.
    GoalBlocked,
    /// Start and goal are not connected.
    NoPath,
    /// The budget ran out.
    TimedOut,
    /// Start and goal may be connected, but only by a path whose cost overflows 32 bits: 748,000 straight steps, fewer where clearance
    /// costs.
    TooLong,
}

/// Result and effort of a search.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_planning::{Budget, Planner, Query, Searcher};
/// use zenav_space::{BitGrid, PointLineOfSight};
///
/// let free = BitGrid::from_fn(100, 100, |cell| cell.x != 50 || cell.y == 99);
/// let (sight, mut searcher) = (PointLineOfSight::new(&free), Searcher::new(&free)?);
/// let query = Query { start: Point2::new(10.5, 10.5), goal: Point2::new(90.5, 10.5), seed: 1 };
/// let [astar, jps] = [Planner::AStar, Planner::Jps].map(|planner| searcher.search(planner, &sight, &query, Budget::UNLIMITED));
/// assert!(jps.expansions < astar.expansions / 10);
/// assert!((jps.result.unwrap().length - astar.result.unwrap().length).abs() < 1e-9, "both are the shortest");
/// # Ok::<(), zenav_planning::TooManyCells>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Searched<W = Path> {
    /// The path, or why there is none.
    pub result: Result<W, NotFound>,
    /// Nodes expanded, or samples drawn.
    pub expansions: u64,
}

impl<W> Searched<W> {
    /// No path, without any expansion.
    pub(super) const fn failed(reason: NotFound) -> Self {
        Self {
            result: Err(reason),
            expansions: 0,
        }
    }
}

impl From<Searched<GridPath>> for Searched {
    fn from(searched: Searched<GridPath>) -> Self {
        Self {
            result: searched.result.map(Path::from),
            expansions: searched.expansions,
        }
    }
}

/// A query in cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// Where the path begins, in cells.
    pub start: Point2<f64>,
    /// Where it ends, in cells.
    pub goal: Point2<f64>,
    /// Seed of planners that draw samples.
    pub seed: u64,
}

impl Query {
    /// The cells of its ends; [`Searcher::search`] has checked that the casts are valid.
    pub(super) fn cells(&self) -> (Cell, Cell) {
        let cell = |p: Point2<f64>| Cell::new(p.x as u32, p.y as u32);
        (cell(self.start), cell(self.goal))
    }

    /// Whether both ends are valid cell coordinates.
    fn is_on_a_grid(&self) -> bool {
        let on = |x: f64| x >= 0.0 && x < f64::from(u32::MAX);
        [self.start, self.goal].iter().all(|p| on(p.x) && on(p.y))
    }
}

/// Grid graph of one bitmap, and memory for searches on it, one at a time.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_planning::{Budget, Planner, Query, Searcher};
/// use zenav_protocol::grid::Cell;
/// use zenav_space::{BitGrid, PointLineOfSight};
///
/// // A wall with a gap at its upper end.
/// let free = BitGrid::from_fn(20, 10, |cell| cell.x != 10 || cell.y == 9);
/// let sight = PointLineOfSight::new(&free);
/// let mut searcher = Searcher::new(&free)?;
/// let query = Query { start: Point2::new(2.5, 2.5), goal: Point2::new(17.5, 2.5), seed: 1 };
/// let path = searcher.search(Planner::Jps, &sight, &query, Budget::UNLIMITED).result.unwrap();
/// assert!(path.corners.iter().any(|corner| corner.y > 9.0), "it leads through the gap");
/// # Ok::<(), zenav_planning::TooManyCells>(())
/// ```
#[derive(Clone, Debug)]
pub struct Searcher {
    graph: GridGraph,
    searches: Searches,
    /// The planner of the last search.
    last: Planner,
    /// Settings of sampling planners.
    pub sampling: SamplingSettings,
    /// Low and high corner of the box that samples are drawn from, cells; `None`: the whole map. Start and goal may lie outside.
    pub domain: Option<[Point2<f64>; 2]>,
    /// Sampling planners query the map through the line of sight only, as published: samples anywhere, no exits, no shortcuts. Slower;
    /// for comparisons.
    pub black_box: bool,
}

impl Searcher {
    /// Prepares a bitmap of free cells: linear in its words.
    ///
    /// # Errors
    /// [`TooManyCells`].
    ///
    /// ```
    /// use zenav_planning::Searcher;
    /// use zenav_protocol::grid::MAX_SIDE;
    /// use zenav_space::BitGrid;
    ///
    /// assert!(Searcher::new(&BitGrid::new(MAX_SIDE, 1)).is_ok());
    /// let refused = Searcher::new(&BitGrid::new(MAX_SIDE + 1, 1)).unwrap_err();
    /// assert!(refused.to_string().contains("a search takes at most"));
    /// ```
    pub fn new(free: &BitGrid) -> Result<Self, TooManyCells> {
        Ok(Self {
            graph: GridGraph::new(free)?,
            searches: Searches::default(),
            last: Planner::default(),
            sampling: SamplingSettings::default(),
            domain: None,
            black_box: false,
        })
    }

    /// Copies changed words of the bitmap (row and word): a few microseconds.
    pub(super) fn update(&mut self, free: &BitGrid, words: &[(u32, usize)]) {
        for (y, word) in words {
            self.graph.update(free, *y, *word);
        }
    }

    pub(super) fn graph(&self) -> &GridGraph {
        &self.graph
    }

    /// Nodes touched by the last A* search, rounded up to cache lines.
    pub(super) fn reached(&self) -> Written {
        self.searches.astar.reached()
    }

    /// A path between two points, in cells. Grid planners go from cell centre to cell centre without cutting corners; the others check
    /// `sight`, the space of the searcher's free cells, and start and end exactly at the given points.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_planning::{Budget, NotFound, Planner, Query, Searcher};
    /// use zenav_space::{BitGrid, PointLineOfSight};
    ///
    /// // A wall from border to border.
    /// let free = BitGrid::from_fn(20, 10, |cell| cell.x != 10);
    /// let (sight, mut searcher) = (PointLineOfSight::new(&free), Searcher::new(&free)?);
    /// let mut ask = |x, y| {
    ///     let query = Query { start: Point2::new(2.5, 2.5), goal: Point2::new(x, y), seed: 1 };
    ///     searcher.search(Planner::AStar, &sight, &query, Budget::UNLIMITED).result
    /// };
    /// // One step straight on, three diagonally.
    /// assert!((ask(5.5, 6.5).unwrap().length - (1.0 + 3.0 * 2_f64.sqrt())).abs() < 1e-9);
    /// assert_eq!(ask(17.5, 2.5), Err(NotFound::NoPath));
    /// assert_eq!(ask(10.5, 2.5), Err(NotFound::GoalBlocked));
    /// assert_eq!(ask(20.5, 2.5), Err(NotFound::OutOfMap));
    /// # Ok::<(), zenav_planning::TooManyCells>(())
    /// ```
    pub fn search(&mut self, planner: Planner, sight: &dyn LineOfSight, query: &Query, budget: Budget<'_>) -> Searched {
        if !query.is_on_a_grid() {
            return Searched::failed(NotFound::OutOfMap);
        }
        let map = Map {
            graph: &self.graph,
            sight: &sight,
            sampling: &self.sampling,
            domain: self.domain,
            black_box: self.black_box,
        };
        self.last = planner;
        self.searches.search(planner, &map, query, budget)
    }

    /// Edges of the trees of the last search, in cells, at most `limit` of them; empty after a search without trees.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_planning::{Budget, Planner, Query, Searcher};
    /// use zenav_space::{BitGrid, PointLineOfSight};
    ///
    /// let free = BitGrid::from_fn(20, 10, |cell| cell.x != 10 || cell.y >= 7);
    /// let (sight, mut searcher) = (PointLineOfSight::new(&free), Searcher::new(&free)?);
    /// let query = Query { start: Point2::new(2.5, 2.5), goal: Point2::new(17.5, 2.5), seed: 1 };
    /// let mut edges = |planner| {
    ///     assert!(searcher.search(planner, &sight, &query, Budget::UNLIMITED).result.is_ok());
    ///     searcher.tree(1000).len()
    /// };
    /// assert!(edges(Planner::Rrt) > 0);
    /// assert_eq!(edges(Planner::Jps), 0, "it grows no tree");
    /// # Ok::<(), zenav_planning::TooManyCells>(())
    /// ```
    #[must_use]
    pub fn tree(&self, limit: usize) -> Vec<[Point2<f64>; 2]> {
        self.searches.edges(self.last, limit)
    }

    /// The cheapest path between two cells, by A*.
    pub(super) fn search_with(
        &mut self,
        costs: &impl CellCost,
        start: Cell,
        goal: Cell,
        budget: Budget<'_>,
    ) -> Searched {
        self.last = Planner::AStar;
        astar::search(&self.graph, costs, start, goal, &mut self.searches.astar, budget).into()
    }
}
