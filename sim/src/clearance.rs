//! Clearance and contact. The distance between two forms, and where they touch, by parry on true outlines.

use nalgebra::Point2;
use parry2d_f64::bounding_volume::Aabb;
use parry2d_f64::math::Pose;
use parry2d_f64::query::{Contact, DefaultQueryDispatcher, QueryDispatcher as _};
use parry2d_f64::shape::SharedShape;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Footprint;

use crate::bridge;
use crate::shape::form;

/// How far something comes from `free` towards `taken`, halved this many times.
pub(crate) fn halved(mut free: f64, mut taken: f64, times: u32, mut is_free: impl FnMut(f64) -> bool) -> f64 {
    for _ in 0..times {
        let middle = 0.5 * (free + taken);
        if is_free(middle) {
            free = middle;
        } else {
            taken = middle;
        }
    }
    free
}

/// A form at a pose.
#[derive(Clone)]
pub struct Placed {
    form: SharedShape,
    pose: Pose,
}

impl Placed {
    /// Puts a form at a pose in the world.
    #[must_use]
    pub fn new(form: SharedShape, map_from_form: Pose2) -> Self {
        let pose = Pose::new(bridge::vector(map_from_form.position()), map_from_form.yaw);
        Self { form, pose }
    }

    /// Puts a footprint at a pose in the world.
    ///
    /// ```
    /// use zenav_protocol::{geometry::Pose2, robot::Footprint};
    /// use zenav_sim::clearance::Placed;
    ///
    /// let robot = Placed::footprint(&Footprint::Radius(0.25), Pose2::IDENTITY);
    /// let other = robot.at(Pose2::new(1.0, 0.0, 0.0));
    /// assert!((robot.distance(&other) - 0.5).abs() < 1e-9);
    /// let nearer = other.at(Pose2::new(0.4, 0.0, 0.0));
    /// assert!(robot.touches(&nearer) && robot.distance(&nearer) == 0.0);
    /// ```
    #[must_use]
    pub fn footprint(footprint: &Footprint, map_from_base: Pose2) -> Self {
        Self::new(form(footprint), map_from_base)
    }

    /// The same form at another pose.
    #[must_use]
    pub fn at(&self, map_from_form: Pose2) -> Self {
        Self::new(self.form.clone(), map_from_form)
    }

    /// Its origin, m.
    #[must_use]
    pub fn center(&self) -> Point2<f64> {
        Point2::new(self.pose.translation.x, self.pose.translation.y)
    }

