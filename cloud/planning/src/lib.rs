//! Path planning on occupancy grids, for the true footprint of a robot.
//!
//! Given the free configuration space `C` of a robot on a grid ([`zenav_space::ConfigurationSpace`]), a start and a goal, find a polyline
//! `p_0 … p_n` from the exact start to the exact goal that the robot can drive as *stop, turn, go*: the footprint, swept along every leg
//! with its heading along the leg, and turned on the spot at every corner, touches no obstacle. Among those, the planners minimise
//!
//! - `astar`: `sum |p_i+1 - p_i| (1 + w (1 - c / d)^2)` over paths on the 8-connected grid graph, with `c` the clearance, `d` the distance that
//!   is wanted and `w` its weight;
//! - `jps`: the length on the same graph, exactly;
//! - `theta`: the length over any directions, approximately;
//! - `rrt`, `rrt_connect`: nothing, the first path that is found; `rrt_star`: the length, in the limit of many samples.
//!
//! Collision checks are exact against the closed squares of occupied cells: there is no step size, and a single occupied cell is never
//! missed. Planning is deterministic and reads no clock: a [`Budget`] bounds a search, and its flag cancels one from outside.
//!
//! # Entry points
//!
//! | question | entry point |
//! |---|---|
//! | Is there a path that this robot can drive? | [`plan()`] |
//! | The same, repeatedly, while the map changes and the robot drives? | [`Replanner`] |
//! | What does one search between two points of a bitmap find, in cells? | [`Searcher`] |
//! | A path past robots whose courses are known? | [`search_space_time`] |
//! | Which planners and settings are there? | [`Planner`], [`PlanningSettings`] |
//!
//! ```
//! use nalgebra::Point2;
//! use zenav_planning::{Budget, FootprintSearch, PlanOptions, Searcher, plan};
//! use zenav_protocol::geometry::Pose2;
//! use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
//! use zenav_protocol::messages::PlanOutcome;
//! use zenav_protocol::robot::Footprint;
//! use zenav_space::{ConfigurationSpace, UnknownPolicy};
//!
//! // A room of 5 m by 4 m with a wall that leaves a gap of 0.5 m.
//! let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 80 };
//! let mut map = Grid::filled(spec, Occupancy::FREE);
//! (0..80).filter(|y| !(40..50).contains(y)).for_each(|y| map[Cell::new(50, y)] = Occupancy::OCCUPIED);
//!
//! // A robot of 0.8 m by 0.3 m fits through lengthways.
//! let corners = [(-0.4, -0.15), (0.4, -0.15), (0.4, 0.15), (-0.4, 0.15)];
//! let footprint = Footprint::Polygon(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
//! let space = ConfigurationSpace::new(&map, &footprint, UnknownPolicy::Blocked, 0.0);
//! let mut searcher = Searcher::new(space.free())?;
//! let [start, goal] = [Pose2::new(1.0, 1.0, 0.0), Pose2::new(4.0, 1.0, 0.0)];
//! let planned = plan(&space, &mut searcher, start, goal, &PlanOptions::default(), Budget::UNLIMITED);
//!
//! let PlanOutcome::Found { path, length } = planned.outcome else { panic!("no path") };
//! assert_eq!((path[0], path[path.len() - 1]), (start.position(), goal.position()));
//! assert!(length > 3.0 && planned.found_by.is_some());
//! assert!(path.windows(2).all(|leg| space.leg_clearance(leg[0], leg[1], 0.1) > 0.0));
//! # Ok::<(), zenav_planning::TooManyCells>(())
//! ```
//!
//! # Files
//!
//! | file | answers |
//! |---|---|
//! | `plan` | is there a path for this robot, and which search finds it? |
//! | `ends` | at which free cells does a search start and end? |
//! | `circumscribed_search` | is there a path on which the robot may turn anywhere? |
//! | `se2_search` | is there a path for the footprint itself, over positions and headings? |
//! | `space_time` | which path passes robots whose courses are known, and when does it arrive? |
//! | `replan` | is an answer still valid after the map has changed or the robot has moved on? |
//! | `planners` | which planners are there, and how is one added? |
//! | `searcher` | which search runs, and on which memory? |
//! | `grid_graph` | which steps can be made from a cell, and what do they cost? |
//! | `cell_cost` | what does a step cost beyond its length? |
//! | `jump_grid`, `lines` | where does a run over free cells stop? |
//! | `open_list` | which open node is next? |
//! | `node_table` | how does a search store values for the few nodes it visits? |
//! | `sampling` | what do tree-growing planners share? |
//! | `string_pulling` | which corners of a path are needed? |
//! | `budget`, `options`, `settings` | how long may a search take, which options does it have, what can be tuned? |

mod budget;
mod cell_cost;
mod circumscribed_search;
mod ends;
mod grid_graph;
mod jump_grid;
mod lines;
mod node_table;
mod open_list;
mod options;
mod path;
mod plan;
mod planners;
mod replan;
mod sampling;
mod se2_search;
mod searcher;
mod settings;
mod space_time;
mod string_pulling;

pub use budget::Budget;
pub use grid_graph::TooManyCells;
pub use options::PlanOptions;
pub use path::Path;
pub use plan::{FootprintSearch, Planned, plan};
pub use planners::{Planner, UnknownPlanner};
pub use replan::Replanner;
pub use searcher::{NotFound, Query, Searched, Searcher};
pub use settings::{
    ClearanceSettings, LeavingSettings, PlanningSettings, ReplanningSettings, SamplingSettings, Se2Settings,
    SpaceTimeSettings,
};
pub use space_time::{SpaceTimePath, SpaceTimeQuery, pulled, search as search_space_time};
