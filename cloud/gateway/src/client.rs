//! One client's view. Which news does this browser lack?
//!
//! The state of a client is a few numbers and a list of map tiles: the watched robot, the last change it was told of, and the missing parts
//! of the map. Each frame holds the newest value of everything that changed since, so a slow client skips values and never falls behind;
//! there is no queue that could grow.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use crate::view::{Entry, FleetView, RobotView, TileCursor};

/// Longest time between two frames, s: without news, a frame shows that the gateway is alive.
const KEEP_ALIVE: f64 = 1.0;

/// What a browser has been told.
#[derive(Debug, Default)]
pub struct Client {
    watched: Option<String>,
    /// Number of the last change it was told of.
    seen: u64,
    /// As `seen`, for the watched robot's details.
    detail_seen: u64,
    tiles: TileCursor,
    last_frame: Option<f64>,
}

/// Data for a browser.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Frame {
    /// Everything but the map, JSON.
    pub text: Option<String>,
    /// A piece of the map.
    pub map: Option<Vec<u8>>,
}

impl Client {
    /// A client that knows nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Watches a robot from now on: the next frame contains all its details.
    ///
    /// ```
    /// use zenav_gateway::{Client, FleetView, Update};
    ///
    /// let (mut view, mut client) = (FleetView::new(), Client::new());
    /// view.take("tiago", Update::RoundTrip(Some(0.02)), 1.0);
    /// let overview = client.frame(&view, 1.0, true).text.unwrap();
    /// client.watch(Some("tiago".into()));
    /// let details = client.frame(&view, 1.1, true).text.unwrap();
    /// assert!(!overview.contains("p50_ms") && details.contains(r#""p50_ms":20.0"#));
    /// ```
    pub fn watch(&mut self, robot: Option<String>) {
        self.watched = robot;
        self.detail_seen = 0;
        self.tiles = TileCursor::default();
        self.last_frame = None;
    }

    /// The watched robot.
    #[must_use]
    pub fn watched(&self) -> Option<&str> {
        self.watched.as_deref()
    }

    /// The values that the client lacks at `now`, in seconds of the gateway's own clock; `connected` is whether the gateway reaches the
    /// bus.
    ///
    /// ```
    /// use zenav_gateway::{Client, FleetView};
    ///
    /// let (view, mut client) = (FleetView::new(), Client::new());
    /// let told = [0.0, 0.5, 1.1, 1.2].map(|now| client.frame(&view, now, false).text.is_some());
    /// assert_eq!(told, [true, false, true, false], "without news once a second, as a sign of life");
    /// ```
    pub fn frame(&mut self, view: &FleetView, now: f64, connected: bool) -> Frame {
        let changed = view.version > self.seen.min(self.detail_seen) || self.seen == 0;
        let due = self.last_frame.is_none_or(|last| now - last >= KEEP_ALIVE);
        let text = (changed || due).then(|| self.text(view, now, connected));
        if text.is_some() {
            self.last_frame = Some(now);
            self.seen = view.version;
            self.detail_seen = view.version;
        }
        let map = self.watched.as_ref().and_then(|robot| {
            let known = view.robots.get(robot)?;
            self.tiles.next(robot, known)
        });
        Frame { text, map }
    }

    fn text(&self, view: &FleetView, now: f64, connected: bool) -> String {
        let mut text = String::with_capacity(4096);
        let _ = write!(
            text,
            "{{\"type\":\"frame\",\"now\":{now:.3},\"connected\":{connected},\"version\":{}",
            view.version
        );
        if view.names_version > self.seen || self.seen == 0 {
            text.push_str(",\"fleet\":");
            let names: Vec<&str> = view.robots().collect();
            text.push_str(&serde_json::to_string(&names).unwrap_or_else(|_| "[]".to_owned()));
        }
        self.push_summaries(&mut text, view, now);
        if let Some((name, robot)) = self
            .watched
            .as_ref()
            .and_then(|name| Some((name, view.robots.get(name)?)))
        {
            self.push_details(&mut text, name, robot, now);
        }
        text.push('}');
        text
    }

