//! What can a program see of a running robot over HTTP alone? `GET /KEY` on a real router.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::time::Duration;

use serde_json::{Value, json};
use zenav_protocol::topics::TABLE;
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::http::request;
use zenav_tests::observer::Observer;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest wait, wall time: far longer than needed even on a busy machine.
const LONG: Duration = Duration::from_secs(60);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_router_tells_the_value_of_a_key_over_http_and_lets_nobody_write() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let mut up = deployment.start_up_with(&["--rest", "127.0.0.1:0"]);
    let line = up.until("REST: http://", LONG);
    let address = line.split("http://").nth(1).unwrap().split('/').next().unwrap();
    let bus = deployment.bus().await;
    Observer::new(&bus, ROBOT)
        .until("a mission commands the robot", LONG, |state| state.lease.live)
        .await;
    let get = |path: &str| request(address, "GET", path, address);

    let pose = get("/zenav/tiago/edge/pose");
    assert_eq!(pose.status, 200, "{}", pose.head);
    assert!(pose.head.contains("content-type: application/json"), "{}", pose.head);
    assert!(pose.json()["map_from_base"]["x"].is_number(), "{}", pose.json());
    // A topic without new messages returns its retained value, and a key with a queryable is queried.
    assert_eq!(get("/zenav/tiago/cloud/mission").status, 200);
    assert_eq!(get("/zenav/tiago/ask/edge/info").json()["component"], "edge");
    let map = get("/zenav/tiago/ask/cloud/map?format=png");
    assert!(map.head.contains("content-type: image/png"), "{}", map.head);
    assert!(map.body.starts_with(b"\x89PNG"));

    let all = get("/zenav/*/edge/*").json();
    let state = all
        .as_array()
        .unwrap()
        .iter()
        .find(|entry| entry["key"] == "zenav/tiago/edge/state");
    assert!(state.unwrap()["value"]["lease"]["live"].is_boolean(), "{all}");

    let nobody = get("/zenav/moon/edge/pose");
    assert_eq!(
        (nobody.status, &nobody.json()["error"]),
        (404, &Value::from("NotFound"))
    );
    assert_eq!(get("/zenav//edge").status, 400, "no key");
    for path in ["/zenav/ti$o/edge/pose", "/zenav/ti%24o/edge/pose", "/zenav/*/ti$o/pose"] {
        assert_eq!(get(path).status, 400, "{path}: no key");
    }
    let any_letters = get("/zenav/ti$*/edge/state").json();
    assert_eq!(any_letters[0]["key"], "zenav/tiago/edge/state", "{any_letters}");
    assert_eq!(
        get("/zenav/tiago/ask/cloud/map?format=gif").status,
        422,
        "the server's own refusal"
    );
    for method in ["POST", "PUT", "DELETE"] {
        assert_eq!(
            request(address, method, "/zenav/tiago/ask/edge/stop", address).status,
            405
        );
    }
    // Nor by asking: only asks that change nothing are passed on.
    for row in TABLE.iter().filter(|row| row.asked_by.is_some()) {
        let key = row.pattern.replace("{robot}", ROBOT).replace(['{', '}'], "");
        let asked = get(&format!("/{key}"));
        let name = key.rsplit('/').next().unwrap();
        let shows = [
            "mode", "param", "info", "goals", "map", "localise", "annotate", "log", "part", "message",
        ];
        assert_eq!(asked.status != 405, shows.contains(&name), "{key}: {}", asked.status);
    }
    let everything = get("/zenav/**");
    assert_eq!(everything.status, 200);
    let stops = |value: &Value| value["key"] == "zenav/tiago/edge/state" && value["value"]["stops"] == 0;
    assert!(get("/zenav/*/edge/*").json().as_array().unwrap().iter().any(stops));
    let schema = get("/zenav/svc/schema/GoalRequest").json();
    assert_eq!(schema["title"], "GoalRequest", "{schema}");
    // A page of another site reaches this machine under its own host name.
    assert_eq!(
        request(address, "GET", "/zenav/tiago/edge/pose", "robot.example").status,
        403
    );

    let refused = deployment.zenav(&["router", "--listen", "tcp/127.0.0.1:0", "--rest", "0.0.0.0:0"]);
    let why = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() == Some(2) && why.contains("loopback"), "{why}");
}

#[test]
fn a_deployment_without_a_router_refuses_what_only_a_router_answers() {
    let deployment = Deployment::new(ZENAV, "kitchen", 1.0);
    std::fs::write(deployment.folder().join("bare.toml"), "[router]\nenabled = false\n").unwrap();
    for option in ["--scouting", "--rest"] {
        let refused = deployment.zenav(&["up", "bare.toml", option]);
        let why = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(
            refused.status.code() == Some(2) && why.contains(option) && why.contains("router.enabled"),
            "{why}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_plain_zenoh_client_gets_the_schema_of_every_message() {
    let deployment = Deployment::new(ZENAV, "kitchen", 1.0);
    let mut router = deployment.start_router();
    router.until("router up", LONG);
    let mut config = zenoh::Config::default();
    for (setting, value) in [
        ("mode", json!("client")),
        ("connect/endpoints", json!([&deployment.router])),
        ("scouting/multicast/enabled", json!(false)),
    ] {
        config.insert_json5(setting, &value.to_string()).unwrap();
    }
    let session = zenoh::open(config).await.unwrap();
    let get = async |name: &str| {
        let replies = session.get(format!("zenav/svc/schema/{name}")).await.unwrap();
        let reply = replies.recv_async().await.unwrap();
        let (is_schema, bytes) = match reply.result() {
            Ok(sample) => (true, sample.payload().to_bytes()),
            Err(error) => (false, error.payload().to_bytes()),
        };
        (is_schema, serde_json::from_slice::<Value>(&bytes).unwrap())
    };
    for message in TABLE.iter().flat_map(|row| row.message.split(" -> ")) {
        let (is_schema, schema) = get(message).await;
        assert!(is_schema && schema["title"] == message, "{message}: {schema}");
        assert!(schema["$schema"].as_str().unwrap().contains("2020-12"), "{schema}");
    }
    let (_, goal) = get("GoalRequest").await;
    assert!(goal["properties"]["place"]["description"].is_string(), "{goal}");
    let (is_schema, refusal) = get("GoalReguest").await;
    assert!(!is_schema && refusal["error"] == "NotFound", "{refusal}");
}
