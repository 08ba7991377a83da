//! How far is a footprint from a solid? Exact distances between true outlines.
//!
//! Discs and convex polygons as footprints, edges and discs as solids. parry's GJK is the reference in the tests.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Footprint;

use crate::shape::{Disc, Edge, Solid, cross, edges};

/// The nearest points of a footprint and a solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Distance between the two points, m; zero when they overlap.
    pub distance: f64,
    /// On the footprint, base frame, m.
    pub on_body: Point2<f64>,
    /// On the solid, base frame, m.
    pub on_solid: Point2<f64>,
}

impl Nearest {
    /// Nothing anywhere.
    pub const NONE: Self = Self {
        distance: f64::INFINITY,
        on_body: Point2::new(0.0, 0.0),
        on_solid: Point2::new(0.0, 0.0),
    };

    fn or(self, other: Self) -> Self {
        if other.distance < self.distance { other } else { self }
    }
}

/// A footprint at a pose.
#[derive(Clone, Copy, Debug)]
pub struct Placed<'a> {
    footprint: &'a Footprint,
    center: Point2<f64>,
    sin: f64,
    cos: f64,
    reach: f64,
}

impl<'a> Placed<'a> {
    /// Puts a footprint at a pose in the world.
    #[must_use]
    pub fn new(footprint: &'a Footprint, map_from_base: Pose2) -> Self {
        let (sin, cos) = map_from_base.yaw.sin_cos();
        Self {
            footprint,
            center: map_from_base.position(),
            sin,
            cos,
            reach: footprint.circumscribed_radius(),
        }
    }

    /// Where the base is, m.
    #[must_use]
    pub fn center(&self) -> Point2<f64> {
        self.center
    }

    /// No part of the footprint is farther from the base, m.
    #[must_use]
    pub fn reach(&self) -> f64 {
        self.reach
    }

    fn to_base(self, point: Point2<f64>) -> Point2<f64> {
        let d = point - self.center;
        Point2::new(self.cos * d.x + self.sin * d.y, self.cos * d.y - self.sin * d.x)
    }

    /// Distance to an edge.
    #[must_use]
    pub fn to_edge(&self, edge: &Edge) -> Nearest {
        match self.footprint {
            Footprint::Radius(radius) => {
                let nearest = closest(edge, self.center);
                from_disc(*radius, self.to_base(nearest))
            }
            Footprint::Polygon(corners) => polygon_to_edge(
                corners,
                &Edge {
                    a: self.to_base(edge.a),
                    b: self.to_base(edge.b),
                },
            ),
        }
    }

    /// Distance to a disc.
    #[must_use]
    pub fn to_disc(&self, disc: &Disc) -> Nearest {
        let center = self.to_base(disc.center);
        let to_center = match self.footprint {
            Footprint::Radius(radius) => from_disc(*radius, center),
            Footprint::Polygon(corners) => polygon_to_point(corners, center),
        };
        let toward = center - to_center.on_body;
        let length = toward.norm();
        let on_solid = if length > 0.0 {
            center - toward * (disc.radius / length).min(1.0)
        } else {
            center
        };
        Nearest {
            distance: (to_center.distance - disc.radius).max(0.0),
            on_body: to_center.on_body,
            on_solid,
        }
    }

    /// Distance to a solid that can move; zero too when one holds the other.
    #[must_use]
    pub fn to_solid(&self, solid: &Solid) -> Nearest {
        if let Some(disc) = solid.disc() {
            return self.to_disc(&disc);
        }
        if solid.contains(self.center) {
            return Nearest {
                distance: 0.0,
                on_body: Point2::origin(),
                on_solid: self.to_base(solid.center()),
            };
        }
        solid
            .edges()
            .iter()
            .map(|edge| self.to_edge(edge))
            .fold(Nearest::NONE, Nearest::or)
    }

    /// No nearer than this to a solid, m: cheap, from centres alone.
    #[must_use]
    pub fn at_least_to(&self, solid: &Solid) -> f64 {
        (solid.center() - self.center).norm() - solid.reach() - self.reach
    }
}

