//! Robot map. What is known about the robot's map? A replica kept up to date by patches, and its configuration space.

use std::sync::Arc;

use nalgebra::Point2;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy};
use zenav_protocol::messages::{MapAction, MapInfo, MapPatch, MapRef, MapRequest, MappingLeader};
use zenav_protocol::robot::Footprint;
use zenav_protocol::time::Stamp;

use super::asks::Asks;
use super::io::{Answer, Ask, Ticket};
use super::transient::{TransientCell, Transients};
use zenav_protocol::map_replica::{MapReplica, PatchResult};
use zenav_protocol::padding::Extent;
use zenav_space::{ConfigurationSpace, Fit, SpaceCache, UnknownPolicy, Zones};

/// Time between two requests for the whole map, s.
const RETRY: f64 = 1.0;
/// The same while mapping answers but is silent, s.
const SILENT: f64 = 5.0;
/// Time to wait for a missing patch before the whole map is requested, s.
const PATIENCE: f64 = 0.5;

/// The robot's map as the mission knows it.
#[derive(Debug, Default)]
pub struct RobotMap {
    info: Option<MapInfo>,
    replica: MapReplica,
    /// The map that the leading mapping service writes, by its last beat.
    led: MapRef,
    /// Whether nothing that mapping publishes comes.
    is_silent: bool,
    /// Time since which the replica has been behind.
    behind: Option<Stamp>,
    asking: Option<Ticket>,
    next_ask: Stamp,
    /// Time since which there has been no mapper.
    mapper_gone: Option<Stamp>,
    spaces: SpaceCache,
    transients: Transients,
    /// Frame of the map in which the transients were observed.
    frame: u64,
    /// Number of changes of the zones.
    zone_changes: u64,
}

impl RobotMap {
    /// An empty map with these zones.
    #[must_use]
    pub fn new(zones: Arc<Zones>) -> Self {
        Self {
            spaces: SpaceCache::new(zones),
            ..Self::default()
        }
    }

    /// Sets the zones of the map.
    pub(crate) fn set_zones(&mut self, zones: Arc<Zones>) {
        self.spaces.set_zones(zones);
        self.zone_changes += 1;
    }

    /// Number of changes of the zones since the start.
    #[must_use]
    pub fn zone_changes(&self) -> u64 {
        self.zone_changes
    }

    /// Observes what the mapper has published.
    pub fn observe(&mut self, now: Stamp, info: Option<MapInfo>, patches: &[MapPatch]) {
        let mut gap = false;
        for patch in patches {
            // A gap may be closed by a later patch that starts from an unknown map.
            gap = match self.replica.apply(patch) {
                PatchResult::Applied if patch.map.frame != self.frame => {
                    // The map has moved as a whole: cells that were free refer to other places now.
                    self.frame = patch.map.frame;
                    self.transients = Transients::default();
                    self.transients.observe_all(now, &patch.map.id, self.replica.grid());
                    false
                }
                PatchResult::Applied => {
                    self.transients.observe(now, patch);
                    false
                }
                PatchResult::Old => gap,
                PatchResult::Gap => true,
            };
        }
        if info.is_some() {
            self.info = info;
        }
        let is_old = self.info.as_ref().is_some_and(|info| !self.replica.holds(&info.map));
        // Nothing tells that there is a map, or a newer one. Between two routers Zenoh 1.10 can lose subscriptions for good while one is
        // replaced (docs/faults.md).
        let is_unheard = self.is_silent && self.mapper_gone.is_none();
        // A leader without a map names none. Two leaders may beat at once: whose map this is, the description tells.
        let is_own = self.replica.has_map() && self.replica.map().id != self.led.id;
        let is_untold = self.led.revision > 0 && !is_own && !self.replica.holds(&self.led);
        let behind = gap || is_old || is_unheard || is_untold;
        self.behind = if behind { Some(self.behind.unwrap_or(now)) } else { None };
    }

    /// Observes the leading mapping service's beat, if one came, and whether mapping is silent: nothing that it publishes has come for so long
    /// that its beats should have.
    pub fn observe_leader(&mut self, beat: Option<MappingLeader>, is_silent: bool) {
        if let Some(beat) = beat {
            self.led = beat.map;
        }
        self.is_silent = is_silent;
    }

