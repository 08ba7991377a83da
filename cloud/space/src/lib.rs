//! Where may a robot be? The configuration space that planning and smoothing stand on.
//!
//! | file | answers |
//! |---|---|
//! | [`body`] | has the true footprint room to drive straight, to turn on the spot, to move a little? |
//! | [`bits`] | which cells of a grid have a property, 64 to a word? |
//! | [`distance`] | how far is each cell's centre from the nearest occupied square, up to a reach? |
//! | `distance::truncated` | how are truncated distances found fast? |
//! | `distance::encoding` | how is a squared distance written down? |
//! | [`distance::exact`], `distance::lower_envelope` | how far is it at any distance? |
//! | [`configuration`] | which cells admit the robot, and how far is any point from an obstacle? |
//! | `update` | what of a space changes when tiles of its map change? |
//! | [`cache`] | which space belongs to a map, a robot and a policy? |
//! | [`costmap`] | what does it cost to be near obstacles? |
//! | [`zones`] | where may the robot not be, and where must it be slow? |
//! | [`raster`] | which cells does a closed polygon touch? |
//! | `shapes` | how far is a disc, a moved disc, a polygon from the nearest occupied square? |
//! | [`reach`] | which places can be got to at all? |
//! | [`line_of_sight`] | can one go straight from here to there? |
//! | `sweep` | which columns of a row does a moved shape meet? |
//! | [`checker`] | may the robot be at a pose, may it follow a path? |
//! | [`validity`] | does the true footprint fit at a pose, along a segment, along a sweep of poses? |
//!
//! An occupied cell is a closed square: a disc that only touches one collides with it. All exact checks go against those
//! squares, so nothing depends on a sampling step and a single occupied cell is never missed.

pub mod bits;
pub mod body;
pub mod cache;
pub mod checker;
pub mod configuration;
pub mod costmap;
pub mod distance;
pub mod line_of_sight;
pub mod raster;
pub mod reach;
mod shapes;
mod sweep;
mod update;
pub mod validity;
pub mod zones;

pub use bits::BitGrid;
pub use cache::SpaceCache;
pub use checker::StateValidityChecker;
pub use configuration::{ConfigurationSpace, UnknownPolicy};
pub use costmap::{Costmap, DistanceCost};
pub use distance::DistanceField;
pub use line_of_sight::{LineOfSight, PointLineOfSight};
pub use update::GridChanged;
pub use zones::Zones;
