//! Descent. Minimises the cost of the measurements from a start.
//!
//! Gauss-Newton steps; when one leads uphill, Levenberg-Marquardt damping, adapted to the ratio of achieved and predicted decrease
//! (Nielsen, "Damping parameter in Marquardt's method", 1999). Near the minimum one factorisation serves several steps: the gradient is
//! always exact, so reuse costs speed, not accuracy.

use nalgebra::{Matrix3, Vector3};
use zenav_protocol::geometry::{Pose2, wrap_angle};

use crate::companion::moved;
use crate::graph::{Edge, PoseGraph};
use crate::linear::{BlockSystem, Pattern};
use crate::settings::DescentSettings;
use crate::start::pattern;

/// First damping, as a share of the diagonal.
const FIRST_DAMPING: f64 = 1e-4;
/// Growth factor of the damping, doubled each time in a row, and the smallest factor by which a good step reduces it.
const DAMPING_GROWS: f64 = 2.0;
const DAMPING_LEFT: f64 = 0.1;
/// Smaller damping is zero: the longest waves of a chain of ten thousand nodes have this stiffness relative to the diagonal.
const LEAST_DAMPING: f64 = 1e-9;
/// Beyond this damping no step leads downhill except by rounding.
const MOST_DAMPING: f64 = 1e10;
/// Share of a cost that is rounding.
const ROUNDING: f64 = 1e-14;
/// A negligible chi squared, for costs that are zero up to rounding.
const NEGLIGIBLE: f64 = 1e-14;
/// Largest turn of a step after which the previous factors are good enough, rad.
const SAME_FACTORS: f64 = 0.2;
/// Steps with old factors must predict at most this share of the previous step's decrease.
const SHRINK: f64 = 0.1;

/// How a descent ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescentStatus {
    /// The next step would change nothing relevant.
    Converged,
    /// Steps ran out: start closer, or allow more.
    OutOfIterations,
    /// The graph is not connected, or its numbers differ too much in size: the start is returned.
    Singular,
}

/// A descent and its end point.
#[derive(Clone, Debug, PartialEq)]
pub struct Descent {
    /// `map_from_node` of each node.
    pub poses: Vec<Pose2>,
    /// Weighted sum of chi squared over the edges.
    pub chi_squared: f64,
    /// Steps taken.
    pub iterations: u32,
    /// How it ended.
    pub status: DescentStatus,
}

/// An edge whose information is rotated into the frame of its first node.
struct Factor {
    from: usize,
    to: usize,
    measurement: Pose2,
    information: Matrix3<f64>,
}

impl Factor {
    fn new(edge: &Edge, weight: f64) -> Self {
        let (sin, cos) = edge.measurement.yaw.sin_cos();
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        Self {
            from: edge.from,
            to: edge.to,
            measurement: edge.measurement,
            information: turn * edge.information * turn.transpose() * weight,
        }
    }

    /// Difference to the measurement in the frame of `from`, and the position of `to` in it.
    fn error(&self, poses: &[Pose2], headings: &[[f64; 2]]) -> (Vector3<f64>, [f64; 2]) {
        let (from, to, [cos, sin]) = (poses[self.from], poses[self.to], headings[self.from]);
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let seen = [cos * dx + sin * dy, cos * dy - sin * dx];
        let Pose2 { x, y, yaw } = self.measurement;
        let turn = wrap_angle(to.yaw - from.yaw - yaw);
        (Vector3::new(seen[0] - x, seen[1] - y, turn), seen)
    }

    fn chi_squared(&self, poses: &[Pose2], headings: &[[f64; 2]]) -> f64 {
        let (error, _) = self.error(poses, headings);
        error.dot(&(self.information * error))
    }
}

