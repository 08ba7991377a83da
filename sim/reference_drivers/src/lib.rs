//! Reference drivers. How well can a robot be driven among walls and moving obstacles, if its pose and everything around it are known?
//!
//! # The problem
//!
//! Given a [`DrivingTask`]: a world with walls and people, a robot's footprint and the limits of its differential drive, a start and a goal.
//! Wanted are wheel speeds, 25 times a second, that take the robot to the goal soon and without touching anything.
//!
//! A navigation stack that is measured on such tasks needs something to be compared with. These drivers solve them by published methods,
//! with the same body and within the same limits, but from the simulator's ground truth instead of sensors:
//!
//! | method | what it knows of moving obstacles | how it decides |
//! |---|---|---|
//! | [`Method::Standing`] | their positions | dynamic window |
//! | [`Method::ConstantVelocity`] | their positions and velocities | dynamic window, with constant velocities |
//! | [`Method::Orca`] | the same | optimal reciprocal collision avoidance: everybody takes half of the effort |
//! | [`Method::AllKnowing`] | their future, if the robot is in nobody's way | A* over cells and time, followed by a dynamic window |
//!
//! [`Field`] gives the shortest path past the walls alone: no driver can be faster than that path at top speed.
//!
//! Frames: `map` is the world's, `base` the robot's. Metres, seconds, radians, yaw counter-clockwise. No clock and no randomness: the same
//! simulation gets the same wheel speeds.
//!
//! # Use
//!
//! A TIAGo reaches its goal behind somebody who crosses its way:
//!
//! ```
//! use nalgebra::Point2;
//! use zenav_protocol::{id::Id, robot::{self, RobotModel}};
//! use zenav_reference_drivers::{DrivingTask, Field, Method, ReferenceDriver, TICKS_PER_DECISION};
//! use zenav_sim::{RobotSpec, Simulation, World};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let text = "size = [8, 4]\n[start]\nx = 1\ny = 2\n\
//!     [[mover]]\nradius = 0.25\nspeed = 0.5\npath = [[4, 0.5], [4, 3.5]]\nrest_secs = [0, 1e4]\n";
//! let world = World::from_toml(text, "crossing.toml", &|_| Err("no map here".to_owned()))?;
//! let model = RobotModel::from_toml(robot::shipped("tiago").unwrap_or_default(), "tiago")?;
//! let task = DrivingTask {
//!     world: &world,
//!     model: &model,
//!     start: world.start(),
//!     goal: Point2::new(6.5, 2.0),
//!     tolerance: 0.15,
//!     timeout: 30.0,
//! };
//! let field = Field::new(&world, model.footprint.inscribed_radius(), task.goal);
//!
//! let tiago = RobotSpec { id: Id::robot("tiago")?, model: model.clone(), start: task.start };
//! let mut simulation = Simulation::new(&world, vec![tiago], 1)?;
//! let mut driver = ReferenceDriver::new(Method::ConstantVelocity, task, &field, &simulation);
//! let mut tick = 0_u64;
//! while simulation.now().as_secs() < task.timeout {
//!     if tick.is_multiple_of(TICKS_PER_DECISION) {
//!         let wheels = driver.decide(&simulation);
//!         simulation.drive(0, wheels);
//!     }
//!     simulation.step();
//!     tick += 1;
//! }
//! let truth = simulation.truth(0);
//! assert!((truth.map_from_base.position() - task.goal).norm() <= task.tolerance);
//! assert_eq!(truth.collisions, 0);
//! assert!(truth.length >= field.shortest(task.start.position()) - task.tolerance);
//! # Ok(())
//! # }
//! ```
//!
//! # Files
//!
//! | file | answers |
//! |---|---|
//! | `task` | what is to be driven? |
//! | `driver` | which wheel speeds come next? |
//! | `field` | how much room is there, and how long is the shortest path? |
//! | `cost_to_go` | which way leads to the goal, past walls and people who stand? |
//! | `window` | which reachable twist is best? (dynamic window) |
//! | `orca` | which velocity avoids everybody, if everybody takes half of the avoidance? |
//! | `replay` | where will everybody be? |
//! | `space_time` | which path is free at the time when the robot is there? (A* over cells and time) |
//! | `cells` | which square of a grid is where? |

mod cells;
mod cost_to_go;
mod driver;
mod field;
mod orca;
mod replay;
mod space_time;
mod task;
#[cfg(test)]
mod tests;
mod window;

pub use driver::{Method, ReferenceDriver, TICKS_PER_DECISION};
pub use field::Field;
pub use task::DrivingTask;
