//! One robot's latest state. What was its last message of each kind, and when did it arrive? Bounded, whatever the robot publishes.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use serde::Serialize;
use zenav_protocol::map_replica::MapReplica;

use super::corridor::Corridors;

/// Most goals kept; beyond that the least recently updated one is dropped.
const MAX_GOALS: usize = 100;
/// Most events kept; beyond that the oldest is dropped.
const MAX_EVENTS: usize = 300;
/// Most points of the trail kept.
const MAX_TRAIL: usize = 4000;
/// Most channels besides the fixed ones: markers by name, lidars by name.
const MAX_CHANNELS: usize = 64;
/// Least distance between two points of the trail, m.
const TRAIL_STEP: f64 = 0.05;
/// A larger jump of the pose is not motion, m: the trail is interrupted there.
const TRAIL_JUMP: f64 = 1.0;

/// A message as JSON text, the number of the change that brought it, and its time of arrival.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub(crate) version: u64,
    /// Seconds of the gateway's own clock.
    pub(crate) heard: f64,
    pub(crate) text: Arc<str>,
}

impl Entry {
    /// `None` for a message that cannot be serialised.
    pub(super) fn new(version: u64, heard: f64, message: &impl Serialize) -> Option<Self> {
        let text = serde_json::to_string(message).ok()?;
        Some(Self {
            version,
            heard,
            text: text.into(),
        })
    }
}

/// What is known about a robot.
#[derive(Debug, Default)]
pub(crate) struct RobotView {
    /// Channels sent to every client for every robot: `state`, `pose`, `parts`.
    pub(crate) summary: BTreeMap<String, Entry>,
    /// Channels sent to the clients that watch this robot: `plan`, `mission`, `scan`, …
    pub(crate) detail: BTreeMap<String, Entry>,
    /// Its plan's corridor, and others that may become it.
    pub(super) corridors: Corridors,
    /// Boot and number of stops of its newest state.
    pub(super) stops: Option<(String, u64)>,
    /// Goals by id.
    pub(crate) goals: BTreeMap<String, Entry>,
    /// Events, oldest first.
    pub(crate) events: VecDeque<Entry>,
    /// Driven path: number of the change, x, y in m of the map frame; a NaN interrupts the line.
    pub(crate) trail: VecDeque<(u64, [f64; 2])>,
    /// Copy of its map, while it is watched.
    pub(crate) map: MapReplica,
    /// Whether a patch of the map is missing.
    pub(crate) map_gap: bool,
    /// Components that are alive: `edge`, `mapping`, `mission`.
    pub(crate) parts: Vec<String>,
    /// Time of its last message, s.
    pub(crate) heard: f64,
    /// Sequence of the newest event and its boot, so that a repeated event is not shown twice.
    pub(crate) last_event: Option<(String, u64)>,
}

impl RobotView {
    /// Sets a channel of the summary.
    pub(super) fn set(&mut self, name: &str, version: u64, now: f64, message: &impl Serialize) {
        if let Some(entry) = Entry::new(version, now, message) {
            self.summary.insert(name.to_owned(), entry);
        }
    }

    pub(super) fn set_detail(&mut self, name: &str, entry: Entry) {
        if self.detail.len() >= MAX_CHANNELS && !self.detail.contains_key(name) {
            // The fixed channels are few, and some are sent only once.
            let named = self.detail.iter().filter(|(name, _)| name.contains('/'));
            let oldest = named.min_by_key(|(_, entry)| entry.version);
            if let Some(oldest) = oldest.map(|(name, _)| name.clone()) {
                self.detail.remove(&oldest);
            }
        }
        self.detail.insert(name.to_owned(), entry);
    }

    pub(super) fn set_goal(&mut self, id: &str, entry: Entry) {
        self.goals.insert(id.to_owned(), entry);
        if self.goals.len() > MAX_GOALS {
            let oldest = self.goals.iter().min_by_key(|(_, entry)| entry.version);
            if let Some(oldest) = oldest.map(|(id, _)| id.clone()) {
                self.goals.remove(&oldest);
            }
        }
    }

    pub(super) fn add_event(&mut self, entry: Entry) {
        self.events.push_back(entry);
        while self.events.len() > MAX_EVENTS {
            self.events.pop_front();
        }
    }

    pub(super) fn follow(&mut self, version: u64, place: [f64; 2]) {
        let step = self.trail.back().map(|(_, last)| {
            let (dx, dy) = (place[0] - last[0], place[1] - last[1]);
            dx.hypot(dy)
        });
        if step.is_some_and(|step| step < TRAIL_STEP) {
            return;
        }
        if step.is_some_and(|step| step > TRAIL_JUMP) {
            self.trail.push_back((version, [f64::NAN; 2]));
        }
        self.trail.push_back((version, place));
        while self.trail.len() > MAX_TRAIL {
            self.trail.pop_front();
        }
    }
}
