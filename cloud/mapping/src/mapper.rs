//! Mapper. Builds a robot's map from its scans.
//!
//! The pure core of mapping: scans in, patches out.

use std::time::Duration;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{MapInfo, MapPatch, MapRef, MapReply, Scan};
use zenav_protocol::robot::Footprint;
use zenav_protocol::time::Stamp;

use crate::log_odds::{GridSnapshot, LogOddsGrid};
use crate::settings::MappingSettings;

/// What the mapper did with a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Insertion {
    /// The scan is in the map.
    Inserted,
    /// The map is held: no scan is inserted until it is resumed.
    Held,
    /// The scan is not newer than the newest one of its lidar in the map.
    OutOfOrder,
    /// The scan's geometry is out of bounds.
    NotSane,
    /// The scan was taken beyond the largest map, or every beam ends beyond it.
    OutOfMap,
}

/// A stamp this much (s) before the newest one is not late: the robot's clock restarted.
const RESTARTED_CLOCK: f64 = 10.0;

/// Most lidars whose scans are kept in order.
const MAX_LIDARS: usize = 16;

/// Most tiles of the patch that begins a frame: the limit of its key.
const MOST_TILES: usize = 15_000;

/// Most positions of a trajectory; beyond that every other one is dropped, and the step doubles.
const MAX_TRAJECTORY: usize = 100_000;

/// Builds the map of one robot.
///
/// ```
/// use zenav_mapping::{Insertion, Mapper, MappingSettings};
/// use zenav_protocol::messages::Scan;
/// use zenav_protocol::time::Stamp;
///
/// let scan = Scan {
///     stamp: Stamp::from_secs(0.1),
///     angle_min: -1.0,
///     angle_increment: 0.02,
///     range_min: 0.02,
///     range_max: 5.0,
///     ranges: vec![2.0; 100],
///     ..Scan::default()
/// };
/// let mut mapper = Mapper::new(MappingSettings::default(), "kitchen");
/// assert_eq!(mapper.insert(&scan), Insertion::Inserted);
/// // The patch brings a replica from revision 0, the unknown map, to revision 1.
/// let patch = mapper.take_patch().unwrap();
/// assert_eq!((patch.base_revision, patch.map.revision), (0, 1));
/// assert!(mapper.take_patch().is_none());
/// assert!(mapper.info().occupied > 0);
/// ```
#[derive(Clone, Debug)]
pub struct Mapper {
    settings: MappingSettings,
    footprint: Option<Footprint>,
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
    /// Whether the map's frame has changed, so that the next patch must carry all changes.
    is_moved: bool,
}

impl Mapper {
    /// A new map, all unknown. Every map must get a new id.
    #[must_use]
    pub fn new(settings: MappingSettings, map_id: impl Into<String>) -> Self {
        Self {
            grid: decaying(LogOddsGrid::new(settings.resolution, &settings.sensor_model), &settings),
            footprint: None,
            map: MapRef::new(map_id, 0),
            stamp: Stamp::ZERO,
            newest: Vec::new(),
            scans: 0,
            trajectory: Vec::new(),
            trajectory_step: settings.trajectory_step,
            stored: false,
            held: false,
            is_moved: false,
            settings,
        }
    }

