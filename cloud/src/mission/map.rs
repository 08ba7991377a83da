//! What is known of the robot's map? A copy kept by patches, and where the robot may be by it.

use zenav_protocol::messages::{MapAction, MapInfo, MapPatch, MapRef, MapRequest};
use zenav_protocol::robot::Footprint;
use zenav_protocol::time::Stamp;

use super::context::Asks;
use super::exchange::{Answer, Ask, Ticket};
use crate::mapping::{MapMirror, Mirrored};
use crate::space::{ConfigurationSpace, UnknownPolicy};

/// Time between two asks for the whole map, s.
const RETRY: f64 = 1.0;
/// For so long patches are waited for before the whole is asked for, s.
const PATIENCE: f64 = 0.5;

/// The robot's map as the mission knows it.
#[derive(Debug, Default)]
pub struct MapBook {
    info: Option<MapInfo>,
    mirror: MapMirror,
    /// Since when the copy has been behind.
    behind: Option<Stamp>,
    asking: Option<Ticket>,
    next_ask: Stamp,
    space: Option<(MapRef, ConfigurationSpace)>,
}

impl MapBook {
    /// Takes in what mapping says.
    pub fn observe(&mut self, now: Stamp, info: Option<MapInfo>, patches: &[MapPatch]) {
        let mut gap = false;
        for patch in patches {
            // A gap may be closed by a later patch that starts from an unknown map.
            gap = match self.mirror.apply(patch) {
                Mirrored::Applied => false,
                Mirrored::Old => gap,
                Mirrored::Gap => true,
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

    /// The copy's map and revision; `None` while there is no copy.
    #[must_use]
    pub fn newest(&self) -> Option<MapRef> {
        self.mirror.has_map().then(|| self.mirror.map().clone())
    }

    /// Where the robot may be; unknown cells do not stand in its way here. `None` without a map.
    pub fn space(&mut self, footprint: &Footprint) -> Option<&ConfigurationSpace> {
        if !self.mirror.has_map() || self.mirror.grid().spec().is_empty() {
            return None;
        }
        let current = self
            .space
            .as_ref()
            .is_some_and(|(map, space)| map == self.mirror.map() && space.footprint() == footprint);
        if !current {
            let space = ConfigurationSpace::new(self.mirror.grid(), footprint, UnknownPolicy::Free, 0.0);
            self.space = Some((self.mirror.map().clone(), space));
        }
        self.space.as_ref().map(|(_, space)| space)
    }
}
