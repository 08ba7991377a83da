//! Tests of the gateway on the network.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use zenav_protocol::bus::{Bus, BusConfig};
use zenav_protocol::messages::{EdgeState, GoalPhase, GoalReply, StopReply};
use zenav_protocol::topics::{GOAL, STATE, STOP};

use super::*;
use crate::testing::router;

const DEADLINE: Duration = Duration::from_secs(20);

fn state() -> EdgeState {
    serde_json::from_value(serde_json::json!({
        "stamp": 1, "boot_id": "b", "mode": "follow", "link": "Connected",
        "lease": { "holder": "m", "role": "mission", "epoch": 1, "live": true }, "velocity": { "v": 0.0, "w": 0.0 },
        "guard": "clear", "battery": 0.5
    }))
    .unwrap()
}

/// One request on its own connection: status line and body.
async fn http(address: &str, method: &str, path: &str, body: &str) -> (String, String) {
    let host = address.trim_start_matches("http://").trim_end_matches('/');
    let mut stream = TcpStream::connect(host).await.unwrap();
    let request = format!(
        "{method} {path} HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}",
        body.len()
    );
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut reply = String::new();
    stream.read_to_string(&mut reply).await.unwrap();
    let (head, content) = reply.split_once("\r\n\r\n").unwrap();
    (head.lines().next().unwrap_or_default().to_owned(), content.to_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_s_state_is_served_and_goals_and_stops_reach_it() {
    let (router, endpoint) = router().await;
    let robot = Bus::open(BusConfig::service("robot", &endpoint)).await.unwrap();
    let states = robot.publisher(&STATE, &["tiago"]).unwrap();
    let mut stops = robot.serve(&STOP, &["tiago"]).unwrap();
    let mut goals = robot.serve(&GOAL, &["tiago"]).unwrap();
    let serving = tokio::spawn(async move {
        loop {
            tokio::select! {
                Some(stop) = stops.next() => stop.reply(&StopReply { stopped: true }),
                Some(goal) = goals.next() => {
                    let id = goal.body.id.clone().unwrap();
                    goal.reply(&GoalReply { id, state: GoalPhase::Accepted, reason: None, robot: None });
                }
                else => return,
            }
        }
    });
    let settings = GatewaySettings {
        listen: "127.0.0.1:0".into(),
        ..GatewaySettings::default()
    };
    let config = GatewayConfig {
        settings,
        ..GatewayConfig::default()
    };
    let gateway = Gateway::bind(config).await.unwrap();
    let address = gateway.address().to_owned();
    let shutdown = Shutdown::new();
    let bus = Bus::open(BusConfig::service("gateway", &endpoint)).await.unwrap();
    let running = tokio::spawn(gateway.run(bus, shutdown.clone()));

    let heard = tokio::time::timeout(DEADLINE, async {
        loop {
            // The route to the gateway may not be declared yet: send repeatedly, as a robot does.
            states.put(&state());
            let (_, body) = http(&address, "GET", "/api/v1/robots", "").await;
            if body.contains(r#""mode":"follow""#) {
                return body;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    });
    assert!(heard.await.unwrap().contains(r#""robot":"tiago""#));
    let (status, body) = http(
        &address,
        "POST",
        "/api/v1/robots/tiago/goals",
        r#"{"x": 1.0, "y": 2.0, "id": "g1"}"#,
    )
    .await;
    assert!(
        status.contains("202") && body.contains(r#""id":"g1""#),
        "{status} {body}"
    );
    let (status, body) = http(&address, "POST", "/api/v1/robots/tiago/stop", "").await;
    assert!(
        status.contains("200") && body == r#"{"stopped":true}"#,
        "{status} {body}"
    );

    shutdown.trigger();
    tokio::time::timeout(DEADLINE, running).await.unwrap().unwrap().unwrap();
    serving.abort();
    router.close().await;
}

#[tokio::test]
async fn an_address_that_others_reach_needs_a_token() {
    let settings = |token_file| GatewaySettings {
        listen: "0.0.0.0:0".into(),
        token_file,
        ..GatewaySettings::default()
    };
    let config = |token_file| GatewayConfig {
        settings: settings(token_file),
        ..GatewayConfig::default()
    };
    let refused = Gateway::bind(config(None)).await.unwrap_err().to_string();
    assert!(refused.contains("token"), "{refused}");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("token");
    std::fs::write(&file, "short\n").unwrap();
    assert!(Gateway::bind(config(Some(file.clone()))).await.is_err());
    std::fs::write(&file, "0123456789abcdef\n").unwrap();
    assert!(Gateway::bind(config(Some(file))).await.is_ok());
}
