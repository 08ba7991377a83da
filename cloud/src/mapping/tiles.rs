//! How does a map grow? By whole tiles, with a fixed anchor: what was known stays where it was, to the last bit.

use nalgebra::Point2;
use zenav_protocol::grid::{GridSpec, MAX_SIDE};
use zenav_protocol::messages::TILE;

/// Most cells of a map.
pub const MAX_CELLS: u64 = 1 << 28;

/// Side of a tile, cells; also the bits of a word, so that a word of a scan's bitmap lies in one tile.
pub(super) const TILE_SIDE: usize = TILE as usize;

/// One byte a cell, zero where nothing was ever written.
#[derive(Clone, Debug)]
pub(super) struct TiledBytes {
    resolution: f64,
    /// Where tile (0, 0) begins, whatever the grid grows to, m.
    anchor: Point2<f64>,
    /// Tile column and row of the grid's lower-left corner, counted from the anchor.
    first_tile: [i64; 2],
    /// Tiles in each direction.
    pub(super) tiles: [usize; 2],
    /// Row-major from the lowest row, whole tiles.
    pub(super) cells: Vec<u8>,
    /// Tiles that changed since they were last taken, row-major.
    pub(super) dirty: Vec<bool>,
}

impl TiledBytes {
    /// No cell yet.
    pub(super) fn new(resolution: f64, anchor: Point2<f64>) -> Self {
        Self {
            resolution,
            anchor,
            first_tile: [0, 0],
            tiles: [0, 0],
            cells: Vec::new(),
            dirty: Vec::new(),
        }
    }

    /// Whole tiles for so many cells from the anchor on, all marked as changed.
    pub(super) fn with_size(resolution: f64, anchor: Point2<f64>, width: u32, height: u32) -> Self {
        let tiles = [width.div_ceil(TILE) as usize, height.div_ceil(TILE) as usize];
        let count = tiles[0] * tiles[1];
        Self {
            tiles,
            cells: vec![0; count * TILE_SIDE * TILE_SIDE],
            dirty: vec![true; count],
            ..Self::new(resolution, anchor)
        }
    }

    /// Cells a row.
    pub(super) fn stride(&self) -> usize {
        self.tiles[0] * TILE_SIDE
    }

    /// Where the grid lies now.
    pub(super) fn spec(&self) -> GridSpec {
        let tile = self.resolution * f64::from(TILE);
        GridSpec {
            origin: Point2::new(
                self.anchor.x + self.first_tile[0] as f64 * tile,
                self.anchor.y + self.first_tile[1] as f64 * tile,
            ),
            resolution: self.resolution,
            width: (self.tiles[0] * TILE_SIDE) as u32,
            height: (self.tiles[1] * TILE_SIDE) as u32,
        }
    }

    /// Grows the grid, by whole tiles, until it holds a rectangle; `false` when the map would become too large.
    pub(super) fn cover(&mut self, bounds: &Bounds) -> bool {
        let tile = self.resolution * f64::from(TILE);
        let tile_of = |p: Point2<f64>| {
            [
                ((p.x - self.anchor.x) / tile).floor(),
                ((p.y - self.anchor.y) / tile).floor(),
            ]
        };
        let (low, high) = (tile_of(bounds.low), tile_of(bounds.high));
        if ![low, high].iter().flatten().all(|at| at.abs() < 1e9) {
            return false;
        }
        let empty = self.tiles[0] == 0 || self.tiles[1] == 0;
        let (mut first, mut end) = ([0_i64; 2], [0_i64; 2]);
        for axis in 0..2 {
            let (now_first, now_end) = (self.first_tile[axis], self.first_tile[axis] + self.tiles[axis] as i64);
            (first[axis], end[axis]) = (low[axis] as i64, high[axis] as i64 + 1);
            if !empty {
                first[axis] = first[axis].min(now_first);
                end[axis] = end[axis].max(now_end);
            }
        }
        let tiles = [end[0] - first[0], end[1] - first[1]];
        if tiles.iter().any(|side| *side > i64::from(MAX_SIDE / TILE))
            || (tiles[0] * tiles[1]).cast_unsigned() * u64::from(TILE * TILE) > MAX_CELLS
        {
            return false;
        }
        let tiles = [tiles[0] as usize, tiles[1] as usize];
        if tiles != self.tiles || first != self.first_tile {
            self.grow(first, tiles);
        }
        true
    }

    fn grow(&mut self, first: [i64; 2], tiles: [usize; 2]) {
        let mut cells = vec![0; tiles[0] * tiles[1] * TILE_SIDE * TILE_SIDE];
        let mut dirty = vec![false; tiles[0] * tiles[1]];
        let shift = [
            (self.first_tile[0] - first[0]).max(0) as usize,
            (self.first_tile[1] - first[1]).max(0) as usize,
        ];
        let (old, new) = (self.tiles[0] * TILE_SIDE, tiles[0] * TILE_SIDE);
        if old > 0 {
            for (y, row) in self.cells.chunks_exact(old).enumerate() {
                cells[(y + shift[1] * TILE_SIDE) * new + shift[0] * TILE_SIDE..][..old].copy_from_slice(row);
            }
            for (y, row) in self.dirty.chunks_exact(self.tiles[0]).enumerate() {
                dirty[(y + shift[1]) * tiles[0] + shift[0]..][..self.tiles[0]].copy_from_slice(row);
            }
        }
        (self.cells, self.dirty, self.first_tile, self.tiles) = (cells, dirty, first, tiles);
    }
}

/// A rectangle that holds points.
#[derive(Clone, Copy)]
pub(super) struct Bounds {
    pub(super) low: Point2<f64>,
    pub(super) high: Point2<f64>,
}

impl Bounds {
    pub(super) fn at(p: Point2<f64>) -> Self {
        Self { low: p, high: p }
    }

    pub(super) fn add(&mut self, p: Point2<f64>) {
        self.low = Point2::new(self.low.x.min(p.x), self.low.y.min(p.y));
        self.high = Point2::new(self.high.x.max(p.x), self.high.y.max(p.y));
    }
}
