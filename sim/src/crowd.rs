//! Crowd. The movers and robots near a form or a point: a tree of boxes, rebuilt once a step.
//!
//! Within a step solids move one after the other while the tree stays: the largest distance that any of them has moved since is
//! subtracted from every bound, so that searches stay exact.

use nalgebra::Point2;
use parry2d_f64::bounding_volume::Aabb;
use parry2d_f64::partitioning::{Bvh, BvhBuildStrategy, BvhNode, TraversalAction};
use parry2d_f64::query::PointQuery as _;
use zenav_protocol::geometry::Pose2;

use crate::bridge;
use crate::clearance::Placed;
use crate::shape::Solid;

/// Everything that moves, indexed by boxes.
#[derive(Clone)]
pub struct Crowd {
    solids: Vec<Solid>,
    tree: Bvh,
    /// Where the solids were when the tree was built.
    built: Vec<Point2<f64>>,
    /// Largest distance that a solid has moved since then, m.
    drift: f64,
}

impl Crowd {
    /// Indexes the solids.
    #[must_use]
    pub fn new(solids: Vec<Solid>) -> Self {
        let mut crowd = Self {
            solids,
            tree: Bvh::new(),
            built: Vec::new(),
            drift: 0.0,
        };
        crowd.refresh();
        crowd
    }

    /// Adds a solid.
    pub fn push(&mut self, solid: Solid) {
        let index = u32::try_from(self.solids.len()).unwrap_or(u32::MAX);
        self.tree.insert(bridge::around(solid.center(), solid.reach()), index);
        self.built.push(solid.center());
        self.solids.push(solid);
    }

    /// Removes a solid; the indices of those after it drop by one.
    pub fn remove(&mut self, index: usize) {
        if index < self.solids.len() {
            self.solids.remove(index);
            self.refresh();
        }
    }

    /// Rebuilds the tree from the present positions. Cost: O(n log n).
    pub fn refresh(&mut self) {
        let boxes: Vec<_> = self
            .solids
            .iter()
            .map(|solid| bridge::around(solid.center(), solid.reach()))
            .collect();
        self.tree = Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes);
        self.built.clear();
        self.built.extend(self.solids.iter().map(Solid::center));
        self.drift = 0.0;
    }

    /// The solids, in the order in which they were added.
    #[must_use]
    pub fn solids(&self) -> &[Solid] {
        &self.solids
    }

    /// Changes a solid, and notes how far it has moved.
    pub fn change(&mut self, index: usize, change: impl FnOnce(&mut Solid)) {
        if let (Some(solid), Some(built)) = (self.solids.get_mut(index), self.built.get(index)) {
            change(solid);
            self.drift = self.drift.max((solid.center() - built).norm());
        }
    }

    /// Puts a solid at a pose.
    pub fn place(&mut self, index: usize, pose: Pose2) {
        self.change(index, |solid| solid.place(pose));
    }

    /// The solid nearest to a form, except the one with index `but`, and its distance, m. Exact.
    #[must_use]
    pub fn nearest(&self, placed: &Placed, but: usize) -> Option<(f64, &Solid)> {
        let own = placed.bounds();
        let bound = |node: &BvhNode, _best: f64| {
            Aabb::new(node.mins() - own.maxs, node.maxs() - own.mins).distance_to_origin() - self.drift
        };
        let leaf = |leaf: u32, _best: f64| {
            let index = leaf as usize;
            let solid = self.solids.get(index).filter(|_| index != but)?;
            Some((solid.distance(placed), solid))
        };
        self.tree
            .find_best(f64::INFINITY, bound, leaf)
            .map(|(_, nearest)| nearest)
    }

    /// Calls `visit` with every solid that reaches within `radius` of a point, m, and with some that do not.
    pub fn near(&self, center: Point2<f64>, radius: f64, mut visit: impl FnMut(usize, &Solid)) {
        let center = bridge::vector(center);
        self.tree.traverse(|node: &BvhNode| {
            if node.aabb().distance_to_local_point(center, true) > radius + self.drift {
                return TraversalAction::Prune;
            }
            if let Some(index) = node.leaf_data().map(|leaf| leaf as usize)
                && let Some(solid) = self.solids.get(index)
            {
                visit(index, solid);
            }
            TraversalAction::Continue
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use zenav_protocol::robot::Footprint;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-5.0..5.0, -5.0..5.0, -3.0..3.0).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
    }

    proptest! {
        #[test]
        fn searches_stay_exact_while_solids_move(
            poses in prop::collection::vec((pose(), pose()), 1..40),
            at in pose(),
            but in 0..40_usize,
        ) {
            let square = [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]].map(|[x, y]| Point2::new(x, y)).to_vec();
            let shape = |i: usize| if i.is_multiple_of(2) { Footprint::Radius(0.3) } else { Footprint::Polygon(square.clone()) };
            let mut crowd = Crowd::new(poses.iter().enumerate().map(|(i, (pose, _))| Solid::new(shape(i), *pose)).collect());
            for (index, (_, pose)) in poses.iter().enumerate().filter(|(index, _)| index % 3 == 0) {
                crowd.place(index, *pose);
            }
            let footprint = Footprint::Radius(0.2);
            let placed = Placed::footprint(&footprint, at);
            let others = crowd.solids().iter().enumerate().filter(|(index, _)| *index != but);
            let least = others.map(|(_, solid)| solid.distance(&placed)).fold(f64::INFINITY, f64::min);
            let found = crowd.nearest(&placed, but).map_or(f64::INFINITY, |(distance, _)| distance);
            prop_assert_eq!(found, least);
        }
    }
}
