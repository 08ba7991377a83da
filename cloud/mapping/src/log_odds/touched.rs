//! Touched obstacles. Which cells has the robot touched though no beam shows an obstacle there?
//!
//! Beams pass through glass, so they cannot tell whether it is still there. A touched cell takes a hit with every scan, whatever the beams
//! say, until the robot's body covers it, or nothing was touched in its tile for an hour. It does not decay. Where a touched surface is only
//! assumed to go on, cells do the same for a short while: then beams clear them, and without beams they decay.

use std::collections::BTreeMap;
use std::time::Duration;

use nalgebra::Point2;
use zenav_protocol::messages::Scan;

use super::decay::ScanClock;
use super::tile::Bits;
use super::tiles::{Bounds, TILE_SIDE};
use crate::beams::CellFrame;

/// A tile's touched cells are forgotten this long after the last report of one of them.
const MEMORY: Duration = Duration::from_secs(3600);
/// And its assumed ones: about a minute after the contact, which a robot reports for a third of that.
const ASSUMED: Duration = Duration::from_secs(40);
/// Most tiles with touched cells, and with assumed ones.
const MOST: usize = 1024;

/// The touched cells of a map.
#[derive(Clone, Debug, Default)]
pub(super) struct TouchedCells {
    clock: ScanClock,
    known: Cells,
    assumed: Cells,
    /// Bounding box of those that the last scan reported.
    pub(super) reported: Option<Bounds>,
}

impl TouchedCells {
    /// Takes a scan's touched obstacles, and forgets what is old by the scans' stamps.
    pub(super) fn report(&mut self, scan: &Scan, frame: &CellFrame) {
        let now = self.clock.advance(scan.stamp);
        self.known.forget(now, MEMORY);
        self.assumed.forget(now, ASSUMED);
        self.reported = None;
        let map_from_base = scan.map_from_odom * scan.odom_from_base;
        for lines in &scan.touched {
            for ([ax, ay, bx, by], cells) in lines.iter().zip([&mut self.known, &mut self.assumed]) {
                let [a, b] =
                    [(ax, ay), (bx, by)].map(|(x, y)| frame.cells(map_from_base.transform_point(Point2::new(*x, *y))));
                cells.add(a, b, now);
                let bounds = self.reported.get_or_insert(Bounds::at(a));
                bounds.add(a);
                bounds.add(b);
            }
        }
    }

    /// The robot's body covers a cell, counted from the map's anchor: nothing is there.
    pub(super) fn remove(&mut self, x: i64, y: i64) {
        self.known.remove(x, y);
        self.assumed.remove(x, y);
    }

    /// The touched cells of a tile, and those assumed to be.
    pub(super) fn of(&self, tile: [i64; 2]) -> Option<[Bits; 2]> {
        let [known, assumed] = [&self.known, &self.assumed].map(|cells| cells.tiles.get(&tile));
        let bits = |cells: Option<&(Bits, Duration)>| cells.map_or([0; TILE_SIDE], |(bits, _)| *bits);
        (known.is_some() || assumed.is_some()).then(|| [bits(known), bits(assumed)])
    }

    /// The touched cells, counted from the map's anchor.
    pub(super) fn cells(&self) -> impl Iterator<Item = [i64; 2]> {
        let side = TILE_SIDE as i64;
        self.known.tiles.iter().flat_map(move |([x, y], (rows, _))| {
            (y * side..).zip(rows).flat_map(move |(y, row)| {
                let columns = (0..side).filter(move |column| row >> column & 1 == 1);
                columns.map(move |column| [x * side + column, y])
            })
        })
    }

    /// Adds touched cells of an earlier run, counted from the map's anchor, as if they were reported now.
    pub(super) fn restore(&mut self, cells: impl Iterator<Item = [i64; 2]>) {
        let now = self.clock.now;
        cells.for_each(|[x, y]| self.known.insert(x, y, now));
    }

    /// The tiles with touched or assumed cells.
    pub(super) fn tiles(&self) -> impl Iterator<Item = [i64; 2]> {
        self.known.tiles.keys().chain(self.assumed.tiles.keys()).copied()
    }
}

/// Cells by tile, and when one of them was last reported.
#[derive(Clone, Debug, Default)]
struct Cells {
    tiles: BTreeMap<[i64; 2], (Bits, Duration)>,
}

impl Cells {
    /// Adds the cells between two places, in cells from the map's anchor.
    fn add(&mut self, a: Point2<f64>, b: Point2<f64>, now: Duration) {
        let steps = (2.0 * (b - a).norm()).ceil().max(1.0);
        for nth in 0..=steps as u32 {
            let cell = a + (b - a) * (f64::from(nth) / steps);
            self.insert(cell.x.floor() as i64, cell.y.floor() as i64, now);
        }
    }

    fn insert(&mut self, x: i64, y: i64, now: Duration) {
        let (tile, row, bit) = place(x, y);
        if self.tiles.len() < MOST || self.tiles.contains_key(&tile) {
            let (cells, told) = self.tiles.entry(tile).or_insert(([0; TILE_SIDE], now));
            cells[row] |= bit;
            *told = now;
        }
    }

    fn remove(&mut self, x: i64, y: i64) {
        let (tile, row, bit) = place(x, y);
        if let Some((cells, _)) = self.tiles.get_mut(&tile) {
            cells[row] &= !bit;
        }
    }

    fn forget(&mut self, now: Duration, after: Duration) {
        self.tiles.retain(|_, (_, told)| now.saturating_sub(*told) <= after);
    }
}

/// The tile of a cell, and its row and bit there.
fn place(x: i64, y: i64) -> ([i64; 2], usize, u64) {
    let side = TILE_SIDE as i64;
    let tile = [x.div_euclid(side), y.div_euclid(side)];
    (tile, y.rem_euclid(side) as usize, 1 << x.rem_euclid(side))
}
