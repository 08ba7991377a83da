//! Does a router accumulate memory for goals of the past?

use zenav_protocol::bus::Bus;
use zenav_protocol::messages::GoalState;
use zenav_protocol::topics;
use zenav_tests::deployment::Deployment;
use zenav_tests::process::Process;

use super::{LONG, ZENAV};

/// Goals per measurement.
const GOALS: usize = 4000;

/// Resident memory of a process, bytes.
fn resident(process: &Process) -> f64 {
    zenav_tests::usage::memory(process.id()).unwrap() as f64
}

fn goal(id: &str) -> GoalState {
    serde_json::from_value(
        serde_json::json!({"id": id, "robot": "r1", "state": "Succeeded", "accepted": 1, "started": 1, "ended": 2,
        "feedback": {"step": "arrived", "distance_left": null, "time_left": null}, "request": {"x": 1.0, "y": 2.0, "on_busy": "queue", "priority": 0}}),
    )
    .unwrap()
}

/// Waits until the router has forwarded everything sent before.
async fn settle(bus: &Bus, other: &Bus) {
    let mut last = other.latest(&topics::MISSION, &["settled"]).unwrap();
    let publisher = bus.publisher(&topics::MISSION, &["settled"]).unwrap();
    publisher.put(
        &serde_json::from_value(
            serde_json::json!({"stamp": 1, "holder": "m", "leads": true, "epoch": 1, "goal_id": null, "tree": null,
        "nodes": [], "feedback": {"step": "", "distance_left": null, "time_left": null}, "queued": 0, "standbys": []}),
        )
        .unwrap(),
    );
    tokio::time::timeout(LONG, last.next()).await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_router_keeps_nothing_of_a_goal_that_has_ended() {
    let deployment = Deployment::new(ZENAV, "kitchen", 1.0);
    let router = deployment.start_router();
    let (writer, reader) = (deployment.bus().await, deployment.bus().await);
    let _all = reader.subscribe(&topics::GOAL_STATE, &["*", "*"], 100).unwrap();
    let publisher = writer.keyed_publisher(&topics::GOAL_STATE, &["r1", "*"], 64).unwrap();
    let mut grown = Vec::new();
    // The first round fills permanent buffers and caches.
    for round in 0..2 {
        settle(&writer, &reader).await;
        let before = resident(&router);
        for number in 0..GOALS {
            let id = format!("goal-{round}-{number}");
            for _ in 0..3 {
                publisher.put(&["r1", &id], &goal(&id));
            }
        }
        settle(&writer, &reader).await;
        grown.push((resident(&router) - before) / GOALS as f64);
    }
    let before = resident(&router);
    for number in 0..GOALS {
        let id = format!("own-{number}");
        writer
            .publisher(&topics::GOAL_STATE, &["r1", &id])
            .unwrap()
            .put(&goal(&id));
    }
    settle(&writer, &reader).await;
    let declared = (resident(&router) - before) / GOALS as f64;
    eprintln!("bytes a goal in the router: {grown:.0?}; with a publisher for each: {declared:.0}");
    assert!(grown[1] < 300.0, "{grown:?} bytes a goal");
}