/// Chi squared of one edge at given poses.
///
/// ```
/// use nalgebra::Matrix3;
/// use zenav_pose_graph::{Edge, EdgeKind, edge_chi_squared};
/// use zenav_protocol::geometry::Pose2;
///
/// // Measured 1.3 m with a standard deviation of 0.1 m; the poses are 1 m apart: three standard deviations.
/// let edge = Edge {
///     from: 0,
///     to: 1,
///     measurement: Pose2::new(1.3, 0.0, 0.0),
///     information: Matrix3::identity() * 100.0,
///     kind: EdgeKind::Closure,
/// };
/// let chi_squared = edge_chi_squared(&edge, &[Pose2::IDENTITY, Pose2::new(1.0, 0.0, 0.0)]);
/// assert!((chi_squared - 9.0).abs() < 1e-9);
/// ```
///
/// # Panics
/// If a node of the edge has no pose.
#[must_use]
pub fn edge_chi_squared(edge: &Edge, poses: &[Pose2]) -> f64 {
    let factor = Factor::new(edge, 1.0);
    let from = poses[edge.from];
    let seen = from.inverse() * poses[edge.to];
    let Pose2 { x, y, yaw } = edge.measurement;
    let error = Vector3::new(seen.x - x, seen.y - y, wrap_angle(seen.yaw - yaw));
    error.dot(&(factor.information * error))
}

/// The cost: weighted sum of chi squared over all edges. `poses`: one for each node; `weights`: one for each edge.
///
/// ```
/// use zenav_pose_graph::{chi_squared, g2o};
///
/// // Two steps of 1 m, and a closure that measured 2.3 m: read from a file, the nodes lie where odometry takes them.
/// let text = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2 1 2 1 0 0 100 0 0 100 0 400\nEDGE_SE2 0 2 2.3 0 0 100 0 0 100 0 400\n";
/// let graph = g2o::read(text)?.graph;
/// assert!((chi_squared(&graph, graph.poses(), &[1.0, 1.0, 1.0]) - 9.0).abs() < 1e-9);
/// assert_eq!(chi_squared(&graph, graph.poses(), &[1.0, 1.0, 0.0]), 0.0, "without the closure");
/// # Ok::<(), g2o::G2oError>(())
/// ```
#[must_use]
pub fn chi_squared(graph: &PoseGraph, poses: &[Pose2], weights: &[f64]) -> f64 {
    let all = graph.edges().iter().zip(weights);
    all.map(|(edge, weight)| weight * edge_chi_squared(edge, poses)).sum()
}

/// Minimises the cost from `start` (one pose for each node) with the given weights (one for each edge). The anchor does not move.
///
/// ```
/// use zenav_pose_graph::{DescentSettings, DescentStatus, descend, g2o};
///
/// // Two steps of 1 m and a closure that measured 2.3 m, all equally certain: each gives way by 0.1 m.
/// let text = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2 1 2 1 0 0 100 0 0 100 0 400\nEDGE_SE2 0 2 2.3 0 0 100 0 0 100 0 400\n";
/// let graph = g2o::read(text)?.graph;
/// let end = descend(&graph, graph.poses(), &[1.0; 3], &DescentSettings::default());
/// assert_eq!(end.status, DescentStatus::Converged);
/// assert!((end.poses[2].x - 2.2).abs() < 1e-6 && (end.chi_squared - 3.0).abs() < 1e-6);
/// let torn = descend(&graph, graph.poses(), &[1.0, 0.0, 0.0], &DescentSettings::default());
/// assert_eq!(torn.status, DescentStatus::Singular, "nothing holds node 2");
/// # Ok::<(), g2o::G2oError>(())
/// ```
#[must_use]
pub fn descend(graph: &PoseGraph, start: &[Pose2], weights: &[f64], settings: &DescentSettings) -> Descent {
    let fitting = start.len() == graph.poses().len() && weights.len() == graph.edges().len();
    let pattern = pattern(graph, weights).filter(|_| fitting && graph.disconnected(weights).is_none());
    match pattern {
        Some(pattern) => Problem::new(graph, weights, &pattern).descend(start, settings),
        None => Descent {
            poses: start.to_vec(),
            chi_squared: f64::NAN,
            iterations: 0,
            status: DescentStatus::Singular,
        },
    }
}

