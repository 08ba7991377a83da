//! How do a robot's scans become its map? The pure core of mapping: scans in, patches out.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{MapInfo, MapPatch, MapRef, MapReply, Scan};
use zenav_protocol::robot::Footprint;
use zenav_protocol::time::Stamp;

use super::config::MapperConfig;
use super::occupancy::LogOddsGrid;

/// What became of a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Insertion {
    /// It is in the map.
    Inserted,
    /// The map is held: nothing is inserted until it is resumed.
    Held,
    /// It is not newer than the newest one of its lidar in the map.
    OutOfOrder,
    /// Its description makes no sense.
    NotSane,
    /// It was taken beyond the largest map, or every beam ends beyond it.
    OutOfMap,
}

/// A stamp this much before the newest one is not late but of another clock: the robot has started anew, s.
const ANOTHER_CLOCK: f64 = 10.0;

/// Most lidars whose scans are kept in order.
const MAX_LIDARS: usize = 16;

/// Longest trajectory that is kept; beyond it every other point is dropped, and the step doubles.
const MAX_TRAJECTORY: usize = 100_000;

/// One robot's map in the making.
#[derive(Clone, Debug)]
pub struct Mapper {
    config: MapperConfig,
    grid: LogOddsGrid,
    map: MapRef,
    stamp: Stamp,
    /// Stamp of the last scan of each lidar; lidars are told apart by their mounts.
    newest: Vec<(Pose2, Stamp)>,
    scans: u64,
    trajectory: Vec<Point2<f64>>,
    trajectory_step: f64,
    stored: bool,
    held: bool,
}

impl Mapper {
    /// An unknown map of this name (new for every map that is begun).
    #[must_use]
    pub fn new(config: MapperConfig, map_id: impl Into<String>) -> Self {
        Self {
            grid: config.fading(LogOddsGrid::new(config.resolution, &config.model)),
            map: MapRef {
                id: map_id.into(),
                revision: 0,
            },
            stamp: Stamp::ZERO,
            newest: Vec::new(),
            scans: 0,
            trajectory: Vec::new(),
            trajectory_step: config.trajectory_step,
            stored: false,
            held: false,
            config,
        }
    }

    /// A stored map: it counts as existing, and is held until it is resumed. All of it is in the first patches.
    #[must_use]
    pub fn with_stored(
        config: MapperConfig,
        map: MapRef,
        grid: &OccupancyGrid,
        trajectory: Vec<Point2<f64>>,
        scans: u64,
    ) -> Self {
        let log_odds = LogOddsGrid::from_occupancy(grid, &config.model);
        Self {
            grid: config.fading(log_odds),
            trajectory,
            scans,
            stored: true,
            held: true,
            map: map.clone(),
            ..Self::new(config, map.id)
        }
    }

    /// Takes in a scan.
    pub fn insert(&mut self, scan: &Scan) -> Insertion {
        if self.held {
            return Insertion::Held;
        }
        if !scan.is_sane() {
            return Insertion::NotSane;
        }
        if !self.is_in_order(scan) {
            return Insertion::OutOfOrder;
        }
        let drawn = self.grid.insert(
            scan,
            &self.config.beams,
            self.config.mode,
            self.config.footprint.as_ref(),
        );
        if drawn.is_none_or(|drawn| drawn.beams == 0 && drawn.left_out > 0) {
            return Insertion::OutOfMap;
        }
        self.note_order(scan);
        self.scans += 1;
        self.keep_trajectory((scan.map_from_odom * scan.odom_from_base).position());
        Insertion::Inserted
    }

    /// Whether a scan is newer than the last one of its lidar: a robot's lidars need not wait for one another.
    fn is_in_order(&self, scan: &Scan) -> bool {
        let last = self.newest.iter().find(|(mount, _)| *mount == scan.base_from_laser);
        last.is_none_or(|(_, stamp)| scan.stamp > *stamp || stamp.secs_since(scan.stamp) >= ANOTHER_CLOCK)
    }

    fn note_order(&mut self, scan: &Scan) {
        if self.stamp.secs_since(scan.stamp) >= ANOTHER_CLOCK || self.newest.len() >= MAX_LIDARS {
            (self.newest, self.stamp) = (Vec::new(), scan.stamp);
        }
        self.newest.retain(|(mount, _)| *mount != scan.base_from_laser);
        self.newest.push((scan.base_from_laser, scan.stamp));
        self.stamp = self.stamp.max(scan.stamp);
    }

