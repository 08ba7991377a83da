//! What is where? A grid of log-odds that grows by whole tiles and is changed by scans.
//!
//! The sensor model is per ray and once a scan: a cell that any beam of the scan ended in takes one hit, every other cell
//! that any beam went through takes one miss, all others none. Beams of one scan are not independent looks, and a hit is
//! not wiped out by its neighbours that graze the same cell.

use std::time::Duration;

use nalgebra::{Point2, Vector2};
use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{Scan, Tile};
use zenav_protocol::robot::Footprint;

use super::beams::{Beam, BeamOptions, BeamReader, CellFrame};
use super::decay::Decay;
use super::scan_bitmap::ScanBitmap;
use super::sensor_model::{Evidence, SensorModel};
use super::tile::EvidenceTile;
use super::tiles::{Bounds, TILE_SIDE, Tiles};

/// How scans are drawn into the map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InsertMode {
    /// Every beam, exactly.
    #[default]
    Reference,
    /// Wedges between neighbouring beams are filled as long as every cell there is met by a beam, and only what lies
    /// beyond is drawn beam by beam. Cells beside surfaces may differ: [`agreement`](super::build::agreement) tells how many.
    Fast,
}

/// Free, occupied and unknown cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellCounts {
    /// Seen to be empty.
    pub free: u64,
    /// Seen to be full.
    pub occupied: u64,
    /// Neither.
    pub unknown: u64,
}

impl CellCounts {
    /// Counts occupancy values.
    #[must_use]
    pub fn of(values: &[i8]) -> Self {
        let mut counts = Self::default();
        for value in values {
            match Occupancy::of(*value) {
                Occupancy::Free => counts.free += 1,
                Occupancy::Occupied => counts.occupied += 1,
                Occupancy::Unknown => counts.unknown += 1,
            }
        }
        counts
    }
}

/// What became of a scan's beams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drawn {
    /// Beams in the map.
    pub beams: usize,
    /// Beams that would have made the map too large.
    pub left_out: usize,
}

/// Log-odds of every cell seen so far.
#[derive(Clone, Debug)]
pub struct LogOddsGrid {
    evidence: Evidence,
    map: Tiles,
    fading: Option<Decay>,
    reader: BeamReader,
    beams: Vec<Beam>,
    window: ScanBitmap,
}

impl LogOddsGrid {
    /// An empty map; cells have this side (m), and a tile border lies at the map frame's origin.
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

    fn of_tiles(map: Tiles, model: &SensorModel) -> Self {
        Self {
            evidence: Evidence::new(model),
            map,
            fading: None,
            reader: BeamReader::default(),
            beams: Vec::new(),
            window: ScanBitmap::default(),
        }
    }

    /// A map that begins with known values; it is padded with unknown cells to whole tiles, and all that is known counts as
    /// changed.
    #[must_use]
    pub fn from_occupancy(grid: &OccupancyGrid, model: &SensorModel) -> Self {
        let spec = *grid.spec();
        let frame = CellFrame {
            anchor: spec.origin,
            resolution: spec.resolution,
        };
        let mut map = Self::of_tiles(Tiles::with_size(frame, spec.width, spec.height), model);
        let columns = map.map.counts[0];
        for (y, row) in grid.values().chunks_exact((spec.width as usize).max(1)).enumerate() {
            for (column, values) in row.chunks(TILE_SIDE).enumerate() {
                if values.iter().all(|value| *value < 0) {
                    continue;
                }
                let index = y / TILE_SIDE * columns + column;
                let tile = map.map.tiles[index].get_or_insert_with(|| Box::new(EvidenceTile::UNSEEN));
                for (x, value) in values.iter().enumerate() {
                    tile.set(x, y, map.evidence.of_percent(*value), &map.evidence);
                }
                map.map.dirty[index] = true;
            }
        }
        map
    }

    /// Lets everything fade at once that is in doubt; nothing where nothing fades.
    pub fn forget(&mut self) {
        if let Some(fading) = &mut self.fading {
            fading.forget(&mut self.map, &self.evidence);
        }
    }

    /// The same map; from now on what goes away unseen fades after so long (see the module `fading`), by the scans' stamps.
    #[must_use]
    pub fn with_fading(mut self, after: Duration) -> Self {
        self.fading = Some(Decay::new(after));
        self
    }

