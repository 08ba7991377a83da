//! Foxglove. Converts samples into Foxglove's well-known messages, which are stored beside the samples.
//!
//! | topic | message | from |
//! |---|---|---|
//! | `/{robot}/scan`, `/{robot}/scan/{lidar}` | `LaserScan`, in the map at the scan's own stamp | `edge/scan` |
//! | `/{robot}/map` | `Grid`, at most once a second | `cloud/map_patch` |
//! | `/{robot}/pose` | `PoseInFrame` | `edge/pose` |
//! | `/tf` | `FrameTransforms`: `map`, `{robot}/odom`, `{robot}/base_link`, `{robot}/laser` | `edge/odometry`, `edge/scan` |
//! | `/{robot}/scene` | `SceneUpdate`: plan, goal, search tree, pose graph, footprint, obstacles, intent, markers | `cloud/plan`, `cloud/tree`, `cloud/graph`, `edge/…` |
//! | `/{robot}/log` | `Log` | `edge/event`, `cloud/goal/…` |
//!
//! Their time is the arrival at the recorder: clocks of robots and cloud are never compared.

mod messages;
mod schemas;

use std::collections::BTreeMap;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use nalgebra::Point2;
use serde::Serialize;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};
use zenav_protocol::messages::{
    Event, EventKind, GoalPhase, GoalState, GraphEdge, GraphEdgeKind, GuardZone, Intent, Link, Marker, Obstacles,
    Odometry, Plan, PoseEstimate, PoseGraph, Scan, SearchTree,
};
use zenav_protocol::robot::Footprint;
use zenav_protocol::sensors::DEFAULT_LIDAR;
use zenav_protocol::topics;

use super::format::Sample;
use messages::{
    Color, Cylinder, ERROR, FrameTransform, FrameTransforms, Grid, INFO, LIST, LOOP, LaserScan, Line, Log,
    PackedElementField, Pose, PoseInFrame, STRIP, SceneEntity, SceneEntityDeletion, SceneUpdate, Time, Vector2,
    Vector3, WARNING,
};
pub use schemas::Schema;

const MAP: &str = "map";
const FRAMES: &str = "/tf";
const PLAN: [u8; 3] = [30, 160, 80];
const GOAL: [u8; 3] = [240, 150, 0];
const TREE: [u8; 3] = [150, 190, 235];
const ODOMETRY: [u8; 3] = [150, 150, 150];
const CLOSURE: [u8; 3] = [30, 130, 76];
const REJECTED: [u8; 3] = [215, 60, 40];
const ROBOT: [u8; 3] = [40, 110, 220];
const OBSTACLE: [u8; 3] = [215, 60, 40];
const INTENT: [u8; 3] = [120, 60, 170];
const MARKER: [u8; 3] = [90, 90, 90];

/// Thickness of lines, m.
const THIN: f64 = 0.015;
/// Height of lines above the floor, m: above the map.
const LOW: f64 = 0.02;
/// Most edges of a search tree that are drawn.
const MOST_EDGES: usize = 20_000;
/// Lifetime of shapes that are published repeatedly, ns.
const SHORT_LIVED: u64 = 1_500_000_000;
/// Shortest interval between two grids of a robot, ns; the second constant times the number of cells if that is longer.
const GRID_EVERY: u64 = 1_000_000_000;
const GRID_CELL: u64 = 4_000;
/// Corners of a disc.
const CORNERS: u32 = 32;

/// A message in Foxglove's format.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    /// Its topic.
    pub topic: String,
    /// Its schema.
    pub schema: Schema,
    /// The message.
    pub json: Vec<u8>,
}

impl Drawn {
    fn new<T: Serialize>(topic: String, schema: Schema, message: &T) -> Option<Self> {
        let json = serde_json::to_vec(message).ok()?;
        Some(Self { topic, schema, json })
    }
}

/// Drawing state of a robot.
#[derive(Debug, Default)]
struct Robot {
    /// Whether the map has changed since it was last drawn.
    changed: bool,
    /// Earliest time at which the map may be drawn again, ns.
    due: u64,
    goals: BTreeMap<String, GoalPhase>,
}

/// Draws a run for Foxglove, sample by sample.
#[derive(Debug, Default)]
pub struct Artist {
    robots: BTreeMap<String, Robot>,
}

