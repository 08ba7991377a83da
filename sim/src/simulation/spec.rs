//! Robots of a simulation. Which robots may be put into a world, and why others are refused.

use std::time::Duration;

use nalgebra::Point2;
use thiserror::Error;
use zenav_protocol::config_text::Number;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::robot::{RobotError, RobotModel};

/// Largest number of robots in one world.
pub const MAX_ROBOTS: usize = 10_000;

/// A robot to put into a world.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotSpec {
    /// Its name; its noise depends on the name and on the seed, not on other robots.
    pub id: Id,
    /// Footprint, limits, sensors.
    pub model: RobotModel,
    /// Start pose, map frame.
    pub start: Pose2,
}

/// Why a simulation cannot begin, or a robot cannot be put or carried somewhere.
#[derive(Debug, Error)]
pub enum SimError {
    /// Two robots have one name.
    #[error("two robots are named `{0}`")]
    Duplicate(Id),
    /// Values that no robot may have.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The start or new place is not a pose.
    #[error("robot `{0}`: its pose is not finite")]
    NotFinite(Id),
    /// The place lies outside the part intended for driving.
    #[error("robot `{robot}` cannot stand at ({}, {}): the world reaches from ({}, {}) to ({}, {})", Number(at.x), Number(at.y), low.x, low.y, high.x, high.y)]
    Outside {
        /// Name of the robot.
        robot: Id,
        /// Where, m.
        at: Point2<f64>,
        /// The world's lower-left corner, m.
        low: Point2<f64>,
        /// Its upper-right one, m.
        high: Point2<f64>,
    },
    /// Something occupies the place: choose another one.
    #[error("robot `{robot}` cannot stand at ({}, {}): something stands there", Number(*x), Number(*y))]
    Occupied {
        /// Name of the robot.
        robot: Id,
        /// m.
        x: f64,
        /// m.
        y: f64,
    },
    /// A fault refers to a sensor that no robot has.
    #[error("{at}: `fault.sensor` is `{sensor}`: expected a sensor that there is: {known}")]
    Fault {
        /// File and line of the fault.
        at: String,
        /// Name that the fault gives.
        sensor: String,
        /// The sensors that there are.
        known: String,
    },
    /// A fault refers to a robot that is not in the simulation.
    #[error("{at}: `fault.robot` is `{robot}`: expected a robot that there is: {known}")]
    FaultOfNobody {
        /// File and line of the fault.
        at: String,
        /// Name of the robot.
        robot: Id,
        /// The robots that there are.
        known: String,
    },
    /// More robots than a world may hold.
    #[error("{0} robots: expected at most {MAX_ROBOTS}")]
    TooMany(usize),
    /// The step is not usable.
    #[error("a step of {0:?}: expected 1 ms to 1 s")]
    Tick(Duration),
}
