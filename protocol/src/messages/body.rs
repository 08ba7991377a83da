//! How does an edge drive a body that is in another process: a world served for many robots, or a driver in any language?
//!
//! The body publishes [`Readings`](crate::readings::Readings) each tick, the edge its [`WheelSpeeds`]. A body that hears none for 0.1 s
//! stops its wheels by itself.

use serde::{Deserialize, Serialize};

use crate::geometry::Pose2;
use crate::robot::RobotModel;
use crate::time::Stamp;

/// Wanted wheel speeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WheelSpeeds {
    /// Stamp of the readings that they answer.
    pub stamp: Stamp,
    /// Left and right, rad/s.
    pub wheels: [f64; 2],
    /// Which edge drives: the number of its [`AttachRequest`]; 0 for a body that asked for none.
    #[serde(default)]
    pub edge: u64,
}

/// Puts a robot into the served world, or takes hold again of one that is in it and that no edge drives any more: the second of two edges
/// of one name is told that the robot is busy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AttachRequest {
    /// The robot's id.
    pub robot: String,
    /// Footprint, limits and sensors of the simulated body.
    pub model: RobotModel,
    /// Where it starts, map frame; the world's own start without it. A robot that is there already stays where it is.
    pub start: Option<Pose2>,
    /// Which edge asks: a number of this life of it, up to 2^53. The robot obeys only wheel speeds that carry it.
    #[serde(default)]
    pub edge: u64,
}

/// The robot stands in the world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AttachReply {
    /// The world's name.
    pub world: String,
    /// Where the robot stands, map frame.
    pub start: Pose2,
    /// Simulated time between readings, s.
    pub tick_secs: f64,
    /// Simulated seconds a second of wall time.
    pub speed: f64,
}
