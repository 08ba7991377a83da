//! What does the world look like? Scans become a map; maps are kept, read and handed on.
//!
//! | file | answers |
//! |---|---|
//! | [`beams`] | which beams of a scan tell something, and what? |
//! | [`sensor_model`] | what does one look at a cell say? |
//! | [`occupancy`] | what is where? a log-odds grid that grows |
//! | `tiles`, `tile` | how does it grow, and what is known of a square of cells? |
//! | `scan_bitmap` | which cells did one scan look at? |
//! | `decay` | what went away without being seen to go? |
//! | [`mapper`], [`config`] | how do a robot's scans become its map? |
//! | [`map_file`], [`map_image`], [`map_yaml`], [`image`], [`atomic`] | how are maps kept in `map_server` files? |
//! | [`moving_ai`] | what do the Moving AI benchmarks say? |
//! | [`store`] | what of a map outlives its service? |
//! | [`carmen`], [`build`] | what did a robot of the CARMEN days see, and how do recorded scans become a map? |

pub mod atomic;
pub mod beams;
pub mod build;
pub mod carmen;
pub mod config;
mod decay;
pub mod image;
pub mod map_file;
pub mod map_image;
pub mod map_yaml;
pub mod mapper;
pub mod moving_ai;
pub mod occupancy;
mod scan_bitmap;
pub mod sensor_model;
pub mod store;
mod tile;
mod tiles;

pub use beams::BeamOptions;
pub use config::{MapperConfig, MapperConfigError};
pub use mapper::{Insertion, Mapper};
pub use occupancy::{CellCounts, Drawn, InsertMode, LogOddsGrid};
pub use sensor_model::SensorModel;
