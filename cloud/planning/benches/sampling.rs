//! Sampling planners compared with OMPL's: time, success rate, path length. `cargo bench -p zenav-planning --bench sampling [-- MAP…]`
//!
//! Maps are files that the stack reads (`.map`, `.yaml`, `.pgm`, `.png`); without any, three generated ones. A scenario `MAP.scen` beside
//! a map gives its ten hardest queries; otherwise they are the longest of many random ones. Lengths are relative to the shortest path on
//! the grid, which knows eight directions and cuts no corners.
//!
//! With `OMPL_PEER` (a program built from `benches/peers/ompl.cpp`) the peer answers the same queries with the same exact checks. Both
//! sides get one run for each query and seed, with memory of their own that no search before has used, and the same processor time: two
//! seconds for a first path, half a second in total for planners that improve theirs. Both are stopped by a flag that another thread sets.
//! `RUNS` seeds are drawn (default 3). All rows are printed. `samples` are those drawn by ours, and the vertices of OMPL's trees.
//!
//! | row | is |
//! |---|---|
//! | `zenav textbook NAME` | the algorithm as published: the map is a black box that answers lines of sight; raw path |
//! | `zenav NAME` | the planner as users get it: samples in free cells, a sweep over the bitmap's free runs, string pulling |
//! | `ompl NAME` | OMPL's planner, raw path |
//! | `ompl NAME + simplify` | the same with OMPL's `simplifySolution`, its time included |

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a bench stops at the first thing that is not as it should be, and prints"
)]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use rand::Rng as _;
use rand_pcg::Pcg64Mcg;
use zenav_mapping::{cell_from_top, parse_moving_ai_map, parse_moving_ai_scenarios, read_map};
use zenav_planning::{Budget, Planner, Query, Searcher};
use zenav_protocol::grid::{Cell, Occupancy};
use zenav_space::{BitGrid, LineOfSight as _, PointLineOfSight};

/// Queries per map.
const QUERIES: usize = 10;
/// Random queries that the longest are chosen from.
const DRAWN: usize = 2000;

fn main() {
    let arguments = std::env::args().skip(1).filter(|argument| !argument.starts_with("--"));
    let mut terrains: Vec<Terrain> = arguments.map(|path| Terrain::read(Path::new(&path))).collect();
    if terrains.is_empty() {
        let made = [("maze", maze()), ("rooms", rooms()), ("caves", caves())];
        terrains = made
            .into_iter()
            .map(|(name, free)| Terrain::new(name.to_owned(), free, None))
            .collect();
    }
    let peer = std::env::var_os("OMPL_PEER").map(PathBuf::from);
    let runs: u64 = std::env::var("RUNS").map_or(3, |runs| runs.parse().unwrap());
    let watch = Watch::start();
    for (planner, peers) in ROWS {
        println!(
            "\n{:18} {:28} {:>7} {:>11} {:>11} {:>8} {:>8} {:>9}",
            planner, "", "found", "median ms", "95 % ms", "length", "longest", "samples"
        );
        for terrain in &terrains {
            let row = |name: String, figures: Figures| println!("{:18} {name:28} {figures}", terrain.name);
            for black_box in [true, false] {
                let name = if black_box { "zenav textbook" } else { "zenav" };
                row(
                    format!("{name} {planner}"),
                    terrain.own(*planner, black_box, runs, &watch),
                );
            }
            let Some(peer) = &peer else { continue };
            for name in *peers {
                let [raw, simplified] = terrain.peer(peer, name, runs);
                row(format!("ompl {name}"), raw);
                row(format!("ompl {name} + simplify"), simplified);
            }
        }
    }
}

/// Our planners, each with its peers in OMPL.
const ROWS: &[(Planner, &[&str])] = &[
    (Planner::Rrt, &["rrt"]),
    (Planner::RrtConnect, &["rrt_connect"]),
    (Planner::RrtStar, &["rrt_star", "informed", "bit_star"]),
];

