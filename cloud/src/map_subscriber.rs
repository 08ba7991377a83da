//! How does a service keep up with every robot's map? By patches, and by asking for the whole where one was lost.

use std::collections::BTreeMap;
use std::time::Duration;

use tokio::time::{Instant, timeout_at};
use zenav_protocol::bus::{Bus, BusError, Subscription};
use zenav_protocol::messages::{MapPatch, MapRef, MapRequest};
use zenav_protocol::topics::{MAP, MAP_PATCH};

use zenav_protocol::map_replica::{MapReplica, PatchResult};

/// Patches that wait; when more come in one go, the whole map is asked for.
const QUEUE: usize = 128;
/// How long a patch may be on its way.
const SETTLING: Duration = Duration::from_millis(100);
/// Robots whose maps are kept; beyond it the first by name goes.
const MAX_ROBOTS: usize = 1024;

/// Copies of the maps of all robots on the bus.
#[derive(Debug)]
pub struct MapSubscriber {
    bus: Bus,
    patches: Subscription<MapPatch>,
    robots: BTreeMap<String, Followed>,
}

#[derive(Debug, Default)]
struct Followed {
    mirror: MapReplica,
    /// Whether a patch is missing.
    gap: bool,
}

impl Followed {
    fn holds(&self, wanted: &MapRef) -> bool {
        if wanted.id.is_empty() {
            self.mirror.has_map() && !self.gap
        } else {
            self.mirror.holds(wanted)
        }
    }

    /// Whether what is missing may just be on its way.
    fn is_a_little_behind(&self, wanted: &MapRef) -> bool {
        !self.gap && self.mirror.map().id == wanted.id && !self.mirror.holds(wanted)
    }
}

impl MapSubscriber {
    /// Begins to follow.
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

    /// Takes in patches for ever; drop the future to go on. `false` when the bus is closed.
    pub async fn follow(&mut self) -> bool {
        while let Some(received) = self.patches.next().await {
            self.take(received.chunks.first(), &received.message);
        }
        false
    }

    fn take(&mut self, robot: Option<&String>, patch: &MapPatch) {
        let Some(robot) = robot else { return };
        let followed = self.robots.entry(robot.clone()).or_default();
        match followed.mirror.apply(patch) {
            PatchResult::Applied => followed.gap = false,
            PatchResult::Old => {}
            // Healed when somebody asks for this map.
            PatchResult::Gap => followed.gap = true,
        }
        if self.robots.len() > MAX_ROBOTS {
            self.robots.pop_first();
        }
    }

    /// A robot's map at the wanted revision or a later one; the whole is asked for where the copy is behind.
    /// Without a name any map will do. `None` when nobody has it in time.
    pub async fn map(&mut self, robot: &str, wanted: &MapRef, deadline: Duration) -> Option<&mut MapReplica> {
        while let Some(received) = self.patches.try_next() {
            self.take(received.chunks.first(), &received.message);
        }
        // A patch that others have already is on its way: the whole is asked for only when it does not come.
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
            let followed = self.robots.entry(robot.to_owned()).or_default();
            followed.gap &= !followed.mirror.replace(&reply);
        }
        self.robots
            .get_mut(robot)
            .map(|known| &mut known.mirror)
            .filter(|mirror| mirror.has_map())
    }
}
