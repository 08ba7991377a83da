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
//! [`Mapper`] is the complete mapper of a live robot: [`insert`](Mapper::insert) scans, [`take_patch`](Mapper::take_patch) for replicas on
//! other machines, [`snapshot`](Mapper::snapshot) for files and pictures. [`LogOddsGrid`] is the grid alone, [`build::build_map`] builds a
//! map from a recorded log, [`map_file`] reads and writes ROS `map_server` files.
//!
//! | file | subject |
//! |---|---|
//! | `settings` | all tunables: [`MappingSettings`] |
//! | `beams` | the usable beams of a scan |
//! | `sensor_model` | the inverse sensor model, in bytes of log-odds |
//! | `log_odds` | the grid: tiles, the bitmap of one scan, temporal decay, snapshots |
//! | `mapper` | a robot's scans in, patches out |
//! | [`build`] | maps from recorded scans, and their agreement |
//! | [`map_file`], [`map_yaml`], [`map_image`], [`image`], [`atomic`] | `map_server` files |
//! | [`store`] | a map on disk between two runs of its service |
//! | [`carmen`], [`moving_ai`] | logs and benchmark maps in other formats |

pub mod atomic;
mod beams;
pub mod build;
pub mod carmen;
pub mod image;
mod log_odds;
pub mod map_file;
pub mod map_image;
pub mod map_yaml;
mod mapper;
pub mod moving_ai;
mod no_return;
mod sensor_model;
mod settings;
pub mod store;

pub use build::{Agreement, BuildError, Built, agreement, build_map};
pub use log_odds::{BeamCount, CellCounts, GridSnapshot, InsertMode, LogOddsGrid};
pub use map_file::{MapFileError, read_map, write_map};
pub use mapper::{Insertion, MapSnapshot, Mapper};
pub use settings::{BeamSettings, MappingSettings, SensorModel};
