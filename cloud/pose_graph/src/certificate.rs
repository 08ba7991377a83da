//! Certificate of global optimality. Proves, if possible, that no other valley of the cost is better than that of a solution.
//!
//! The dual matrix `S = M - diag(0, λ)` of the isotropic companion (see [`crate`]) always has two null vectors at a stationary point of the
//! cost: moving the whole map, and the solution itself. Both are removed with the rows and columns of the anchor: a Hermitian matrix with a
//! null vector `v` is positive semidefinite exactly if it is so without row and column `k`, provided `vₖ` is not zero. The negative
//! eigenvalues of the rest are counted by the signs of its pivots.

use nalgebra::{Matrix2, Matrix4};
use zenav_protocol::geometry::{Pose2, wrap_angle};

use crate::companion::{self, Isotropic, headings};
use crate::descent::{DescentStatus, Problem};
use crate::graph::PoseGraph;
use crate::linear::{BlockSystem, Pattern};
use crate::settings::DescentSettings;
use crate::start::{Positions, pattern};

/// A gradient of the companion below this share of its terms is zero.
const STATIONARY: f64 = 1e-6;
/// Poses this close to each other, m and rad, are the same solution.
const SAME: f64 = 1e-4;

/// Verdict on a solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Optimality {
    /// Proven: with these weights no arrangement has a lower cost in the companion problem, and that optimum leads to this solution.
    Certified,
    /// The dual matrix has negative eigenvalues: the solution is in the wrong valley, or the measurements are too noisy for the proof.
    Refused,
    /// Descending from the companion's optimum ends elsewhere: another valley of the full problem is equally well founded.
    Elsewhere,
    /// No stationary point was reached, or the graph is not connected: no verdict.
    Unknown,
}

/// The certificate of one solution, and the figures behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Certificate {
    /// The verdict.
    pub optimality: Optimality,
    /// Pivots of the dual matrix that are not positive (each eigenvalue of the complex matrix counts twice).
    pub negative_pivots: usize,
    /// Largest entry of the companion's gradient, as a share of the terms that it sums.
    pub stationarity: f64,
    /// The companion's cost at its stationary point.
    pub companion_cost: f64,
    /// Largest distance between a node here and in the companion's optimum, m.
    pub distance: f64,
    /// Largest difference of a yaw, rad.
    pub turn: f64,
}

/// Certifies poses (one for each node, the anchor where the graph has it) as optimal for these weights (one for each edge, 0 to 1).
///
/// Costs three to eight factorisations: the companion's descent from `poses`, its dual matrix, and the descent back.
///
/// ```
/// use zenav_pose_graph::{Optimality, certify, g2o};
///
/// let text = "EDGE_SE2 0 1 1 0 1.5708 9 0 0 9 0 9\nEDGE_SE2 1 2 1 0 1.5708 9 0 0 9 0 9\nEDGE_SE2 2 0 1 1 3.1416 9 0 0 9 0 9\n";
/// let graph = g2o::read(text)?.graph;
/// let weights = [1.0; 3];
/// let solution = zenav_pose_graph::descend(&graph, graph.poses(), &weights, &Default::default());
/// assert_eq!(certify(&graph, &solution.poses, &weights).optimality, Optimality::Certified);
/// # Ok::<(), zenav_pose_graph::g2o::G2oError>(())
/// ```
#[must_use]
pub fn certify(graph: &PoseGraph, poses: &[Pose2], weights: &[f64]) -> Certificate {
    let fitting = poses.len() == graph.poses().len() && weights.len() == graph.edges().len() && !poses.is_empty();
    let pattern = pattern(graph, weights).filter(|_| fitting && graph.disconnected(weights).is_none());
    let Some(pattern) = pattern else {
        return UNKNOWN;
    };
    let edges = Isotropic::of(graph, weights);
    let Some(positions) = Positions::new(&edges, &pattern) else {
        return UNKNOWN;
    };
    let mut problem = Problem::new(graph, weights, &pattern);
    let Some(optimum) = companion::stationary(&edges, problem.system(), &positions, poses) else {
        return UNKNOWN;
    };
    let certificate = certify_companion(&edges, &pattern, &optimum).with_distance(&optimum, poses);
    if certificate.optimality != Optimality::Certified {
        return certificate;
    }
    let back = problem.descend(&optimum, &DescentSettings::default());
    let (distance, turn) = apart(&back.poses, poses);
    let is_same = back.status == DescentStatus::Converged && distance < SAME && turn < SAME;
    Certificate {
        optimality: if is_same {
            Optimality::Certified
        } else {
            Optimality::Elsewhere
        },
        ..certificate
    }
}

/// The certificate without a verdict.
pub(crate) const UNKNOWN: Certificate = Certificate {
    optimality: Optimality::Unknown,
    negative_pivots: 0,
    stationarity: f64::NAN,
    companion_cost: f64::NAN,
    distance: f64::NAN,
    turn: f64::NAN,
};

impl Certificate {
    /// The same, with the distance of the companion's optimum from `poses`.
    pub(crate) fn with_distance(self, optimum: &[Pose2], poses: &[Pose2]) -> Self {
        let (distance, turn) = apart(optimum, poses);
        Self { distance, turn, ..self }
    }
}