/// Processor time of a search, s.
fn limit(planner: &str) -> f64 {
    if ["rrt", "rrt_connect"].contains(&planner) {
        2.0
    } else {
        0.5
    }
}

/// A map with its queries.
struct Terrain {
    name: String,
    grid: BitGrid,
    sight: PointLineOfSight,
    /// Start, goal, length of the shortest path on the grid.
    queries: Vec<(Cell, Cell, f64)>,
}

impl Terrain {
    fn read(path: &Path) -> Self {
        let grid = if path.extension().is_some_and(|ending| ending == "map") {
            parse_moving_ai_map(&std::fs::read(path).unwrap(), 0.05).unwrap()
        } else {
            read_map(path, 0.05).unwrap()
        };
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let free = BitGrid::from_fn(grid.spec().width, grid.spec().height, |cell| {
            Occupancy::of(grid[cell]) == Occupancy::Free
        });
        let scenario = PathBuf::from(format!("{}.scen", path.display()));
        let queries = scenario.exists().then(|| {
            let mut all = parse_moving_ai_scenarios(&std::fs::read(&scenario).unwrap()).unwrap();
            all.sort_by(|a, b| b.optimum.total_cmp(&a.optimum));
            let cell = |at| cell_from_top(grid.spec(), at).unwrap();
            all.iter()
                .take(QUERIES)
                .map(|query| (cell(query.start), cell(query.goal), query.optimum))
                .collect()
        });
        Self::new(name, free, queries)
    }

    fn new(name: String, free: BitGrid, queries: Option<Vec<(Cell, Cell, f64)>>) -> Self {
        let sight = PointLineOfSight::new(&free);
        let queries = queries.unwrap_or_else(|| longest(&free));
        Self {
            name,
            grid: free,
            sight,
            queries,
        }
    }

    fn own(&self, planner: Planner, black_box: bool, runs: u64, watch: &Watch) -> Figures {
        let mut figures = Figures::default();
        for seed in 1..=runs {
            for (start, goal, optimum) in &self.queries {
                let query = Query {
                    start: start.center(),
                    goal: goal.center(),
                    seed,
                };
                let budget = Budget {
                    cancel: Some(&watch.cancel),
                    ..Budget::UNLIMITED
                };
                let mut searcher = Searcher::new(&self.grid).unwrap();
                searcher.black_box = black_box;
                searcher.sampling.improving = u64::MAX;
                watch.arm(limit(planner.name()));
                let begin = now();
                let searched = searcher.search(planner, &self.sight, &query, budget);
                let took = now() - begin;
                watch.disarm();
                let length = searched.result.ok().map(|path| {
                    let corners = &path.corners;
                    assert!(
                        corners.windows(2).all(|leg| self.sight.sees(leg[0], leg[1])),
                        "not free"
                    );
                    assert!(corners[0] == query.start && corners[corners.len() - 1] == query.goal);
                    path.length
                });
                figures.add(took, length.map(|length| length / optimum), searched.expansions);
            }
        }
        figures
    }

    /// The raw paths, and the simplified ones.
    fn peer(&self, program: &Path, planner: &str, runs: u64) -> [Figures; 2] {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        let [width, height] = [self.grid.width(), self.grid.height()];
        let mut text = format!("type octile\nheight {height}\nwidth {width}\nmap\n");
        for y in (0..height).rev() {
            text.extend((0..width).map(|x| if self.grid.get(Cell::new(x, y)) { '.' } else { '@' }));
            text.push('\n');
        }
        std::fs::write(file("map"), text).unwrap();
        let from_top = |cell: Cell| format!("{} {}", cell.x, height - 1 - cell.y);
        let lines: Vec<String> = self
            .queries
            .iter()
            .map(|(a, b, length)| format!("{} {} {length}\n", from_top(*a), from_top(*b)))
            .collect();
        std::fs::write(file("queries"), lines.concat()).unwrap();
        let mut figures = [Figures::default(), Figures::default()];
        for seed in 1..=runs {
            let status = Command::new(program)
                .args([file("map"), file("queries")])
                .args([planner, &limit(planner).to_string()])
                .arg(file("results"))
                .arg(seed.to_string())
                .status()
                .unwrap();
            assert!(status.success());
            let results = std::fs::read_to_string(file("results")).unwrap();
            for (line, (_, _, optimum)) in results.lines().zip(&self.queries) {
                let numbers: Vec<f64> = line.split_whitespace().map(|word| word.parse().unwrap()).collect();
                let is_found = numbers[2] == 1.0;
                let samples = numbers[3] as u64;
                let ratio = |length: f64| is_found.then(|| length / optimum);
                figures[0].add(1e-6 * numbers[0], ratio(numbers[1]), samples);
                figures[1].add(1e-6 * (numbers[0] + numbers[6]), ratio(numbers[7]), samples);
            }
        }
        figures
    }
}

