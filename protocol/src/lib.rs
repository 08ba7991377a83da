//! What two machines of zenav must agree on.
//!
//! | module | holds |
//! |---|---|
//! | [`geometry`] | poses, twists, angles (REP-103) |
//! | [`polygon`] | outlines: edges, area, inside or not |
//! | [`grid`] | the grid convention, occupancy values, the one ray walk |
//! | [`time`] | stamps in nanoseconds |
//! | [`id`] | names that may stand in a key |
//! | [`robot`] | a robot's footprint, limits and sensors, and its TOML file |
//! | [`drive`] | wheels, their limits and kinematics |
//! | [`sensors`] | what a robot senses with: one file a kind |
//! | [`gains`] | how a robot follows its plan: tracker, gains and their bounds |
//! | [`energy`] | motors, and what it costs a battery to move a robot |
//! | [`readings`] | what a body gives its pilot |
//! | [`map_replica`], [`padding`] | a copy of a map, kept by patches |
//! | [`messages`] | everything that crosses the wire |
//! | [`lease`] | who may command a robot |
//! | [`topics`] | the key table |
//! | [`wall_following`] | how a robot follows walls |
//! | [`settings`] | what can be tuned: one declaration a setting |
//! | [`config_text`] | what users write in files: pairs, bounds, lines |
//! | [`codec`] | JSON and CBOR by encoding |
//! | `bus` | typed Zenoh (feature `bus`) |

// `settings!` names this crate by its name, in here too.
extern crate self as zenav_protocol;

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
pub mod messages;
pub mod padding;
pub mod polygon;
pub mod readings;
pub mod robot;
mod robot_check;
pub mod sensors;
pub mod settings;
pub mod time;
pub mod topics;
pub mod wall_following;

/// Version of the message schema. Two components that talk must have the same one: each says it in its `info` reply.
pub const SCHEMA_VERSION: u32 = 1;
