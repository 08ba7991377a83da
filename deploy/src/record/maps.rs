//! Maps. The maps of a run at a moment: replicas, updated with the run's own patches.

use std::collections::BTreeMap;

use zenav_mapping::CellCounts;
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::map_replica::{MapReplica, PatchResult};
use zenav_protocol::messages::{MapInfo, MapRef, MapReply};
use zenav_protocol::topics;

use super::format::{Kind, Sample};

/// The map of each robot.
#[derive(Debug, Default)]
pub struct Maps {
    robots: BTreeMap<String, RobotMap>,
}

#[derive(Debug, Default)]
struct RobotMap {
    replica: MapReplica,
    /// The revision that mapping announced.
    told: MapRef,
}

impl Maps {
    /// Applies a sample to the maps; returns the robot whose map has changed.
    pub fn see(&mut self, sample: &Sample) -> Option<String> {
        if let Some((robot, reply)) = sample.reply(&topics::MAP) {
            let map = self.robots.entry(robot.clone()).or_default();
            return map.replica.replace(&reply).then_some(robot);
        }
        if let Some((robot, info)) = sample.message(&topics::MAP_INFO) {
            self.robots.entry(robot).or_default().told = info.map;
        } else if let Some((robot, patch)) = sample.message(&topics::MAP_PATCH) {
            let map = self.robots.entry(robot.clone()).or_default();
            return (map.replica.apply(&patch) == PatchResult::Applied).then_some(robot);
        }
        None
    }

    /// A robot's map, if one is known.
    #[must_use]
    pub fn grid(&self, robot: &str) -> Option<&OccupancyGrid> {
        let map = self.robots.get(robot)?;
        map.replica.has_map().then(|| map.replica.grid())
    }

    /// The reply that mapping would give now to a request for a robot's map.
    #[must_use]
    pub fn reply(&self, robot: &str) -> Option<MapReply> {
        let map = self.robots.get(robot)?;
        map.replica.has_map().then(|| reply(&map.replica))
    }

    /// Robots whose map is behind the revision that mapping announced.
    pub fn incomplete(&self) -> impl Iterator<Item = &str> {
        let lacks = |map: &RobotMap| map.told.revision > 0 && !map.replica.holds(&map.told);
        let robots = self.robots.iter().filter(move |(_, map)| lacks(map));
        robots.map(|(robot, _)| robot.as_str())
    }

    /// The replies that mapping would give now to requests for the maps.
    #[must_use]
    pub fn replies(&self, now: u64) -> Vec<Sample> {
        let known = self.robots.iter().filter(|(_, map)| map.replica.has_map());
        known
            .filter_map(|(robot, map)| {
                let bytes = codec::encode(&reply(&map.replica), Encoding::Cbor).ok()?;
                let key = topics::MAP.key(&[robot]);
                Some(Sample::new(key, Kind::Reply, Encoding::Cbor, bytes, now))
            })
            .collect()
    }
}

fn reply(map: &MapReplica) -> MapReply {
    let values = map.grid().values();
    let counts = CellCounts::of(values);
    MapReply {
        info: MapInfo {
            stamp: map.stamp(),
            map: map.map().clone(),
            spec: *map.grid().spec(),
            free: counts.free,
            occupied: counts.occupied,
            unknown: counts.unknown,
            scans: 0,
            stored: false,
        },
        values: values.to_vec(),
        trajectory: Vec::new(),
        stored: Vec::new(),
    }
}
