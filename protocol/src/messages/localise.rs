//! Localise. How well is the robot localised, where is it, and should mapping search for it?

use serde::{Deserialize, Serialize};

use super::Health;
use crate::geometry::Pose2;

/// Asks how well the robot is localised, states its pose, or starts a search of the whole map.
///
/// While the robot's lease is held, every action but `report` must carry the lease's epoch.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LocaliseRequest {
    /// The action; without it, the request only reports.
    #[serde(default)]
    pub action: LocaliseAction,
    /// The robot's pose, `map_from_base`, for `at`.
    pub pose: Option<Pose2>,
    /// Lease epoch of the requester, for every action but `report`.
    pub epoch: Option<u64>,
}

/// What to do about the robot's pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum LocaliseAction {
    /// Report only.
    #[default]
    Report,
    /// The robot is at `pose`, to within some decimetres; localisation continues from there.
    At,
    /// The pose is unknown: search the whole map.
    Global,
}

/// How well the robot is localised.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LocaliseReply {
    /// Whether the pose can be trusted.
    pub health: Health,
}
