//! Occupancy grid map. What does the mapped world look like, what changed, and how is mapping controlled?

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::is_first;
use crate::grid::{GridError, GridSpec, OccupancyGrid};
use crate::time::Stamp;

/// Side of a map tile, cells.
pub const TILE: u32 = 64;

/// A map at a revision.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MapRef {
    /// Identifies the map; new for every map that is started.
    pub id: String,
    /// Number of the map's latest change.
    pub revision: u64,
    /// Frame of the map's coordinates: a loop closure that moves the map starts the next one.
    #[serde(default, skip_serializing_if = "is_first")]
    pub frame: u64,
}

impl MapRef {
    /// A map in its first frame.
    #[must_use]
    pub fn new(id: impl Into<String>, revision: u64) -> Self {
        Self {
            id: id.into(),
            revision,
            frame: 0,
        }
    }
}

/// Description of a map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MapInfo {
    /// Stamp of the newest scan in the map, on the robot's clock.
    pub stamp: Stamp,
    /// The map and its revision.
    pub map: MapRef,
    /// Geometry of the map's grid.
    pub spec: GridSpec,
    /// Number of free cells.
    pub free: u64,
    /// Number of occupied cells.
    pub occupied: u64,
    /// Number of unknown cells.
    pub unknown: u64,
    /// Number of scans inserted.
    pub scans: u64,
    /// Whether the map was loaded from a file, or saved as complete (a behaviour tree's `DoesMapExist`).
    pub stored: bool,
}

/// The mapping service that leads: it alone writes the robot's map. Repeated several times a second, also when nothing changes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MappingLeader {
    /// Name of the service, unique to its process.
    pub name: String,
    /// Number of its leadership; a service that begins to lead begins the next one that it knows of. Of two leaders the one with the lower
    /// number steps back; of equal ones the one with the lower revision of the map, then the one whose name sorts first.
    pub term: u64,
    /// The map that it writes, at its newest revision; without an id while it is being loaded.
    pub map: MapRef,
    /// Whether the map is held: no scan is inserted into it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub held: bool,
}

/// A square block of a map's cells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Tile {
    /// Column of the tile; its first cell has column `TILE * x`.
    pub x: u32,
    /// Row of the tile; its first cell has row `TILE * y`.
    pub y: u32,
    /// `TILE * TILE` occupancy values, row-major from the lowest row; cells beyond the grid are -1.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<i8>"))]
    #[serde(with = "occupancy_bytes")]
    pub values: Vec<i8>,
}

/// Tiles that changed from one revision to the next. Tiles carry values, not differences.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MapPatch {
    /// Stamp of the newest scan in the map, on the robot's clock.
    pub stamp: Stamp,
    /// The map, at its revision after the patch.
    pub map: MapRef,
    /// The revision that the patch applies to; zero is the all-unknown map. A replica at another revision requests the whole map.
    pub base_revision: u64,
    /// Geometry of the whole map after the patch; the map may have grown, by whole tiles.
    pub spec: GridSpec,
    /// The changed tiles.
    pub tiles: Vec<Tile>,
}

/// Asks for the map, or controls mapping.
///
/// The selector's parameter `format` (`json`, `png`, `pgm`, `yaml`, `cbor`) selects the format of the map. While the robot's lease is held,
/// every action but `get` and `list` must carry the lease's epoch, as in `{"action": "reset", "epoch": 7}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MapRequest {
    /// What mapping is to do; without it, the request only reads the map.
    #[serde(default)]
    pub action: MapAction,
    /// Identifies the request: a repeated request is not carried out again; it gets the first answer.
    pub request_id: Option<String>,
    /// Lease epoch of the requester, for every action that changes the map.
    pub epoch: Option<u64>,
    /// Name of a stored map, for `save` (a copy beside the robot's own map) and `load`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// For `load` without a name: the map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<GivenMap>,
    /// For `load`: keep inserting scans into the loaded map instead of holding it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub live: bool,
}

/// A map sent with a request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GivenMap {
    /// Geometry of the map's grid.
    pub spec: GridSpec,
    /// Occupancy of every cell, row-major from the lowest row.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<i8>"))]
    #[serde(with = "occupancy_bytes")]
    pub values: Vec<i8>,
}

/// What mapping is asked to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum MapAction {
    /// Return the map.
    #[default]
    Get,
    /// Store the map as `map_server` files; the map then counts as complete.
    Save,
    /// Start a new, all-unknown map, and insert scans into it.
    Reset,
    /// Insert scans again. A map loaded from a file is held until then.
    Resume,
    /// Hold the map: stop inserting scans.
    Hold,
    /// Let every recent obstacle decay at once; obstacles that are still there will be seen again.
    Forget,
    /// Replace the map by a stored one or by the one in the request; it counts as complete, and is held unless `live` is set.
    Load,
    /// List the stored maps.
    List,
}

/// A map stored beside the robot's own.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StoredMapInfo {
    /// Name of the stored map.
    pub name: String,
    /// The map and its revision, as far as recorded.
    pub map: MapRef,
    /// Number of scans in the map.
    pub scans: u64,
}

/// The whole map, or the answer to an action.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MapReply {
    /// Description of the map.
    pub info: MapInfo,
    /// Occupancy of every cell, row-major from the lowest row; empty in the answer to an action.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<i8>"))]
    #[serde(with = "occupancy_bytes")]
    pub values: Vec<i8>,
    /// Positions of the robot while the map was built, map frame, about every 0.1 m.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub trajectory: Vec<Point2<f64>>,
    /// For `list`: maps stored beside the robot's own, ordered by name.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stored: Vec<StoredMapInfo>,
}

impl MapReply {
    /// The map as a grid.
    ///
    /// # Errors
    /// [`GridError`] for a geometry that is out of bounds, or values that do not fill it.
    pub fn grid(&self) -> Result<OccupancyGrid, GridError> {
        OccupancyGrid::from_values(self.info.spec.checked()?, self.values.clone())
    }
}

/// Occupancy values: an array of numbers in JSON, one byte string in CBOR.
mod occupancy_bytes {
    use std::fmt;

    use serde::de::{SeqAccess, Visitor};
    use serde::{Deserializer, Serializer};

    pub fn serialize<S: Serializer>(values: &[i8], serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            serializer.collect_seq(values)
        } else {
            let bytes: Vec<u8> = values.iter().map(|value| value.cast_unsigned()).collect();
            serializer.serialize_bytes(&bytes)
        }
    }

    struct Values;

    impl<'de> Visitor<'de> for Values {
        type Value = Vec<i8>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("occupancy values from -1 to 100")
        }

        fn visit_bytes<E>(self, bytes: &[u8]) -> Result<Vec<i8>, E> {
            Ok(bytes.iter().map(|byte| byte.cast_signed()).collect())
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Vec<i8>, A::Error> {
            let mut values = Vec::new();
            while let Some(value) = seq.next_element()? {
                values.push(value);
            }
            Ok(values)
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<i8>, D::Error> {
        deserializer.deserialize_any(Values)
    }
}
