//! RRT. One tree grows from the start towards samples, and now and then towards the goal.
//!
//! Source: LaValle, "Rapidly-Exploring Random Trees: A New Tool for Path Planning", 1998. If the first samples do not find a path, every
//! other sample steers the tree out of the region it covers ([`Tree::explore`]). Each new vertex tries to connect to the goal.

use nalgebra::Point2;
use zenav_space::LineOfSight;

use super::{Map, PathSearch};
use crate::budget::Budget;
use crate::sampling::tree::{Explored, Extended, SearchSpace, Tree};
use crate::sampling::{self, Sampling};
use crate::searcher::{NotFound, Query, Searched};

/// RRT and its tree.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rrt {
    tree: Tree,
}

impl PathSearch for Rrt {
    fn search<S: LineOfSight>(&mut self, map: &Map<'_, S>, query: &Query, budget: Budget<'_>) -> Searched {
        self.tree.clear();
        sampling::search(map, query, budget, |space, sampling| {
            self.tree.plant(space, query.start);
            let mut path = grow(space, &mut self.tree, query.goal, sampling)?;
            sampling.prune(space, &mut path);
            Ok(path)
        })
    }

    fn edges(&self, limit: usize) -> Vec<[Point2<f64>; 2]> {
        self.tree.edges().take(limit).collect()
    }
}

/// Grows a planted tree until it reaches the goal; returns the path from its root.
fn grow<S: LineOfSight>(
    space: &SearchSpace<'_, S>,
    tree: &mut Tree,
    goal: Point2<f64>,
    sampling: &mut Sampling<'_>,
) -> Result<Vec<Point2<f64>>, NotFound> {
    let target = space.free_at(goal);
    let mut found = None;
    while found.is_none() {
        let explores = sampling.next()?;
        let before = tree.vertices();
        let sample = if explores {
            None
        } else if sampling.sampler.unit() < sampling.settings.goal_bias {
            Some(goal)
        } else {
            sampling.sample(space)
        };
        if let Some(sample) = sample {
            tree.extend(space, sample);
        } else {
            let explored = tree.explore(space, &mut sampling.sampler, sampling.settings.exits, target);
            if explored == Explored::Everything && target.is_some() && tree.vertices() == before {
                return Err(NotFound::NoPath);
            }
        }
        found = (before..tree.vertices())
            .rev()
            .find_map(|vertex| match tree.extend_from(space, vertex, goal) {
                Extended::Arrived(vertex) => Some(vertex),
                Extended::Stepped(_) | Extended::Trapped => None,
            });
    }
    let mut path: Vec<Point2<f64>> = found.into_iter().flat_map(|vertex| tree.back(vertex)).collect();
    path.reverse();
    Ok(path)
}
