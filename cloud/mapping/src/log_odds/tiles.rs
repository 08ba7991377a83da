//! Tile store. Storage of a growing map.
//!
//! The map grows by whole tiles from a fixed anchor: known cells stay where they are, bit for bit, and only tiles that were seen take
//! memory. Tiles are shared with snapshots and copied on write.

use std::sync::Arc;

use nalgebra::Point2;
use zenav_protocol::grid::{GridSpec, MAX_CELLS, MAX_SIDE, Occupancy};
use zenav_protocol::messages::{TILE, Tile};

use super::tile::LogOddsTile;
use crate::beams::CellFrame;
use crate::sensor_model::{QuantizedModel, UNSEEN};

/// Side of a tile, cells. Also the number of bits of a word, so that each word of a scan bitmap lies in one tile.
pub(super) const TILE_SIDE: usize = TILE as usize;

/// A growing rectangle of tiles.
#[derive(Clone, Debug)]
pub(super) struct Tiles {
    /// Corner of tile (0, 0), fixed while the grid grows, and the side of a cell.
    pub(super) frame: CellFrame,
    /// Tile column and row of the grid's lower-left corner, counted from the anchor.
    pub(super) first: [i64; 2],
    /// Tiles in each direction.
    pub(super) counts: [usize; 2],
    /// Row-major from the lowest row; `None` where nothing was ever seen.
    pub(super) tiles: Vec<Option<Arc<LogOddsTile>>>,
    /// Tiles that changed since they were last taken.
    pub(super) dirty: Vec<bool>,
}

impl Tiles {
    /// A store without tiles.
    pub(super) fn new(frame: CellFrame) -> Self {
        Self {
            frame,
            first: [0, 0],
            counts: [0, 0],
            tiles: Vec::new(),
            dirty: Vec::new(),
        }
    }

    /// Whole tiles for a number of cells, from the anchor on.
    pub(super) fn with_size(frame: CellFrame, width: u32, height: u32) -> Self {
        let counts = [width.div_ceil(TILE) as usize, height.div_ceil(TILE) as usize];
        let mut tiles = Self::new(frame);
        tiles.lay([0, 0], counts);
        tiles
    }

    /// A store of the same size in which nothing was ever seen.
    pub(super) fn unseen(&self) -> Self {
        Self {
            frame: self.frame,
            first: self.first,
            counts: self.counts,
            tiles: vec![None; self.tiles.len()],
            dirty: vec![false; self.dirty.len()],
        }
    }

    /// Replaces another store of the same frame: grows to cover it, and every tile known in either counts as changed. Returns `false`, with
    /// no change, if both together would be too large.
    pub(super) fn succeed(&mut self, other: &Self) -> bool {
        if other.counts.contains(&0) {
            return true;
        }
        let side = TILE_SIDE as f64;
        let corner = |tile: [i64; 2]| Point2::new(tile[0] as f64 * side, tile[1] as f64 * side);
        let last = [0, 1].map(|axis| other.first[axis] + other.counts[axis] as i64 - 1);
        let mut bounds = Bounds::at(corner(other.first));
        bounds.add(corner(last));
        if !self.cover(&bounds) {
            return false;
        }
        self.dirty = self.tiles.iter().map(Option::is_some).collect();
        for (at, _) in other.known() {
            if let Some(index) = self.index(at) {
                self.dirty[index] = true;
            }
        }
        true
    }

    /// Geometry of the grid.
    pub(super) fn spec(&self) -> GridSpec {
        let CellFrame { anchor, resolution } = self.frame;
        let tile = resolution * f64::from(TILE);
        GridSpec {
            origin: Point2::new(
                anchor.x + self.first[0] as f64 * tile,
                anchor.y + self.first[1] as f64 * tile,
            ),
            resolution,
            width: (self.counts[0] * TILE_SIDE) as u32,
            height: (self.counts[1] * TILE_SIDE) as u32,
        }
    }

    /// Index of a tile in storage, by its column and row from the anchor; `None` outside the grid.
    #[inline]
    pub(super) fn index(&self, [x, y]: [i64; 2]) -> Option<usize> {
        let column = usize::try_from(x - self.first[0])
            .ok()
            .filter(|x| *x < self.counts[0])?;
        let row = usize::try_from(y - self.first[1])
            .ok()
            .filter(|y| *y < self.counts[1])?;
        Some(row * self.counts[0] + column)
    }

    /// The tile at an index of storage, for writing; an unseen tile is created.
    #[inline]
    pub(super) fn tile_mut(&mut self, index: usize) -> &mut LogOddsTile {
        Arc::make_mut(self.tiles[index].get_or_insert_with(|| Arc::new(LogOddsTile::UNSEEN)))
    }

