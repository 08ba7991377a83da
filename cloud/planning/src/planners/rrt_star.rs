//! RRT*. Shortens the first path: a tree with costs, and new vertices only where they can still help, until the budget ends.
//!
//! Sources: Karaman and Frazzoli, "Sampling-Based Algorithms for Optimal Motion Planning", 2011 (RRT*, the rewiring radius); Gammell,
//! Srinivasa and Barfoot, "Informed RRT*", 2014 (samples and vertices only where a shorter path can lead). The first path is that of
//! [`RrtConnect`]. Each better path is pulled taut, and its corners become vertices. A share of the samples is drawn at convex corners of
//! obstacles, where shortest paths bend; the rest stays uniform, as optimality in the limit requires.

use nalgebra::Point2;
use zenav_space::LineOfSight;

use super::rrt_connect::RrtConnect;
use super::{Map, PathSearch};
use crate::budget::Budget;
use crate::path::length;
use crate::sampling::rewiring::CostTree;
use crate::sampling::sampler::Ellipse;
use crate::sampling::tree::SearchSpace;
use crate::sampling::{self, Sampling};
use crate::searcher::{Query, Searched};

/// Two trees for the first path, and the tree that improves it.
#[derive(Clone, Debug, Default)]
pub(crate) struct RrtStar {
    first: RrtConnect,
    costs: CostTree,
}

impl PathSearch for RrtStar {
    fn search<S: LineOfSight>(&mut self, map: &Map<'_, S>, query: &Query, budget: Budget<'_>) -> Searched {
        self.first.clear();
        self.costs.clear();
        sampling::search(map, query, budget, |space, sampling| {
            let path = self.first.first_path(space, query, sampling)?;
            self.first.clear();
            Ok(improve(space, &mut self.costs, path, sampling))
        })
    }

    fn edges(&self, limit: usize) -> Vec<[Point2<f64>; 2]> {
        let mut edges: Vec<_> = self.costs.edges().take(limit).collect();
        edges.extend(self.first.edges(limit - edges.len()));
        edges
    }
}

/// Samples between two checks for a better path in the tree.
const PERIOD: u64 = 128;
/// A gain below this share is not worth string pulling.
const WORTH: f64 = 1e-5;

/// Improves a path until the search's budget ends; never longer than it was.
fn improve<S: LineOfSight>(
    space: &SearchSpace<'_, S>,
    tree: &mut CostTree,
    path: Vec<Point2<f64>>,
    sampling: &mut Sampling<'_>,
) -> Vec<Point2<f64>> {
    let mut best = path;
    let (Some(start), Some(goal)) = (best.first().copied(), best.last().copied()) else {
        return best;
    };
    sampling.pull_string(space, &mut best);
    let mut bound = length(&best);
    tree.plant(space.sight.size(), &best);
    sampling.sampler.narrow(Ellipse::new([start, goal], bound));
    let last = sampling.samples.saturating_add(sampling.settings.improving);
    // The straight line is a lower bound.
    while bound > (goal - start).norm() * (1.0 + 1e-9) && sampling.samples < last && sampling.next().is_ok() {
        let corner = sampling.sampler.unit() < sampling.corners();
        let sample = if corner {
            sampling.sampler.corner(space.graph)
        } else {
            sampling.sampler.free(space.graph)
        };
        if let Some(sample) = sample {
            let radius = radius(sampling.sampler.free_area(), tree.len()).min(space.step);
            tree.insert(space.sight, sample, radius, space.step, bound);
        }
        if sampling.samples.is_multiple_of(PERIOD) && tree.cost() < bound * (1.0 - WORTH) {
            let mut path = tree.path();
            sampling.pull_string(space, &mut path);
            best = path;
            bound = length(&best);
            let radius = radius(sampling.sampler.free_area(), tree.len()).min(space.step);
            tree.lay(space.sight, &best, radius);
            sampling.sampler.narrow(Ellipse::new([start, goal], bound));
        }
    }
    if tree.cost() < bound { tree.path() } else { best }
}

/// Rewiring radius for `vertices` spread over an area, cells: 1.1 times the least radius that optimality in the limit requires (Karaman
/// and Frazzoli, theorem 38).
fn radius(area: f64, vertices: usize) -> f64 {
    let n = vertices.max(2) as f64;
    1.1 * 2.0 * (1.5 * area / std::f64::consts::PI).sqrt() * (n.ln() / n).sqrt()
}
