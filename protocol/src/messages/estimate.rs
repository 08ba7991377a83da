//! Pose estimates. Where does the robot estimate itself to be, and what corrects the estimate?

use std::fmt;

use serde::{Deserialize, Serialize};

use super::is_first;
use crate::geometry::{Pose2, Twist2};
use crate::time::Stamp;

/// Dead reckoning: continuous, drifting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Odometry {
    /// Time of the measurement.
    pub stamp: Stamp,
    /// Pose in the odometry frame.
    pub odom_from_base: Pose2,
    /// Velocity in the base frame.
    pub velocity: Twist2,
    /// Wheel angles since start, left and right, rad.
    pub wheels: [f64; 2],
}

/// The robot's own pose estimate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PoseEstimate {
    /// Time that the estimate is for.
    pub stamp: Stamp,
    /// Pose in the map.
    pub map_from_base: Pose2,
    /// Row-major covariance of (x, y, yaw), m², m rad, rad².
    pub covariance: [f64; 9],
    /// Velocity in the base frame.
    pub velocity: Twist2,
    /// Map frame that the pose is in, as far as the robot knows.
    #[serde(default, skip_serializing_if = "is_first")]
    pub frame: u64,
}

/// A pose measurement made off board; the estimator gates and fuses it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
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
    /// A global search found the robot: the estimate is replaced, not corrected, and the robot drives no plan made before.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_found_anew: bool,
    /// Frame of the map that the pose is in. A correction in an older frame has no effect.
    #[serde(default, skip_serializing_if = "is_first")]
    pub frame: u64,
    /// How the map around the robot moved at the start of each of the last frames, `new_from_old`; the move into `frame` is last.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub moves: Vec<Pose2>,
}

/// Whether the robot's pose in the map can be trusted: a verdict, not a covariance.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "state")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Health {
    /// The scans agree with the map.
    #[default]
    Tracking,
    /// The scans do not contradict the map, but leave the pose undetermined along one direction, as in a corridor, or see too little.
    Degraded {
        /// That direction in the map, rad.
        direction: f64,
    },
    /// The pose is not known, and a search of the whole map for it is pending or running.
    Searching,
    /// The scans contradict the map, and no other pose that agrees was found: the robot must not drive by this map. The search is repeated.
    Lost,
    /// The scan agrees about equally well with several poses.
    Ambiguous {
        /// Those poses, `map_from_base`, the best first.
        hypotheses: Vec<Pose2>,
    },
    /// The pose is the robot's own estimate, and its scans were not compared with a known map: there is none about it, or the pose was just
    /// set.
    Unchecked,
    /// The pose is the robot's own estimate, and the scans contradict the known map: the pose or the map is wrong, or the building has
    /// changed. The robot drives all the same; the mission reaches no goal while more than a quarter of the beams pass through walls.
    Contradicted,
}

impl Health {
    /// Whether the robot may drive by its pose in the map.
    #[must_use]
    pub const fn is_trusted(&self) -> bool {
        !matches!(self, Self::Searching | Self::Lost | Self::Ambiguous { .. })
    }
}

impl fmt::Display for Health {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tracking => formatter.write_str("tracking"),
            Self::Degraded { direction } => write!(formatter, "degraded along {direction:.2} rad"),
            Self::Searching => formatter.write_str("searching"),
            Self::Lost => formatter.write_str("lost"),
            Self::Ambiguous { hypotheses } => write!(formatter, "ambiguous: {} places", hypotheses.len()),
            Self::Unchecked => formatter.write_str("unchecked: its scans were not compared with a known map"),
            Self::Contradicted => formatter.write_str("contradicted: its scans do not agree with the map"),
        }
    }
}

/// How well the robot is localised, reported by the off-board source of poses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Localisation {
    /// Stamp of the scan that it was computed from (the edge's clock).
    pub stamp: Stamp,
    /// Boot that the stamp belongs to.
    pub boot_id: String,
    /// Whether the pose can be trusted.
    pub health: Health,
    /// Best available pose in the map at that stamp.
    pub map_from_base: Pose2,
    /// Share of the scan's points near known cells that agree with the map, 0 to 1.
    pub agreeing: f64,
    /// Share of the scan's beams that pass through walls of the map, 0 to 1.
    pub through_walls: f64,
}

/// Simulated time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SimClock {
    /// Now, ns since the simulation began.
    pub stamp: Stamp,
}
