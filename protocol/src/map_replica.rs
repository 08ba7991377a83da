//! How does another machine keep a copy of a map? By patches, and by the whole where a patch is missing.

use std::sync::Arc;

use crate::grid::{GridSpec, Occupancy, OccupancyGrid};
use crate::messages::{MapPatch, MapRef, MapReply, TILE, Tile};
use crate::time::Stamp;
use nalgebra::Point2;

use crate::grid::MAX_CELLS;
use crate::padding::{Extent, Padding, tiles_before};

/// What became of a patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum PatchResult {
    /// The copy is at the patch's revision now.
    Applied,
    /// The copy already held it.
    Old,
    /// The copy is of another map or revision than the patch applies to, or the patch makes no sense: ask for the whole.
    Gap,
}

/// A copy of a map. It may reach farther than the map, over cells that nobody has seen. A copy of the copy costs nothing until one of
/// them changes.
#[derive(Clone, Debug)]
pub struct MapReplica {
    map: MapRef,
    stamp: Stamp,
    /// The map's own grid.
    spec: GridSpec,
    beyond: Padding,
    grid: Arc<OccupancyGrid>,
    /// The revision in which each tile was last written, row by row.
    written: Arc<Vec<u64>>,
}

impl Default for MapReplica {
    fn default() -> Self {
        Self::new()
    }
}

impl MapReplica {
    /// A copy of nothing: no map, no cells.
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
            beyond: Padding::default(),
            grid: Arc::new(OccupancyGrid::filled(nothing, Occupancy::UNKNOWN)),
            written: Arc::default(),
        }
    }

    /// Brings the copy to a patch's revision.
    pub fn apply(&mut self, patch: &MapPatch) -> PatchResult {
        let same = patch.map.id == self.map.id;
        if same && patch.map.revision <= self.map.revision && self.map.revision > 0 {
            return PatchResult::Old;
        }
        let from_unknown = patch.base_revision == 0 && (!same || self.map.revision == 0);
        if !(from_unknown || same && patch.base_revision == self.map.revision) || !makes_sense(patch) {
            return PatchResult::Gap;
        }
        if from_unknown {
            // Another map: places of the one before mean nothing here.
            self.beyond = Padding::default();
        }
        let reached = self.beyond.around(patch.spec);
        let begun = if from_unknown {
            Some(OccupancyGrid::filled(reached, Occupancy::UNKNOWN))
        } else if *self.grid.spec() == reached {
            None
        } else if let Some(grown) = self.regridded(reached) {
            Some(grown)
        } else {
            return PatchResult::Gap;
        };
        if let Some(grid) = begun {
            self.begin(grid, patch.map.revision);
        }
        self.spec = patch.spec;
        let before = tiles_before(&reached, &patch.spec);
        for tile in &patch.tiles {
            self.write(tile, before, patch.map.revision);
        }
        self.map = patch.map.clone();
        self.stamp = patch.stamp;
        PatchResult::Applied
    }

    /// Takes over a whole map; `false`, and nothing changed, when it makes no sense.
    pub fn replace(&mut self, reply: &MapReply) -> bool {
        let Ok(grid) = reply.grid() else {
            return false;
        };
        if self.map.id != reply.info.map.id {
            self.beyond = Padding::default();
        }
        self.spec = *grid.spec();
        self.begin(grid, reply.info.map.revision);
        self.map = reply.info.map.clone();
        self.stamp = reply.info.stamp;
        self.reach_out();
        true
    }

    /// Makes the copy reach farther than the map, for whoever may go where nobody has looked. It stays so as the map grows.
    pub fn reach(&mut self, outlook: &Extent) {
        self.beyond.include(outlook);
        self.reach_out();
    }

    fn reach_out(&mut self) {
        let reached = self.beyond.around(self.spec);
        if reached != *self.grid.spec()
            && let Some(grid) = self.regridded(reached)
        {
            self.begin(grid, self.map.revision);
        }
    }

    /// The copy.
    #[must_use]
    pub fn grid(&self) -> &OccupancyGrid {
        &self.grid
    }

    /// Which map and revision it is; an empty name for none yet.
    #[must_use]
    pub fn map(&self) -> &MapRef {
        &self.map
    }

    /// Stamp of the newest scan in it.
    #[must_use]
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Whether there is any map.
    #[must_use]
    pub fn has_map(&self) -> bool {
        !self.map.id.is_empty()
    }

    /// Whether the copy is of this map, at its revision or a later one.
    #[must_use]
    pub fn holds(&self, wanted: &MapRef) -> bool {
        self.map.id == wanted.id && self.map.revision >= wanted.revision
    }

    /// Tiles (column and row) that may have changed after a revision of this map, row by row.
    #[must_use]
    pub fn changed_since(&self, revision: u64) -> Vec<(u32, u32)> {
        let columns = self.grid.spec().width.div_ceil(TILE).max(1);
        let numbered = (0_u32..).zip(self.written.iter());
        numbered
            .filter(|(_, written)| **written > revision)
            .map(|(number, _)| (number % columns, number / columns))
            .collect()
    }

    /// Takes another grid, all of it new in a revision.
    fn begin(&mut self, grid: OccupancyGrid, revision: u64) {
        let tiles = grid.spec().width.div_ceil(TILE) as usize * grid.spec().height.div_ceil(TILE) as usize;
        self.grid = Arc::new(grid);
        self.written = Arc::new(vec![revision; tiles]);
    }

    /// The values moved over to another grid of the same cells; `None` when the cells do not coincide.
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
        // Columns of the old grid that the new one has as well.
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

    /// Writes a tile of the map, before whose first one the copy has so many columns and rows of tiles.
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
        // Of a tile at the map's border only what belongs to the map: beyond it nothing is known.
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

/// Whether a patch from outside is fit to be applied: a grid of bearable size, whole tiles inside it.
fn makes_sense(patch: &MapPatch) -> bool {
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
