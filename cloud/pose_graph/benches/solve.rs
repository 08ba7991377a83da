//! Duration of a solve, its certificate and robust closures: processor time of the thread, on graphs from files or a generated one.
//!
//! `cargo bench -p zenav-pose-graph`; with `ZENAV_BENCH_GRAPHS=DIR` on each `*.g2o` of a folder, else on a seeded walk of 3,500 nodes.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a bench stops at what is wrong, and says what it measures"
)]

use std::ops::RangeInclusive;

use criterion::{Criterion, criterion_group, criterion_main};
use zenav_fixtures::{Row, ThreadTime, on_thread_time};
use zenav_pose_graph::{
    DescentSettings, PoseGraph, RobustSettings, certify, chordal_start, descend, g2o, solve, solve_robust,
};

#[path = "../tests/manhattan/mod.rs"]
mod manhattan;

/// Seeds of the false closures.
const SEEDS: RangeInclusive<u64> = 1001..=1030;
/// Poses that differ by no more than this are the same optimum, m.
const SAME: f64 = 1e-3;

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
        let mut same = 0;
        for seed in SEEDS {
            let kept = solve_robust(&spoiled(seed), &descent, &robust).unwrap();
            let away = kept.solution.poses.iter().zip(&solution.poses);
            let away = away.map(|(a, b)| a.distance(b)).fold(0.0, f64::max);
            same += u32::from(away <= SAME);
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
        Row::new(what, f64::from(same), "seeds").print();
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
