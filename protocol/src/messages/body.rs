//! Remote body. How does an edge drive a robot body in another process: a simulated world, or a driver in any language?
//!
//! The body publishes [`Readings`](crate::readings::Readings) each tick, and the edge answers with [`WheelSpeeds`]. A body that receives no
//! wheel speeds for 0.1 s stops its wheels.

use serde::{Deserialize, Serialize};

use crate::geometry::Pose2;
use crate::robot::RobotModel;
use crate::time::Stamp;

/// Commanded wheel speeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WheelSpeeds {
    /// Stamp of the readings that these speeds answer.
    pub stamp: Stamp,
    /// Speeds of the left and the right wheel, rad/s.
    pub wheels: [f64; 2],
    /// Which edge sends the command: the number in its [`AttachRequest`]; 0 for a body without attach requests.
    #[serde(default)]
    pub edge: u64,
}

/// Puts a robot into a served world, or takes over a robot in it that no edge drives any more.
///
/// If two edges use one name, the second is refused with `Busy`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AttachRequest {
    /// The robot's id.
    pub robot: String,
    /// Footprint, limits and sensors of the simulated body.
    pub model: RobotModel,
    /// Start pose, map frame; without it, the world's own start. A robot that is already in the world stays where it is.
    pub start: Option<Pose2>,
    /// Identifies this start of the edge: a random number up to 2^53. The body obeys only wheel speeds that carry it.
    #[serde(default)]
    pub edge: u64,
}

/// Answer to an attach request: the robot is in the world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AttachReply {
    /// Name of the world.
    pub world: String,
    /// The robot's pose, map frame.
    pub start: Pose2,
    /// Time between readings, s of simulated time.
    pub tick_secs: f64,
    /// Simulated seconds per second of wall time.
    pub speed: f64,
}
