//! Incremental update. When tiles of the map change, only the part of a configuration space within reach of changed cells is recomputed;
//! the result equals a new build.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use thiserror::Error;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};
use zenav_protocol::messages::TILE;

use super::bits::pack;
use super::configuration::{ConfigurationSpace, UnknownPolicy};
use super::raster::CellMask;

/// Side of a map's tile, cells; a word of a bitmap and a tile of the distance field are as wide.
const SIDE: usize = 64;
const _: () = assert!(
    TILE as usize == SIDE,
    "words of bitmaps and tiles of maps must coincide"
);

/// The map has grown or moved: its space has to be rebuilt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the map's grid is not the space's any more")]
pub struct GridChanged;

/// Meaning of 64 cells of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Marks {
    /// Cells that no part of the robot may touch.
    pub obstacles: u64,
    /// Cells that the robot's centre stays off.
    pub forbidden: u64,
}

impl Marks {
    /// Reads one word of a row.
    pub(super) fn read(
        grid: &OccupancyGrid,
        unknown: UnknownPolicy,
        keep_out: Option<&CellMask>,
        y: u32,
        word: usize,
    ) -> Self {
        let width = grid.spec().width as usize;
        let row = &grid.values()[y as usize * width..][..width];
        // Cells beyond the grid count as free: they are masked out where it matters.
        let mut padded = [Occupancy::FREE; SIDE];
        let cells = if let Some(cells) = row.get(word * SIDE..).and_then(|cells| cells.first_chunk()) {
            cells
        } else {
            let rest = row.get(word * SIDE..).unwrap_or_default();
            padded[..rest.len()].copy_from_slice(rest);
            &padded
        };
        let are = |kind: Occupancy| pack(cells, |value| Occupancy::of(value) == kind);
        let occupied = are(Occupancy::Occupied) | keep_out.map_or(0, |mask| mask.word(y, word));
        match unknown {
            UnknownPolicy::Free => Self {
                obstacles: occupied,
                forbidden: 0,
            },
            UnknownPolicy::Blocked => Self {
                obstacles: occupied,
                forbidden: are(Occupancy::Unknown),
            },
            UnknownPolicy::Obstacle => Self {
                obstacles: occupied | are(Occupancy::Unknown),
                forbidden: 0,
            },
        }
    }
}

/// Rows of one word column in which the meaning of cells has changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Difference {
    word: usize,
    rows: Range<u32>,
}

impl ConfigurationSpace {
    /// Updates tiles of the map that may have changed (column and row of each, [`TILE`] cells a side); the map's grid must be the same.
    /// The result equals a new build. Returns whether anything has changed.
    ///
    /// Cost: some microseconds per changed tile and its surroundings, and a copy of the bitmaps if they are shared.
    ///
    /// # Errors
    /// [`GridChanged`] if the map has another grid: rebuild the space.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, GridChanged, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// let mut space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
    /// map[Cell::new(30, 20)] = Occupancy::OCCUPIED;
    /// assert_eq!(space.update(&map, &[(0, 0)]), Ok(true), "the cell is in the lower left tile");
    /// assert!(!space.is_free(Cell::new(30, 20)));
    ///
    /// let grown = Grid::filled(GridSpec { width: 41, ..spec }, Occupancy::FREE);
    /// assert_eq!(space.update(&grown, &[(0, 0)]), Err(GridChanged));
    /// ```
    pub fn update(&mut self, grid: &OccupancyGrid, tiles: &[(u32, u32)]) -> Result<bool, GridChanged> {
        let differences = self.differences(grid, tiles)?;
        self.apply(grid, &differences);
        Ok(!differences.is_empty())
    }

    /// Differences between tiles of a map and this space.
    pub(super) fn differences(
        &self,
        grid: &OccupancyGrid,
        tiles: &[(u32, u32)],
    ) -> Result<Vec<Difference>, GridChanged> {
        if *grid.spec() != self.spec {
            return Err(GridChanged);
        }
        let mut differences = Vec::new();
        for (x, y) in tiles {
            let word = *x as usize;
            let rows = y.saturating_mul(TILE)..y.saturating_add(1).saturating_mul(TILE).min(self.spec.height);
            if word >= self.obstacles().stride() {
                continue;
            }
            let keep_out = self.keep_out.as_deref();
            let differs = |y: &u32| self.marks(*y, word) != Marks::read(grid, self.unknown_policy, keep_out, *y, word);
            let first = rows.clone().find(differs);
            let last = rows.rev().find(differs);
            if let (Some(first), Some(last)) = (first, last) {
                differences.push(Difference {
                    word,
                    rows: first..last + 1,
                });
            }
        }
        Ok(differences)
    }

    /// Meaning of a word in this space.
    fn marks(&self, y: u32, word: usize) -> Marks {
        Marks {
            obstacles: self.obstacles().row(y)[word],
            forbidden: match self.unknown_policy {
                UnknownPolicy::Blocked => self.forbidden().row(y)[word],
                UnknownPolicy::Free | UnknownPolicy::Obstacle => 0,
            },
        }
    }