    /// Where the grid lies now.
    #[must_use]
    pub fn spec(&self) -> GridSpec {
        self.map.spec()
    }

    /// Inserts a sane scan, and clears the cells under the robot's own footprint, where one is given. Beams that end
    /// beyond the largest map are left out. `None`, and nothing changed, for a scan that was taken beyond it.
    pub fn insert(
        &mut self,
        scan: &Scan,
        options: &BeamOptions,
        mode: InsertMode,
        footprint: Option<&Footprint>,
    ) -> Option<Drawn> {
        let mut beams = std::mem::take(&mut self.beams);
        beams.clear();
        self.reader.read(scan, options, &self.map.frame, &mut beams);
        let base = scan.map_from_odom * scan.odom_from_base;
        if let Some(fading) = &mut self.fading {
            fading.go_on(scan.stamp, &mut self.map, &self.evidence);
        }
        let drawn = self.draw(
            self.map.frame.cells(scan.map_from_laser().position()),
            &mut beams,
            // Neighbouring beams are a cell apart where an arc of the circle between them is one cell long.
            (mode == InsertMode::Fast).then_some(scan.angle_increment.recip()),
            footprint.map(|footprint| (footprint, base)),
        );
        self.beams = beams;
        drawn
    }

    fn draw(
        &mut self,
        laser: Point2<f64>,
        beams: &mut Vec<Beam>,
        dense: Option<f64>,
        body: Option<(&Footprint, Pose2)>,
    ) -> Option<Drawn> {
        let mut bounds = Bounds::at(laser);
        let body_bounds = body.map(|(footprint, base)| {
            let radius = footprint.circumscribed_radius();
            let center = base.position();
            [-radius, radius].map(|side| self.map.frame.cells(center + Vector2::repeat(side)))
        });
        for corner in body_bounds.iter().flatten() {
            bounds.add(*corner);
        }
        if !self.map.cover(&bounds) {
            return None;
        }
        let read = beams.len();
        let mut all = bounds;
        for beam in beams.iter() {
            all.add(beam.end);
        }
        if self.map.cover(&all) {
            bounds = all;
        } else {
            // Slow but rare: some beam leaves the largest map.
            beams.retain(|beam| {
                let mut with = bounds;
                with.add(beam.end);
                let covered = self.map.cover(&with);
                if covered {
                    bounds = with;
                }
                covered
            });
        }
        let (first, counts) = bounds.tiles();
        self.window.lay(first, counts);
        self.window.draw(laser, beams, dense);
        if let (Some((footprint, base)), Some(corners)) = (body, body_bounds) {
            self.vacate(footprint, base, corners);
        }
        let (map, evidence) = (&mut self.map, &self.evidence);
        self.window.take(|at, seen, hits| {
            if let Some(fading) = &mut self.fading {
                fading.notice(at, hits, map, evidence);
            }
            if let Some(index) = map.index(at) {
                let tile = map.tiles[index].get_or_insert_with(|| Box::new(EvidenceTile::UNSEEN));
                map.dirty[index] |= tile.look(seen, hits, evidence);
            }
        });
        Some(Drawn {
            beams: beams.len(),
            left_out: read - beams.len(),
        })
    }

    /// Marks the cells between two corners whose centre the robot itself covers as empty.
    fn vacate(&mut self, footprint: &Footprint, base: Pose2, [low, high]: [Point2<f64>; 2]) {
        let base_from_map = base.inverse();
        let corner = self.window.corner();
        let CellFrame { anchor, resolution } = self.map.frame;
        let (low, high) = (low - corner, high - corner);
        for y in low.y as usize..=high.y as usize {
            for x in low.x as usize..=high.x as usize {
                let center = anchor + (Vector2::new(x as f64 + 0.5, y as f64 + 0.5) + corner) * resolution;
                if footprint.distance(base_from_map.transform_point(center)) <= 0.0 {
                    self.window.vacate(x, y);
                }
            }
        }
    }

    /// Whether any tile changed since it was last taken.
    #[must_use]
    pub fn is_dirty(&self) -> bool {
        self.map.dirty.contains(&true)
    }

