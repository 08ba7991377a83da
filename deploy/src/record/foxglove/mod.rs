//! Foxglove. Converts samples into Foxglove's well-known messages, which are stored beside the samples.
//!
//! | topic | message | from |
//! |---|---|---|
//! | `/{robot}/scan`, `/{robot}/scan/{lidar}` | `LaserScan`, in the map at the scan's own stamp | `edge/scan` |
//! | `/{robot}/map` | `Grid`, at most once a second | `cloud/map_patch` |
//! | `/{robot}/pose` | `PoseInFrame` | `edge/pose` |
//! | `/tf` | `FrameTransforms`: `map`, `{robot}/odom`, `{robot}/base_link`, `{robot}/laser`, `{robot}/{lidar}` | `edge/odometry`, `edge/scan` |
//! | `/{robot}/footprint`, `/{robot}/plan`, `/{robot}/tree`, `/{robot}/graph` | `SceneUpdate`: footprint; plan and its end; search tree; pose graph | the edge's info, `cloud/plan`, `cloud/tree`, `cloud/graph` |
//! | `/{robot}/scene` | `SceneUpdate` of what goes by itself after a while: obstacles, intent, markers | `edge/…` |
//! | `/{robot}/log` | `Log` | `edge/event`, `cloud/goal/…` |
//!
//! Types and encoding (protobuf) are those of Foxglove's own SDK. Their time is the arrival at the recorder: clocks of robots and cloud are never
//! compared. What stays until it is replaced has a topic of its own: after a jump in time a viewer shows the last message of each topic, and no other.

mod shapes;

use std::collections::BTreeMap;

use foxglove::Encode;
use foxglove::messages::log::Level;
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{
    FrameTransform, FrameTransforms, Grid, LaserScan, Log, PackedElementField, Pose, PoseInFrame, Quaternion,
    Timestamp, Vector2, Vector3,
};
use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};
use zenav_protocol::messages::{Event, EventKind, GoalPhase, GoalState, Scan};
use zenav_protocol::topics;

use super::format::Sample;
use super::words;
use crate::output::piece;
use shapes::scene;

/// Encoding of the messages.
pub const ENCODING: &str = "protobuf";

/// The frame of the map.
pub const MAP: &str = "map";
const FRAMES: &str = "/tf";

/// Shortest interval between two grids of a robot, ns; the second constant times the number of cells if that is longer.
const GRID_EVERY: u64 = 1_000_000_000;
const GRID_CELL: u64 = 4_000;

/// A message in Foxglove's format.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Its topic.
    pub topic: String,
    /// Its schema.
    pub schema: foxglove::Schema,
    /// The message, encoded.
    pub bytes: Vec<u8>,
}