    /// What has changed of every robot.
    fn push_summaries(&self, text: &mut String, view: &FleetView, now: f64) {
        text.push_str(",\"robots\":{");
        let mut first = true;
        for (name, robot) in &view.robots {
            let is_news = |entry: &Entry| entry.version > self.seen;
            if robot.summary.values().any(is_news) {
                comma(text, &mut first);
                push_string(text, name);
                text.push(':');
                push_entries(text, &robot.summary, is_news, now);
            }
        }
        text.push('}');
    }

    /// What has changed of the watched robot's details.
    fn push_details(&self, text: &mut String, name: &str, robot: &RobotView, now: f64) {
        let is_news = |entry: &Entry| entry.version > self.detail_seen;
        text.push_str(",\"watched\":");
        push_string(text, name);
        if self.detail_seen == 0 {
            text.push_str(",\"fresh\":true");
        }
        text.push_str(",\"detail\":");
        push_entries(text, &robot.detail, is_news, now);
        text.push_str(",\"goals\":");
        push_texts(text, robot.goals.values().filter(|entry| is_news(entry)));
        text.push_str(",\"events\":");
        push_texts(text, robot.events.iter().filter(|entry| is_news(entry)));
        text.push_str(",\"trail\":[");
        let mut first = true;
        for (_, [x, y]) in robot.trail.iter().filter(|(version, _)| *version > self.detail_seen) {
            comma(text, &mut first);
            let _ = if x.is_finite() {
                write!(text, "[{x:.3},{y:.3}]")
            } else {
                write!(text, "null")
            };
        }
        text.push(']');
    }
}

/// The entries that are news, as an object by channel.
fn push_entries(text: &mut String, entries: &BTreeMap<String, Entry>, is_news: impl Fn(&Entry) -> bool, now: f64) {
    text.push('{');
    let mut first = true;
    for (channel, entry) in entries.iter().filter(|(_, entry)| is_news(entry)) {
        comma(text, &mut first);
        write_entry(text, channel, entry, now);
    }
    text.push('}');
}

/// `"name":{"age":…,"data":…}`, with the age in s.
pub(crate) fn write_entry(text: &mut String, name: &str, entry: &Entry, now: f64) {
    push_string(text, name);
    let age = (now - entry.heard).max(0.0);
    let _ = write!(text, ":{{\"age\":{age:.3},\"data\":{}}}", entry.text);
}

fn push_texts<'a>(text: &mut String, entries: impl Iterator<Item = &'a Entry>) {
    text.push('[');
    let mut first = true;
    for entry in entries {
        comma(text, &mut first);
        text.push_str(&entry.text);
    }
    text.push(']');
}

fn comma(text: &mut String, first: &mut bool) {
    if !std::mem::take(first) {
        text.push(',');
    }
}

