//! Transient obstacles. What of the map may leave again, and since when has it stood there?
//!
//! | may leave | because |
//! |---|---|
//! | what stands where the map was free, all around | it came |
//! | what is no larger than a person, with free space around it, in a map that grows | people and carts stand so; walls do not |
//!
//! Beams that graze a wall show its surface as free now and then. But behind a wall nothing was ever free: that is why all around counts. What
//! stands in a stored map has stood there long, and stays.

mod window;

use std::collections::BTreeMap;

use nalgebra::Point2;
use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{MapPatch, TILE};
use zenav_protocol::time::Stamp;

pub(crate) use self::window::LARGEST;
use self::window::Window;

/// Side of a tile, cells: one word a row.
const SIDE: usize = 64;
const _: () = assert!(TILE as usize == SIDE, "a row of a tile is a word");
/// Up to this percentage a cell was seen free, and not by one grazing beam: two observations with the usual sensor model.
const SEEN_FREE: i8 = 15;
/// Most cells that are told of.
const MAX_CELLS: usize = 20_000;

/// A cell's column and row, counted from the origin of the map's first grid.
type Place = (i64, i64);

/// A cell of a thing that may leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransientCell {
    /// Its centre, map frame, m.
    pub center: Point2<f64>,
    /// Since when it has been occupied, by the mission's time; `None` if it was never seen free.
    pub since: Option<Stamp>,
}

/// What was free once, and what has been occupied since.
#[derive(Clone, Debug, Default)]
pub struct Transients {
    /// Geometry of the grid that cells are counted from.
    anchor: Option<(String, GridSpec)>,
    tiles: BTreeMap<Place, Tile>,
    /// When cells that had been free became occupied, by row and column.
    since: BTreeMap<Place, Stamp>,
}

/// One word a row.
#[derive(Clone, Debug)]
struct Tile {
    was_free: [u64; SIDE],
    /// Occupied after that.
    taken: [u64; SIDE],
}

impl Transients {
    /// Takes a patch that has been applied to the replica.
    pub fn observe(&mut self, now: Stamp, patch: &MapPatch) {
        let Some((x, y)) = self.offset(&patch.map.id, &patch.spec) else {
            return;
        };
        for tile in &patch.tiles {
            let first = (x + i64::from(tile.x) * SIDE as i64, y + i64::from(tile.y) * SIDE as i64);
            for (row, values) in (0_i64..).zip(tile.values.chunks_exact(SIDE)) {
                self.row(now, (first.0, first.1 + row), values);
            }
        }
    }

    /// Takes a whole map.
    pub fn observe_all(&mut self, now: Stamp, map: &str, grid: &OccupancyGrid) {
        let Some((x, y)) = self.offset(map, grid.spec()) else {
            return;
        };
        let width = grid.spec().width.max(1) as usize;
        for (row, values) in (y..).zip(grid.values().chunks_exact(width)) {
            for (column, values) in (x..).step_by(SIDE).zip(values.chunks(SIDE)) {
                self.row(now, (column, row), values);
            }
        }
    }

    /// Up to 64 cells of a row, the first of them at the left border of a tile.
    fn row(&mut self, now: Stamp, (x, y): Place, values: &[i8]) {
        let mask = |is: fn(i8) -> bool| {
            let bits = values.iter().take(SIDE).enumerate();
            bits.fold(0_u64, |mask, (bit, value)| mask | u64::from(is(*value)) << bit)
        };
        let free = mask(|value| (0..=SEEN_FREE).contains(&value));
        let occupied = mask(|value| Occupancy::of(value) == Occupancy::Occupied);
        let side = SIDE as i64;
        let key = (x.div_euclid(side), y.div_euclid(side));
        if free == 0 && !self.tiles.contains_key(&key) {
            return;
        }
        let tile = self.tiles.entry(key).or_insert(Tile {
            was_free: [0; SIDE],
            taken: [0; SIDE],
        });
        let row = y.rem_euclid(side) as usize;
        tile.was_free[row] |= free;
        let before = std::mem::replace(&mut tile.taken[row], occupied & tile.was_free[row]);
        let mut changed = before ^ tile.taken[row];
        while changed != 0 {
            let bit = changed.trailing_zeros();
            changed &= changed - 1;
            let cell = (y, x + i64::from(bit));
            if tile.taken[row] >> bit & 1 == 1 {
                self.since.insert(cell, now);
            } else {
                self.since.remove(&cell);
            }
        }
    }

    /// Whether a cell (row and column) was free once.
    fn was_free(&self, (y, x): Place) -> bool {
        let side = SIDE as i64;
        let tile = self.tiles.get(&(x.div_euclid(side), y.div_euclid(side)));
        tile.is_some_and(|tile| tile.was_free[y.rem_euclid(side) as usize] >> x.rem_euclid(side) & 1 == 1)
    }

    /// Column and row of a grid's first cell. Of another map, or of a grid whose tiles lie elsewhere, nothing is known yet; `None` for one
    /// that is out of all bounds.
    fn offset(&mut self, map: &str, spec: &GridSpec) -> Option<Place> {
        let known = self.anchor.as_ref().filter(|(id, _)| id == map);
        if let Some(offset) = known.and_then(|(_, anchor)| between(anchor, spec)) {
            return Some(offset);
        }
        *self = Self::default();
        let offset = between(spec, spec)?;
        self.anchor = Some((map.to_owned(), *spec));
        Some(offset)
    }

    /// Cells of what may leave, near these places, row by row. `grid` is the map; where it `grows`, what stands alone may leave, too.
    #[must_use]
    pub fn cells(&self, grid: &OccupancyGrid, grows: bool, near: &[Point2<f64>]) -> Vec<TransientCell> {
        let spec = grid.spec();
        let offset = self.anchor.as_ref().and_then(|(_, anchor)| between(anchor, spec));
        let mut found: BTreeMap<Place, Option<Stamp>> = BTreeMap::new();
        for place in near {
            let Some(window) = Window::new(grid, *place) else {
                continue;
            };
            let known = |x: i64, y: i64| {
                let (dx, dy) = offset?;
                Some((y.checked_add(dy)?, x.checked_add(dx)?))
            };
            let since = |x: i64, y: i64| self.since.get(&known(x, y)?).copied();
            let was_free = |x: i64, y: i64| known(x, y).is_some_and(|cell| self.was_free(cell));
            for (x, y) in window.transient(grid, grows, &|x, y| since(x, y).is_some(), &was_free) {
                found.insert((y, x), since(x, y));
            }
        }
        let cells = found.into_iter().take(MAX_CELLS).map(|((y, x), since)| TransientCell {
            center: spec.from_cells(Point2::new(x as f64 + 0.5, y as f64 + 0.5)),
            since,
        });
        cells.collect()
    }
}

/// Columns and rows from one grid's origin to another's, if their tiles coincide.
fn between(anchor: &GridSpec, spec: &GridSpec) -> Option<Place> {
    let far = f64::from(1_u32 << 30);
    let shift = anchor.to_cells(spec.origin).coords;
    let whole = shift.map(f64::round);
    let same = (spec.resolution - anchor.resolution).abs() <= 1e-9 * anchor.resolution;
    let fits = same && (shift - whole).amax() < 1e-3 && whole.amax() < far;
    let place = (whole.x as i64, whole.y as i64);
    let tiles = |cells: i64| cells.rem_euclid(SIDE as i64) == 0;
    (fits && tiles(place.0) && tiles(place.1)).then_some(place)
}

#[cfg(test)]
mod tests;
