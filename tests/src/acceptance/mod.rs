//! Proving grounds: the robot's side in its simulated world, in lockstep and without a network, by the thousand; and processes that are
//! killed by the hundred.
//!
//! | module | answers |
//! |---|---|
//! | [`sim_rig`] | how do a world, a robot and its pilot step together? |
//! | [`worlds`] | what does a random world look like? |
//! | [`pose`] | is the estimate as good as its covariance says? |
//! | [`tracking`] | how near to its path does each tracker keep the robot? |
//! | [`footprint`] | what does the robot's side cost its machine? |
//! | [`kills`] | is any goal lost when the orchestrator is killed? |
//! | [`handover`] | does another orchestrator go on when the leader dies or freezes? |
//! | [`fleet`] | how many robots' missions does one orchestrator run? |
//! | [`invariants`] | what is true of goals and of the robot meanwhile? |
//! | [`guard`] | does the robot ever drive into anything, whatever it is told? |

pub mod fleet;
pub mod footprint;
pub mod guard;
pub mod handover;
pub mod invariants;
pub mod kills;
pub mod pose;
pub mod sim_rig;
pub mod tracking;
pub mod worlds;