    /// Observes whether a mapper is alive.
    pub fn observe_mapper(&mut self, now: Stamp, alive: bool) {
        self.mapper_gone = match alive {
            true => None,
            false => Some(self.mapper_gone.unwrap_or(now)),
        };
    }

    /// Why the replica cannot be used to check for free space: it is empty, or no mapper has updated it for longer than `patience`, s.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::grid::{GridSpec, Occupancy};
    /// # use zenav_protocol::messages::{MapPatch, MapRef, TILE, Tile};
    /// use zenav_mission::RobotMap;
    /// use zenav_protocol::time::Stamp;
    ///
    /// # let patch = MapPatch {
    /// #     stamp: Stamp(1),
    /// #     map: MapRef::new("kitchen", 1),
    /// #     base_revision: 0,
    /// #     spec: GridSpec { origin: Point2::origin(), resolution: 0.05, width: TILE, height: TILE },
    /// #     tiles: vec![Tile { x: 0, y: 0, values: vec![Occupancy::FREE; (TILE * TILE) as usize] }],
    /// # };
    /// let (mut map, at) = (RobotMap::default(), Stamp::from_secs);
    /// assert_eq!(map.unusable(at(1.0), 10.0).as_deref(), Some("no map has come yet"));
    /// map.observe(at(1.0), None, &[patch]);
    /// map.observe_mapper(at(5.0), false);
    /// assert_eq!(map.unusable(at(14.0), 10.0), None);
    /// assert_eq!(map.unusable(at(17.0), 10.0).as_deref(), Some("the mapper has been gone for 12 s"));
    /// ```
    #[must_use]
    pub fn unusable(&self, now: Stamp, patience: f64) -> Option<String> {
        if self.spec().is_none_or(|spec| spec.is_empty()) {
            return Some("no map has come yet".to_owned());
        }
        let gone = self.mapper_gone.map(|since| now.secs_since(since))?;
        (gone > patience).then(|| format!("the mapper has been gone for {gone:.0} s"))
    }

    /// Requests the whole map if patches are missing.
    pub(crate) fn step(&mut self, now: Stamp, asks: &mut Asks) {
        if let Some(answer) = self.asking.and_then(|ticket| asks.take(ticket)) {
            self.asking = None;
            let is_unheard = self.is_silent && answer.is_ok();
            self.next_ask = now.plus_secs(if is_unheard { SILENT } else { RETRY });
            if let Ok(Answer::Map(reply)) = answer
                && self.replica.replace(&reply)
            {
                if self.replica.map().frame != self.frame {
                    self.frame = self.replica.map().frame;
                    self.transients = Transients::default();
                }
                let (map, grid) = (&self.replica.map().id, self.replica.grid());
                self.transients.observe_all(now, map, grid);
                self.behind = None;
                self.info = Some(reply.info);
            }
        }
        let due = self.behind.is_some_and(|since| now.secs_since(since) >= PATIENCE);
        if due && self.asking.is_none() && now >= self.next_ask {
            self.asking = Some(asks.ask(Ask::Map(MapRequest {
                action: MapAction::Get,
                ..MapRequest::default()
            })));
        }
    }

    /// The map's description.
    #[must_use]
    pub fn info(&self) -> Option<&MapInfo> {
        self.info.as_ref()
    }

    /// The map's grid; `None` while there is no replica.
    #[must_use]
    pub fn spec(&self) -> Option<GridSpec> {
        self.replica.has_map().then(|| *self.replica.grid().spec())
    }

    /// The replica's map id and revision; `None` while there is no replica.
    #[must_use]
    pub fn newest(&self) -> Option<MapRef> {
        self.replica.has_map().then(|| self.replica.map().clone())
    }

    /// The replica's revision; zero while there is no replica.
    #[must_use]
    pub fn revision(&self) -> u64 {
        if self.replica.has_map() {
            self.replica.map().revision
        } else {
            0
        }
    }

