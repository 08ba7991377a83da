//! Back end. The poses that agree best with all odometry and all matches so far.

use std::collections::BTreeMap;

use zenav_pose_graph::{
    DescentSettings, DescentStatus, Edge, EdgeKind, GraphError, PoseGraph, RobustSettings, RobustSolution, Solution,
    SolveError, Uncertain, certify, descend, edge_chi_squared, solve_robust,
};
use zenav_protocol::geometry::Pose2;

use crate::drift::Drift;
use crate::fixes::Factor;
use crate::settings::FrontSettings;
use crate::solve::Settled;
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
    factors: Vec<Factor>,
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

    pub(crate) fn add_factor(&mut self, factor: Factor) {
        self.factors.push(factor);
    }

    pub(crate) fn drop_factors(&mut self) {
        self.factors.clear();
    }

    /// Measurements of nodes in the world.
    pub(crate) fn factors(&self) -> &[Factor] {
        &self.factors
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

    /// Moves the nodes and sets every measurement to agree with the new poses; drops those in the world, which cannot.
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
        self.factors.clear();
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
        kept.factors = std::mem::take(&mut self.factors);
        *self = kept;
        Ok(())
    }

    /// [`settle`]s this graph.
    pub(crate) fn settle(&mut self, descent: &DescentSettings, robust: &RobustSettings) -> Result<(), GraphError> {
        settle(&mut self.graph, &mut self.weights, descent, robust)
    }

    /// Adopts the result of a solve that was begun with the first nodes and edges of this graph; later nodes move with the last of these.
    /// Returns how that one moved, `new_from_old`.
    pub(crate) fn adopt(&mut self, settled: &Settled) -> Result<Pose2, GraphError> {
        let (before, mut poses) = (self.graph.poses(), settled.poses().to_vec());
        let known = poses.len();
        let last = poses.last().zip(before.get(known.wrapping_sub(1)));
        let new_from_old = last.map_or(Pose2::IDENTITY, |(new, old)| *new * old.inverse());
        poses.extend(before.iter().skip(known).map(|pose| new_from_old * *pose));
        self.graph.set_poses(&poses)?;
        for (weight, decided) in self.weights.iter_mut().zip(settled.weights()) {
            *weight = *decided;
        }
        for (factor, decided) in self.factors.iter_mut().zip(settled.factor_weights()) {
            factor.weight = *decided;
        }
        Ok(new_from_old)
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

/// Moves the nodes of a graph to their optimum; switches closures off that do not fit, and back on if they do.
pub(crate) fn settle(
    graph: &mut PoseGraph,
    weights: &mut Vec<f64>,
    descent: &DescentSettings,
    robust: &RobustSettings,
) -> Result<(), GraphError> {
    let start = graph.poses().to_vec();
    for round in 0..=ROUNDS {
        let end = descend(graph, graph.poses(), weights, descent);
        if end.status == DescentStatus::Singular {
            return Ok(());
        }
        let fits = |edge: &Edge| {
            let is_trusted = edge.kind == EdgeKind::Odometry;
            is_trusted || edge_chi_squared(edge, &end.poses) <= robust.max_chi_squared
        };
        let decided = graph.edges().iter().map(|edge| f64::from(u8::from(fits(edge))));
        let decided: Vec<f64> = decided.collect();
        // The last round decides nothing: poses and weights belong together.
        if decided == *weights || round == ROUNDS {
            return graph.set_poses(&end.poses);
        }
        // What a false measurement has bent is not straight again after the few steps of a round.
        let is_bent = decided.iter().zip(weights.iter()).any(|(now, before)| now < before);
        graph.set_poses(if is_bent { &start } else { &end.poses })?;
        *weights = decided;
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use nalgebra::Matrix3;

    use super::*;

    #[test]
    fn closures_that_change_sides_in_every_round_leave_no_pose_unsolved() {
        // Where they see the second node, m, and their information, 1/m²: in the fourth round one is still switched off.
        let closures = [
            (18.8, 0.55),
            (-0.6, 3.02),
            (9.0, 0.92),
            (16.7, 0.48),
            (12.8, 0.68),
            (-2.1, 0.2),
        ];
        let mut graph = PoseGraph::new();
        for x in [0.0, -5.0] {
            graph.add_node(Pose2::new(x, 0.0, 0.0)).unwrap();
        }
        let mut add = |x: f64, information: f64, kind: EdgeKind| {
            let edge = Edge {
                from: 0,
                to: 1,
                measurement: Pose2::new(x, 0.0, 0.0),
                information: Matrix3::from_diagonal(&[information, 1.0, 1.0].into()),
                kind,
            };
            graph.add_edge(edge).unwrap();
        };
        add(0.0, 0.01, EdgeKind::Odometry);
        for (x, information) in closures {
            add(x, information, EdgeKind::Closure);
        }
        let mut weights = vec![1.0; graph.edges().len()];
        settle(
            &mut graph,
            &mut weights,
            &DescentSettings::default(),
            &RobustSettings::default(),
        )
        .unwrap();
        let counted = || graph.edges().iter().zip(&weights);
        let information: f64 = counted().map(|(edge, weight)| weight * edge.information[(0, 0)]).sum();
        let moment = counted().map(|(edge, weight)| weight * edge.information[(0, 0)] * edge.measurement.x);
        let mean = moment.sum::<f64>() / information;
        let at = graph.poses()[0].inverse() * graph.poses()[1];
        assert!(
            (at.x - mean).abs() < 1e-3,
            "at {} m, the mean is {mean} m, {weights:?}",
            at.x
        );
    }
}
