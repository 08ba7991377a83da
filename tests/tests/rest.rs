//! What can a program see of a running robot over HTTP alone? `GET /KEY` on a real router.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::time::Duration;

use serde_json::Value;
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
    let rows = zenav_protocol::topics::TABLE.iter();
    for row in rows.filter(|row| row.asked_by.is_some()) {
        let key = row.pattern.replace("{robot}", ROBOT).replace(['{', '}'], "");
        let asked = get(&format!("/{key}"));
        let name = key.rsplit('/').next().unwrap();
        let shows = [
            "mode", "param", "info", "goals", "map", "localise", "annotate", "log", "part",
        ];
        assert_eq!(asked.status != 405, shows.contains(&name), "{key}: {}", asked.status);
    }
    let everything = get("/zenav/**");
    assert_eq!(everything.status, 200);
    let stops = |value: &Value| value["key"] == "zenav/tiago/edge/state" && value["value"]["stops"] == 0;
    assert!(get("/zenav/*/edge/*").json().as_array().unwrap().iter().any(stops));
    // A page of another site reaches this machine under its own host name.
    assert_eq!(
        request(address, "GET", "/zenav/tiago/edge/pose", "robot.example").status,
        403
    );

    let refused = deployment.zenav(&["router", "--listen", "tcp/127.0.0.1:0", "--rest", "0.0.0.0:0"]);
    let why = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() == Some(2) && why.contains("loopback"), "{why}");
}