impl Artist {
    /// Messages for a sample. A sample that cannot be decoded is not drawn.
    pub fn draw(&mut self, sample: &Sample) -> Vec<Drawn> {
        let Some(row) = topics::row_of(&sample.key) else {
            return Vec::new();
        };
        let pattern = row.pattern;
        let time = Time::from_nanos(sample.logged);
        let mut drawn = Vec::new();
        if pattern == topics::SCAN.pattern {
            if let Ok(Some((chunks, message))) = sample.message(&topics::SCAN) {
                scan(time, &chunks, &message, &mut drawn);
            }
        } else if pattern == topics::LIDAR_SCAN.pattern {
            if let Ok(Some((chunks, message))) = sample.message(&topics::LIDAR_SCAN) {
                scan(time, &chunks, &message, &mut drawn);
            }
        } else if pattern == topics::ODOMETRY.pattern {
            if let Ok(Some((chunks, message))) = sample.message(&topics::ODOMETRY) {
                drawn.extend(odometry(time, &chunks, &message));
            }
        } else if pattern == topics::POSE.pattern {
            if let Ok(Some((chunks, message))) = sample.message(&topics::POSE) {
                drawn.extend(pose(time, &chunks, &message));
            }
        } else if pattern == topics::EVENT.pattern {
            if let Ok(Some((chunks, message))) = sample.message(&topics::EVENT) {
                drawn.extend(event(time, &chunks, &message));
            }
        } else if pattern == topics::GOAL_STATE.pattern {
            if let Ok(Some((chunks, message))) = sample.message(&topics::GOAL_STATE) {
                drawn.extend(self.goal(time, &chunks, &message));
            }
        } else if let Some((robot, update)) = scene(time, sample) {
            drawn.extend(Drawn::new(format!("/{robot}/scene"), Schema::SceneUpdate, &update));
        }
        drawn
    }

    /// The map of a robot, if it may be drawn again; with `last` (at the end of a file) in any case.
    pub fn draw_map(&mut self, name: &str, map: &OccupancyGrid, now: u64, last: bool) -> Option<Drawn> {
        let robot = self.robots.entry(name.to_owned()).or_default();
        if !last && now < robot.due {
            robot.changed = true;
            return None;
        }
        robot.changed = false;
        robot.due = now + GRID_EVERY.max(GRID_CELL * map.values().len() as u64);
        grid(name, map, now)
    }

    /// Starts a new file: every map may be drawn at once.
    pub fn begin_file(&mut self) {
        self.robots.values_mut().for_each(|robot| robot.due = 0);
    }

    /// Robots whose maps have changed since they were last drawn.
    #[must_use]
    pub fn undrawn(&self) -> Vec<String> {
        let changed = self.robots.iter().filter(|(_, robot)| robot.changed);
        changed.map(|(name, _)| name.clone()).collect()
    }

    fn goal(&mut self, time: Time, chunks: &[String], goal: &GoalState) -> Option<Drawn> {
        let name = chunks.first()?;
        let goals = &mut self.robots.entry(name.clone()).or_default().goals;
        if goals.insert(goal.id.clone(), goal.state) == Some(goal.state) {
            return None;
        }
        let level = match goal.state {
            GoalPhase::Aborted | GoalPhase::Rejected => ERROR,
            GoalPhase::Canceled => WARNING,
            _ => INFO,
        };
        let reason = goal.reason.as_deref().map(|reason| format!(": {reason}"));
        let message = format!("goal {} {:?}{}", goal.id, goal.state, reason.unwrap_or_default());
        log(time, name, level, message, "goal")
    }
}

/// The map with four bytes of colour per cell: Foxglove then shows it correctly without further settings.
fn grid(name: &str, map: &OccupancyGrid, now: u64) -> Option<Drawn> {
    const UINT8: u8 = 1;
    let spec = map.spec();
    let mut cells = Vec::with_capacity(4 * map.values().len());
    for value in map.values() {
        cells.extend(match Occupancy::of(*value) {
            Occupancy::Free => [245, 246, 248, 255],
            Occupancy::Occupied => [30, 34, 40, 255],
            Occupancy::Unknown => [0, 0, 0, 0],
        });
    }
    let field = |name, offset| PackedElementField {
        name,
        offset,
        kind: UINT8,
    };
    let message = Grid {
        timestamp: Time::from_nanos(now),
        frame_id: MAP,
        pose: Pose::at(Vector3::above(spec.origin, 0.0)),
        column_count: spec.width,
        cell_size: Vector2 {
            x: spec.resolution,
            y: spec.resolution,
        },
        row_stride: 4 * spec.width,
        cell_stride: 4,
        fields: [field("red", 0), field("green", 1), field("blue", 2), field("alpha", 3)],
        data: STANDARD.encode(&cells),
    };
    Drawn::new(format!("/{name}/map"), Schema::Grid, &message)
}

