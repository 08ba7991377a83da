//! Pose estimates. Where does the robot believe to be, and who corrects it?

use std::fmt;

use serde::{Deserialize, Serialize};

use super::is_first;
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
    /// Frame of the map that the pose is in, as the robot knows it.
    #[serde(default, skip_serializing_if = "is_first")]
    pub frame: u64,
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
    /// The robot was found anew, in a search of the whole map: its belief is replaced, not corrected, and it drives no plan made before.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_found_anew: bool,
    /// Frame of the map that the pose is in. One of an older frame does nothing.
    #[serde(default, skip_serializing_if = "is_first")]
    pub frame: u64,
    /// How the robot's surroundings moved as each of the last frames began, `new_from_old`, the move into `frame` last.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub moves: Vec<Pose2>,
}

/// Whether the robot's place in the map can be trusted: a statement, not a covariance.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "state")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Health {
    /// The scans agree with the map.
    #[default]
    Tracking,
    /// They agree, but do not say where the robot is along a direction: a corridor.
    Degraded {
        /// That direction in the map, rad.
        direction: f64,
    },
    /// The scans contradict the map, and no place was found that they agree with: the robot must not drive by this map.
    Lost,
    /// Several places agree with the scan about as well.
    Ambiguous {
        /// Those places, `map_from_base`, the best first.
        hypotheses: Vec<Pose2>,
    },
}

impl Health {
    /// Whether the robot may drive by its place in the map.
    #[must_use]
    pub const fn is_trusted(&self) -> bool {
        matches!(self, Self::Tracking | Self::Degraded { .. })
    }
}

impl fmt::Display for Health {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tracking => formatter.write_str("tracking"),
            Self::Degraded { direction } => write!(formatter, "degraded along {direction:.2} rad"),
            Self::Lost => formatter.write_str("lost"),
            Self::Ambiguous { hypotheses } => write!(formatter, "ambiguous: {} places", hypotheses.len()),
        }
    }
}

/// How well the robot is localised, by the source of poses off board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Localisation {
    /// Stamp of the scan that it was computed from (the edge's clock).
    pub stamp: Stamp,
    /// Boot that the stamp belongs to.
    pub boot_id: String,
    /// Whether the place can be trusted.
    pub health: Health,
    /// Pose in the map at that stamp, the best there is.
    pub map_from_base: Pose2,
    /// Share of the scan's points about known cells that agree with the map, 0 to 1.
    pub agreeing: f64,
    /// Share of its beams that go through walls of the map, 0 to 1.
    pub through_walls: f64,
}

/// Simulated time, where there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SimClock {
    /// Now, ns since the simulation began.
    pub stamp: Stamp,
}
