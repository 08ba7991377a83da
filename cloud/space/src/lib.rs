//! The configuration space of a mobile robot on an occupancy grid. Which poses are valid, and how far the robot is from obstacles there.
//!
//! For a robot with footprint `A` on a map whose occupied cells are closed squares `O`, a pose `q` is valid if `A(q)` and `O` do not
//! meet, and clearance is the distance from `A(q)` to `O`. This library computes both exactly, for poses, straight legs, turns on the
//! spot and sweeps between poses: in closed form, against the squares themselves, so that nothing depends on a sampling step and a single
//! occupied cell is never missed. A disc that only touches a square collides with it.
//!
//! For searches it keeps one bit per cell, set where the inscribed disc fits ([`ConfigurationSpace::free`]) by an exact Euclidean
//! distance field ([`DistanceField`]), and a line of sight between any two points ([`LineOfSight`]). Both are updated tile by tile when
//! the map changes, and the result equals a new build.
//!
//! ```
//! use nalgebra::Point2;
//! use zenav_protocol::geometry::Pose2;
//! use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
//! use zenav_protocol::robot::Footprint;
//! use zenav_space::{ConfigurationSpace, UnknownPolicy};
//!
//! let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
//! let mut map = Grid::filled(spec, Occupancy::FREE);
//! map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // the square from (2.0, 2.0) to (2.1, 2.1)
//!
//! let corners = [(-0.4, -0.15), (0.4, -0.15), (0.4, 0.15), (-0.4, 0.15)];
//! let footprint = Footprint::Polygon(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
//! let space = ConfigurationSpace::new(&map, &footprint, UnknownPolicy::Blocked, 0.0);
//!
//! // Beside the square it fits lengthways and not across.
//! let along = Pose2::new(1.8, 2.05, std::f64::consts::FRAC_PI_2);
//! assert!(space.is_valid(along) && !space.is_valid(Pose2 { yaw: 0.0, ..along }));
//! assert!((space.footprint_clearance(along) - 0.05).abs() < 1e-9);
//! assert!(!space.turn_is_free(along.position(), along.yaw, 0.0));
//! ```
//!
//! # Files
//!
//! | file | answers |
//! |---|---|
//! | `configuration` | which cells admit the robot, and how far is any point from an obstacle? |
//! | `validity` | does the true footprint fit at a pose, along a segment, along a sweep of poses? |
//! | `body` | does the true footprint have room to drive straight, to turn on the spot, to move a little? |
//! | `line_of_sight` | is the straight path between two points free? |
//! | `distance` | how far is each cell's centre from the nearest occupied square, up to a reach? |
//! | `distance::{truncated, encoding}` | how are truncated distances computed fast, and how are they encoded? |
//! | `distance::{exact, lower_envelope}` | how far is it without a limit? |
//! | `distance_cost` | what does it cost to be near obstacles? |
//! | [`reach`] | which places are reachable at all? |
//! | `zones`, `raster` | where must the robot not be, where must it be slow, and which cells does that touch? |
//! | `cache`, `update` | which space belongs to a map, a robot and a policy, and what changes with the map? |
//! | `bits` | which cells of a grid have a property, 64 to a word? |
//! | `shapes`, `sweep` | how far is a shape from a square, and which columns of a row does a moved shape meet? |

mod bits;
mod body;
mod cache;
mod configuration;
mod distance;
mod distance_cost;
mod line_of_sight;
mod raster;
pub mod reach;
mod shapes;
mod sweep;
mod update;
mod validity;
mod zones;

pub use bits::BitGrid;
pub use body::{convex_hull, swept_corners};
pub use cache::{Fit, SpaceCache};
pub use configuration::{ConfigurationSpace, UnknownPolicy};
pub use distance::exact::squared_distances;
pub use distance::{DistanceField, MAX_REACH};
pub use distance_cost::DistanceCost;
pub use line_of_sight::{LineOfSight, PointLineOfSight};
pub use raster::CellMask;
pub use update::GridChanged;
pub use zenav_protocol::config_text::TextError as ZonesError;
pub use zones::{ZoneError, Zones};
