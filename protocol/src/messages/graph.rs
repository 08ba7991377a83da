//! Pose graph. Which poses and measurements does SLAM's map rest on? For pictures.

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::MapRef;
use crate::geometry::Pose2;
use crate::time::Stamp;

/// Most nodes in a message: a larger graph is thinned out.
pub const MOST_GRAPH_NODES: usize = 5_000;
/// Most edges in a message, closures first.
pub const MOST_GRAPH_EDGES: usize = 20_000;

/// SLAM's pose graph, thinned out and rounded to millimetres and milliradians. Published when it has changed, at most once a second, and
/// without nodes for a map that has none yet.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PoseGraph {
    /// Stamp of the newest scan in the graph, on the robot's clock.
    pub stamp: Stamp,
    /// Boot that the stamp belongs to.
    pub boot_id: String,
    /// The map, and the frame that the poses are in.
    pub map: MapRef,
    /// Whether no other arrangement of the nodes is better.
    #[serde(default, skip_serializing_if = "GraphCertificate::is_not_solved")]
    pub certificate: GraphCertificate,
    /// Poses of the nodes, `map_from_node`, in the order of the drive.
    pub nodes: Vec<Pose2>,
    /// Measurements between nodes.
    pub edges: Vec<GraphEdge>,
}

/// Verdict on the last solve of a pose graph, which closures lead to: with the closures that it accepted, is no other arrangement of its
/// nodes better? It does not say whether these closures are true.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum GraphCertificate {
    /// There was no solve since mapping began or resumed a stored session: the nodes are where they were then, or where odometry and
    /// matches have put them.
    #[default]
    NotSolved,
    /// The proof is still being computed.
    Pending,
    /// Proven: no other arrangement is better. Each node is within 1 cm and 2 mrad of the proven one.
    Certified,
    /// There is no proof: the solve ended in the wrong valley, or the measurements are too noisy.
    Refused,
    /// The optimum of the problem that can be certified leads to another valley.
    Elsewhere,
    /// The solve did not converge well enough for a verdict.
    Unknown,
}

impl GraphCertificate {
    fn is_not_solved(&self) -> bool {
        *self == Self::NotSolved
    }
}

/// A measurement between two nodes of a pose graph.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GraphEdge {
    /// Index of the node from which the measurement is taken.
    pub from: u32,
    /// Index of the measured node.
    pub to: u32,
    /// Its origin.
    pub kind: GraphEdgeKind,
    /// Its weight in the solution, 0 to 1: 0 for a closure that is held to be false.
    pub weight: f64,
}

/// Origin of a measurement in a pose graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum GraphEdgeKind {
    /// Odometry, or a match between neighbours: trusted.
    Odometry,
    /// A recognised place: may be false.
    Closure,
}

impl GraphEdge {
    /// Whether the measurement is a closure that is held to be false.
    #[must_use]
    pub fn is_rejected(&self) -> bool {
        self.kind == GraphEdgeKind::Closure && self.weight <= 0.0
    }
}

impl PoseGraph {
    /// Each edge with the positions of its ends, map frame, m. Edges to nodes that do not exist are left out.
    pub fn lines(&self) -> impl Iterator<Item = (&GraphEdge, [Point2<f64>; 2])> {
        let at = |node: u32| Some(self.nodes.get(node as usize)?.position());
        let ends = move |edge: &GraphEdge| Some([at(edge.from)?, at(edge.to)?]);
        self.edges.iter().filter_map(move |edge| Some((edge, ends(edge)?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_to_a_node_that_does_not_exist_is_not_drawn() {
        let edge = |from, to| GraphEdge {
            from,
            to,
            kind: GraphEdgeKind::Closure,
            weight: 0.0,
        };
        let graph = PoseGraph {
            nodes: vec![Pose2::IDENTITY, Pose2::new(1.0, 2.0, 0.5)],
            edges: vec![edge(0, 2), edge(1, 0), edge(u32::MAX, 0)],
            ..PoseGraph::default()
        };
        let lines: Vec<_> = graph.lines().collect();
        assert_eq!(lines, [(&edge(1, 0), [Point2::new(1.0, 2.0), Point2::origin()])]);
        assert!(lines[0].0.is_rejected());
    }
}