    /// The box around it, m.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        self.form.compute_aabb(&self.pose)
    }

    /// Whether its inside is solid: a non-convex outline has only edges.
    #[must_use]
    pub fn is_convex(&self) -> bool {
        self.form.is_convex()
    }

    /// Distance to another form, m; zero if they overlap.
    #[must_use]
    pub fn distance(&self, other: &Self) -> f64 {
        DefaultQueryDispatcher
            .distance(&self.pose.inv_mul(&other.pose), &*self.form, &*other.form)
            .map_or(f64::INFINITY, |found| found.distance)
    }

    /// Whether it overlaps another form.
    #[must_use]
    pub fn touches(&self, other: &Self) -> bool {
        DefaultQueryDispatcher
            .intersection_test(&self.pose.inv_mul(&other.pose), &*self.form, &*other.form)
            .is_ok_and(|found| found.intersecting)
    }

    /// Contact with another form, or the closest points if they are within a distance, m: the points in each form's own frame, and its
    /// outward normal.
    #[must_use]
    pub fn contact(&self, other: &Self, within: f64) -> Option<Contact> {
        DefaultQueryDispatcher
            .contact(&self.pose.inv_mul(&other.pose), &*self.form, &*other.form, within)
            .unwrap_or(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use crate::shape::{Disc, Edge, Solid, edges};
    use proptest::prelude::*;
    use zenav_protocol::polygon::{contains, touch};

    fn footprint() -> impl Strategy<Value = Footprint> {
        let pentagon = (0.05..0.5, 0.05..0.5, 0.05..0.4).prop_map(|(back, front, half): (f64, f64, f64)| {
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
        prop_oneof![(0.05..0.5).prop_map(Footprint::Radius), pentagon]
    }

    fn point() -> impl Strategy<Value = Point2<f64>> {
        (-2.0..2.0, -2.0..2.0).prop_map(|(x, y)| Point2::new(x, y))
    }

    fn to_point(edge: &Edge, point: Point2<f64>) -> f64 {
        (edge.nearest(point) - point).norm()
    }

    /// Reference: the distance from a footprint to an edge, both in the base frame.
    fn to_edge(footprint: &Footprint, edge: &Edge) -> f64 {
        match footprint {
            Footprint::Radius(radius) => (to_point(edge, Point2::origin()) - radius).max(0.0),
            Footprint::Polygon(corners) => {
                if edges(corners).any(|side| touch(side, *edge)) || contains(corners, edge.a) {
                    return 0.0;
                }
                let ends = footprint.distance(edge.a).min(footprint.distance(edge.b));
                corners
                    .iter()
                    .map(|corner| to_point(edge, *corner))
                    .fold(ends, f64::min)
            }
        }
    }

    proptest! {
        #[test]
        fn distances_are_exact_and_contacts_lie_at_them(footprint in footprint(), at in point(), yaw in -3.0..3.0, a in point(), b in point(), radius in 0.01..0.5) {
            let map_from_base = Pose2::new(at.x, at.y, yaw);
            let base = |point: Point2<f64>| map_from_base.inverse().transform_point(point);
            let placed = Placed::footprint(&footprint, map_from_base);
            let edge = Scene::new(vec![Edge { a, b }], Vec::new());
            let disc = Scene::new(Vec::new(), vec![Disc { center: a, radius }]);
            let to_edge = to_edge(&footprint, &Edge { a: base(a), b: base(b) });
            let to_disc = (footprint.distance(base(a)) - radius).max(0.0);
            for (scene, exact) in [(edge, to_edge), (disc, to_disc)] {
                let distance = scene.distance(&placed);
                prop_assert!((distance - exact).abs() < 1e-9 + 1e-7 * exact, "{distance} {exact}");
                prop_assert_eq!(scene.touches(&placed), distance == 0.0);
                let contact = scene.contact(&placed, distance + 1e-6);
                prop_assert!(contact.is_some_and(|contact| (contact.dist.max(0.0) - exact).abs() < 1e-6), "{contact:?} {exact}");
                prop_assert!(exact < 1e-3 || scene.contact(&placed, 0.5 * exact).is_none());
            }
        }

        #[test]
        fn the_tree_finds_what_a_search_through_everything_finds(footprint in footprint(), at in point(), yaw in -3.0..3.0, ends in prop::collection::vec((point(), point()), 0..60), discs in prop::collection::vec((point(), 0.01..0.3), 0..20)) {
            let edges: Vec<Edge> = ends.into_iter().map(|(a, b)| Edge { a, b }).collect();
            let discs: Vec<Disc> = discs.into_iter().map(|(center, radius)| Disc { center, radius }).collect();
            let placed = Placed::footprint(&footprint, Pose2::new(at.x, at.y, yaw));
            let each = edges.iter().map(|edge| Scene::new(vec![*edge], Vec::new()));
            let each = each.chain(discs.iter().map(|disc| Scene::new(Vec::new(), vec![*disc])));
            let least = each.map(|scene| scene.distance(&placed)).fold(f64::INFINITY, f64::min);
            prop_assert_eq!(Scene::new(edges, discs).distance(&placed), least);
        }
    }

    #[test]
    fn a_robot_inside_a_larger_solid_has_no_clearance() {
        let square = [[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]];
        let notched = [[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [0.0, 1.5], [-2.0, 2.0]];
        for corners in [&square[..], &notched] {
            let corners = corners.iter().map(|[x, y]| Point2::new(*x, *y)).collect();
            let wagon = Solid::new(Footprint::Polygon(corners), Pose2::IDENTITY);
            let distance = |pose| wagon.distance(&Placed::footprint(&Footprint::Radius(0.2), pose));
            assert_eq!(distance(Pose2::IDENTITY), 0.0);
            assert!((distance(Pose2::new(3.0, 0.0, 1.0)) - 0.8).abs() < 1e-12);
        }
    }
}