fn scan(time: Time, chunks: &[String], scan: &Scan, drawn: &mut Vec<Drawn>) {
    let Some(robot) = chunks.first() else { return };
    let lidar = chunks.get(1);
    let topic = lidar.map_or_else(|| format!("/{robot}/scan"), |lidar| format!("/{robot}/scan/{lidar}"));
    let no_return = |range: &f32| if scan.is_return(*range) { *range } else { 0.0 };
    let message = LaserScan {
        timestamp: time,
        frame_id: MAP,
        pose: scan.map_from_laser().into(),
        start_angle: scan.angle_min,
        end_angle: scan.angle(scan.ranges.len().saturating_sub(1)),
        ranges: scan.ranges.iter().map(no_return).collect(),
        intensities: [],
    };
    drawn.extend(Drawn::new(topic, Schema::LaserScan, &message));
    let laser = lidar.map_or(DEFAULT_LIDAR, String::as_str);
    let laser = if laser == DEFAULT_LIDAR { "laser" } else { laser };
    let (odom, base) = (format!("{robot}/odom"), format!("{robot}/base_link"));
    let frames = FrameTransforms {
        transforms: vec![
            FrameTransform::new(time, MAP.to_owned(), odom, scan.map_from_odom),
            FrameTransform::new(time, base, format!("{robot}/{laser}"), scan.base_from_laser),
        ],
    };
    drawn.extend(Drawn::new(FRAMES.to_owned(), Schema::FrameTransforms, &frames));
}

fn odometry(time: Time, chunks: &[String], odometry: &Odometry) -> Option<Drawn> {
    let robot = chunks.first()?;
    let (odom, base) = (format!("{robot}/odom"), format!("{robot}/base_link"));
    let frames = FrameTransforms {
        transforms: vec![FrameTransform::new(time, odom, base, odometry.odom_from_base)],
    };
    Drawn::new(FRAMES.to_owned(), Schema::FrameTransforms, &frames)
}

fn pose(time: Time, chunks: &[String], pose: &PoseEstimate) -> Option<Drawn> {
    let message = PoseInFrame {
        timestamp: time,
        frame_id: MAP,
        pose: pose.map_from_base.into(),
    };
    Drawn::new(format!("/{}/pose", chunks.first()?), Schema::PoseInFrame, &message)
}

fn log(time: Time, robot: &str, level: u8, message: String, name: &str) -> Option<Drawn> {
    let message = Log {
        timestamp: time,
        level,
        message,
        name,
        file: "",
        line: 0,
    };
    Drawn::new(format!("/{robot}/log"), Schema::Log, &message)
}

fn event(time: Time, chunks: &[String], event: &Event) -> Option<Drawn> {
    let level = match &event.kind {
        EventKind::Bumped => ERROR,
        EventKind::PlanRejected { .. }
        | EventKind::PlanExpired { .. }
        | EventKind::BatteryLow { .. }
        | EventKind::InputsDropped { .. }
        | EventKind::TeleopDropped { .. }
        | EventKind::Stopped { .. }
        | EventKind::Guard {
            zone: GuardZone::Stop, ..
        }
        | EventKind::LinkChanged {
            link: Link::Stale | Link::Lost,
        } => WARNING,
        _ => INFO,
    };
    log(time, chunks.first()?, level, super::words::event(&event.kind), "edge")
}

/// The shapes of a sample, and their robot.
fn scene(time: Time, sample: &Sample) -> Option<(String, SceneUpdate)> {
    fn of<T>(message: Result<Option<(Vec<String>, T)>, impl Sized>) -> Option<(String, T)> {
        let (chunks, message) = message.ok().flatten()?;
        Some((chunks.into_iter().next()?, message))
    }
    if let Some((robot, info)) = sample.reply(&topics::EDGE_INFO) {
        let footprint = info.model?.footprint;
        return Some((robot.clone(), footprint_scene(time, &robot, &footprint)));
    }
    let pattern = topics::row_of(&sample.key)?.pattern;
    if pattern == topics::PLAN.pattern {
        of(sample.message(&topics::PLAN)).map(|(robot, plan)| (robot, plan_scene(time, &plan)))
    } else if pattern == topics::TREE.pattern {
        of(sample.message(&topics::TREE)).map(|(robot, tree)| (robot, tree_scene(time, &tree)))
    } else if pattern == topics::GRAPH.pattern {
        of(sample.message(&topics::GRAPH)).map(|(robot, graph)| (robot, graph_scene(time, &graph)))
    } else if pattern == topics::OBSTACLES.pattern {
        of(sample.message(&topics::OBSTACLES)).map(|(robot, seen)| (robot, obstacle_scene(time, &seen)))
    } else if pattern == topics::INTENT.pattern {
        of(sample.message(&topics::INTENT)).map(|(robot, intent)| (robot, intent_scene(time, &intent)))
    } else if pattern == topics::MARKER.pattern {
        of(sample.message(&topics::MARKER)).map(|(robot, marker)| (robot, marker_scene(time, &marker)))
    } else {
        None
    }
}

