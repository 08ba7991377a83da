//! A robot's inputs. Lines of a message's name and its JSON, each for a few control ticks of a robot in a simulated hall: plans, heartbeats,
//! hand control, corrections, other robots, and everything that can be asked of it.

#![allow(
    clippy::expect_used,
    reason = "a message that was published and cannot be encoded is a finding"
)]

use serde::Serialize;
use serde::de::DeserializeOwned;
use zenav_edge::{EdgeConfig, Inbox, Outbox, Persisted, Pilot, Publication, Ticket};
use zenav_fixtures::robot;
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::topics::EdgeRequest;
use zenav_sim::{RobotSpec, Simulation, World};

use super::wire::golden;

/// Most lines of one input.
const MOST_LINES: usize = 60;
/// Control ticks of each line.
const TICKS: usize = 3;
/// Boot and epochs as in the golden messages: the first lease has epoch 5.
const BOOT: &str = "b1";
const EPOCH: u64 = 4;
/// Where the robot stands: at the start of the golden messages' plan.
const START: Pose2 = Pose2 {
    x: 1.0,
    y: 2.0,
    yaw: 0.25,
};
/// A mission takes the lease and sends a plan, which the robot begins to drive.
const PLAN: &str = r#"LeaseRequest {"holder":"mission-a","role":"mission","action":"acquire","request_id":"r0"}
Heartbeat {"holder":"mission-a","epoch":5,"counter":1}
Plan {"goal_id":"g1","epoch":5,"revision":{"incarnation":3,"counter":7},"trajectory_id":9,"map":{"id":"kitchen","revision":12},"frame":"map","based_on":{"stamp":20000000,"boot_id":"b1"},"valid_for":5.0,"waypoints":[],"trajectory":[{"t":0,"x":1.0,"y":2.0,"yaw":0.25,"v":0,"w":0},{"t":1,"x":1.09689,"y":2.02474,"yaw":0.25,"v":0.2,"w":0},{"t":2,"x":1.19378,"y":2.04948,"yaw":0.25,"v":0,"w":0}],"statistics":{"planner":"astar","search_ms":1.5,"corridor_ms":0.5,"geometry_ms":2.0,"timing_ms":0.25,"length":0.2,"duration":2.0,"energy_j":1.0,"min_clearance":0.3,"status":"smoothed","solver":"Solved"}}
Heartbeat {"holder":"mission-a","epoch":5,"counter":2}
"#;
/// An operator takes the lease and drives by hand.
const BY_HAND: &str = r#"LeaseRequest {"holder":"anna","role":"operator","action":"acquire","request_id":"r0"}
Teleop {"epoch":5,"twist":{"v":0.5,"w":-0.25},"echo":20000000}
"#;

/// The golden messages behind a plan, while its lease is kept, and behind hand control.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let kept = golden().filter(|(name, _)| *name != "LeaseRequest").enumerate();
    let kept = kept.map(|(number, (name, json))| {
        let renewal = format!(
            "Heartbeat {{\"holder\":\"mission-a\",\"epoch\":5,\"counter\":{}}}\n",
            100 + number
        );
        format!("{}{name} {json}\n", if number % 10 == 0 { &*renewal } else { "" })
    });
    let driven = PLAN.to_owned() + &kept.collect::<String>();
    let by_hand = BY_HAND.to_owned()
        + &golden()
            .map(|(name, json)| format!("{name} {json}\n"))
            .collect::<String>();
    vec![driven.into_bytes(), by_hand.into_bytes()]
}

/// Gives each line to the robot, and lets it drive.
///
/// # Panics
/// When it turns its wheels faster than they can, or publishes something that cannot be read again.
pub fn exercise(bytes: &[u8]) -> usize {
    let (name, model) = (Id::robot("tiago").expect("a name"), robot("tiago"));
    let hall = World::shipped("empty").expect("a world");
    let spec = RobotSpec {
        id: name.clone(),
        model: model.clone(),
        start: START,
    };
    let mut simulation = Simulation::new(&hall, vec![spec], 1).expect("a place for the robot");
    let stored = Persisted {
        epoch: EPOCH,
        ..Persisted::default()
    };
    let fastest = model.drive.max_wheel_speed * (1.0 + 1e-9);
    let mut pilot = Pilot::new(EdgeConfig::new(name, model, START), BOOT.to_owned(), stored);
    let mut taken = 0;
    let lines = bytes.split(|byte| *byte == b'\n').filter_map(inbox);
    for mut inbox in lines.take(MOST_LINES) {
        taken += 1;
        for _ in 0..TICKS {
            simulation.step();
            let readings = simulation.readings(0);
            let out = pilot.step(simulation.now(), &readings, std::mem::take(&mut inbox));
            assert!(
                out.wheels.iter().all(|speed| speed.abs() <= fastest),
                "{:?}",
                out.wheels
            );
            simulation.drive(0, out.wheels);
            publish(&out);
        }
    }
    taken
}

/// The input of a line: a message of this name.
fn inbox(line: &[u8]) -> Option<Inbox> {
    let at = line.iter().position(|byte| *byte == b' ')?;
    let (name, json) = (&line[..at], &line[at + 1..]);
    let mut inbox = Inbox::default();
    let ask = |request| vec![(Ticket(1), request)];
    match name {
        b"Plan" => inbox.plans = vec![read(json)?],
        b"Heartbeat" => inbox.heartbeats = vec![read(json)?],
        b"Teleop" => inbox.teleops = vec![read(json)?],
        b"Correction" => inbox.corrections = vec![read(json)?],
        b"Localisation" => inbox.localisations = vec![read(json)?],
        b"Intent" => inbox.intents = vec![read(json)?],
        b"LeaseRequest" => inbox.requests = ask(EdgeRequest::Lease(read(json)?)),
        b"StopRequest" => inbox.requests = ask(EdgeRequest::Stop(read(json)?)),
        b"ResumeRequest" => inbox.requests = ask(EdgeRequest::Resume(read(json)?)),
        b"ModeRequest" => inbox.requests = ask(EdgeRequest::Mode(read(json)?)),
        b"ParamRequest" => inbox.requests = ask(EdgeRequest::Param(read(json)?)),
        b"BehaviourRequest" => inbox.requests = ask(EdgeRequest::Behaviour(read(json)?)),
        b"InfoRequest" => inbox.requests = ask(EdgeRequest::Info(read(json)?)),
        _ => return None,
    }
    Some(inbox)
}

fn read<T: DeserializeOwned>(json: &[u8]) -> Option<T> {
    codec::decode(json, Encoding::Json, usize::MAX).ok()
}

/// Whatever moves receivers can be read by them.
fn publish(out: &Outbox) {
    for publication in &out.publications {
        match publication {
            Publication::Scan(_, scan) => check(scan),
            Publication::Odometry(odometry) => check(odometry),
            Publication::Pose(pose) => check(pose),
            Publication::State(state) => check(&**state),
            Publication::Event(event) => check(event),
            Publication::Obstacles(obstacles) => check(obstacles),
            Publication::Intent(intent) => check(intent),
            Publication::Yield(yields) => check(yields),
            Publication::Marker(marker) => check(marker),
            Publication::Imu(_) | Publication::Sensor(_) | Publication::Bump(_) | Publication::Battery(_) => {}
        }
    }
}

fn check<T: Serialize + DeserializeOwned>(message: &T) {
    let text = codec::encode(message, Encoding::Json).expect("JSON");
    if let Err(error) = codec::decode::<T>(&text, Encoding::Json, usize::MAX) {
        panic!("{error}: {}", String::from_utf8_lossy(&text));
    }
}