    /// The configuration space padded to an extent, and the replica with the same padding; `None` without a map.
    pub(crate) fn space_reaching(
        &mut self,
        footprint: &Footprint,
        extent: &Extent,
    ) -> Option<(Arc<ConfigurationSpace>, MapReplica)> {
        if !self.replica.has_map() || self.replica.grid().spec().is_empty() {
            return None;
        }
        let mut replica = self.replica.clone();
        replica.reach(extent);
        Some((
            self.spaces.get(&replica, footprint, UnknownPolicy::Free, Fit::Tight),
            replica,
        ))
    }

    /// Occupancy at a point, `Unknown` outside the map; `None` without a map.
    #[must_use]
    pub fn occupancy(&self, point: Point2<f64>) -> Option<Occupancy> {
        let grid = self.replica.has_map().then(|| self.replica.grid())?;
        let value = grid.spec().cell_at(point).and_then(|cell| grid.get(cell));
        Some(value.map_or(Occupancy::Unknown, |value| Occupancy::of(*value)))
    }

    /// Transient cells near these places; none without a map.
    #[must_use]
    pub(crate) fn transient(&self, near: &[Point2<f64>]) -> Vec<TransientCell> {
        let grows = self.info.as_ref().is_some_and(|info| !info.stored);
        if self.spec().is_none_or(|spec| spec.is_empty()) {
            return Vec::new();
        }
        self.transients.cells(self.replica.grid(), grows, near)
    }

    /// Notes that an obstacle of these cells is in the way; returns since when it has been, `since` at the latest.
    pub(crate) fn notice(&mut self, cells: &[Point2<f64>], since: Stamp) -> Stamp {
        self.transients.notice(self.replica.grid(), cells, since)
    }

    /// Whether a cell within a distance (m) of a place is occupied.
    #[must_use]
    pub(crate) fn is_occupied_within(&self, place: Point2<f64>, within: f64) -> bool {
        self.occupied_near(place, within)
            .any(|center| (center - place).norm() <= within)
    }

    /// Occupied cells within a distance (m) of a place that are surrounded by no others up to twice that distance: one or two beam returns
    /// far away, not a wall. None in a stored map.
    #[must_use]
    pub(crate) fn lone(&self, place: Point2<f64>, within: f64) -> Vec<TransientCell> {
        if self.info.as_ref().is_none_or(|info| info.stored) {
            return Vec::new();
        }
        let centers: Vec<Point2<f64>> = self.occupied_near(place, 2.0 * within).collect();
        let is_near = |center: &Point2<f64>| (center - place).norm() <= within;
        if !centers
            .iter()
            .all(|center| is_near(center) || (center - place).norm() > 2.0 * within)
        {
            return Vec::new();
        }
        let near = centers.into_iter().filter(is_near);
        near.map(|center| TransientCell { center, since: None }).collect()
    }

    /// Centres of the occupied cells of a square around a place, `reach` (m) to each side.
    fn occupied_near(&self, place: Point2<f64>, reach: f64) -> impl Iterator<Item = Point2<f64>> {
        let grid = self.replica.grid();
        let spec = grid.spec();
        let reach = (reach / spec.resolution).ceil() as u32;
        let cells = spec.cell_at(place).into_iter().flat_map(move |center| {
            let rows = center.y.saturating_sub(reach)..=center.y.saturating_add(reach);
            rows.flat_map(move |y| {
                let columns = center.x.saturating_sub(reach)..=center.x.saturating_add(reach);
                columns.map(move |x| Cell { x, y })
            })
        });
        let occupied = cells.filter(|cell| {
            grid.get(*cell)
                .is_some_and(|value| Occupancy::of(*value) == Occupancy::Occupied)
        });
        occupied.map(|cell| spec.center(cell))
    }

    /// The configuration space of a (padded) replica of this map, with the cells at these points cleared.
    #[must_use]
    pub(crate) fn space_without(
        &mut self,
        map: &MapReplica,
        footprint: &Footprint,
        points: &[Point2<f64>],
    ) -> ConfigurationSpace {
        self.spaces.cleared(map, footprint, UnknownPolicy::Free, points)
    }

