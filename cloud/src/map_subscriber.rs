//! Map subscriber. Keeps a replica of every robot's map.
//!
//! Replicas are updated by patches. When a patch is lost, the whole map is requested.

use std::collections::BTreeMap;
use std::time::Duration;

use tokio::time::{Instant, timeout_at};
use zenav_protocol::bus::{Bus, BusError, Subscription};
use zenav_protocol::map_replica::{MapReplica, PatchResult};
use zenav_protocol::messages::{MapPatch, MapRef, MapRequest};
use zenav_protocol::topics::{MAP, MAP_PATCH};

/// Most queued patches; when more arrive at once, the whole map is requested.
const QUEUE: usize = 128;
/// Time that a patch may take to arrive.
const SETTLING: Duration = Duration::from_millis(100);
/// Most robots whose maps are kept; beyond that the first by name is dropped.
const MAX_ROBOTS: usize = 1024;

/// Replicas of the maps of all robots on the bus.
#[derive(Debug)]
pub struct MapSubscriber {
    bus: Bus,
    patches: Subscription<MapPatch>,
    robots: BTreeMap<String, RobotReplica>,
}

#[derive(Debug, Default)]
struct RobotReplica {
    replica: MapReplica,
    /// Whether a patch is missing.
    gap: bool,
}

impl RobotReplica {
    fn holds(&self, wanted: &MapRef) -> bool {
        if wanted.id.is_empty() {
            self.replica.has_map() && !self.gap
        } else {
            self.replica.holds(wanted)
        }
    }

    /// Whether the missing patch may still be in transit.
    fn is_a_little_behind(&self, wanted: &MapRef) -> bool {
        !self.gap && self.replica.map().id == wanted.id && !self.replica.holds(wanted)
    }
}

impl MapSubscriber {
    /// Subscribes to the maps of all robots.
    ///
    /// # Errors
    /// [`BusError`] when the patches cannot be subscribed to.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self {
            bus: bus.clone(),
            patches: bus.subscribe(&MAP_PATCH, &["*"], QUEUE)?,
            robots: BTreeMap::new(),
        })
    }

    /// Applies patches forever; drop the future to stop. Returns `false` when the bus is closed.
    pub async fn follow(&mut self) -> bool {
        while let Some(received) = self.patches.next().await {
            self.take(received.chunks.first(), &received.message);
        }
        false
    }

    fn take(&mut self, robot: Option<&String>, patch: &MapPatch) {
        let Some(robot) = robot else { return };
        let robot_replica = self.robots.entry(robot.clone()).or_default();
        match robot_replica.replica.apply(patch) {
            PatchResult::Applied => robot_replica.gap = false,
            PatchResult::Old => {}
            // Repaired by the next request for this map.
            PatchResult::Gap => robot_replica.gap = true,
        }
        if self.robots.len() > MAX_ROBOTS {
            self.robots.pop_first();
        }
    }

    /// A robot's map at the wanted revision or later. If the replica is behind, the whole map is requested. With an empty id any map will
    /// do. `None` when the map does not arrive in time.
    pub async fn map(&mut self, robot: &str, wanted: &MapRef, deadline: Duration) -> Option<&mut MapReplica> {
        while let Some(received) = self.patches.try_next() {
            self.take(received.chunks.first(), &received.message);
        }
        // A patch that others already have is in transit: the whole map is requested only if it does not arrive.
        let settled = Instant::now() + SETTLING.min(deadline);
        while self
            .robots
            .get(robot)
            .is_some_and(|known| known.is_a_little_behind(wanted))
        {
            let Ok(Some(received)) = timeout_at(settled, self.patches.next()).await else {
                break;
            };
            self.take(received.chunks.first(), &received.message);
        }
        if !self.robots.get(robot).is_some_and(|known| known.holds(wanted)) {
            let reply = self
                .bus
                .ask(&MAP, &[robot], &MapRequest::default(), deadline)
                .await
                .ok()?;
            let robot_replica = self.robots.entry(robot.to_owned()).or_default();
            robot_replica.gap &= !robot_replica.replica.replace(&reply);
        }
        self.robots
            .get_mut(robot)
            .map(|known| &mut known.replica)
            .filter(|replica| replica.has_map())
    }
}
