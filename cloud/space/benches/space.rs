//! Time to build, to update and to query the configuration space. `cargo bench -p zenav-space --bench space`
//!
//! Each transform is compared with a plain textbook version on the same map in the same run: the truncated one with the textbook's
//! truncated one (Saito and Toriwaki, 1994: two passes down the columns, a window along the rows, 16 bits a cell), the unbounded one with
//! the textbook's unbounded one (Felzenszwalb and Huttenlocher, "Distance Transforms of Sampled Functions", 2012: 32 bits a cell, as
//! ours). The footprint's queries are compared with parry's on a tree over the same squares: a box for each cell (`cells`), and cells joined
//! to fewer boxes (`boxes`). Both must give the same answers. The space and the trees are built beforehand, and that is timed by itself: the
//! space holds a distance field of about a metre, with which it answers far from obstacles; `within reach` gives parry the same limit.
//! Times are the thread's own CPU time, independent of other load.

#![allow(missing_docs, reason = "criterion's macros")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a bench stops at the first thing that is not as it should be"
)]

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::hint::black_box;
use std::sync::Arc;

use criterion::{BatchSize, BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::Point2;
use parry2d_f64::math::{Pose, Vector};
use parry2d_f64::query::{ClosestPoints, DefaultQueryDispatcher, QueryDispatcher as _};
use parry2d_f64::shape::{Capsule, Compound, ConvexPolygon, SharedShape};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use zenav_fixtures::{Pair, ThreadTime, on_thread_time};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::map_replica::{MapReplica, PatchResult};
use zenav_protocol::messages::{MapInfo, MapPatch, MapRef, MapReply, TILE, Tile};
use zenav_protocol::robot::Footprint;
use zenav_protocol::time::Stamp;
use zenav_space::{BitGrid, ConfigurationSpace, DistanceField, SpaceCache, UnknownPolicy, squared_distances};

const SIDES: [u32; 2] = [1000, 4000];
/// Reach, cells.
const REACH: u32 = 10;
/// An outline with its base off its middle, m. For a rectangle parry has a shorter way, for others it has not.
const OUTLINE: [(f64, f64); 5] = [(-0.4, -0.15), (0.1, -0.18), (0.2, 0.0), (0.1, 0.18), (-0.4, 0.15)];
/// Number of poses of the footprint.
const POSES: usize = 1000;
/// A disc's radius, and the length of its ways, m.
const DISC: f64 = 0.25;
const WAY: f64 = 2.0;
/// parry's distances are iterated: they equal ours to within this, m.
const TOLERANCE: f64 = 1e-6;

fn spec(side: u32) -> GridSpec {
    zenav_fixtures::spec(side, side, 0.05)
}

/// Rooms of 5 m by 4 m with doors of 0.9 m, corridors, and tables in most rooms.
fn office(side: u32) -> BitGrid {
    BitGrid::from_fn(side, side, |Cell { x, y }| {
        let (u, v) = (x % 100, y % 110);
        let wall = (u == 0 && v <= 80 && !(30..48).contains(&v)) || ((v == 0 || v == 80) && !(60..78).contains(&u));
        let table = (40..60).contains(&u) && (20..36).contains(&v) && (x / 100 + y / 110) % 3 != 0;
        wall || table
    })
}

/// Obstacles of each kind of map.
fn maps(side: u32) -> [(&'static str, BitGrid); 4] {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut random = |share: f64| BitGrid::from_fn(side, side, |_| rng.random_bool(share));
    let (dense, sparse) = (random(0.2), random(0.01));
    [
        ("random 20 %", dense),
        ("random 1 %", sparse),
        ("office", office(side)),
        ("empty", BitGrid::new(side, side)),
    ]
}

/// The textbook's transforms: squared distances from centre to centre, cells.
mod textbook {
    use zenav_protocol::grid::Cell;
    use zenav_space::BitGrid;

    const FAR: f32 = 1e12;

    /// One dimension: the lower envelope of parabolas.
    fn line(f: &[f32], out: &mut [f32], v: &mut [usize], z: &mut [f32]) {
        let (n, mut k) = (f.len(), 0);
        (v[0], z[0], z[1]) = (0, f32::NEG_INFINITY, f32::INFINITY);
        for q in 1..n {
            let meet =
                |p: usize| ((f[q] + (q * q) as f32) - (f[p] + (p * p) as f32)) / (2.0 * q as f32 - 2.0 * p as f32);
            let mut s = meet(v[k]);
            while s <= z[k] {
                k -= 1;
                s = meet(v[k]);
            }
            k += 1;
            (v[k], z[k], z[k + 1]) = (q, s, f32::INFINITY);
        }
        k = 0;
        for (q, out) in out.iter_mut().enumerate() {
            while z[k + 1] < q as f32 {
                k += 1;
            }
            let d = q as f32 - v[k] as f32;
            *out = d * d + f[v[k]];
        }
    }

    /// Distances up to a reach, cells; its square stands for everything farther.
    pub fn truncated(obstacles: &BitGrid, reach: u16) -> Vec<u16> {
        let (width, height) = (obstacles.width() as usize, obstacles.height() as usize);
        let cell = |x: usize, y: usize| Cell::new(x as u32, y as u32);
        // Distance along the column, from below and from above.
        let mut columns = vec![reach; width * height];
        for y in 0..height {
            for x in 0..width {
                let below = if y > 0 { columns[(y - 1) * width + x] } else { reach };
                columns[y * width + x] = if obstacles.get(cell(x, y)) {
                    0
                } else {
                    reach.min(below + 1)
                };
            }
        }
        for y in (0..height.saturating_sub(1)).rev() {
            for x in 0..width {
                let above = columns[(y + 1) * width + x] + 1;
                columns[y * width + x] = columns[y * width + x].min(above);
            }
        }
        let window = usize::from(reach);
        let mut out = vec![reach * reach; width * height];
        for y in 0..height {
            let row = &columns[y * width..][..width];
            for (x, out) in out[y * width..][..width].iter_mut().enumerate() {
                let (first, last) = (x.saturating_sub(window), (x + window).min(width - 1));
                for (from, column) in row.iter().enumerate().take(last + 1).skip(first) {
                    let along = x.abs_diff(from) as u16;
                    *out = (*out).min(along * along + column * column);
                }
            }
        }
        out
    }

    /// Distances without a limit.
    pub fn squared_distances(obstacles: &BitGrid) -> Vec<f32> {
        let (width, height) = (obstacles.width() as usize, obstacles.height() as usize);
        let cell = |i: usize| Cell::new((i % width) as u32, (i / width) as u32);
        let mut grid: Vec<f32> = (0..width * height)
            .map(|i| if obstacles.get(cell(i)) { 0.0 } else { FAR })
            .collect();
        let longest = width.max(height);
        let (mut f, mut out) = (vec![0.0; longest], vec![0.0; longest]);
        let (mut v, mut z) = (vec![0; longest], vec![0.0; longest + 1]);
        for x in 0..width {
            for y in 0..height {
                f[y] = grid[y * width + x];
            }
            line(&f[..height], &mut out[..height], &mut v, &mut z);
            for y in 0..height {
                grid[y * width + x] = out[y];
            }
        }
        for y in 0..height {
            f[..width].copy_from_slice(&grid[y * width..][..width]);
            line(&f[..width], &mut grid[y * width..][..width], &mut v, &mut z);
        }
        grid
    }
}

fn distance(c: &mut Criterion<ThreadTime>) {
    for side in SIDES {
        let mut group = c.benchmark_group(format!("distance {side}x{side}"));
        group.sample_size(if side > 2000 { 10 } else { 50 });
        for (name, obstacles) in maps(side) {
            let at = |function: &str| format!("distance {side}x{side}/{function}/{name}");
            for ours in ["to 10 cells", "unbounded"] {
                Pair::new(at(ours), "textbook", at(&format!("textbook, {ours}"))).print();
            }
            group.bench_with_input(BenchmarkId::new("to 10 cells", name), &obstacles, |b, obstacles| {
                b.iter_with_large_drop(|| DistanceField::new(spec(side), obstacles, REACH));
            });
            group.bench_with_input(
                BenchmarkId::new("textbook, to 10 cells", name),
                &obstacles,
                |b, obstacles| {
                    b.iter_with_large_drop(|| textbook::truncated(obstacles, REACH as u16));
                },
            );
            group.bench_with_input(BenchmarkId::new("unbounded", name), &obstacles, |b, obstacles| {
                b.iter_with_large_drop(|| squared_distances(obstacles));
            });
            group.bench_with_input(
                BenchmarkId::new("textbook, unbounded", name),
                &obstacles,
                |b, obstacles| {
                    b.iter_with_large_drop(|| textbook::squared_distances(obstacles));
                },
            );
        }
    }
}

fn vector(point: Point2<f64>) -> Vector {
    Vector::new(point.x, point.y)
}

/// Set cells as few boxes: runs of a row, joined with equal runs of the rows above. First column and row, and those past the last.
fn joined(cells: &BitGrid) -> Vec<[u32; 4]> {
    let mut boxes = Vec::new();
    // Runs of the row below, and the row in which each begins.
    let mut open: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    for y in 0..=cells.height() {
        let mut runs: Vec<(u32, u32)> = Vec::new();
        for x in cells.set_in_row(y, 0, i64::MAX) {
            match runs.last_mut() {
                Some((_, end)) if *end == x => *end += 1,
                _ => runs.push((x, x + 1)),
            }
        }
        let mut next = BTreeMap::new();
        for run in runs {
            next.insert(run, open.remove(&run).unwrap_or(y));
        }
        boxes.extend(open.into_iter().map(|((left, right), low)| [left, low, right, y]));
        open = next;
    }
    boxes
}

/// A tree of parry's over boxes in cells of a grid.
fn tree(boxes: &[[u32; 4]], spec: &GridSpec) -> Compound {
    let placed = boxes.iter().map(|sides| {
        let [left, low, right, high] = sides.map(|at| f64::from(at) * spec.resolution);
        let shape = SharedShape::cuboid(0.5 * (right - left), 0.5 * (high - low));
        (Pose::translation(0.5 * (left + right), 0.5 * (low + high)), shape)
    });
    Compound::new(placed.collect())
}

/// Clearance of a footprint, whether it fits, and whether a disc passes.
fn footprint(c: &mut Criterion<ThreadTime>) {
    let spec = spec(SIDES[0]);
    let footprint = zenav_fixtures::footprint(&OUTLINE);
    let corners = OUTLINE.map(|(x, y)| Vector::new(x, y)).to_vec();
    let body = ConvexPolygon::from_convex_polyline_unmodified(corners).unwrap();
    let placed = |pose: Pose2| Pose::new(vector(pose.position()), pose.yaw);
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let side = f64::from(spec.width) * spec.resolution;
    let mut at = || rng.random_range(0.0..side);
    let places: Vec<Point2<f64>> = (0..POSES).map(|_| Point2::new(at(), at())).collect();
    let poses: Vec<Pose2> = places
        .iter()
        .map(|place| Pose2::new(place.x, place.y, rng.random_range(-PI..PI)))
        .collect();
    let ends: Vec<Point2<f64>> = poses
        .iter()
        .map(|pose| pose.position() + pose.heading() * WAY)
        .collect();
    let ways: Vec<(Point2<f64>, Point2<f64>)> = places.into_iter().zip(ends).collect();
    let chosen = |(name, _): &(&str, BitGrid)| matches!(*name, "office" | "random 1 %");
    for (name, obstacles) in maps(SIDES[0]).into_iter().filter(chosen) {
        let mut grid = OccupancyGrid::filled(spec, Occupancy::FREE);
        let mut squares = Vec::new();
        for y in 0..spec.height {
            for x in obstacles.set_in_row(y, 0, i64::MAX) {
                grid[Cell::new(x, y)] = Occupancy::OCCUPIED;
                squares.push([x, y, x + 1, y + 1]);
            }
        }
        let space = ConfigurationSpace::new(&grid, &footprint, UnknownPolicy::Free, 0.0);
        let trees = [
            ("cells", tree(&squares, &spec)),
            ("boxes", tree(&joined(&obstacles), &spec)),
        ];
        let distance = |tree: &Compound, pose: Pose2| {
            let found = DefaultQueryDispatcher.distance(&placed(pose), tree, &body);
            found.unwrap().distance
        };
        let within_reach = |tree: &Compound, pose: Pose2| {
            let pose = placed(pose);
            let found = DefaultQueryDispatcher.closest_points(&pose, tree, &body, space.reach());
            match found.unwrap() {
                ClosestPoints::Intersecting => 0.0,
                ClosestPoints::WithinMargin(on_map, on_body) => (on_map - pose * on_body).length(),
                ClosestPoints::Disjoint => space.reach(),
            }
        };
        let fits = |tree: &Compound, pose: Pose2| {
            let found = DefaultQueryDispatcher.intersection_test(&placed(pose), tree, &body);
            !found.unwrap().intersecting
        };
        let passes = |tree: &Compound, a: Point2<f64>, b: Point2<f64>| {
            let swept = Capsule::new(vector(a), vector(b), DISC);
            let found = DefaultQueryDispatcher.intersection_test(&Pose::IDENTITY, tree, &swept);
            !found.unwrap().intersecting
        };
        for (boxes, tree) in &trees {
            for pose in &poses {
                let clearance = space.footprint_clearance(*pose);
                for theirs in [distance(tree, *pose).min(space.reach()), within_reach(tree, *pose)] {
                    assert!(
                        (clearance - theirs).abs() < TOLERANCE,
                        "{name}, {boxes}, {pose:?}: {clearance} m, parry's {theirs} m"
                    );
                }
                assert_eq!(space.is_valid(*pose), fits(tree, *pose), "{name}, {boxes}, {pose:?}");
            }
            for (a, b) in &ways {
                let ours = space.segment_is_free(*a, *b, DISC);
                assert_eq!(ours, passes(tree, *a, *b), "{name}, {boxes}, {a} to {b}");
            }
        }

        let title = format!("footprint, built, {name}");
        let mut group = c.benchmark_group(&title);
        group.sample_size(10);
        group.bench_function(OWN, |b| {
            b.iter_with_large_drop(|| ConfigurationSpace::new(&grid, &footprint, UnknownPolicy::Free, 0.0));
        });
        for (boxes, sides) in [("cells", &squares), ("boxes", &joined(&obstacles))] {
            let function = format!("parry, {boxes}");
            pair(&title, &function);
            group.bench_function(function, |b| b.iter_with_large_drop(|| tree(sides, &spec)));
        }
        group.finish();

        let title = format!("footprint, {POSES} clearances, {name}");
        let mut group = c.benchmark_group(&title);
        group.sample_size(20);
        group.bench_function(OWN, |b| {
            b.iter(|| poses.iter().map(|pose| space.footprint_clearance(*pose)).sum::<f64>());
        });
        for (boxes, tree) in &trees {
            let function = format!("parry, {boxes}");
            pair(&title, &function);
            group.bench_function(function, |b| {
                b.iter(|| poses.iter().map(|pose| distance(tree, *pose)).sum::<f64>());
            });
            let function = format!("parry within reach, {boxes}");
            pair(&title, &function);
            group.bench_function(function, |b| {
                b.iter(|| poses.iter().map(|pose| within_reach(tree, *pose)).sum::<f64>());
            });
        }
        group.finish();

        let title = format!("footprint, {POSES} fits, {name}");
        let mut group = c.benchmark_group(&title);
        group.sample_size(20);
        group.bench_function(OWN, |b| {
            b.iter(|| poses.iter().filter(|pose| space.is_valid(**pose)).count());
        });
        for (boxes, tree) in &trees {
            let function = format!("parry, {boxes}");
            pair(&title, &function);
            group.bench_function(function, |b| {
                b.iter(|| poses.iter().filter(|pose| fits(tree, **pose)).count());
            });
        }
        group.finish();

        let title = format!("disc, {POSES} ways, {name}");
        let mut group = c.benchmark_group(&title);
        group.sample_size(20);
        group.bench_function(OWN, |bencher| {
            bencher.iter(|| ways.iter().filter(|(a, b)| space.segment_is_free(*a, *b, DISC)).count());
        });
        for (boxes, tree) in &trees {
            let function = format!("parry, {boxes}");
            pair(&title, &function);
            group.bench_function(function, |bencher| {
                bencher.iter(|| ways.iter().filter(|(a, b)| passes(tree, *a, *b)).count());
            });
        }
        group.finish();
    }
}

/// Our function in every group beside parry.
const OWN: &str = "rows of bits";

/// Names a function of parry's as the peer of ours in its group.
fn pair(group: &str, function: &str) {
    Pair::new(format!("{group}/{OWN}"), function, format!("{group}/{function}")).print();
}

/// The largest map that is required: offices in a corner of it and the rest open; then offices everywhere.
fn largest(c: &mut Criterion<ThreadTime>) {
    const SIDE: u32 = 16_384;
    let mut group = c.benchmark_group(format!("space {SIDE}x{SIDE}, radius 0.25 m"));
    group.sample_size(10);
    let footprint = Footprint::Radius(0.25);
    let office = office(SIDE);
    for (name, rows) in [("offices in 4 % of it", SIDE / 5), ("offices everywhere", SIDE)] {
        let mut grid = OccupancyGrid::filled(spec(SIDE), Occupancy::FREE);
        for y in 0..rows {
            for x in office.set_in_row(y, 0, i64::from(rows)) {
                grid[Cell::new(x, y)] = Occupancy::OCCUPIED;
            }
        }
        let space = ConfigurationSpace::new(&grid, &footprint, UnknownPolicy::Free, 0.0);
        eprintln!("{name}: {} MiB beside a map of 256 MiB", space.bytes() >> 20);
        drop(space);
        group.bench_function(name, |b| {
            b.iter_with_large_drop(|| ConfigurationSpace::new(&grid, &footprint, UnknownPolicy::Free, 0.0));
        });
    }
}

/// A map of offices, its replica at revision 1, and two patches of one tile, there and back.
fn mirrored(side: u32) -> (MapReplica, [MapPatch; 2]) {
    let spec = spec(side);
    let office = office(side);
    let mut grid = OccupancyGrid::filled(spec, Occupancy::FREE);
    for y in 0..side {
        for x in office.set_in_row(y, 0, i64::MAX) {
            grid[Cell::new(x, y)] = Occupancy::OCCUPIED;
        }
    }
    let map = |revision| MapRef::new("bench", revision);
    let mut mirror = MapReplica::new();
    assert!(mirror.replace(&MapReply {
        info: MapInfo {
            stamp: Stamp::ZERO,
            map: map(1),
            spec,
            free: 0,
            occupied: 0,
            unknown: 0,
            scans: 0,
            stored: false,
        },
        values: grid.values().to_vec(),
        trajectory: Vec::new(),
        stored: Vec::new(),
    }));
    let column = side / TILE / 2;
    let tile = |shift: u32| {
        let cells =
            (0..TILE * TILE).map(|i| Cell::new(column * TILE + i % TILE, column * TILE + (i / TILE + shift) % TILE));
        Tile {
            x: column,
            y: column,
            values: cells.map(|cell| grid[cell]).collect(),
        }
    };
    let patch = |base, tile| MapPatch {
        stamp: Stamp::ZERO,
        map: map(base + 1),
        base_revision: base,
        spec,
        tiles: vec![tile],
    };
    (mirror, [patch(1, tile(7)), patch(2, tile(0))])
}

/// Update of the space for a revision with one changed tile of 64 by 64 cells.
fn update(c: &mut Criterion<ThreadTime>) {
    let mut group = c.benchmark_group("space 1000x1000, radius 0.25 m");
    let footprint = Footprint::Radius(0.25);
    let (mirror, patches) = mirrored(1000);
    group.bench_function("anew", |b| {
        b.iter_with_large_drop(|| ConfigurationSpace::new(mirror.grid(), &footprint, UnknownPolicy::Free, 0.0));
    });
    for (name, held) in [("a tile, in place", false), ("a tile, others hold the last one", true)] {
        group.bench_function(name, |b| {
            b.iter_batched(
                || {
                    let (mut cache, mut mirror) = (SpaceCache::default(), mirror.clone());
                    let first = cache.get(&mirror, &footprint, UnknownPolicy::Free, zenav_space::Fit::Tight);
                    assert_eq!(mirror.apply(&patches[0]), PatchResult::Applied);
                    (cache, mirror, held.then(|| Arc::clone(&first)))
                },
                |(mut cache, mirror, held)| {
                    let space = cache.get(&mirror, &footprint, UnknownPolicy::Free, zenav_space::Fit::Tight);
                    (cache, mirror, held, black_box(space))
                },
                BatchSize::LargeInput,
            );
        });
    }
    let mut there = mirror.clone();
    let _ = there.apply(&patches[0]);
    let mut back = there.clone();
    assert_eq!(back.apply(&patches[1]), PatchResult::Applied);
    assert_eq!(back.grid(), mirror.grid(), "the second patch undoes the first");
}

criterion_group!(name = benches; config = on_thread_time(); targets = distance, footprint, update, largest);
criterion_main!(benches);