    /// The configuration space, with unknown cells free; `None` without a map.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::grid::{GridSpec, Occupancy};
    /// # use zenav_protocol::messages::{MapPatch, MapRef, TILE, Tile};
    /// # use zenav_protocol::time::Stamp;
    /// use zenav_mission::RobotMap;
    /// use zenav_protocol::robot::Footprint;
    ///
    /// # let mut values = vec![Occupancy::FREE; (TILE * TILE) as usize];
    /// # values[32 * TILE as usize + 32] = Occupancy::OCCUPIED;
    /// # let patch = MapPatch {
    /// #     stamp: Stamp(1),
    /// #     map: MapRef::new("kitchen", 1),
    /// #     base_revision: 0,
    /// #     spec: GridSpec { origin: Point2::origin(), resolution: 0.05, width: TILE, height: TILE },
    /// #     tiles: vec![Tile { x: 0, y: 0, values }],
    /// # };
    /// let mut map = RobotMap::default();
    /// assert!(map.space(&Footprint::Radius(0.3)).is_none(), "no map has come yet");
    /// map.observe(Stamp::from_secs(1.0), None, &[patch]); // one occupied cell, from (1.6, 1.6) to (1.65, 1.65)
    /// let space = map.space(&Footprint::Radius(0.3)).unwrap();
    /// assert!((space.clearance(Point2::new(1.2, 1.62)) - 0.4).abs() < 1e-9);
    /// ```
    pub fn space(&mut self, footprint: &Footprint) -> Option<Arc<ConfigurationSpace>> {
        let mapped = self.replica.has_map() && !self.replica.grid().spec().is_empty();
        mapped.then(|| {
            self.spaces
                .get(&self.replica, footprint, UnknownPolicy::Free, Fit::Tight)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::messages::Scan;

    use zenav_mapping::{Mapper, MappingSettings};

    fn scan(stamp: u64, x: f64) -> Scan {
        let ranges = (0..120).map(|beam| 1.0 + 0.03 * beam as f32).collect();
        zenav_fixtures::scan(stamp, Pose2::new(x, 0.3 * x, 0.0), ranges)
    }

    #[test]
    fn a_space_kept_by_patches_is_that_of_the_map() {
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        let mut map = RobotMap::default();
        let footprint = Footprint::Radius(0.3);
        for step in 1..30 {
            mapper.insert(&scan(step, 0.4 * step as f64));
            let patches: Vec<MapPatch> = std::iter::from_fn(|| mapper.take_patch()).collect();
            map.observe(Stamp(step), Some(mapper.info()), &patches);
            if step % 3 == 0 {
                let kept = map.space(&footprint).unwrap();
                let anew = ConfigurationSpace::new(&mapper.grid(), kept.footprint(), UnknownPolicy::Free, 0.0);
                assert_eq!(
                    (kept.spec(), kept.free(), kept.obstacles()),
                    (anew.spec(), anew.free(), anew.obstacles())
                );
            }
        }
        let larger = Footprint::Radius(0.6);
        assert!(map.space(&larger).unwrap().clearance(Point2::origin()) >= 0.0);
        assert!(map.space(&larger).unwrap().radius() > 0.55);
    }

    #[test]
    fn what_a_beam_or_two_met_is_alone_and_a_piece_of_a_wall_is_not() {
        for (beams, alone) in [(60..62, true), (40..80, false)] {
            let mut mapper = Mapper::new(MappingSettings::default(), "m");
            let mut map = RobotMap::default();
            let mut ranges = vec![f32::INFINITY; 120];
            ranges[beams].fill(4.0);
            let mut met = Point2::origin();
            for step in 1..6 {
                let scan = zenav_fixtures::scan(step, Pose2::IDENTITY, ranges.clone());
                let angle = scan.angle(60);
                met = scan
                    .map_from_laser()
                    .transform_point(Point2::new(4.0 * angle.cos(), 4.0 * angle.sin()));
                mapper.insert(&scan);
                let patches: Vec<MapPatch> = std::iter::from_fn(|| mapper.take_patch()).collect();
                map.observe(Stamp(step), Some(mapper.info()), &patches);
            }
            assert_eq!(!map.lone(met, 0.3).is_empty(), alone);
        }
    }

    #[test]
    fn a_replica_without_a_mapper_goes_stale() {
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        let mut map = RobotMap::default();
        let at = Stamp::from_secs;
        assert_eq!(map.unusable(at(1.0), 10.0).as_deref(), Some("no map has come yet"));
        mapper.insert(&scan(1, 0.0));
        let patches: Vec<MapPatch> = std::iter::from_fn(|| mapper.take_patch()).collect();
        map.observe(at(1.0), Some(mapper.info()), &patches);
        assert_eq!(
            map.unusable(at(100.0), 10.0),
            None,
            "a mapper that has nothing new is silent"
        );
        map.observe_mapper(at(100.0), false);
        map.observe_mapper(at(105.0), false);
        assert_eq!(map.unusable(at(110.0), 10.0), None);
        assert!(map.unusable(at(110.5), 10.0).is_some());
        map.observe_mapper(at(111.0), true);
        assert_eq!(map.unusable(at(111.0), 10.0), None);
    }

    #[test]
    fn a_replica_with_a_gap_and_one_whose_mapping_is_silent_request_the_whole_map() {
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        mapper.insert(&scan(1, 0.0));
        while mapper.take_patch().is_some() {}
        for is_silent in [false, true] {
            let (mut map, mut asks) = (RobotMap::default(), Asks::new(1));
            map.observe_leader(None, is_silent);
            let told = (!is_silent).then(|| mapper.info());
            map.observe(Stamp::from_secs(1.0), told, &[]);
            map.step(Stamp::from_secs(1.0), &mut asks);
            assert!(asks.take_new().is_empty(), "a patch may still be on its way");
            map.observe(Stamp::from_secs(2.0), None, &[]);
            map.step(Stamp::from_secs(2.0), &mut asks);
            let (ticket, _) = asks.take_new().pop().unwrap();
            asks.answer(ticket, Ok(Answer::Map(Box::new(mapper.reply()))));
            map.step(Stamp::from_secs(2.1), &mut asks);
            assert_eq!(map.newest().as_ref(), Some(mapper.map()));
            // Later changes would not be heard either.
            for (secs, asks_again) in [(6.0, false), (7.2, is_silent)] {
                map.observe(Stamp::from_secs(secs), None, &[]);
                map.step(Stamp::from_secs(secs), &mut asks);
                assert_eq!(!asks.take_new().is_empty(), asks_again, "{secs} s, silent: {is_silent}");
            }
        }
    }

    #[test]
    fn a_map_that_only_the_leader_s_beats_name_is_requested() {
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        mapper.insert(&scan(1, 0.0));
        while mapper.take_patch().is_some() {}
        let beat = |map: &MapRef| MappingLeader {
            map: map.clone(),
            ..MappingLeader::default()
        };
        let (mut map, mut asks) = (RobotMap::default(), Asks::new(1));
        for (secs, is_due) in [(1.0, false), (2.0, true)] {
            map.observe_leader(Some(beat(mapper.map())), false);
            map.observe(Stamp::from_secs(secs), None, &[]);
            map.step(Stamp::from_secs(secs), &mut asks);
            let asked = asks.take_new().pop();
            assert_eq!(asked.is_some(), is_due, "{secs} s");
            if let Some((ticket, _)) = asked {
                asks.answer(ticket, Ok(Answer::Map(Box::new(mapper.reply()))));
            }
        }
        for secs in [2.1, 9.0] {
            map.observe_leader(Some(beat(&MapRef::new("of another leader", 7))), false);
            map.step(Stamp::from_secs(secs), &mut asks);
            map.observe(Stamp::from_secs(secs), None, &[]);
        }
        assert_eq!(map.newest().as_ref(), Some(mapper.map()));
        assert!(asks.take_new().is_empty(), "it has the map");
    }

    #[test]
    fn mapping_that_is_gone_is_not_asked_for_its_silence() {
        let (mut map, mut asks) = (RobotMap::default(), Asks::new(1));
        map.observe_leader(None, true);
        map.observe_mapper(Stamp::from_secs(0.5), false);
        for secs in [1.0, 3.0] {
            map.observe(Stamp::from_secs(secs), None, &[]);
            map.step(Stamp::from_secs(secs), &mut asks);
        }
        assert!(asks.take_new().is_empty());
        map.observe_mapper(Stamp::from_secs(3.0), true);
        for secs in [3.0, 4.0] {
            map.observe(Stamp::from_secs(secs), None, &[]);
            map.step(Stamp::from_secs(secs), &mut asks);
        }
        assert_eq!(asks.take_new().len(), 1);
    }
}
