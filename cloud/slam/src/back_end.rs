//! Back end. The poses that agree best with all odometry and all matches so far.

use std::collections::BTreeMap;

use zenav_pose_graph::{
    DescentSettings, DescentStatus, Edge, EdgeKind, GraphError, PoseGraph, RobustSettings, RobustSolution, Solution,
    SolveError, Uncertain, certify, descend, edge_chi_squared, solve_robust,
};
use zenav_protocol::geometry::Pose2;

use crate::drift::Drift;
use crate::settings::FrontSettings;
use crate::step::SlamError;

/// Most rounds of switching closures on or off each time the graph is settled.
const ROUNDS: usize = 4;

/// The graph of all inserted scans.
#[derive(Clone, Debug, Default)]
pub(crate) struct BackEnd {
    graph: PoseGraph,
    weights: Vec<f64>,
    /// Which edges are matches of a finish: the next finish replaces them.
    is_final: Vec<bool>,
    drift: Drift,
}

impl BackEnd {
    pub(crate) fn add_node(&mut self, map_from_node: Pose2) -> Result<usize, GraphError> {
        self.graph.add_node(map_from_node)
    }

    pub(crate) fn add_edge(&mut self, edge: Edge) -> Result<(), GraphError> {
        self.add_weighted(edge, 1.0, false)
    }

    /// Adds an edge with a weight; `is_final`: a match of a finish.
    pub(crate) fn add_weighted(&mut self, edge: Edge, weight: f64, is_final: bool) -> Result<(), GraphError> {
        self.graph.add_edge(edge)?;
        self.weights.push(weight);
        self.is_final.push(is_final);
        Ok(())
    }

    /// All edges, each with its weight and whether it is a match of a finish.
    pub(crate) fn edges(&self) -> impl Iterator<Item = (&Edge, f64, bool)> {
        let flags = self.weights.iter().zip(&self.is_final);
        let edges = self.graph.edges().iter().zip(flags);
        edges.map(|(edge, (weight, is_final))| (edge, *weight, *is_final))
    }

    pub(crate) fn graph(&self) -> &PoseGraph {
        &self.graph
    }

    pub(crate) fn weights(&self) -> &[f64] {
        &self.weights
    }

    pub(crate) fn is_final(&self) -> &[bool] {
        &self.is_final
    }

    /// `map_from_node` of all nodes.
    pub(crate) fn poses(&self) -> &[Pose2] {
        self.graph.poses()
    }

    /// The last node relative to the submaps that begin at `anchors`, `anchor_from_node`, for those in which its position is known to
    /// within a standard deviation of `limit`, m.
    pub(crate) fn as_seen_from(
        &mut self,
        anchors: &[usize],
        front: &FrontSettings,
        limit: f64,
    ) -> BTreeMap<usize, Uncertain> {
        let edges = self.graph.edges().iter().zip(self.is_final.iter().copied());
        self.drift.update(edges, self.graph.poses().len(), anchors, front);
        self.drift.of_last_node(&self.weights, limit)
    }

    /// Moves the nodes and sets every measurement to agree with the new poses.
    pub(crate) fn bend(&mut self, bend: impl Fn(Pose2) -> Pose2) -> Result<(), GraphError> {
        let poses: Vec<Pose2> = self.graph.poses().iter().map(|pose| bend(*pose)).collect();
        let mut graph = PoseGraph::new();
        for pose in &poses {
            graph.add_node(*pose)?;
        }
        for edge in self.graph.edges() {
            graph.add_edge(Edge {
                measurement: poses[edge.from].inverse() * poses[edge.to],
                ..*edge
            })?;
        }
        self.graph = graph;
        Ok(())
    }

    /// Drops the matches of a finish.
    pub(crate) fn drop_final(&mut self) -> Result<(), GraphError> {
        let mut kept = Self::default();
        for pose in self.graph.poses() {
            kept.add_node(*pose)?;
        }
        for (edge, weight, _) in self.edges().filter(|(_, _, is_final)| !is_final) {
            kept.add_weighted(*edge, weight, false)?;
        }
        *self = kept;
        Ok(())
    }

    /// Moves the nodes to their optimum; switches closures off that do not fit, and back on if they do.
    pub(crate) fn settle(&mut self, descent: &DescentSettings, robust: &RobustSettings) -> Result<(), GraphError> {
        for _ in 0..ROUNDS {
            let end = descend(&self.graph, self.graph.poses(), &self.weights, descent);
            if end.status == DescentStatus::Singular {
                return Ok(());
            }
            self.graph.set_poses(&end.poses)?;
            let fits = |edge: &Edge| {
                let is_trusted = edge.kind == EdgeKind::Odometry;
                is_trusted || edge_chi_squared(edge, &end.poses) <= robust.max_chi_squared
            };
            let weights: Vec<f64> = self
                .graph
                .edges()
                .iter()
                .map(|edge| f64::from(u8::from(fits(edge))))
                .collect();
            if weights == self.weights {
                break;
            }
            self.weights = weights;
        }
        Ok(())
    }

    /// Decides on all closures again, from scratch, and moves the nodes.
    pub(crate) fn solve(
        &mut self,
        descent: &DescentSettings,
        robust: &RobustSettings,
    ) -> Result<RobustSolution, SlamError> {
        let solved = solve_robust(&self.graph, descent, robust)?;
        self.weights.clone_from(&solved.weights);
        self.graph.set_poses(&solved.solution.poses)?;
        Ok(solved)
    }

    /// Certifies the present poses with the present weights.
    pub(crate) fn solved(&self, descent: &DescentSettings) -> Result<RobustSolution, SolveError> {
        let end = descend(&self.graph, self.graph.poses(), &self.weights, descent);
        if end.status == DescentStatus::Singular {
            return Err(SolveError::Singular);
        }
        Ok(RobustSolution {
            solution: Solution {
                certificate: certify(&self.graph, &end.poses, &self.weights),
                poses: end.poses,
                chi_squared: end.chi_squared,
                iterations: end.iterations,
                is_minimum: end.status == DescentStatus::Converged,
            },
            weights: self.weights.clone(),
            rounds: 0,
        })
    }
}
