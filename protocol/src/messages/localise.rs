//! Localise. Where is the robot said to be, and is it to be looked for?

use serde::{Deserialize, Serialize};

use super::Health;
use crate::geometry::Pose2;

/// Asks how well the robot is localised, tells where it is, or has it looked for in the whole map.
///
/// While somebody holds the robot's lease, every action but `report` must carry the lease's epoch.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LocaliseRequest {
    /// What is to be done; without it, only answer.
    #[serde(default)]
    pub action: LocaliseAction,
    /// Where the robot is, `map_from_base`, for `at`.
    pub pose: Option<Pose2>,
    /// Lease epoch of the asker, for every action but `report`.
    pub epoch: Option<u64>,
}

/// What is to be done about the robot's place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum LocaliseAction {
    /// Only answer.
    #[default]
    Report,
    /// The robot is at `pose`, to within some decimetres: it goes on from there.
    At,
    /// Nobody knows where it is: it is looked for in the whole map.
    Global,
}

/// How well the robot is localised.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LocaliseReply {
    /// Whether its place can be trusted.
    pub health: Health,
}
