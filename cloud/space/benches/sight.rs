//! Line-of-sight checks per second. Segments of several lengths on one map, compared with a walk from cell to cell and the exact
//! measurement of a moved disc; in processor time of the thread.
//!
//! `cargo bench -p zenav-space --bench sight`, on a house made from a seed; `ZENAV_BENCH_MAP=file` takes a map (.yaml, .pgm, .png, .map).
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, reason = "a bench")]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Point2, Vector2};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use zenav_fixtures::{Pair, ThreadTime, on_thread_time};
use zenav_mapping::read_map;
use zenav_protocol::grid::{Cell, Grid, Occupancy, OccupancyGrid};
use zenav_protocol::robot::Footprint;
use zenav_space::{BitGrid, ConfigurationSpace, LineOfSight, PointLineOfSight, UnknownPolicy};

/// Segments per length.
const SEGMENTS: usize = 1000;

/// Rooms of 4 m with doors, most of them with a box.
fn house() -> OccupancyGrid {
    let spec = zenav_fixtures::spec(1000, 1000, 0.05);
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let mut grid = Grid::filled(spec, Occupancy::FREE);
    let room = |x: u32| x / 80;
    let doors: Vec<u32> = (0..400).map(|_| random.random_range(10..50)).collect();
    for y in 0..spec.height {
        for x in 0..spec.width {
            let (in_x, in_y) = (x % 80, y % 80);
            let door = |i: u32, at: u32| (doors[i as usize % 400]..doors[i as usize % 400] + 20).contains(&at);
            let number = room(x) * 13 + room(y);
            let wall = (in_x == 0 && !door(number, in_y)) || (in_y == 0 && !door(number + 200, in_x));
            let (bx, by) = (doors[(number as usize + 57) % 400], doors[(number as usize + 91) % 400]);
            let inside = (bx..bx + 12).contains(&in_x) && (by..by + 8).contains(&in_y);
            if wall || inside {
                grid[Cell::new(x, y)] = Occupancy::OCCUPIED;
            }
        }
    }
    grid
}

fn map() -> OccupancyGrid {
    match std::env::var_os("ZENAV_BENCH_MAP") {
        Some(path) => read_map(std::path::Path::new(&path), 0.05).expect("a map"),
        None => house(),
    }
}

/// Segments of a length that start at a free point and end inside the grid.
fn segments(sight: &impl LineOfSight, length: f64) -> Vec<[Point2<f64>; 2]> {
    let [width, height] = sight.size().map(f64::from);
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut segments = Vec::new();
    while segments.len() < SEGMENTS {
        let a = Point2::new(random.random_range(0.0..width), random.random_range(0.0..height));
        let angle = random.random_range(0.0..std::f64::consts::TAU);
        let b = a + Vector2::new(angle.cos(), angle.sin()) * length;
        if sight.admits(a) && b.x > 0.0 && b.y > 0.0 && b.x < width && b.y < height {
            segments.push([a, b]);
        }
    }
    segments
}

/// A walk from cell to cell that tests both cells beside a corner, as planners do that know a map only by its cells.
fn walk(free: &[bool], width: i64, height: i64, a: Point2<f64>, b: Point2<f64>) -> bool {
    let is_free = |x: i64, y: i64| x >= 0 && y >= 0 && x < width && y < height && free[(y * width + x) as usize];
    let (mut x, mut y) = (a.x as i64, a.y as i64);
    let (last_x, last_y) = (b.x as i64, b.y as i64);
    let axis = |from: f64, cell: i64, d: f64| {
        if d > 0.0 {
            (1, ((cell + 1) as f64 - from) / d, 1.0 / d)
        } else {
            (-1, (from - cell as f64) / -d, -1.0 / d)
        }
    };
    let (step_x, mut next_x, delta_x) = axis(a.x, x, b.x - a.x);
    let (step_y, mut next_y, delta_y) = axis(a.y, y, b.y - a.y);
    if !is_free(x, y) {
        return false;
    }
    while x != last_x || y != last_y {
        if (next_x - next_y).abs() < 1e-12 {
            if !is_free(x + step_x, y) || !is_free(x, y + step_y) {
                return false;
            }
            (x, y, next_x, next_y) = (x + step_x, y + step_y, next_x + delta_x, next_y + delta_y);
        } else if next_x < next_y {
            (x, next_x) = (x + step_x, next_x + delta_x);
        } else {
            (y, next_y) = (y + step_y, next_y + delta_y);
        }
        if !is_free(x, y) {
            return false;
        }
    }
    true
}

