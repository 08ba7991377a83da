//! Rejects false closures and certifies the global optimum, on a seeded walk through a town of square blocks.
//!
//! `cargo run -p zenav-pose-graph --example manhattan`

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "an example shows its result")]

use zenav_pose_graph::{DescentSettings, EdgeKind, RobustSettings, marginal_covariance, solve, solve_robust};
use zenav_protocol::geometry::Pose2;

#[path = "../tests/manhattan/mod.rs"]
mod manhattan;

fn main() {
    let (mut graph, truth) = manhattan::walk(600, 1);
    let away = |poses: &[Pose2]| {
        let pairs = poses.iter().zip(&truth);
        pairs.map(|(pose, truth)| pose.distance(truth)).fold(0.0, f64::max)
    };
    println!("odometry alone:           {:6.2} m off at most", away(graph.poses()));
    let settings = DescentSettings::default();
    let clean = solve(&graph, &settings).unwrap();
    println!(
        "with all closures:        {:6.2} m, chi squared {:.1}, {:?}",
        away(&clean.poses),
        clean.chi_squared,
        clean.certificate.optimality
    );

    let is_closure = |weight: f64, kind| kind == EdgeKind::Closure && weight > 0.0;
    let before = graph.edges().len();
    manhattan::add_false(&mut graph, 1.0, 2);
    let robust = solve_robust(&graph, &settings, &RobustSettings::default()).unwrap();
    let kept = graph.edges().iter().zip(&robust.weights).enumerate();
    let kept: Vec<usize> = kept
        .filter(|(_, (edge, weight))| is_closure(**weight, edge.kind))
        .map(|(index, _)| index)
        .collect();
    println!(
        "as many false ones added: {:6.2} m, chi squared {:.1}, {:?}",
        away(&robust.solution.poses),
        robust.solution.chi_squared,
        robust.solution.certificate.optimality
    );
    println!(
        "closures kept: {} true, {} false",
        kept.iter().filter(|index| **index < before).count(),
        kept.iter().filter(|index| **index >= before).count()
    );
    let covariance = marginal_covariance(&graph, &robust.solution.poses, &robust.weights, &[599]).unwrap();
    println!(
        "the last node is known to {:.2} m by {:.2} m, {:.3} rad",
        covariance[(0, 0)].sqrt(),
        covariance[(1, 1)].sqrt(),
        covariance[(2, 2)].sqrt()
    );
}
