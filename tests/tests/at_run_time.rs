//! Changes to a running robot from the command line: maps, places, zones, parameters, maneuvers, manual requests; each group against one
//! real deployment.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::io::BufRead as _;
use std::process::Output;
use std::time::Duration;

use serde_json::Value;
use zenav_protocol::bus::Bus;
use zenav_protocol::messages::{EdgeState, Mode};
use zenav_tests::deployment::{CORRIDOR, Deployment, ROBOT};
use zenav_tests::observer::Observer;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest wait, wall time: far longer than needed even on a busy machine.
const LONG: Duration = Duration::from_secs(60);
/// Simulated seconds per second.
const SPEED: f64 = 4.0;

/// Runs a client that must exit with `code`; returns its output.
#[track_caller]
fn client(deployment: &Deployment, words: &[&str], code: i32) -> String {
    let output = deployment.client(words);
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let Output { stdout, stderr, .. } = &output;
    assert_eq!(
        output.status.code(),
        Some(code),
        "{words:?}\n{}\n{}",
        text(stdout),
        text(stderr)
    );
    if code == 0 {
        text(stdout)
    } else {
        text(stderr) + &text(stdout)
    }
}

#[track_caller]
fn json(deployment: &Deployment, words: &[&str]) -> Value {
    let words = [words, &["-o", "json"]].concat();
    serde_json::from_str(&client(deployment, &words, 0)).unwrap()
}

/// Completions that a shell offers for the last word typed.
fn offered(words: &[&str]) -> String {
    let output = std::process::Command::new(ZENAV)
        .args(["--", "zenav"])
        .args(words)
        .env("COMPLETE", "bash")
        .env("_CLAP_COMPLETE_INDEX", words.len().to_string())
        .env("_CLAP_IFS", "\n")
        .output()
        .unwrap();
    String::from_utf8(output.stdout).unwrap()
}

/// Runs `zenav map watch` until its picture contains this sign.
fn watched(deployment: &Deployment, sign: &str) {
    let mut watch = std::process::Command::new(ZENAV)
        .args(["map", "watch", "--connect", &deployment.router])
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let lines = std::io::BufReader::new(watch.stdout.take().unwrap()).lines();
    let mut drawn = Vec::new();
    for line in lines.map_while(Result::ok).take(2000) {
        drawn.push(line);
        if drawn.last().is_some_and(|line| line.contains(sign)) {
            break;
        }
    }
    watch.kill().unwrap();
    watch.wait().unwrap();
    let seen = drawn.last().is_some_and(|line| line.contains(sign));
    let last = drawn.split_off(drawn.len().saturating_sub(40));
    assert!(seen, "no {sign} in\n{}", last.join("\n"));
}

