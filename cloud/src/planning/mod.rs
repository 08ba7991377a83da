//! Is there a way? Searches over the configuration space, and the service that answers with them.
//!
//! | file | answers |
//! |---|---|
//! | [`lattice`] | which steps can be made from a cell, and what do they cost? |
//! | [`budget`] | how long may a search take? |
//! | [`astar`] | what is the cheapest way over the lattice? |
//! | [`planner`] | is there a way for this robot? which searches are there (and where to add one) |

pub mod astar;
pub mod budget;
pub mod lattice;
pub mod planner;

pub use budget::Budget;
pub use lattice::GridPath;
pub use planner::{PlanOptions, Planned, Planner, Searcher, plan};
