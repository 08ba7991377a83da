#![allow(clippy::unwrap_used, reason = "tests")]

mod contact;
mod motion;
mod sensors;
mod time;

use super::*;
use std::f64::consts::{FRAC_PI_2, PI};

fn world(body: &str) -> World {
    World::from_toml(
        &format!("size = [20, 20]\norigin = [-10, -10]\n{body}"),
        "test.toml",
        &|_| Err(String::new()),
    )
    .unwrap()
}

fn model(name: &str) -> RobotModel {
    zenav_fixtures::robot(name)
}

fn robot(id: &str, model_name: &str, start: Pose2) -> RobotSpec {
    RobotSpec {
        id: Id::robot(id).unwrap(),
        model: model(model_name),
        start,
    }
}

fn simulate(world: &World, robots: Vec<RobotSpec>) -> Simulation {
    Simulation::new(world, robots, 7).unwrap()
}

fn steps(simulation: &mut Simulation, robot: usize, wheels: [f64; 2], count: usize) {
    simulation.drive(robot, wheels);
    for _ in 0..count {
        simulation.step();
    }
}

const WALL: &str = "[[wall]]\nfrom = [1, -5]\nto = [1, 5]\nthickness = 0.1\n";
