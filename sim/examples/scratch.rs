//! scratch
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "scratch")]
use std::time::{Duration, Instant};
use nalgebra::Point2;
use rand::{Rng, SeedableRng};
use zenav_protocol::{geometry::Pose2, grid::*, robot::{self, RobotModel}};
use zenav_sim::{World, bench, shape::{Disc, Edge}, scene::Scene, lidar::AngularBuffer};

fn pgm(path: &str, res: f64, ox: f64, oy: f64) -> OccupancyGrid {
    let data = std::fs::read(path).unwrap();
    let mut at = 0; let mut fields = vec![];
    while fields.len() < 4 {
        while data[at].is_ascii_whitespace() { at += 1; }
        if data[at] == b'#' { while data[at] != b'\n' { at += 1; } continue; }
        let s = at; while !data[at].is_ascii_whitespace() { at += 1; }
        fields.push(String::from_utf8(data[s..at].to_vec()).unwrap());
    }
    at += 1;
    let (w, h): (u32, u32) = (fields[1].parse().unwrap(), fields[2].parse().unwrap());
    let spec = GridSpec { origin: Point2::new(ox, oy), resolution: res, width: w, height: h };
    let mut v = vec![0i8; spec.len()];
    for y in 0..h as usize { for x in 0..w as usize {
        let p = data[at + (h as usize - 1 - y) * w as usize + x];
        v[y * w as usize + x] = if p < 90 { 100 } else if p > 204 { 0 } else { -1 };
    } }
    OccupancyGrid::from_values(spec, v).unwrap()
}

fn main() {
    let begin = Instant::now();
    let clock = || begin.elapsed();
    let tiago = RobotModel::from_toml(robot::shipped("tiago").unwrap(), "tiago").unwrap();
    for (f, range) in [("willow-full-0.05.pgm", 5.6), ("willow-full-0.05.pgm", 25.0), ("depot.pgm", 5.6), ("tb3_sandbox.pgm", 5.6)] {
        let t = Instant::now();
        let world = World::from_map(f, pgm(&format!("/work/shared/data/ros_maps/{f}"), 0.05, 0.0, 0.0), Pose2::IDENTITY);
        println!("{f}: {} edges, built in {:?}", world.scene().edge_count(), t.elapsed());
        let mut m = tiago.clone(); m.lidar.range_max = range;
        println!("  range {range}: {:?}", bench::run(&world, &m, 1, Duration::from_secs(500), &clock).unwrap());
    }
    // 50 shapes; 2,000 segments in 50 m
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(1);
    let mut u = move || rng.next_u64() as f64 / u64::MAX as f64;
    for (n, corners, r) in [(50, 4, 1.0), (50, 40, 1.0), (400, 5, 0.5)] {
        let mut edges = vec![];
        let discs: Vec<Disc> = vec![];
        for _ in 0..n {
            let c = Point2::new(u() * 50.0, u() * 50.0);
            let pts: Vec<_> = (0..corners).map(|i| { let a = i as f64 * std::f64::consts::TAU / corners as f64; Point2::new(c.x + r * a.cos(), c.y + r * a.sin()) }).collect();
            edges.extend(zenav_sim::shape::edges(&pts).collect::<Vec<Edge>>());
        }
        let scene = Scene::new(edges, discs);
        let mut m = tiago.lidar.clone(); m.range_max = 25.0;
        let mut b = AngularBuffer::new(&m);
        let t = Instant::now(); let mut s = 0.0;
        for _ in 0..5000 { b.begin(Pose2::new(u() * 50.0, u() * 50.0, u())); b.scene(&scene); s += b.ranges().filter(|r| *r < 25.0).sum::<f64>(); }
        let el = t.elapsed().as_secs_f64();
        println!("{n} x {corners}: {:.1} M rays/s ({s})", 5000.0 * 667.0 / el / 1e6);
    }
    let mut m = tiago.clone(); m.lidar.beams = 360; m.footprint = robot::Footprint::Radius(0.2);
    let w = World::from_toml("size=[100,100]\n", "x", &|_| Err(String::new())).unwrap();
    println!("1000 robots: {:?}", bench::run(&w, &m, 1000, Duration::from_secs(5), &clock).unwrap());
}
