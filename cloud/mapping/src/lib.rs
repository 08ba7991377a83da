//! Occupancy grid mapping: laser scans at known poses become a map.
//!
//! # The problem
//!
//! Given scans `z₁ … zₙ` and the poses from which they were taken, find for each cell `m` of a grid the probability that it is occupied.
//! With independent cells and observations, Bayes' rule in log-odds is a sum over the scans that observed the cell:
//!
//! ```text
//! l(m | z₁…zₙ) = l₀ + Σ [ l(m | zᵢ) − l₀ ]        l(p) = ln(p / (1 − p))
//! ```
//!
//! where `p(m | zᵢ)` is the inverse sensor model: one value for a cell in which a beam of the scan ended (a hit), one for a cell that beams
//! only passed (a miss), none for all others. The sum is clamped so that a map can change its mind. Cells that the robot no longer looks at
//! cannot be freed by a beam; so obstacles that appeared on cells long free decay after a while (temporal decay).
//!
//! Moravec and Elfes 1985; Thrun, Burgard and Fox, "Probabilistic Robotics", chapter 9; Hornung et al., "OctoMap", 2013; Macenski et al.,
//! "Spatio-Temporal Voxel Layer", 2020.
//!
//! # Where to begin
//!
//! | question | entry point |
//! |---|---|
//! | How does a live robot's map come about? | [`Mapper`]: [`insert`](Mapper::insert) scans, [`take_patch`](Mapper::take_patch) for replicas on other machines, [`snapshot`](Mapper::snapshot) for files and pictures |
//! | The grid alone? | [`LogOddsGrid`] |
//! | A map from a recorded log, and how well do two maps agree? | [`build_map`], [`agreement`] |
//! | What can be tuned? | [`MappingSettings`] |
//! | How are ROS `map_server` files read and written? | [`read_map`], [`write_map`]; [`map_image`] has their halves, image and description |
//! | Where is a map kept between two runs of its service? | [`store`] |
//! | How are logs and benchmark maps in other formats read? | [`carmen`], [`parse_moving_ai_map`], [`parse_moving_ai_scenarios`] |
//!
//! # Files
//!
//! | file | subject |
//! |---|---|
//! | `settings` | all tunables |
//! | `beams`, `no_return` | the usable beams of a scan, and the reading that means no return |
//! | `sensor_model` | the inverse sensor model, in bytes of log-odds |
//! | `log_odds` | the grid: tiles, the bitmap of one scan, temporal decay, snapshots |
//! | `mapper` | a robot's scans in, patches out |
//! | `build` | maps from recorded scans, and their agreement |
//! | `map_file`, [`map_image`], `map_yaml`, `image`, `atomic` | `map_server` files |
//! | [`store`] | a map on disk between two runs of its service |
//! | [`carmen`], `moving_ai` | logs and benchmark maps in other formats |

mod atomic;
mod beams;
mod build;
pub mod carmen;
mod image;
mod log_odds;
mod map_file;
pub mod map_image;
mod map_yaml;
mod mapper;
mod moving_ai;
mod no_return;
mod sensor_model;
mod settings;
pub mod store;

// Maps from scans.
pub use build::{Agreement, BuildError, BuiltMap, agreement, build_map};
pub use log_odds::{BeamCount, CellCounts, GridSnapshot, InsertMode, LogOddsGrid};
pub use mapper::{Insertion, MapSnapshot, Mapper};
pub use settings::{BeamSettings, MappingSettings, SensorModel};

// Map files.
pub use atomic::write_atomically;
pub use map_file::{MapFileError, read_map, write_map};
pub use moving_ai::{MovingAiError, MovingAiScenario, cell_from_top, parse_moving_ai_map, parse_moving_ai_scenarios};
