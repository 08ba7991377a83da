//! Pose estimates. Where does the robot believe to be, and who corrects it?

use serde::{Deserialize, Serialize};

use crate::geometry::{Pose2, Twist2};
use crate::time::Stamp;

/// Dead reckoning: continuous, drifting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Odometry {
    /// When it was measured.
    pub stamp: Stamp,
    /// Pose in the odometry frame.
    pub odom_from_base: Pose2,
    /// Velocity in the base frame.
    pub velocity: Twist2,
    /// Wheel angles since start, left and right, rad.
    pub wheels: [f64; 2],
}

/// The robot's own estimate of where it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PoseEstimate {
    /// When it holds.
    pub stamp: Stamp,
    /// Pose in the map.
    pub map_from_base: Pose2,
    /// Row-major covariance of (x, y, yaw), m², m rad, rad².
    pub covariance: [f64; 9],
    /// Velocity in the base frame.
    pub velocity: Twist2,
}

/// A pose measurement made off board, for the estimator to gate and fuse.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Correction {
    /// Stamp of the scan that it was computed from (the edge's clock).
    pub stamp: Stamp,
    /// Boot that the stamp belongs to.
    pub boot_id: String,
    /// Measured pose in the map.
    pub map_from_base: Pose2,
    /// Row-major covariance of (x, y, yaw).
    pub covariance: [f64; 9],
}

/// Simulated time, where there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SimClock {
    /// Now, ns since the simulation began.
    pub stamp: Stamp,
}
