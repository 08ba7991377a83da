//! Fleet view. What is the latest state of every robot?
//!
//! A pure core: takes messages with their time of arrival, and keeps the newest of each kind as JSON text, with the number of the change
//! that brought it. A client is then sent what changed after the last change it saw ([`crate::client`]): there are no queues, and a slow
//! client costs no memory.

mod compact;
mod corridor;
mod map_tiles;
mod robot;

use std::collections::BTreeMap;

use zenav_protocol::map_replica::PatchResult;
use zenav_protocol::messages::{
    Annotations, EdgeState, Event, GoalState, InfoReply, Localisation, MapPatch, MapReply, Marker, MissionStatus,
    MotionReply, Obstacles, Plan, PoseEstimate, PoseGraph, Scan, SearchTree,
};

use compact::{CompactGraph, CompactModel, CompactPlan, CompactPose, CompactScan, CompactTree};
use corridor::Corridors;
pub(crate) use map_tiles::TileCursor;
pub(crate) use robot::{Entry, RobotView};

/// Most robots kept; beyond that the one silent for longest is dropped.
const MAX_ROBOTS: usize = 1024;

/// A message about one robot.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "a few at a time, moved once")]
pub enum Update {
    /// Mode, link, lease, progress.
    State(EdgeState),
    /// Pose and velocity.
    Pose(PoseEstimate),
    /// A sweep of a lidar; the name is empty for the main one.
    Scan(String, Scan),
    /// The plan it is to follow.
    Plan(Plan),
    /// State of its behaviour tree.
    Mission(MissionStatus),
    /// A goal and its progress.
    Goal(GoalState),
    /// An event on the robot.
    Event(Event),
    /// A shape to draw.
    Marker(Marker),
    /// Moving obstacles around it.
    Obstacles(Obstacles),
    /// A planner's search.
    Tree(SearchTree),
    /// A motion worker's answer, which has the corridor of a plan.
    Motion(MotionReply),
    /// SLAM's pose graph.
    Graph(PoseGraph),
    /// Its whole map.
    Map(MapReply),
    /// Changes of its map.
    Patch(MapPatch),
    /// Its identity and model.
    Info(InfoReply),
    /// Places and zones of its map.
    Annotations(Annotations),
    /// How well it is localised.
    Localisation(Localisation),
    /// One of its components appeared or disappeared.
    Part {
        /// `edge`, `mapping`, `mission`.
        component: String,
        /// Whether it is alive.
        alive: bool,
    },
    /// Round trip of a request to the robot and back, s; `None` for an unanswered one.
    RoundTrip(Option<f64>),
}

/// The latest state of every robot.
#[derive(Debug, Default)]
pub struct FleetView {
    pub(crate) robots: BTreeMap<String, RobotView>,
    /// Number of the latest change.
    pub(crate) version: u64,
    /// Number of the change that added or removed a robot.
    pub(crate) names_version: u64,
    /// Newest round trips, by robot.
    round_trips: BTreeMap<String, Vec<Option<f64>>>,
}

/// Round trips kept per robot.
const ROUND_TRIPS: usize = 60;

impl FleetView {
    /// A view without robots.
    #[must_use]
    pub fn new() -> Self {
        // A client that has been told nothing has seen change 1.
        Self {
            version: 1,
            ..Self::default()
        }
    }