/// The edges with a weight above zero, and their system.
pub(crate) struct Problem<'p> {
    factors: Vec<Factor>,
    system: BlockSystem<'p, 3>,
}

impl<'p> Problem<'p> {
    /// `pattern`: of the same graph and weights.
    pub(crate) fn new(graph: &PoseGraph, weights: &[f64], pattern: &'p Pattern) -> Self {
        let used = graph.edges().iter().zip(weights).filter(|(_, weight)| **weight > 0.0);
        Self {
            factors: used.map(|(edge, weight)| Factor::new(edge, *weight)).collect(),
            system: BlockSystem::new(pattern),
        }
    }

    /// Returns half the gradient by node; with `is_full`, puts the normal equations into the system.
    fn linearise(&mut self, poses: &[Pose2], is_full: bool) -> Vec<[f64; 3]> {
        let headings = crate::companion::headings(poses);
        let mut gradient = vec![[0.0; 3]; poses.len()];
        if is_full {
            self.system.clear();
        }
        for (pair, factor) in self.factors.iter().enumerate() {
            let (error, [x, y]) = factor.error(poses, &headings);
            let [cos, sin] = headings[factor.from];
            let by_to = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
            let by_from = Matrix3::new(-cos, -sin, y, sin, -cos, -x, 0.0, 0.0, -1.0);
            let weighted = factor.information * error;
            for (node, slope) in [
                (factor.from, by_from.tr_mul(&weighted)),
                (factor.to, by_to.tr_mul(&weighted)),
            ] {
                for (sum, part) in gradient[node].iter_mut().zip(slope.iter()) {
                    *sum += part;
                }
            }
            if is_full {
                let weighted_to = factor.information * by_to;
                self.system.add_node(factor.to, &by_to.tr_mul(&weighted_to));
                self.system.add_pair(pair, &by_from.tr_mul(&weighted_to));
                self.system
                    .add_node(factor.from, &by_from.tr_mul(&(factor.information * by_from)));
            }
        }
        gradient
    }

    /// The system, for another problem over the same graph: its content is lost.
    pub(crate) fn system(&mut self) -> &mut BlockSystem<'p, 3> {
        &mut self.system
    }

    /// The factorised normal equations at given poses; `None` if the graph does not constrain a node.
    pub(crate) fn factorised(mut self, poses: &[Pose2]) -> Option<BlockSystem<'p, 3>> {
        self.linearise(poses, true);
        self.system.factorise().filter(|negative| *negative == 0)?;
        Some(self.system)
    }

    /// Minimises the cost.
    pub(crate) fn descend(&mut self, start: &[Pose2], settings: &DescentSettings) -> Descent {
        minimise(self, start, settings)
    }
}

/// A cost over poses, to be minimised.
pub(crate) trait Objective {
    fn cost(&self, poses: &[Pose2]) -> f64;

    /// Half the gradient by node.
    fn gradient(&mut self, poses: &[Pose2]) -> Vec<[f64; 3]>;

    /// Factorises half the Hessian, or its approximation, with a share of its diagonal added; returns whether it is positive definite.
    fn factorise(&mut self, poses: &[Pose2], damping: f64) -> bool;

    /// Solves for the step of a gradient with these factors.
    fn solve(&mut self, gradient: &mut [[f64; 3]]);

    /// The poses after a step against the given direction.
    fn moved(&mut self, poses: &[Pose2], step: &[[f64; 3]]) -> Vec<Pose2> {
        moved(poses, step)
    }
}

impl Objective for Problem<'_> {
    fn cost(&self, poses: &[Pose2]) -> f64 {
        let headings = crate::companion::headings(poses);
        let factors = self.factors.iter();
        factors.map(|factor| factor.chi_squared(poses, &headings)).sum()
    }

    fn gradient(&mut self, poses: &[Pose2]) -> Vec<[f64; 3]> {
        self.linearise(poses, false)
    }

    fn factorise(&mut self, poses: &[Pose2], damping: f64) -> bool {
        self.linearise(poses, true);
        self.system.damp(damping);
        self.system.factorise() == Some(0)
    }

    fn solve(&mut self, gradient: &mut [[f64; 3]]) {
        self.system.solve(gradient);
    }
}

