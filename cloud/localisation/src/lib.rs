//! Localisation in the plane. Estimates the robot's pose in a known map, and whether it can be trusted.
//!
//! # The problem
//!
//! Given an occupancy map, and scans with the odometry at their stamps; wanted is `map_from_base` at each scan, its covariance, and a
//! statement of health: tracking, degraded along a direction, searching, lost, or ambiguous. A covariance alone does not reveal that the
//! robot is in the wrong room; contradictions between scan and map do.
//!
//! 1. **tracking** ([`Localiser::step`]): the pose by odometry is refined on the map's likelihood field. If the match is doubtful, an exact
//!    search of a window around it decides.
//! 2. **evidence** ([`evidence()`]): the share of the scan's points in known cells that agrees with the map. Cells that the map does not
//!    know do not count: unmapped rooms are no contradiction.
//! 3. **global search** ([`find`]): all positions and headings of the map, by exact branch and bound. The best places are refined and
//!    weighed by evidence; if two agree with the scan about equally well, the answer is ambiguous and lists all of them.
//!
//! Frames: `map` is the map's, `base` the robot's. Metres, radians, seconds. No clock, no randomness, no files.
//!
//! # Use
//!
//! `cargo run --release -p zenav-localisation --example find_me` finds a robot in a house without a guess, and follows it.
//!
//! | file | answers |
//! |---|---|
//! | `localiser` | where is the robot now, and is that right? |
//! | `global` | where in the whole map could this scan be from? |
//! | `track_record` | was the robot carried away, or has the building changed? |
//! | `view` | what has a lost robot seen so far? |
//! | `faces` | how far behind the walls of the map does the lidar see them? |
//! | `known_map` | how near is a point to a wall, and is its cell known? |
//! | `evidence` | how much of a scan agrees with the map? |
//! | `settings` | what can be tuned? |

mod evidence;
mod faces;
mod global;
mod known_map;
mod localiser;
mod settings;
mod track_record;
mod view;

pub use evidence::{Evidence, evidence};
pub use global::{Found, Hypothesis, find, is_one_place};
pub use known_map::KnownMap;
pub use localiser::{Localiser, Located};
pub use settings::{EvidenceSettings, GlobalSettings, LocalisationSettings, TrackingSettings};