    /// Takes a message about a robot that arrived at `now`, in seconds of the gateway's own clock.
    ///
    /// ```
    /// use zenav_gateway::{FleetView, Update};
    ///
    /// let mut view = FleetView::new();
    /// for (component, alive) in [("edge", true), ("mission", true), ("edge", false)] {
    ///     view.take("tiago", Update::Part { component: component.into(), alive }, 1.0);
    /// }
    /// assert_eq!(view.channel("tiago", "parts", 1.0), Some((r#"["mission"]"#, 0.0)));
    /// ```
    pub fn take(&mut self, robot: &str, update: Update, now: f64) {
        self.version += 1;
        let version = self.version;
        if !self.robots.contains_key(robot) {
            self.add(robot);
        }
        let Some(view) = self.robots.get_mut(robot) else {
            return;
        };
        let is_a_sign_of_life = matches!(update, Update::State(_) | Update::Pose(_) | Update::Event(_));
        if is_a_sign_of_life || view.heard == 0.0 {
            view.heard = now;
        }
        let corridor = match &update {
            Update::Plan(plan) => view.corridors.take_plan(plan),
            Update::Motion(answer) => view.corridors.take_answer(answer),
            _ => None,
        };
        if let Some(entry) = corridor.and_then(|corridor| Entry::new(version, now, &corridor)) {
            view.set_detail("corridor", entry);
        }
        match update {
            Update::State(state) => {
                view.stops = Some((state.boot_id.clone(), state.stops));
                view.set("state", version, now, &state);
            }
            Update::Pose(pose) => {
                let at = pose.map_from_base;
                if at.is_finite() {
                    view.follow(version, [at.x, at.y]);
                }
                view.set("pose", version, now, &CompactPose::from(&pose));
            }
            Update::Annotations(annotations) => view.set("annotations", version, now, &annotations),
            Update::Localisation(localisation) => view.set("localisation", version, now, &localisation),
            Update::Part { component, alive } => {
                view.parts.retain(|part| *part != component);
                if alive && view.parts.len() < 32 {
                    view.parts.push(component);
                    view.parts.sort_unstable();
                }
                let parts = view.parts.clone();
                view.set("parts", version, now, &parts);
            }
            Update::Goal(goal) => {
                if let Some(entry) = Entry::new(version, now, &goal) {
                    view.set_goal(&goal.id, entry);
                }
            }
            Update::Event(event) => {
                let this = (event.boot_id.clone(), event.sequence);
                // An event sent again to a late subscriber is not a second event.
                let known = view
                    .last_event
                    .as_ref()
                    .is_some_and(|(boot, sequence)| *boot == this.0 && *sequence >= this.1);
                if !known && let Some(entry) = Entry::new(version, now, &event) {
                    view.last_event = Some(this);
                    view.add_event(entry);
                }
            }
            Update::Patch(patch) => match view.map.apply(&patch) {
                PatchResult::Applied => view.map_gap = false,
                PatchResult::Old => {}
                PatchResult::Gap => view.map_gap = true,
            },
            Update::Map(reply) => view.map_gap &= !view.map.replace(&reply),
            Update::RoundTrip(took) => {
                let trips = self.round_trips.entry(robot.to_owned()).or_default();
                trips.push(took);
                if trips.len() > ROUND_TRIPS {
                    trips.remove(0);
                }
                if let Some(entry) = Entry::new(version, now, &trip_summary(trips)) {
                    view.set_detail("round_trip", entry);
                }
            }
            other => {
                if let Some((name, entry)) = detail(other, version, now) {
                    view.set_detail(&name, entry);
                }
            }
        }
    }

    fn add(&mut self, robot: &str) {
        if self.robots.len() >= MAX_ROBOTS {
            let silent = self.robots.iter().min_by(|a, b| a.1.heard.total_cmp(&b.1.heard));
            if let Some(silent) = silent.map(|(name, _)| name.clone()) {
                self.forget(&silent);
            }
        }
        self.robots.insert(robot.to_owned(), RobotView::default());
        self.names_version = self.version;
    }

    /// Drops a robot.
    pub fn forget(&mut self, robot: &str) {
        self.version += 1;
        self.robots.remove(robot);
        self.round_trips.remove(robot);
        self.names_version = self.version;
    }

