//! What is the robot to do next, and how does nobody lose it? Goals, their behaviour trees, the lease, the plan in force.
//!
//! A mission is one robot's orchestrator: it holds the robot's lease, and it alone publishes the plan that moves it.
//!
//! | file | answers |
//! |---|---|
//! | [`config`] | what can be set? |
//! | [`exchange`] | what goes into a step, and what comes out? |
//! | [`orchestrator`] | what happens in a step? |
//! | `desk`, [`intake`], [`goals`] | what are clients told, which goals are taken, which are there? |
//! | [`records`], [`store`] | what outlives a crash, and where is it kept? |
//! | [`lease`] | does this mission command the robot? |
//! | [`robot`], [`map`] | what is known of the robot and its map? |
//! | [`motion`] | which plan is in force, and is it still good? |
//! | [`route`] | how does a goal become a motion? plan, then smooth |
//! | [`context`], [`leaves`], [`trees`] | what do the trees' leaves act on, which are there, which trees are shipped? |
//! | [`service`] | how is all this fed from the bus? |

pub mod config;
pub mod context;
mod desk;
pub mod exchange;
pub mod goals;
pub mod intake;
pub mod lease;
pub mod leaves;
pub mod map;
pub mod motion;
pub mod orchestrator;
pub mod records;
pub mod robot;
pub mod route;
pub mod service;
pub mod store;
#[cfg(test)]
mod tests;
pub mod trees;

pub use config::MissionConfig;
pub use exchange::{Answer, Ask, Client, Effect, Inputs, NoAnswer, Request, Response, Ticket};
pub use orchestrator::Mission;
pub use records::{Record, Restored};
