//! Marginal covariance. Uncertainty of a node, and of one node relative to another.

use nalgebra::{DMatrix, Matrix3, Vector3};
use zenav_protocol::geometry::Pose2;

use crate::descent::Problem;
use crate::graph::PoseGraph;
use crate::linear::BlockSystem;
use crate::start::pattern;

/// Joint covariance of chosen nodes at a solution, given the anchor: 3k x 3k for k nodes, in order, x, y (m², map frame) and yaw (rad²).
///
/// `poses`: one for each node; `weights`: one for each edge. `None` if a node does not exist or is not constrained by the graph. The
/// anchor's rows are zero. Cost: one factorisation, then three solves for each node.
///
/// ```
/// use zenav_pose_graph::{g2o, marginal_covariance};
///
/// // Two steps of 1 m, standard deviations of 0.1 m and 0.05 rad.
/// let text = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2 1 2 1 0 0 100 0 0 100 0 400\n";
/// let graph = g2o::read(text)?.graph;
/// let covariance = marginal_covariance(&graph, graph.poses(), &[1.0; 2], &[2]).unwrap();
/// assert!((covariance[(0, 0)] - 2.0 * 0.1_f64.powi(2)).abs() < 1e-9);
/// // Across, the turn of the first step swings the second.
/// assert!((covariance[(1, 1)] - (2.0 * 0.1_f64.powi(2) + 0.05_f64.powi(2))).abs() < 1e-9);
/// assert!(marginal_covariance(&graph, graph.poses(), &[1.0; 2], &[3]).is_none());
/// # Ok::<(), g2o::G2oError>(())
/// ```
#[must_use]
pub fn marginal_covariance(
    graph: &PoseGraph,
    poses: &[Pose2],
    weights: &[f64],
    nodes: &[usize],
) -> Option<DMatrix<f64>> {
    let fitting = poses.len() == graph.poses().len() && weights.len() == graph.edges().len();
    if !fitting || nodes.iter().any(|node| *node >= poses.len()) || graph.disconnected(weights).is_some() {
        return None;
    }
    let pattern = pattern(graph, weights)?;
    let system = Problem::new(graph, weights, &pattern).factorised(poses)?;
    Some(joint(&system, poses.len(), nodes))
}

/// [`marginal_covariance`] from a factorised system over `count` nodes.
pub(crate) fn joint(system: &BlockSystem<'_, 3>, count: usize, nodes: &[usize]) -> DMatrix<f64> {
    let mut covariance = DMatrix::zeros(3 * nodes.len(), 3 * nodes.len());
    for (column, node) in nodes.iter().enumerate() {
        for part in 0..3 {
            let mut unit = vec![[0.0; 3]; count];
            unit[*node][part] = 1.0;
            system.solve(&mut unit);
            for (row, other) in nodes.iter().enumerate() {
                for inner in 0..3 {
                    covariance[(3 * row + inner, 3 * column + part)] = unit[*other][inner];
                }
            }
        }
    }
    covariance
}

/// Covariance of `to` relative to `from`, x, y (m², in the frame of `from`) and yaw (rad²), from their joint covariance of 6 x 6 (`from`
/// first) as returned by [`marginal_covariance`].
///
/// ```
/// # use zenav_pose_graph::{g2o, marginal_covariance, relative_covariance};
/// # let step = |i: u32| format!("EDGE_SE2 {i} {} 1 0 0 100 0 0 100 0 400\n", i + 1);
/// # let graph = g2o::read(&(0..9).map(step).collect::<String>())?.graph;
/// // Far from the anchor, two neighbours are known to each other as well as their step was measured: 0.1 m and 0.05 rad.
/// let (poses, weights) = (graph.poses(), [1.0; 9]);
/// let joint = marginal_covariance(&graph, poses, &weights, &[8, 9]).unwrap();
/// let step = relative_covariance(&joint, poses[8], poses[9]);
/// assert!(joint[(0, 0)] > 0.079 && (step[(0, 0)] - 0.01).abs() < 1e-9);
/// assert!((step[(2, 2)] - 0.0025).abs() < 1e-9);
/// # Ok::<(), g2o::G2oError>(())
/// ```
///
/// # Panics
/// When `joint` is smaller than 6 x 6.
#[must_use]
pub fn relative_covariance(joint: &DMatrix<f64>, from: Pose2, to: Pose2) -> Matrix3<f64> {
    let (sin, cos) = from.yaw.sin_cos();
    let seen = from.inverse() * to;
    let by_from = Matrix3::new(-cos, -sin, seen.y, sin, -cos, -seen.x, 0.0, 0.0, -1.0);
    let by_to = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
    let block = |row, column| joint.fixed_view::<3, 3>(row, column).into_owned();
    let mixed = by_from * block(0, 3) * by_to.transpose();
    by_from * block(0, 0) * by_from.transpose() + by_to * block(3, 3) * by_to.transpose() + mixed + mixed.transpose()
}

/// Squared Mahalanobis distance of a vector; infinite if the covariance cannot be inverted.
pub(crate) fn mahalanobis(vector: &Vector3<f64>, covariance: &Matrix3<f64>) -> f64 {
    let solved = covariance.cholesky().map(|factor| factor.solve(vector));
    solved.map_or(f64::INFINITY, |solved| vector.dot(&solved))
}
