use zenav_cloud::mapping::{map_file, moving_ai};
use zenav_cloud::planning::{Budget, Planner, Query, Searcher, plan};
use zenav_cloud::space::{BitGrid, PointSight, Sight, ConfigurationSpace, UnknownPolicy};
use zenav_protocol::grid::{Cell, Occupancy};
use zenav_protocol::robot::Footprint;
use nalgebra::Point2;
use rand::{RngExt as _, SeedableRng as _};
fn cpu() -> f64 { let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime); t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6 }
fn run(name: &str, searcher: &mut Searcher, sight: &impl Sight, queries: &[Query]) {
    let (mut n, mut worse, mut worst, mut ratio, mut times, mut jt, mut at, mut exp, mut corners) = (0, 0, 0.0_f64, 0.0, vec![], vec![], vec![], 0, 0);
    for q in queries {
        let t = cpu();
        let theta = searcher.search(Planner::Theta, sight, q, Budget::UNLIMITED);
        times.push(cpu() - t);
        let t = cpu();
        let jps = searcher.search(Planner::Jps, sight, q, Budget::UNLIMITED);
        jt.push(cpu() - t);
        let t = cpu();
        let astar = searcher.search(Planner::AStar, sight, q, Budget::UNLIMITED);
        at.push(cpu() - t);
        exp += theta.expansions;
        match (theta.result, jps.result) {
            (Ok(a), Ok(b)) => {
                for leg in a.corners.windows(2) { assert!(sight.sees(leg[0], leg[1]) , "{leg:?}"); }
                n += 1; let r = if b.length > 0.0 { a.length / b.length } else { 1.0 };
                ratio += r; corners += a.corners.len();
                if r > 1.0 + 1e-9 { worse += 1; worst = worst.max(r); }
            }
            (Err(a), Err(b)) => { assert_eq!(a, b); }
            other => panic!("{other:?} {q:?}"),
        }
        let _ = astar;
    }
    let med = |v: &mut Vec<f64>, s: f64| { v.sort_by(f64::total_cmp); v.get(((v.len() as f64) * s) as usize).copied().unwrap_or(f64::NAN) };
    println!("{name}: {n} ratio {:.5} worse {worse} worst {worst:.5} theta {:.3} p95 {:.3} jps {:.3} astar {:.3} p95 {:.3} exp/query {} corners {:.1}", ratio / n as f64, med(&mut times, 0.5), med(&mut times, 0.95), med(&mut jt, 0.5), med(&mut at, 0.5), med(&mut at, 0.95), exp / queries.len().max(1) as u64, corners as f64 / n as f64);
}
fn main() {
    let hard = std::env::var_os("HARD").is_some();
    for path in std::env::args().skip(1) {
        let path = std::path::PathBuf::from(path);
        let grid = map_file::read_map(&path, 0.05).unwrap();
        let spec = *grid.spec();
        let free = BitGrid::from_fn(spec.width, spec.height, |cell| Occupancy::of(grid[cell]) == Occupancy::Free);
        let center = |c: Cell| Point2::new(f64::from(c.x) + 0.5, f64::from(c.y) + 0.5);
        let mut queries: Vec<Query> = vec![];
        if let Ok(text) = std::fs::read(format!("{}.scen", path.display())) {
            let mut s = moving_ai::parse_scenarios(&text).unwrap();
            if hard { s.sort_by(|a, b| b.optimum.total_cmp(&a.optimum)); s.truncate(50); }
            queries.extend(s.iter().map(|s| Query { start: center(moving_ai::cell_from_top(&spec, s.start).unwrap()), goal: center(moving_ai::cell_from_top(&spec, s.goal).unwrap()), seed: 1 }));
        } else {
            let cells: Vec<Cell> = (0..free.height()).flat_map(|y| free.set_in_row(y, 0, i64::MAX).map(move |x| Cell::new(x, y)).collect::<Vec<_>>()).collect();
            let mut r = rand_pcg::Pcg64Mcg::seed_from_u64(1);
            for _ in 0..300 { queries.push(Query { start: center(cells[r.random_range(0..cells.len())]), goal: center(cells[r.random_range(0..cells.len())]), seed: 1 }); }
        }
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let sight = PointSight::new(&free);
        let mut searcher = Searcher::new(&free).unwrap();
        run(&name, &mut searcher, &sight, &queries);
        let space = ConfigurationSpace::new(&grid, &Footprint::Radius(0.1), UnknownPolicy::Blocked, 0.0);
        let mut searcher = Searcher::new(space.free()).unwrap();
        let q: Vec<Query> = queries.iter().filter(|q| space.is_free(Cell::new(q.start.x as u32, q.start.y as u32)) && space.is_free(Cell::new(q.goal.x as u32, q.goal.y as u32))).copied().collect();
        if !q.is_empty() { run(&format!("{name} disc"), &mut searcher, &space, &q); }
    }
}
