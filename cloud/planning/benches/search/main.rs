//! Grid searches compared with a peer: speed and path length. `cargo bench -p zenav-planning --bench search`
//!
//! A*, jump point search and A* of the crate `pathfinding` answer the same queries in the same run: a point robot, no corner cutting, a
//! diagonal step costs the square root of two. The table gives the median (95th percentile) over a map's queries of the least thread CPU
//! time of three runs each, and the median of the ratio, query by query. A path whose length differs from the peer's ends the bench. What
//! ours prepare once for a map, the jump points for the most part, is timed by itself (`ready`); the peer prepares nothing.
//!
//! | variable | does |
//! |---|---|
//! | `ZENAV_BENCH_MAPS=DIR` | adds every `.map`, `.pgm` and `.png` of a folder |
//! | `ZENAV_BENCH_ONLY=NAME` | only maps whose name contains this |
//!
//! Queries: the 50 with the longest published optimum if a scenario file (`NAME.map.scen`) lies beside the map; else the 50 longest of
//! 1000 pairs of connected free cells, drawn with [`queries::SEED`]. Unknown cells are blocked.

#![allow(missing_docs, reason = "a bench has no users")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a bench prints its table and stops at the first thing that is not as it should be"
)]

mod generated;
mod peer;
mod queries;

use std::hint::black_box;
use std::path::Path;
use std::time::Duration;

use criterion::Criterion;
use rustix::time::{ClockId, clock_gettime};
use zenav_fixtures::{Row, ThreadTime};
use zenav_mapping::read_map;
use zenav_planning::{Budget, Planner, Query, Searcher};
use zenav_protocol::grid::Occupancy;
use zenav_space::{BitGrid, PointLineOfSight};

/// Runs of each query by each solver; the least time counts.
const RUNS: usize = 3;
const SOLVERS: [Solver; 3] = [Solver::Peer, Solver::Ours(Planner::AStar), Solver::Ours(Planner::Jps)];

#[derive(Clone, Copy)]
enum Solver {
    Peer,
    Ours(Planner),
}

/// A map and its queries.
struct Case {
    name: String,
    free: BitGrid,
    queries: Vec<Query>,
}

fn main() {
    let only = std::env::var("ZENAV_BENCH_ONLY").unwrap_or_default();
    let mut cases = generated::maps(&only);
    if let Ok(folder) = std::env::var("ZENAV_BENCH_MAPS") {
        cases.extend(read(Path::new(&folder), &only));
    }
    println!("times in ms, median (95th percentile)\n");
    println!(
        "| map | cells | ready | crate `pathfinding` A* | `astar` | times faster | `jps` | times faster | queries |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for case in &cases {
        compare(case);
    }
    let mut criterion = Criterion::default()
        .with_measurement(ThreadTime)
        .configure_from_args()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1));
    for case in &cases {
        follow(&mut criterion, case);
    }
    criterion.final_summary();
}

/// One line of the table.
fn compare(case: &Case) {
    let sight = PointLineOfSight::new(&case.free);
    let began = cpu();
    let mut searcher = Searcher::new(&case.free).unwrap();
    if let Some(query) = case.queries.first() {
        // The first query prepares the jump points; with the start as its goal it costs nothing else.
        let stay = Query {
            goal: query.start,
            ..*query
        };
        black_box(searcher.search(Planner::Jps, &sight, &stay, Budget::UNLIMITED));
    }
    let ready = cpu() - began;
    let mut times = [const { Vec::new() }; 3];
    for query in &case.queries {
        let mut lengths = [0.0; 3];
        for (i, solver) in SOLVERS.iter().enumerate() {
            let mut least = f64::INFINITY;
            for _ in 0..RUNS {
                let began = cpu();
                lengths[i] = match solver {
                    Solver::Peer => peer::length(&case.free, query),
                    Solver::Ours(planner) => {
                        let searched = searcher.search(*planner, &sight, query, Budget::UNLIMITED);
                        searched.result.unwrap().length
                    }
                };
                least = least.min(cpu() - began);
            }
            times[i].push(least);
        }
        for length in &lengths[1..] {
            assert!(
                (length - lengths[0]).abs() <= 1e-5 * lengths[0].max(1.0),
                "{}: {query:?}: {length} cells, the peer has {}",
                case.name,
                lengths[0]
            );
        }
    }
    let figure = |i: usize| format!("{:.3} ({:.3})", quantile(&times[i], 0.5), quantile(&times[i], 0.95));
    let ratio = |i: usize| {
        let ratios: Vec<f64> = times[0].iter().zip(&times[i]).map(|(peer, ours)| peer / ours).collect();
        quantile(&ratios, 0.5)
    };
    println!(
        "| {} | {}x{} | {ready:.2} | {} | {} | {:.1} | {} | {:.1} | {} |",
        case.name,
        case.free.width(),
        case.free.height(),
        figure(0),
        figure(1),
        ratio(1),
        figure(2),
        ratio(2),
        case.queries.len()
    );
    Row::new(format!("{}, jump points prepared", case.name), ready, "ms").print();
    for (i, planner) in [(1, "A*"), (2, "JPS")] {
        let medians = [quantile(&times[i], 0.5), quantile(&times[0], 0.5)];
        let row = Row::new(format!("{} {planner}, median", case.name), medians[0], "ms");
        row.beside("pathfinding A*", medians[1]).print();
    }
}

/// All queries of a map in a row, tracked from run to run by criterion.
fn follow(criterion: &mut Criterion<ThreadTime>, case: &Case) {
    let mut searcher = Searcher::new(&case.free).unwrap();
    let sight = PointLineOfSight::new(&case.free);
    for planner in [Planner::AStar, Planner::Jps] {
        criterion.bench_function(&format!("{}/{planner}", case.name), |bencher| {
            bencher.iter(|| {
                for query in &case.queries {
                    black_box(searcher.search(planner, &sight, query, Budget::UNLIMITED).expansions);
                }
            });
        });
    }
}

/// The maps of a folder by name, with their queries.
fn read(folder: &Path, only: &str) -> Vec<Case> {
    let mut paths: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.retain(|path| {
        path.extension()
            .is_some_and(|ending| ["map", "pgm", "png"].iter().any(|known| ending == *known))
            && path.to_string_lossy().contains(only)
    });
    paths.sort();
    let case = |path: &std::path::PathBuf| {
        let grid = read_map(path, 0.05).unwrap();
        let spec = *grid.spec();
        let free = BitGrid::from_fn(spec.width, spec.height, |cell| {
            Occupancy::of(grid[cell]) == Occupancy::Free
        });
        let scenarios = std::fs::read(format!("{}.scen", path.display())).ok();
        let queries = match scenarios {
            Some(text) => queries::published(&spec, &text),
            None => queries::drawn(&free),
        };
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        Case { name, free, queries }
    };
    paths.iter().map(case).collect()
}

fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = (share * sorted.len() as f64) as usize;
    sorted
        .get(at.min(sorted.len().wrapping_sub(1)))
        .copied()
        .unwrap_or(f64::NAN)
}

/// CPU time of this thread, ms: other load on a shared machine does not count.
fn cpu() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
}