    /// A stored map: it counts as complete, and is held until it is resumed. The first patches carry all of it.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_mapping::{Mapper, MappingSettings};
    /// use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
    /// use zenav_protocol::messages::MapRef;
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 20, height: 10 };
    /// let map = OccupancyGrid::filled(spec, Occupancy::FREE);
    /// let stored = MapRef::new("kitchen", 7);
    /// let mut mapper = Mapper::with_stored(MappingSettings::default(), stored, &map, Vec::new(), 100);
    /// assert!(mapper.is_held() && mapper.info().stored);
    /// assert_eq!(mapper.take_patch().unwrap().map.revision, 8);
    /// ```
    #[must_use]
    pub fn with_stored(
        settings: MappingSettings,
        map: MapRef,
        grid: &OccupancyGrid,
        trajectory: Vec<Point2<f64>>,
        scans: u64,
    ) -> Self {
        let log_odds = LogOddsGrid::from_occupancy(grid, &settings.sensor_model);
        Self {
            grid: decaying(log_odds, &settings),
            trajectory,
            scans,
            stored: true,
            held: true,
            map: map.clone(),
            ..Self::new(settings, map.id)
        }
    }

    /// A map that another mapper has drawn, from a replica and the last description of it. Scans are inserted, and the first patch carries
    /// all of it, so that no replica has a part of it only. The id must be new.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_mapping::{Mapper, MappingSettings};
    /// use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
    /// use zenav_protocol::messages::MapRef;
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 4096, height: 64 };
    /// let replica = OccupancyGrid::filled(spec, Occupancy::FREE);
    /// let map = MapRef { id: "kitchen-2".into(), revision: 0, frame: 3 };
    /// let mut mapper = Mapper::inheriting(MappingSettings::default(), map, &replica, None);
    /// assert!(!mapper.is_held() && !mapper.is_stored());
    /// let patch = mapper.take_patch().unwrap();
    /// assert_eq!((patch.base_revision, patch.map.frame, patch.tiles.len()), (0, 3, 64));
    /// assert!(!mapper.has_changes());
    /// ```
    #[must_use]
    pub fn inheriting(settings: MappingSettings, map: MapRef, replica: &OccupancyGrid, info: Option<&MapInfo>) -> Self {
        Self {
            stored: info.is_some_and(|info| info.stored),
            held: false,
            is_moved: true,
            ..Self::with_stored(settings, map, replica, Vec::new(), info.map_or(0, |info| info.scans))
        }
    }

    /// Sets the footprint under which cells are cleared.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_mapping::carmen::{CarmenReader, LOG_BEAMS};
    /// use zenav_mapping::{Mapper, MappingSettings};
    /// use zenav_protocol::grid::Occupancy;
    /// use zenav_protocol::robot::Footprint;
    ///
    /// # let log = "FLASER 3 1.0 1.5 1.0 0 0 0 0 0 0 1.0 host 1.0\n";
    /// # let scan = CarmenReader::new(log.as_bytes()).next().unwrap().unwrap();
    /// # let settings = MappingSettings { beams: LOG_BEAMS, ..MappingSettings::default() };
    /// // The lidar looks ahead only; behind it, 0.2 m away, stands the robot itself.
    /// let mut mapper = Mapper::new(settings, "kitchen").with_footprint(Footprint::Radius(0.3));
    /// mapper.insert(&scan);
    /// let behind = mapper.grid().at(Point2::new(-0.2, 0.1)).map(|value| Occupancy::of(*value));
    /// assert_eq!(behind, Some(Occupancy::Free));
    /// ```
    #[must_use]
    pub fn with_footprint(mut self, footprint: Footprint) -> Self {
        self.set_footprint(footprint);
        self
    }

    /// Inserts a scan and returns the outcome.
    ///
    /// ```
    /// use zenav_mapping::carmen::CarmenReader;
    /// use zenav_mapping::{Insertion, Mapper, MappingSettings};
    ///
    /// // The second scan was taken 0.1 s before the first one.
    /// let log = "FLASER 3 1.0 1.5 1.0 0 0 0 0 0 0 2.0 host 2.0
    /// FLASER 3 1.0 1.5 1.0 0 0 0 0 0 0 1.9 host 1.9\n";
    /// let scans: Vec<_> = CarmenReader::new(log.as_bytes()).collect::<Result<_, _>>()?;
    /// let mut mapper = Mapper::new(MappingSettings::default(), "kitchen");
    /// assert_eq!(mapper.insert(&scans[0]), Insertion::Inserted);
    /// assert_eq!(mapper.insert(&scans[1]), Insertion::OutOfOrder);
    /// # Ok::<(), zenav_mapping::carmen::CarmenError>(())
    /// ```
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
        let count = self
            .grid
            .insert(scan, &self.settings.beams, self.settings.mode, self.footprint.as_ref());
        if count.is_none_or(|count| count.inserted == 0 && count.left_out > 0) {
            return Insertion::OutOfMap;
        }
        self.note_order(scan);
        self.scans += 1;
        self.keep_trajectory((scan.map_from_odom * scan.odom_from_base).position());
        Insertion::Inserted
    }

    /// An empty mapper of the same map: the scans of this one are redrawn into it from better poses, then it [succeeds](Self::succeed) this
    /// one.
    #[must_use]
    pub fn redrawing(&self) -> Self {
        Self {
            settings: self.settings.clone(),
            footprint: self.footprint.clone(),
            grid: self.grid.unseen(),
            map: self.map.clone(),
            ..Self::new(self.settings.clone(), "")
        }
    }

    /// As [`Self::redrawing`], over what an earlier map shows.
    #[must_use]
    pub fn redrawing_over(&self, base: &Self) -> Self {
        Self {
            grid: base.grid.clone(),
            ..self.redrawing()
        }
    }

    /// Replaces the mapper from which it was made by [`Self::redrawing`]: the same map, possibly changed everywhere.
    #[must_use]
    pub fn succeed(mut self, old: &Self) -> Self {
        // Both cover the same ground to within centimetres; if that makes the map too large, the borders of the old one are dropped.
        self.grid.succeed(&old.grid);
        Self {
            stamp: self.stamp.max(old.stamp),
            newest: old.newest.clone(),
            scans: old.scans,
            stored: old.stored,
            held: old.held,
            map: old.map.clone(),
            footprint: old.footprint.clone(),
            ..self
        }
    }

    /// Whether a scan is newer than the last one of its lidar; the lidars of a robot scan independently.
    fn is_in_order(&self, scan: &Scan) -> bool {
        let last = self.newest.iter().find(|(mount, _)| *mount == scan.base_from_laser);
        last.is_none_or(|(_, stamp)| scan.stamp > *stamp || stamp.secs_since(scan.stamp) >= RESTARTED_CLOCK)
    }

    fn note_order(&mut self, scan: &Scan) {
        if self.stamp.secs_since(scan.stamp) >= RESTARTED_CLOCK || self.newest.len() >= MAX_LIDARS {
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

    /// Takes the changes since the last patch, as the next revision; `None` without any.
    pub fn take_patch(&mut self) -> Option<MapPatch> {
        // A new frame goes out in one patch, so that no replica mixes two frames.
        let is_moved = std::mem::take(&mut self.is_moved);
        let most = if is_moved {
            MOST_TILES
        } else {
            self.settings.patch_tiles.max(1)
        };
        let tiles = self.grid.take_dirty(most);
        // A new frame is published even if no cell has changed.
        if tiles.is_empty() && !(is_moved && self.map.revision > 0) {
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

    /// Sets the frame of the map's coordinates. The next patch carries all changes.
    pub fn set_frame(&mut self, frame: u64) {
        self.is_moved |= self.map.frame != frame;
        self.map.frame = frame;
    }

    /// Whether there are changes for another patch.
    #[must_use]
    pub fn has_changes(&self) -> bool {
        self.is_moved || self.grid.is_dirty()
    }

    /// Sets the robot's footprint, under which cells are cleared from now on.
    pub fn set_footprint(&mut self, footprint: Footprint) {
        self.footprint = Some(footprint);
    }

    /// Description of the map, at the revision of the last patch.
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

    /// The map at this moment. Cheap: the cells are shared until they change, and converted when the snapshot is read.
    ///
    /// ```
    /// # use zenav_mapping::carmen::{CarmenReader, LOG_BEAMS};
    /// use zenav_mapping::{Mapper, MappingSettings};
    ///
    /// # let log = "FLASER 3 1.0 1.5 1.0 0 0 0 0 0 0 1.0 host 1.0\n";
    /// # let scan = CarmenReader::new(log.as_bytes()).next().unwrap().unwrap();
    /// # let settings = MappingSettings { beams: LOG_BEAMS, ..MappingSettings::default() };
    /// let mut mapper = Mapper::new(settings, "kitchen");
    /// let before = mapper.snapshot();
    /// mapper.insert(&scan); // three beams, three returns
    /// assert_eq!((before.info.scans, before.info.occupied), (0, 0));
    /// assert_eq!((mapper.snapshot().info.scans, mapper.snapshot().info.occupied), (1, 3));
    /// ```
    #[must_use]
    pub fn snapshot(&self) -> MapSnapshot {
        MapSnapshot {
            info: self.info(),
            trajectory: self.trajectory.clone(),
            touched: self.grid.touched_cells(),
            grid: self.grid.snapshot(),
        }
    }

    /// The whole map as a message. It may already hold changes of the next patch, which is harmless: patches carry values, not differences.
    #[must_use]
    pub fn reply(&self) -> MapReply {
        self.snapshot().into_reply()
    }

    /// The map as ROS's occupancy values.
    #[must_use]
    pub fn grid(&self) -> OccupancyGrid {
        self.grid.to_occupancy()
    }

    /// Positions of the robot while the map was built, map frame, about every `trajectory_step`.
    #[must_use]
    pub fn trajectory(&self) -> &[Point2<f64>] {
        &self.trajectory
    }

    /// The map's id and revision.
    #[must_use]
    pub fn map(&self) -> &MapRef {
        &self.map
    }

    /// Starts a new map, all unknown, in the previous map's frame, and resumes inserting scans.
    ///
    /// ```
    /// # use zenav_mapping::carmen::CarmenReader;
    /// use zenav_mapping::{Mapper, MappingSettings};
    ///
    /// # let log = "FLASER 3 1.0 1.5 1.0 0 0 0 0 0 0 1.0 host 1.0\n";
    /// # let scan = CarmenReader::new(log.as_bytes()).next().unwrap().unwrap();
    /// let mut mapper = Mapper::new(MappingSettings::default(), "kitchen");
    /// mapper.insert(&scan);
    /// mapper.reset("kitchen-2");
    /// assert_eq!((&*mapper.map().id, mapper.map().revision, mapper.info().scans), ("kitchen-2", 0, 0));
    /// ```
    pub fn reset(&mut self, map_id: impl Into<String>) {
        let (footprint, frame) = (self.footprint.take(), self.map.frame);
        *self = Self::new(self.settings.clone(), map_id);
        (self.footprint, self.map.frame) = (footprint, frame);
    }

    /// Replaces the map by a stored one, as [`with_stored`](Self::with_stored). The id must be new.
    pub fn load(&mut self, map: MapRef, grid: &OccupancyGrid, trajectory: Vec<Point2<f64>>, scans: u64) {
        let (footprint, frame) = (self.footprint.take(), self.map.frame);
        *self = Self::with_stored(self.settings.clone(), map, grid, trajectory, scans);
        (self.footprint, self.map.frame) = (footprint, frame);
    }

    /// Adds what the robot had touched in a stored map ([`MapSnapshot::touched`]): beams do not clear it.
    pub fn restore_touched(&mut self, cells: &[[u32; 2]]) {
        self.grid.restore_touched(cells);
    }

    /// Decays every transient obstacle now.
    pub fn decay_now(&mut self) {
        self.grid.decay_now();
    }

    /// Holds the map: no scan is inserted until [`resume`](Self::resume).
    ///
    /// ```
    /// # use zenav_mapping::carmen::CarmenReader;
    /// use zenav_mapping::{Insertion, Mapper, MappingSettings};
    ///
    /// # let log = "FLASER 3 1.0 1.5 1.0 0 0 0 0 0 0 1.0 host 1.0\n";
    /// # let scan = CarmenReader::new(log.as_bytes()).next().unwrap().unwrap();
    /// let mut mapper = Mapper::new(MappingSettings::default(), "kitchen");
    /// mapper.hold();
    /// assert_eq!(mapper.insert(&scan), Insertion::Held);
    /// mapper.resume();
    /// assert_eq!(mapper.insert(&scan), Insertion::Inserted);
    /// ```
    pub fn hold(&mut self) {
        self.held = true;
    }

    /// Resumes a held map: scans are inserted again.
    pub fn resume(&mut self) {
        self.held = false;
    }

    /// Whether the map is held.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.held
    }

    /// Marks the map as complete: it was stored.
    pub fn mark_stored(&mut self) {
        self.stored = true;
    }

    /// Whether the map is complete: loaded, or stored.
    #[must_use]
    pub fn is_stored(&self) -> bool {
        self.stored
    }
}

/// Adds decay to a grid, as set.
fn decaying(grid: LogOddsGrid, settings: &MappingSettings) -> LogOddsGrid {
    match Duration::try_from_secs_f64(settings.decay_after) {
        Ok(after) if !after.is_zero() => grid.with_decay(after),
        _ => grid,
    }
}

/// A map at one moment.
#[derive(Clone, Debug)]
pub struct MapSnapshot {
    /// Description of the map.
    pub info: MapInfo,
    /// Positions of the robot while the map was built, map frame.
    pub trajectory: Vec<Point2<f64>>,
    /// The cells that the robot has touched though no beam shows an obstacle there: column and row.
    pub touched: Vec<[u32; 2]>,
    grid: GridSnapshot,
}

impl MapSnapshot {
    /// The map as ROS's occupancy values. Cost: every cell.
    #[must_use]
    pub fn grid(&self) -> OccupancyGrid {
        self.grid.to_occupancy()
    }

    /// The whole map as a message. Cost: every cell.
    #[must_use]
    pub fn into_reply(self) -> MapReply {
        MapReply {
            values: self.grid().into_values(),
            info: self.info,
            trajectory: self.trajectory,
            stored: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::grid::Occupancy;

    use super::*;

    fn scan(stamp: u64, x: f64) -> Scan {
        Scan {
            base_from_laser: Pose2::new(0.1, 0.0, 0.0),
            ..zenav_fixtures::scan(stamp, Pose2::new(x, 0.0, 0.0), vec![2.0; 100])
        }
    }

    #[test]
    fn every_patch_is_the_next_revision_and_says_what_it_applies_to() {
        let mut mapper = Mapper::new(MappingSettings::default(), "first");
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
    fn late_repeated_and_malformed_scans_change_nothing() {
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        mapper.insert(&scan(20_000_000_000, 0.0));
        let before = mapper.reply();
        assert_eq!(mapper.insert(&scan(20_000_000_000, 1.0)), Insertion::OutOfOrder);
        assert_eq!(mapper.insert(&scan(19_000_000_000, 1.0)), Insertion::OutOfOrder);
        let mut malformed = scan(21_000_000_000, 1.0);
        malformed.odom_from_base.x = f64::NAN;
        assert_eq!(mapper.insert(&malformed), Insertion::NotSane);
        let far = scan(21_000_000_000, 1e9);
        mapper.take_patch();
        assert_eq!(mapper.insert(&far), Insertion::OutOfMap);
        assert_eq!(mapper.reply().values, before.values);
    }

    #[test]
    fn two_lidars_need_not_wait_for_one_another() {
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        let rear = |stamp| Scan {
            base_from_laser: Pose2::new(-0.1, 0.0, 3.0),
            ..scan(stamp, 0.0)
        };
        for (scan, is_inserted) in [
            (scan(5, 0.0), true),
            (rear(5), true),
            (rear(8), true),
            (scan(7, 0.0), true),
            (rear(8), false),
            (scan(6, 0.0), false),
        ] {
            assert_eq!(
                mapper.insert(&scan) == Insertion::Inserted,
                is_inserted,
                "{:?}",
                scan.stamp
            );
        }
        assert_eq!(mapper.info().stamp, Stamp(8));
    }

    #[test]
    fn after_a_restart_of_the_robot_s_clock_scans_are_inserted_again() {
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        mapper.insert(&scan(100_000_000_000, 0.0));
        assert_eq!(mapper.insert(&scan(1, 0.5)), Insertion::Inserted);
        assert_eq!(mapper.insert(&scan(2, 0.5)), Insertion::Inserted);
    }

    #[test]
    fn the_trajectory_has_a_position_about_every_tenth_of_a_metre() {
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        for i in 0..200 {
            mapper.insert(&scan(i + 1, i as f64 * 0.01));
        }
        let count = mapper.trajectory().len();
        assert!((18..=21).contains(&count), "{count} points on 2 m");
    }

    #[test]
    fn a_snapshot_does_not_change_while_mapping_goes_on() {
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        mapper.insert(&scan(1, 0.0));
        let (snapshot, before) = (mapper.snapshot(), mapper.reply());
        mapper.insert(&scan(2, 1.0));
        assert_ne!(mapper.reply().values, before.values);
        assert_eq!(snapshot.into_reply(), before);
    }

    #[test]
    fn a_stored_map_is_not_changed_until_it_is_resumed() {
        let mut first = Mapper::new(MappingSettings::default(), "kitchen");
        first.insert(&scan(1, 0.0));
        first.take_patch();
        let mut second = Mapper::with_stored(
            MappingSettings::default(),
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

    #[test]
    fn what_was_touched_in_a_stored_map_is_not_cleared_by_beams() {
        let settings = MappingSettings::default();
        let mut first = Mapper::new(settings.clone(), "kitchen");
        let pane = [[1.02, -0.2, 1.02, 0.2]; 2];
        for stamp in 1..20 {
            first.insert(&Scan {
                touched: vec![pane],
                ..scan(stamp, -3.0)
            });
        }
        let stored = first.snapshot();
        assert!((16..=18).contains(&stored.touched.len()), "{:?}", stored.touched);
        for (touched, stays) in [(&stored.touched[..], true), (&stored.touched[..0], false)] {
            let mut second = Mapper::with_stored(settings.clone(), first.map().clone(), &stored.grid(), Vec::new(), 1);
            second.restore_touched(touched);
            // A file may be of anybody.
            second.restore_touched(&[[u32::MAX, 0], [0, u32::MAX]]);
            assert_eq!(second.snapshot().touched, touched);
            second.resume();
            for stamp in 1..40 {
                assert_eq!(second.insert(&scan(stamp, -3.0)), Insertion::Inserted);
            }
            let there = second
                .grid()
                .at(Point2::new(-1.985, 0.12))
                .map(|value| Occupancy::of(*value));
            assert_eq!(there == Some(Occupancy::Occupied), stays, "{there:?}");
        }
    }
}
