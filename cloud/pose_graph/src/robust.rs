//! Robust closures. Separates false loop closures from true ones, and finds the poses that agree with the true ones.
//!
//! Truncated least squares: a true closure costs its chi squared, a false one a constant. This cost has many valleys, so the solver starts
//! with a nearly convex cost and approaches the truncated one in rounds (Yang et al., "Graduated non-convexity for robust spatial
//! perception", RA-L 2020), using the closures that have support. From there on all closures are weighed by the evidence for them.

use zenav_protocol::geometry::Pose2;

use crate::chance::Chance;
use crate::consistency::{Cycle, for_each_cycle};
use crate::descent::{descend, edge_chi_squared};
use crate::evidence::{Weighing, drop_worst};
use crate::graph::{Edge, EdgeKind, PoseGraph};
use crate::settings::{DescentSettings, RobustSettings};
use crate::solver::{Solution, SolveError, solve_weighted};
use crate::start::{chordal_start, odometry_start};

/// A descent between two rounds need not converge fully.
const BETWEEN_ROUNDS: DescentSettings = DescentSettings {
    max_iterations: 6,
    tolerance: 1e-4,
};
/// Pairs of closures agree if at most this many false ones may be expected to agree as well.
const CHANCE_OF_SUPPORT: f64 = 0.1;

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
/// Odometry edges are trusted and must connect the graph. A closure is accepted if it lies within chi squared of what odometry and the other
/// closures foresee, and if at most one in twenty false ones may be expected, in the whole graph, to fit as well. So the more closures are
/// false, and the less the graph knows of a place, the more closures have to agree on it. Those that this leaves open are rejected, and
/// named by [`RobustSolution::doubtful`]. Not told apart: false closures that agree with each other and contradict nothing.
///
/// Cost: some ten descents and some ten thousand sparse solves for thousands of closures.
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
    let odometry = weights.clone();
    let closures: Vec<usize> = (0..edges.len()).filter(|index| weights[*index] == 0.0).collect();
    let pairs = agreeing_pairs(graph, settings);
    let mut candidates: Vec<usize> = pairs.iter().flatten().copied().collect();
    candidates.sort_unstable();
    candidates.dedup();
    if candidates.is_empty() {
        candidates.clone_from(&closures);
    }
    for index in &candidates {
        weights[*index] = 1.0;
    }
    // Without a chordal start odometry leads everywhere.
    let mut poses = chordal_start(graph, &weights).unwrap_or_else(|| odometry_start(graph, &[]));
    let rounds = graduate(graph, &mut poses, &mut weights, &candidates, settings);
    for index in &candidates {
        weights[*index] = f64::from(u8::from(weights[*index] >= 0.5));
    }
    let mut weighing = Weighing::new(graph, settings, &pairs, weights, poses);
    weighing.settle(descent);
    if weighing.is_contested() {
        // From odometry on, short loops first, false closures that agree with each other have no head start.
        let poses = odometry_start(graph, &[]);
        let mut other = Weighing::new(graph, settings, &pairs, odometry, poses);
        other.settle(descent);
        if other.truncated_cost() < weighing.truncated_cost() {
            weighing = other;
        }
    }
    weighing.try_rejected(descent);
    let Weighing { mut weights, poses, .. } = weighing;
    let mut solution = solve_weighted(graph, &weights, &poses, descent)?;
    // Closures that fit in another valley only do not hold: what is returned fits its weights.
    while solution.is_minimum && drop_worst(graph, &mut weights, &solution.poses, settings, &[]) {
        solution = solve_weighted(graph, &weights, &solution.poses, descent)?;
    }
    Ok(RobustSolution {
        solution,
        weights,
        rounds,
    })
}

impl RobustSolution {
    /// The closures that could not be told for certain: rejected ones that would fit within the covariance of the graph, but no better than
    /// false ones do by chance, and accepted ones for which one false closure in two hundred graphs like this may be expected to fit as well.
    /// If one of them was decided wrongly, the poses are others. Ascending indices of edges.
    ///
    /// `graph`, `settings`: those that were solved. Cost: one factorisation, and a sparse solve for each closure.
    ///
    /// ```
    /// use zenav_pose_graph::{DescentSettings, RobustSettings, g2o, solve_robust};
    ///
    /// // Forty metres straight on, a hundred closures that see anything anywhere, and one across all of it, 12 m beside where odometry
    /// // leads: within its uncertainty, and yet it may well be one of the others.
    /// let step = |i: u32| format!("EDGE_SE2 {i} {} 1 0 0 100 0 0 100 0 400\n", i + 1);
    /// let wrong = |i: u32| {
    ///     let (x, y) = (f64::from(i * 7 % 13) - 20.0, f64::from(i * 5 % 11) - 5.0);
    ///     format!("EDGE_SE2 {} {} {x} {y} 2 100 0 0 100 0 400\n", i % 20, 20 + i * 3 % 17)
    /// };
    /// let text = (0..40).map(step).chain((0..100).map(wrong)).collect::<String>() + "EDGE_SE2 0 40 40 12 0 100 0 0 100 0 400\n";
    /// let (graph, settings) = (g2o::read(&text)?.graph, RobustSettings::default());
    /// let robust = solve_robust(&graph, &DescentSettings::default(), &settings)?;
    /// assert_eq!(robust.doubtful(&graph, &settings), [140]);
    /// assert_eq!(robust.weights[140], 0.0);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn doubtful(&self, graph: &PoseGraph, settings: &RobustSettings) -> Vec<usize> {
        let (weights, poses) = (self.weights.clone(), self.solution.poses.clone());
        if weights.len() != graph.edges().len() || poses.len() != graph.poses().len() {
            return Vec::new();
        }
        Weighing::new(graph, settings, &[], weights, poses).doubtful()
    }
}

/// Pairs of closures that agree around a short cycle, better than false ones do by chance; one that agrees with odometry alone is a pair
/// with itself.
fn agreeing_pairs(graph: &PoseGraph, settings: &RobustSettings) -> Vec<[usize; 2]> {
    let (mut closed, mut misses) = (Vec::new(), Vec::new());
    for_each_cycle(graph, settings.window, |cycle| {
        if cycle.end.chi_squared() <= settings.max_chi_squared {
            closed.push(cycle);
        } else {
            misses.push(cycle.end.pose.x.hypot(cycle.end.pose.y));
        }
    });
    let chance = Chance::of(misses);
    let is_no_chance = |Cycle { end, .. }: &&Cycle| {
        let information = end.covariance.try_inverse().unwrap_or_default();
        chance.expected(end.chi_squared(), &information) <= CHANCE_OF_SUPPORT
    };
    closed.iter().filter(is_no_chance).map(|cycle| cycle.closures).collect()
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
