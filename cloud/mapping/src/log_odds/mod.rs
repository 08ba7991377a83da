//! Log-odds occupancy grid. Occupancy of each cell from all scans so far.
//!
//! The grid grows by whole tiles. The sensor model is applied once for each cell and scan: a cell in which any beam of the scan ended takes
//! one hit, every other cell that any beam passed takes one miss. Beams of one scan are not independent observations, and a hit must not be
//! erased by neighbouring beams that graze the same cell. A cell that the robot touched (`touched`) takes a hit, too.

mod decay;
mod scan_bitmap;
mod snapshot;
#[cfg(test)]
mod tests;
mod tile;
mod tiles;
mod touched;

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Point2, Vector2};
use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{GridSpec, OccupancyGrid};
use zenav_protocol::messages::{Scan, Tile};
use zenav_protocol::robot::Footprint;

pub use snapshot::{CellCounts, GridSnapshot};

use crate::beams::{Beam, BeamReader, CellFrame};
use crate::sensor_model::QuantizedModel;
use crate::settings::{BeamSettings, SensorModel};
use decay::Decay;
use scan_bitmap::{ScanBitmap, Spacing};
use tile::Bits;
use tiles::{Bounds, TILE_SIDE, Tiles};
use touched::TouchedCells;

/// How beams are drawn into the map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InsertMode {
    /// Every beam is drawn exactly.
    #[default]
    Reference,
    /// Wedges between neighbouring beams are filled as far as the beams meet every cell in them, and only the rest is drawn beam by beam.
    /// Cells beside surfaces may differ: [`agreement`](crate::agreement) measures how many.
    Fast,
}

/// Numbers of beams of a scan that were inserted and left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BeamCount {
    /// Number of beams inserted.
    pub inserted: usize,
    /// Number of beams left out because the map would have become too large.
    pub left_out: usize,
}

/// A growing grid of log-odds, changed by scans.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_mapping::{BeamSettings, InsertMode, LogOddsGrid, SensorModel};
/// use zenav_protocol::geometry::Pose2;
/// use zenav_protocol::grid::Occupancy;
/// use zenav_protocol::messages::Scan;
/// use zenav_protocol::time::Stamp;
///
/// // One beam straight ahead that ends 2 m from the robot.
/// let scan = Scan {
///     stamp: Stamp(1),
///     angle_min: 0.0,
///     angle_increment: 0.1,
///     range_min: 0.02,
///     range_max: 5.0,
///     ranges: vec![2.0],
///     odom_from_base: Pose2::new(0.01, 0.01, 0.0),
///     ..Scan::default()
/// };
/// let beams = BeamSettings { trim: 0, ..BeamSettings::default() };
/// let mut grid = LogOddsGrid::new(0.05, &SensorModel::default());
/// grid.insert(&scan, &beams, InsertMode::Reference, None);
/// let map = grid.to_occupancy();
/// let class = |x: f64| map.at(Point2::new(x, 0.01)).map(|value| Occupancy::of(*value));
/// assert_eq!(class(1.0), Some(Occupancy::Free));
/// assert_eq!(class(2.01), Some(Occupancy::Occupied));
/// assert_eq!(class(2.5), Some(Occupancy::Unknown));
/// ```
#[derive(Clone, Debug)]
pub struct LogOddsGrid {
    model: QuantizedModel,
    tiles: Tiles,
    decay: Option<Decay>,
    touched: TouchedCells,
    reader: BeamReader,
    beams: Vec<Beam>,
    bitmap: ScanBitmap,
}

impl LogOddsGrid {
    /// An empty grid with cells of this side (m); a tile's corner lies at the origin of the map frame.
    #[must_use]
    pub fn new(resolution: f64, model: &SensorModel) -> Self {
        Self::of_tiles(
            Tiles::new(CellFrame {
                anchor: Point2::origin(),
                resolution,
            }),
            model,
        )
    }

