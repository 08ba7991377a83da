//! Snapshot. The grid at one moment, in ROS's occupancy values.

use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};

use super::tiles::{TILE_SIDE, Tiles};
use crate::sensor_model::QuantizedModel;

/// Number of free, occupied and unknown cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellCounts {
    /// Number of free cells.
    pub free: u64,
    /// Number of occupied cells.
    pub occupied: u64,
    /// Number of unknown cells.
    pub unknown: u64,
}

impl CellCounts {
    /// Counts the classes of occupancy values.
    ///
    /// ```
    /// use zenav_mapping::CellCounts;
    ///
    /// let counts = CellCounts::of(&[-1, 0, 10, 100]);
    /// assert_eq!((counts.free, counts.occupied, counts.unknown), (2, 1, 1));
    /// ```
    #[must_use]
    pub fn of(values: &[i8]) -> Self {
        let mut counts = Self::default();
        for value in values {
            match Occupancy::of(*value) {
                Occupancy::Free => counts.free += 1,
                Occupancy::Occupied => counts.occupied += 1,
                Occupancy::Unknown => counts.unknown += 1,
            }
        }
        counts
    }
}

/// A grid at one moment. It shares its cells with the source grid until they change there.
#[derive(Clone, Debug)]
pub struct GridSnapshot {
    tiles: Tiles,
    model: QuantizedModel,
}

impl GridSnapshot {
    pub(super) fn new(tiles: Tiles, model: QuantizedModel) -> Self {
        Self { tiles, model }
    }

    /// Geometry of the grid.
    #[must_use]
    pub fn spec(&self) -> GridSpec {
        self.tiles.spec()
    }

    /// The grid as ROS's occupancy values. Cost: every cell.
    #[must_use]
    pub fn to_occupancy(&self) -> OccupancyGrid {
        to_occupancy(&self.tiles, &self.model)
    }
}

pub(super) fn to_occupancy(map: &Tiles, model: &QuantizedModel) -> OccupancyGrid {
    let mut grid = OccupancyGrid::filled(map.spec(), Occupancy::UNKNOWN);
    let columns = map.counts[0].max(1);
    let bands = grid.values_mut().chunks_exact_mut(columns * TILE_SIDE * TILE_SIDE);
    for (band, tiles) in bands.zip(map.tiles.chunks_exact(columns)) {
        for (column, tile) in tiles.iter().enumerate() {
            let Some(tile) = tile else {
                continue;
            };
            for (values, bytes) in band.chunks_exact_mut(columns * TILE_SIDE).zip(tile.rows()) {
                for (value, byte) in values[column * TILE_SIDE..].iter_mut().zip(bytes) {
                    *value = model.percent(*byte);
                }
            }
        }
    }
    grid
}

pub(super) fn counts(map: &Tiles, model: &QuantizedModel) -> CellCounts {
    let mut counts = CellCounts::default();
    for (_, tile) in map.known() {
        let [free, occupied] = tile.counts(model);
        counts.free += u64::from(free);
        counts.occupied += u64::from(occupied);
    }
    counts.unknown = map.spec().len() as u64 - counts.free - counts.occupied;
    counts
}
