//! Which search runs, and on what memory? One map's lattice for all of them, one query after the other.

use nalgebra::Point2;
use zenav_protocol::grid::Cell;

use super::astar::{self, CellCost, Memory, NotFound, Uniform};
use super::budget::Budget;
use super::grid_graph::{GridGraph, GridPath, TooManyCells};
use super::jps;
use super::jump_grid::JumpGrid;
use super::node_table::Written;
use super::path::Path;
use super::planner::Planner;
use super::sampling;
use super::theta;
use zenav_space::{BitGrid, LineOfSight};

/// What a search found, and what it took.
#[derive(Clone, Debug, PartialEq)]
pub struct Searched<W = Path> {
    /// The way, or why there is none.
    pub result: Result<W, NotFound>,
    /// Nodes expanded, or samples drawn.
    pub expansions: u64,
}

impl<W> Searched<W> {
    /// No path, and nothing was looked at.
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

/// What is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// Start, in cells.
    pub start: Point2<f64>,
    /// Goal, in cells.
    pub goal: Point2<f64>,
    /// Seed of planners that draw samples.
    pub seed: u64,
}

impl Query {
    /// The cells that hold its ends; `None` where one lies outside any grid.
    pub(super) fn cells(&self) -> Option<(Cell, Cell)> {
        Some((cell_of(self.start)?, cell_of(self.goal)?))
    }
}

/// One bitmap's lattice, and memory for searches on it, one after the other.
#[derive(Clone, Debug)]
pub struct Searcher {
    lattice: GridGraph,
    memory: Memory,
    /// Prepared when it is first asked for.
    jumps: Option<JumpGrid>,
    jump_memory: jps::Memory,
    theta_memory: theta::Memory,
    trees: sampling::Memory,
    /// Parameters of planners that draw samples.
    pub sampling: sampling::Options,
}

impl Searcher {
    /// Prepares a bitmap of free cells: linear in its words.
    ///
    /// # Errors
    /// [`TooManyCells`].
    pub fn new(free: &BitGrid) -> Result<Self, TooManyCells> {
        Ok(Self {
            lattice: GridGraph::new(free)?,
            memory: Memory::default(),
            jumps: None,
            jump_memory: jps::Memory::default(),
            theta_memory: theta::Memory::default(),
            trees: sampling::Memory::default(),
            sampling: sampling::Options::default(),
        })
    }

    /// Takes over words of the bitmap that have changed (row and word): a few microseconds, and what only jump point search needs is
    /// prepared anew when it is asked for next.
    pub(super) fn update(&mut self, free: &BitGrid, words: &[(u32, usize)]) {
        for (y, word) in words {
            self.lattice.update(free, *y, *word);
        }
        if !words.is_empty() {
            self.jumps = None;
        }
    }

    pub(super) fn lattice(&self) -> &GridGraph {
        &self.lattice
    }

    /// Where the last search by A* had been, and a little more.
    pub(super) fn reached(&self) -> Written {
        self.memory.reached()
    }

    /// A way between two points. Grids go from cell centre to cell centre without cutting corners; the others ask `sight`, the space
    /// that the searcher's free cells belong to, and start and end exactly where they are asked to.
    pub fn search(
        &mut self,
        planner: Planner,
        sight: &impl LineOfSight,
        query: &Query,
        budget: Budget<'_>,
    ) -> Searched {
        let Some((start, goal)) = query.cells() else {
            return Searched::failed(NotFound::OutOfMap);
        };
        match planner {
            Planner::Rrt => self.grow(sampling::Growth::Single, sight, query, budget),
            Planner::RrtConnect => self.grow(sampling::Growth::Connect, sight, query, budget),
            Planner::RrtStar => self.grow(sampling::Growth::Optimal, sight, query, budget),
            Planner::AStar => astar::search(&self.lattice, &Uniform, start, goal, &mut self.memory, budget).into(),
            Planner::Jps => {
                let jumps = self.jumps.get_or_insert_with(|| JumpGrid::new(&self.lattice));
                jps::search(&self.lattice, jumps, start, goal, &mut self.jump_memory, budget).into()
            }
            Planner::Theta => theta::search(&self.lattice, sight, query, &mut self.theta_memory, budget),
        }
    }

    /// Edges of the trees of the last search by a sampling planner, in cells, at most `limit` of them.
    pub fn tree(&self, limit: usize) -> impl Iterator<Item = [Point2<f64>; 2]> + '_ {
        self.trees.edges().take(limit)
    }

    fn grow(
        &mut self,
        growth: sampling::Growth,
        sight: &impl LineOfSight,
        query: &Query,
        budget: Budget<'_>,
    ) -> Searched {
        sampling::search(
            growth,
            &self.lattice,
            sight,
            query,
            &self.sampling,
            &mut self.trees,
            budget,
        )
    }

    /// The cheapest way between two cells.
    pub(super) fn search_with(
        &mut self,
        costs: &impl CellCost,
        start: Cell,
        goal: Cell,
        budget: Budget<'_>,
    ) -> Searched {
        astar::search(&self.lattice, costs, start, goal, &mut self.memory, budget).into()
    }
}

/// The cell that holds a point.
fn cell_of(p: Point2<f64>) -> Option<Cell> {
    let on = |x: f64| x >= 0.0 && x < f64::from(u32::MAX);
    (on(p.x) && on(p.y)).then(|| Cell::new(p.x as u32, p.y as u32))
}
