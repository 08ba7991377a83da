//! Robust closures. Separates false loop closures from true ones, and finds the poses that agree with the true ones.
//!
//! Truncated least squares: a true closure costs its chi squared, a false one a constant. This cost has many valleys, so the solver starts
//! with a nearly convex cost and approaches the truncated one in rounds (Yang et al., "Graduated non-convexity for robust spatial
//! perception", RA-L 2020), using the closures that have support. A closure without support is accepted if it agrees with the resulting
//! poses, within their covariance.

use nalgebra::{Matrix3, Rotation2, Vector3};
use zenav_protocol::geometry::{Pose2, wrap_angle};

use crate::consistency::supported;
use crate::covariance::{joint, mahalanobis, relative_covariance};
use crate::descent::{Problem, descend, edge_chi_squared};
use crate::graph::{Edge, EdgeKind, PoseGraph};
use crate::settings::{DescentSettings, RobustSettings};
use crate::solver::{Solution, SolveError, solve_weighted};
use crate::start::{chordal_start, odometry_start, pattern};

/// A descent between two rounds need not converge fully.
const BETWEEN_ROUNDS: DescentSettings = DescentSettings {
    max_iterations: 6,
    tolerance: 1e-4,
};
/// Most rounds in which closures still change sides.
const SETTLING_ROUNDS: usize = 20;

/// The best poses with the accepted closures.
#[derive(Clone, Debug, PartialEq)]
pub struct RobustSolution {
    /// The poses, their cost with these weights, and the certificate for these weights.
    pub solution: Solution,
    /// One for each edge: 1 if it counts, 0 for a false closure.
    pub weights: Vec<f64>,
    /// Rounds of growing non-convexity.
    pub rounds: u32,
}

/// Finds the poses that agree best with odometry and with the true closures, and which closures are true.
///
/// Odometry edges are trusted and must connect the graph. Undecidable cases: a lone closure within odometry's own uncertainty, and false
/// closures that agree with each other better than the true ones do.
///
/// ```
/// use zenav_pose_graph::{DescentSettings, RobustSettings, g2o, solve_robust};
///
/// // Five metres straight on, and two closures: one that says so, and one that takes node 4 for node 1.
/// let step = |i: u32| format!("EDGE_SE2 {i} {} 1 0 0 100 0 0 100 0 400\n", i + 1);
/// let closures = "EDGE_SE2 0 5 5 0 0 100 0 0 100 0 400\nEDGE_SE2 1 4 0 0 0 100 0 0 100 0 400\n";
/// let graph = g2o::read(&((0..5).map(step).collect::<String>() + closures))?.graph;
/// let robust = solve_robust(&graph, &DescentSettings::default(), &RobustSettings::default())?;
/// assert_eq!(robust.weights, [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
/// assert!((robust.solution.poses[5].x - 5.0).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// See [`SolveError`]: each variant says what to do.
pub fn solve_robust(
    graph: &PoseGraph,
    descent: &DescentSettings,
    settings: &RobustSettings,
) -> Result<RobustSolution, SolveError> {
    let edges = graph.edges();
    if graph.poses().is_empty() {
        return Err(SolveError::Empty);
    }
    let trusted = |edge: &Edge| if edge.kind == EdgeKind::Odometry { 1.0 } else { 0.0 };
    let mut weights: Vec<f64> = edges.iter().map(trusted).collect();
    if let Some(node) = graph.disconnected(&weights) {
        return Err(SolveError::Disconnected { node });
    }
    let support = supported(graph, settings);
    let closures: Vec<usize> = (0..edges.len()).filter(|index| weights[*index] == 0.0).collect();
    let mut candidates: Vec<usize> = closures.iter().copied().filter(|index| support[*index]).collect();
    if candidates.is_empty() {
        candidates.clone_from(&closures);
    }
    for index in &candidates {
        weights[*index] = 1.0;
    }
    // Without a chordal start odometry leads everywhere.
    let mut poses = chordal_start(graph, &weights).unwrap_or_else(|| odometry_start(graph, &[]));
    let rounds = graduate(graph, &mut poses, &mut weights, &candidates, settings);

    let is_true = |index: &usize, poses: &[Pose2]| edge_chi_squared(&edges[*index], poses) <= settings.max_chi_squared;
    for _ in 0..SETTLING_ROUNDS {
        let before = weights.clone();
        for index in &closures {
            weights[*index] = f64::from(u8::from(is_true(index, &poses)));
        }
        if weights == before {
            // Everything else is settled: try those that may be true given odometry and the other closures.
            for index in plausible(graph, &poses, &weights, &closures, settings) {
                weights[index] = 1.0;
                let trial = descend(graph, &poses, &weights, descent);
                if is_true(&index, &trial.poses) {
                    poses = trial.poses;
                } else {
                    weights[index] = 0.0;
                }
            }
            if weights == before {
                break;
            }
        }
        poses = descend(graph, &poses, &weights, descent).poses;
    }
    let mut solution = solve_weighted(graph, &weights, &poses, descent)?;
    // Closures that change sides in every round, or that fit in another valley only, do not hold: what is returned fits its weights. The
    // worst go first, since they bend the others.
    while solution.is_minimum {
        let misfit = |index: usize| weights[index] * edge_chi_squared(&edges[index], &solution.poses);
        let worst = closures.iter().map(|index| misfit(*index)).fold(0.0, f64::max);
        if worst <= settings.max_chi_squared {
            break;
        }
        let limit = settings.max_chi_squared.max(0.5 * worst);
        let dropped: Vec<usize> = closures
            .iter()
            .copied()
            .filter(|index| misfit(*index) > limit)
            .collect();
        for index in dropped {
            weights[index] = 0.0;
        }
        solution = solve_weighted(graph, &weights, &solution.poses, descent)?;
    }
    Ok(RobustSolution {
        solution,
        weights,
        rounds,
    })
}

