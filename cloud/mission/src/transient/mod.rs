//! Transient obstacles. Which obstacles on the map may leave again, and how long have they been there?
//!
//! | may leave | because |
//! |---|---|
//! | an obstacle in space that was free, on all sides | it arrived |
//! | an object no larger than a person, surrounded by free space, in a map that grows | people and carts look like this; walls do not |
//!
//! Beams that graze a wall sometimes show its surface as free. But the space behind a wall is never seen free, so all sides are checked.
//! Obstacles of a stored map have been there for long, and stay.
//!
//! Nobody knows how long a lone object has been there. A piece of a wall of which no more was seen looks the same, so the time counts from
//! when it was first in the way, for all goals, until its cells are free.

mod window;

use std::collections::BTreeMap;

use nalgebra::Point2;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{MapPatch, TILE};
use zenav_protocol::time::Stamp;

pub(crate) use self::window::LARGEST;
use self::window::Window;

/// Side of a tile, cells: one machine word per row.
const SIDE: usize = 64;
const _: () = assert!(TILE as usize == SIDE, "a row of a tile is a word");
/// Largest occupancy percentage of a cell that was seen free by more than one grazing beam: two observations with the usual sensor model.
const SEEN_FREE: i8 = 15;
/// Most cells returned.
const MAX_CELLS: usize = 20_000;
/// Fewest newly occupied cells that show that something has arrived: noise moves the edge of an obstacle by a cell here and there.
const ARRIVED: usize = 5;

/// A cell's column and row, counted from the origin of the map's first grid.
type Place = (i64, i64);

/// A cell of a transient obstacle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TransientCell {
    /// Its centre, map frame, m.
    pub center: Point2<f64>,
    /// Time since which it has been occupied, on the mission's clock; `None` if it was never seen free.
    pub since: Option<Stamp>,
}

/// History of the map: cells that were free once, and cells occupied since.
#[derive(Clone, Debug, Default)]
pub(crate) struct Transients {
    /// Geometry of the grid that cells are counted from.
    anchor: Option<(String, GridSpec)>,
    tiles: BTreeMap<Place, Tile>,
    /// Times at which free cells became occupied, by row and column.
    since: BTreeMap<Place, Stamp>,
    /// Times since which occupied cells that were never seen free have been in the way, by row and column.
    noticed: BTreeMap<Place, Stamp>,
}

/// One machine word per row.
#[derive(Clone, Debug)]
struct Tile {
    was_free: [u64; SIDE],
    /// Occupied after having been free.
    taken: [u64; SIDE],
}

impl Transients {
    /// Observes a patch that was applied to the replica.
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

    /// Observes a whole map.
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

    /// Up to 64 cells of a row, beginning at the left border of a tile.
    fn row(&mut self, now: Stamp, (x, y): Place, values: &[i8]) {
        let mask = |is: fn(i8) -> bool| {
            let bits = values.iter().take(SIDE).enumerate();
            bits.fold(0_u64, |mask, (bit, value)| mask | u64::from(is(*value)) << bit)
        };
        let free = mask(|value| (0..=SEEN_FREE).contains(&value));
        let occupied = mask(|value| Occupancy::of(value) == Occupancy::Occupied);
        let side = SIDE as i64;
        if !self.noticed.is_empty() {
            let stands = |cell: &Place| occupied >> (cell.1 - x) & 1 == 1;
            let row = self.noticed.range((y, x)..(y, x + side));
            let left: Vec<Place> = row.map(|(cell, _)| *cell).filter(|cell| !stands(cell)).collect();
            for cell in left {
                self.noticed.remove(&cell);
            }
        }
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

    /// Notes that the cells with these centres are in the way since a time. Returns that time, or an earlier one at which they were noticed
    /// before. Of cells that became occupied the time is known without that; with more than a few of them something has arrived, and the
    /// given time holds.
    pub fn notice(&mut self, grid: &OccupancyGrid, centers: &[Point2<f64>], since: Stamp) -> Stamp {
        let offset = self.anchor.as_ref();
        let Some((dx, dy)) = offset.and_then(|(_, anchor)| between(anchor, grid.spec())) else {
            return since;
        };
        let is_occupied = |cell: &Cell| {
            let value = grid.get(*cell);
            value.is_some_and(|value| Occupancy::of(*value) == Occupancy::Occupied)
        };
        let cells = centers.iter().filter_map(|center| grid.spec().cell_at(*center));
        let places = cells
            .filter(is_occupied)
            .map(|cell| (i64::from(cell.y) + dy, i64::from(cell.x) + dx));
        let (arrived, places): (Vec<Place>, Vec<Place>) = places.partition(|place| self.since.contains_key(place));
        if arrived.len() >= ARRIVED {
            return since;
        }
        let first = places.iter().filter_map(|place| self.noticed.get(place).copied()).min();
        let first = first.map_or(since, |first| first.min(since));
        for place in places {
            if self.noticed.len() < MAX_CELLS {
                self.noticed.entry(place).or_insert(first);
            }
        }
        first
    }

    /// Whether a cell (row and column) was ever free.
    fn was_free(&self, (y, x): Place) -> bool {
        let side = SIDE as i64;
        let tile = self.tiles.get(&(x.div_euclid(side), y.div_euclid(side)));
        tile.is_some_and(|tile| tile.was_free[y.rem_euclid(side) as usize] >> x.rem_euclid(side) & 1 == 1)
    }

    /// Column and row of a grid's first cell. Starts over for another map, or for a grid with other tile positions; `None` for a grid out
    /// of all bounds.
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

    /// Transient cells near these places, row by row. `grid` is the map; if it `grows`, lone objects count as well.
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