impl Drawn {
    fn new<T: Encode>(topic: String, message: &T) -> Option<Self> {
        let mut bytes = Vec::new();
        message.encode(&mut bytes).ok()?;
        let schema = T::get_schema()?;
        Some(Self { topic, schema, bytes })
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
        let time = timestamp(sample.logged);
        let drawn = if let Some((robot, message)) = sample.message(&topics::SCAN) {
            return scan(time, &robot, None, &message);
        } else if let Some((robot, message)) = sample.message(&topics::LIDAR_SCAN) {
            return scan(time, &robot, topics::LIDAR_SCAN.chunks(&sample.key).pop(), &message);
        } else if let Some((robot, message)) = sample.message(&topics::ODOMETRY) {
            let (odom, base) = (format!("{robot}/odom"), format!("{robot}/base_link"));
            frames(vec![frame(time, odom, base, message.odom_from_base)])
        } else if let Some((robot, message)) = sample.message(&topics::POSE) {
            let message = PoseInFrame {
                timestamp: time,
                frame_id: MAP.to_owned(),
                pose: Some(pose(message.map_from_base)),
            };
            Drawn::new(format!("/{robot}/pose"), &message)
        } else if let Some((robot, message)) = sample.message(&topics::EVENT) {
            event(time, &robot, &message)
        } else if let Some((robot, message)) = sample.message(&topics::GOAL_STATE) {
            self.goal(time, &robot, &message)
        } else {
            scene(time, sample).and_then(|(topic, update)| Drawn::new(topic, &update))
        };
        drawn.into_iter().collect()
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

    fn goal(&mut self, time: Option<Timestamp>, name: &str, goal: &GoalState) -> Option<Drawn> {
        let goals = &mut self.robots.entry(name.to_owned()).or_default().goals;
        if goals.insert(goal.id.clone(), goal.state) == Some(goal.state) {
            return None;
        }
        let level = match goal.state {
            GoalPhase::Aborted | GoalPhase::Rejected => Level::Error,
            GoalPhase::Canceled => Level::Warning,
            _ => Level::Info,
        };
        let reason = piece(goal.reason.as_deref(), |reason| format!(": {reason}"));
        let message = format!("goal {} {:?}{reason}", goal.id, goal.state);
        log(time, name, level, message, "goal")
    }
}

/// The time of a message, from ns since the UNIX epoch.
fn timestamp(nanos: u64) -> Option<Timestamp> {
    let secs = u32::try_from(nanos / 1_000_000_000).ok()?;
    Timestamp::new_checked(secs, (nanos % 1_000_000_000) as u32)
}

fn vector(point: Point2<f64>, z: f64) -> Vector3 {
    Vector3 {
        x: point.x,
        y: point.y,
        z,
    }
}

/// A pose at this height above the floor, m.
fn pose_at(point: Point2<f64>, z: f64, yaw: f64) -> Pose {
    let (sin, cos) = (0.5 * yaw).sin_cos();
    Pose {
        position: Some(vector(point, z)),
        orientation: Some(Quaternion {
            x: 0.0,
            y: 0.0,
            z: sin,
            w: cos,
        }),
    }
}

fn pose(pose: Pose2) -> Pose {
    pose_at(pose.position(), 0.0, pose.yaw)
}

/// The map with four bytes of colour per cell: Foxglove then shows it correctly without further settings.
fn grid(name: &str, map: &OccupancyGrid, now: u64) -> Option<Drawn> {
    let spec = map.spec();
    let mut cells = Vec::with_capacity(4 * map.values().len());
    for value in map.values() {
        cells.extend(match Occupancy::of(*value) {
            Occupancy::Free => [245, 246, 248, 255],
            Occupancy::Occupied => [30, 34, 40, 255],
            Occupancy::Unknown => [0, 0, 0, 0],
        });
    }
    let fields = (0..).zip(["red", "green", "blue", "alpha"]);
    let message = Grid {
        timestamp: timestamp(now),
        frame_id: MAP.to_owned(),
        pose: Some(pose_at(spec.origin, 0.0, 0.0)),
        column_count: spec.width,
        cell_size: Some(Vector2 {
            x: spec.resolution,
            y: spec.resolution,
        }),
        row_stride: 4 * spec.width,
        cell_stride: 4,
        fields: fields
            .map(|(offset, name)| PackedElementField {
                name: name.to_owned(),
                offset,
                r#type: NumericType::Uint8.into(),
            })
            .collect(),
        data: cells.into(),
    };
    Drawn::new(format!("/{name}/map"), &message)
}

/// `parent_from_child` at a time.
fn frame(time: Option<Timestamp>, parent: String, child: String, parent_from_child: Pose2) -> FrameTransform {
    let pose = pose(parent_from_child);
    FrameTransform {
        timestamp: time,
        parent_frame_id: parent,
        child_frame_id: child,
        translation: pose.position,
        rotation: pose.orientation,
    }
}

fn frames(transforms: Vec<FrameTransform>) -> Option<Drawn> {
    Drawn::new(FRAMES.to_owned(), &FrameTransforms { transforms })
}

/// A scan of the main lidar or of the further one of this name, and the frames that it was taken in.
fn scan(time: Option<Timestamp>, robot: &str, lidar: Option<String>, scan: &Scan) -> Vec<Drawn> {
    let topic = lidar
        .as_ref()
        .map_or_else(|| format!("/{robot}/scan"), |lidar| format!("/{robot}/scan/{lidar}"));
    // A viewer draws every number, even zero, at the laser.
    let no_return = |range: &f32| {
        if scan.is_return(*range) {
            f64::from(*range)
        } else {
            f64::NAN
        }
    };
    let message = LaserScan {
        timestamp: time,
        frame_id: MAP.to_owned(),
        pose: Some(pose(scan.map_from_laser())),
        start_angle: scan.angle_min,
        end_angle: scan.angle(scan.ranges.len().saturating_sub(1)),
        ranges: scan.ranges.iter().map(no_return).collect(),
        intensities: Vec::new(),
    };
    let laser = lidar.as_deref().unwrap_or("laser");
    let (odom, base) = (format!("{robot}/odom"), format!("{robot}/base_link"));
    let frames = frames(vec![
        frame(time, MAP.to_owned(), odom, scan.map_from_odom),
        frame(time, base, format!("{robot}/{laser}"), scan.base_from_laser),
    ]);
    Drawn::new(topic, &message).into_iter().chain(frames).collect()
}

fn log(time: Option<Timestamp>, robot: &str, level: Level, message: String, name: &str) -> Option<Drawn> {
    let message = Log {
        timestamp: time,
        level: level.into(),
        message,
        name: name.to_owned(),
        ..Log::default()
    };
    Drawn::new(format!("/{robot}/log"), &message)
}

fn event(time: Option<Timestamp>, robot: &str, event: &Event) -> Option<Drawn> {
    let level = match &event.kind {
        EventKind::Bumped => Level::Error,
        kind if words::is_warning(kind) => Level::Warning,
        _ => Level::Info,
    };
    log(time, robot, level, words::event(&event.kind), "edge")
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

    use foxglove::Decode;

    use super::super::made_up::sample;
    use super::*;

    fn decoded<T: Decode>(drawn: &Drawn) -> T {
        T::decode(drawn.bytes.as_slice()).unwrap()
    }

    #[test]
    fn a_scan_lies_where_it_was_taken_and_names_the_frames() {
        let scan = Scan {
            angle_min: -0.5,
            angle_increment: 0.5,
            ranges: vec![1.0, f32::INFINITY, 2.0],
            ..zenav_fixtures::scan(1, Pose2::new(3.0, 0.0, FRAC_PI_2), vec![])
        };
        let drawn = Artist::default().draw(&sample("zenav/r/edge/scan", &scan, 2_500_000_000));
        let scan: LaserScan = decoded(&drawn[0]);
        assert_eq!(drawn[0].topic, "/r/scan");
        assert!(
            matches!(scan.ranges[..], [1.0, missed, 2.0] if missed.is_nan()),
            "{:?}",
            scan.ranges
        );
        assert_eq!((scan.start_angle, scan.end_angle), (-0.5, 0.5));
        assert_eq!(scan.timestamp, Some(Timestamp::new(2, 500_000_000)));
        let pose = scan.pose.unwrap();
        assert_eq!(pose.position, Some(vector(Point2::new(3.0, 0.0), 0.0)));
        let turned = pose.orientation.unwrap();
        let off = [turned.x, turned.y, turned.z - FRAC_1_SQRT_2, turned.w - FRAC_1_SQRT_2];
        assert!(
            off.iter().all(|off| off.abs() < 1e-9),
            "a quarter to the left: {turned:?}"
        );
        let frames: FrameTransforms = decoded(&drawn[1]);
        assert_eq!(frames.transforms[1].child_frame_id, "r/laser");
    }

    #[test]
    fn a_further_lidar_has_a_topic_and_a_frame_of_its_own_whatever_its_name() {
        let scan = zenav_fixtures::scan(1, Pose2::IDENTITY, vec![1.0]);
        for lidar in ["rear", "lidar"] {
            let drawn = Artist::default().draw(&sample(&format!("zenav/r/edge/scan/{lidar}"), &scan, 1));
            let frames: FrameTransforms = decoded(&drawn[1]);
            let names = (&drawn[0].topic, &frames.transforms[1].child_frame_id);
            assert_eq!(names, (&format!("/r/scan/{lidar}"), &format!("r/{lidar}")));
        }
    }

    #[test]
    fn the_log_tells_each_phase_of_a_goal_once() {
        let mut artist = Artist::default();
        let mut told = |state: &str, reason: Option<&str>| -> Vec<Log> {
            let goal = serde_json::json!({
                "id": "g", "robot": "r", "state": state, "reason": reason, "accepted": 0, "request": { "place": "sink" }
            });
            let drawn = artist.draw(&sample("zenav/r/cloud/goal/g", &goal, 2_500_000_000));
            assert!(drawn.iter().all(|drawn| drawn.topic == "/r/log"));
            drawn.iter().map(decoded).collect()
        };
        let expected = |level: Level, message: &str| Log {
            timestamp: Some(Timestamp::new(2, 500_000_000)),
            level: level.into(),
            message: message.to_owned(),
            name: "goal".to_owned(),
            ..Log::default()
        };
        assert_eq!(told("Active", None), [expected(Level::Info, "goal g Active")]);
        assert!(told("Active", None).is_empty());
        assert_eq!(
            told("Aborted", Some("no path")),
            [expected(Level::Error, "goal g Aborted: no path")]
        );
    }

    #[test]
    fn a_map_is_drawn_once_a_second_and_at_the_end() {
        let mut artist = Artist::default();
        let spec = zenav_fixtures::spec(3, 2, 0.05);
        let map = zenav_fixtures::map_with_occupied(spec, &[(0, 0)]);
        let first = artist.draw_map("r", &map, 1_000, false).unwrap();
        let grid: Grid = decoded(&first);
        assert_eq!(grid.column_count, 3);
        assert_eq!((grid.data.len(), &grid.data[..4]), (24, &[30, 34, 40, 255][..]));
        assert!(artist.undrawn().is_empty());
        assert!(artist.draw_map("r", &map, 2_000, false).is_none());
        assert_eq!(artist.undrawn(), ["r"]);
        assert!(artist.draw_map("r", &map, 3_000, true).is_some());
        assert!(artist.undrawn().is_empty(), "nothing has changed since");
    }

    #[test]
    fn what_cannot_be_decoded_is_not_drawn() {
        let mut broken = sample("zenav/r/edge/scan", &1, 1);
        assert!(Artist::default().draw(&broken).is_empty());
        broken.key = "zenav/r/something/else".into();
        assert!(Artist::default().draw(&broken).is_empty());
    }
}
