//! Which robots may be put into a world, and why not?

use std::time::Duration;

use nalgebra::Point2;
use thiserror::Error;
use zenav_protocol::config_text::Number;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::robot::{RobotError, RobotModel};

/// Most robots in one world.
pub const MAX_ROBOTS: usize = 10_000;

/// A robot to put into a world.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotSpec {
    /// Its name: its noise depends on it and on the seed, not on other robots.
    pub id: Id,
    /// Footprint, limits, sensors.
    pub model: RobotModel,
    /// Where it starts, map frame.
    pub start: Pose2,
}

/// Why a simulation cannot begin.
#[derive(Debug, Error)]
pub enum SimError {
    /// Two robots have one name.
    #[error("two robots are named `{0}`")]
    Duplicate(Id),
    /// Values that no robot has.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The start is not a pose.
    #[error("robot `{0}`: its start is not finite")]
    NotFinite(Id),
    /// The start lies outside of what is meant to be driven in.
    #[error("robot `{robot}` cannot start at ({}, {}): the world reaches from ({}, {}) to ({}, {})", Number(at.x), Number(at.y), low.x, low.y, high.x, high.y)]
    Outside {
        /// The robot.
        robot: Id,
        /// Where, m.
        at: Point2<f64>,
        /// The world's lower-left corner, m.
        low: Point2<f64>,
        /// Its upper-right one, m.
        high: Point2<f64>,
    },
    /// Something stands where the robot should start: choose another start.
    #[error("robot `{robot}` cannot start at ({}, {}): something stands there", Number(*x), Number(*y))]
    Occupied {
        /// The robot.
        robot: Id,
        /// m.
        x: f64,
        /// m.
        y: f64,
    },
    /// A fault of the world is one of a sensor that no robot has.
    #[error("{at}: `fault.sensor` is `{sensor}`: expected a sensor that there is: {known}")]
    Fault {
        /// Where the fault is written: file and line.
        at: String,
        /// The sensor.
        sensor: String,
        /// The sensors that there are.
        known: String,
    },
    /// A fault of the world is one of a robot that is not in it.
    #[error("{at}: `fault.robot` is `{robot}`: expected a robot that there is: {known}")]
    FaultOfNobody {
        /// Where the fault is written: file and line.
        at: String,
        /// The robot.
        robot: Id,
        /// The robots that there are.
        known: String,
    },
    /// More robots than a world holds.
    #[error("{0} robots: expected at most {MAX_ROBOTS}")]
    TooMany(usize),
    /// The step is not usable.
    #[error("a step of {0:?}: expected 1 ms to 1 s")]
    Tick(Duration),
}
