//! Shapes. Solids are made of directed edges with the solid on their left, and of discs.
//!
//! Everything that a lidar sees or a footprint touches is one of the two: polygons and map cells are represented by their edges.

use nalgebra::Point2;
use parry2d_f64::query::Contact;
use parry2d_f64::shape::SharedShape;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::polygon::is_convex;
pub use zenav_protocol::polygon::{Edge, contains, cross, crossings, doubled_area, edges};
use zenav_protocol::robot::Footprint;

use crate::bridge;
use crate::clearance::Placed;

/// A round solid, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Centre, m.
    pub center: Point2<f64>,
    /// Radius, m.
    pub radius: f64,
}

/// A form for parry: solid if it is convex, otherwise its outline.
pub(crate) fn form(shape: &Footprint) -> SharedShape {
    match shape {
        Footprint::Radius(radius) => SharedShape::ball(*radius),
        Footprint::Polygon(corners) => {
            let points = || corners.iter().map(|corner| bridge::vector(*corner));
            let solid = is_convex(corners).then(|| SharedShape::convex_polyline_unmodified(points().collect()));
            let outline = || SharedShape::polyline(points().chain(points().take(1)).collect(), None);
            solid.flatten().unwrap_or_else(outline)
        }
    }
}

/// A solid that can move: its form and its present place, in world coordinates.
#[derive(Clone)]
pub struct Solid {
    shape: Footprint,
    placed: Placed,
    reach: f64,
    edges: Vec<Edge>,
}

impl Solid {
    /// A form at a pose; as a polygon it may be concave.
    #[must_use]
    pub fn new(shape: Footprint, pose: Pose2) -> Self {
        let mut solid = Self {
            placed: Placed::new(form(&shape), pose),
            reach: shape.circumscribed_radius(),
            edges: Vec::new(),
            shape,
        };
        solid.place(pose);
        solid
    }

    /// Puts the form at a pose.
    pub fn place(&mut self, pose: Pose2) {
        self.placed = self.placed.at(pose);
        self.edges.clear();
        if let Footprint::Polygon(corners) = &self.shape {
            let (sin, cos) = pose.yaw.sin_cos();
            let placed = |p: Point2<f64>| Point2::new(pose.x + cos * p.x - sin * p.y, pose.y + sin * p.x + cos * p.y);
            self.edges.extend(edges(corners).map(|edge| Edge {
                a: placed(edge.a),
                b: placed(edge.b),
            }));
        }
    }

    /// Its origin, m.
    #[must_use]
    pub fn center(&self) -> Point2<f64> {
        self.placed.center()
    }

    /// Largest distance of any part from its origin, m.
    #[must_use]
    pub fn reach(&self) -> f64 {
        self.reach
    }

    /// Its edges; none for a disc.
    #[must_use]
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// The disc, if it is one.
    #[must_use]
    pub fn disc(&self) -> Option<Disc> {
        match self.shape {
            Footprint::Radius(radius) => Some(Disc {
                center: self.center(),
                radius,
            }),
            Footprint::Polygon(_) => None,
        }
    }

    /// Distance from a form, m; also zero if one contains the other.
    #[must_use]
    pub fn distance(&self, placed: &Placed) -> f64 {
        if !self.placed.is_convex() && crossings(self.edges.iter().copied(), placed.center()) {
            return 0.0;
        }
        placed.distance(&self.placed)
    }

    /// Contact of a form with it, within a distance, m; see [`Placed::contact`].
    #[must_use]
    pub fn contact(&self, placed: &Placed, within: f64) -> Option<Contact> {
        placed.contact(&self.placed, within)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn l_shape() -> Vec<Point2<f64>> {
        [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]]
            .map(|[x, y]| Point2::new(x, y))
            .to_vec()
    }

    #[test]
    fn a_concave_polygon_knows_its_inside_and_area() {
        assert_eq!(doubled_area(&l_shape()), 6.0);
        assert!(contains(&l_shape(), Point2::new(0.5, 1.5)));
        assert!(!contains(&l_shape(), Point2::new(1.5, 1.5)));
    }

    #[test]
    fn a_placed_solid_turns_with_its_pose() {
        let solid = Solid::new(
            Footprint::Polygon(l_shape()),
            Pose2::new(5.0, 5.0, std::f64::consts::FRAC_PI_2),
        );
        let dot = Placed::new(SharedShape::ball(0.1), Pose2::IDENTITY);
        let distance = |x, y| solid.distance(&dot.at(Pose2::new(x, y, 0.0)));
        assert_eq!((distance(4.5, 6.5), distance(3.5, 5.5)), (0.0, 0.0));
        assert!((distance(3.5, 6.5) - 0.4).abs() < 1e-12);
    }
}