fn lifted(points: &[Point2<f64>]) -> Vec<Vector3> {
    points.iter().map(|point| Vector3::above(*point, LOW)).collect()
}

fn footprint_scene(time: Time, robot: &str, footprint: &Footprint) -> SceneUpdate {
    let corners = super::words::outline(footprint, CORNERS);
    let mut entity = SceneEntity::new(time, &format!("{robot}/base_link"), "footprint");
    entity.frame_locked = true;
    entity
        .lines
        .push(Line::new(LOOP, lifted(&corners), 2.0 * THIN, Color::rgb(ROBOT, 1.0)));
    SceneUpdate {
        entities: vec![entity],
        ..SceneUpdate::default()
    }
}

fn plan_scene(time: Time, plan: &Plan) -> SceneUpdate {
    let mut points: Vec<Point2<f64>> = plan.trajectory.iter().map(|point| point.position()).collect();
    if points.is_empty() {
        points.clone_from(&plan.waypoints);
    }
    let Some(end) = points.last().copied() else {
        let deletion = SceneEntityDeletion {
            timestamp: time,
            kind: 0,
            id: "plan".to_owned(),
        };
        return SceneUpdate {
            deletions: vec![deletion],
            ..SceneUpdate::default()
        };
    };
    let mut entity = SceneEntity::new(time, MAP, "plan");
    entity
        .lines
        .push(Line::new(STRIP, lifted(&points), 2.0 * THIN, Color::rgb(PLAN, 1.0)));
    entity
        .cylinders
        .push(Cylinder::on_floor(end, 0.06, LOW, Color::rgb(GOAL, 0.9)));
    SceneUpdate {
        entities: vec![entity],
        ..SceneUpdate::default()
    }
}

fn tree_scene(time: Time, tree: &SearchTree) -> SceneUpdate {
    let mut entity = SceneEntity::new(time, MAP, "search tree");
    let ends: Vec<Point2<f64>> = tree.edges.iter().take(MOST_EDGES).flatten().copied().collect();
    entity
        .lines
        .push(Line::new(LIST, lifted(&ends), 0.5 * THIN, Color::rgb(TREE, 0.8)));
    entity
        .lines
        .push(Line::new(STRIP, lifted(&tree.path), THIN, Color::rgb(ROBOT, 1.0)));
    SceneUpdate {
        entities: vec![entity],
        ..SceneUpdate::default()
    }
}

fn graph_scene(time: Time, graph: &PoseGraph) -> SceneUpdate {
    let mut entity = SceneEntity::new(time, MAP, "pose graph");
    let mut draw = |color, is_drawn: fn(&GraphEdge) -> bool| {
        let edges = graph.lines().filter(|(edge, _)| is_drawn(edge));
        let ends: Vec<Point2<f64>> = edges.flat_map(|(_, ends)| ends).collect();
        entity
            .lines
            .push(Line::new(LIST, lifted(&ends), THIN, Color::rgb(color, 0.8)));
    };
    draw(ODOMETRY, |edge| edge.kind == GraphEdgeKind::Odometry);
    draw(CLOSURE, |edge| {
        edge.kind == GraphEdgeKind::Closure && !edge.is_rejected()
    });
    draw(REJECTED, GraphEdge::is_rejected);
    SceneUpdate {
        entities: vec![entity],
        ..SceneUpdate::default()
    }
}

