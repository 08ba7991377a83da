//! How much does the simulator hold, beside IR-SIM? `cargo bench -p zenav-tests --bench simulator [-- MAP…]`
//!
//! Rays a second of whole exact sweeps, 667 beams to 25 m, in made worlds and in maps: arguments, and every `.yaml`, `.pgm` and `.png` of the
//! folder in `ZENAV_BENCH_MAPS`. Then a thousand robots with 360 beams at 10 Hz that see one another, one robot alone, and one robot that
//! takes a whole scan every step, as IR-SIM (`pip install ir-sim`) does in the same world where the interpreter in `IR_SIM_PYTHON` (default
//! `python3`) has it. Everything on one core, by that thread's own time.

#![allow(
    clippy::unwrap_used,
    reason = "a bench stops at the first thing that is not as it should be"
)]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use zenav_fixtures::{Row, robot, thread_time};
use zenav_mapping::read_map;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::robot::{Footprint, RobotModel};
use zenav_sim::capacity::{rays, run};
use zenav_sim::made_worlds::{office, polygons};
use zenav_sim::{RobotSpec, Simulation, World};

/// Beams of the peer's robot.
const BEAMS: usize = 667;
/// How far they reach, m.
const RANGE: f64 = 25.0;

fn main() {
    let model = lidar(BEAMS, RANGE);
    for (name, world) in made().into_iter().chain(maps()) {
        Row::new(
            format!("exact sweeps, {name}"),
            rays(&world, &model, &thread_time) / 1e6,
            "M rays/s",
        )
        .print();
    }

    let model = lidar(360, 5.6);
    let square = |size: f64| world(&format!("size = [{size}, {size}]\n"));
    let crowds = [
        ("open floor of 60 m", square(60.0)),
        ("100 polygons in 60 m", world(&polygons(100, 4, 60.0))),
    ];
    for (name, world) in crowds {
        let report = run(&world, &model, 1000, Duration::from_secs(10), &thread_time).unwrap();
        for (robots, factor) in [
            (report.robots, report.real_time_factor),
            (1, report.single_real_time_factor),
        ] {
            Row::new(format!("{robots} robots of 360 beams, {name}"), factor, "x real time").print();
        }
    }

    for (name, sides) in [("50 polygons", 4), ("2,000 segments", 40)] {
        let text = polygons(50, sides, 20.0) + "[start]\nx = 10.0\ny = 10.0\n";
        let row = Row::new(
            format!("steps with a scan each, {name}"),
            steps(&world(&text)),
            "steps/s",
        );
        match peer(&text) {
            Some(value) => row.beside("IR-SIM", value).print(),
            None => row.print(),
        }
    }
}

fn lidar(beams: usize, range_max: f64) -> RobotModel {
    let mut model = robot("tiago");
    let lidar = model.lidar.as_mut().unwrap();
    (lidar.beams, lidar.range_max, lidar.rate_hz) = (beams, range_max, 10.0);
    model
}

fn world(text: &str) -> World {
    World::from_toml(text, "bench.toml", &|_| Err(String::new())).unwrap()
}

fn made() -> Vec<(String, World)> {
    vec![
        ("50 polygons".to_owned(), world(&polygons(50, 4, 20.0))),
        ("2,000 segments".to_owned(), world(&polygons(50, 40, 20.0))),
        ("office, a grid of 1200 x 1200 cells".to_owned(), office()),
    ]
}

fn maps() -> impl Iterator<Item = (String, World)> {
    let mut paths: Vec<PathBuf> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with("--"))
        .map(PathBuf::from)
        .collect();
    if let Some(folder) = std::env::var_os("ZENAV_BENCH_MAPS") {
        let files = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path());
        let is_map = |path: &PathBuf| {
            path.extension()
                .is_some_and(|kind| kind == "yaml" || kind == "pgm" || kind == "png")
        };
        let all: Vec<PathBuf> = files.filter(is_map).collect();
        // A picture that a `.yaml` belongs to is read by it.
        let described =
            |path: &Path| path.extension().is_some_and(|kind| kind != "yaml") && path.with_extension("yaml").is_file();
        paths.extend(all.into_iter().filter(|path| !described(path)));
        paths.sort();
    }
    paths.into_iter().map(|path| {
        let name = path
            .file_name()
            .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let map = read_map(&path, 0.05).unwrap();
        (name.clone(), World::from_map(&name, map, Pose2::IDENTITY))
    })
}

/// Steps a second of one robot that takes a scan in each.
fn steps(world: &World) -> f64 {
    let mut model = lidar(BEAMS, RANGE);
    model.lidar.as_mut().unwrap().rate_hz = 50.0;
    let turning = model.drive.wheels(zenav_protocol::geometry::Twist2::new(0.2, 0.5));
    let id = Id::robot("robot").unwrap();
    let start = world.start();
    let mut simulation = Simulation::new(world, vec![RobotSpec { id, model, start }], 1).unwrap();
    simulation.drive(0, turning);
    let (begin, mut steps) = (thread_time(), 0);
    loop {
        simulation.step();
        steps += 1;
        assert!(simulation.readings(0).sweeps.len() == 1);
        let took = thread_time() - begin;
        if took > Duration::from_secs(1) {
            return f64::from(steps) / took.as_secs_f64();
        }
    }
}

/// The same of IR-SIM, where it is there.
fn peer(text: &str) -> Option<f64> {
    let python = std::env::var("IR_SIM_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peers/ir_sim.py");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("world.toml");
    std::fs::write(&file, text).unwrap();
    let model = lidar(BEAMS, RANGE);
    let Footprint::Radius(radius) = model.footprint else {
        return None;
    };
    let numbers = [
        radius,
        BEAMS as f64,
        model.first_lidar().unwrap().field_of_view,
        RANGE,
        5.0,
    ]
    .map(|value| value.to_string());
    let output = Command::new(python).arg(script).arg(&file).args(numbers).output();
    let output = output.ok().filter(|output| output.status.success())?;
    // Plotting libraries may print lines of their own first.
    let lines = String::from_utf8_lossy(&output.stdout);
    lines.lines().last()?.split_whitespace().next()?.parse().ok()
}