    /// Takes changed tiles, at most so many, in row-major order; the rest stays for the next time.
    pub fn take_dirty(&mut self, at_most: usize) -> Vec<Tile> {
        let mut tiles = Vec::new();
        for index in 0..self.map.dirty.len() {
            if tiles.len() == at_most {
                break;
            }
            if std::mem::take(&mut self.map.dirty[index]) {
                if let Some(tile) = &mut self.map.tiles[index] {
                    tile.keep_counts(&self.evidence);
                }
                tiles.push(self.tile(index));
            }
        }
        tiles
    }

    fn tile(&self, index: usize) -> Tile {
        Tile {
            x: (index % self.map.counts[0]) as u32,
            y: (index / self.map.counts[0]) as u32,
            values: match &self.map.tiles[index] {
                Some(tile) => tile.rows().iter().flatten().map(|byte| self.percent(*byte)).collect(),
                None => vec![Occupancy::UNKNOWN; TILE_SIDE * TILE_SIDE],
            },
        }
    }

    fn percent(&self, byte: u8) -> i8 {
        self.evidence.percent[usize::from(byte)]
    }

    /// The map with ROS's occupancy values.
    #[must_use]
    pub fn to_occupancy(&self) -> OccupancyGrid {
        let mut grid = OccupancyGrid::filled(self.spec(), Occupancy::UNKNOWN);
        let columns = self.map.counts[0].max(1);
        let bands = grid.values_mut().chunks_exact_mut(columns * TILE_SIDE * TILE_SIDE);
        for (band, tiles) in bands.zip(self.map.tiles.chunks_exact(columns)) {
            for (column, tile) in tiles.iter().enumerate() {
                let Some(tile) = tile else {
                    continue;
                };
                for (values, bytes) in band.chunks_exact_mut(columns * TILE_SIDE).zip(tile.rows()) {
                    for (value, byte) in values[column * TILE_SIDE..].iter_mut().zip(bytes) {
                        *value = self.percent(*byte);
                    }
                }
            }
        }
        grid
    }

