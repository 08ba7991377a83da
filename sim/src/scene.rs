//! Which edges and discs never move, and which of them are near?

use nalgebra::Point2;

use crate::boxes::{Bounded, BoxTree};
use crate::clearance::{Nearest, Placed};
use crate::shape::{Disc, Edge};

/// Everything that never moves, indexed.
#[derive(Clone)]
pub struct Scene {
    edges: BoxTree<Edge>,
    discs: BoxTree<Disc>,
}

impl Bounded for Edge {
    fn bounds(&self) -> [Point2<f64>; 2] {
        [self.a.inf(&self.b), self.a.sup(&self.b)]
    }
}

impl Bounded for Disc {
    fn bounds(&self) -> [Point2<f64>; 2] {
        let reach = nalgebra::Vector2::repeat(self.radius);
        [self.center - reach, self.center + reach]
    }
}

impl Scene {
    /// Sorts and indexes. Cost: O(n log n).
    #[must_use]
    pub fn new(edges: Vec<Edge>, discs: Vec<Disc>) -> Self {
        Self {
            edges: BoxTree::new(edges),
            discs: BoxTree::new(discs),
        }
    }

    /// All edges.
    #[must_use]
    pub fn edges(&self) -> &BoxTree<Edge> {
        &self.edges
    }

    /// All discs.
    #[must_use]
    pub fn discs(&self) -> &BoxTree<Disc> {
        &self.discs
    }

    /// The solid nearest to a footprint, where one is nearer than `limit`, m. Exact.
    #[must_use]
    pub fn nearest(&self, placed: &Placed<'_>, limit: f64) -> Option<Nearest> {
        let (from, reach) = (placed.center(), placed.reach());
        let apart = |nearest: Nearest| (nearest.distance, nearest);
        let edge = self
            .edges
            .nearest(from, reach, limit, |edge| apart(placed.to_edge(edge)));
        let limit = edge.as_ref().map_or(limit, |(distance, _)| *distance);
        let disc = self
            .discs
            .nearest(from, reach, limit, |disc| apart(placed.to_disc(disc)));
        disc.or(edge).map(|(_, nearest)| nearest)
    }
}
