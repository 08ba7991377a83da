//! Is there a way? Searches over the configuration space, and the service that answers with them.
//!
//! | file | answers |
//! |---|---|
//! | [`grid_graph`] | which steps can be made from a cell, and what do they cost? |
//! | [`budget`] | how long may a search take? |
//! | [`astar`] | what is the cheapest way over the lattice? |
//! | [`jps`] | the shortest way, where every cell costs the same? |
//! | `jump_grid` | where does a run over free cells end? |
//! | `lines` | how are bitmaps turned, so that columns and diagonals lie as rows do? |
//! | `open_list` | which open node is next? |
//! | `node_table` | what does a search note about cells, of which it sees few? |
//! | [`theta`] | a short way in any direction? |
//! | [`string_pulling`] | which corners of a way are needed? |
//! | `se2_search` | is there a way for the true footprint of a robot that is longer than wide? |
//! | `circumscribed_search` | is there a way on which it may turn anywhere? |
//! | [`planner`] | which planners are there (and where to add one)? |
//! | [`searcher`] | which search runs, and on what memory? |
//! | [`path`] | what does a search give? |
//! | [`mod@plan`] | is there a way for this robot? |
//! | [`replan`] | does an answer still stand when the map has changed or the robot has moved on? |

pub mod astar;
pub mod budget;
mod circumscribed_search;
mod ends;
pub mod grid_graph;
pub mod jps;
pub mod jump_grid;
mod lines;
mod node_table;
mod open_list;
pub mod path;
pub mod plan;
pub mod planner;
pub mod replan;
pub mod sampling;
mod se2_search;
pub mod searcher;
pub mod string_pulling;
pub mod theta;

pub use budget::Budget;
pub use grid_graph::GridPath;
pub use path::Path;
pub use plan::{FootprintSearch, Planned, plan};
pub use planner::{PlanOptions, Planner};
pub use replan::Replanner;
pub use searcher::{Query, Searched, Searcher};
