//! Isotropic companion. The simplified problem for which optimality can be certified, and its stationary point.
//!
//! Cost `Σ κ |zⱼ - r zᵢ|² + τ |tⱼ - tᵢ - zᵢ p|²` with complex rotations `z`, positions `t`, measured rotation `r` and position `p`; `κ` is
//! the information of the yaw, `τ` the harmonic mean of the information along the two axes of the plane (Rosen et al. 2019, section 6).

use nalgebra::{Matrix2, Matrix3};
use zenav_protocol::geometry::Pose2;

use crate::descent::{DescentStatus, Objective, minimise};
use crate::graph::PoseGraph;
use crate::linear::BlockSystem;
use crate::settings::DescentSettings;
use crate::start::Positions;

/// Smallest weight in the plane, as a share of the larger of the two, for an edge that constrains only one direction.
const LEAST_SHARE: f64 = 1e-6;
/// The descent ends when the next step would lower the cost by less than this share of it.
const TOLERANCE: f64 = 1e-15;
/// Most steps.
const MAX_STEPS: u32 = 60;

/// An edge with the same weight in each direction of the plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Isotropic {
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) cos: f64,
    pub(crate) sin: f64,
    /// κ, 1/rad².
    pub(crate) rotation: f64,
    /// τ, 1/m².
    pub(crate) translation: f64,
}

impl Isotropic {
    /// The edges of some weight, in the order of the graph.
    pub(crate) fn of(graph: &PoseGraph, weights: &[f64]) -> Vec<Self> {
        let used = graph.edges().iter().zip(weights).filter(|(_, weight)| **weight > 0.0);
        let isotropic = used.map(|(edge, weight)| {
            let plane: Matrix2<f64> = edge.information.fixed_view::<2, 2>(0, 0).into_owned();
            let sum = plane.trace().max(f64::MIN_POSITIVE);
            let harmonic = (2.0 * plane.determinant() / sum).max(LEAST_SHARE * sum);
            let Pose2 { x, y, yaw } = edge.measurement;
            Self {
                from: edge.from,
                to: edge.to,
                x,
                y,
                cos: yaw.cos(),
                sin: yaw.sin(),
                rotation: weight * edge.information[(2, 2)].max(f64::MIN_POSITIVE),
                translation: weight * harmonic,
            }
        });
        isotropic.collect()
    }
}

/// The terms of one edge at given poses.
struct Terms {
    /// `zᵢ p`: the measured position, turned into the map's frame.
    turned: [f64; 2],
    /// `tⱼ - tᵢ - zᵢ p`.
    gap: [f64; 2],
    /// Cosine and sine of the difference of yaws, beyond the measurement.
    turn: [f64; 2],
}

impl Terms {
    fn of(edge: &Isotropic, poses: &[Pose2], headings: &[[f64; 2]]) -> Self {
        let ([cos, sin], [to_cos, to_sin]) = (headings[edge.from], headings[edge.to]);
        let turned = [cos * edge.x - sin * edge.y, sin * edge.x + cos * edge.y];
        let (from, to) = (poses[edge.from], poses[edge.to]);
        let expected = [cos * edge.cos - sin * edge.sin, sin * edge.cos + cos * edge.sin];
        Self {
            turned,
            gap: [to.x - from.x - turned[0], to.y - from.y - turned[1]],
            turn: [
                expected[0] * to_cos + expected[1] * to_sin,
                expected[0] * to_sin - expected[1] * to_cos,
            ],
        }
    }

    fn cost(&self, edge: &Isotropic) -> f64 {
        let [gap_x, gap_y] = self.gap;
        2.0 * edge.rotation * (1.0 - self.turn[0]) + edge.translation * (gap_x * gap_x + gap_y * gap_y)
    }
}

/// Cosine and sine of each yaw.
pub(crate) fn headings(poses: &[Pose2]) -> Vec<[f64; 2]> {
    poses.iter().map(|pose| [pose.yaw.cos(), pose.yaw.sin()]).collect()
}

/// The companion's cost.
pub(crate) fn cost(edges: &[Isotropic], poses: &[Pose2]) -> f64 {
    let headings = headings(poses);
    edges
        .iter()
        .map(|edge| Terms::of(edge, poses, &headings).cost(edge))
        .sum()
}