    /// How many cells are free, occupied, unknown.
    #[must_use]
    pub fn counts(&self) -> CellCounts {
        let mut counts = CellCounts::default();
        for (_, tile) in self.map.known() {
            let [free, occupied] = tile.counts(&self.evidence);
            counts.free += u64::from(free);
            counts.occupied += u64::from(occupied);
        }
        counts.unknown = self.spec().len() as u64 - counts.free - counts.occupied;
        counts
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use zenav_protocol::grid::Cell;
    use zenav_protocol::messages::TILE;
    use zenav_protocol::time::Stamp;

    use super::super::sensor_model::UNSEEN;
    use super::*;

    const OPTIONS: BeamOptions = BeamOptions {
        trim: 0,
        max_range: None,
        clear_without_return: true,
    };

    /// A scan from a pose whose beams start straight ahead and go counter-clockwise by `step`.
    fn scan(pose: Pose2, step: f64, ranges: Vec<f32>) -> Scan {
        Scan {
            stamp: Stamp(1),
            angle_min: 0.0,
            angle_increment: step,
            range_min: 0.02,
            range_max: 5.0,
            ranges,
            base_from_laser: Pose2::IDENTITY,
            map_from_odom: Pose2::IDENTITY,
            odom_from_base: pose,
        }
    }

    fn empty() -> LogOddsGrid {
        LogOddsGrid::new(0.05, &SensorModel::default())
    }

    fn at(map: &LogOddsGrid, x: f64, y: f64) -> Occupancy {
        map.to_occupancy()
            .at(Point2::new(x, y))
            .map_or(Occupancy::Unknown, |value| Occupancy::of(*value))
    }

    proptest::proptest! {
        #![proptest_config(proptest::test_runner::Config::with_cases(32))]

        #[test]
        fn the_exact_way_is_a_walk_along_every_beam(looks in proptest::collection::vec((-3.0..3.0, -3.0..3.0, -3.1..3.1, 0.01..0.3, proptest::collection::vec(0.05_f32..7.0, 1..40)), 1..12)) {
            let (mut map, evidence) = (empty(), Evidence::new(&SensorModel::default()));
            let whole = GridSpec { origin: Point2::new(-12.8, -12.8), resolution: 0.05, width: 512, height: 512 };
            let mut bytes = vec![UNSEEN; whole.len()];
            for (x, y, yaw, step, mut ranges) in looks {
                ranges.truncate((std::f64::consts::TAU / step) as usize);
                let scan = scan(Pose2::new(x, y, yaw), step, ranges);
                proptest::prop_assert!(map.insert(&scan, &OPTIONS, InsertMode::Reference, None).is_some());
                let (mut seen, mut hit) = (std::collections::BTreeSet::new(), std::collections::BTreeSet::new());
                for (beam, range) in scan.ranges.iter().enumerate() {
                    let length = f64::from(*range).min(scan.range_max);
                    let end = Point2::new(x, y) + Vector2::new((yaw + scan.angle(beam)).cos(), (yaw + scan.angle(beam)).sin()) * length;
                    seen.extend(whole.walk(Point2::new(x, y), end).map(|cell| whole.index(cell)));
                    hit.extend((f64::from(*range) <= scan.range_max).then(|| whole.index(whole.cell_at(end).unwrap())));
                }
                for index in seen {
                    bytes[index] = if hit.contains(&index) { evidence.after_hit(bytes[index]) } else { evidence.after_miss(bytes[index]) };
                }
            }
            let map = map.to_occupancy();
            for (index, byte) in bytes.iter().enumerate() {
                let value = map.at(whole.center(whole.cell(index))).copied().unwrap_or(Occupancy::UNKNOWN);
                proptest::prop_assert_eq!(value, evidence.percent[usize::from(*byte)], "at {}", whole.center(whole.cell(index)));
            }
        }
    }

    proptest::proptest! {
        #[test]
        fn the_fast_way_marks_what_the_exact_way_marks(ranges in proptest::collection::vec((0.3_f32..5.0, 1_usize..60), 5..40), x in -1.0..1.0, yaw in -3.0..3.0, step in 0.005..0.02) {
            let ranges: Vec<f32> = ranges.iter().flat_map(|(range, times)| (0..*times).map(move |i| range + 0.003 * i as f32)).collect();
            let count = ranges.len().min((std::f64::consts::TAU / step) as usize);
            let scan = scan(Pose2::new(x, 0.4, yaw), step, ranges[..count].to_vec());
            let [exact, fast] = [InsertMode::Reference, InsertMode::Fast].map(|mode| {
                let mut map = empty();
                map.insert(&scan, &OPTIONS, mode, None);
                map.to_occupancy()
            });
            let differ = exact.values().iter().zip(fast.values()).filter(|(exact, fast)| exact != fast).count();
            let known = exact.values().iter().filter(|value| **value >= 0).count();
            proptest::prop_assert!(differ * 200 <= known, "{differ} of {known} cells differ");
        }
    }

    #[test]
    fn a_beam_frees_its_way_and_fills_its_end_and_leaves_the_rest_unknown() {
        let mut map = empty();
        map.insert(
            &scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![2.0]),
            &OPTIONS,
            InsertMode::Reference,
            None,
        );
        assert_eq!(at(&map, 1.0, 0.01), Occupancy::Free);
        assert_eq!(at(&map, 2.01, 0.01), Occupancy::Occupied);
        assert_eq!(at(&map, 2.06, 0.01), Occupancy::Unknown);
        assert_eq!(at(&map, 1.0, 0.11), Occupancy::Unknown);
        assert_eq!(map.counts().occupied, 1);
    }