    fn keep_trajectory(&mut self, position: Point2<f64>) {
        if self
            .trajectory
            .last()
            .is_some_and(|last| (position - last).norm() < self.trajectory_step)
        {
            return;
        }
        self.trajectory.push(position);
        if self.trajectory.len() > MAX_TRAJECTORY {
            let mut keep = false;
            self.trajectory.retain(|_| {
                keep = !keep;
                keep
            });
            self.trajectory_step *= 2.0;
        }
    }

    /// What changed since the last patch, as the next revision; `None` when nothing did.
    pub fn take_patch(&mut self) -> Option<MapPatch> {
        let tiles = self.grid.take_dirty(self.config.patch_tiles.max(1));
        if tiles.is_empty() {
            return None;
        }
        let base_revision = self.map.revision;
        self.map.revision += 1;
        Some(MapPatch {
            stamp: self.stamp,
            map: self.map.clone(),
            base_revision,
            spec: self.grid.spec(),
            tiles,
        })
    }

    /// Whether the next patch has anything to say.
    #[must_use]
    pub fn has_changes(&self) -> bool {
        self.grid.is_dirty()
    }

    /// From now on the cells under this outline are cleared.
    pub fn set_footprint(&mut self, footprint: Footprint) {
        self.config.footprint = Some(footprint);
    }

    /// The map's description, with the revision of the last patch.
    #[must_use]
    pub fn info(&self) -> MapInfo {
        let counts = self.grid.counts();
        MapInfo {
            stamp: self.stamp,
            map: self.map.clone(),
            spec: self.grid.spec(),
            free: counts.free,
            occupied: counts.occupied,
            unknown: counts.unknown,
            scans: self.scans,
            stored: self.stored,
        }
    }

    /// The whole map. It may already hold changes that follow in the next patch, which does no harm: patches carry values, not differences.
    #[must_use]
    pub fn reply(&self) -> MapReply {
        MapReply {
            info: self.info(),
            values: self.grid.to_occupancy().into_values(),
            trajectory: self.trajectory.clone(),
        }
    }

    /// The map with ROS's occupancy values.
    #[must_use]
    pub fn grid(&self) -> OccupancyGrid {
        self.grid.to_occupancy()
    }

    /// The robot's way while the map was built, map frame, about every 0.1 m.
    #[must_use]
    pub fn trajectory(&self) -> &[Point2<f64>] {
        &self.trajectory
    }

    /// Name and revision.
    #[must_use]
    pub fn map(&self) -> &MapRef {
        &self.map
    }

    /// Begins a new, unknown map, and inserts scans into it.
    pub fn reset(&mut self, map_id: impl Into<String>) {
        *self = Self::new(self.config.clone(), map_id);
    }

    /// Takes everything for gone that may only have passed by (see the module `fading`).
    pub fn forget(&mut self) {
        self.grid.forget();
    }

    /// Inserts no more scans until [`resume`](Self::resume).
    pub fn hold(&mut self) {
        self.held = true;
    }

    /// Goes on inserting scans.
    pub fn resume(&mut self) {
        self.held = false;
    }

