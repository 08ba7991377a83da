//! Tests of single nodes that depend on a robot, its paths and its goals: one test per row of Nav2's semantics.

use std::time::Duration;

use nalgebra::Point2;
use zenav_behaviour_tree::{
    Category, Limits, NodeSpec, PortSpec, PortType, Registry, Status, Tree, Value, check, simulate,
};
use zenav_mapping::{Mapper, MappingSettings};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::{GridSpec, OccupancyGrid};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    EdgeState, Event, EventKind, Health, InfoReply, Link, Localisation, MapFrame, MapRef, PoseEstimate,
};
use zenav_protocol::time::Stamp;

use super::parse_path;
use super::path::DrivenPath;
use crate::MissionConfig;
use crate::context::Context;
use crate::io::{Answer, Ask};
use crate::records::Restored;
use crate::route::RouteData;
use crate::trees::{build, registry};

use Status::{Failure, Running, Success};

const SPEC: GridSpec = GridSpec {
    origin: Point2::new(-5.0, -5.0),
    resolution: 0.1,
    width: 128,
    height: 128,
};

/// A single node, and a robot placed where a test needs it.
struct Stand {
    tree: Tree<Context>,
    ctx: Context,
    ms: u64,
    pose: Pose2,
    covariance: [f64; 9],
    velocity: Twist2,
    events: Vec<Event>,
}

impl Stand {
    fn new(node: &str) -> Stand {
        Stand::on(node, &zenav_fixtures::free_map(SPEC))
    }

    /// With a map.
    fn on(node: &str, map: &OccupancyGrid) -> Stand {
        let config = MissionConfig::new(Id::robot("tiago").unwrap(), "m", "unused".into());
        let mut ctx = Context::new(config, &Restored::fresh());
        let settings = MappingSettings {
            resolution: SPEC.resolution,
            ..MappingSettings::default()
        };
        let name = MapRef::new("m", 0);
        let mut mapper = Mapper::with_stored(settings, name, map, Vec::new(), 1);
        let patches: Vec<_> = std::iter::from_fn(|| mapper.take_patch()).collect();
        ctx.map.observe(Stamp(1), Some(mapper.info()), &patches);
        ctx.robot.step(Stamp(1), &mut ctx.asks);
        let (ticket, ask) = ctx.asks.take_new().pop().unwrap();
        assert!(matches!(ask, Ask::EdgeInfo(_)));
        let info = InfoReply {
            component: "edge".into(),
            version: "0".into(),
            schema: zenav_protocol::SCHEMA_VERSION,
            robot: "tiago".into(),
            model: Some(zenav_fixtures::robot("tiago")),
            ..InfoReply::default()
        };
        ctx.asks.answer(ticket, Ok(Answer::EdgeInfo(Box::new(info))));
        ctx.robot.step(Stamp(2), &mut ctx.asks);
        let text = format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"Main\">{node}</BehaviorTree></root>");
        Stand {
            tree: build(&text).unwrap_or_else(|error| panic!("{error}")),
            ctx,
            ms: 1000,
            pose: Pose2::IDENTITY,
            covariance: [0.0; 9],
            velocity: Twist2::ZERO,
            events: Vec::new(),
        }
    }

    /// Sets an entry on the blackboard.
    fn with(mut self, key: &str, value: &str) -> Stand {
        self.tree.blackboard_mut().set(key, value).unwrap();
        self
    }

    fn at(&mut self, x: f64, y: f64) -> &mut Stand {
        self.pose = Pose2::new(x, y, 0.0);
        self
    }

    /// Advances the time by `secs`, then ticks.
    fn after(&mut self, secs: f64) -> Status {
        self.ms += (secs * 1e3) as u64;
        let now = Stamp::from_secs(self.ms as f64 * 1e-3);
        self.ctx.now = now;
        let pose = PoseEstimate {
            stamp: now,
            map_from_base: self.pose,
            covariance: self.covariance,
            velocity: self.velocity,
            frame: 0,
        };
        let state = EdgeState {
            velocity: self.velocity,
            ..state(now)
        };
        self.ctx.robot.hear(now, &std::mem::take(&mut self.events));
        self.ctx.robot.observe(now, Some(state), Some(pose));
        self.ctx.settle();
        self.tree.tick(Duration::from_millis(self.ms), &mut self.ctx).unwrap()
    }

    fn now(&mut self) -> Status {
        self.after(0.05)
    }

    fn entry(&self, key: &str) -> String {
        self.tree
            .blackboard()
            .get(key)
            .map(Value::to_string)
            .unwrap_or_default()
    }

    /// The map's frame that a path on the blackboard is of.
    fn frame(&self, key: &str) -> Option<u64> {
        parse_path(self.tree.blackboard().get(key).unwrap()).unwrap().frame
    }

    /// Corners of a path on the blackboard.
    fn path(&self, key: &str) -> Vec<(f64, f64)> {
        self.driven(key).0
    }

    /// Its corners, and its legs that are driven backwards.
    fn driven(&self, key: &str) -> (Vec<(f64, f64)>, Vec<usize>) {
        let path = parse_path(self.tree.blackboard().get(key).unwrap()).unwrap();
        let corners = path.points.iter().map(|point| (point.x, point.y));
        (corners.collect(), path.backwards)
    }
}