/// A JSON string.
fn push_string(text: &mut String, value: &str) {
    text.push_str(&serde_json::to_string(value).unwrap_or_else(|_| "\"\"".to_owned()));
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use serde_json::{Value, json};
    use zenav_protocol::grid::GridSpec;
    use zenav_protocol::messages::{
        EdgeState, Event, MapPatch, MapRef, MotionReply, Plan, PlanStatistics, PoseEstimate, SmoothReply, TILE, Tile,
    };
    use zenav_protocol::time::Stamp;
    use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};

    use super::*;
    use crate::view::Update;

    fn state(mode: &str) -> Update {
        let state: EdgeState = serde_json::from_value(json!({
            "stamp": 1, "boot_id": "b", "mode": mode, "link": "Connected",
            "lease": { "holder": null, "role": null, "epoch": 1, "live": false },
            "velocity": { "v": 0.0, "w": 0.0 }, "guard": "clear", "battery": 1.0,
        }))
        .unwrap();
        Update::State(state)
    }

    fn pose(x: f64) -> Update {
        let pose: PoseEstimate = serde_json::from_value(json!({
            "stamp": 1, "map_from_base": { "x": x, "y": 0.0, "yaw": 0.0 }, "covariance": vec![0.0; 9], "velocity": { "v": 0.0, "w": 0.0 },
        }))
        .unwrap();
        Update::Pose(pose)
    }

    fn event(sequence: u64) -> Update {
        let event: Event =
            serde_json::from_value(json!({ "stamp": 1, "boot_id": "b", "sequence": sequence, "event": "bumped" }))
                .unwrap();
        Update::Event(event)
    }

    fn patch(revision: u64, base_revision: u64, tiles: u32, changed: &[u32], value: i8) -> Update {
        let tile = |x: &u32| Tile {
            x: *x,
            y: 0,
            values: vec![value; (TILE * TILE) as usize],
        };
        Update::Patch(MapPatch {
            stamp: Stamp(revision),
            map: MapRef::new("m", revision),
            base_revision,
            spec: GridSpec {
                origin: Point2::origin(),
                resolution: 0.05,
                width: TILE * tiles,
                height: TILE,
            },
            tiles: changed.iter().map(tile).collect(),
        })
    }

    fn told(client: &mut Client, view: &FleetView, now: f64) -> Value {
        serde_json::from_str(&client.frame(view, now, true).text.unwrap()).unwrap()
    }

    #[test]
    fn a_slow_client_gets_the_newest_and_no_more_than_that() {
        let (mut view, mut slow) = (FleetView::new(), Client::new());
        slow.watch(Some("a".into()));
        view.take("a", state("idle"), 1.0);
        let first = told(&mut slow, &view, 1.0);
        assert_eq!(first["fleet"], json!(["a"]));
        assert_eq!(first["robots"]["a"]["state"]["data"]["mode"], "idle");
        for step in 0..10_000_u32 {
            view.take("a", pose(f64::from(step) * 0.001), 1.0 + f64::from(step));
            view.take("a", event(step.into()), 1.0);
        }
        let frame = told(&mut slow, &view, 10_000.5);
        assert_eq!(frame["robots"]["a"]["pose"]["data"]["x"], 9.999);
        assert_eq!(frame["robots"]["a"]["pose"]["age"], 0.5);
        assert!(
            frame["robots"]["a"]["state"].is_null(),
            "what has not changed is not told again"
        );
        assert!(frame.get("fleet").is_none());
        assert_eq!(frame["events"].as_array().unwrap().len(), 300, "the newest events");
        assert!(frame.to_string().len() < 60_000);
    }

    #[test]
    fn who_came_before_the_first_robot_is_told_of_it() {
        let (mut view, mut early) = (FleetView::new(), Client::new());
        assert_eq!(told(&mut early, &view, 0.0)["fleet"], json!([]));
        view.take("a", state("idle"), 1.0);
        let frame = told(&mut early, &view, 1.0);
        assert_eq!(frame["fleet"], json!(["a"]));
        assert_eq!(frame["robots"]["a"]["state"]["data"]["mode"], "idle");
    }

    #[test]
    fn nothing_new_is_told_once_a_second_that_the_gateway_lives() {
        let (view, mut client) = (FleetView::new(), Client::new());
        let times = [0.0, 0.1, 0.5, 1.1, 1.2, 2.2];
        let told: Vec<bool> = times
            .iter()
            .map(|now| client.frame(&view, *now, false).text.is_some())
            .collect();
        assert_eq!(told, [true, false, false, true, false, true]);
    }

    #[test]
    fn places_and_zones_of_a_robot_are_told_when_they_change() {
        let (mut view, mut client) = (FleetView::new(), Client::new());
        let annotations = |name: &str| {
            let text = json!({ "revision": 1, "places": { name: { "x": 1.0, "y": 2.0 } }, "zones": [] });
            Update::Annotations(serde_json::from_value(text).unwrap())
        };
        view.take("a", annotations("sink"), 1.0);
        let frame = told(&mut client, &view, 1.0);
        assert_eq!(frame["robots"]["a"]["annotations"]["data"]["places"]["sink"]["x"], 1.0);
        view.take("a", pose(0.0), 1.1);
        assert!(told(&mut client, &view, 1.1)["robots"]["a"]["annotations"].is_null());
        view.take("a", annotations("fridge"), 1.2);
        let frame = told(&mut client, &view, 1.2);
        assert!(frame["robots"]["a"]["annotations"]["data"]["places"]["fridge"].is_object());
        let lost = json!({
            "stamp": 1, "boot_id": "b", "health": { "state": "lost" }, "map_from_base": { "x": 0.0, "y": 0.0, "yaw": 0.0 },
            "agreeing": 0.1, "through_walls": 0.5,
        });
        view.take("a", Update::Localisation(serde_json::from_value(lost).unwrap()), 1.3);
        let frame = told(&mut client, &view, 1.4);
        assert_eq!(frame["robots"]["a"]["localisation"]["data"]["health"]["state"], "lost");
    }

    #[test]
    fn details_are_for_who_watches_and_are_whole_after_every_change_of_robot() {
        let (mut view, mut client) = (FleetView::new(), Client::new());
        view.take("a", pose(0.0), 1.0);
        view.take("a", event(1), 1.0);
        view.take("a", event(1), 1.0);
        view.take("b", pose(1.0), 1.0);
        let frame = told(&mut client, &view, 1.0);
        assert!(frame["robots"]["b"].is_object() && frame["events"].is_null());
        client.watch(Some("a".into()));
        let frame = told(&mut client, &view, 1.1);
        assert_eq!((&frame["watched"], &frame["fresh"]), (&json!("a"), &json!(true)));
        assert_eq!(
            frame["events"].as_array().unwrap().len(),
            1,
            "an event that is sent again is one event"
        );
        assert_eq!(frame["trail"], json!([[0.0, 0.0]]));
        view.take("a", pose(0.2), 1.2);
        assert_eq!(told(&mut client, &view, 1.2)["trail"], json!([[0.2, 0.0]]));
        client.watch(Some("gone".into()));
        assert!(told(&mut client, &view, 1.3)["detail"].is_null());
    }

    #[test]
    fn a_pose_graph_goes_to_who_watches_with_its_edges_by_kind() {
        let (mut view, mut client) = (FleetView::new(), Client::new());
        let edge = |from: u32, to: u32, kind: &str, weight: f64| json!({ "from": from, "to": to, "kind": kind, "weight": weight });
        let graph = json!({
            "stamp": 1, "boot_id": "b", "map": { "id": "m", "revision": 1 }, "certificate": "certified",
            "nodes": [{ "x": 0.0, "y": 0.0, "yaw": 0.0 }, { "x": 1.0, "y": 0.5, "yaw": 0.0 }, { "x": 2.0, "y": 0.0, "yaw": 0.0 }],
            "edges": [
                edge(0, 2, "closure", 1.0), edge(1, 0, "closure", 0.0), edge(0, 1, "odometry", 1.0), edge(1, 2, "odometry", 1.0),
                edge(2, 3, "odometry", 1.0),
            ],
        });
        view.take("a", Update::Graph(serde_json::from_value(graph).unwrap()), 1.0);
        client.watch(Some("a".into()));
        assert_eq!(
            told(&mut client, &view, 1.0)["detail"]["graph"]["data"],
            json!({
                "nodes": [0.0, 0.0, 1.0, 0.5, 2.0, 0.0], "odometry": [0, 1, 1, 2], "closures": [0, 2], "rejected": [1, 0],
                "certificate": "certified",
            }),
            "an edge to a node that does not exist is left out"
        );
    }

    #[test]
    fn a_plan_s_corridor_is_that_of_the_answer_with_its_trajectory_whichever_comes_first() {
        let (mut view, mut client) = (FleetView::new(), Client::new());
        client.watch(Some("a".into()));
        let drive = |x: f64| {
            let end = TrajectoryPoint {
                t: 1.0,
                x,
                ..TrajectoryPoint::default()
            };
            Trajectory::new(vec![TrajectoryPoint::default(), end])
        };
        let plan = |trajectory_id: u64, x: f64| {
            Update::Plan(Plan {
                trajectory_id,
                trajectory: drive(x),
                ..Plan::default()
            })
        };
        let answer = |x: f64| {
            Update::Motion(MotionReply::Smooth(SmoothReply {
                map: MapRef::default(),
                trajectory: drive(x),
                statistics: PlanStatistics::default(),
                corridor: vec![vec![Point2::new(0.0, -1.0), Point2::new(x, -1.0), Point2::new(x, 1.0)]],
            }))
        };
        let corridor = |trajectory_id: u64, x: f64| json!({ "trajectory_id": trajectory_id, "polygons": [[0.0, -1.0, x, -1.0, x, 1.0]] });
        let updates = [
            (answer(2.0), json!(null), "no plan yet"),
            (answer(3.0), json!(null), "no plan yet"),
            (plan(7, 2.0), corridor(7, 2.0), "its answer came first"),
            (plan(7, 2.0), json!(null), "renewed: told once"),
            (plan(8, 4.0), json!(null), "no answer yet"),
            (answer(4.0), corridor(8, 4.0), "its plan came first"),
            (plan(7, 2.0), corridor(7, 2.0), "in force again"),
        ];
        for (update, expected, why) in updates {
            view.take("a", update, 1.0);
            view.take("a", pose(0.0), 1.0);
            assert_eq!(
                told(&mut client, &view, 1.0)["detail"]["corridor"]["data"],
                expected,
                "{why}"
            );
        }
    }

    #[test]
    fn round_trips_are_told_as_median_95th_percentile_and_loss() {
        let (mut view, mut client) = (FleetView::new(), Client::new());
        client.watch(Some("a".into()));
        let answered = (1..=18).map(|ms| Some(f64::from(ms) * 1e-3));
        for took in answered.chain([None, None]) {
            view.take("a", Update::RoundTrip(took), 1.0);
        }
        let told = told(&mut client, &view, 1.0);
        assert_eq!(
            told["detail"]["round_trip"]["data"],
            json!({ "p50_ms": 10.0, "p95_ms": 17.0, "loss": 0.1 })
        );
    }

    #[test]
    fn a_jump_of_the_pose_breaks_the_trail() {
        let (mut view, mut client) = (FleetView::new(), Client::new());
        client.watch(Some("a".into()));
        view.take("a", pose(0.0), 1.0);
        view.take("a", pose(5.0), 1.1);
        assert_eq!(
            told(&mut client, &view, 1.2)["trail"],
            json!([[0.0, 0.0], null, [5.0, 0.0]])
        );
    }

    /// Header and cells of a piece of the map.
    fn piece(client: &mut Client, view: &FleetView) -> Option<(Value, Vec<u8>)> {
        let bytes = client.frame(view, 1.0, true).map?;
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        Some((
            serde_json::from_slice(&bytes[4..4 + length]).unwrap(),
            bytes[4 + length..].to_vec(),
        ))
    }

    #[test]
    fn the_map_goes_out_in_pieces_and_then_only_what_changed() {
        let (mut view, mut client) = (FleetView::new(), Client::new());
        client.watch(Some("a".into()));
        assert!(piece(&mut client, &view).is_none());
        let all: Vec<u32> = (0..200).collect();
        view.take("a", patch(1, 0, 200, &all, 0), 1.0);
        assert!(!view.wants_map("a"));
        let (header, cells) = piece(&mut client, &view).unwrap();
        assert_eq!(header["tiles"].as_array().unwrap().len(), 128);
        assert_eq!((cells.len(), header["left"].as_u64()), (128 * 4096, Some(72)));
        // Tile 199 changes before it was sent: it is sent once, with its newest cells.
        view.take("a", patch(2, 1, 200, &[199, 3], 100), 1.0);
        let (header, cells) = piece(&mut client, &view).unwrap();
        assert_eq!(header["tiles"].as_array().unwrap().len(), 73);
        assert_eq!(cells.last(), Some(&100));
        assert!(piece(&mut client, &view).is_none());
        view.take("a", patch(9, 8, 200, &[0], 100), 1.0);
        assert!(view.wants_map("a"), "a patch is missing");
    }

    #[test]
    fn a_robot_that_is_gone_for_long_is_dropped() {
        let mut view = FleetView::new();
        view.take("a", state("idle"), 1.0);
        view.take("b", state("idle"), 50.0);
        view.forget_silent(62.0, 60.0);
        assert_eq!(view.robots().collect::<Vec<_>>(), ["b"]);
        let mut client = Client::new();
        assert_eq!(told(&mut client, &view, 62.0)["fleet"], json!(["b"]));
    }
}
