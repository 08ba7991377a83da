//! Duration of a solve, its certificate and robust closures: processor time of the thread, on graphs from files or a generated one.
//!
//! `cargo bench -p zenav-pose-graph`; with `ZENAV_BENCH_GRAPHS=DIR` on each `*.g2o` of a folder, else on a seeded walk of 3,500 nodes.
//!
//! With `GTSAM_PYTHON=PYTHON`, the interpreter of a virtual environment with PyPI's `gtsam`, GTSAM solves the same graphs from the same
//! start with the same information matrices, single-threaded like ours, with its default parameters and nothing to certify. Its robust
//! methods trust odometry, as ours does, and get our limit for a false closure.
//!
//! With `FACTRS_PEER=PROGRAM`, what `cargo build --release` makes of `peers/factrs`, factrs does so as well, without robust methods.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a bench stops at what is wrong, and says what it measures"
)]

use std::ops::RangeInclusive;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use zenav_fixtures::{Row, ThreadTime, on_thread_time, thread_time};
use zenav_pose_graph::{
    DescentSettings, PoseGraph, RobustSettings, Solution, certify, chi_squared, chordal_start, descend, g2o, solve,
    solve_robust,
};
use zenav_protocol::geometry::Pose2;

#[path = "../tests/manhattan/mod.rs"]
mod manhattan;
#[path = "peers/mod.rs"]
mod peers;

use peers::Peer;

/// Seeds of the false closures.
const SEEDS: RangeInclusive<u64> = 1001..=1030;
/// Poses that differ by no more than this are the same optimum, m.
const SAME: f64 = 1e-3;
/// Runs of a solve beside a peer, of either.
const RUNS: usize = 20;
/// Peers' methods for graphs that are true, and GTSAM's for those that may not be.
const METHODS: [(&str, &str); 2] = [
    ("gauss_newton", "Gauss-Newton"),
    ("levenberg_marquardt", "Levenberg-Marquardt"),
];
const ROBUST_METHODS: [(&str, &str); 2] = [("gnc", "GNC"), ("huber", "Huber")];
/// Seeds of the false closures beside a peer, the first ones: GNC takes five seconds each in CSAIL, and more than a minute in M3500.
const PEER_SEEDS: usize = 5;

fn graphs() -> Vec<(String, PoseGraph)> {
    let Ok(folder) = std::env::var("ZENAV_BENCH_GRAPHS") else {
        return vec![("walk_3500".to_owned(), manhattan::walk(3500, 1).0)];
    };
    let mut paths: Vec<_> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "g2o"));
    paths.sort();
    let read = |path: &std::path::PathBuf| {
        let text = std::fs::read_to_string(path).unwrap();
        (
            path.file_stem().unwrap().to_string_lossy().into_owned(),
            g2o::read(&text).unwrap().graph,
        )
    };
    paths.iter().map(read).collect()
}

/// Solves beside a peer's, both from the file's own start; and whether both find the same optimum.
fn beside(peer: &Peer, name: &str, graph: &PoseGraph, solution: &Solution) {
    let descent = DescentSettings::default();
    let took = |_| {
        let begin = thread_time();
        let _ = std::hint::black_box(solve(graph, &descent));
        ms(thread_time().saturating_sub(begin))
    };
    let _ = solve(graph, &descent);
    let ours = median((0..RUNS).map(took).collect());
    for (method, what) in METHODS {
        let what = format!("{} {what}", peer.name);
        let theirs = peer.solve(method, graph, RUNS);
        Row::new(format!("{name}: solve, ours with its certificate"), ours, "ms")
            .beside(&what, theirs.ms)
            .print();
        let mut ours_first = graph.clone();
        ours_first.set_poses(&solution.poses).unwrap();
        let from_ours = peer.solve(method, &ours_first, 1);
        println!(
            "{name}, {what}: chi squared {:.4} by its errors, {:.4} by ours (ours {:.4}), {:.1e} m from our optimum, {:.1e} m from where it ends from there",
            theirs.chi_squared,
            chi_squared(graph, &theirs.poses, &vec![1.0; graph.edges().len()]),
            solution.chi_squared,
            farthest(&theirs.poses, &solution.poses),
            farthest(&theirs.poses, &from_ours.poses),
        );
    }
}