/// Rounds from nearly convex to truncated; returns their number. Poses and weights end as the last round leaves them.
fn graduate(
    graph: &PoseGraph,
    poses: &mut Vec<Pose2>,
    weights: &mut [f64],
    candidates: &[usize],
    settings: &RobustSettings,
) -> u32 {
    let limit = settings.max_chi_squared;
    let residuals = |poses: &[Pose2]| -> Vec<f64> {
        let all = candidates
            .iter()
            .map(|index| edge_chi_squared(&graph.edges()[*index], poses));
        all.collect()
    };
    *poses = descend(graph, poses, weights, &BETWEEN_ROUNDS).poses;
    let mut now = residuals(poses);
    let worst = now.iter().copied().fold(0.0, f64::max);
    if worst <= limit {
        return 0;
    }
    let mut control = limit / (2.0 * worst - limit);
    for round in 1..=settings.max_rounds {
        let mut is_binary = true;
        for (index, chi_squared) in candidates.iter().zip(&now) {
            let weight = truncated_weight(*chi_squared, limit, control);
            is_binary &= weight == 0.0 || weight == 1.0;
            weights[*index] = weight;
        }
        *poses = descend(graph, poses, weights, &BETWEEN_ROUNDS).poses;
        if is_binary {
            return round;
        }
        now = residuals(poses);
        control *= settings.step;
    }
    settings.max_rounds
}

/// The weight of an edge in a round: equation 14 of Yang et al.
fn truncated_weight(chi_squared: f64, limit: f64, control: f64) -> f64 {
    if chi_squared >= limit * (control + 1.0) / control {
        0.0
    } else if chi_squared <= limit * control / (control + 1.0) {
        1.0
    } else {
        ((limit * control * (control + 1.0) / chi_squared).sqrt() - control).clamp(0.0, 1.0)
    }
}

/// Difference between the poses and a measurement, m, m, rad, in the frame of its first node.
fn gap(edge: &Edge, poses: &[Pose2]) -> Vector3<f64> {
    let seen = poses[edge.from].inverse() * poses[edge.to];
    let Pose2 { x, y, yaw } = edge.measurement;
    Vector3::new(seen.x - x, seen.y - y, wrap_angle(seen.yaw - yaw))
}

/// The closures of weight 0 that agree with the others within the covariance between their ends, smallest gap first: chi squared would put
/// precise measurements last.
fn plausible(
    graph: &PoseGraph,
    poses: &[Pose2],
    weights: &[f64],
    closures: &[usize],
    settings: &RobustSettings,
) -> Vec<usize> {
    let edges = graph.edges();
    let mut asked: Vec<(f64, usize)> = closures
        .iter()
        .filter(|index| weights[**index] == 0.0)
        .map(|index| (gap(&edges[*index], poses).norm(), *index))
        .collect();
    asked.sort_by(|a, b| a.0.total_cmp(&b.0));
    asked.truncate(settings.reconsidered as usize);
    let Some(pattern) = pattern(graph, weights).filter(|_| !asked.is_empty()) else {
        return Vec::new();
    };
    let Some(mut system) = Problem::new(graph, weights, &pattern).factorised(poses) else {
        return Vec::new();
    };
    asked.retain(|(_, index)| {
        let edge = &edges[*index];
        let both = joint(&mut system, poses.len(), &[edge.from, edge.to]);
        let turn = Rotation2::new(edge.measurement.yaw).to_homogeneous();
        let least = Matrix3::identity() * (f64::EPSILON * edge.information.amax());
        let own = (edge.information + least).try_inverse().unwrap_or_default();
        let covariance = relative_covariance(&both, poses[edge.from], poses[edge.to]) + turn * own * turn.transpose();
        mahalanobis(&gap(edge, poses), &covariance) <= settings.max_chi_squared
    });
    asked.into_iter().map(|(_, index)| index).collect()
}
