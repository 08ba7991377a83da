//! Is bad input refused with a clear answer, without doing harm?

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::time::Duration;

use nalgebra::Point2;
use serde::Serialize;
use serde_json::Value;
use zenav_fixtures::robot;
use zenav_protocol::bus::{Bus, RawReply};
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::GridSpec;
use zenav_protocol::messages::{
    BasedOn, Correction, Heartbeat, MapPatch, MapRef, Plan, PlanStatistics, Refusal, Revision, Scan, Splice, Teleop,
    Tile,
};
use zenav_protocol::robot::shipped;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{self, Producer, TABLE};
use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};
use zenav_sim::World;
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::observer::Observer;
use zenav_tests::process::free_endpoint;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Side of a map's cells, m.
const MAP_CELL: f64 = 0.025;
/// Longest wait for an answer, wall time.
const LONG: Duration = Duration::from_secs(20);
/// Larger than any ask accepts, bytes.
const HUGE: usize = 10_000_000;

/// Whether a refusal is the expected one.
type Fits = fn(&Refusal) -> bool;

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// Undecodable payloads, by name.
fn unreadable() -> Vec<(&'static str, Vec<u8>)> {
    let deep = |open: &str| open.repeat(200_000).into_bytes();
    let huge_text = [b"\"".as_slice(), &vec![b'a'; HUGE], b"\""].concat();
    vec![
        ("no JSON", b"nonsense".to_vec()),
        ("NaN", br#"{"x": NaN, "y": 0.0}"#.to_vec()),
        ("cut off", br#"{"x": 0.0, "y""#.to_vec()),
        ("not UTF-8", vec![0xff, 0xfe, 0x00, 0x9f]),
        ("deep arrays", deep("[")),
        ("deep objects", deep("{\"a\":")),
        (
            "deep in a field that nobody knows",
            [br#"{"x": 0.0, "y": 0.0, "more": "#.as_slice(), &deep("[")].concat(),
        ),
        ("huge bytes", vec![b'x'; HUGE]),
        ("huge text", huge_text),
    ]
}

/// A key of the table, with the robot, a goal or every worker filled in.
fn key(pattern: &str) -> String {
    pattern
        .replace("{robot}", ROBOT)
        .replace("{id}", "some_goal")
        .replace("{worker}", "*")
        .replace("{store}", "*")
        .replace("{part}", "*")
        .replace("{message}", "*")
}

/// The error reply of every server of a key, one each.
async fn refusal(bus: &Bus, key: &str, payload: Vec<u8>) -> Vec<Refusal> {
    let replies = bus.raw_query(key, Some(payload), LONG).await.unwrap();
    let read = |reply: RawReply| match reply {
        RawReply::Err { bytes, .. } => serde_json::from_slice(&bytes)
            .unwrap_or_else(|error| panic!("{key}: {error}: {}", String::from_utf8_lossy(&bytes))),
        RawReply::Ok(sample) => panic!("{key} took it: {}", String::from_utf8_lossy(&sample.bytes)),
    };
    replies.into_iter().map(read).collect()
}

fn cbor(message: &impl Serialize) -> Vec<u8> {
    codec::encode(message, Encoding::Cbor).unwrap()
}

/// Well-formed messages with impossible contents, by key; CBOR can carry what JSON cannot.
fn senseless() -> Vec<(String, Vec<u8>)> {
    let nowhere = Pose2::new(f64::NAN, f64::INFINITY, f64::NAN);
    let scan = Scan {
        stamp: Stamp(u64::MAX),
        angle_min: f64::NAN,
        angle_increment: 0.0,
        range_min: -1.0,
        range_max: f64::NAN,
        ranges: vec![f32::NAN; 10],
        base_from_laser: nowhere,
        map_from_odom: nowhere,
        odom_from_base: nowhere,
        ..Scan::default()
    };
    let far_away = Scan {
        stamp: Stamp::from_secs(1.0),
        angle_min: 0.0,
        angle_increment: 0.1,
        range_max: 1e300,
        ranges: vec![1e30; 10],
        map_from_odom: Pose2::new(1e300, -1e300, 0.0),
        ..Scan::default()
    };
    let correction = Correction {
        stamp: Stamp(u64::MAX),
        boot_id: "x".repeat(1000),
        map_from_base: nowhere,
        covariance: [f64::NAN; 9],
        is_found_anew: false,
        frame: 0,
        moves: Vec::new(),
    };
    let spec = GridSpec {
        origin: Point2::new(f64::NAN, 1e300),
        resolution: -0.0,
        width: u32::MAX,
        height: u32::MAX,
    };
    let patch = MapPatch {
        stamp: Stamp(u64::MAX),
        map: MapRef {
            id: "huge".into(),
            revision: u64::MAX,
            frame: 0,
        },
        base_revision: 0,
        spec,
        tiles: vec![Tile {
            x: u32::MAX,
            y: u32::MAX,
            values: vec![0; 3],
        }],
    };
    let plan = Plan {
        goal_id: "x".repeat(1000),
        epoch: u64::MAX,
        revision: Revision {
            incarnation: u64::MAX,
            counter: u64::MAX,
        },
        trajectory_id: u64::MAX,
        map: MapRef::default(),
        frame: "map".into(),
        based_on: BasedOn {
            stamp: Stamp(u64::MAX),
            boot_id: String::new(),
        },
        valid_for: f64::NAN,
        waypoints: vec![Point2::new(f64::NAN, f64::INFINITY)],
        trajectory: Trajectory::new(vec![TrajectoryPoint {
            t: f64::NAN,
            x: f64::NAN,
            y: 0.0,
            yaw: 0.0,
            v: f64::INFINITY,
            w: 0.0,
        }]),
        splice: Some(Splice {
            trajectory_id: 0,
            time: f64::NAN,
        }),
        statistics: PlanStatistics::default(),
    };
    let twist = zenav_protocol::geometry::Twist2::new(f64::NAN, f64::INFINITY);
    let teleop = Teleop {
        epoch: u64::MAX,
        twist,
        echo: Stamp(u64::MAX),
    };
    let heartbeat = Heartbeat {
        holder: "x".repeat(1000),
        epoch: u64::MAX,
        counter: u64::MAX,
        echo: None,
    };
    let robot = &[ROBOT];
    vec![
        (topics::SCAN.key(robot), cbor(&scan)),
        (topics::SCAN.key(robot), cbor(&far_away)),
        (topics::CORRECTION.key(robot), cbor(&correction)),
        (topics::MAP_PATCH.key(robot), cbor(&patch)),
        (topics::PLAN.key(robot), cbor(&plan)),
        (topics::TELEOP.key(robot), cbor(&teleop)),
        (topics::HEARTBEAT.key(robot), cbor(&heartbeat)),
    ]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn every_ask_refuses_and_every_topic_ignores_what_cannot_be_read_and_the_robot_still_drives() {
    let deployment = Deployment::new(ZENAV, "kitchen", 8.0);
    let mut up = deployment.start_up();
    let bus = deployment.bus().await;
    let mut robot = Observer::new(&bus, ROBOT);
    // After a drive all parts are certain to be running.
    let drive = |x: &str, y: &str| {
        let output = deployment.client(&["goal", "submit", "--wait", x, y]);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
    };
    drive("-0.9", "-0.2");

    let payloads = unreadable();
    // No world is served here: the robot's own process simulates it.
    for row in TABLE
        .iter()
        .filter(|row| row.qos.is_none() && row.producer != Producer::Sim)
    {
        let key = key(row.pattern);
        for (name, payload) in &payloads {
            let too_large = payload.len() > row.max_bytes;
            let refusals = refusal(&bus, &key, payload.clone()).await;
            assert!(!refusals.is_empty(), "{key}: {name}: no answer");
            for refusal in refusals {
                let fits = match &refusal {
                    Refusal::TooLarge { limit } => too_large && *limit == row.max_bytes,
                    Refusal::BadRequest { reason } => !too_large && !reason.is_empty(),
                    _ => false,
                };
                assert!(fits, "{key}: {name}: {refusal:?}");
            }
        }
    }
    for row in TABLE.iter().filter(|row| row.qos.is_some()) {
        for (_, payload) in &payloads {
            for encoding in ["application/json", "application/cbor", "text/plain"] {
                // One huge payload is enough.
                if payload.len() < HUGE || encoding == "application/json" {
                    bus.raw_put(&key(row.pattern), payload.clone(), encoding).unwrap();
                }
            }
        }
    }
    for (key, bytes) in senseless() {
        bus.raw_put(&key, bytes, "application/cbor").unwrap();
    }
    drive("-0.9", "0.3");

    // Readable requests with impossible contents.
    let bad: Fits = |refusal| matches!(refusal, Refusal::BadRequest { .. });
    let goals: [(&str, Fits); 8] = [
        ("{}", bad),
        (r#"{"x": "one", "y": 0}"#, bad),
        (r#"{"x": 1e999, "y": 0}"#, bad),
        (r#"{"x": 0, "y": 0, "id": "a/b"}"#, bad),
        (r#"{"x": 0, "y": 0, "tolerance": -1}"#, bad),
        (r#"{"place": "nowhere"}"#, |refusal| {
            matches!(refusal, Refusal::NotFound { .. })
        }),
        (
            r#"{"x": 90000, "y": 0}"#,
            |refusal| matches!(refusal, Refusal::Rejected { reason, .. } if reason.contains("outside")),
        ),
        (
            r#"{"tree": "<root BTCPP_format=\"4\"><BehaviorTree ID=\"A\"><NoSuchNode/></BehaviorTree></root>"}"#,
            |refusal| matches!(refusal, Refusal::BadRequest { reason } | Refusal::Rejected { reason, .. } if reason.contains("NoSuchNode")),
        ),
    ];
    for (goal, fits) in goals {
        let refusals = refusal(&bus, &topics::GOAL.key(&[ROBOT]), goal.as_bytes().to_vec()).await;
        assert!(refusals.len() == 1 && refusals.iter().all(fits), "{goal}: {refusals:?}");
    }
    robot.assert_untouched();
    up.assert_running();
}

#[test]
fn a_goal_that_cannot_be_and_a_robot_that_is_not_have_their_own_exit_codes() {
    let deployment = Deployment::new(ZENAV, "kitchen", 8.0);
    let mut up = deployment.start_up();
    tokio::runtime::Runtime::new()
        .unwrap()
        .block_on(async { deployment.bus().await.close().await });
    let first = deployment.client(&["goal", "submit", "--wait", "-0.9", "-0.3"]);
    assert_eq!(first.status.code(), Some(0), "{first:?}");

    // On the left face of the table, in full view of the lidar.
    let in_a_wall = deployment.client(&["goal", "submit", "-o", "json", "-0.6", "-1.5"]);
    assert_eq!(in_a_wall.status.code(), Some(7), "{in_a_wall:?}");
    let answer: Value = serde_json::from_slice(&in_a_wall.stdout).unwrap();
    assert_eq!(answer["state"], "Rejected");
    assert!(answer["reason"].as_str().unwrap().contains("occupied"), "{answer}");
    let near = Pose2::new(
        number(&answer["nearest_free"]["x"]),
        number(&answer["nearest_free"]["y"]),
        0.0,
    );
    assert!((near.x + 0.6).hypot(near.y + 1.5) < 0.5, "{answer}");
    // Also free in the true world, to within a cell: the map has the table's face from noisy ranges.
    let footprint = robot("tiago").footprint;
    let clearance = World::shipped("kitchen").unwrap().clearance(&footprint, near);
    assert!(clearance > -MAP_CELL, "{clearance} m: {answer}");

    let outside = deployment.client(&["goal", "submit", "-o", "json", "1000", "0"]);
    assert_eq!(outside.status.code(), Some(7), "{outside:?}");
    assert!(
        String::from_utf8_lossy(&outside.stdout).contains("outside"),
        "{outside:?}"
    );

    let nobody = deployment.client(&["goal", "submit", "--robot", "nobody", "0", "0"]);
    assert_eq!(nobody.status.code(), Some(3), "{nobody:?}");
    assert!(
        String::from_utf8_lossy(&nobody.stderr).contains(ROBOT),
        "it names who is there: {nobody:?}"
    );

    let there = deployment.client(&["goal", "submit", "--wait", "-0.9", "0.1"]);
    assert_eq!(there.status.code(), Some(0), "{there:?}");
    up.assert_running();
}

#[test]
fn without_a_router_commands_say_so_at_once() {
    let deployment = Deployment::new(ZENAV, "kitchen", 1.0);
    let nobody = free_endpoint();
    for command in [
        &["goal", "submit", "0", "0"][..],
        &["goal", "list"],
        &["stop"],
        &["topic", "list"],
        &["map", "show"],
    ] {
        let mut all = command.to_vec();
        all.extend(["--connect", &nobody]);
        let output = deployment.zenav(&all);
        assert_eq!(output.status.code(), Some(4), "{command:?}: {output:?}");
        assert!(
            String::from_utf8_lossy(&output.stderr).contains(&nobody),
            "{command:?}: {output:?}"
        );
    }
}

#[test]
fn a_file_with_an_unknown_key_is_refused_with_file_line_and_key() {
    let deployment = Deployment::new(ZENAV, "kitchen", 1.0);
    let write = |name: &str, text: &str| std::fs::write(deployment.folder().join(name), text).unwrap();
    write(
        "world.toml",
        "name = \"w\"\nsize = [5.0, 5.0]\norigin = [0.0, 0.0]\ncolour = \"red\"\n",
    );
    write(
        "robot.toml",
        &shipped("tiago").unwrap().replacen('\n', "\nwheelbase = 1.0\n", 1),
    );
    write(
        "tree.xml",
        "<root BTCPP_format=\"4\">\n  <BehaviorTree ID=\"A\">\n    <Wait wait_duraton=\"1.0\"/>\n  </BehaviorTree>\n</root>\n",
    );
    write("deployment.toml", "[mapping]\nresolutoin = 0.1\n");
    let line_of = |name: &str, word: &str| {
        let text = std::fs::read_to_string(deployment.folder().join(name)).unwrap();
        text.lines().position(|line| line.contains(word)).unwrap() + 1
    };
    let run = ["run", "--goal", "1", "1"];
    for (arguments, file, key) in [
        ([&run[..], &["--world", "world.toml"]].concat(), "world.toml", "colour"),
        (
            [&run[..], &["--robot", "robot.toml"]].concat(),
            "robot.toml",
            "wheelbase",
        ),
        (vec!["edge", "--world", "world.toml"], "world.toml", "colour"),
        (vec!["bt", "validate", "tree.xml"], "tree.xml", "wait_duraton"),
        (vec!["up", "deployment.toml"], "deployment.toml", "resolutoin"),
        (
            [&run[..], &["--deployment", "deployment.toml"]].concat(),
            "deployment.toml",
            "resolutoin",
        ),
    ] {
        let output = deployment.zenav(&arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(file) && said.contains(key), "{arguments:?}: {said}");
        let line = line_of(file, key).to_string();
        assert!(
            said.split(|c: char| !c.is_ascii_digit()).any(|number| number == line),
            "{arguments:?}: line {line}: {said}"
        );
    }
}

#[test]
fn a_truncated_map_file_is_refused_by_name() {
    let deployment = Deployment::new(ZENAV, "kitchen", 1.0);
    let write = |name: &str, bytes: &[u8]| std::fs::write(deployment.folder().join(name), bytes).unwrap();
    write("map.yaml", b"image: map.pgm\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n");
    write("map.pgm", &[b"P5\n100 100\n255\n".as_slice(), &[254; 5000]].concat());
    write("huge.pgm", b"P5\n4000000000 4000000000\n255\n0");
    write(
        "world.toml",
        b"name = \"w\"\nsize = [5.0, 5.0]\norigin = [0.0, 0.0]\n[map]\nyaml = \"map.yaml\"\n",
    );
    write("cut.map", b"type octile\nheight 10\nwidth 10\nmap\n.....\n");
    write("queries.txt", b"1 1 2 2\n");
    let plan = |map: &'static str| {
        vec![
            "plan",
            "--map",
            map,
            "--queries",
            "queries.txt",
            "--planner",
            "astar",
            "--out",
            "out.txt",
        ]
    };
    for (arguments, file) in [
        (plan("map.yaml"), "map.pgm"),
        (plan("map.pgm"), "map.pgm"),
        (plan("huge.pgm"), "huge.pgm"),
        (plan("cut.map"), "cut.map"),
        (vec!["run", "--world", "world.toml", "--goal", "1", "1"], "map.pgm"),
    ] {
        let output = deployment.zenav(&arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(file), "{arguments:?}: {said}");
    }
}
