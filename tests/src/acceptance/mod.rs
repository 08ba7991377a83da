//! Acceptance runs: the robot's side in thousands of simulated worlds, in lockstep without a network; and real processes that are killed
//! hundreds of times.
//!
//! | module | holds |
//! |---|---|
//! | [`sim_rig`] | a simulated world, a robot and its pilot, stepped together |
//! | [`worlds`] | random worlds, and the seeded random numbers that they are drawn with |
//! | [`pose`] | consistency of the pose estimate (NEES, NIS) |
//! | [`closure`] | a loop closure that moves the map while the robot drives |
//! | [`corrections`] | localisation in a changed house, and the robot that it corrects over a bad link |
//! | [`everywhere`] | global localisation |
//! | [`tracking`] | path error of every tracker |
//! | [`footprint`] | size, processor time, memory and lateness of the robot's binary |
//! | [`kidnapped`] | robots that are kidnapped while they drive |
//! | [`kills`] | missions killed at random instants |
//! | [`handover`] | missions that take over from a dead or frozen one |
//! | [`faults`] | bad links, and parts that are killed, frozen, or started in any order |
//! | [`fleet`] | many robots' missions in one process |
//! | [`workers`] | motion requests of many robots, to one worker, two, and two of which one is frozen |
//! | [`page`] | the mission-control page with many robots, and with many browsers that do not read |
//! | [`invariants`] | invariants of goals and of the robot meanwhile |
//! | [`guard`] | the collision monitor under adversarial commands |

mod benign;
pub mod closure;
pub mod corrections;
pub mod everywhere;
pub mod faults;
pub mod fleet;
pub mod footprint;
pub mod guard;
pub mod handover;
mod indoors;
pub mod invariants;
pub mod kidnapped;
pub mod kills;
pub mod page;
pub mod pose;
mod sight;
pub mod sim_rig;
pub mod tracking;
pub mod workers;
pub mod worlds;