    fn of_tiles(tiles: Tiles, model: &SensorModel) -> Self {
        Self {
            model: QuantizedModel::new(model),
            tiles,
            decay: None,
            touched: TouchedCells::default(),
            reader: BeamReader::default(),
            beams: Vec::new(),
            bitmap: ScanBitmap::default(),
        }
    }

    /// A grid that starts with a known map, padded with unknown cells to whole tiles. All known cells count as changed.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_mapping::{LogOddsGrid, SensorModel};
    /// use zenav_protocol::grid::{GridSpec, OccupancyGrid};
    ///
    /// let spec = GridSpec { origin: Point2::new(-1.0, 2.0), resolution: 0.05, width: 3, height: 1 };
    /// let map = OccupancyGrid::from_values(spec, vec![0, 100, -1]).unwrap();
    /// let map = LogOddsGrid::from_occupancy(&map, &SensorModel::default());
    /// assert_eq!((map.counts().free, map.counts().occupied), (1, 1));
    /// assert_eq!((map.spec().origin, map.spec().width), (spec.origin, 64));
    /// ```
    #[must_use]
    pub fn from_occupancy(grid: &OccupancyGrid, model: &SensorModel) -> Self {
        let spec = *grid.spec();
        let frame = CellFrame {
            anchor: spec.origin,
            resolution: spec.resolution,
        };
        let mut map = Self::of_tiles(Tiles::with_size(frame, spec.width, spec.height), model);
        let columns = map.tiles.counts[0];
        for (y, row) in grid.values().chunks_exact((spec.width as usize).max(1)).enumerate() {
            for (column, values) in row.chunks(TILE_SIDE).enumerate() {
                if values.iter().all(|value| *value < 0) {
                    continue;
                }
                let index = y / TILE_SIDE * columns + column;
                let tile = map.tiles.tile_mut(index);
                for (x, value) in values.iter().enumerate() {
                    tile.set(x, y, map.model.of_percent(*value), &map.model);
                }
                map.tiles.dirty[index] = true;
            }
        }
        map
    }

    /// The cells that the robot has touched though no beam shows an obstacle there: column and row, from the grid's lower-left cell.
    #[must_use]
    pub fn touched_cells(&self) -> Vec<[u32; 2]> {
        let [left, low] = self.tiles.first.map(|tile| tile * TILE_SIDE as i64);
        let cells = self.touched.cells();
        let in_grid = |[x, y]: [i64; 2]| Some([u32::try_from(x - left).ok()?, u32::try_from(y - low).ok()?]);
        cells.filter_map(in_grid).collect()
    }

    /// Adds [`Self::touched_cells`] of the grid that was stored, as if the robot had just reported them. Cells outside of this one are
    /// left out.
    pub fn restore_touched(&mut self, cells: &[[u32; 2]]) {
        let [left, low] = self.tiles.first.map(|tile| tile * TILE_SIDE as i64);
        let spec = self.spec();
        let cells = cells.iter().filter(|[x, y]| *x < spec.width && *y < spec.height);
        self.touched
            .restore(cells.map(|[x, y]| [left + i64::from(*x), low + i64::from(*y)]));
    }

    /// The same grid, with temporal decay: an obstacle that appeared where it had long been free, and that is no longer seen, is freed
    /// after this time, by the scans' stamps.
    #[must_use]
    pub fn with_decay(mut self, after: Duration) -> Self {
        self.decay = Some(Decay::new(after));
        self
    }

    /// Decays at once every obstacle that would decay in time; none without [decay](Self::with_decay).
    pub fn decay_now(&mut self) {
        if let Some(decay) = &mut self.decay {
            decay.all_now(&mut self.tiles, &self.model);
        }
    }

    /// An unknown grid of the same geometry, model and decay, for redrawing the same scans from other poses.
    #[must_use]
    pub fn unseen(&self) -> Self {
        Self {
            tiles: self.tiles.unseen(),
            decay: self.decay.as_ref().map(Decay::restarted),
            touched: TouchedCells::default(),
            ..self.clone()
        }
    }