/// Returns half the gradient by node, and puts half the Hessian (Gauss-Newton, or exact) into `system`, if given.
fn linearise(
    edges: &[Isotropic],
    poses: &[Pose2],
    is_exact: bool,
    mut system: Option<&mut BlockSystem<'_, 3>>,
) -> Vec<[f64; 3]> {
    let headings = headings(poses);
    let mut gradient = vec![[0.0; 3]; poses.len()];
    if let Some(system) = &mut system {
        system.clear();
    }
    for (pair, edge) in edges.iter().enumerate() {
        let terms = Terms::of(edge, poses, &headings);
        let ([gap_x, gap_y], [turned_x, turned_y], [cos, sin]) = (terms.gap, terms.turned, terms.turn);
        let (kappa, tau) = (edge.rotation, edge.translation);
        // Turning `from` moves the measured position along its normal.
        let normal = [-turned_y, turned_x];
        let along = gap_x * normal[0] + gap_y * normal[1];
        for (all, sign) in [(edge.from, -1.0), (edge.to, 1.0)] {
            gradient[all][0] += sign * tau * gap_x;
            gradient[all][1] += sign * tau * gap_y;
            gradient[all][2] += sign * kappa * sin;
        }
        gradient[edge.from][2] -= tau * along;
        let Some(system) = &mut system else {
            continue;
        };
        let own = tau * (turned_x * turned_x + turned_y * turned_y);
        // The second derivative of the measured position by the turn points back along it.
        let bend = if is_exact {
            tau * (gap_x * turned_x + gap_y * turned_y)
        } else {
            0.0
        };
        let yaw = if is_exact { kappa * cos } else { kappa };
        let (mixed_x, mixed_y) = (tau * normal[0], tau * normal[1]);
        let from = Matrix3::new(tau, 0.0, mixed_x, 0.0, tau, mixed_y, mixed_x, mixed_y, yaw + own + bend);
        system.add_node(edge.from, &from);
        system.add_node(edge.to, &Matrix3::new(tau, 0.0, 0.0, 0.0, tau, 0.0, 0.0, 0.0, yaw));
        let mixed = Matrix3::new(-tau, 0.0, 0.0, 0.0, -tau, 0.0, -mixed_x, -mixed_y, -yaw);
        system.add_pair(pair, &mixed);
    }
    gradient
}

/// The companion's cost as an objective.
struct Companion<'a, 'p> {
    edges: &'a [Isotropic],
    system: &'a mut BlockSystem<'p, 3>,
    positions: &'a Positions<'p>,
}

impl Objective for Companion<'_, '_> {
    fn cost(&self, poses: &[Pose2]) -> f64 {
        cost(self.edges, poses)
    }

    fn gradient(&mut self, poses: &[Pose2]) -> Vec<[f64; 3]> {
        linearise(self.edges, poses, true, None)
    }

    fn factorise(&mut self, poses: &[Pose2], damping: f64) -> bool {
        // Far from a minimum the exact Hessian need not be positive definite.
        [true, false].into_iter().any(|is_exact| {
            linearise(self.edges, poses, is_exact, Some(self.system));
            self.system.damp(damping);
            self.system.factorise() == Some(0)
        })
    }

    fn solve(&mut self, gradient: &mut [[f64; 3]]) {
        self.system.solve(gradient);
    }

    /// Turns the nodes, then moves each to its best position: a straight step would tear a long chain that turns.
    fn moved(&mut self, poses: &[Pose2], step: &[[f64; 3]]) -> Vec<Pose2> {
        let turned = moved(poses, step);
        let positions = self.positions.of(poses[0], self.edges, &headings(&turned));
        let both = positions.iter().zip(&turned);
        both.map(|(at, turned)| Pose2::new(at.x, at.y, turned.yaw)).collect()
    }
}

/// The stationary point of the companion's cost that a descent from `poses` reaches, or its last poses. `None` if the systems cannot be
/// solved. `system`: over the same graph; its content is lost.
pub(crate) fn stationary<'p>(
    edges: &[Isotropic],
    system: &mut BlockSystem<'p, 3>,
    positions: &Positions<'p>,
    poses: &[Pose2],
) -> Option<Vec<Pose2>> {
    let mut companion = Companion {
        edges,
        system,
        positions,
    };
    let settings = DescentSettings {
        max_iterations: MAX_STEPS,
        tolerance: TOLERANCE,
    };
    let end = minimise(&mut companion, poses, &settings);
    (end.status != DescentStatus::Singular).then_some(end.poses)
}

/// The poses after a step against the given direction.
pub(crate) fn moved(poses: &[Pose2], step: &[[f64; 3]]) -> Vec<Pose2> {
    let all = poses.iter().zip(step);
    all.map(|(pose, [x, y, yaw])| Pose2::new(pose.x - x, pose.y - y, pose.yaw - yaw))
        .collect()
}