fn obstacle_scene(time: Time, seen: &Obstacles) -> SceneUpdate {
    let mut entity = SceneEntity::new(time, MAP, "obstacles");
    entity.lifetime = Time::from_nanos(SHORT_LIVED);
    for obstacle in &seen.obstacles {
        let at = Point2::new(obstacle.x, obstacle.y);
        let ahead = Point2::new(obstacle.x + obstacle.vx, obstacle.y + obstacle.vy);
        let color = Color::rgb(OBSTACLE, 0.5);
        entity
            .cylinders
            .push(Cylinder::on_floor(at, obstacle.radius, 0.5, color));
        entity
            .lines
            .push(Line::new(STRIP, lifted(&[at, ahead]), THIN, Color::rgb(OBSTACLE, 1.0)));
    }
    SceneUpdate {
        entities: vec![entity],
        ..SceneUpdate::default()
    }
}

fn intent_scene(time: Time, intent: &Intent) -> SceneUpdate {
    let mut entity = SceneEntity::new(time, MAP, "intent");
    entity.lifetime = Time::from_nanos(SHORT_LIVED);
    entity
        .lines
        .push(Line::new(STRIP, lifted(&intent.places), THIN, Color::rgb(INTENT, 0.8)));
    SceneUpdate {
        entities: vec![entity],
        ..SceneUpdate::default()
    }
}

