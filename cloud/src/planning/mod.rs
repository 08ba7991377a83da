//! Is there a way? Searches over the configuration space, and the service that answers with them.
//!
//! | file | answers |
//! |---|---|
//! | [`lattice`] | which steps can be made from a cell, and what do they cost? |
//! | [`budget`] | how long may a search take? |
//! | [`astar`] | what is the cheapest way over the lattice? |
//! | [`jps`] | the shortest way, where every cell costs the same? |
//! | [`planner`] | is there a way for this robot? which searches are there (and where to add one) |
//! | [`worker`] | how is one request answered? |
//! | [`service`] | how does a worker live on the network? |

pub mod astar;
pub mod budget;
pub mod jps;
pub mod lattice;
pub mod planner;
pub mod service;
pub mod worker;

pub use budget::Budget;
pub use lattice::GridPath;
pub use planner::{PlanOptions, Planned, Planner, Searcher, plan};
pub use worker::PlanWorker;