    /// The tile at an index of storage as a message, in ROS's occupancy values.
    pub(super) fn message(&self, index: usize, model: &QuantizedModel) -> Tile {
        Tile {
            x: (index % self.counts[0]) as u32,
            y: (index / self.counts[0]) as u32,
            values: match &self.tiles[index] {
                Some(tile) => tile.rows().iter().flatten().map(|byte| model.percent(*byte)).collect(),
                None => vec![Occupancy::UNKNOWN; TILE_SIDE * TILE_SIDE],
            },
        }
    }

    /// Byte of a cell, by its tile, row and column; unseen outside the grid.
    pub(super) fn byte(&self, tile: [i64; 2], row: usize, column: usize) -> u8 {
        let tile = self.index(tile).and_then(|index| self.tiles[index].as_ref());
        tile.map_or(UNSEEN, |tile| tile.rows()[row][column])
    }

    /// All tiles that were seen, with their column and row from the anchor.
    pub(super) fn known(&self) -> impl Iterator<Item = ([i64; 2], &LogOddsTile)> {
        let place = |index: usize| {
            [
                self.first[0] + (index % self.counts[0]) as i64,
                self.first[1] + (index / self.counts[0]) as i64,
            ]
        };
        let tiles = self.tiles.iter().enumerate();
        tiles.filter_map(move |(index, tile)| Some((place(index), tile.as_deref()?)))
    }

    /// Grows the grid by whole tiles until it covers a rectangle. Returns `false`, with no change, if it would become too large.
    pub(super) fn cover(&mut self, bounds: &Bounds) -> bool {
        let Some((first, counts)) = self.covering(bounds) else {
            return false;
        };
        if counts != self.counts || first != self.first {
            self.lay(first, counts);
        }
        true
    }

    /// First tile and number of tiles of the grid that covers a rectangle and the present grid; `None` if it would be too large.
    fn covering(&self, bounds: &Bounds) -> Option<([i64; 2], [usize; 2])> {
        let (low, high) = (bounds.low / TILE_SIDE as f64, bounds.high / TILE_SIDE as f64);
        let (mut first, mut end) = (
            [low.x.floor(), low.y.floor()],
            [high.x.floor() + 1.0, high.y.floor() + 1.0],
        );
        if self.counts[0] > 0 && self.counts[1] > 0 {
            for axis in 0..2 {
                let now = self.first[axis] as f64;
                first[axis] = first[axis].min(now);
                end[axis] = end[axis].max(now + self.counts[axis] as f64);
            }
        }
        let cells = [0, 1].map(|axis| (end[axis] - first[axis]) * TILE_SIDE as f64);
        // These comparisons are false for NaN.
        let is_near = first.iter().chain(&end).all(|tile| tile.abs() < 1e9);
        let fits = cells.iter().all(|side| *side <= f64::from(MAX_SIDE)) && cells[0] * cells[1] <= MAX_CELLS as f64;
        (is_near && fits).then(|| {
            (
                first.map(|tile| tile as i64),
                cells.map(|cells| cells as usize / TILE_SIDE),
            )
        })
    }

    fn lay(&mut self, first: [i64; 2], counts: [usize; 2]) {
        let mut tiles = vec![None; counts[0] * counts[1]];
        let mut dirty = vec![false; tiles.len()];
        let shift = [0, 1].map(|axis| (self.first[axis] - first[axis]).max(0) as usize);
        for (index, tile) in std::mem::take(&mut self.tiles).into_iter().enumerate() {
            let (x, y) = (index % self.counts[0], index / self.counts[0]);
            let at = (y + shift[1]) * counts[0] + x + shift[0];
            (tiles[at], dirty[at]) = (tile, self.dirty[index]);
        }
        (self.tiles, self.dirty, self.first, self.counts) = (tiles, dirty, first, counts);
    }
}

/// Bounding box of points, in cells from the anchor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) low: Point2<f64>,
    pub(super) high: Point2<f64>,
}

impl Bounds {
    pub(super) fn at(p: Point2<f64>) -> Self {
        Self { low: p, high: p }
    }

    #[inline]
    pub(super) fn add(&mut self, p: Point2<f64>) {
        self.low = Point2::new(self.low.x.min(p.x), self.low.y.min(p.y));
        self.high = Point2::new(self.high.x.max(p.x), self.high.y.max(p.y));
    }

    /// First tile and number of tiles; saturates beyond every grid.
    pub(super) fn tiles(&self) -> ([i64; 2], [usize; 2]) {
        let side = TILE_SIDE as f64;
        let tile = |at: f64| (at / side).floor() as i64;
        let first = [tile(self.low.x), tile(self.low.y)];
        let count = |first: i64, last: i64| (last.saturating_sub(first).max(0) as usize).saturating_add(1);
        (
            first,
            [count(first[0], tile(self.high.x)), count(first[1], tile(self.high.y))],
        )
    }
}
