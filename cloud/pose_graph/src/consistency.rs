//! Pairwise consistency. Which loop closures agree with another one around a short cycle?
//!
//! Two closures whose ends lie a few odometry steps apart make a cycle: there, along odometry, back, along odometry. Where both are true it
//! ends where it began, but for noise: chi squared with three degrees of freedom (Mangelson et al., "Pairwise consistent measurement set
//! maximization", ICRA 2018). A false closure seldom has such company.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use zenav_protocol::geometry::Pose2;

use crate::covariance::mahalanobis;
use crate::graph::{Edge, EdgeKind, PoseGraph};
use crate::settings::RobustSettings;

/// Added to information matrices before they are inverted, as a share of the largest entry: directions that an edge does not know.
const LEAST_INFORMATION: f64 = 1e-9;

/// A relative pose and its covariance in the frame of its far end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Uncertain {
    pub(crate) pose: Pose2,
    pub(crate) covariance: Matrix3<f64>,
}

/// What turns a small motion at the far end of `pose` into one at its near end.
fn adjoint(pose: Pose2) -> Matrix3<f64> {
    let (sin, cos) = pose.yaw.sin_cos();
    Matrix3::new(cos, -sin, pose.y, sin, cos, -pose.x, 0.0, 0.0, 1.0)
}

impl Uncertain {
    pub(crate) const CERTAIN: Self = Self {
        pose: Pose2::IDENTITY,
        covariance: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    pub(crate) fn of(edge: &Edge) -> Self {
        let least = Matrix3::identity() * (LEAST_INFORMATION * edge.information.amax());
        Self {
            pose: edge.measurement,
            covariance: (edge.information + least).try_inverse().unwrap_or_else(Matrix3::zeros),
        }
    }

    pub(crate) fn inverse(&self) -> Self {
        let turn = adjoint(self.pose);
        Self {
            pose: self.pose.inverse(),
            covariance: turn * self.covariance * turn.transpose(),
        }
    }

    pub(crate) fn then(&self, next: &Self) -> Self {
        let back = adjoint(next.pose.inverse());
        Self {
            pose: self.pose * next.pose,
            covariance: back * self.covariance * back.transpose() + next.covariance,
        }
    }

    /// How far this is from no motion at all.
    fn chi_squared(&self) -> f64 {
        let Pose2 { x, y, yaw } = self.pose;
        mahalanobis(&Vector3::new(x, y, yaw), &self.covariance)
    }
}

/// Whether each edge has support: odometry always, a closure where it agrees with odometry alone within the window, or with another closure
/// around a cycle of at most twice the window's odometry steps.
///
/// Cost: closures x (window + closures in the window).
#[must_use]
pub fn supported(graph: &PoseGraph, settings: &RobustSettings) -> Vec<bool> {
    let edges = graph.edges();
    let mut odometry: Vec<Vec<usize>> = vec![Vec::new(); graph.poses().len()];
    let mut closures: Vec<Vec<usize>> = vec![Vec::new(); graph.poses().len()];
    for (index, edge) in edges.iter().enumerate() {
        let at = if edge.kind == EdgeKind::Odometry {
            &mut odometry
        } else {
            &mut closures
        };
        at[edge.from].push(index);
        at[edge.to].push(index);
    }
    let mut is_supported: Vec<bool> = edges.iter().map(|edge| edge.kind == EdgeKind::Odometry).collect();
    for (index, edge) in edges.iter().enumerate() {
        if is_supported[index] {
            continue;
        }
        let own = Uncertain::of(edge);
        let near_from = around(edge.from, edges, &odometry, settings.window);
        if let Some(along) = near_from.get(&edge.to) {
            is_supported[index] = own.then(&along.inverse()).chi_squared() <= settings.max_chi_squared;
        }
        let near_to = around(edge.to, edges, &odometry, settings.window);
        let candidates = near_from.keys().flat_map(|node| &closures[*node]);
        for other in candidates.filter(|other| **other != index) {
            let (mut back, mut ends) = (
                Uncertain::of(&edges[*other]).inverse(),
                (edges[*other].from, edges[*other].to),
            );
            if !near_from.contains_key(&ends.0) || !near_to.contains_key(&ends.1) {
                (back, ends) = (back.inverse(), (ends.1, ends.0));
            }
            let (Some(there), Some(here)) = (near_to.get(&ends.1), near_from.get(&ends.0)) else {
                continue;
            };
            let cycle = own.then(there).then(&back).then(&here.inverse());
            if cycle.chi_squared() <= settings.max_chi_squared {
                is_supported[index] = true;
                is_supported[*other] = true;
                break;
            }
        }
    }
    is_supported
}

/// The nodes within `window` odometry steps of one, and their poses as seen from it.
fn around(node: usize, edges: &[Edge], odometry: &[Vec<usize>], window: u32) -> BTreeMap<usize, Uncertain> {
    let mut reached = BTreeMap::from([(node, Uncertain::CERTAIN)]);
    let mut front = vec![node];
    for _ in 0..window {
        let mut next = Vec::new();
        for node in front {
            let here = reached[&node];
            for edge in odometry[node].iter().map(|index| &edges[*index]) {
                let (other, step) = if edge.from == node {
                    (edge.to, Uncertain::of(edge))
                } else {
                    (edge.from, Uncertain::of(edge).inverse())
                };
                if let std::collections::btree_map::Entry::Vacant(free) = reached.entry(other) {
                    free.insert(here.then(&step));
                    next.push(other);
                }
            }
        }
        front = next;
    }
    reached
}
