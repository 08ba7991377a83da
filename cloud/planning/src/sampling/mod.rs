//! Sampling. Shared parts of the planners that grow trees towards samples, with straight edges between any two points that see each
//! other.
//!
//! | file | answers |
//! |---|---|
//! | [`tree`] | how does a tree grow? |
//! | [`rewiring`] | what is the cheapest path to each vertex? |
//! | [`frontier`] | which free cells has a tree not covered yet, and how does it get there? |
//! | [`nearest`] | which vertex is nearest? |
//! | [`sampler`] | where are samples drawn? |
//! | [`shortcut`] | how is a path with redundant corners shortened? |

mod frontier;
mod nearest;
pub(crate) mod rewiring;
pub(crate) mod sampler;
pub(crate) mod shortcut;
pub(crate) mod tree;

#[cfg(test)]
mod tests;

use nalgebra::Point2;
use zenav_space::LineOfSight;

use super::budget::Budget;
use super::path::Path;
use super::planners::Map;
use super::searcher::{NotFound, Query, Searched};
use super::settings::SamplingSettings;
use sampler::Sampler;
use tree::SearchSpace;

/// The samples of one search.
#[derive(Debug)]
pub(crate) struct Sampling<'a> {
    pub(crate) settings: &'a SamplingSettings,
    pub(crate) budget: Budget<'a>,
    pub(crate) sampler: Sampler,
    /// Number of samples drawn so far.
    pub(crate) samples: u64,
    black_box: bool,
}

impl Sampling<'_> {
    /// Counts a sample; returns whether it is to steer a tree out of the region it covers.
    pub(crate) fn next(&mut self) -> Result<bool, NotFound> {
        if self.samples >= self.budget.max_samples || self.budget.is_cancelled() {
            return Err(NotFound::TimedOut);
        }
        self.samples += 1;
        // Both trees explore before plain sampling resumes.
        Ok(!self.black_box && self.samples > self.settings.patience && self.samples & 2 == 0)
    }

    /// A point in a free cell, `None` if no draw hit one; any point if the map is a black box.
    pub(crate) fn sample<S>(&mut self, space: &SearchSpace<'_, S>) -> Option<Point2<f64>> {
        if self.black_box {
            Some(self.sampler.anywhere())
        } else {
            self.sampler.free(space.graph)
        }
    }

    /// Removes redundant corners.
    pub(crate) fn prune<S: LineOfSight>(&self, space: &SearchSpace<'_, S>, path: &mut Vec<Point2<f64>>) {
        if !self.black_box {
            shortcut::prune(space.sight, path, || self.budget.is_cancelled());
        }
    }

    /// Pulls the path taut.
    pub(crate) fn pull_string<S: LineOfSight>(&self, space: &SearchSpace<'_, S>, path: &mut Vec<Point2<f64>>) {
        if !self.black_box {
            shortcut::pull_string(space.sight, path, || self.budget.is_cancelled());
        }
    }

    /// Share of samples at the corners of obstacles.
    pub(crate) fn corners(&self) -> f64 {
        if self.black_box { 0.0 } else { self.settings.corners }
    }
}

/// A path between two points by `grow`, or the straight line if one sees the other. Deterministic for the same query, settings and number
/// of samples.
pub(crate) fn search<S: LineOfSight>(
    map: &Map<'_, S>,
    query: &Query,
    budget: Budget<'_>,
    grow: impl FnOnce(&SearchSpace<'_, S>, &mut Sampling<'_>) -> Result<Vec<Point2<f64>>, NotFound>,
) -> Searched {
    let [width, height] = map.sight.size().map(f64::from);
    let inside = |p: Point2<f64>| p.x >= 0.0 && p.x < width && p.y >= 0.0 && p.y < height;
    let ends = if !(inside(query.start) && inside(query.goal)) {
        Err(NotFound::OutOfMap)
    } else if !map.sight.admits(query.start) {
        Err(NotFound::StartBlocked)
    } else if !map.sight.admits(query.goal) {
        Err(NotFound::GoalBlocked)
    } else {
        Ok(())
    };
    if let Err(reason) = ends {
        return Searched::failed(reason);
    }
    if map.sight.sees(query.start, query.goal) {
        let mut corners = vec![query.start, query.goal];
        corners.dedup();
        let result = Ok(Path::through(corners));
        return Searched { result, expansions: 0 };
    }
    let space = SearchSpace {
        sight: map.sight,
        graph: map.graph,
        step: (map.sampling.step * width.hypot(height)).max(1.0),
    };
    let domain = map.domain.unwrap_or([Point2::origin(), Point2::new(width, height)]);
    let mut sampling = Sampling {
        settings: map.sampling,
        budget,
        sampler: Sampler::new(query.seed, domain),
        samples: 0,
        black_box: map.black_box,
    };
    let result = grow(&space, &mut sampling);
    Searched {
        result: result.map(Path::through),
        expansions: sampling.samples,
    }
}
