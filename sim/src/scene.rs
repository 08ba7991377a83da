//! Scene. The edges and discs that never move, and the distances to them.

use nalgebra::Point2;
use parry2d_f64::math::Pose;
use parry2d_f64::query::Contact;
use parry2d_f64::shape::SharedShape;
use zenav_protocol::geometry::Pose2;

use crate::boxes::{Apart, Bounded, BoxTree, Visitor};
use crate::bridge;
use crate::clearance::Placed;
use crate::shape::{Disc, Edge};

/// Everything static, indexed: once for lidars, once for clearances.
#[derive(Clone)]
pub struct Scene {
    edges: BoxTree<Edge>,
    discs: BoxTree<Disc>,
    /// All of it as one form; `None` if there is nothing.
    solid: Option<Placed>,
}

/// Edges and discs as one form; `None` if there are none.
fn solid(edges: &[Edge], discs: &[Disc]) -> Option<Placed> {
    let segment = |edge: &Edge| SharedShape::segment(bridge::vector(edge.a), bridge::vector(edge.b));
    let ball = |disc: &Disc| {
        let pose = Pose::from_translation(bridge::vector(disc.center));
        (pose, SharedShape::ball(disc.radius))
    };
    let segments = edges.iter().map(|edge| (Pose::IDENTITY, segment(edge)));
    let parts: Vec<_> = segments.chain(discs.iter().map(ball)).collect();
    (!parts.is_empty()).then(|| Placed::new(SharedShape::compound(parts), Pose2::IDENTITY))
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
            solid: solid(&edges, &discs),
            edges: BoxTree::new(edges),
            discs: BoxTree::new(discs),
        }
    }

    /// The same scene with glass: it can be touched, but no lidar sees it.
    #[must_use]
    pub fn with_glass(mut self, edges: Vec<Edge>, discs: &[Disc]) -> Self {
        if edges.is_empty() && discs.is_empty() {
            return self;
        }
        let edges: Vec<Edge> = self.edges.things().iter().copied().chain(edges).collect();
        let discs: Vec<Disc> = self.discs.things().iter().chain(discs).copied().collect();
        self.solid = solid(&edges, &discs);
        self
    }

    /// All edges that a lidar sees.
    #[must_use]
    pub fn edges(&self) -> &BoxTree<Edge> {
        &self.edges
    }

    /// All discs that a lidar sees.
    #[must_use]
    pub fn discs(&self) -> &BoxTree<Disc> {
        &self.discs
    }

    /// Distance from a form to the nearest edge or disc, m; infinite if there is none.
    #[must_use]
    pub fn distance(&self, placed: &Placed) -> f64 {
        self.solid
            .as_ref()
            .map_or(f64::INFINITY, |solid| placed.distance(solid))
    }

    /// Calls `visit` with the nearest point of every edge and disc that a lidar sees, if that point is within `radius` of a place, m.
    pub fn near(&self, place: Point2<f64>, radius: f64, visit: impl FnMut(Point2<f64>)) {
        let mut nearby = Nearby { place, radius, visit };
        self.edges.walk(place, &mut nearby);
        self.discs.walk(place, &mut nearby);
    }

    /// Whether a form overlaps an edge or disc.
    #[must_use]
    pub fn touches(&self, placed: &Placed) -> bool {
        self.solid.as_ref().is_some_and(|solid| placed.touches(solid))
    }

    /// Contact of a form with an edge or disc, within a distance, m; see [`Placed::contact`].
    #[must_use]
    pub fn contact(&self, placed: &Placed, within: f64) -> Option<Contact> {
        placed.contact(self.solid.as_ref()?, within)
    }
}

/// Visitor of everything near a place.
struct Nearby<F> {
    place: Point2<f64>,
    radius: f64,
    visit: F,
}

impl<F: FnMut(Point2<f64>)> Nearby<F> {
    fn found(&mut self, nearest: Point2<f64>) {
        if (nearest - self.place).norm_squared() <= self.radius * self.radius {
            (self.visit)(nearest);
        }
    }
}

impl<F: FnMut(Point2<f64>)> Visitor<Edge> for Nearby<F> {
    /// Squared distance, m².
    type View = f64;

    fn look(&self, pair: [&Apart; 2]) -> [f64; 2] {
        pair.map(|apart| apart.squared)
    }

    fn enters(&self, squared: &f64) -> bool {
        *squared <= self.radius * self.radius
    }

    fn meet(&mut self, edges: &[Edge]) {
        for edge in edges {
            self.found(edge.nearest(self.place));
        }
    }
}

impl<F: FnMut(Point2<f64>)> Visitor<Disc> for Nearby<F> {
    type View = f64;

    fn look(&self, pair: [&Apart; 2]) -> [f64; 2] {
        pair.map(|apart| apart.squared)
    }

    fn enters(&self, squared: &f64) -> bool {
        *squared <= self.radius * self.radius
    }

    fn meet(&mut self, discs: &[Disc]) {
        for disc in discs {
            let outwards = (self.place - disc.center).try_normalize(1e-9);
            self.found(disc.center + outwards.unwrap_or_else(nalgebra::Vector2::x) * disc.radius);
        }
    }
}
