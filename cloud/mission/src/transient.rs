//! Transient obstacles. What of the map may leave again, and since when has it stood there?
//!
//! | may leave | because |
//! |---|---|
//! | what stands where the map was free, all around | it came |
//! | what is no larger than a person and touches nothing, in a map that grows | people and carts stand so; walls do not |
//!
//! Beams that graze a wall show its surface as free now and then. But behind a wall nothing was ever free: that is why all around counts. What stands in a stored map has stood there long, and stays.

use std::collections::{BTreeMap, VecDeque};

use nalgebra::Point2;
use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{MapPatch, TILE};
use zenav_protocol::time::Stamp;

/// Side of a tile, cells: one word a row.
const SIDE: usize = 64;
const _: () = assert!(TILE as usize == SIDE, "a row of a tile is a word");
/// Up to this percentage a cell was seen free, and not by one grazing beam: two observations with the usual sensor model.
const SEEN_FREE: i8 = 15;
/// Cells whose centres are this near belong to one thing: beams are farther apart than cells where it is far away, m.
const LINK: f64 = 0.1;
/// Longer side of the box around a thing, m: less is noise at the edge of a wall, more than a person is not taken for one.
const SIZES: std::ops::RangeInclusive<f64> = 0.2..=0.8;
/// Cells that a thing must have at least.
const MIN_CELLS: usize = 4;
/// Share of the cells around a cell that were free once, for what stands there to have come: all around a person, half along a wall, and a
/// few more where two rows of its surface were grazed.
const FREE_AROUND: f64 = 0.9;
/// What is this near to a cell on each axis is around it, m.
const AROUND: f64 = 0.15;
/// Things are looked for this near to the robot and to its goals, m, and not beyond so many cells.
const WINDOW: (f64, i64) = (12.0, 480);

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

/// A part of a map.
struct Window {
    /// Its first column and row in the map.
    first: Place,
    width: i64,
    height: i64,
    resolution: f64,
}

/// A thing: its cells, and the box around them.
struct Thing {
    cells: Vec<Place>,
    low: Place,
    high: Place,
}

impl Window {
    fn new(grid: &OccupancyGrid, place: Point2<f64>) -> Option<Self> {
        let spec = grid.spec();
        let center = spec.clamped_cell(place)?;
        let half = ((WINDOW.0 / spec.resolution) as i64).clamp(1, WINDOW.1);
        let span = |at: u32, side: u32| {
            let first = (i64::from(at) - half).max(0);
            (first, (i64::from(at) + half + 1).min(i64::from(side)) - first)
        };
        let ((x, width), (y, height)) = (span(center.x, spec.width), span(center.y, spec.height));
        Some(Self {
            first: (x, y),
            width,
            height,
            resolution: spec.resolution,
        })
    }

    fn index(&self, (x, y): Place) -> Option<usize> {
        let inside = x >= 0 && y >= 0 && x < self.width && y < self.height;
        inside.then(|| (y * self.width + x) as usize)
    }

    /// Cells (column and row in the map) of what may leave. `is_new`: occupied, and free before; `was_free`: free once.
    fn transient(
        &self,
        grid: &OccupancyGrid,
        grows: bool,
        is_new: &dyn Fn(i64, i64) -> bool,
        was_free: &dyn Fn(i64, i64) -> bool,
    ) -> Vec<Place> {
        let wide = i64::from(grid.spec().width);
        let rows = (0..self.height).flat_map(|y| {
            let begin = ((self.first.1 + y) * wide + self.first.0) as usize;
            grid.values()
                .get(begin..begin + self.width as usize)
                .unwrap_or_default()
        });
        let occupied: Vec<bool> = rows.map(|value| Occupancy::of(*value) == Occupancy::Occupied).collect();
        let in_map = |(x, y): Place| (x + self.first.0, y + self.first.1);
        let each = || (0..self.height).flat_map(|y| (0..self.width).map(move |x| (x, y)));
        let new: Vec<bool> = each()
            .zip(&occupied)
            .map(|(cell, occupied)| *occupied && is_new(in_map(cell).0, in_map(cell).1))
            .collect();
        let around = ((AROUND / self.resolution).round() as i64).clamp(1, 8);
        let square = (2 * around + 1) * (2 * around + 1);
        let is_in_the_open = |cell: Place| {
            let (x, y) = in_map(cell);
            let free = beside(around).filter(|(dx, dy)| was_free(x + dx, y + dy));
            free.count() as f64 >= FREE_AROUND * square as f64
        };
        let come: Vec<bool> = each()
            .zip(&new)
            .map(|(cell, new)| *new && is_in_the_open(cell))
            .collect();
        let mut cells = Vec::new();
        for thing in self.things(&come).iter().filter(|thing| self.is_large_enough(thing)) {
            // It may touch a wall: there its last cells are not in the open.
            let reach = beside(self.link());
            let touched = reach.flat_map(|(dx, dy)| thing.cells.iter().map(move |(x, y)| (x + dx, y + dy)));
            let is_new = |cell: &Place| self.index(*cell).is_some_and(|index| new[index]);
            cells.extend(touched.filter(is_new));
        }
        let alone = |thing: &Thing| {
            let inside =
                thing.low.0 > 0 && thing.low.1 > 0 && thing.high.0 + 1 < self.width && thing.high.1 + 1 < self.height;
            inside && self.is_large_enough(thing) && self.size(thing) <= *SIZES.end()
        };
        if grows {
            let things = self.things(&occupied).into_iter();
            cells.extend(things.filter(alone).flat_map(|thing| thing.cells));
        }
        cells.into_iter().map(in_map).collect()
    }

