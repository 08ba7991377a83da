//! What does the world look like? A map's description, its changed tiles, and the question for the whole.

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use crate::grid::{GridError, GridSpec, OccupancyGrid};
use crate::time::Stamp;

/// Side of a tile, cells.
pub const TILE: u32 = 64;

/// Which map, and which state of it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct MapRef {
    /// The map's name, new for every map that is begun.
    pub id: String,
    /// Grows with every change.
    pub revision: u64,
}

/// A map's description.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapInfo {
    /// Stamp of the newest scan in it.
    pub stamp: Stamp,
    /// Which map and revision.
    pub map: MapRef,
    /// Where the grid lies.
    pub spec: GridSpec,
    /// Free cells.
    pub free: u64,
    /// Occupied cells.
    pub occupied: u64,
    /// Unknown cells.
    pub unknown: u64,
    /// Scans inserted.
    pub scans: u64,
    /// Whether the map was loaded or has been saved as complete ("does map exist?").
    pub stored: bool,
}

/// A square of cells of a map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tile {
    /// Column of the tile: its first cell is `TILE * x`.
    pub x: u32,
    /// Row of the tile.
    pub y: u32,
    /// `TILE * TILE` occupancy values, row-major from the lowest row; cells beyond the grid are -1.
    #[serde(with = "occupancy_bytes")]
    pub values: Vec<i8>,
}

/// The tiles that changed from one revision to the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapPatch {
    /// Stamp of the newest scan in it.
    pub stamp: Stamp,
    /// Which map, and its revision after the patch.
    pub map: MapRef,
    /// The revision that the patch applies to; zero starts from an unknown map. A receiver with another one asks for the whole.
    pub base_revision: u64,
    /// The whole map's grid after the patch: it may have grown, by whole tiles.
    pub spec: GridSpec,
    /// Changed tiles.
    pub tiles: Vec<Tile>,
}

/// Question for a map; the selector's `format` parameter (`json`, `png`, `pgm`, `yaml`, `cbor`) says in which form.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MapRequest {
    /// Effects wanted besides the answer.
    #[serde(default)]
    pub action: MapAction,
    /// Who asks: the same id is answered with the first answer.
    #[serde(default)]
    pub request_id: Option<String>,
    /// Lease epoch, for an action that changes something.
    #[serde(default)]
    pub epoch: Option<u64>,
}

/// What a map question is to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MapAction {
    /// Only answer.
    #[default]
    Get,
    /// Store the map as `map_server` files, from now on "the map exists".
    Save,
    /// Begin a new, unknown map.
    Reset,
    /// Go on inserting scans (a stored map that was loaded is not changed until then).
    Resume,
    /// Insert no more scans.
    Hold,
    /// Take everything for gone that may only have passed by: what is still there is seen again.
    Forget,
}

/// A whole map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapReply {
    /// Its description.
    pub info: MapInfo,
    /// All values, row-major from the lowest row; empty when only an action was asked for.
    #[serde(with = "occupancy_bytes")]
    pub values: Vec<i8>,
    /// Poses of the robot while the map was built, map frame, about every 0.1 m.
    #[serde(default)]
    pub trajectory: Vec<Point2<f64>>,
}

impl MapReply {
    /// The grid.
    ///
    /// # Errors
    /// [`GridError`] when the description is not sane or the values do not fill it.
    pub fn grid(&self) -> Result<OccupancyGrid, GridError> {
        OccupancyGrid::from_values(self.info.spec.checked()?, self.values.clone())
    }
}

/// Occupancy values: an array of numbers in JSON, one byte string in CBOR.
mod occupancy_bytes {
    use std::fmt;

    use serde::de::{SeqAccess, Visitor};
    use serde::ser::SerializeSeq;
    use serde::{Deserializer, Serializer};

    pub fn serialize<S: Serializer>(values: &[i8], serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            let mut seq = serializer.serialize_seq(Some(values.len()))?;
            for value in values {
                seq.serialize_element(value)?;
            }
            seq.end()
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
        if deserializer.is_human_readable() {
            deserializer.deserialize_seq(Values)
        } else {
            deserializer.deserialize_any(Values)
        }
    }
}
