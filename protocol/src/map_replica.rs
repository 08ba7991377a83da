//! Map replica. How does another machine keep a copy of a map?
//!
//! The replica applies patches. When a patch is missing, it reports a gap and takes over the whole map instead:
//!
//! ```
//! use nalgebra::Point2;
//! use zenav_protocol::grid::{GridSpec, Occupancy};
//! use zenav_protocol::map_replica::{MapReplica, PatchResult};
//! use zenav_protocol::messages::{MapPatch, MapRef, TILE, Tile};
//! use zenav_protocol::time::Stamp;
//!
//! let free = Tile { x: 0, y: 0, values: vec![Occupancy::FREE; (TILE * TILE) as usize] };
//! let mut patch = MapPatch {
//!     stamp: Stamp(1),
//!     map: MapRef::new("kitchen", 1),
//!     base_revision: 0,
//!     spec: GridSpec { origin: Point2::origin(), resolution: 0.05, width: TILE, height: TILE },
//!     tiles: vec![free],
//! };
//! let mut replica = MapReplica::new();
//! assert_eq!(replica.apply(&patch), PatchResult::Applied);
//! assert_eq!(replica.grid().at(Point2::new(1.0, 1.0)), Some(&Occupancy::FREE));
//! // Revision 2 was lost on the way: ask for the whole map, and `replace` it.
//! (patch.base_revision, patch.map.revision) = (2, 3);
//! assert_eq!(replica.apply(&patch), PatchResult::Gap);
//! // A patch leads to the next revision: of any other, all that follow would be old.
//! (patch.base_revision, patch.map.revision) = (1, u64::MAX);
//! assert_eq!(replica.apply(&patch), PatchResult::Gap);
//! ```

use std::sync::Arc;

use nalgebra::Point2;

use crate::grid::{GridSpec, MAX_CELLS, Occupancy, OccupancyGrid};
use crate::messages::{MapPatch, MapRef, MapReply, TILE, Tile};
use crate::padding::{Extent, Padding, tiles_before};
use crate::time::Stamp;

/// Most cells per tile, plus one tile, of a patch that starts a map: a small message must not allocate much memory.
const MOST_CELLS_A_TILE: usize = 4096 * (TILE * TILE) as usize;

/// What a replica did with a patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum PatchResult {
    /// The patch was applied: the replica is at the patch's revision.
    Applied,
    /// The replica already holds this revision or a later one.
    Old,
    /// The patch is for another map or revision, or it is malformed: request the whole map.
    Gap,
}

/// A copy of a map, kept up to date by patches.
///
/// [Padding](Self::reach) can extend the replica with unknown cells beyond the map. A clone shares the cells until either copy changes.
#[derive(Clone, Debug)]
pub struct MapReplica {
    map: MapRef,
    stamp: Stamp,
    /// Geometry of the map itself, without padding.
    spec: GridSpec,
    padding: Padding,
    grid: Arc<OccupancyGrid>,
    /// Revision in which each tile was last written, row by row.
    written: Arc<Vec<u64>>,
}

impl Default for MapReplica {
    fn default() -> Self {
        Self::new()
    }
}

impl MapReplica {
    /// A replica without a map: it has no cells.
    #[must_use]
    pub fn new() -> Self {
        let nothing = GridSpec {
            origin: Point2::origin(),
            resolution: 1.0,
            width: 0,
            height: 0,
        };
        Self {
            map: MapRef::default(),
            stamp: Stamp::ZERO,
            spec: nothing,
            padding: Padding::default(),
            grid: Arc::new(OccupancyGrid::filled(nothing, Occupancy::UNKNOWN)),
            written: Arc::default(),
        }
    }

    /// Applies a patch. After [`PatchResult::Gap`] the replica is unchanged.
    pub fn apply(&mut self, patch: &MapPatch) -> PatchResult {
        let same = patch.map.id == self.map.id;
        if same && patch.map.revision <= self.map.revision && self.map.revision > 0 {
            return PatchResult::Old;
        }
        let from_unknown = patch.base_revision == 0 && (!same || self.map.revision == 0);
        // Anything but the next revision is not of mapping: with it, the patches that follow would count as old.
        let is_next = same
            && patch.base_revision == self.map.revision
            && patch.map.revision.checked_sub(1) == Some(patch.base_revision);
        if !(from_unknown || is_next) || !is_well_formed(patch) {
            return PatchResult::Gap;
        }
        if from_unknown {
            // The requested padding belongs to the previous map.
            self.padding = Padding::default();
        }
        if from_unknown && patch.spec.len() > MOST_CELLS_A_TILE * (patch.tiles.len() + 1) {
            return PatchResult::Gap;
        }
        let padded = self.padding.around(patch.spec);
        let begun = if from_unknown {
            Some(OccupancyGrid::filled(padded, Occupancy::UNKNOWN))
        } else if *self.grid.spec() == padded {
            None
        } else if let Some(grown) = self.regridded(padded) {
            Some(grown)
        } else {
            return PatchResult::Gap;
        };
        if let Some(grid) = begun {
            self.begin(grid, patch.map.revision);
        }
        self.spec = patch.spec;
        let before = tiles_before(&padded, &patch.spec);
        for tile in &patch.tiles {
            self.write(tile, before, patch.map.revision);
        }
        self.map = patch.map.clone();
        self.stamp = patch.stamp;
        PatchResult::Applied
    }

