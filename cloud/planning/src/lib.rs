//! Is there a way? Searches over the configuration space, and the service that answers with them.
//!
//! | file | answers |
//! |---|---|
//! | [`lattice`] | which steps can be made from a cell, and what do they cost? |
//! | [`budget`] | how long may a search take? |
//! | [`astar`] | what is the cheapest way over the lattice? |
//! | [`jps`] | the shortest way, where every cell costs the same? |
//! | `jump_grid` | where does a run over free cells end? |
//! | `lines` | how are bitmaps turned, so that columns and diagonals lie as rows do? |
//! | `open` | which open node is next? |
//! | `records` | what does a search note about cells, of which it sees few? |
//! | [`theta`] | a short way in any direction? |
//! | [`taut`] | which corners of a way are needed? |
//! | `oriented` | is there a way for the true footprint of a robot that is longer than wide? |
//! | `roomy` | is there a way on which it may turn anywhere? |
//! | [`planner`] | which planners are there (and where to add one)? |
//! | [`searcher`] | which search runs, and on what memory? |
//! | [`way`] | what does a search give? |
//! | [`mod@plan`] | is there a way for this robot? |
//! | [`replan`] | does an answer still stand when the map has changed or the robot has moved on? |

pub mod astar;
pub mod budget;
pub mod jps;
pub mod jump_grid;
pub mod lattice;
mod lines;
mod open;
mod oriented;
pub mod plan;
pub mod planner;
mod records;
pub mod replan;
mod roomy;
pub mod sampling;
pub mod searcher;
pub mod taut;
pub mod theta;
pub mod way;

pub use budget::Budget;
pub use lattice::GridPath;
pub use plan::{Planned, plan};
pub use planner::{PlanOptions, Planner};
pub use replan::Replanner;
pub use searcher::{Query, Searched, Searcher};
pub use way::Way;