    /// Drops robots that have been silent for `secs` and have no living component.
    ///
    /// ```
    /// use zenav_gateway::{FleetView, Update};
    ///
    /// let mut view = FleetView::new();
    /// view.take("gone", Update::RoundTrip(None), 1.0);
    /// view.take("quiet", Update::Part { component: "edge".into(), alive: true }, 1.0);
    /// view.forget_silent(62.0, 60.0);
    /// assert!(!view.knows("gone") && view.knows("quiet"), "one of its components is alive");
    /// ```
    pub fn forget_silent(&mut self, now: f64, secs: f64) {
        let gone = |view: &RobotView| view.parts.is_empty() && now - view.heard > secs;
        let gone: Vec<String> = self
            .robots
            .iter()
            .filter(|(_, view)| gone(view))
            .map(|(name, _)| name.clone())
            .collect();
        for robot in gone {
            self.forget(&robot);
        }
    }

    /// Names of the robots, in order.
    ///
    /// ```
    /// use zenav_gateway::{FleetView, Update};
    ///
    /// let mut view = FleetView::new();
    /// for robot in ["tiago-2", "jackal", "tiago-1"] {
    ///     view.take(robot, Update::RoundTrip(None), 1.0);
    /// }
    /// view.forget("jackal");
    /// assert_eq!(view.robots().collect::<Vec<_>>(), ["tiago-1", "tiago-2"]);
    /// ```
    pub fn robots(&self) -> impl Iterator<Item = &str> {
        self.robots.keys().map(String::as_str)
    }

    /// Whether the robot is known.
    #[must_use]
    pub fn knows(&self, robot: &str) -> bool {
        self.robots.contains_key(robot)
    }

    /// Boot and number of stops of this robot's newest state.
    pub(crate) fn stops(&self, robot: &str) -> Option<(String, u64)> {
        self.robots.get(robot)?.stops.clone()
    }

    /// The robot was just told to stop: its next state reports the new number.
    pub(crate) fn forget_stops(&mut self, robot: &str) {
        if let Some(robot) = self.robots.get_mut(robot) {
            robot.stops = None;
        }
    }

    /// Whether the whole map of this robot must be requested.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_gateway::{FleetView, Update};
    /// # use zenav_protocol::{grid::GridSpec, messages::{MapPatch, MapRef, TILE, Tile}, time::Stamp};
    /// # let patch = MapPatch {
    /// #     stamp: Stamp(1),
    /// #     map: MapRef::new("kitchen", 1),
    /// #     base_revision: 0,
    /// #     spec: GridSpec { origin: Point2::origin(), resolution: 0.05, width: TILE, height: TILE },
    /// #     tiles: vec![Tile { x: 0, y: 0, values: vec![0; (TILE * TILE) as usize] }],
    /// # };
    /// let mut view = FleetView::new();
    /// view.take("tiago", Update::RoundTrip(None), 1.0);
    /// assert!(view.wants_map("tiago") && !view.wants_map("nobody"));
    /// // The first patch of a map holds all of it; with the third the second is missing.
    /// let later = MapPatch { base_revision: 2, map: MapRef { revision: 3, ..patch.map.clone() }, ..patch.clone() };
    /// view.take("tiago", Update::Patch(patch), 1.1);
    /// assert!(!view.wants_map("tiago"));
    /// view.take("tiago", Update::Patch(later), 1.2);
    /// assert!(view.wants_map("tiago"));
    /// ```
    #[must_use]
    pub fn wants_map(&self, robot: &str) -> bool {
        self.robots
            .get(robot)
            .is_some_and(|view| view.map_gap || !view.map.has_map())
    }

    /// Drops the data needed only by watchers of the robot.
    pub fn forget_details(&mut self, robot: &str) {
        if let Some(view) = self.robots.get_mut(robot) {
            view.map = zenav_protocol::map_replica::MapReplica::new();
            view.map_gap = false;
            view.detail.retain(|name, _| name == "model");
            view.corridors = Corridors::default();
            view.goals.clear();
        }
    }