/// The longest of many random queries.
fn longest(free: &BitGrid) -> Vec<(Cell, Cell, f64)> {
    let mut rng = Pcg64Mcg::new(1);
    let cells: Vec<Cell> = (0..free.height())
        .flat_map(|y| free.set_in_row(y, 0, i64::MAX).map(move |x| Cell::new(x, y)))
        .collect();
    let mut searcher = Searcher::new(free).unwrap();
    let sight = PointLineOfSight::new(free);
    let mut found: Vec<(Cell, Cell, f64)> = (0..DRAWN)
        .filter_map(|_| {
            let [start, goal] = [(); 2].map(|()| cells[rng.next_u64() as usize % cells.len()]);
            let query = Query {
                start: start.center(),
                goal: goal.center(),
                seed: 0,
            };
            let path = searcher
                .search(Planner::Jps, &sight, &query, Budget::UNLIMITED)
                .result
                .ok()?;
            Some((start, goal, path.length))
        })
        .collect();
    found.sort_by(|a, b| b.2.total_cmp(&a.2));
    found.truncate(QUERIES);
    found
}

/// Results of many searches.
#[derive(Default)]
struct Figures {
    /// Times, s; always sorted.
    times: Vec<f64>,
    /// Path lengths relative to the shortest on the grid; always sorted.
    ratios: Vec<f64>,
    /// Samples drawn, or vertices made.
    samples: Vec<u64>,
}

impl Figures {
    fn add(&mut self, time: f64, ratio: Option<f64>, samples: u64) {
        self.times.push(time);
        self.times.sort_by(f64::total_cmp);
        self.ratios.extend(ratio);
        self.ratios.sort_by(f64::total_cmp);
        self.samples.push(samples);
        self.samples.sort_unstable();
    }

    /// A quantile, ms.
    fn time(&self, share: f64) -> f64 {
        1e3 * self.times[(share * (self.times.len() - 1) as f64).round() as usize]
    }
}

impl std::fmt::Display for Figures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let ratio = |share: f64| {
            let last = self.ratios.len().saturating_sub(1) as f64;
            let found = self.ratios.get((share * last).round() as usize);
            found.map_or_else(|| "-".to_owned(), |ratio| format!("{ratio:.4}"))
        };
        write!(
            f,
            "{:>7} {:>11.4} {:>11.4} {:>8} {:>8} {:>9}",
            format!("{}/{}", self.ratios.len(), self.times.len()),
            self.time(0.5),
            self.time(0.95),
            ratio(0.5),
            ratio(1.0),
            self.samples[self.samples.len() / 2]
        )
    }
}

