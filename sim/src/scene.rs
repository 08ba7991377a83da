//! Which edges and discs are near? A tree of boxes (parry's BVH) over short runs of neighbouring edges.
//!
//! Edges are sorted along a Z-order curve and cut into runs, so that a box of the tree holds what is close together:
//! a sweep of the lidar and a search for the nearest solid both touch little memory, on drawn worlds as on map worlds.

use nalgebra::Point2;
use parry2d_f64::partitioning::{Bvh, BvhBuildStrategy, BvhNode, TraversalAction};

use crate::bridge;
use crate::clearance::{Nearest, Placed};
use crate::shape::{Disc, Edge};

/// Edges or discs in one box of the tree.
const RUN: usize = 8;

/// Everything that never moves, indexed.
#[derive(Clone)]
pub struct Scene {
    edges: Vec<Edge>,
    discs: Vec<Disc>,
    /// Leaves below this number are runs of edges, the others runs of discs.
    edge_runs: usize,
    tree: Bvh,
}

impl Scene {
    /// Sorts and indexes. Cost: O(n log n).
    #[must_use]
    pub fn new(mut edges: Vec<Edge>, mut discs: Vec<Disc>) -> Self {
        let low = edges
            .iter()
            .map(middle)
            .chain(discs.iter().map(|disc| disc.center))
            .fold([f64::INFINITY; 2], |low, p| [low[0].min(p.x), low[1].min(p.y)]);
        edges.sort_by_cached_key(|edge| z_order(middle(edge), low));
        discs.sort_by_cached_key(|disc| z_order(disc.center, low));
        let edge_boxes = edges.chunks(RUN).map(|run| {
            let ends = run.iter().flat_map(|edge| [edge.a, edge.b]);
            bounds(ends.map(|p| (p, 0.0)))
        });
        let disc_boxes = discs
            .chunks(RUN)
            .map(|run| bounds(run.iter().map(|disc| (disc.center, disc.radius))));
        let boxes: Vec<_> = edge_boxes.chain(disc_boxes).collect();
        let tree = Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes);
        let edge_runs = edges.len().div_ceil(RUN);
        Self {
            edges,
            discs,
            edge_runs,
            tree,
        }
    }

    /// Number of edges.
    #[must_use]
    pub fn edge_count(&self) -> usize {
        self.edges.len()
    }

    /// Number of discs.
    #[must_use]
    pub fn disc_count(&self) -> usize {
        self.discs.len()
    }

    fn run(&self, leaf: u32) -> (&[Edge], &[Disc]) {
        let leaf = leaf as usize;
        if leaf < self.edge_runs {
            let from = leaf * RUN;
            (
                self.edges.get(from..(from + RUN).min(self.edges.len())).unwrap_or(&[]),
                &[],
            )
        } else {
            let from = (leaf - self.edge_runs) * RUN;
            (
                &[],
                self.discs.get(from..(from + RUN).min(self.discs.len())).unwrap_or(&[]),
            )
        }
    }

    /// Calls `visit` with runs that hold at least every edge and disc within `radius` of a point, m.
    pub fn near(&self, center: Point2<f64>, radius: f64, mut visit: impl FnMut(&[Edge], &[Disc])) {
        let limit = radius * radius;
        self.tree.traverse(|node: &BvhNode| {
            if bridge::squared_distance(center, node.mins(), node.maxs()) > limit {
                return TraversalAction::Prune;
            }
            if let Some(leaf) = node.leaf_data() {
                let (edges, discs) = self.run(leaf);
                visit(edges, discs);
            }
            TraversalAction::Continue
        });
    }

    /// The solid nearest to a footprint, where one is nearer than `limit`, m. Exact.
    #[must_use]
    pub fn nearest(&self, placed: &Placed<'_>, limit: f64) -> Option<Nearest> {
        let bound = |node: &BvhNode, _best: f64| {
            bridge::squared_distance(placed.center(), node.mins(), node.maxs()).sqrt() - placed.reach()
        };
        let leaf = |leaf: u32, best: f64| {
            let (edges, discs) = self.run(leaf);
            let found = edges
                .iter()
                .map(|edge| placed.to_edge(edge))
                .chain(discs.iter().map(|disc| placed.to_disc(disc)));
            found
                .filter(|nearest| nearest.distance < best)
                .min_by(|a, b| a.distance.total_cmp(&b.distance))
                .map(|nearest| (nearest.distance, nearest))
        };
        self.tree.find_best(limit, bound, leaf).map(|(_, (_, nearest))| nearest)
    }
}

fn middle(edge: &Edge) -> Point2<f64> {
    nalgebra::center(&edge.a, &edge.b)
}

fn bounds(points: impl Iterator<Item = (Point2<f64>, f64)>) -> parry2d_f64::bounding_volume::Aabb {
    let start = (
        Point2::new(f64::INFINITY, f64::INFINITY),
        Point2::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
    );
    let (low, high) = points.fold(start, |(low, high), (p, r)| {
        (
            Point2::new(low.x.min(p.x - r), low.y.min(p.y - r)),
            Point2::new(high.x.max(p.x + r), high.y.max(p.y + r)),
        )
    });
    bridge::aabb(low, high)
}

/// Place on a Z-order curve of quarter-metre squares.
fn z_order(point: Point2<f64>, low: [f64; 2]) -> u64 {
    let spread = |value: f64| {
        // Float to integer casts saturate.
        let mut bits = u64::from((value * 4.0) as u32);
        for (shift, mask) in [
            (16, 0x0000_FFFF_0000_FFFF),
            (8, 0x00FF_00FF_00FF_00FF),
            (4, 0x0F0F_0F0F_0F0F_0F0F),
            (2, 0x3333_3333_3333_3333),
            (1, 0x5555_5555_5555_5555),
        ] {
            bits = (bits | (bits << shift)) & mask;
        }
        bits
    };
    spread(point.x - low[0]) | (spread(point.y - low[1]) << 1)
}
