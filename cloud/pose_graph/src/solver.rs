//! Solver. Finds and certifies the poses that agree best with all measurements.

use thiserror::Error;
use zenav_protocol::geometry::Pose2;

use crate::certificate::{Certificate, Optimality, UNKNOWN, certify_companion};
use crate::companion::{self, Isotropic};
use crate::descent::{Descent, DescentStatus, Problem};
use crate::graph::PoseGraph;
use crate::linear::Pattern;
use crate::settings::DescentSettings;
use crate::start::{Positions, chordal, pattern};

/// The best poses, with their certificate.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// `map_from_node` of each node; the anchor is where the graph has it.
    pub poses: Vec<Pose2>,
    /// Weighted sum of chi squared over the edges.
    pub chi_squared: f64,
    /// Steps of the last descent.
    pub iterations: u32,
    /// Whether the descent ended at a minimum; otherwise the poses are the best that were reached, and nothing is certified.
    pub is_minimum: bool,
    /// Whether there is no better valley.
    pub certificate: Certificate,
}

/// Why a graph has no solution.
///
/// ```
/// use zenav_pose_graph::{DescentSettings, PoseGraph, SolveError, solve};
/// use zenav_protocol::geometry::Pose2;
///
/// let mut graph = PoseGraph::new();
/// assert_eq!(solve(&graph, &DescentSettings::default()), Err(SolveError::Empty));
/// for x in [0.0, 1.0] {
///     graph.add_node(Pose2::new(x, 0.0, 0.0))?;
/// }
/// // Nothing was measured between the two.
/// assert_eq!(solve(&graph, &DescentSettings::default()), Err(SolveError::Disconnected { node: 1 }));
/// # Ok::<(), zenav_pose_graph::GraphError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum SolveError {
    /// There is no node.
    #[error("the graph has no nodes")]
    Empty,
    /// No chain of measurements (for robust solving: of odometry) connects a node to the anchor: solve the parts separately.
    #[error("node {node} is not joined to the anchor")]
    Disconnected {
        /// Index of the first such node.
        node: usize,
    },
    /// Information matrices do not constrain a direction of a node, or differ too much in size for the arithmetic.
    #[error("the measurements leave a node free, or their information matrices lie too far apart")]
    Singular,
}

/// Why a solution has no verdict.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Unknown {
    /// Steps ran out: raise `max_iterations`.
    #[error("no minimum within {0} iterations: the poses are the best that were reached")]
    NoMinimum(u32),
    /// The companion has no stationary point accurate enough for the proof: its gradient as a share of its terms.
    #[error("the companion problem is not stationary: {0:e}")]
    NotStationary(f64),
}

/// Finds the poses that agree best with all edges, each with weight 1, and certifies them.
///
/// If steps run out, the best poses are returned nevertheless: see [`Solution::unknown_because`]. Starts from the chordal relaxation and,
/// if that ends without a certificate, also from the graph's own poses; returns the certified or else the cheaper of the two. Cost: about
/// six sparse factorisations.
///
/// ```
/// use zenav_pose_graph::{DescentSettings, Optimality, g2o, solve};
/// use zenav_protocol::geometry::Pose2;
///
/// // Around a square of 1 m; each corner was measured as 1.6 rad, 0.03 too much.
/// let corner = |i: u32| format!("EDGE_SE2 {i} {} 1 0 1.6 100 0 0 100 0 400\n", (i + 1) % 4);
/// let graph = g2o::read(&(0..4).map(corner).collect::<String>())?.graph;
/// let solution = solve(&graph, &DescentSettings::default())?;
/// assert!(solution.poses[3].distance(&Pose2::new(0.0, 1.0, 0.0)) < 1e-3);
/// assert_eq!(solution.certificate.optimality, Optimality::Certified);
/// assert_eq!(solution.unknown_because(), None);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// See [`SolveError`]: each variant says what to do.
pub fn solve(graph: &PoseGraph, settings: &DescentSettings) -> Result<Solution, SolveError> {
    solve_weighted(graph, &vec![1.0; graph.edges().len()], graph.poses(), settings)
}

/// [`solve()`] with weights, and with another start beside the chordal one.
pub(crate) fn solve_weighted(
    graph: &PoseGraph,
    weights: &[f64],
    other_start: &[Pose2],
    settings: &DescentSettings,
) -> Result<Solution, SolveError> {
    if graph.poses().is_empty() {
        return Err(SolveError::Empty);
    }
    if let Some(node) = graph.disconnected(weights) {
        return Err(SolveError::Disconnected { node });
    }
    let pattern = pattern(graph, weights).ok_or(SolveError::Singular)?;
    let edges = Isotropic::of(graph, weights);
    let positions = Positions::new(&edges, &pattern).ok_or(SolveError::Singular)?;
    let mut problem = Problem::new(graph, weights, &pattern);
    let mut from = |start: &[Pose2]| solve_from(&mut problem, &edges, &pattern, &positions, start, settings);
    let from_chordal = chordal(graph.poses(), &edges, &pattern, &positions)
        .ok_or(SolveError::Singular)
        .and_then(|start| from(&start));
    if let Ok(solution) = &from_chordal
        && solution.certificate.optimality == Optimality::Certified
    {
        return from_chordal;
    }
    let from_other = from(other_start);
    match (from_chordal, from_other) {
        (Ok(a), Ok(b)) => {
            let is_better = b.certificate.optimality == Optimality::Certified || b.chi_squared < a.chi_squared;
            Ok(if is_better { b } else { a })
        }
        (Ok(one), Err(_)) | (Err(_), Ok(one)) => Ok(one),
        (Err(error), Err(_)) => Err(error),
    }
}

/// Companion, certificate and descent from one start.
fn solve_from<'p>(
    problem: &mut Problem<'p>,
    edges: &[Isotropic],
    pattern: &Pattern,
    positions: &Positions<'p>,
    start: &[Pose2],
    settings: &DescentSettings,
) -> Result<Solution, SolveError> {
    let optimum = companion::stationary(edges, problem.system(), positions, start);
    let certificate = match &optimum {
        Some(optimum) => certify_companion(edges, pattern, optimum),
        None => UNKNOWN,
    };
    let optimum = optimum.as_deref().unwrap_or(start);
    let Descent {
        poses,
        chi_squared,
        iterations,
        status,
    } = problem.descend(optimum, settings);
    let is_minimum = status == DescentStatus::Converged;
    // Of a cost beyond all numbers any poses are the minimum.
    if status == DescentStatus::Singular || !chi_squared.is_finite() {
        return Err(SolveError::Singular);
    }
    let certificate = if is_minimum { certificate } else { UNKNOWN };
    Ok(Solution {
        certificate: certificate.with_distance(optimum, &poses),
        poses,
        chi_squared,
        iterations,
        is_minimum,
    })
}

impl Solution {
    /// Why the solution has no verdict, if so.
    #[must_use]
    pub fn unknown_because(&self) -> Option<Unknown> {
        match self.certificate.optimality {
            Optimality::Unknown if !self.is_minimum => Some(Unknown::NoMinimum(self.iterations)),
            Optimality::Unknown => Some(Unknown::NotStationary(self.certificate.stationarity)),
            _ => None,
        }
    }
}