/// Robust solves beside GTSAM's. `ends`: ours, in ms and m from our optimum of the graph without false closures.
fn beside_robust(peer: &Peer, name: &str, graph: &PoseGraph, spoiled: &[PoseGraph], ends: &[(f64, f64)]) {
    let optimum = peer.solve(METHODS[1].0, graph, 1).poses;
    for (method, what) in ROBUST_METHODS {
        let what = format!("{} {what}", peer.name);
        let theirs: Vec<(f64, f64)> = spoiled
            .iter()
            .map(|graph| peer.solve(method, graph, 1))
            .map(|answer| (answer.ms, farthest(&answer.poses, &optimum)))
            .collect();
        println!("{name}, half of the closures false, {what}: ms and m from its optimum {theirs:.2?}");
        let times = |ends: &[(f64, f64)]| median(ends.iter().map(|end| end.0).collect());
        let of = |what| format!("{name}, half of the closures false: {what} {} seeds", spoiled.len());
        Row::new(of("time, median of"), times(ends), "ms")
            .beside(&what, times(&theirs))
            .print();
        Row::new(of("same optimum, of"), same(ends), "seeds")
            .beside(&what, same(&theirs))
            .print();
    }
}

fn same(ends: &[(f64, f64)]) -> f64 {
    ends.iter().filter(|(_, away)| *away <= SAME).count() as f64
}

fn farthest(a: &[Pose2], b: &[Pose2]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance(b)).fold(0.0, f64::max)
}

fn ms(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn benches(criterion: &mut Criterion<ThreadTime>) {
    let (descent, robust) = (DescentSettings::default(), RobustSettings::default());
    for (name, graph) in graphs() {
        let weights = vec![1.0; graph.edges().len()];
        let solution = solve(&graph, &descent).unwrap();
        println!(
            "{name}: {} nodes, {} edges, chi squared {:.4}, {:?}",
            graph.poses().len(),
            graph.edges().len(),
            solution.chi_squared,
            solution.certificate.optimality
        );
        let mut group = criterion.benchmark_group(&name);
        group.sample_size(20);
        group.bench_function("solve_and_certify", |bench| bench.iter(|| solve(&graph, &descent)));
        group.bench_function("certify", |bench| {
            bench.iter(|| certify(&graph, &solution.poses, &weights))
        });
        let start = chordal_start(&graph, &weights).unwrap();
        group.bench_function("descend_from_chordal", |bench| {
            bench.iter(|| descend(&graph, &start, &weights, &descent));
        });
        let true_edges = graph.edges().len();
        let spoiled = |seed| {
            let mut spoiled = graph.clone();
            manhattan::add_false(&mut spoiled, 1.0, seed);
            spoiled
        };
        let mut ends = Vec::new();
        for seed in SEEDS {
            let graph = spoiled(seed);
            let begin = thread_time();
            let kept = solve_robust(&graph, &descent, &robust).unwrap();
            let took = thread_time().saturating_sub(begin);
            let away = farthest(&kept.solution.poses, &solution.poses);
            ends.push((ms(took), away));
            println!(
                "{name}, half of the closures false, seed {seed}: {} true ones lost, {} false ones kept, {away:.1e} m from the optimum, {:?}",
                kept.weights[..true_edges]
                    .iter()
                    .filter(|weight| **weight == 0.0)
                    .count(),
                kept.weights[true_edges..]
                    .iter()
                    .filter(|weight| **weight > 0.0)
                    .count(),
                kept.solution.certificate.optimality
            );
        }
        let what = format!("{name}, half of the closures false: same optimum, of {}", SEEDS.count());
        Row::new(what, same(&ends), "seeds").print();
        if let Some(peer) = Peer::factrs() {
            beside(&peer, &name, &graph, &solution);
        }
        if let Some(peer) = Peer::gtsam(robust.max_chi_squared) {
            beside(&peer, &name, &graph, &solution);
            let graphs: Vec<PoseGraph> = SEEDS.take(PEER_SEEDS).map(spoiled).collect();
            beside_robust(&peer, &name, &graph, &graphs, &ends[..PEER_SEEDS]);
        }
        let graph = spoiled(*SEEDS.start());
        group.sample_size(10);
        group.bench_function("half_of_the_closures_false", |bench| {
            bench.iter(|| solve_robust(&graph, &descent, &robust));
        });
        group.finish();
    }
}

criterion_group! {
    name = all;
    config = on_thread_time();
    targets = benches
}
criterion_main!(all);
