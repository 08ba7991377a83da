#![allow(missing_docs, warnings, clippy::all, clippy::pedantic)]
use std::path::Path;
use zenav_cloud::mapping::map_file;
use zenav_cloud::planning::{Budget, Planner, Query, Searcher};
use zenav_cloud::space::{BitGrid, PointSight};
use zenav_protocol::grid::{Cell, Occupancy};
use rand::{RngExt as _, SeedableRng as _};
#[path = "q/generated_q.rs"] mod generated;
#[path = "../benches/search/queries.rs"] mod queries;
pub struct Case { pub name: String, pub free: BitGrid, pub queries: Vec<Query> }
mod cached { use super::*; pub fn drawn(name: &str, free: &BitGrid) -> Vec<Query> {
 let f = format!("/tmp/qcache/{name}"); 
 if let Ok(t) = std::fs::read_to_string(&f) { return t.lines().map(|l| { let v: Vec<f64> = l.split(' ').map(|w| w.parse().unwrap()).collect(); Query { start: nalgebra::Point2::new(v[0], v[1]), goal: nalgebra::Point2::new(v[2], v[3]), seed: 1 } }).collect(); }
 let q = queries::drawn(free); std::fs::create_dir_all("/tmp/qcache").unwrap(); std::fs::write(&f, q.iter().map(|q| format!("{} {} {} {}\n", q.start.x, q.start.y, q.goal.x, q.goal.y)).collect::<String>()).unwrap(); q } }
fn cpu() -> f64 { let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime); t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6 }
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let only = args.get(1).cloned().unwrap_or_default();
    let planners: Vec<Planner> = args.get(2).map_or(vec![Planner::AStar, Planner::Jps], |p| vec![p.parse().unwrap()]);
    let runs: usize = args.get(3).map_or(3, |r| r.parse().unwrap());
    let mut cases = generated::maps(&only);
    let mut paths: Vec<_> = std::fs::read_dir("/tmp/smaps").unwrap().map(|e| e.unwrap().path()).collect();
    paths.retain(|p| p.extension().is_some_and(|e| ["map", "pgm", "png"].iter().any(|k| e == *k)) && p.to_string_lossy().contains(&only));
    paths.sort();
    for path in &paths {
        let grid = map_file::read_map(path, 0.05).unwrap();
        let spec = *grid.spec();
        let free = BitGrid::from_fn(spec.width, spec.height, |cell| Occupancy::of(grid[cell]) == Occupancy::Free);
        let queries = match std::fs::read(format!("{}.scen", path.display())).ok() { Some(t) => queries::published(&spec, &t), None => cached::drawn(&path.file_stem().unwrap().to_string_lossy(), &free) };
        cases.push(Case { name: path.file_stem().unwrap().to_string_lossy().into_owned(), free, queries });
    }
    for case in &cases {
        let sight = PointSight::new(&case.free); let b0 = cpu(); let mut searcher = Searcher::new(&case.free).unwrap(); let b1 = cpu(); let s0 = Query { goal: case.queries[0].start, ..case.queries[0] }; let _ = searcher.search(Planner::Jps, &sight, &s0, Budget::UNLIMITED); print!("{:.3}+{:.3} ", b1 - b0, cpu() - b1);
        print!("{:20}", case.name);
        for planner in &planners {
            let mut times = vec![f64::INFINITY; case.queries.len()];
            let mut exp = 0;
            for _ in 0..runs { for (i, q) in case.queries.iter().enumerate() {
                let b = cpu();
                let s = searcher.search(*planner, &sight, q, Budget::UNLIMITED);
                let t = cpu() - b; times[i] = times[i].min(t); exp += s.expansions;
            } }
            let total: f64 = times.iter().sum(); exp /= runs as u64;
            times.sort_by(f64::total_cmp);
            print!(" {planner}: {:8.4} ({:8.4}) ms exp {:7} {:6.1} ns/exp |", times[25.min(times.len()-1)], times[times.len()*95/100], exp / case.queries.len() as u64, total * 1e6 / exp as f64);
        }
        println!();
    }
}