fn points(criterion: &mut Criterion<ThreadTime>) {
    let grid = map();
    let spec = *grid.spec();
    let free = BitGrid::from_fn(spec.width, spec.height, |cell| {
        Occupancy::of(grid[cell]) == Occupancy::Free
    });
    let cells: Vec<bool> = grid
        .values()
        .iter()
        .map(|value| Occupancy::of(*value) == Occupancy::Free)
        .collect();
    criterion.bench_function("PointLineOfSight::new", |bencher| {
        bencher.iter(|| PointLineOfSight::new(&free));
    });
    let sight = PointLineOfSight::new(&free);
    for only_seen in [false, true] {
        let title = if only_seen { "point, in sight" } else { "point" };
        let mut group = criterion.benchmark_group(title);
        group.throughput(Throughput::Elements(SEGMENTS as u64));
        for length in [5, 20, 80, 320] {
            let mut segments = segments(&sight, length.into());
            if only_seen {
                segments.retain(|[a, b]| sight.sees(*a, *b));
                segments = segments
                    .iter()
                    .copied()
                    .cycle()
                    .take(if segments.is_empty() { 0 } else { SEGMENTS })
                    .collect();
            }
            let seen = segments.iter().filter(|[a, b]| sight.sees(*a, *b)).count();
            eprintln!("{length} cells: {seen} of {} seen", segments.len());
            pair(title, ["words", "walk"], length);
            let (width, height) = (i64::from(spec.width), i64::from(spec.height));
            group.bench_function(BenchmarkId::new("words", length), |bencher| {
                bencher.iter(|| black_box(segments.iter().filter(|[a, b]| sight.sees(*a, *b)).count()));
            });
            group.bench_function(BenchmarkId::new("walk", length), |bencher| {
                bencher.iter(|| {
                    black_box(
                        segments
                            .iter()
                            .filter(|[a, b]| walk(&cells, width, height, *a, *b))
                            .count(),
                    )
                });
            });
        }
        group.finish();
    }
}

fn discs(criterion: &mut Criterion<ThreadTime>) {
    let space = ConfigurationSpace::new(&map(), &Footprint::Radius(0.25), UnknownPolicy::Free, 0.0);
    let mut group = criterion.benchmark_group("disc");
    group.throughput(Throughput::Elements(SEGMENTS as u64));
    for length in [5, 20, 80, 320] {
        let segments = segments(&space, length.into());
        let seen = segments.iter().filter(|[a, b]| space.sees(*a, *b)).count();
        eprintln!("{length} cells: {seen} of {} seen", segments.len());
        pair("disc", ["hops", "measured"], length);
        group.bench_function(BenchmarkId::new("hops", length), |bencher| {
            bencher.iter(|| black_box(segments.iter().filter(|[a, b]| space.sees(*a, *b)).count()));
        });
        group.bench_function(BenchmarkId::new("measured", length), |bencher| {
            let spec = *space.spec();
            bencher.iter(|| {
                let free = segments
                    .iter()
                    .filter(|[a, b]| space.segment_is_free(spec.from_cells(*a), spec.from_cells(*b), space.radius()));
                black_box(free.count())
            });
        });
    }
    group.finish();
}

/// Names the slower way of the two as a peer.
fn pair(group: &str, [ours, theirs]: [&str; 2], length: u32) {
    Pair::new(
        format!("{group}/{ours}/{length}"),
        theirs,
        format!("{group}/{theirs}/{length}"),
    )
    .print();
}

criterion_group! {
    name = benches;
    config = on_thread_time();
    targets = points, discs
}
criterion_main!(benches);
