//! Every reference driver takes a TIAGo through a door and past two walkers; prints time, path, least clearance and contacts.
//!
//! `cargo run -p zenav-reference-drivers --example past_walkers`

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use nalgebra::Point2;
use zenav_protocol::{
    id::Id,
    robot::{self, RobotModel},
};
use zenav_reference_drivers::{DrivingTask, Field, Method, ReferenceDriver, TICKS_PER_DECISION};
use zenav_sim::{RobotSpec, Simulation, World};

/// A wall with a door 1.2 m wide; one walker crosses behind it, the other one walks through it and back.
const WORLD: &str = r"
size = [9, 5]
[start]
x = 1
y = 2.5

[[wall]]
from = [4, 0]
to = [4, 1.9]
thickness = 0.1

[[wall]]
from = [4, 3.1]
to = [4, 5]
thickness = 0.1

[[mover]]
radius = 0.25
speed = 0.6
path = [[6, 0.5], [6, 4.5]]

[[mover]]
radius = 0.25
speed = 0.8
path = [[8, 3.5], [5, 2.5], [3, 2.5], [1, 4], [3, 2.5], [5, 2.5]]
";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let world = World::from_toml(WORLD, "walkers.toml", &|_| Err("no map here".to_owned()))?;
    let model = RobotModel::from_toml(robot::shipped("tiago").unwrap_or_default(), "tiago")?;
    let task = DrivingTask {
        world: &world,
        model: &model,
        start: world.start(),
        goal: Point2::new(8.0, 2.0),
        tolerance: 0.15,
        timeout: 60.0,
    };
    let field = Field::new(&world, model.footprint.inscribed_radius(), task.goal);
    let metres = field.shortest(task.start.position());
    println!(
        "{metres:.2} m past the walls, {:.1} s at top speed",
        metres / model.drive.top_speed()
    );
    println!("method            time s  path m  clearance m  contacts");
    for method in Method::ALL {
        let tiago = RobotSpec {
            id: Id::robot("tiago")?,
            model: model.clone(),
            start: task.start,
        };
        let mut simulation = Simulation::new(&world, vec![tiago], 1)?;
        let mut driver = ReferenceDriver::new(method, task, &field, &simulation);
        let mut tick = 0_u64;
        loop {
            if tick.is_multiple_of(TICKS_PER_DECISION) {
                let wheels = driver.decide(&simulation);
                simulation.drive(0, wheels);
            }
            simulation.step();
            tick += 1;
            let left = (simulation.truth(0).map_from_base.position() - task.goal).norm();
            if left <= task.tolerance || simulation.now().as_secs() >= task.timeout {
                break;
            }
        }
        let truth = simulation.truth(0);
        let name = format!("{method:?}");
        println!(
            "{name:16} {:7.1} {:7.2} {:12.2} {:9}",
            simulation.now().as_secs(),
            truth.length,
            truth.min_clearance,
            truth.collisions
        );
    }
    Ok(())
}
