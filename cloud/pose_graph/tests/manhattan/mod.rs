//! Manhattan graphs. Seeded graphs shared by tests, benches and the example.

#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each of those that share this uses a part of it, and stops at what is wrong"
)]

use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use zenav_pose_graph::{Edge, EdgeKind, PoseGraph};
use zenav_protocol::geometry::Pose2;

/// Standard deviations of all measurements: m, m, rad.
pub const SIGMA: [f64; 3] = [0.05, 0.05, 0.02];
/// Steps between two corners of the streets.
const BLOCK: usize = 4;
/// Closures connect nodes closer than this, m.
const NEAR: f64 = 0.5;

/// The inverse of the covariance of all measurements.
pub fn information() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::from(SIGMA.map(|sigma| 1.0 / (sigma * sigma))))
}

pub fn noisy(pose: Pose2, random: &mut Pcg64Mcg) -> Pose2 {
    let mut draw = |sigma: f64| -> f64 {
        let normal: f64 = StandardNormal.sample(random);
        sigma * normal
    };
    pose * Pose2::new(draw(SIGMA[0]), draw(SIGMA[1]), draw(SIGMA[2]))
}

/// A walk of `nodes` steps of 1 m through streets of 4 m within a square of 40 m: odometry, and a closure wherever a node comes within half
/// a metre of an older one. Returns the graph, with its nodes at the poses by odometry, and the true poses.
pub fn walk(nodes: usize, seed: u64) -> (PoseGraph, Vec<Pose2>) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut truth = vec![Pose2::IDENTITY];
    let mut graph = PoseGraph::new();
    let mut odometry = graph.add_node(Pose2::IDENTITY).unwrap();
    while truth.len() < nodes {
        let here = truth[truth.len() - 1];
        let mut turn = 0.0;
        if truth.len() % BLOCK == 0 {
            let ahead = here * Pose2::new(BLOCK as f64, 0.0, 0.0);
            let is_out = ahead.x.abs() > 20.5 || ahead.y.abs() > 20.5;
            let quarter = std::f64::consts::FRAC_PI_2;
            turn = match random.random_range(0..4) {
                0 => quarter,
                1 => -quarter,
                _ if is_out => quarter,
                _ => 0.0,
            };
        }
        let next = here * Pose2::new(0.0, 0.0, turn) * Pose2::new(1.0, 0.0, 0.0);
        let measurement = noisy(here.inverse() * next, &mut random);
        let guess = graph.poses()[odometry] * measurement;
        let added = graph.add_node(guess).unwrap();
        let edge = |from, to, measurement, kind| Edge {
            from,
            to,
            measurement,
            information: information(),
            kind,
        };
        graph
            .add_edge(edge(odometry, added, measurement, EdgeKind::Odometry))
            .unwrap();
        let older = truth.iter().take(truth.len().saturating_sub(10));
        if let Some((seen, pose)) = older.enumerate().find(|(_, pose)| pose.distance(&next) < NEAR) {
            let measurement = noisy(pose.inverse() * next, &mut random);
            graph
                .add_edge(edge(seen, added, measurement, EdgeKind::Closure))
                .unwrap();
        }
        truth.push(next);
        odometry = added;
    }
    (graph, truth)
}

/// Adds false closures between random nodes, as many as there are closures times `share`; half of them claim a place within a metre.
pub fn add_false(graph: &mut PoseGraph, share: f64, seed: u64) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let closures = graph.edges().iter().filter(|edge| edge.kind == EdgeKind::Closure);
    let count = (closures.count() as f64 * share).round() as usize;
    let information = graph
        .edges()
        .iter()
        .rev()
        .find(|edge| edge.kind == EdgeKind::Closure)
        .map_or(information(), |edge| edge.information);
    for index in 0..count {
        let nodes = graph.poses().len();
        let from = random.random_range(0..nodes - 11);
        let to = random.random_range(from + 10..nodes);
        let reach = if index % 2 == 0 { 1.0 } else { 20.0 };
        let mut draw = |reach: f64| random.random_range(-reach..reach);
        let edge = Edge {
            from,
            to,
            measurement: Pose2::new(draw(reach), draw(reach), draw(3.0)),
            information,
            kind: EdgeKind::Closure,
        };
        graph.add_edge(edge).unwrap();
    }
}