    /// Brings the space up to date with the grid, which differs from it only there.
    pub(super) fn apply(&mut self, grid: &OccupancyGrid, differences: &[Difference]) {
        if differences.is_empty() {
            return;
        }
        let obstacles = Arc::make_mut(&mut self.obstacles);
        for difference in differences {
            for y in difference.rows.clone() {
                let marks = Marks::read(grid, self.unknown_policy, self.keep_out.as_deref(), y, difference.word);
                obstacles.set_word(y, difference.word, marks.obstacles);
                if self.unknown_policy == UnknownPolicy::Blocked {
                    Arc::make_mut(&mut self.forbidden).set_word(y, difference.word, marks.forbidden);
                }
            }
        }
        for (words, rows) in self.around(differences) {
            self.field.refresh(
                self.obstacles.bits(),
                words.clone(),
                rows.start as usize..rows.end as usize,
            );
            if !self.is_beyond_the_field() {
                self.admit(words, rows);
            }
        }
        if self.is_beyond_the_field() {
            self.admit(0..self.obstacles().stride(), 0..self.spec.height);
        }
    }

    /// Windows of words and rows that cover everything within reach of the differences, without overlap.
    fn around(&self, differences: &[Difference]) -> Vec<(Range<usize>, Range<u32>)> {
        let reach = self.field.reach_cells();
        // Keyed by row and column of tiles: the rows of each tile to be recomputed. The reach is less than a word.
        let mut tiles: BTreeMap<(u32, usize), Range<u32>> = BTreeMap::new();
        for Difference { word, rows } in differences {
            let rows = rows.start.saturating_sub(reach)..(rows.end + reach).min(self.spec.height);
            for word in word.saturating_sub(1)..(word + 2).min(self.obstacles().stride()) {
                for row in rows.start / TILE..rows.end.div_ceil(TILE) {
                    let inside = rows.start.max(row * TILE)..rows.end.min((row + 1) * TILE);
                    tiles
                        .entry((row, word))
                        .and_modify(|known| *known = known.start.min(inside.start)..known.end.max(inside.end))
                        .or_insert(inside);
                }
            }
        }
        let mut windows: Vec<(Range<usize>, Range<u32>)> = Vec::new();
        for ((_, word), rows) in tiles {
            match windows.last_mut() {
                Some((words, last)) if words.end == word && last.start / TILE == rows.start / TILE => {
                    *words = words.start..word + 1;
                    *last = last.start.min(rows.start)..last.end.max(rows.end);
                }
                _ => windows.push((word..word + 1, rows)),
            }
        }
        windows
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use zenav_protocol::grid::Cell;
    use zenav_protocol::robot::Footprint;

    use super::super::zones::Zones;
    use super::*;

    fn grid(width: u32, height: u32, marks: &[(u32, u32, i8)]) -> OccupancyGrid {
        zenav_fixtures::map_with(zenav_fixtures::spec(width, height, 0.1), marks)
    }

    const ZONES: &str = "[[keep_out]]\npoints = [[2.0, 2.0], [9.0, 3.0], [4.0, 9.0]]";

    fn marks() -> impl Strategy<Value = Vec<(u32, u32, i8)>> {
        proptest::collection::vec(
            (0_u32..300, 0_u32..300, prop::sample::select(vec![-1_i8, 0, 100])),
            0..30,
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn an_updated_space_equals_one_that_is_built_anew(width in 1_u32..300, height in 1_u32..300, before in marks(), changes in marks(), at_once in 1_usize..5, zoned in any::<bool>(), radius in prop::sample::select(vec![0.2, 1.5, 9.0])) {
            let zones = Zones::from_toml(if zoned { ZONES } else { "" }, "zones").map(Arc::new).unwrap();
            for policy in [UnknownPolicy::Free, UnknownPolicy::Blocked, UnknownPolicy::Obstacle] {
                let footprint = Footprint::Radius(radius);
                let mut map = grid(width, height, &before);
                let mut space = ConfigurationSpace::with_zones(&map, &footprint, policy, 0.0, &zones);
                let original = space.clone();
                for changes in changes.chunks(at_once) {
                    let cells = changes.iter().map(|(x, y, value)| (Cell::new(x % width, y % height), *value));
                    let tiles: Vec<_> = cells.clone().map(|(cell, _)| (cell.x / TILE, cell.y / TILE)).collect();
                    for (cell, value) in cells {
                        map[cell] = value;
                    }
                    space.update(&map, &tiles).unwrap();
                }
                let anew = ConfigurationSpace::with_zones(&map, &footprint, policy, 0.0, &zones);
                prop_assert_eq!(space.free(), anew.free());
                prop_assert_eq!(space.field(), anew.field());
                prop_assert_eq!(space.obstacles(), anew.obstacles());
                prop_assert_eq!(space.forbidden(), anew.forbidden());
                // The parts that the copy shares with its original stay unchanged.
                let before = ConfigurationSpace::with_zones(&grid(width, height, &before), &footprint, policy, 0.0, &zones);
                prop_assert_eq!(original.free(), before.free());
                prop_assert_eq!(original.field(), before.field());
            }
        }
    }

    #[test]
    fn a_map_that_has_grown_is_not_updated() {
        let mut space = ConfigurationSpace::new(&grid(10, 10, &[]), &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
        assert_eq!(space.update(&grid(11, 10, &[]), &[(0, 0)]), Err(GridChanged));
        let changed = grid(10, 10, &[(5, 5, 100)]);
        assert_eq!(
            space.update(&changed, &[(7, 0), (0, u32::MAX)]),
            Ok(false),
            "tiles outside the grid"
        );
        assert_eq!(space.update(&changed, &[(0, 0)]), Ok(true));
        assert_eq!(space.update(&changed, &[(0, 0)]), Ok(false), "it knows by now");
    }
}