/// Corridors of five cells between walls of one, without loops: a random walk that backtracks at dead ends.
fn maze() -> BitGrid {
    const ROOMS: i64 = 60;
    let mut rng = Pcg64Mcg::new(3);
    let mut free = BitGrid::new(6 * ROOMS as u32 + 1, 6 * ROOMS as u32 + 1);
    let open = |free: &mut BitGrid, x: i64, y: i64, width: i64, height: i64| {
        for cell in (0..width * height).map(|i| Cell::new((x + i % width) as u32, (y + i / width) as u32)) {
            free.set(cell, true);
        }
    };
    let mut path = vec![(0, 0)];
    while let Some((x, y)) = path.last().copied() {
        open(&mut free, 6 * x + 1, 6 * y + 1, 5, 5);
        let closed = |(dx, dy): &(i64, i64)| {
            let (x, y) = (x + dx, y + dy);
            let inside = (0..ROOMS).contains(&x) && (0..ROOMS).contains(&y);
            inside && !free.get(Cell::new(6 * x as u32 + 1, 6 * y as u32 + 1))
        };
        let next: Vec<(i64, i64)> = [(1, 0), (-1, 0), (0, 1), (0, -1)].into_iter().filter(closed).collect();
        if next.is_empty() {
            path.pop();
            continue;
        }
        let (dx, dy) = next[rng.next_u64() as usize % next.len()];
        let (width, height) = if dx == 0 { (5, 1) } else { (1, 5) };
        open(
            &mut free,
            6 * x + 1 + dx.max(0) * 5 + dx.min(0),
            6 * y + 1 + dy.max(0) * 5 + dy.min(0),
            width,
            height,
        );
        path.push((x + dx, y + dy));
    }
    free
}

/// Rooms of 24 cells; two of three walls have a door of one cell.
fn rooms() -> BitGrid {
    let mut rng = Pcg64Mcg::new(5);
    let mut free = BitGrid::from_fn(501, 501, |cell| {
        !cell.x.is_multiple_of(25) && !cell.y.is_multiple_of(25)
    });
    for wall in 0..20 * 19 * 2 {
        let (across, along) = (
            25 * (wall / 2 % 19 + 1),
            25 * (wall / 38) + 1 + rng.next_u64() as u32 % 24,
        );
        if !rng.next_u64().is_multiple_of(3) {
            free.set(
                if wall % 2 == 0 {
                    Cell::new(across, along)
                } else {
                    Cell::new(along, across)
                },
                true,
            );
        }
    }
    free
}

/// Random noise after five rounds of majority smoothing over 3 x 3 cells.
fn caves() -> BitGrid {
    let mut rng = Pcg64Mcg::new(7);
    let mut free = BitGrid::from_fn(600, 400, |_| rng.next_u64() % 100 < 56);
    for _ in 0..5 {
        let is_free = |cell: Cell, i: u32| {
            free.get(Cell::new(
                (cell.x + i % 3).wrapping_sub(1),
                (cell.y + i / 3).wrapping_sub(1),
            ))
        };
        free = BitGrid::from_fn(600, 400, |cell| (0..9).filter(|i| is_free(cell, *i)).count() >= 5);
    }
    free
}

/// This thread's processor time, s.
fn now() -> f64 {
    seconds(rustix::time::ClockId::ThreadCPUTime)
}

fn seconds(clock: rustix::time::ClockId) -> f64 {
    let time = rustix::time::clock_gettime(clock);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Sets the cancel flag when the process has used its time.
struct Watch {
    cancel: Arc<AtomicBool>,
    /// Processor time of the process at which to cancel, s, as the bits of an `f64`.
    until: Arc<AtomicU64>,
}

impl Watch {
    fn start() -> Self {
        let watch = Self {
            cancel: Arc::default(),
            until: Arc::new(AtomicU64::new(f64::INFINITY.to_bits())),
        };
        let (cancel, until) = (Arc::clone(&watch.cancel), Arc::clone(&watch.until));
        std::thread::spawn(move || {
            loop {
                std::thread::sleep(Duration::from_micros(500));
                if seconds(rustix::time::ClockId::ProcessCPUTime) >= f64::from_bits(until.load(Ordering::Relaxed)) {
                    cancel.store(true, Ordering::Relaxed);
                }
            }
        });
        watch
    }

    fn arm(&self, limit: f64) {
        let until = seconds(rustix::time::ClockId::ProcessCPUTime) + limit;
        self.until.store(until.to_bits(), Ordering::Relaxed);
        self.cancel.store(false, Ordering::Relaxed);
    }

    fn disarm(&self) {
        self.until.store(f64::INFINITY.to_bits(), Ordering::Relaxed);
    }
}