    #[test]
    fn a_beam_without_a_return_frees_its_whole_range() {
        let mut map = empty();
        map.insert(
            &scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![f32::INFINITY]),
            &OPTIONS,
            InsertMode::Reference,
            None,
        );
        assert_eq!((at(&map, 4.9, 0.01), map.counts().occupied), (Occupancy::Free, 0));
        let mut map = empty();
        map.insert(
            &scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![f32::INFINITY]),
            &BeamOptions {
                clear_without_return: false,
                ..OPTIONS
            },
            InsertMode::Reference,
            None,
        );
        assert_eq!(map.counts().free, 0);
    }

    #[test]
    fn a_hit_is_not_wiped_out_by_another_beam_of_its_scan() {
        let mut map = empty();
        // The second beam goes on through the cell that the first one ended in.
        map.insert(
            &scan(Pose2::new(0.01, 0.01, 0.0), 1e-4, vec![1.0, 2.0]),
            &OPTIONS,
            InsertMode::Reference,
            None,
        );
        assert_eq!(at(&map, 1.01, 0.01), Occupancy::Occupied);
        // The next scan does wipe it out.
        for _ in 0..5 {
            map.insert(
                &scan(Pose2::new(0.01, 0.01, 0.0), 1e-4, vec![2.0, 2.0]),
                &OPTIONS,
                InsertMode::Reference,
                None,
            );
        }
        assert_eq!(at(&map, 1.01, 0.01), Occupancy::Free);
    }

    #[test]
    fn the_place_where_the_robot_stands_is_free() {
        let mut map = empty();
        map.insert(
            &scan(Pose2::new(3.0, -2.0, 0.3), 0.1, vec![0.1; 40]),
            &OPTIONS,
            InsertMode::Reference,
            Some(&Footprint::Radius(0.25)),
        );
        for (x, y) in [(3.0, -2.0), (3.2, -2.0), (2.8, -2.0), (3.0, -1.8), (3.1, -2.0)] {
            assert_eq!(at(&map, x, y), Occupancy::Free);
        }
    }

    #[test]
    fn growing_keeps_what_was_known_where_it_was() {
        let mut map = empty();
        map.insert(
            &scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![1.0]),
            &OPTIONS,
            InsertMode::Reference,
            None,
        );
        let before = map.spec();
        map.insert(
            &scan(Pose2::new(-20.0, -30.0, 0.0), 0.1, vec![1.0]),
            &OPTIONS,
            InsertMode::Reference,
            None,
        );
        let after = map.spec();
        assert!(after.len() > before.len() && after.width.is_multiple_of(TILE) && after.height.is_multiple_of(TILE));
        assert_eq!(
            (at(&map, 0.5, 0.01), at(&map, 1.01, 0.01)),
            (Occupancy::Free, Occupancy::Occupied)
        );
        assert_eq!(
            (at(&map, -19.5, -30.0), at(&map, -18.99, -29.99)),
            (Occupancy::Free, Occupancy::Occupied)
        );
    }

    #[test]
    fn a_beam_to_the_end_of_the_world_is_left_out() {
        let mut map = empty();
        let mut far = scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![1.0, 1e9]);
        far.range_max = 1e10;
        let drawn = Drawn { beams: 1, left_out: 1 };
        assert_eq!(map.insert(&far, &OPTIONS, InsertMode::Reference, None), Some(drawn));
        let nowhere = scan(Pose2::new(1e12, 0.0, 0.0), 0.1, vec![1.0]);
        assert_eq!(map.insert(&nowhere, &OPTIONS, InsertMode::Reference, None), None);
        assert_eq!(at(&map, 1.01, 0.01), Occupancy::Occupied);
    }

    #[test]
    fn changed_tiles_are_given_once() {
        let mut map = empty();
        let still = scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![1.0]);
        map.insert(&still, &OPTIONS, InsertMode::Reference, None);
        let tiles = map.take_dirty(usize::MAX);
        assert_eq!(tiles.len(), 1);
        assert_eq!(tiles[0].values, map.to_occupancy().values());
        assert!(!map.is_dirty());
        // A scene that does not change any more is not told again.
        for _ in 0..100 {
            map.insert(&still, &OPTIONS, InsertMode::Reference, None);
        }
        map.take_dirty(usize::MAX);
        map.insert(&still, &OPTIONS, InsertMode::Reference, None);
        assert!(!map.is_dirty());
    }

    #[test]
    fn known_values_are_taken_over_and_padded() {
        let spec = GridSpec {
            origin: Point2::new(0.3, -0.7),
            resolution: 0.1,
            width: 70,
            height: 3,
        };
        let mut grid = OccupancyGrid::filled(spec, Occupancy::FREE);
        grid[Cell::new(69, 2)] = Occupancy::OCCUPIED;
        let map = LogOddsGrid::from_occupancy(&grid, &SensorModel::default());
        assert_eq!(
            (map.spec().width, map.spec().height, map.spec().origin),
            (128, 64, spec.origin)
        );
        assert_eq!(
            map.counts(),
            CellCounts {
                free: 209,
                occupied: 1,
                unknown: 128 * 64 - 210
            }
        );
        assert_eq!(Occupancy::of(map.to_occupancy()[Cell::new(69, 2)]), Occupancy::Occupied);
    }
}
