//! Which edges and discs never move, and how far are they?

use nalgebra::Point2;
use parry2d_f64::math::Pose;
use parry2d_f64::query::Contact;
use parry2d_f64::shape::SharedShape;
use zenav_protocol::geometry::Pose2;

use crate::boxes::{Bounded, BoxTree};
use crate::bridge;
use crate::clearance::Placed;
use crate::shape::{Disc, Edge};

/// Everything that never moves, indexed: once for lidars, once for clearances.
#[derive(Clone)]
pub struct Scene {
    edges: BoxTree<Edge>,
    discs: BoxTree<Disc>,
    /// All of it as one form, unless there is nothing.
    solid: Option<Placed>,
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
        let segment = |edge: &Edge| SharedShape::segment(bridge::vector(edge.a), bridge::vector(edge.b));
        let ball = |disc: &Disc| {
            (
                Pose::from_translation(bridge::vector(disc.center)),
                SharedShape::ball(disc.radius),
            )
        };
        let segments = edges.iter().map(|edge| (Pose::IDENTITY, segment(edge)));
        let parts: Vec<_> = segments.chain(discs.iter().map(ball)).collect();
        Self {
            solid: (!parts.is_empty()).then(|| Placed::new(SharedShape::compound(parts), Pose2::IDENTITY)),
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

    /// Distance from a form to the nearest edge or disc, m; infinite where there is none.
    #[must_use]
    pub fn distance(&self, placed: &Placed) -> f64 {
        self.solid
            .as_ref()
            .map_or(f64::INFINITY, |solid| placed.distance(solid))
    }

    /// Whether a form overlaps an edge or disc.
    #[must_use]
    pub fn touches(&self, placed: &Placed) -> bool {
        self.solid.as_ref().is_some_and(|solid| placed.touches(solid))
    }

    /// Where a form touches an edge or disc, or would within a distance, m; see [`Placed::contact`].
    #[must_use]
    pub fn contact(&self, placed: &Placed, within: f64) -> Option<Contact> {
        placed.contact(self.solid.as_ref()?, within)
    }
}
