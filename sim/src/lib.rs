//! A seeded two-dimensional world without a network: bodies, sensors, movers.
//!
//! | module | answers |
//! |---|---|
//! | [`world`] | what is where? |
//! | `world_file` | how is a world described in a file? (TOML) |
//! | [`world_check`] | which values may a world hold? |
//! | [`shape`] | what are solids made of? (edges and discs) |
//! | [`outline`] | which edges bound the occupied cells of a map? |
//! | [`boxes`] | which things are near, the nearest first? (for lidars) |
//! | [`scene`] | what never moves, and how far away is it? |
//! | [`crowd`] | which movers and robots are near? |
//! | [`clearance`] | how far is a form from another, and where do they touch? (parry) |
//! | [`lidar`] | what does a planar lidar measure? (angular z-buffer) |
//! | [`motors`] | how do wheels and motors respond to a command? |
//! | [`sensors`] | what do encoders, gyro, compass and GPS measure, and when? |
//! | [`faults`] | which sensor is broken, how, and when? |
//! | [`movers`] | where are the moving obstacles? |
//! | [`manners`] | how does a walker make way for others? (ORCA, social force) |
//! | [`chassis`] | how does one robot move among solids, and what does it touch? |
//! | [`body`] | what does one robot do in a tick? |
//! | [`simulation`] | how does everything advance together? |
//! | [`scatter`] | where can many robots start? |
//! | [`made_worlds`] | which worlds need no file? |
//! | [`capacity`] | how many rays and robots does this machine hold? |
//!
//! The world frame is the map frame. Metres, radians, seconds.
//!
//! ```
//! use zenav_protocol::{id::Id, robot::{self, RobotModel}};
//! use zenav_sim::{RobotSpec, Simulation, World};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let world = World::shipped("kitchen")?;
//! let model = RobotModel::from_toml(robot::shipped("tiago").unwrap_or_default(), "tiago")?;
//! let tiago = RobotSpec { id: Id::robot("tiago")?, model, start: world.start() };
//! let mut simulation = Simulation::new(&world, vec![tiago], 1)?;
//! simulation.drive(0, [1.0, 1.0]);
//! for _ in 0..50 {
//!     simulation.step();
//! }
//! assert!(simulation.truth(0).length > 0.05);
//! # Ok(())
//! # }
//! ```

pub mod body;
pub mod boxes;
mod bridge;
pub mod capacity;
pub mod chassis;
pub mod clearance;
pub mod crowd;
pub mod faults;
pub mod lidar;
pub mod made_worlds;
pub mod manners;
pub mod motors;
pub mod movers;
pub mod outline;
pub mod scatter;
pub mod scene;
pub mod sensors;
pub mod shape;
pub mod simulation;
pub mod world;
pub mod world_check;
mod world_file;

pub use chassis::{Contact, Truth};
pub use simulation::{RobotSpec, SimError, Simulation, TICK};
pub use world::{Place, World};
pub use world_check::WorldError;