    /// Everything known about a robot, as JSON: every channel with its age.
    ///
    /// ```
    /// use zenav_gateway::{FleetView, Update};
    ///
    /// let mut view = FleetView::new();
    /// view.take("tiago", Update::Part { component: "edge".into(), alive: true }, 1.0);
    /// assert_eq!(view.robot_json("tiago", 1.5).unwrap(), r#"{"parts":{"age":0.500,"data":["edge"]}}"#);
    /// assert_eq!(view.robot_json("nobody", 1.5), None);
    /// ```
    #[must_use]
    pub fn robot_json(&self, robot: &str, now: f64) -> Option<String> {
        let view = self.robots.get(robot)?;
        let mut text = String::from("{");
        let channels = view.summary.iter().chain(&view.detail);
        for (at, (name, entry)) in channels.enumerate() {
            if at > 0 {
                text.push(',');
            }
            crate::client::write_entry(&mut text, name, entry, now);
        }
        text.push('}');
        Some(text)
    }

    /// The text of one of a robot's channels, such as `state`, and its age in s.
    #[must_use]
    pub fn channel(&self, robot: &str, name: &str, now: f64) -> Option<(&str, f64)> {
        let view = self.robots.get(robot)?;
        let entry = view.summary.get(name).or_else(|| view.detail.get(name))?;
        Some((&entry.text, now - entry.heard))
    }

    /// A robot's events, oldest first, as JSON texts.
    ///
    /// ```
    /// use serde_json::json;
    /// use zenav_gateway::{FleetView, Update};
    ///
    /// let bumped = |sequence: u32| serde_json::from_value(json!({ "stamp": 1, "boot_id": "b", "sequence": sequence, "event": "bumped" }));
    /// let mut view = FleetView::new();
    /// for sequence in [1, 2, 2] {
    ///     view.take("tiago", Update::Event(bumped(sequence)?), 1.0);
    /// }
    /// assert_eq!(view.events("tiago").count(), 2, "an event that is sent again is one event");
    /// # Ok::<(), serde_json::Error>(())
    /// ```
    pub fn events(&self, robot: &str) -> impl Iterator<Item = &str> {
        let view = self.robots.get(robot);
        view.into_iter()
            .flat_map(|view| view.events.iter().map(|entry| &*entry.text))
    }
}

/// The channel of a detail, and its entry.
fn detail(update: Update, version: u64, now: f64) -> Option<(String, Entry)> {
    let fixed = |name: &str, entry: Option<Entry>| Some((name.to_owned(), entry?));
    match update {
        Update::Scan(lidar, scan) => {
            let name = if lidar.is_empty() {
                "scan".to_owned()
            } else {
                format!("scan/{lidar}")
            };
            Some((name, Entry::new(version, now, &CompactScan::from(&scan))?))
        }
        Update::Plan(plan) => fixed("plan", Entry::new(version, now, &CompactPlan::from(&plan))),
        Update::Mission(mission) => fixed("mission", Entry::new(version, now, &mission)),
        Update::Marker(marker) => {
            let name: String = marker.name.chars().take(40).collect();
            Some((format!("marker/{name}"), Entry::new(version, now, &marker)?))
        }
        Update::Obstacles(all) => fixed("obstacles", Entry::new(version, now, &compact::obstacles(&all))),
        Update::Tree(tree) => fixed("tree", Entry::new(version, now, &CompactTree::from(&tree))),
        Update::Graph(graph) => fixed("graph", Entry::new(version, now, &CompactGraph::from(&graph))),
        Update::Info(info) => fixed("model", Entry::new(version, now, &CompactModel::of(&info)?)),
        _ => None,
    }
}

/// Median and 95th percentile of the answered round trips in ms, and the share of unanswered ones.
fn trip_summary(trips: &[Option<f64>]) -> serde_json::Value {
    let mut answered: Vec<f64> = trips.iter().copied().flatten().collect();
    answered.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let last = answered.len().checked_sub(1)?;
        let ms = answered.get((share * last as f64).round() as usize)? * 1e3;
        Some((ms * 10.0).round() / 10.0)
    };
    let lost = trips.iter().filter(|trip| trip.is_none()).count();
    serde_json::json!({
        "p50_ms": quantile(0.5), "p95_ms": quantile(0.95),
        "loss": (lost as f64 / trips.len().max(1) as f64 * 1e3).round() / 1e3,
    })
}