fn marker_scene(time: Time, marker: &Marker) -> SceneUpdate {
    let mut entity = SceneEntity::new(time, MAP, &format!("marker {}", marker.name));
    entity.lifetime = Time::from_nanos(SHORT_LIVED);
    if let [point] = marker.points.as_slice() {
        entity
            .cylinders
            .push(Cylinder::on_floor(*point, 0.04, LOW, Color::rgb(MARKER, 0.9)));
    } else {
        entity
            .lines
            .push(Line::new(STRIP, lifted(&marker.points), THIN, Color::rgb(MARKER, 0.9)));
    }
    SceneUpdate {
        entities: vec![entity],
        ..SceneUpdate::default()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use serde_json::Value;
    use zenav_protocol::codec::{Encoding, encode};
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::time::Stamp;

    use super::super::format::Kind;
    use super::*;

    fn sample<T: Serialize>(key: &str, message: &T, encoding: Encoding, logged: u64) -> Sample {
        Sample {
            key: key.to_owned(),
            encoding: encoding.mime().to_owned(),
            kind: Kind::Put,
            bytes: encode(message, encoding).unwrap(),
            attachment: None,
            logged,
            published: None,
        }
    }

    /// Checks that a value has what a schema requires, with the right types.
    fn fits(schema: &Value, value: &Value, at: &str) {
        if let Some(choices) = schema.get("oneOf").and_then(Value::as_array) {
            assert!(choices.iter().any(|choice| choice["const"] == *value), "{at}: {value}");
            return;
        }
        match schema["type"].as_str().unwrap() {
            "object" => {
                let fields = value.as_object().unwrap_or_else(|| panic!("{at}: {value}"));
                for required in schema.get("required").and_then(Value::as_array).into_iter().flatten() {
                    assert!(fields.contains_key(required.as_str().unwrap()), "{at} lacks {required}");
                }
                for (name, field) in fields {
                    fits(&schema["properties"][name], field, &format!("{at}.{name}"));
                }
            }
            "array" => value
                .as_array()
                .unwrap()
                .iter()
                .for_each(|item| fits(&schema["items"], item, at)),
            "string" => assert!(value.is_string(), "{at}"),
            "boolean" => assert!(value.is_boolean(), "{at}"),
            "integer" => assert!(value.is_u64(), "{at}: {value}"),
            "number" => assert!(value.is_number(), "{at}: {value}"),
            other => panic!("{at}: {other}"),
        }
    }

    fn checked(drawn: &[Drawn]) -> Vec<Value> {
        let value = |drawn: &Drawn| {
            let value = serde_json::from_slice(&drawn.json).unwrap();
            fits(&drawn.schema.json(), &value, drawn.schema.name());
            value
        };
        drawn.iter().map(value).collect()
    }

    #[test]
    fn a_scan_lies_where_it_was_taken_and_names_the_frames() {
        let scan = Scan {
            ranges: vec![1.0, f32::INFINITY, 2.0],
            ..zenav_fixtures::scan(1, Pose2::new(3.0, 0.0, 0.0), vec![])
        };
        let drawn = Artist::default().draw(&sample("zenav/r/edge/scan", &scan, Encoding::Json, 2_500_000_000));
        let values = checked(&drawn);
        assert_eq!(drawn[0].topic, "/r/scan");
        assert_eq!(values[0]["ranges"], serde_json::json!([1.0, 0.0, 2.0]));
        assert_eq!(
            values[0]["timestamp"],
            serde_json::json!({ "sec": 2, "nsec": 500_000_000 })
        );
        assert_eq!(values[0]["pose"]["position"]["x"], 3.0);
        assert_eq!(values[1]["transforms"][1]["child_frame_id"], "r/laser");
    }

    #[test]
    fn a_map_is_drawn_once_a_second_and_at_the_end() {
        let mut artist = Artist::default();
        let spec = zenav_fixtures::spec(3, 2, 0.05);
        let map = zenav_fixtures::map_with_occupied(spec, &[(0, 0)]);
        let first = artist.draw_map("r", &map, 1_000, false).unwrap();
        let value = &checked(&[first])[0];
        assert_eq!(value["column_count"], 3);
        let bytes = STANDARD.decode(value["data"].as_str().unwrap()).unwrap();
        assert_eq!((bytes.len(), &bytes[..4]), (24, &[30, 34, 40, 255][..]));
        assert!(artist.undrawn().is_empty());
        assert!(artist.draw_map("r", &map, 2_000, false).is_none());
        assert_eq!(artist.undrawn(), ["r"]);
        assert!(artist.draw_map("r", &map, 3_000, true).is_some());
        assert!(artist.undrawn().is_empty(), "nothing has changed since");
    }

    #[test]
    fn every_shape_fits_its_schema() {
        let mut artist = Artist::default();
        let plan = Plan {
            waypoints: vec![Point2::new(1.0, 2.0), Point2::new(2.0, 2.0)],
            ..zenav_fixtures_plan()
        };
        let marker = Marker {
            stamp: Stamp(1),
            name: "waypoint".into(),
            points: vec![Point2::new(1.0, 1.0)],
        };
        let intent = Intent {
            robot: "r".into(),
            places: vec![Point2::new(0.0, 0.0)],
            ..Intent::default()
        };
        let tree = SearchTree {
            stamp: Stamp(1),
            edges: vec![[Point2::new(0.0, 0.0), Point2::new(1.0, 0.0)]],
            path: vec![Point2::new(0.0, 0.0)],
        };
        let graph = PoseGraph {
            nodes: vec![Pose2::IDENTITY, Pose2::new(1.0, 0.0, 0.0)],
            edges: vec![GraphEdge {
                from: 0,
                to: 1,
                kind: GraphEdgeKind::Closure,
                weight: 0.0,
            }],
            ..PoseGraph::default()
        };
        let event = Event {
            stamp: Stamp(1),
            boot_id: "b".into(),
            sequence: 1,
            kind: EventKind::Bumped,
        };
        for sample in [
            sample("zenav/r/cloud/plan", &plan, Encoding::Json, 1),
            sample("zenav/r/edge/marker", &marker, Encoding::Json, 1),
            sample("zenav/r/edge/intent", &intent, Encoding::Json, 1),
            sample("zenav/r/cloud/tree", &tree, Encoding::Json, 1),
            sample("zenav/r/cloud/graph", &graph, Encoding::Json, 1),
            sample("zenav/r/edge/event", &event, Encoding::Json, 1),
            sample("zenav/r/edge/obstacles", &Obstacles::default(), Encoding::Json, 1),
        ] {
            let drawn = artist.draw(&sample);
            assert_eq!(checked(&drawn).len(), 1, "{}", sample.key);
        }
    }

    fn zenav_fixtures_plan() -> Plan {
        serde_json::from_value(serde_json::json!({
            "goal_id": "g", "epoch": 1, "revision": { "incarnation": 1, "counter": 1 }, "trajectory_id": 1,
            "map": { "id": "m", "revision": 1 }, "frame": "map", "based_on": { "stamp": 1, "boot_id": "b" }, "valid_for": 5.0,
            "waypoints": [], "trajectory": [], "splice": null,
            "statistics": { "planner": "astar", "search_ms": 0.0, "corridor_ms": 0.0, "geometry_ms": 0.0, "timing_ms": 0.0,
                "length": 0.0, "duration": 0.0, "min_clearance": null, "status": "waypoints", "solver": "" },
        }))
        .unwrap()
    }

    #[test]
    fn what_cannot_be_decoded_is_not_drawn() {
        let mut broken = sample("zenav/r/edge/scan", &1, Encoding::Json, 1);
        assert!(Artist::default().draw(&broken).is_empty());
        broken.key = "zenav/r/something/else".into();
        assert!(Artist::default().draw(&broken).is_empty());
    }
}
