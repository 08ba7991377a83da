//! What does the world look like? Scans become a map; maps are kept, read and handed on.
//!
//! | file | answers |
//! |---|---|
//! | [`beams`] | which beams of a scan tell something, and what? |
//! | [`evidence`] | what does one look at a cell say? |
//! | [`occupancy`] | what is where? a log-odds grid that grows |
//! | [`mapper`] | how do a robot's scans become its map? |
//! | [`mirror`] | how does another machine keep a copy? |

pub mod beams;
pub mod evidence;
pub mod mapper;
pub mod mirror;
pub mod occupancy;
mod window;

pub use beams::BeamOptions;
pub use evidence::SensorModel;
pub use mapper::{Insertion, Mapper, MapperConfig};
pub use mirror::{MapMirror, Mirrored};
pub use occupancy::{CellCounts, InsertMode, LogOddsGrid};