    /// Cells that belong to one thing are so many apart at most.
    fn link(&self) -> i64 {
        ((LINK / self.resolution).round() as i64).clamp(1, 8)
    }

    fn is_large_enough(&self, thing: &Thing) -> bool {
        thing.cells.len() >= MIN_CELLS && self.size(thing) >= *SIZES.start()
    }

    /// The longer side of the box around a thing, m.
    fn size(&self, thing: &Thing) -> f64 {
        let side = (thing.high.0 - thing.low.0).max(thing.high.1 - thing.low.1) + 1;
        side as f64 * self.resolution
    }

    /// Marked cells that are near each other, as things.
    fn things(&self, marks: &[bool]) -> Vec<Thing> {
        let mut left = marks.to_vec();
        let mut things = Vec::new();
        for start in 0..marks.len() {
            if !left[start] {
                continue;
            }
            left[start] = false;
            let start = (start as i64 % self.width, start as i64 / self.width);
            let mut thing = Thing {
                cells: Vec::new(),
                low: start,
                high: start,
            };
            let mut edge = VecDeque::from([start]);
            while let Some((x, y)) = edge.pop_front() {
                thing.cells.push((x, y));
                thing.low = (thing.low.0.min(x), thing.low.1.min(y));
                thing.high = (thing.high.0.max(x), thing.high.1.max(y));
                for (dx, dy) in beside(self.link()) {
                    let next = (x + dx, y + dy);
                    if let Some(mark) = self.index(next).and_then(|index| left.get_mut(index))
                        && std::mem::take(mark)
                    {
                        edge.push_back(next);
                    }
                }
            }
            things.push(thing);
        }
        things
    }
}

