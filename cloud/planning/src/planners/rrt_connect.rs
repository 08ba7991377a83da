//! RRT-Connect. Two trees, from start and goal, grow in turns; each tries to connect to the new vertices of the other.
//!
//! Source: Kuffner and LaValle, "RRT-Connect: An Efficient Approach to Single-Query Path Planning", 2000. If the first samples do not
//! find a path, every other sample steers a tree out of the region it covers ([`Tree::explore`]): a hybrid with a sweep over the map's
//! bitmap, which [`Searcher::black_box`](crate::Searcher::black_box) turns off.

use nalgebra::Point2;
use zenav_space::LineOfSight;

use super::{Map, PathSearch};
use crate::budget::Budget;
use crate::sampling::tree::{Explored, SearchSpace, Tree};
use crate::sampling::{self, Sampling};
use crate::searcher::{NotFound, Query, Searched};

/// RRT-Connect and its two trees.
#[derive(Clone, Debug, Default)]
pub(crate) struct RrtConnect {
    trees: [Tree; 2],
}

impl PathSearch for RrtConnect {
    fn search<S: LineOfSight>(&mut self, map: &Map<'_, S>, query: &Query, budget: Budget<'_>) -> Searched {
        self.clear();
        sampling::search(map, query, budget, |space, sampling| {
            self.first_path(space, query, sampling)
        })
    }

    fn edges(&self, limit: usize) -> Vec<[Point2<f64>; 2]> {
        self.trees.iter().flat_map(Tree::edges).take(limit).collect()
    }
}

impl RrtConnect {
    /// Forgets the trees of the last search.
    pub(super) fn clear(&mut self) {
        self.trees.iter_mut().for_each(Tree::clear);
    }

    /// The path on which the trees meet, without redundant corners.
    pub(super) fn first_path<S: LineOfSight>(
        &mut self,
        space: &SearchSpace<'_, S>,
        query: &Query,
        sampling: &mut Sampling<'_>,
    ) -> Result<Vec<Point2<f64>>, NotFound> {
        self.trees[0].plant(space, query.start);
        self.trees[1].plant(space, query.goal);
        let mut path = meet(space, &mut self.trees, sampling)?;
        sampling.prune(space, &mut path);
        Ok(path)
    }
}

/// Grows two planted trees until they meet; returns the path from the first root to the second.
fn meet<S: LineOfSight>(
    space: &SearchSpace<'_, S>,
    trees: &mut [Tree; 2],
    sampling: &mut Sampling<'_>,
) -> Result<Vec<Point2<f64>>, NotFound> {
    let roots = [0, 1].map(|side: usize| space.free_at(trees[side].point(0)));
    loop {
        let explores = sampling.next()?;
        let side = (sampling.samples & 1) as usize;
        let [first, second] = trees;
        let (tree, other) = if side == 0 { (first, second) } else { (second, first) };
        let before = tree.vertices();
        let sample = if explores { None } else { sampling.sample(space) };
        if let Some(sample) = sample {
            tree.extend(space, sample);
        } else {
            let target = roots[1 - side];
            let explored = tree.explore(space, &mut sampling.sampler, sampling.settings.exits, target);
            if explored == Explored::Everything && target.is_some() && tree.vertices() == before {
                return Err(NotFound::NoPath);
            }
        }
        for vertex in (before..tree.vertices()).rev() {
            let p = tree.point(vertex);
            if let Some(met) = other.connect(space, p) {
                return Ok(join(trees, side, vertex, met));
            }
        }
    }
}

/// The path from the first root to the second, through the vertices at which the trees met.
fn join(trees: &[Tree; 2], side: usize, vertex: u32, met: u32) -> Vec<Point2<f64>> {
    let [here, there] = if side == 0 { [vertex, met] } else { [met, vertex] };
    let mut path: Vec<Point2<f64>> = trees[0].back(here).collect();
    path.reverse();
    path.extend(trees[1].back(there).skip(1));
    path
}
