//! Is there a way, by trees that grow towards samples? No grid of directions: straight edges between any two points that see each other.
//!
//! | file | answers |
//! |---|---|
//! | [`options`] | what can be chosen? |
//! | [`rrt`] | how does one tree find the goal? |
//! | [`rrt_connect`] | how do two trees meet? |
//! | [`rrt_star`] | how does a way become the shortest one? |
//! | [`tree`] | what grows, and how? |
//! | [`rewiring`] | what is the cheapest way to each vertex? |
//! | [`frontier`] | what has a tree not seen yet, and how does it get there? |
//! | [`nearest`] | which vertex is nearest? |
//! | [`sampler`] | where are samples drawn? |
//! | [`shortcut`] | how does a way with needless corners become a short one? |

pub mod frontier;
pub mod nearest;
pub mod options;
pub mod rewiring;
pub mod rrt;
pub mod rrt_connect;
pub mod rrt_star;
pub mod sampler;
pub mod shortcut;
pub mod tree;

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests;

pub use options::Options;

use nalgebra::Point2;

use super::astar::NotFound;
use super::budget::Budget;
use super::grid_graph::GridGraph;
use super::path::Path;
use super::searcher::{Query, Searched};
use rewiring::CostTree;
use sampler::Sampler;
use tree::{Ground, Tree};
use zenav_space::LineOfSight;

/// Which trees grow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Growth {
    /// One, from the start ([`rrt`]).
    Single,
    /// Two that meet ([`rrt_connect`]).
    Connect,
    /// Two that meet, then one with costs, until the budget ends ([`rrt_star`]).
    Optimal,
}

/// Working memory, kept from one search to the next, and the trees of the last one.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    trees: [Tree; 2],
    costs: CostTree,
}

impl Memory {
    /// The edges of the last search's trees, cells.
    pub fn edges(&self) -> impl Iterator<Item = [Point2<f64>; 2]> + '_ {
        self.costs.edges().chain(self.trees.iter().flat_map(Tree::edges))
    }
}

/// One search under way.
#[derive(Debug)]
pub struct Search<'a> {
    options: &'a Options,
    budget: Budget<'a>,
    sampler: Sampler,
    /// Drawn so far.
    samples: u64,
}

impl Search<'_> {
    /// Counts a sample; whether it is to lead a tree out of what it has covered.
    fn next(&mut self) -> Result<bool, NotFound> {
        if self.samples >= self.budget.max_expansions || self.budget.is_cancelled() {
            return Err(NotFound::TimedOut);
        }
        self.samples += 1;
        // Both trees have a turn before it is chance's turn again.
        Ok(self.samples > self.options.patience && self.samples & 2 == 0)
    }
}

/// A way between two points; always the same one for the same query, options and number of samples.
pub fn search<S: LineOfSight>(
    growth: Growth,
    lattice: &GridGraph,
    sight: &S,
    query: &Query,
    options: &Options,
    memory: &mut Memory,
    budget: Budget<'_>,
) -> Searched {
    let [width, height] = sight.size().map(f64::from);
    let mut search = Search {
        options,
        budget,
        sampler: Sampler::new(
            query.seed,
            options.domain.unwrap_or([Point2::origin(), Point2::new(width, height)]),
        ),
        samples: 0,
    };
    let ground = Ground {
        sight,
        lattice,
        step: (options.step * width.hypot(height)).max(1.0),
    };
    let result = find(growth, &ground, query, memory, &mut search);
    Searched {
        result: result.map(Path::through),
        expansions: search.samples,
    }
}

fn find<S: LineOfSight>(
    growth: Growth,
    ground: &Ground<'_, S>,
    query: &Query,
    memory: &mut Memory,
    search: &mut Search<'_>,
) -> Result<Vec<Point2<f64>>, NotFound> {
    memory.trees.iter_mut().for_each(Tree::clear);
    memory.costs.clear();
    let [width, height] = ground.sight.size().map(f64::from);
    let inside = |p: Point2<f64>| p.x >= 0.0 && p.x < width && p.y >= 0.0 && p.y < height;
    if !(inside(query.start) && inside(query.goal)) {
        return Err(NotFound::OutOfMap);
    }
    if !ground.sight.admits(query.start) {
        return Err(NotFound::StartBlocked);
    }
    if !ground.sight.admits(query.goal) {
        return Err(NotFound::GoalBlocked);
    }
    if query.start == query.goal {
        return Ok(vec![query.start]);
    }
    if ground.sight.sees(query.start, query.goal) {
        return Ok(vec![query.start, query.goal]);
    }
    memory.trees[0].plant(ground, query.start);
    let mut way = match growth {
        Growth::Single => rrt::grow(ground, &mut memory.trees[0], query.goal, search)?,
        Growth::Connect | Growth::Optimal => {
            memory.trees[1].plant(ground, query.goal);
            rrt_connect::meet(ground, &mut memory.trees, search)?
        }
    };
    shortcut::prune(ground.sight, &mut way, || search.budget.is_cancelled());
    if growth == Growth::Optimal {
        memory.trees.iter_mut().for_each(Tree::clear);
        way = rrt_star::improve(ground, &mut memory.costs, way, search);
    }
    Ok(way)
}