/// The point of an edge that is closest to a point.
fn closest(edge: &Edge, point: Point2<f64>) -> Point2<f64> {
    let along = edge.b - edge.a;
    let squared = along.norm_squared();
    let share = if squared > 0.0 {
        ((point - edge.a).dot(&along) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    edge.a + along * share
}

fn from_disc(radius: f64, point: Point2<f64>) -> Nearest {
    let norm = point.coords.norm();
    let on_body = if norm > radius { point * (radius / norm) } else { point };
    Nearest {
        distance: (norm - radius).max(0.0),
        on_body,
        on_solid: point,
    }
}

/// Convex polygon and point, both in the base frame.
fn polygon_to_point(corners: &[Point2<f64>], point: Point2<f64>) -> Nearest {
    if edges(corners).all(|edge| cross(edge.b - edge.a, point - edge.a) >= 0.0) {
        return Nearest {
            distance: 0.0,
            on_body: point,
            on_solid: point,
        };
    }
    let boundary = edges(corners).map(|edge| {
        let on_body = closest(&edge, point);
        Nearest {
            distance: (point - on_body).norm(),
            on_body,
            on_solid: point,
        }
    });
    boundary.fold(Nearest::NONE, Nearest::or)
}

/// Convex polygon and edge, both in the base frame.
fn polygon_to_edge(corners: &[Point2<f64>], edge: &Edge) -> Nearest {
    // What is left of the edge inside all half planes (Cyrus and Beck 1978)?
    let along = edge.b - edge.a;
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for side in edges(corners) {
        let d = side.b - side.a;
        let (start, change) = (cross(d, edge.a - side.a), cross(d, along));
        if change > 0.0 {
            enter = enter.max(-start / change);
        } else if change < 0.0 {
            leave = leave.min(-start / change);
        } else if start < 0.0 {
            leave = f64::NEG_INFINITY;
        }
    }
    if enter <= leave {
        let inside = edge.a + along * (0.5 * (enter + leave));
        return Nearest {
            distance: 0.0,
            on_body: inside,
            on_solid: inside,
        };
    }
    let ends = polygon_to_point(corners, edge.a).or(polygon_to_point(corners, edge.b));
    let from_corners = corners.iter().map(|corner| {
        let on_solid = closest(edge, *corner);
        Nearest {
            distance: (on_solid - corner).norm(),
            on_body: *corner,
            on_solid,
        }
    });
    from_corners.fold(ends, Nearest::or)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::bridge;
    use crate::scene::Scene;
    use crate::shape::Shape;
    use parry2d_f64::math::{Pose, Vector};
    use parry2d_f64::query;
    use parry2d_f64::shape::{Ball, ConvexPolygon, Segment, Shape as ParryShape};
    use proptest::prelude::*;

    fn parry(footprint: &Footprint) -> Box<dyn ParryShape> {
        match footprint {
            Footprint::Radius(radius) => Box::new(Ball::new(*radius)),
            Footprint::Polygon(corners) => Box::new(
                ConvexPolygon::from_convex_polyline(corners.iter().map(|p| bridge::vector(*p)).collect()).unwrap(),
            ),
        }
    }

    fn footprint() -> impl Strategy<Value = Footprint> {
        let rectangle = (0.05..0.5, 0.05..0.5, 0.05..0.4).prop_map(|(back, front, half): (f64, f64, f64)| {
            Footprint::Polygon(
                [
                    [-back, -half],
                    [front, -half],
                    [front + 0.1, 0.0],
                    [front, half],
                    [-back, half],
                ]
                .map(|[x, y]: [f64; 2]| Point2::new(x, y))
                .to_vec(),
            )
        });
        prop_oneof![(0.05..0.5).prop_map(Footprint::Radius), rectangle]
    }

    fn point() -> impl Strategy<Value = Point2<f64>> {
        (-2.0..2.0, -2.0..2.0).prop_map(|(x, y)| Point2::new(x, y))
    }

    proptest! {
        #[test]
        fn distances_equal_parrys(footprint in footprint(), at in point(), yaw in -3.0..3.0, a in point(), b in point(), radius in 0.01..0.5) {
            let placed = Placed::new(&footprint, Pose2::new(at.x, at.y, yaw));
            let shape = parry(&footprint);
            let pose = Pose::new(bridge::vector(at), yaw);
            let edge = placed.to_edge(&Edge { a, b });
            let theirs = query::distance(&pose, shape.as_ref(), &Pose::identity(), &Segment::new(bridge::vector(a), bridge::vector(b))).unwrap().distance;
            prop_assert!((edge.distance - theirs).abs() < 1e-6, "{} {theirs}", edge.distance);
            prop_assert!(((edge.on_solid - edge.on_body).norm() - edge.distance).abs() < 1e-9);
            let disc = placed.to_disc(&Disc { center: a, radius });
            let theirs = query::distance(&pose, shape.as_ref(), &Pose::new(Vector::new(a.x, a.y), 0.0), &Ball::new(radius)).unwrap().distance;
            prop_assert!((disc.distance - theirs).abs() < 1e-6, "{} {theirs}", disc.distance);
        }

        #[test]
        fn the_tree_finds_what_a_search_through_everything_finds(footprint in footprint(), at in point(), yaw in -3.0..3.0, ends in prop::collection::vec((point(), point()), 0..60), discs in prop::collection::vec((point(), 0.01..0.3), 0..20)) {
            let edges: Vec<Edge> = ends.into_iter().map(|(a, b)| Edge { a, b }).collect();
            let discs: Vec<Disc> = discs.into_iter().map(|(center, radius)| Disc { center, radius }).collect();
            let placed = Placed::new(&footprint, Pose2::new(at.x, at.y, yaw));
            let all = edges.iter().map(|edge| placed.to_edge(edge)).chain(discs.iter().map(|disc| placed.to_disc(disc)));
            let least = all.map(|nearest| nearest.distance).fold(f64::INFINITY, f64::min);
            let found = Scene::new(edges, discs).nearest(&placed, f64::INFINITY).map_or(f64::INFINITY, |nearest| nearest.distance);
            prop_assert_eq!(found, least);
        }
    }

    #[test]
    fn a_robot_inside_a_larger_solid_has_no_clearance() {
        let wagon = Solid::new(
            Shape::Polygon(
                [[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]]
                    .map(|[x, y]| Point2::new(x, y))
                    .to_vec(),
            ),
            Pose2::IDENTITY,
        );
        assert_eq!(
            Placed::new(&Footprint::Radius(0.2), Pose2::IDENTITY)
                .to_solid(&wagon)
                .distance,
            0.0
        );
        assert!(
            (Placed::new(&Footprint::Radius(0.2), Pose2::new(3.0, 0.0, 1.0))
                .to_solid(&wagon)
                .distance
                - 0.8)
                .abs()
                < 1e-12
        );
    }
}