/// Waits until a mission commands the robot.
async fn ready(deployment: &Deployment) -> (Bus, Observer) {
    let bus = deployment.bus().await;
    let mut robot = Observer::new(&bus, ROBOT);
    robot
        .until("a mission commands the robot", LONG, |state| state.lease.live)
        .await;
    (bus, robot)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn maps_are_stored_loaded_and_begun_with() {
    let deployment = Deployment::new(ZENAV, "kitchen", SPEED);
    let mut up = deployment.start_up();
    ready(&deployment).await;
    let zenav = |words: &[&str]| json(&deployment, words);
    client(&deployment, &["goal", "submit", "-0.9", "-0.2", "--wait"], 0);

    let stored = zenav(&["map", "store", "mine"]);
    assert_eq!(
        stored["stored"], false,
        "a copy under a name is not the robot's own map: {stored}"
    );
    assert_eq!(zenav(&["map", "list"])[0]["name"], "mine");
    let names = offered(&["map", "load", "--connect", &deployment.router, "mi"]);
    assert!(names.contains("mine"), "{names}");
    let saved = zenav(&["map", "save", "known"]);
    let loaded = zenav(&["map", "load", "mine"]);
    assert!(loaded["id"] != stored["id"] && loaded["stored"] == true, "{loaded}");
    assert_eq!(
        (&loaded["width"], &loaded["occupied"]),
        (&stored["width"], &stored["occupied"])
    );
    let from_file = zenav(&["map", "load", "known.yaml", "--live"]);
    assert_eq!(from_file["width"], stored["width"], "{from_file}");
    for (words, code, what) in [
        (&["map", "load", "moon"][..], 3, "stored map `moon`"),
        (&["map", "load", "no/such.yaml"], 3, "no such map file"),
        (&["map", "store", "a/b"], 2, "A-Z"),
    ] {
        let said = client(&deployment, words, code);
        assert!(said.contains(what), "{words:?}: {said}");
    }
    zenav(&["map", "hold"]);
    zenav(&["map", "resume"]);
    let reset = zenav(&["map", "reset"]);
    assert!(reset["id"] != from_file["id"] && reset["stored"] == false, "{reset}");
    // The mission was interrupted for each of these, and is in command again.
    client(&deployment, &["goal", "submit", "-0.9", "0.1", "--wait"], 0);
    up.assert_running();
    up.until("ready in", LONG);
    assert_eq!(up.interrupt(LONG), Ok(0));
    up.until(&format!("the map of {ROBOT} is not kept: `zenav map store`"), LONG);

    // Another start, with a known map and a pose on it.
    let known = [
        "--map",
        "known.yaml",
        "--pose",
        "-0.9",
        "-0.2",
        "1.5",
        "--data",
        "other",
    ];
    let mut up = deployment.start_up_with(&known);
    let (_bus, mut robot) = ready(&deployment).await;
    robot.next(LONG).await;
    let map = zenav(&["map", "show"]);
    assert_eq!((&map["width"], &map["occupied"]), (&saved["width"], &saved["occupied"]));
    let asked = zenav(&["ask", "ask/cloud/map", r#"{"action": "list"}"#]);
    assert_eq!(asked["info"]["stored"], true, "{asked}");
    let pose = zenav(&["topic", "echo", "edge/pose", "--count", "1"]);
    let at = &pose["payload"]["map_from_base"];
    assert!((at["x"].as_f64().unwrap() + 0.9).abs() < 0.1, "{at}");
    assert!((at["yaw"].as_f64().unwrap() - 1.5).abs() < 0.2, "{at}");
    client(&deployment, &["goal", "submit", "-0.9", "0.1", "--wait"], 0);
    up.assert_running();
    robot.assert_untouched();
    up.until("ready in", LONG);
    assert_eq!(up.interrupt(LONG), Ok(0));
    assert!(!up.log().contains("is not kept"), "this map came from a file");

    let refused = deployment.zenav(&[
        "up",
        "--map",
        "nowhere.yaml",
        "--listen",
        "tcp/127.0.0.1:0",
        "--no-gateway",
    ]);
    assert_eq!(refused.status.code(), Some(3), "{refused:?}");
    let degrees = deployment.zenav(&["up", "--pose", "0", "0", "90"]);
    assert!(
        String::from_utf8_lossy(&degrees.stderr).contains("1.571"),
        "{degrees:?}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn in_a_known_map_a_robot_is_told_where_it_is_and_found_without_being_told() {
    let deployment = Deployment::new(ZENAV, "kitchen", SPEED);
    let mut up = deployment.start_up();
    ready(&deployment).await;
    client(&deployment, &["goal", "submit", "-0.9", "-0.2", "--wait"], 0);
    client(&deployment, &["map", "save", "known"], 0);
    up.kill();

    let sections = "[mapping]\nposes = \"localise\"\nmap = \"known.yaml\"\n";
    let mut up = deployment.start_up_of(sections, &["--data", "other"]);
    let (_bus, mut robot) = ready(&deployment).await;
    robot.next(LONG).await;
    let zenav = |words: &[&str]| json(&deployment, words);
    let start = zenav(&["pose", "show"]);
    assert_eq!(start["health"]["state"], "tracking", "{start}");
    let told = zenav(&["pose", "set", "-0.9", "-0.45", "0.1"]);
    assert!(told["pose"]["x"].as_f64().unwrap() < -0.8, "{told}");
    zenav(&["pose", "search"]);
    let is_found = || {
        let found = zenav(&["pose", "show"]);
        let near = |key: &str, at: f64| (found["pose"][key].as_f64().unwrap() - at).abs() < 0.1;
        found["health"]["state"] == "tracking" && near("x", -1.0) && near("y", -0.5) && near("yaw", 0.0)
    };
    assert!((0..20).any(|_| is_found()), "{}", zenav(&["pose", "show"]));
    client(&deployment, &["goal", "submit", "-0.9", "0.1", "--wait"], 0);
    up.assert_running();
    robot.assert_untouched();
    up.kill();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_zone_that_is_added_bends_the_plan_that_is_driven_and_places_are_goals() {
    let deployment = Deployment::new(ZENAV, CORRIDOR, SPEED);
    let mut up = deployment.start_up();
    let (_bus, mut robot) = ready(&deployment).await;
    let zenav = |words: &[&str]| json(&deployment, words);

    zenav(&["place", "add", "half_way", "6", "0"]);
    assert_eq!(zenav(&["place", "list"])["half_way"]["x"], 6.0);
    // Shell completion of a place's name offers both.
    let names = offered(&["goal", "submit", "--connect", &deployment.router, "--place", ""]);
    assert!(names.contains("half_way") && names.contains("far_end"), "{names}");
    client(&deployment, &["goal", "submit", "--place", "far_end", "--id", "far"], 0);
    robot
        .until("well on its way", LONG, |state| {
            state.mode == Mode::Follow && state.velocity.v > 0.2
        })
        .await;
    // Between the robot and the far end, with space to pass on the left.
    let wet = [
        "zone",
        "add",
        "wet",
        "--keep-out",
        "9",
        "-1.4",
        "10",
        "-1.4",
        "10",
        "0.2",
        "9",
        "0.2",
    ];
    assert_eq!(zenav(&wet)[0]["name"], "wet");
    client(&deployment, &["goal", "watch", "far"], 0);
    watched(&deployment, "◆half_way");
    let plan = robot.plans().last().expect("a plan").clone();
    let entered = |x: f64, y: f64| (9.0..=10.0).contains(&x) && y < 0.2;
    let last = &plan.trajectory;
    assert!(
        !last.iter().any(|point| entered(point.x, point.y)),
        "the plan passes the zone"
    );
    let on_the_left = robot
        .plans()
        .iter()
        .flat_map(|plan| plan.trajectory.iter())
        .any(|point| point.y > 0.4);
    assert!(on_the_left, "some plan went around");
    let refused = client(&deployment, &["goal", "submit", "9.5", "-0.5"], 7);
    assert!(refused.contains("keep-out zone: wet"), "{refused}");

    // Back to a place that was added at run time, slowly through the speed zone.
    zenav(&[
        "zone",
        "add",
        "people",
        "--max-speed",
        "0.15",
        "6.5",
        "-1.4",
        "8.5",
        "-1.4",
        "8.5",
        "1.4",
        "6.5",
        "1.4",
    ]);
    client(
        &deployment,
        &["goal", "submit", "--place", "half_way", "--id", "back"],
        0,
    );
    let mut fastest: f64 = 0.0;
    let for_back = |state: &EdgeState| state.plan.as_ref().is_some_and(|plan| plan.goal_id == "back");
    robot
        .until("it drives back", LONG, |state| {
            state.mode == Mode::Follow && for_back(state)
        })
        .await;
    loop {
        let state = robot.next(LONG).await;
        let x = robot.pose().map_from_base.x;
        if (6.8..8.2).contains(&x) {
            fastest = fastest.max(state.velocity.v);
        }
        if state.mode == Mode::Idle || !for_back(&state) {
            break;
        }
    }
    client(&deployment, &["goal", "watch", "back"], 0);
    assert!(fastest > 0.02 && fastest < 0.2, "{fastest} m/s in a zone of 0.15 m/s");
    robot.assert_untouched();

    let goals = zenav(&["goal", "list"]);
    assert_eq!(goals[0]["id"], "back");
    assert!(goals[0]["feedback"]["final_error"].as_f64().unwrap() < 0.1, "{goals}");
    assert!(goals[0]["age_s"].as_f64().unwrap() > 1.0);
    let table = client(&deployment, &["goal", "list"], 0);
    assert!(table.contains("AGE") && table.contains("cm off"), "{table}");

    // They survive a restart, and can be removed.
    up.kill();
    let mut up = deployment.start_up();
    ready(&deployment).await;
    assert_eq!(zenav(&["zone", "list"]).as_array().unwrap().len(), 2);
    client(
        &deployment,
        &["goal", "submit", "--place", "half_way", "--tolerance", "0.3", "--wait"],
        0,
    );
    zenav(&["place", "remove", "half_way"]);
    let unknown = client(&deployment, &["goal", "submit", "--place", "half_way"], 3);
    assert!(unknown.contains("there are far_end"), "{unknown}");
    zenav(&["zone", "remove", "wet"]);
    assert_eq!(zenav(&["zone", "clear"]).as_array().unwrap().len(), 0);
    for (words, code, what) in [
        (&["zone", "remove", "wet"][..], 3, "zone `wet`"),
        (&["place", "remove", "moon"], 3, "there are far_end"),
        (&["place", "add", "a|b", "0", "0"], 2, "the name"),
        (
            &["zone", "add", "z", "--keep-out", "0", "0", "1", "1", "2", "2"],
            2,
            "zone `z`",
        ),
    ] {
        let said = client(&deployment, words, code);
        assert!(said.contains(what), "{words:?}: {said}");
    }
    up.assert_running();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn parameters_maneuvers_and_requests_by_hand() {
    let deployment = Deployment::new(ZENAV, "empty", SPEED);
    let mut up = deployment.start_up();
    let (_bus, mut robot) = ready(&deployment).await;
    let zenav = |words: &[&str]| json(&deployment, words);

    let before = zenav(&["param", "get", "guard_margin"])["guard_margin"]
        .as_f64()
        .unwrap();
    let set = zenav(&["param", "set", "guard_margin", "0.07"]);
    assert_eq!(
        (set["before"].as_f64(), set["value"].as_f64()),
        (Some(before), Some(0.07))
    );
    assert_eq!(zenav(&["param", "list"])["guard_margin"], 0.07);
    let names = offered(&["param", "get", "--connect", &deployment.router, "guard_m"]);
    assert!(names.contains("guard_margin"), "{names}");
    for (words, code, what) in [
        (&["param", "set", "guard_margin", "-1"][..], 7, "guard_margin"),
        (&["param", "get", "guard_margins"], 3, "guard_margin"),
    ] {
        let said = client(&deployment, words, code);
        assert!(said.contains(what), "{words:?}: {said}");
    }

    let yaw = robot.pose().map_from_base.yaw;
    let spun = zenav(&["do", "spin", "1.0", "--id", "s1"]);
    assert_eq!(
        (&spun["id"], &spun["state"]),
        (&Value::from("s1"), &Value::from("succeeded"))
    );
    let turned = zenav_protocol::geometry::wrap_angle(robot.pose().map_from_base.yaw - yaw);
    assert!((turned - 1.0).abs() < 0.15, "{turned}");
    let again = zenav(&["do", "spin", "1.0", "--id", "s1"]);
    assert_eq!(again["state"], "succeeded", "the same id starts nothing again");
    let still = zenav_protocol::geometry::wrap_angle(robot.pose().map_from_base.yaw - yaw);
    assert!((still - turned).abs() < 0.1, "{still}");
    zenav(&["do", "wait", "0.5"]);
    client(&deployment, &["do", "drive", "0.2", "--speed", "0"], 2);
    // The lease was released: the mission is in command again.
    robot
        .until("a mission commands the robot again", LONG, |state| {
            state.lease.live && state.lease.holder.as_deref() == Some("mission")
        })
        .await;
    client(&deployment, &["stop"], 0);
    client(&deployment, &["do", "spin", "1"], 7);
    client(&deployment, &["resume"], 0);

    let info = zenav(&["ask", "ask/edge/info"]);
    assert_eq!(info["robot"], ROBOT);
    for (words, code, what) in [
        (
            &["ask", "goal", r#"{"x": 0, "y": 0, "tolerence": 1}"#][..],
            2,
            "perhaps `tolerance`",
        ),
        (&["ask", "goal", r#"{"x": "#], 2, "EOF"),
        (&["ask", "goal", r#"{"place": "nowhere"}"#], 3, "nowhere"),
        (&["ask", "gaol", "{}"], 3, "goals"),
        (&["topic", "pub", "cloud/plan", "{}"], 7, "written by mission alone"),
        (&["topic", "pub", "edge/pose", "{}", "--force"], 2, "PoseEstimate"),
        (&["topic", "pub", "operator/teleop", "{}"], 2, "Teleop"),
        (&["topic", "pub", "my/la$*", "{}"], 2, "without wildcards"),
        (&["topic", "echo", "zenav/ti$o/edge/pose"], 2, "zenav/ti$o/edge/pose"),
        (&["topic", "hz", "zenav/ti$o/edge/pose"], 2, "zenav/ti$o/edge/pose"),
        (&["topic", "info", "zenav/ti$o/edge/pose"], 2, "zenav/ti$o/edge/pose"),
    ] {
        let said = client(&deployment, words, code);
        assert!(said.contains(what), "{words:?}: {said}");
    }
    // Zenoh's sign for any letters of a chunk: keys are printed, as with every wildcard.
    let said = client(
        &deployment,
        &["topic", "echo", "zenav/ti$*/edge/pose", "--count", "1"],
        0,
    );
    assert!(said.starts_with("zenav/tiago/edge/pose "), "{said}");
    client(&deployment, &["topic", "pub", "my/lamp", r#"{"on": true}"#], 0);
    client(&deployment, &["ask", "ask/cloud/map?format=pgm", "--out", "map.pgm"], 0);
    assert!(
        std::fs::read(deployment.folder().join("map.pgm"))
            .unwrap()
            .starts_with(b"P5")
    );
    up.assert_running();
}

#[test]
fn schemas_and_node_palettes_need_no_robot() {
    let deployment = Deployment::new(ZENAV, "kitchen", SPEED);
    let run = |words: &[&str]| {
        let output = deployment.zenav(words);
        assert_eq!(output.status.code(), Some(0), "{words:?}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    let schema: Value = serde_json::from_str(&run(&["schema", "GoalRequest"])).unwrap();
    assert!(schema["properties"]["tolerance"]["description"].is_string(), "{schema}");
    assert!(run(&["schema", "--list"]).contains("EdgeState"));
    assert!(run(&["bt", "nodes", "--xml"]).contains("<Action ID=\"FollowPath\">"));
    assert!(run(&["bt", "nodes", "spin"]).contains("Spin (Action)"));
    let unknown = deployment.zenav(&["schema", "GoalRequests"]);
    assert_eq!(unknown.status.code(), Some(3));
    assert!(
        String::from_utf8_lossy(&unknown.stderr).contains("perhaps `GoalRequest`"),
        "{unknown:?}"
    );
}