/// Largest distance, m, and largest difference of yaws, rad, between two sets of poses.
fn apart(a: &[Pose2], b: &[Pose2]) -> (f64, f64) {
    let pairs = a.iter().zip(b);
    pairs.fold((0.0, 0.0), |(distance, turn), (a, b)| {
        (a.distance(b).max(distance), wrap_angle(a.yaw - b.yaw).abs().max(turn))
    })
}

/// A complex number as a real matrix.
fn complex(re: f64, im: f64) -> Matrix2<f64> {
    Matrix2::new(re, -im, im, re)
}

/// Adds one entry of complex numbers to a block of four real rows and columns.
fn put(block: &mut Matrix4<f64>, row: usize, column: usize, value: Matrix2<f64>) {
    let mut view = block.fixed_view_mut::<2, 2>(2 * row, 2 * column);
    view += value;
}

/// The verdict on a stationary point of the companion.
pub(crate) fn certify_companion(edges: &[Isotropic], pattern: &Pattern, poses: &[Pose2]) -> Certificate {
    let headings = headings(poses);
    let mut system = BlockSystem::<4>::new(pattern);
    // z̄ᵢ (M x)ᵢ of the rows of rotations, and M x of those of positions; and the size of the terms.
    let mut rows = vec![[0.0; 4]; poses.len()];
    let mut sizes = vec![[0.0; 2]; poses.len()];
    for (pair, edge) in edges.iter().enumerate() {
        let (kappa, tau) = (edge.rotation, edge.translation);
        let ([cos, sin], [to_cos, to_sin]) = (headings[edge.from], headings[edge.to]);
        let square = edge.x * edge.x + edge.y * edge.y;
        let turned = [cos * edge.x - sin * edge.y, sin * edge.x + cos * edge.y];
        let (a, b) = (poses[edge.from], poses[edge.to]);
        let gap = [b.x - a.x - turned[0], b.y - a.y - turned[1]];
        // exp(i δ) of the difference of the yaws beyond the measurement.
        let expected = [cos * edge.cos - sin * edge.sin, sin * edge.cos + cos * edge.sin];
        let turn = [
            expected[0] * to_cos + expected[1] * to_sin,
            expected[0] * to_sin - expected[1] * to_cos,
        ];
        // Rows of positions: τ (tⱼ - tᵢ - zᵢ p); of rotations: κ (zᵢ - r̄ zⱼ) - τ p̄ (…) and κ (zⱼ - r zᵢ), each times z̄.
        let along = [
            gap[0] * turned[0] + gap[1] * turned[1],
            gap[1] * turned[0] - gap[0] * turned[1],
        ];
        rows[edge.from][0] -= tau * gap[0];
        rows[edge.from][1] -= tau * gap[1];
        rows[edge.from][2] += kappa * (1.0 - turn[0]) - tau * along[0];
        rows[edge.from][3] += -kappa * turn[1] - tau * along[1];
        rows[edge.to][0] += tau * gap[0];
        rows[edge.to][1] += tau * gap[1];
        rows[edge.to][2] += kappa * (1.0 - turn[0]);
        rows[edge.to][3] += kappa * turn[1];
        for node in [edge.from, edge.to] {
            sizes[node][0] += tau * (gap[0].abs() + gap[1].abs() + turned[0].abs() + turned[1].abs());
            sizes[node][1] += kappa + tau * square;
        }

        let mut from = Matrix4::zeros();
        put(&mut from, 0, 0, complex(tau, 0.0));
        put(&mut from, 1, 1, complex(kappa + tau * square, 0.0));
        put(&mut from, 0, 1, complex(tau * edge.x, tau * edge.y));
        put(&mut from, 1, 0, complex(tau * edge.x, -tau * edge.y));
        system.add_node(edge.from, &from);
        let mut to = Matrix4::zeros();
        put(&mut to, 0, 0, complex(tau, 0.0));
        put(&mut to, 1, 1, complex(kappa, 0.0));
        system.add_node(edge.to, &to);
        let mut mixed = Matrix4::zeros();
        put(&mut mixed, 0, 0, complex(-tau, 0.0));
        put(&mut mixed, 1, 1, complex(-kappa * edge.cos, kappa * edge.sin));
        put(&mut mixed, 1, 0, complex(-tau * edge.x, tau * edge.y));
        system.add_pair(pair, &mixed);
    }
    let mut stationarity = 0.0_f64;
    for (node, ([x, y, re, im], [plane, turn])) in rows.iter().zip(&sizes).enumerate() {
        let lambda = complex(*re, 0.0);
        let mut multiplier = Matrix4::zeros();
        put(&mut multiplier, 1, 1, -lambda);
        system.add_node(node, &multiplier);
        if node > 0 {
            stationarity = stationarity.max(x.abs().max(y.abs()) / plane.max(f64::MIN_POSITIVE));
            stationarity = stationarity.max(im.abs() / turn.max(f64::MIN_POSITIVE));
        }
    }
    let negative = system.factorise();
    let optimality = match negative {
        Some(0) if stationarity < STATIONARY => Optimality::Certified,
        Some(count) if count > 0 => Optimality::Refused,
        _ => Optimality::Unknown,
    };
    Certificate {
        optimality,
        negative_pivots: negative.unwrap_or(0),
        stationarity,
        companion_cost: companion::cost(edges, poses),
        distance: f64::NAN,
        turn: f64::NAN,
    }
}