fn state(now: Stamp) -> EdgeState {
    EdgeState {
        stamp: now,
        boot_id: "b".into(),
        link: Link::Connected,
        battery: 0.15,
        uplink: 1.0,
        ..EdgeState::default()
    }
}

/// Five metres along x, then three along y.
const PATH: &str = "[[0,0],[5,0],[5,3]]";

/// A path with legs that are driven backwards, as on the blackboard.
fn path_with(corners: &[(f64, f64)], backwards: &[usize]) -> String {
    let path = DrivenPath {
        points: corners.iter().map(|(x, y)| Point2::new(*x, *y)).collect(),
        backwards: backwards.to_vec(),
    };
    serde_json::to_string(&RouteData::of(path, None)).unwrap()
}

/// Four metres along x, two backwards along -y, then two along -x.
fn back() -> String {
    path_with(&[(0.0, 0.0), (4.0, 0.0), (4.0, -2.0), (2.0, -2.0)], &[1])
}

#[test]
fn is_goal_nearby_goes_by_the_way_left_not_by_the_distance() {
    let mut stand = Stand::new(r#"<IsGoalNearby path="{path}" proximity_threshold="4.0"/>"#).with("path", PATH);
    assert_eq!(stand.at(2.0, 0.0).now(), Failure, "six metres");
    assert_eq!(stand.at(3.9, 0.1).now(), Failure);
    assert_eq!(stand.at(4.2, 0.1).now(), Success);
    let mut empty = Stand::new(r#"<IsGoalNearby path="{path}"/>"#).with("path", "[]");
    assert_eq!(empty.now(), Failure, "an empty path");
}

#[test]
fn is_goal_nearby_with_a_bound_does_not_jump_ahead_where_the_path_comes_back() {
    let node = |bound: &str| {
        format!(r#"<IsGoalNearby path="{{path}}" proximity_threshold="2.0" max_robot_pose_search_dist="{bound}"/>"#)
    };
    let back = "[[0,0],[4,0],[4,0.4],[0,0.4]]";
    let mut bounded = Stand::new(&node("1.5")).with("path", back);
    assert_eq!(bounded.at(0.5, 0.0).now(), Failure);
    assert_eq!(bounded.at(1.0, 0.3).now(), Failure, "on the way out");
    let mut free = Stand::new(&node("-1.0")).with("path", back);
    assert_eq!(free.at(1.0, 0.3).now(), Success, "the closest of all");
}

#[test]
fn truncate_path_local_cuts_before_and_behind_the_robot() {
    let node = |forward: &str, backward: &str| {
        format!(
            r#"<TruncatePathLocal input_path="{{path}}" output_path="{{cut}}" distance_forward="{forward}" distance_backward="{backward}"/>"#
        )
    };
    for (forward, backward, expected) in [
        ("-1", "0.0", vec![(2.0, 0.0), (5.0, 0.0), (5.0, 3.0)]),
        ("1.5", "1.0", vec![(1.0, 0.0), (3.5, 0.0)]),
        ("-1", "-1", vec![(0.0, 0.0), (5.0, 0.0), (5.0, 3.0)]),
    ] {
        let mut stand = Stand::new(&node(forward, backward)).with("path", PATH);
        assert_eq!(stand.at(2.0, 0.2).now(), Success);
        assert_eq!(stand.path("cut"), expected, "{forward} {backward}");
    }
}

#[test]
fn truncate_path_cuts_its_end_and_leaves_at_least_a_point() {
    let mut stand =
        Stand::new(r#"<TruncatePath input_path="{path}" output_path="{cut}" distance="4.0"/>"#).with("path", PATH);
    assert_eq!(stand.now(), Success);
    assert_eq!(stand.path("cut"), [(0.0, 0.0), (4.0, 0.0)]);
    let mut all =
        Stand::new(r#"<TruncatePath input_path="{path}" output_path="{cut}" distance="40.0"/>"#).with("path", PATH);
    assert_eq!(all.now(), Success);
    assert_eq!(all.path("cut"), [(0.0, 0.0)]);
}

#[test]
fn a_cut_path_keeps_which_of_its_legs_are_driven_backwards() {
    for (forward, backward, expected) in [
        ("-1", "0.0", (vec![(4.0, -1.0), (4.0, -2.0), (2.0, -2.0)], vec![0])),
        ("0.5", "2.0", (vec![(3.0, 0.0), (4.0, 0.0), (4.0, -1.5)], vec![1])),
    ] {
        let node = format!(
            r#"<TruncatePathLocal input_path="{{path}}" output_path="{{cut}}" distance_forward="{forward}" distance_backward="{backward}"/>"#
        );
        let mut stand = Stand::new(&node).with("path", &back());
        assert_eq!(stand.at(4.0, -1.0).now(), Success);
        assert_eq!(stand.driven("cut"), expected, "{forward} {backward}");
    }
    for (distance, expected) in [
        ("3.0", (vec![(0.0, 0.0), (4.0, 0.0), (4.0, -1.0)], vec![1])),
        ("4.0", (vec![(0.0, 0.0), (4.0, 0.0)], vec![])),
    ] {
        let node = format!(r#"<TruncatePath input_path="{{path}}" output_path="{{cut}}" distance="{distance}"/>"#);
        let mut stand = Stand::new(&node).with("path", &back());
        assert_eq!(stand.now(), Success);
        assert_eq!(stand.driven("cut"), expected, "{distance}");
    }
}

#[test]
fn truncate_path_local_neither_skips_a_reverse_leg_nor_returns_to_it() {
    // One metre back, then ahead over the same ground.
    let path = path_with(&[(0.0, 0.0), (-1.0, 0.0), (15.0, 0.0)], &[0]);
    let node =
        r#"<TruncatePathLocal input_path="{path}" output_path="{cut}" distance_forward="-1" distance_backward="0.0"/>"#;
    let mut stand = Stand::new(node).with("path", &path);
    for (x, expected) in [
        (0.001, (vec![(0.0, 0.0), (-1.0, 0.0), (15.0, 0.0)], vec![0])),
        (-0.5, (vec![(-0.5, 0.0), (-1.0, 0.0), (15.0, 0.0)], vec![0])),
        (-1.0, (vec![(-1.0, 0.0), (15.0, 0.0)], vec![])),
        (-0.5, (vec![(-0.5, 0.0), (15.0, 0.0)], vec![])),
        // A correction sets the robot back.
        (-0.75, (vec![(-0.75, 0.0), (15.0, 0.0)], vec![])),
    ] {
        assert_eq!(stand.at(x, 0.0).now(), Success);
        assert_eq!(stand.driven("cut"), expected, "at {x}");
    }
}

#[test]
fn a_local_cut_tells_how_much_of_it_is_behind_the_robot_also_when_it_is_cut_again() {
    // One metre back, then ahead over the same ground.
    let path = path_with(&[(0.0, 0.0), (-1.0, 0.0), (15.0, 0.0)], &[0]);
    let cut_driven = |stand: &Stand| parse_path(stand.tree.blackboard().get("cut").unwrap()).unwrap().driven;
    // With the default of 4 m behind; to the goal or not.
    for forward in ["-1", "8.0"] {
        let node =
            format!(r#"<TruncatePathLocal input_path="{{path}}" output_path="{{cut}}" distance_forward="{forward}"/>"#);
        let mut stand = Stand::new(&node).with("path", &path);
        for (x, driven) in [(-0.5, 0.5), (-1.0, 1.0), (-0.5, 1.5), (5.0, 4.0)] {
            assert_eq!(stand.at(x, 0.0).now(), Success);
            assert_eq!(cut_driven(&stand), driven, "at {x}");
        }
    }
    let behind = RouteData {
        driven: 1.5,
        ..parse_path(&Value::text(path)).unwrap()
    };
    let mut again = Stand::new(r#"<TruncatePathLocal input_path="{path}" output_path="{cut}"/>"#)
        .with("path", &serde_json::to_string(&behind).unwrap());
    assert_eq!(again.at(-0.5, 0.0).now(), Success);
    assert_eq!(cut_driven(&again), 1.5);
}

#[test]
fn joined_paths_keep_which_of_their_legs_are_driven_backwards() {
    // A corner of the first path is there twice, and the second path begins where the first one ends.
    let first = path_with(&[(0.0, 0.0), (2.0, 0.0), (2.0, 0.0), (1.0, 0.0)], &[2]);
    let second = path_with(&[(1.0, 0.0), (0.0, 0.0), (0.0, 1.0)], &[0]);
    let mut stand = Stand::new(r#"<ConcatenatePaths input_path1="{a}" input_path2="{b}" output_path="{joined}"/>"#)
        .with("a", &first)
        .with("b", &second);
    assert_eq!(stand.now(), Success);
    let corners = vec![(0.0, 0.0), (2.0, 0.0), (1.0, 0.0), (0.0, 0.0), (0.0, 1.0)];
    assert_eq!(stand.driven("joined"), (corners, vec![1, 2]));
}

#[test]
fn paths_that_are_cut_joined_or_read_keep_their_frame_or_are_carried_over_to_the_present_one() {
    let told = |frame: u64, corners: &[(f64, f64)]| {
        let path = RouteData {
            frame: Some(frame),
            ..parse_path(&Value::text(path_with(corners, &[]))).unwrap()
        };
        serde_json::to_string(&path).unwrap()
    };
    // The map is in frame 0; in frame 1 everything lies a metre farther to the left.
    let stand = |node: &str| {
        let mut stand = Stand::new(node);
        let moved = Pose2::new(0.0, 1.0, 0.0);
        for (frame, moves, part) in [(0, vec![], Pose2::IDENTITY), (1, vec![moved], moved)] {
            let map = MapRef {
                id: "m".into(),
                revision: 0,
                frame,
            };
            stand.ctx.frames.observe(MapFrame {
                map,
                moves,
                parts: vec![part],
                ..MapFrame::default()
            });
        }
        stand
    };
    let later = told(1, &[(0.0, 1.0), (5.0, 1.0)]);

    let mut cut =
        stand(r#"<TruncatePath input_path="{path}" output_path="{cut}" distance="1.0"/>"#).with("path", &later);
    assert_eq!(cut.now(), Success);
    assert_eq!(
        (cut.path("cut"), cut.frame("cut")),
        (vec![(0.0, 1.0), (4.0, 1.0)], Some(1))
    );

    let mut local = stand(
        r#"<TruncatePathLocal input_path="{path}" output_path="{cut}" distance_forward="1.5" distance_backward="0.0"/>"#,
    )
    .with("path", &later);
    assert_eq!(local.at(2.0, 0.2).now(), Success);
    assert_eq!(
        (local.path("cut"), local.frame("cut")),
        (vec![(2.0, 0.0), (3.5, 0.0)], Some(0))
    );

    let mut end = stand(r#"<GetPoseFromPath path="{path}" index="-1" pose="{pose}"/>"#).with("path", &later);
    assert_eq!((end.now(), end.entry("pose").as_str()), (Success, "5;0"));

    let join = |first: &str, second: &str| {
        stand(r#"<ConcatenatePaths input_path1="{a}" input_path2="{b}" output_path="{joined}"/>"#)
            .with("a", first)
            .with("b", second)
    };
    let mut joined = join(&later, &told(0, &[(5.0, 0.0), (6.0, 0.0)]));
    assert_eq!(joined.now(), Success);
    let corners = vec![(0.0, 0.0), (5.0, 0.0), (6.0, 0.0)];
    assert_eq!((joined.path("joined"), joined.frame("joined")), (corners, Some(0)));
    assert_eq!(
        join(&later, &told(9, &[(5.0, 0.0), (6.0, 0.0)])).now(),
        Failure,
        "of an unknown frame"
    );
}

#[test]
fn the_pose_on_a_leg_that_is_driven_backwards_faces_the_other_way() {
    let node = r#"<GetPoseFromPath path="{path}" index="1" pose="{pose}"/>"#;
    let mut stand = Stand::new(node).with("path", &back());
    assert_eq!(stand.now(), Success);
    let yaw: f64 = stand.entry("pose").rsplit(';').next().unwrap().parse().unwrap();
    assert!((yaw - std::f64::consts::FRAC_PI_2).abs() < 1e-9, "{yaw}");
}

#[test]
fn validate_path_fails_where_the_body_does_not_fit_and_lists_the_places() {
    let map = zenav_fixtures::map_where(SPEC, |at| (at.x - 3.05).abs() < 0.05 && (at.y - 0.25).abs() < 0.05);
    let node = r#"<ValidatePath path="{path}" collision_poses="{bad}" stop_at_first_collision="false"/>"#;
    let mut stand = Stand::on(node, &map).with("path", "[[0,0],[5,0]]");
    assert_eq!(stand.now(), Failure);
    let places: Vec<Point2<f64>> = serde_json::from_str(&stand.entry("bad")).unwrap();
    assert!(
        places.len() > 3 && places.iter().all(|place| (place.x - 3.0).abs() < 0.5),
        "{places:?}"
    );
    let mut beside = Stand::on(node, &map).with("path", "[[0,-0.5],[5,-0.5]]");
    assert_eq!(beside.now(), Success);
    let mut ahead =
        Stand::on(r#"<ValidatePath path="{path}" max_lookahead_distance="1.5"/>"#, &map).with("path", "[[0,0],[5,0]]");
    assert_eq!(ahead.now(), Success, "far ahead");
    assert_eq!(ahead.at(1.5, 0.0).now(), Failure);
    for (way, answer) in [("[[0,0],[5,0]]", Failure), ("[[0,-0.5],[5,-0.5]]", Success)] {
        let mut older = Stand::on(r#"<IsPathValid path="{path}"/>"#, &map).with("path", way);
        assert_eq!(older.now(), answer, "by its name in older releases");
    }
}

#[test]
fn validate_path_takes_the_unknown_for_an_obstacle_only_if_asked() {
    let out = "[[0,0],[0,20]]";
    let mut stand = Stand::new(r#"<ValidatePath path="{path}"/>"#).with("path", out);
    assert_eq!(stand.now(), Success);
    let mut strict =
        Stand::new(r#"<ValidatePath path="{path}" consider_unknown_as_obstacle="true"/>"#).with("path", out);
    assert_eq!(strict.now(), Failure);
}

#[test]
fn path_expiring_timer_counts_from_the_last_path_and_again_after_each_success() {
    let mut stand = Stand::new(r#"<PathExpiringTimer seconds="2" path="{path}"/>"#).with("path", PATH);
    assert_eq!(
        (stand.now(), stand.after(1.9), stand.after(0.2)),
        (Failure, Failure, Success)
    );
    assert_eq!((stand.now(), stand.after(2.0)), (Failure, Success));
    stand.tree.blackboard_mut().set("path", "[[0,0],[1,1]]").unwrap();
    assert_eq!(
        (stand.now(), stand.after(1.0), stand.after(1.1)),
        (Failure, Failure, Success)
    );
}

#[test]
fn time_expired_and_distance_traveled_hold_once_and_begin_again() {
    // A parent that does not reset its condition.
    let asked =
        |node: &str| format!("<WhileDoElse>{node}<Sleep msec=\"100000\"/><Sleep msec=\"100000\"/></WhileDoElse>");
    let told = |stand: &Stand| stand.tree.report()[1].last;
    let mut time = Stand::new(&asked(r#"<TimeExpired seconds="1.0"/>"#));
    let mut answers = Vec::new();
    for step in [0.0, 0.9, 0.2, 0.5, 0.6] {
        time.after(step);
        answers.push(told(&time));
    }
    assert_eq!(answers, [Failure, Failure, Success, Failure, Success]);
    let mut way = Stand::new(&asked(r#"<DistanceTraveled distance="1.0"/>"#));
    let mut answers = Vec::new();
    for x in [0.0, 0.9, 1.1, 1.9, 2.2] {
        way.at(x, 0.0).now();
        answers.push(told(&way));
    }
    assert_eq!(answers, [Failure, Failure, Success, Failure, Success]);
}

#[test]
fn path_tracking_bounds_hold_for_both_sides_and_without_feedback() {
    let node = r#"<IsWithinPathTrackingBounds max_error_left="0.4" max_error_right="0.2" max_error_heading="0.5" tracking_feedback="{t}"/>"#;
    assert_eq!(Stand::new(node).now(), Success, "nothing is known");
    for (aside, heading, expected) in [
        (0.3, 0.0, Success),
        (0.5, 0.0, Failure),
        (-0.3, 0.0, Failure),
        (-0.1, -0.6, Failure),
        (-0.1, 0.4, Success),
    ] {
        let feedback = format!(r#"{{"position_tracking_error": {aside}, "heading_tracking_error": {heading}}}"#);
        assert_eq!(Stand::new(node).with("t", &feedback).now(), expected, "{feedback}");
    }
}

#[test]
fn is_stuck_tells_a_bump_for_a_second() {
    let mut stand = Stand::new("<IsStuck/>");
    assert_eq!(stand.now(), Failure);
    stand.events.push(Event {
        stamp: Stamp(1),
        boot_id: "b".into(),
        sequence: 1,
        kind: EventKind::Bumped,
    });
    assert_eq!(
        (stand.now(), stand.after(0.9), stand.after(0.3)),
        (Success, Success, Failure)
    );
}

#[test]
fn remove_passed_goals_drops_leading_ones_never_the_last_and_marks_them() {
    let node = r#"<RemovePassedGoals radius="0.7" input_goals="{goals}" output_goals="{goals}" input_waypoint_statuses="{s}" output_waypoint_statuses="{s}"/>"#;
    let mut stand = Stand::new(node).with("goals", "0.5;0|0.6;0|5;0|0.1;0");
    let open = serde_json::json!([{"waypoint_status": 0}, {"waypoint_status": 0}, {"waypoint_status": 0}, {"waypoint_status": 0}]);
    stand
        .tree
        .blackboard_mut()
        .set("s", Value::data(&open).unwrap())
        .unwrap();
    assert_eq!(stand.now(), Success);
    let left = |stand: &Stand| stand.entry("goals");
    assert!(
        left(&stand).contains("5;0") && !left(&stand).contains("0.6;0"),
        "{}",
        left(&stand)
    );
    let marked: serde_json::Value = serde_json::from_str(&stand.entry("s")).unwrap();
    let marks: Vec<u64> = marked
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one["waypoint_status"].as_u64().unwrap())
        .collect();
    assert_eq!(marks, [1, 1, 0, 0]);
    assert_eq!(stand.at(5.0, 0.0).now(), Success);
    assert_eq!(stand.at(0.1, 0.0).now(), Success, "the last one stays");
    assert!(left(&stand).contains("0.1;0"));
}

#[test]
fn a_selector_takes_what_its_topic_says_else_the_default_else_it_fails() {
    let node = r#"<PlannerSelector selected_planner="{p}" default_planner="GridBased" topic_name="planner_selector"/>"#;
    let mut stand = Stand::new(node);
    assert_eq!((stand.now(), stand.entry("p").as_str()), (Success, "GridBased"));
    let mut told = Stand::new(node).with("planner_selector", "theta");
    assert_eq!((told.now(), told.entry("p").as_str()), (Success, "theta"));
    assert_eq!(
        Stand::new(r#"<GoalCheckerSelector selected_goal_checker="{p}"/>"#).now(),
        Failure
    );
}

#[test]
fn a_robot_whose_beams_pass_through_walls_has_not_arrived_though_it_takes_itself_to_be_there() {
    for (health, answer, code) in [(Health::Contradicted, Failure, "102"), (Health::Tracking, Success, "0")] {
        let node = r#"<FollowPath path="{path}" error_code_id="{code}"/>"#;
        let mut stand = Stand::new(node).with("path", "[[1,0],[0,0]]");
        let said = Localisation {
            stamp: Stamp(1),
            boot_id: "b".into(),
            health,
            map_from_base: Pose2::IDENTITY,
            agreeing: 0.3,
            through_walls: 0.4,
        };
        stand.ctx.robot.observe_localisation(Stamp(1), said);
        assert_eq!((stand.now(), stand.entry("code").as_str()), (answer, code));
    }
}

/// The scans leave the position open along x.
fn open_along_x() -> Localisation {
    Localisation {
        stamp: Stamp(1),
        boot_id: "b".into(),
        health: Health::Degraded { direction: 0.0 },
        map_from_base: Pose2::IDENTITY,
        agreeing: 0.9,
        through_walls: 0.0,
    }
}

#[test]
fn a_robot_that_is_unsure_of_its_place_at_the_goal_waits_for_a_correction_and_then_fails() {
    let unsure = [0.0784, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4];
    for (corrected, code) in [(false, "102"), (true, "0")] {
        let mut stand =
            Stand::new(r#"<FollowPath path="{path}" error_code_id="{code}"/>"#).with("path", "[[1,0],[0,0]]");
        stand.ctx.goal.tolerance = 0.1;
        stand.covariance = unsure;
        for secs in [0.05, 5.0, 5.0] {
            stand.ctx.robot.observe_localisation(stand.ctx.now, open_along_x());
            assert_eq!(stand.after(secs), Running);
        }
        let step = stand.ctx.goal.feedback.step.clone();
        assert!(step.contains("3 sigma is 0.8 m, the goal asks for 0.1 m"), "{step}");
        if corrected {
            stand.covariance = [0.0; 9];
        }
        let answer = if corrected { Success } else { Failure };
        assert_eq!((stand.after(3.0), stand.entry("code").as_str()), (answer, code));
    }
}

#[test]
fn a_map_that_slam_draws_shares_the_error_of_the_robot_which_arrives_at_once() {
    let mut stand = Stand::new(r#"<FollowPath path="{path}"/>"#).with("path", "[[1,0],[0,0]]");
    stand.covariance = [1.0, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4];
    stand.ctx.robot.observe_localisation(stand.ctx.now, open_along_x());
    stand.ctx.frames.observe(MapFrame {
        map: MapRef::new("m", 1),
        parts: vec![Pose2::IDENTITY],
        ..MapFrame::default()
    });
    assert_eq!(stand.now(), Success);
}

#[test]
fn check_stop_status_waits_for_a_second_of_rest_and_fails_while_it_moves() {
    let mut stand = Stand::new("<CheckStopStatus/>");
    assert_eq!(
        (stand.now(), stand.after(0.9), stand.after(0.2)),
        (Running, Running, Success)
    );
    stand.velocity = Twist2::new(0.3, 0.0);
    assert_eq!(stand.now(), Failure);
}

#[test]
fn what_is_missing_is_told_with_the_name_of_the_node_once() {
    let mut stand = Stand::new("<DockRobot/>");
    assert_eq!(stand.now(), Failure);
    let why = stand.ctx.goal.failure.as_deref();
    assert_eq!(why, Some("DockRobot: this stack does not have docking"));
}

#[test]
fn poses_batteries_and_transforms_are_told() {
    let mut near = Stand::new(r#"<ArePosesNear target_pose="{t}" tolerance="0.5"/>"#).with("t", "1;1");
    assert_eq!(near.now(), Failure);
    assert_eq!(near.at(1.2, 0.8).now(), Success);
    assert_eq!(Stand::new(r#"<IsBatteryLow min_battery="0.2"/>"#).now(), Success);
    assert_eq!(Stand::new(r#"<IsBatteryLow min_battery="0.1"/>"#).now(), Failure);
    assert_eq!(Stand::new("<TransformAvailable/>").now(), Success);
    assert_eq!(Stand::new(r#"<ToggleCollisionMonitor enable="false"/>"#).now(), Failure);
    let mut here = Stand::new(r#"<GetCurrentPose current_pose="{p}"/>"#);
    assert_eq!((here.at(1.0, 2.0).now(), here.entry("p").as_str()), (Success, "1;2;0"));
}

#[test]
fn every_node_of_nav2_can_stand_in_a_mission_tree_with_all_its_ports() {
    fn nodes<C>(registry: &Registry<C>) -> String {
        let specs = registry.specs().filter(|spec| spec.category != Category::SubTree);
        let node = |spec: &NodeSpec| {
            let value = |port: &PortSpec| match &port.default {
                Some(default) => default.clone(),
                None if matches!(port.kind, PortType::Script) => "1 == 1".to_owned(),
                None => format!("{{{}_{}}}", spec.id, port.name),
            };
            let ports: String = spec
                .ports
                .iter()
                .map(|port| format!(" {}=\"{}\"", port.name, value(port)))
                .collect();
            let children = "<AlwaysSuccess/>".repeat(spec.children.0);
            format!("<{0}{ports}>{children}</{0}>", spec.id)
        };
        specs.map(node).collect()
    }
    let text = format!(
        "<root BTCPP_format=\"4\"><BehaviorTree ID=\"Main\"><Sequence>{}</Sequence></BehaviorTree></root>",
        nodes(&simulate::registry())
    );
    let none = &mut |_: &str, _: &str| Err("none".to_owned());
    let summary = check::<Context>("all.xml", text.as_bytes(), registry(), none, Limits::default());
    let count = summary.unwrap_or_else(|errors| panic!("{errors}")).trees["Main"];
    assert!(count > 120, "{count}");
    build(&text).unwrap_or_else(|error| panic!("{error}"));
}