    /// Takes over a whole map; `false`, without any change, when the reply is malformed or has no cells.
    pub fn replace(&mut self, reply: &MapReply) -> bool {
        let Ok(grid) = reply.grid() else {
            return false;
        };
        if self.map.id != reply.info.map.id {
            self.padding = Padding::default();
        }
        self.spec = *grid.spec();
        self.begin(grid, reply.info.map.revision);
        self.map = reply.info.map.clone();
        self.stamp = reply.info.stamp;
        self.pad();
        true
    }

    /// Pads the replica so that it covers an extent, also as the map grows: a planner may route through unseen cells.
    pub fn reach(&mut self, extent: &Extent) {
        self.padding = self.padding.widened(extent, self.spec);
        self.pad();
    }

    fn pad(&mut self) {
        let padded = self.padding.around(self.spec);
        if padded != *self.grid.spec()
            && let Some(grid) = self.regridded(padded)
        {
            self.begin(grid, self.map.revision);
        }
    }

    /// The cells, padding included.
    #[must_use]
    pub fn grid(&self) -> &OccupancyGrid {
        &self.grid
    }

    /// The map and its revision; the id is empty before the first map.
    #[must_use]
    pub fn map(&self) -> &MapRef {
        &self.map
    }

    /// Stamp of the newest scan in the map.
    #[must_use]
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Whether the replica holds a map.
    #[must_use]
    pub fn has_map(&self) -> bool {
        !self.map.id.is_empty()
    }

    /// Whether the replica holds this map, at the wanted revision or a later one.
    #[must_use]
    pub fn holds(&self, wanted: &MapRef) -> bool {
        self.map.id == wanted.id && self.map.revision >= wanted.revision
    }

    /// Tiles (column and row, padding included) that may have changed after a revision of this map, row by row.
    #[must_use]
    pub fn changed_since(&self, revision: u64) -> Vec<(u32, u32)> {
        let columns = self.grid.spec().width.div_ceil(TILE).max(1);
        let numbered = (0_u32..).zip(self.written.iter());
        numbered
            .filter(|(_, written)| **written > revision)
            .map(|(number, _)| (number % columns, number / columns))
            .collect()
    }

    /// Replaces the grid; all tiles count as written in this revision.
    fn begin(&mut self, grid: OccupancyGrid, revision: u64) {
        let tiles = grid.spec().width.div_ceil(TILE) as usize * grid.spec().height.div_ceil(TILE) as usize;
        self.grid = Arc::new(grid);
        self.written = Arc::new(vec![revision; tiles]);
    }

    /// The values, copied into a grid of another size; `None` when the cells of the two grids do not coincide.
    fn regridded(&self, spec: GridSpec) -> Option<OccupancyGrid> {
        let old = *self.grid.spec();
        let shift = spec.to_cells(old.origin);
        let (x, y) = (shift.x.round(), shift.y.round());
        if (old.resolution - spec.resolution).abs() > 1e-9 * spec.resolution
            || (shift.x - x).abs() > 1e-3
            || (shift.y - y).abs() > 1e-3
        {
            return None;
        }
        let mut grid = OccupancyGrid::filled(spec, Occupancy::UNKNOWN);
        let (dx, dy) = (x as i64, y as i64);
        // Columns that both grids have.
        let first = (-dx).clamp(0, i64::from(old.width));
        let end = (i64::from(spec.width) - dx).clamp(first, i64::from(old.width));
        for row in 0..i64::from(old.height) {
            let to = row + dy;
            if to < 0 || to >= i64::from(spec.height) || first == end {
                continue;
            }
            let source = (row * i64::from(old.width) + first) as usize;
            let target = (to * i64::from(spec.width) + first + dx) as usize;
            let length = (end - first) as usize;
            grid.values_mut()[target..target + length].copy_from_slice(&self.grid.values()[source..source + length]);
        }
        Some(grid)
    }

    /// Writes a tile of the map; `before` is the padding to the left and below, in columns and rows of tiles.
    fn write(&mut self, tile: &Tile, before: (u32, u32), revision: u64) {
        let columns = self.grid.spec().width.div_ceil(TILE) as usize;
        let place = (tile.y + before.1) as usize * columns + (tile.x + before.0) as usize;
        if let Some(written) = Arc::make_mut(&mut self.written).get_mut(place) {
            *written = revision;
        }
        let grid = Arc::make_mut(&mut self.grid);
        let (width, height) = (grid.spec().width as usize, grid.spec().height as usize);
        let side = TILE as usize;
        let (x, y) = ((tile.x + before.0) as usize * side, (tile.y + before.1) as usize * side);
        // A tile at the map's border is clipped to the map: the cells beyond are padding and stay unknown.
        let length = side
            .min(width.saturating_sub(x))
            .min((self.spec.width as usize).saturating_sub(tile.x as usize * side));
        let height = height.min(before.1 as usize * side + self.spec.height as usize);
        for (row, values) in tile
            .values
            .chunks_exact(side)
            .enumerate()
            .take(height.saturating_sub(y))
        {
            let start = (y + row) * width + x;
            if let Some(cells) = grid.values_mut().get_mut(start..start + length) {
                cells.copy_from_slice(&values[..length]);
            }
        }
    }
}

/// Whether an external patch is well-formed: a grid within the limits, with whole tiles inside it.
fn is_well_formed(patch: &MapPatch) -> bool {
    let Ok(spec) = patch.spec.checked() else {
        return false;
    };
    let inside = |tile: &Tile| {
        u64::from(tile.x) * u64::from(TILE) < u64::from(spec.width)
            && u64::from(tile.y) * u64::from(TILE) < u64::from(spec.height)
            && tile.values.len() == (TILE * TILE) as usize
    };
    spec.len() as u64 <= MAX_CELLS && !patch.map.id.is_empty() && patch.tiles.iter().all(inside)
}