    /// Replaces `other`, from which it was made by [`Self::unseen`]: every cell known in either counts as changed. Returns `false`, with no
    /// change, if both together would be too large.
    pub fn succeed(&mut self, other: &Self) -> bool {
        self.tiles.succeed(&other.tiles)
    }

    /// Geometry of the grid; it changes as the grid grows.
    #[must_use]
    pub fn spec(&self) -> GridSpec {
        self.tiles.spec()
    }

    /// Inserts a scan with what the robot touched, and clears the cells under the robot's footprint if one is given.
    ///
    /// The scan must be [sane](Scan::is_sane). Beams that end beyond the largest map are left out. A scan taken beyond it changes nothing
    /// and returns `None`. Cost: proportional to the cells that the beams pass.
    pub fn insert(
        &mut self,
        scan: &Scan,
        settings: &BeamSettings,
        mode: InsertMode,
        footprint: Option<&Footprint>,
    ) -> Option<BeamCount> {
        let mut beams = std::mem::take(&mut self.beams);
        beams.clear();
        self.reader.read(scan, settings, &self.tiles.frame, &mut beams);
        let base = scan.map_from_odom * scan.odom_from_base;
        if let Some(decay) = &mut self.decay {
            decay.advance(scan.stamp, &mut self.tiles, &self.model);
        }
        let count = self.insert_beams(
            scan,
            &mut beams,
            Spacing::new(scan.angle_increment, self.tiles.frame.resolution),
            mode,
            footprint.map(|footprint| (footprint, base)),
        );
        self.beams = beams;
        count
    }

    fn insert_beams(
        &mut self,
        scan: &Scan,
        beams: &mut Vec<Beam>,
        spacing: Spacing,
        mode: InsertMode,
        body: Option<(&Footprint, Pose2)>,
    ) -> Option<BeamCount> {
        let laser = self.tiles.frame.cells(scan.map_from_laser().position());
        let mut bounds = Bounds::at(laser);
        let body_bounds = body.map(|(footprint, base)| {
            let radius = footprint.circumscribed_radius();
            let center = base.position();
            [-radius, radius].map(|side| self.tiles.frame.cells(center + Vector2::repeat(side)))
        });
        for corner in body_bounds.iter().flatten() {
            bounds.add(*corner);
        }
        if !self.tiles.cover(&bounds) {
            return None;
        }
        self.touched.report(scan, &self.tiles.frame);
        let read = beams.len();
        let mut all = bounds;
        for beam in beams.iter() {
            all.add(beam.end);
        }
        if let Some(touched) = self.touched.reported {
            all.add(touched.low);
            all.add(touched.high);
        }
        if self.tiles.cover(&all) {
            bounds = all;
        } else {
            // Slow but rare: some beam ends beyond the largest map.
            beams.retain(|beam| {
                let mut with = bounds;
                with.add(beam.end);
                let covered = self.tiles.cover(&with);
                if covered {
                    bounds = with;
                }
                covered
            });
        }
        let (first, counts) = bounds.tiles();
        self.bitmap.lay(first, counts);
        self.bitmap.draw(laser, beams, spacing, mode);
        if let (Some((footprint, base)), Some(corners)) = (body, body_bounds) {
            self.clear_footprint(footprint, base, corners);
        }
        for tile in self.touched.tiles() {
            self.bitmap.visit(tile);
        }
        let (tiles, model, touched) = (&mut self.tiles, &self.model, &self.touched);
        let mut update = |at, seen: &Bits, by_beams: &Bits, hits: &Bits, cells: Option<&[Bits; 2]>| {
            if let Some(decay) = &mut self.decay {
                if let Some(cells) = cells {
                    decay.touch(at, cells);
                }
                decay.observe(at, by_beams, tiles, model);
            }
            if let Some(index) = tiles.index(at) {
                tiles.dirty[index] |= tiles.tile_mut(index).update(seen, hits, model);
            }
        };
        self.bitmap.take(|at, seen, hits| match touched.of(at) {
            None => update(at, seen, hits, hits, None),
            Some(cells) => {
                let held: Bits = std::array::from_fn(|row| cells[0][row] | cells[1][row]);
                let by_beams = std::array::from_fn(|row| hits[row] & !held[row]);
                let all = std::array::from_fn(|row| hits[row] | held[row]);
                update(at, seen, &by_beams, &all, Some(&cells));
            }
        });
        Some(BeamCount {
            inserted: beams.len(),
            left_out: read - beams.len(),
        })
    }

