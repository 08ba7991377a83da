//! Drawing. What of the pose graph is drawn? All of a small one; of a larger one every second node, or every third, …, and the edges
//! between the groups of nodes that these stand for.

use std::collections::BTreeMap;

use zenav_pose_graph::{Edge, EdgeKind};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{GraphEdge, GraphEdgeKind, MOST_GRAPH_EDGES, MOST_GRAPH_NODES};

use crate::slam::Slam;

impl Slam {
    /// The pose graph for a picture: nodes, `map_from_node`, and edges between them, closures first, at most [`MOST_GRAPH_NODES`] and
    /// [`MOST_GRAPH_EDGES`]. Numbers are rounded to thousandths.
    ///
    /// ```
    #[doc = include_str!("doc_setup/mapped_room.txt")]
    /// let (nodes, edges) = slam.drawn_graph();
    /// assert_eq!(nodes.len(), slam.nodes().len(), "a small graph is drawn whole");
    /// assert!((0..8).all(|node| edges.iter().any(|edge| (edge.from, edge.to) == (node, node + 1))));
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn drawn_graph(&self) -> (Vec<Pose2>, Vec<GraphEdge>) {
        let edges = self.graph().edges().iter().zip(self.weights().iter().copied());
        drawn(self.nodes(), edges)
    }
}

fn drawn<'e>(poses: &[Pose2], edges: impl Iterator<Item = (&'e Edge, f64)>) -> (Vec<Pose2>, Vec<GraphEdge>) {
    let stride = poses.len().div_ceil(MOST_GRAPH_NODES).max(1);
    let nodes = poses.iter().step_by(stride).map(rounded).collect();
    // Of several edges between the same groups the one with the largest weight is drawn.
    let (mut closures, mut odometry) = (BTreeMap::new(), BTreeMap::new());
    for (edge, weight) in edges {
        let (from, to) = (edge.from / stride, edge.to / stride);
        let (Ok(from), Ok(to)) = (u32::try_from(from), u32::try_from(to)) else {
            continue;
        };
        let (kind, known) = match edge.kind {
            EdgeKind::Closure => (GraphEdgeKind::Closure, &mut closures),
            EdgeKind::Odometry => (GraphEdgeKind::Odometry, &mut odometry),
        };
        if from == to {
            continue;
        }
        let weight = milli(weight);
        let drawn = GraphEdge { from, to, kind, weight };
        let entry = known.entry((from, to)).or_insert(drawn);
        entry.weight = entry.weight.max(weight);
    }
    let edges = closures.into_values().chain(odometry.into_values());
    (nodes, edges.take(MOST_GRAPH_EDGES).collect())
}

fn rounded(pose: &Pose2) -> Pose2 {
    Pose2::new(milli(pose.x), milli(pose.y), milli(pose.yaw))
}

/// The number to a thousandth; never -0.
fn milli(number: f64) -> f64 {
    (1e3 * number).round() / 1e3 + 0.0
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;

    fn edge(from: usize, to: usize, kind: EdgeKind) -> Edge {
        Edge {
            from,
            to,
            measurement: Pose2::IDENTITY,
            information: Matrix3::identity(),
            kind,
        }
    }

    #[test]
    fn a_small_graph_is_drawn_as_it_is_with_closures_first() {
        let poses = [
            Pose2::IDENTITY,
            Pose2::new(1.234_56, -1e-9, 0.5),
            Pose2::new(2.0, 0.0, 1.0),
        ];
        let edges = [
            (edge(0, 1, EdgeKind::Odometry), 1.0),
            (edge(1, 2, EdgeKind::Odometry), 1.0),
            (edge(0, 2, EdgeKind::Closure), 0.0),
        ];
        let (nodes, drawn) = drawn(&poses, edges.iter().map(|(edge, weight)| (edge, *weight)));
        assert_eq!(nodes[1], Pose2::new(1.235, 0.0, 0.5));
        assert!(nodes[1].y.is_sign_positive());
        let told: Vec<_> = drawn
            .iter()
            .map(|edge| (edge.from, edge.to, edge.is_rejected()))
            .collect();
        assert_eq!(told, [(0, 2, true), (0, 1, false), (1, 2, false)]);
    }

    #[test]
    fn of_a_large_graph_the_shape_and_all_closures_are_drawn_within_the_limits() {
        let count = 20 * MOST_GRAPH_NODES;
        let poses: Vec<Pose2> = (0..count).map(|node| Pose2::new(0.1 * node as f64, 0.0, 0.0)).collect();
        let steps = (1..count).map(|node| (edge(node - 1, node, EdgeKind::Odometry), 1.0));
        let closures = (0..100).map(|nth| {
            (
                edge(900 * nth, count - 1, EdgeKind::Closure),
                f64::from(u8::from(nth % 2 == 0)),
            )
        });
        let edges: Vec<_> = steps.chain(closures).collect();
        let (nodes, drawn) = drawn(&poses, edges.iter().map(|(edge, weight)| (edge, *weight)));
        assert_eq!((nodes.len(), nodes[1]), (MOST_GRAPH_NODES, poses[20]));
        assert!(drawn.len() <= MOST_GRAPH_EDGES);
        assert!(drawn.iter().all(|edge| (edge.from.max(edge.to) as usize) < nodes.len()));
        let of = |kind| drawn.iter().filter(move |edge| edge.kind == kind);
        assert_eq!(of(GraphEdgeKind::Odometry).count(), MOST_GRAPH_NODES - 1);
        assert_eq!(of(GraphEdgeKind::Closure).count(), 100);
        assert_eq!(of(GraphEdgeKind::Closure).filter(|edge| edge.is_rejected()).count(), 50);
    }
}
