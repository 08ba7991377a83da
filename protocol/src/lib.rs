//! The contract between robot and cloud: everything two machines of zenav must agree on.
//!
//! Plain data and pure functions, without a network: geometry, grids, robot files, messages, the key table, codecs, the lease. With the
//! feature `bus` also typed publish, subscribe and ask over [Zenoh](https://zenoh.io); no other crate of zenav names Zenoh.
//!
//! | module | subject |
//! |---|---|
//! | [`geometry`] | poses, twists, angles (REP-103); frames in names, `a_from_b` |
//! | [`polygon`] | simple polygons: edges, area, point inside |
//! | [`grid`] | the grid convention, occupancy values, the one ray walk |
//! | [`trajectory`] | a path in time: sample, splice, nearest ahead |
//! | [`time`] | stamps in nanoseconds |
//! | [`token_bucket`] | messages that come too fast |
//! | [`id`] | names that are valid in a key, and unique ids |
//! | [`robot`] | footprint, limits and sensors of a robot, and its TOML file |
//! | [`drive`] | wheels, their limits and kinematics |
//! | [`sensors`] | sensors: model, bounds, reading and message, one file for each kind |
//! | [`gains`], [`wall_following`] | path trackers and the wall follower: settings and their bounds |
//! | [`energy`] | electrical power that a robot draws |
//! | [`readings`] | sensor readings, from a body to its edge |
//! | [`messages`] | everything that crosses the wire |
//! | [`topics`] | the key table: key, message, quality of service, producer |
//! | [`member`], [`access`] | the members of a fleet, and which keys each may use |
//! | [`codec`] | JSON and CBOR |
//! | [`lease`] | lease arbiter: who may command a robot |
//! | [`map_replica`], [`padding`] | a copy of a map on another machine |
//! | [`mod@settings`] | settings: one declaration for each, with default, unit and bounds |
//! | [`config_text`] | configuration files: bounds, lines, numbers |
//! | `bus` | typed Zenoh (feature `bus`) |

// `settings!` names this crate by its name, in here too.
extern crate self as zenav_protocol;

pub mod access;
#[cfg(feature = "bus")]
pub mod bus;
pub mod codec;
pub mod config_text;
pub mod drive;
pub mod energy;
pub mod gains;
pub mod geometry;
pub mod grid;
pub mod id;
pub mod lease;
pub mod map_replica;
pub mod member;
pub mod messages;
pub mod padding;
pub mod polygon;
pub mod readings;
pub mod robot;
mod robot_check;
pub mod sensors;
pub mod settings;
pub mod time;
pub mod token_bucket;
pub mod topics;
pub mod trajectory;
pub mod wall_following;

/// Version of the message schema. Two components that communicate must have the same one; each states it in its `info` reply.
pub const SCHEMA_VERSION: u32 = 5;