    /// Marks the cells between two corners as passed if the robot covers their centre.
    fn clear_footprint(&mut self, footprint: &Footprint, base: Pose2, [low, high]: [Point2<f64>; 2]) {
        let base_from_map = base.inverse();
        let corner = self.bitmap.corner();
        let CellFrame { anchor, resolution } = self.tiles.frame;
        let (low, high) = (low - corner, high - corner);
        for y in low.y as usize..=high.y as usize {
            for x in low.x as usize..=high.x as usize {
                let center = anchor + (Vector2::new(x as f64 + 0.5, y as f64 + 0.5) + corner) * resolution;
                if footprint.distance(base_from_map.transform_point(center)) <= 0.0 {
                    self.bitmap.clear(x, y);
                    self.touched
                        .remove(corner.x as i64 + x as i64, corner.y as i64 + y as i64);
                }
            }
        }
    }

    /// Whether any tile changed since it was last taken.
    #[must_use]
    pub fn is_dirty(&self) -> bool {
        self.tiles.dirty.contains(&true)
    }

    /// Takes up to `at_most` changed tiles, in row-major order; the others remain changed.
    ///
    /// ```
    /// # use zenav_mapping::carmen::{CarmenReader, LOG_BEAMS};
    /// use zenav_mapping::{InsertMode, LogOddsGrid, SensorModel};
    ///
    /// # let log = "FLASER 3 1.0 1.5 1.0 0 0 0 0 0 0 1.0 host 1.0\n";
    /// # let scan = CarmenReader::new(log.as_bytes()).next().unwrap().unwrap();
    /// let mut map = LogOddsGrid::new(0.05, &SensorModel::default());
    /// map.insert(&scan, &LOG_BEAMS, InsertMode::Reference, None);
    /// assert!(map.is_dirty() && !map.take_dirty(100).is_empty());
    /// assert!(!map.is_dirty() && map.take_dirty(100).is_empty());
    /// ```
    pub fn take_dirty(&mut self, at_most: usize) -> Vec<Tile> {
        let mut taken = Vec::new();
        for index in 0..self.tiles.dirty.len() {
            if taken.len() == at_most {
                break;
            }
            if std::mem::take(&mut self.tiles.dirty[index]) {
                if let Some(tile) = &mut self.tiles.tiles[index] {
                    Arc::make_mut(tile).cache_counts(&self.model);
                }
                taken.push(self.tiles.message(index, &self.model));
            }
        }
        taken
    }

    /// The grid at this moment. Costs a pointer per tile; the cells are shared with this grid until they change.
    #[must_use]
    pub fn snapshot(&self) -> GridSnapshot {
        GridSnapshot::new(self.tiles.clone(), self.model.clone())
    }

    /// The grid as ROS's occupancy values.
    #[must_use]
    pub fn to_occupancy(&self) -> OccupancyGrid {
        snapshot::to_occupancy(&self.tiles, &self.model)
    }

    /// Number of free, occupied and unknown cells.
    #[must_use]
    pub fn counts(&self) -> CellCounts {
        snapshot::counts(&self.tiles, &self.model)
    }
}
