//! Acceptance runs: the robot's side in simulated worlds by the thousand, in lockstep and without a network; and processes that are killed by
//! the hundred.
//!
//! | module | holds |
//! |---|---|
//! | [`sim_rig`] | a simulated world, a robot and its pilot, stepped together |
//! | [`worlds`] | random worlds, and the seeded random numbers that they are drawn with |
//! | [`pose`] | consistency of the pose estimate (NEES, NIS) |
//! | [`tracking`] | path error of every tracker |
//! | [`footprint`] | size, processor time, memory and lateness of the robot's binary |
//! | [`kills`] | missions killed at random instants |
//! | [`handover`] | missions that take over from one that dies or freezes |
//! | [`fleet`] | many robots' missions in one process |
//! | [`invariants`] | what holds of goals and of the robot meanwhile |
//! | [`guard`] | the collision monitor under adversarial commands |

mod benign;
pub mod fleet;
pub mod footprint;
pub mod guard;
pub mod handover;
pub mod invariants;
pub mod kills;
pub mod pose;
mod sight;
pub mod sim_rig;
pub mod tracking;
pub mod worlds;
