//! What is known of the robot's map? A copy kept by patches, and where the robot may be by it.

use std::sync::Arc;

use nalgebra::Point2;
use zenav_protocol::grid::{GridSpec, Occupancy};
use zenav_protocol::messages::{MapAction, MapInfo, MapPatch, MapRef, MapRequest};
use zenav_protocol::robot::Footprint;
use zenav_protocol::time::Stamp;

use super::context::Asks;
use super::io::{Answer, Ask, Ticket};
use zenav_protocol::map_replica::{MapReplica, PatchResult};
use zenav_protocol::padding::Extent;
use zenav_space::{ConfigurationSpace, SpaceCache, UnknownPolicy, Zones};

/// Time between two asks for the whole map, s.
const RETRY: f64 = 1.0;
/// For so long patches are waited for before the whole is asked for, s.
const PATIENCE: f64 = 0.5;

/// The robot's map as the mission knows it.
#[derive(Debug, Default)]
pub struct RobotMap {
    info: Option<MapInfo>,
    mirror: MapReplica,
    /// Since when the copy has been behind.
    behind: Option<Stamp>,
    asking: Option<Ticket>,
    next_ask: Stamp,
    spaces: SpaceCache,
}

impl RobotMap {
    /// Nothing is known yet of a map with these zones.
    #[must_use]
    pub fn new(zones: Arc<Zones>) -> Self {
        Self {
            spaces: SpaceCache::new(zones),
            ..Self::default()
        }
    }

    /// Takes in what mapping says.
    pub fn observe(&mut self, now: Stamp, info: Option<MapInfo>, patches: &[MapPatch]) {
        let mut gap = false;
        for patch in patches {
            // A gap may be closed by a later patch that starts from an unknown map.
            gap = match self.mirror.apply(patch) {
                PatchResult::Applied => false,
                PatchResult::Old => gap,
                PatchResult::Gap => true,
            };
        }
        if info.is_some() {
            self.info = info;
        }
        let behind = gap || self.info.as_ref().is_some_and(|info| !self.mirror.holds(&info.map));
        self.behind = if behind { Some(self.behind.unwrap_or(now)) } else { None };
    }

    /// Asks for the whole map where patches are missing.
    pub fn step(&mut self, now: Stamp, asks: &mut Asks) {
        if let Some(answer) = self.asking.and_then(|ticket| asks.take(ticket)) {
            self.asking = None;
            self.next_ask = now.plus_secs(RETRY);
            if let Ok(Answer::Map(reply)) = answer
                && self.mirror.replace(&reply)
            {
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

    /// Its description.
    #[must_use]
    pub fn info(&self) -> Option<&MapInfo> {
        self.info.as_ref()
    }

    /// Where the map itself lies; `None` while there is no copy.
    #[must_use]
    pub fn spec(&self) -> Option<GridSpec> {
        self.mirror.has_map().then(|| *self.mirror.grid().spec())
    }

    /// The copy's map and revision; `None` while there is no copy.
    #[must_use]
    pub fn newest(&self) -> Option<MapRef> {
        self.mirror.has_map().then(|| self.mirror.map().clone())
    }

    /// Where the robot may be as far as an outlook goes, and a copy of the map that reaches there; `None` without a map.
    pub fn space_reaching(
        &mut self,
        footprint: &Footprint,
        outlook: &Extent,
    ) -> Option<(Arc<ConfigurationSpace>, MapReplica)> {
        if !self.mirror.has_map() || self.mirror.grid().spec().is_empty() {
            return None;
        }
        let mut mirror = self.mirror.clone();
        mirror.reach(outlook);
        Some((self.spaces.get(&mirror, footprint, UnknownPolicy::Free), mirror))
    }

    /// What the map has at a point; `None` without a map. Outside of it nothing is known.
    #[must_use]
    pub fn occupancy(&self, point: Point2<f64>) -> Option<Occupancy> {
        let grid = self.mirror.has_map().then(|| self.mirror.grid())?;
        let value = grid.spec().cell_at(point).and_then(|cell| grid.get(cell));
        Some(value.map_or(Occupancy::Unknown, |value| Occupancy::of(*value)))
    }

    /// Where the robot may be; unknown cells do not stand in its way here. `None` without a map.
    pub fn space(&mut self, footprint: &Footprint) -> Option<Arc<ConfigurationSpace>> {
        let mapped = self.mirror.has_map() && !self.mirror.grid().spec().is_empty();
        mapped.then(|| self.spaces.get(&self.mirror, footprint, UnknownPolicy::Free))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
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
        let mut book = RobotMap::default();
        let footprint = Footprint::Radius(0.3);
        for step in 1..30 {
            mapper.insert(&scan(step, 0.4 * step as f64));
            let patches: Vec<MapPatch> = std::iter::from_fn(|| mapper.take_patch()).collect();
            book.observe(Stamp(step), Some(mapper.info()), &patches);
            if step % 3 == 0 {
                let anew = ConfigurationSpace::new(&mapper.grid(), &footprint, UnknownPolicy::Free, 0.0);
                let kept = book.space(&footprint).unwrap();
                assert_eq!(
                    (kept.spec(), kept.free(), kept.obstacles()),
                    (anew.spec(), anew.free(), anew.obstacles())
                );
            }
        }
        let larger = Footprint::Radius(0.6);
        assert!(book.space(&larger).unwrap().clearance(Point2::origin()) >= 0.0);
        assert_eq!(book.space(&larger).unwrap().footprint(), &larger);
    }

    #[test]
    fn a_copy_with_a_gap_asks_for_the_whole() {
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        let (mut book, mut asks) = (RobotMap::default(), Asks::new(1));
        mapper.insert(&scan(1, 0.0));
        while mapper.take_patch().is_some() {}
        book.observe(Stamp::from_secs(1.0), Some(mapper.info()), &[]);
        book.step(Stamp::from_secs(1.0), &mut asks);
        assert!(asks.take_new().is_empty(), "a patch may still be on its way");
        book.observe(Stamp::from_secs(2.0), None, &[]);
        book.step(Stamp::from_secs(2.0), &mut asks);
        let (ticket, _) = asks.take_new().pop().unwrap();
        asks.answer(ticket, Ok(Answer::Map(Box::new(mapper.reply()))));
        book.step(Stamp::from_secs(2.1), &mut asks);
        assert_eq!(book.newest().as_ref(), Some(mapper.map()));
    }
}