/// A cell and its neighbours up to so many away, as steps to them.
fn beside(cells: i64) -> impl Iterator<Item = Place> {
    (-cells..=cells).flat_map(move |dy| (-cells..=cells).map(move |dx| (dx, dy)))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use zenav_protocol::messages::{MapRef, Tile};

    use super::*;

    const SPEC: GridSpec = GridSpec {
        origin: Point2::new(-3.2, 6.4),
        resolution: 0.05,
        width: 128,
        height: 128,
    };

    /// A map as it was shown from time to time, and what may leave now.
    struct Shown {
        transients: Transients,
        grid: OccupancyGrid,
        secs: f64,
    }

    impl Shown {
        fn new() -> Self {
            Self {
                transients: Transients::default(),
                grid: OccupancyGrid::filled(SPEC, Occupancy::UNKNOWN),
                secs: 0.0,
            }
        }

        /// Ten seconds later these cells have a value.
        fn show(&mut self, value: i8, columns: std::ops::Range<u32>, rows: std::ops::Range<u32>) -> &mut Self {
            for (x, y) in rows.flat_map(|y| columns.clone().map(move |x| (x, y))) {
                self.grid[zenav_protocol::grid::Cell::new(x, y)] = value;
            }
            self.secs += 10.0;
            let tiles = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| Tile {
                x,
                y,
                values: (0..64 * 64)
                    .map(|at| self.grid.values()[((y * 64 + at / 64) * 128 + x * 64 + at % 64) as usize])
                    .collect(),
            });
            let map = MapRef {
                id: "m".to_owned(),
                revision: self.secs as u64,
            };
            let patch = MapPatch {
                stamp: Stamp::ZERO,
                base_revision: 0,
                map,
                spec: SPEC,
                tiles: tiles.to_vec(),
            };
            self.transients.observe(Stamp::from_secs(self.secs), &patch);
            self
        }

        fn cells(&self, grows: bool) -> Vec<TransientCell> {
            self.transients
                .cells(&self.grid, grows, &[SPEC.from_cells(Point2::new(64.0, 64.0))])
        }
    }

    #[test]
    fn what_came_may_leave_and_is_known_since_when() {
        let mut shown = Shown::new();
        shown.show(0, 20..110, 20..110).show(100, 60..68, 62..66);
        let cells = shown.cells(false);
        assert_eq!(cells.len(), 32);
        assert!(cells.iter().all(|cell| cell.since == Some(Stamp::from_secs(20.0))));
        let first = SPEC.from_cells(Point2::new(60.5, 62.5));
        assert!((cells[0].center - first).norm() < 1e-9, "{:?}", cells[0]);
        // A whole map, told anew, is no other.
        shown.transients.observe_all(Stamp::from_secs(30.0), "m", &shown.grid);
        assert_eq!(shown.cells(false), cells);
        shown.show(0, 60..68, 62..66);
        assert!(shown.cells(true).is_empty());
    }

    #[test]
    fn a_door_may_leave_and_the_surface_of_a_wall_may_not_though_both_were_seen_free() {
        let mut shown = Shown::new();
        // A wall with a door of 0.9 m, seen from both sides.
        shown.show(0, 20..110, 20..110).show(100, 20..50, 64..66);
        shown.show(100, 68..110, 64..66).show(100, 50..68, 64..65);
        let cells = shown.cells(false);
        assert!(
            cells
                .iter()
                .filter(|cell| cell.since == Some(Stamp::from_secs(40.0)))
                .count()
                >= 18
        );
        // Only the door, although the surface of the walls beside it was taken for free.
        let mut shown = Shown::new();
        shown
            .show(0, 20..110, 20..64)
            .show(0, 50..68, 20..110)
            .show(0, 20..110, 70..110);
        shown
            .show(100, 20..50, 63..64)
            .show(100, 68..110, 63..64)
            .show(100, 50..68, 65..66);
        let cells = shown.cells(false);
        let low = SPEC.from_cells(Point2::new(47.0, 62.0));
        let high = SPEC.from_cells(Point2::new(71.0, 67.0));
        assert!(cells.iter().filter(|cell| cell.center.y > high.y - 0.1 - 1e-9).count() >= 16);
        assert!(
            cells.iter().all(|cell| cell.center > low && cell.center < high),
            "{cells:?}"
        );
        // A wall whose surface a grazing beam once showed as free, and behind which nothing was ever seen.
        let mut shown = Shown::new();
        shown.show(0, 20..110, 20..65).show(100, 20..110, 64..65);
        assert!(shown.cells(true).is_empty());
    }

    #[test]
    fn what_stands_alone_may_leave_unless_it_is_large_or_in_a_stored_map() {
        let mut shown = Shown::new();
        shown.show(100, 60..68, 62..64).show(100, 20..40, 62..64);
        assert_eq!(shown.cells(true).len(), 16);
        assert!(shown.cells(false).is_empty());
    }

    #[test]
    fn a_map_of_senseless_size_is_left_alone() {
        let mut transients = Transients::default();
        let spec = GridSpec {
            origin: Point2::new(1e300, -1e300),
            resolution: 1e-300,
            ..SPEC
        };
        let grid = OccupancyGrid::filled(spec, Occupancy::OCCUPIED);
        transients.observe_all(Stamp::ZERO, "m", &grid);
        assert!(transients.cells(&grid, true, &[Point2::origin()]).is_empty());
        transients.observe_all(Stamp::ZERO, "m", &OccupancyGrid::filled(SPEC, Occupancy::FREE));
        assert!(
            transients
                .cells(&grid, true, &[Point2::new(f64::NAN, 1e300)])
                .is_empty()
        );
    }
}
