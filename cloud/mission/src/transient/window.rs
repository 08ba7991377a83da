//! Window. Which cells of a part of a map belong to a transient obstacle?

use std::collections::VecDeque;

use nalgebra::Point2;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};

use super::Place;

/// Distance of cell centres within one object, m: far away, beams are farther apart than cells.
const LINK: f64 = 0.1;
/// Largest size of a person, m.
pub(crate) const LARGEST: f64 = 0.8;
/// Longer side of the bounding box of an object, m: a smaller one is noise at the edge of a wall.
const SIZES: std::ops::RangeInclusive<f64> = 0.2..=LARGEST;
/// Fewest cells of an object, unless all cells around it were free.
const MIN_CELLS: usize = 4;
/// Share of the cells around a cell that must once have been free for its object to count as arrived: all around a person, eight in nine
/// along a wall of which 10 cm were grazed.
const FREE_AROUND: f64 = 0.92;
/// Extent of the surroundings of a cell on each axis, m.
const AROUND: f64 = 0.1;
/// Share of the bounding box around a lone object that must be free, without the object itself: beside a piece of a wall it is half.
const FREE_BESIDE: f64 = 0.42;
/// Objects are searched within this distance of the robot and its goals, m, and within this many cells.
const WINDOW: (f64, i64) = (12.0, 480);

/// A part of a map.
pub(super) struct Window {
    /// Its first column and row in the map.
    first: Place,
    width: i64,
    height: i64,
    resolution: f64,
}

/// An object: its cells and their bounding box.
struct Thing {
    cells: Vec<Place>,
    low: Place,
    high: Place,
}

impl Window {
    pub(super) fn new(grid: &OccupancyGrid, place: Point2<f64>) -> Option<Self> {
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

    /// Transient cells (column and row in the map). `is_new`: occupied now, and free before; `was_free`: free at some time.
    pub(super) fn transient(
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
        let values: Vec<Occupancy> = rows.map(|value| Occupancy::of(*value)).collect();
        let occupied: Vec<bool> = values.iter().map(|value| *value == Occupancy::Occupied).collect();
        let in_map = |(x, y): Place| (x + self.first.0, y + self.first.1);
        let each = || (0..self.height).flat_map(|y| (0..self.width).map(move |x| (x, y)));
        let new: Vec<bool> = each()
            .zip(&occupied)
            .map(|(cell, occupied)| *occupied && is_new(in_map(cell).0, in_map(cell).1))
            .collect();
        let around = self.cells(AROUND);
        let square = (2 * around + 1).pow(2);
        let openness = |cell: Place| {
            let (x, y) = in_map(cell);
            let free = beside(around).filter(|(dx, dy)| was_free(x + dx, y + dy));
            free.count() as f64 / square as f64
        };
        let come: Vec<bool> = each()
            .zip(&new)
            .map(|(cell, new)| *new && openness(cell) >= FREE_AROUND)
            .collect();
        // The last cells of somebody who moved on, not yet cleared by a beam, are few.
        let may_leave =
            |thing: &&Thing| self.is_large_enough(thing) || thing.cells.iter().all(|cell| openness(*cell) >= 1.0);
        let mut cells = Vec::new();
        for thing in self.things(&come).iter().filter(may_leave) {
            // The object may touch a wall: its cells there are not surrounded by free space.
            let reach = beside(self.cells(AROUND + LINK));
            let touched = reach.flat_map(|(dx, dy)| thing.cells.iter().map(move |(x, y)| (x + dx, y + dy)));
            let is_new = |cell: &Place| self.index(*cell).is_some_and(|index| new[index]);
            cells.extend(touched.filter(is_new));
        }
        let alone = |thing: &Thing| {
            let inside =
                thing.low.0 > 0 && thing.low.1 > 0 && thing.high.0 + 1 < self.width && thing.high.1 + 1 < self.height;
            inside
                && self.is_large_enough(thing)
                && self.size(thing) <= *SIZES.end()
                && self.is_free_around(thing, &values)
        };
        if grows {
            let things = self.things(&occupied).into_iter();
            cells.extend(things.filter(alone).flat_map(|thing| thing.cells));
        }
        cells.into_iter().map(in_map).collect()
    }

    /// A distance (m) in cells.
    fn cells(&self, metres: f64) -> i64 {
        ((metres / self.resolution).round() as i64).clamp(1, 8)
    }

    fn is_large_enough(&self, thing: &Thing) -> bool {
        thing.cells.len() >= MIN_CELLS && self.size(thing) >= *SIZES.start()
    }

    /// Whether most of the known cells around an object are free: beside a person there is free space, beside a piece of a wall the wall
    /// continues.
    fn is_free_around(&self, thing: &Thing, values: &[Occupancy]) -> bool {
        let beyond = self.cells(AROUND);
        let columns = thing.low.0 - beyond..=thing.high.0 + beyond;
        let rows = thing.low.1 - beyond..=thing.high.1 + beyond;
        let all = columns.clone().count() * rows.clone().count() - thing.cells.len();
        let cells = rows.flat_map(|y| columns.clone().map(move |x| (x, y)));
        let is_free = |cell: &Place| {
            let value = self.index(*cell).and_then(|index| values.get(index));
            value == Some(&Occupancy::Free)
        };
        cells.filter(is_free).count() as f64 >= FREE_BESIDE * all as f64
    }

    /// The longer side of the box around a thing, m.
    fn size(&self, thing: &Thing) -> f64 {
        let side = (thing.high.0 - thing.low.0).max(thing.high.1 - thing.low.1) + 1;
        side as f64 * self.resolution
    }

    /// Groups marked cells that are near each other into objects.
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
                for (dx, dy) in beside(self.cells(LINK)) {
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

/// Steps from a cell to itself and to its neighbours up to this many cells away.
fn beside(cells: i64) -> impl Iterator<Item = Place> {
    (-cells..=cells).flat_map(move |dy| (-cells..=cells).map(move |dx| (dx, dy)))
}