    /// Whether scans are left out.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.held
    }

    /// From now on the map exists: it has been stored as complete.
    pub fn mark_stored(&mut self) {
        self.stored = true;
    }

    /// Whether the map exists: loaded, or stored as complete.
    #[must_use]
    pub fn is_stored(&self) -> bool {
        self.stored
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use zenav_protocol::grid::Occupancy;

    use super::*;

    fn scan(stamp: u64, x: f64) -> Scan {
        Scan {
            stamp: Stamp(stamp),
            angle_min: -1.0,
            angle_increment: 0.02,
            range_min: 0.02,
            range_max: 5.0,
            ranges: vec![2.0; 100],
            base_from_laser: Pose2::new(0.1, 0.0, 0.0),
            map_from_odom: Pose2::IDENTITY,
            odom_from_base: Pose2::new(x, 0.0, 0.0),
        }
    }

    #[test]
    fn every_patch_is_the_next_revision_and_says_what_it_applies_to() {
        let mut mapper = Mapper::new(MapperConfig::default(), "first");
        assert_eq!(mapper.take_patch(), None);
        assert_eq!(mapper.insert(&scan(1, 0.0)), Insertion::Inserted);
        let first = mapper.take_patch().unwrap();
        assert_eq!((first.base_revision, first.map.revision), (0, 1));
        assert_eq!(mapper.take_patch(), None);
        mapper.insert(&scan(2, 0.5));
        let second = mapper.take_patch().unwrap();
        assert_eq!((second.base_revision, second.map.revision), (1, 2));
        assert_eq!(mapper.info().map, second.map);
    }

    #[test]
    fn stale_repeated_and_senseless_scans_change_nothing() {
        let mut mapper = Mapper::new(MapperConfig::default(), "m");
        mapper.insert(&scan(20_000_000_000, 0.0));
        let before = mapper.reply();
        assert_eq!(mapper.insert(&scan(20_000_000_000, 1.0)), Insertion::OutOfOrder);
        assert_eq!(mapper.insert(&scan(19_000_000_000, 1.0)), Insertion::OutOfOrder);
        let mut senseless = scan(21_000_000_000, 1.0);
        senseless.odom_from_base.x = f64::NAN;
        assert_eq!(mapper.insert(&senseless), Insertion::NotSane);
        let far = scan(21_000_000_000, 1e9);
        mapper.take_patch();
        assert_eq!(mapper.insert(&far), Insertion::OutOfMap);
        assert_eq!(mapper.reply().values, before.values);
    }

    #[test]
    fn two_lidars_need_not_wait_for_one_another() {
        let mut mapper = Mapper::new(MapperConfig::default(), "m");
        let rear = |stamp| Scan {
            base_from_laser: Pose2::new(-0.1, 0.0, 3.0),
            ..scan(stamp, 0.0)
        };
        for (scan, inserted) in [
            (scan(5, 0.0), true),
            (rear(5), true),
            (rear(8), true),
            (scan(7, 0.0), true),
            (rear(8), false),
            (scan(6, 0.0), false),
        ] {
            let expected = if inserted {
                Insertion::Inserted
            } else {
                Insertion::OutOfOrder
            };
            assert_eq!(mapper.insert(&scan), expected, "{:?}", scan.stamp);
        }
        assert_eq!(mapper.info().stamp, Stamp(8));
    }

    #[test]
    fn a_robot_that_starts_anew_is_mapped_again() {
        let mut mapper = Mapper::new(MapperConfig::default(), "m");
        mapper.insert(&scan(100_000_000_000, 0.0));
        assert_eq!(mapper.insert(&scan(1, 0.5)), Insertion::Inserted);
        assert_eq!(mapper.insert(&scan(2, 0.5)), Insertion::Inserted);
    }

    #[test]
    fn the_way_is_kept_about_every_tenth_of_a_metre() {
        let mut mapper = Mapper::new(MapperConfig::default(), "m");
        for i in 0..200 {
            mapper.insert(&scan(i + 1, i as f64 * 0.01));
        }
        let count = mapper.trajectory().len();
        assert!((18..=21).contains(&count), "{count} points on 2 m");
    }

    #[test]
    fn a_stored_map_is_not_changed_until_it_is_resumed() {
        let mut first = Mapper::new(MapperConfig::default(), "kitchen");
        first.insert(&scan(1, 0.0));
        first.take_patch();
        let mut second = Mapper::with_stored(
            MapperConfig::default(),
            first.map().clone(),
            &first.grid(),
            first.trajectory().to_vec(),
            1,
        );
        assert!(second.is_stored() && second.info().map == *first.map());
        assert_eq!(second.insert(&scan(2, 1.0)), Insertion::Held);
        let class = |mapper: &Mapper| {
            mapper
                .grid()
                .values()
                .iter()
                .map(|value| Occupancy::of(*value))
                .collect::<Vec<_>>()
        };
        assert_eq!(class(&second), class(&first));
        assert_eq!(second.take_patch().unwrap().base_revision, 1);
        second.resume();
        assert_eq!(second.insert(&scan(3, 1.0)), Insertion::Inserted);
        second.reset("another");
        assert!(!second.is_stored() && second.info().spec.is_empty() && second.trajectory().is_empty());
    }
}
