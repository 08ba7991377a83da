//! How much does this machine hold? Prints rays a second and the real-time factor as one JSON line a world.
//!
//! `cargo run --release -p zenav-sim --example bench`

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "an example that prints")]

use std::time::{Duration, Instant};

use zenav_protocol::robot::{self, RobotModel};
use zenav_sim::{World, bench};

fn main() {
    let begin = Instant::now();
    for (world, model, robots) in [("kitchen", "tiago", 1), ("house", "tiago", 4), ("house", "neato", 1)] {
        let model = RobotModel::from_toml(robot::shipped(model).unwrap(), model).unwrap();
        let world = World::shipped(world).unwrap();
        let report = bench::run(&world, &model, robots, Duration::from_secs(1000), &|| begin.elapsed()).unwrap();
        println!("{} {}", world.name(), serde_json::to_string(&report).unwrap());
    }
}
