//! Do robots of several processes share one world? They see and pass one another, and a robot whose edge dies stops.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::process::Output;
use std::time::{Duration, Instant};

use tokio::time::timeout;
use zenav_protocol::bus::{Bus, RawReply};
use zenav_protocol::readings::Readings;
use zenav_protocol::topics;
use zenav_tests::deployment::{CORRIDOR, Deployment};

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest wait, wall time: far longer than needed even on a busy machine.
const LONG: Duration = Duration::from_secs(60);
/// Simulated seconds per second.
const SPEED: f64 = 4.0;

/// One robot that drives, and one that stands in its way.
const TWO: &str = "
[robots.driver]
model = \"tiago\"
listen = \"tcp/127.0.0.1:0\"
attach = true
[robots.bystander]
model = \"turtlebot3_waffle\"
listen = \"tcp/127.0.0.1:0\"
attach = true
start = { x = 7.0, y = 0.1, yaw = 1.0 }
[groups]
all = [\"driver\", \"bystander\"]
";

/// Output of a command once it succeeds: robots and missions may still be starting.
fn retried(command: impl Fn() -> Output) -> Output {
    let deadline = Instant::now() + LONG;
    loop {
        let output = command();
        if output.status.success() || Instant::now() > deadline {
            return output;
        }
    }
}

/// Readings of a robot in order, until `enough`.
async fn listen(bus: &Bus, robot: &str, mut enough: impl FnMut(&[Readings]) -> bool) -> Vec<Readings> {
    let mut subscription = bus.subscribe(&topics::READINGS, &[robot], 256).unwrap();
    let mut heard = Vec::new();
    let listening = async {
        while !enough(&heard) {
            heard.push(subscription.next().await.expect("the bus is open").message);
        }
    };
    timeout(LONG, listening).await.expect("the world goes on");
    heard
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn robots_of_one_served_world_pass_one_another_and_stop_when_their_edge_dies() {
    let deployment = Deployment::new(ZENAV, CORRIDOR, SPEED);
    let mut world = deployment.start_served_world();
    let bus = deployment.bus().await;
    let attach = topics::ATTACH.key(&[]);
    let answers = bus.raw_query(&attach, Some(b"{}".to_vec()), LONG).await.unwrap();
    let [RawReply::Err { bytes, .. }] = &answers[..] else {
        panic!("{answers:?}")
    };
    assert!(
        String::from_utf8_lossy(bytes).contains("robot"),
        "it names the missing field"
    );
    // With two worlds on one bus, each robot would have two bodies.
    let other = deployment.client(&["sim", "serve"]);
    let said = String::from_utf8_lossy(&other.stderr);
    assert!(!other.status.success() && said.contains("served"), "{said}");
    let mut robots = deployment.start_up_attached(TWO);
    // The bystander is the nearer of the two; a repeated request is the same goal.
    let group = [
        "goal",
        "submit",
        "--group",
        "all",
        "--id",
        "step",
        "8",
        "0.4",
        "--timeout",
        "40",
        "-o",
        "json",
    ];
    let stepped = retried(|| deployment.client(&[&group[..], &["--wait"]].concat()));
    let report: serde_json::Value = serde_json::from_slice(&stepped.stdout).unwrap();
    assert_eq!(
        (&report["robot"], &report["state"]),
        (&"bystander".into(), &"Succeeded".into()),
        "{stepped:?}"
    );
    let again: serde_json::Value = serde_json::from_slice(&deployment.client(&group).stdout).unwrap();
    assert_eq!(
        (&again["robot"], &again["state"]),
        (&"bystander".into(), &"Succeeded".into()),
        "{again}"
    );

    let goal = ["goal", "submit", "--robot", "driver", "--timeout", "40"];
    let there = deployment.client(&[&goal[..], &["--place", "far_end", "--wait"]].concat());
    assert_eq!(there.status.code(), Some(0), "{there:?}\n{}", robots.log());
    assert!(!world.log().contains("touched"), "{}", world.log());

    // On the way back everything dies except the world.
    let back = deployment.client(&[&goal[..], &["0.5", "0"]].concat());
    assert_eq!(back.status.code(), Some(0), "{back:?}");
    let turned = |from: &Readings, to: &Readings| (to.wheels[0] - from.wheels[0]).abs();
    let under_way =
        |heard: &[Readings]| matches!((heard.first(), heard.last()), (Some(a), Some(b)) if turned(a, b) > 5.0);
    listen(&bus, "driver", under_way).await;
    robots.kill();
    let rest = |heard: &[Readings]| matches!(heard, [.., a, b] if turned(a, b) < 1e-4);
    let stopping = listen(&bus, "driver", rest).await;
    let braked = stopping[stopping.len() - 1].stamp.secs_since(stopping[0].stamp);
    assert!(braked < 3.0, "{braked} s");
    let resting = listen(&bus, "driver", |heard| heard.len() > 50).await;
    assert!(turned(&resting[0], &resting[50]) < 0.01);
    world.assert_running();
    assert!(!world.log().contains("touched"), "{}", world.log());
}
