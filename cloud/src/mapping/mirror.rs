//! How does another machine keep a copy of a map? By patches, and by the whole where a patch is missing.

use std::sync::Arc;

use nalgebra::Point2;
use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{MapPatch, MapRef, MapReply, TILE, Tile};
use zenav_protocol::time::Stamp;

use super::beyond::{Beyond, Outlook, tiles_before};
use super::tiles::MAX_CELLS;

/// What became of a patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Mirrored {
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
pub struct MapMirror {
    map: MapRef,
    stamp: Stamp,
    /// The map's own grid.
    spec: GridSpec,
    beyond: Beyond,
    grid: Arc<OccupancyGrid>,
    /// The revision in which each tile was last written, row by row.
    written: Arc<Vec<u64>>,
}

impl Default for MapMirror {
    fn default() -> Self {
        Self::new()
    }
}

impl MapMirror {
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
            beyond: Beyond::default(),
            grid: Arc::new(OccupancyGrid::filled(nothing, Occupancy::UNKNOWN)),
            written: Arc::default(),
        }
    }

    /// Brings the copy to a patch's revision.
    pub fn apply(&mut self, patch: &MapPatch) -> Mirrored {
        let same = patch.map.id == self.map.id;
        if same && patch.map.revision <= self.map.revision && self.map.revision > 0 {
            return Mirrored::Old;
        }
        let from_unknown = patch.base_revision == 0 && (!same || self.map.revision == 0);
        if !(from_unknown || same && patch.base_revision == self.map.revision) || !makes_sense(patch) {
            return Mirrored::Gap;
        }
        if from_unknown {
            // Another map: places of the one before mean nothing here.
            self.beyond = Beyond::default();
        }
        let reached = self.beyond.around(patch.spec);
        let begun = if from_unknown {
            Some(OccupancyGrid::filled(reached, Occupancy::UNKNOWN))
        } else if *self.grid.spec() == reached {
            None
        } else if let Some(grown) = self.regridded(reached) {
            Some(grown)
        } else {
            return Mirrored::Gap;
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
        Mirrored::Applied
    }

    /// Takes over a whole map; `false`, and nothing changed, when it makes no sense.
    pub fn replace(&mut self, reply: &MapReply) -> bool {
        let Ok(grid) = reply.grid() else {
            return false;
        };
        if self.map.id != reply.info.map.id {
            self.beyond = Beyond::default();
        }
        self.spec = *grid.spec();
        self.begin(grid, reply.info.map.revision);
        self.map = reply.info.map.clone();
        self.stamp = reply.info.stamp;
        self.reach_out();
        true
    }

    /// Makes the copy reach farther than the map, for whoever may go where nobody has looked. It stays so as the map grows.
    pub fn reach(&mut self, outlook: &Outlook) {
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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use proptest::prelude::*;
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::messages::Scan;

    use super::super::config::MapperConfig;
    use super::super::mapper::Mapper;
    use super::*;

    fn scan(stamp: u64, x: f64, y: f64) -> Scan {
        Scan {
            stamp: Stamp(stamp),
            angle_min: -3.0,
            angle_increment: 0.1,
            range_min: 0.02,
            range_max: 8.0,
            ranges: (0..60).map(|beam| 0.5 + 0.1 * beam as f32).collect(),
            base_from_laser: Pose2::IDENTITY,
            map_from_odom: Pose2::IDENTITY,
            odom_from_base: Pose2::new(x, y, 0.0),
        }
    }

    proptest! {
        #[test]
        fn a_copy_that_loses_patches_heals_by_asking_for_the_whole(steps in proptest::collection::vec((-20.0..20.0, -20.0..20.0, any::<bool>(), 1_usize..4), 1..15)) {
            let mut mapper = Mapper::new(MapperConfig { patch_tiles: 7, ..MapperConfig::default() }, "m");
            let mut mirror = MapMirror::new();
            for (step, (x, y, lost, patches)) in steps.iter().enumerate() {
                mapper.insert(&scan(step as u64 + 1, *x, *y));
                for _ in 0..*patches {
                    let Some(patch) = mapper.take_patch() else { break };
                    if *lost {
                        continue;
                    }
                    if mirror.apply(&patch) == Mirrored::Gap {
                        prop_assert!(mirror.replace(&mapper.reply()));
                    }
                    prop_assert_eq!(mirror.map(), mapper.map());
                }
            }
            while let Some(patch) = mapper.take_patch() {
                if mirror.apply(&patch) == Mirrored::Gap {
                    prop_assert!(mirror.replace(&mapper.reply()));
                }
            }
            if mirror.map() != mapper.map() {
                prop_assert!(mirror.replace(&mapper.reply()));
            }
            prop_assert_eq!(mirror.grid(), &mapper.grid());
        }
    }

    #[test]
    fn patches_that_make_no_sense_change_nothing() {
        let mut mapper = Mapper::new(MapperConfig::default(), "m");
        mapper.insert(&scan(1, 0.0, 0.0));
        let good = mapper.take_patch().unwrap();
        let mut mirror = MapMirror::new();
        let wrong: [fn(&mut MapPatch); 7] = [
            |patch| patch.spec.width = u32::MAX,
            |patch| (patch.spec.width, patch.spec.height) = (32_768, 32_768),
            |patch| patch.spec.resolution = f64::NAN,
            |patch| patch.tiles[0].values.truncate(10),
            |patch| patch.tiles[0].x = u32::MAX,
            |patch| patch.map.id.clear(),
            |patch| patch.base_revision = 5,
        ];
        for spoil in wrong {
            let mut patch = good.clone();
            spoil(&mut patch);
            assert_eq!(mirror.apply(&patch), Mirrored::Gap);
            assert!(!mirror.has_map());
        }
        assert_eq!(mirror.apply(&good), Mirrored::Applied);
        assert_eq!(mirror.apply(&good), Mirrored::Old);
        // The grid may not slip by part of a cell.
        let mut slipped = good.clone();
        slipped.base_revision = 1;
        slipped.map.revision = 2;
        slipped.spec.origin.x += 0.02;
        assert_eq!(mirror.apply(&slipped), Mirrored::Gap);
        assert_eq!(mirror.grid(), &mapper.grid());
    }

    #[test]
    fn a_new_map_takes_the_place_of_the_old_one() {
        let mut mirror = MapMirror::new();
        for id in ["first", "second"] {
            let mut mapper = Mapper::new(MapperConfig::default(), id);
            mapper.insert(&scan(1, 3.0, 4.0));
            assert_eq!(mirror.apply(&mapper.take_patch().unwrap()), Mirrored::Applied);
            assert_eq!(mirror.grid(), &mapper.grid());
            assert!(
                mirror.holds(mapper.map())
                    && !mirror.holds(&MapRef {
                        id: id.into(),
                        revision: 2
                    })
            );
        }
    }

    #[test]
    fn a_copy_that_reaches_farther_holds_the_same_map_and_nothing_else() {
        let mut mapper = Mapper::new(MapperConfig::default(), "m");
        let (mut far, mut exact) = (MapMirror::new(), MapMirror::new());
        for (step, x) in [0.0, 4.0, -9.0, 12.0, 12.5].into_iter().enumerate() {
            mapper.insert(&scan(step as u64 + 1, x, 0.5 * x));
            while let Some(patch) = mapper.take_patch() {
                assert_eq!(far.apply(&patch), Mirrored::Applied);
                assert_eq!(exact.apply(&patch), Mirrored::Applied);
            }
            if step == 1 {
                far.reach(&Outlook {
                    places: vec![Point2::new(-30.0, 21.0)],
                    ring: 1.0,
                });
            } else if step == 3 {
                assert!(far.replace(&mapper.reply()));
            }
        }
        assert_eq!(exact.grid().values(), mapper.grid().values());
        let (large, small) = (far.grid().spec(), exact.grid().spec());
        assert!(large.cell_at(Point2::new(-30.9, 21.9)).is_some() && small.cell_at(Point2::new(-30.0, 21.0)).is_none());
        for y in 0..large.height {
            for x in 0..large.width {
                let cell = zenav_protocol::grid::Cell::new(x, y);
                let known = small
                    .cell_at(large.center(cell))
                    .and_then(|cell| exact.grid().get(cell));
                assert_eq!(far.grid().get(cell), known.or(Some(&Occupancy::UNKNOWN)), "{cell:?}");
            }
        }
    }
}
