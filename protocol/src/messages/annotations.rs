//! Annotations. Which named places, keep-out zones and speed zones have people drawn on a robot's map?
//!
//! The mapping service is the only writer. It starts with the annotations of the world and deployment files, keeps later changes in its
//! data folder, and publishes all of them as one value.

use std::collections::BTreeMap;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::{GoalPoint, is_first};

/// Places and zones of a robot's map.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Annotations {
    /// Number of changes since the data folder was created.
    #[serde(default)]
    pub revision: u64,
    /// Named goals, map frame.
    #[serde(default)]
    pub places: BTreeMap<String, GoalPoint>,
    /// Zones in the order of their names, each name once.
    #[serde(default)]
    pub zones: Vec<Zone>,
    /// Frame of the map that the coordinates are in.
    #[serde(default, skip_serializing_if = "is_first")]
    pub frame: u64,
}

/// An area of the map with a rule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Zone {
    /// Name of the zone, for display.
    pub name: String,
    /// The rule inside the zone.
    pub rule: ZoneRule,
    /// Corners of a simple polygon in order, map frame, m.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub points: Vec<Point2<f64>>,
}

/// Rule inside a zone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ZoneRule {
    /// No part of a robot may enter.
    KeepOut,
    /// A robot drives slowly while its centre is inside.
    SpeedLimit {
        /// Largest speed, m/s.
        max_speed: f64,
    },
}

/// Reads the annotations of a robot's map, or changes them.
///
/// While the robot's lease is held, every action but `get` must carry the lease's epoch, as for [`MapRequest`](super::MapRequest).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AnnotateRequest {
    /// The change; without it, the request only reads.
    #[serde(default)]
    pub action: AnnotateAction,
    /// Identifies the request: a repeated request is not carried out again; it gets the first answer.
    pub request_id: Option<String>,
    /// Lease epoch in force, for every action but `get`.
    pub epoch: Option<u64>,
}

/// A change of the annotations.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum AnnotateAction {
    /// Read only.
    #[default]
    Get,
    /// Add a place, or move the existing one of this name.
    AddPlace {
        /// Name of the place.
        name: String,
        /// Position and heading of the place, map frame.
        at: GoalPoint,
    },
    /// Remove a place.
    RemovePlace {
        /// Name of the place.
        name: String,
    },
    /// Add a zone, or replace the existing one of this name.
    AddZone {
        /// The zone.
        zone: Zone,
    },
    /// Remove a zone.
    RemoveZone {
        /// Name of the zone.
        name: String,
    },
    /// Remove all zones.
    ClearZones,
}
