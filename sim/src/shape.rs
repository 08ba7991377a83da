//! What are solids made of? Directed edges with the solid on their left, and discs.
//!
//! Everything that a lidar sees or a footprint touches is one of the two: polygons and map cells are their edges.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
pub use zenav_protocol::polygon::{Edge, contains, cross, crossings, doubled_area, edges};
use zenav_protocol::robot::Footprint;

/// A round solid, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Its centre.
    pub center: Point2<f64>,
    /// Its radius.
    pub radius: f64,
}

/// The form of a solid in its own frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A disc around the origin, m.
    Disc(f64),
    /// Corners of a simple polygon, counter-clockwise, m.
    Polygon(Vec<Point2<f64>>),
}

impl From<&Footprint> for Shape {
    fn from(footprint: &Footprint) -> Self {
        match footprint {
            Footprint::Radius(radius) => Self::Disc(*radius),
            Footprint::Polygon(corners) => Self::Polygon(corners.clone()),
        }
    }
}

/// A solid that can move: its form and where it is now, in world coordinates.
#[derive(Clone, Debug)]
pub struct Solid {
    shape: Shape,
    center: Point2<f64>,
    reach: f64,
    edges: Vec<Edge>,
}

impl Solid {
    /// A form at a pose.
    #[must_use]
    pub fn new(shape: Shape, pose: Pose2) -> Self {
        let reach = match &shape {
            Shape::Disc(radius) => *radius,
            Shape::Polygon(corners) => corners.iter().map(|corner| corner.coords.norm()).fold(0.0, f64::max),
        };
        let mut solid = Self {
            shape,
            center: pose.position(),
            reach,
            edges: Vec::new(),
        };
        solid.place(pose);
        solid
    }

    /// Puts the form at a pose.
    pub fn place(&mut self, pose: Pose2) {
        self.center = pose.position();
        self.edges.clear();
        if let Shape::Polygon(corners) = &self.shape {
            let (sin, cos) = pose.yaw.sin_cos();
            let placed = |p: Point2<f64>| Point2::new(pose.x + cos * p.x - sin * p.y, pose.y + sin * p.x + cos * p.y);
            self.edges.extend(edges(corners).map(|edge| Edge {
                a: placed(edge.a),
                b: placed(edge.b),
            }));
        }
    }

    /// Where its origin is, m.
    #[must_use]
    pub fn center(&self) -> Point2<f64> {
        self.center
    }

    /// No part of it is farther from its origin, m.
    #[must_use]
    pub fn reach(&self) -> f64 {
        self.reach
    }

    /// Its edges; none for a disc.
    #[must_use]
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// The disc, where it is one.
    #[must_use]
    pub fn disc(&self) -> Option<Disc> {
        match self.shape {
            Shape::Disc(radius) => Some(Disc {
                center: self.center,
                radius,
            }),
            Shape::Polygon(_) => None,
        }
    }

    /// Whether a point lies inside.
    #[must_use]
    pub fn contains(&self, point: Point2<f64>) -> bool {
        match self.shape {
            Shape::Disc(radius) => (point - self.center).norm_squared() <= radius * radius,
            Shape::Polygon(_) => crossings(self.edges.iter().copied(), point),
        }
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
            Shape::Polygon(l_shape()),
            Pose2::new(5.0, 5.0, std::f64::consts::FRAC_PI_2),
        );
        assert!(solid.contains(Point2::new(4.5, 6.5)) && solid.contains(Point2::new(3.5, 5.5)));
        assert!(!solid.contains(Point2::new(3.5, 6.5)));
    }
}