/// Minimises a cost from `start`.
pub(crate) fn minimise(objective: &mut impl Objective, start: &[Pose2], settings: &DescentSettings) -> Descent {
    let mut poses = start.to_vec();
    let mut cost = objective.cost(&poses);
    let mut damping = Damping::NONE;
    let (mut is_kept, mut promised, mut is_uphill) = (false, f64::INFINITY, false);
    let ended = |poses, chi_squared, iterations, status| Descent {
        poses,
        chi_squared,
        iterations,
        status,
    };
    let mut iterations = 0;
    while iterations < settings.max_iterations {
        if !is_kept && !objective.factorise(&poses, damping.share) {
            iterations += 1;
            damping.grow();
            if damping.share > MOST_DAMPING {
                return ended(poses, cost, iterations, DescentStatus::Singular);
            }
            continue;
        }
        let gradient = objective.gradient(&poses);
        let mut step = gradient.clone();
        objective.solve(&mut step);
        let promise = dot(&gradient, &step);
        if promise <= (settings.tolerance * cost).max(NEGLIGIBLE) {
            // Damped steps predict little anywhere: that counts as converged only if longer ones lead uphill.
            if damping.share == 0.0 || is_uphill {
                let poses = objective.moved(&poses, &step);
                return ended(poses, cost, iterations, DescentStatus::Converged);
            }
            iterations += 1;
            damping.shrink(1.0);
            continue;
        }
        if is_kept && promise > SHRINK * promised {
            is_kept = false;
            promised = f64::INFINITY;
            continue;
        }
        let next = objective.moved(&poses, &step);
        let next_cost = objective.cost(&next);
        let is_downhill = next_cost <= cost * (1.0 + ROUNDING);
        if is_kept && !is_downhill {
            // The factors are too old, which says nothing on damping.
            is_kept = false;
            promised = f64::INFINITY;
            continue;
        }
        iterations += 1;
        if is_downhill {
            let turn = step.iter().map(|block| block[2].abs()).fold(0.0, f64::max);
            is_kept = turn < SAME_FACTORS && damping.share == 0.0;
            damping.shrink((cost - next_cost) / promise);
            (poses, cost, promised, is_uphill) = (next, next_cost, promise, false);
        } else {
            (is_kept, promised, is_uphill) = (false, f64::INFINITY, true);
            damping.grow();
            if damping.share > MOST_DAMPING {
                return ended(poses, cost, iterations, DescentStatus::Converged);
            }
        }
    }
    ended(poses, cost, iterations, DescentStatus::OutOfIterations)
}

/// Damping of the Gauss-Newton steps.
struct Damping {
    /// Share of the diagonal that is added to it.
    share: f64,
    /// The next share after zero.
    first: f64,
    /// The factor of the next growth.
    grows: f64,
}

impl Damping {
    const NONE: Self = Self {
        share: 0.0,
        first: FIRST_DAMPING,
        grows: DAMPING_GROWS,
    };

    /// Updates after a step uphill.
    fn grow(&mut self) {
        if self.share == 0.0 {
            self.share = self.first;
        } else {
            self.share *= self.grows;
            self.grows *= DAMPING_GROWS;
        }
    }

    /// Updates after a step downhill that achieved this share of the predicted decrease.
    fn shrink(&mut self, kept: f64) {
        self.share *= (1.0 - (2.0 * kept - 1.0).powi(3)).max(DAMPING_LEFT);
        self.grows = DAMPING_GROWS;
        if self.share > 0.0 && self.share < LEAST_DAMPING {
            (self.share, self.first) = (0.0, LEAST_DAMPING);
        }
    }
}

/// Sum of the products of all numbers.
fn dot(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let products = a.iter().zip(b);
    products.map(|(a, b)| (0..3).map(|k| a[k] * b[k]).sum::<f64>()).sum()
}
