//! A single message from anybody on the bus: does the robot still drive?

use nalgebra::Point2;
use tokio::time::timeout;
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::bus::{Bus, Publisher};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    Annotations, Correction, EdgeState, Event, EventKind, Health, InfoReply, Leader, LeaseAction, LeaseRequest,
    LeaseRole, Localisation, MapFrame, MapRef, Mode, Plan, Revision, SimClock, Zone, ZoneRule,
};
use zenav_protocol::readings::Readings;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::observer::{Observer, is_rest};
use zenav_tests::process::Process;

use super::{LONG, ZENAV, drive, said};

/// A robot in the served world, with its own endpoint.
fn attached(deployment: &Deployment) -> Process {
    let edge = &deployment.edge;
    deployment.start_up_attached(&format!(
        "[robots.{ROBOT}]\nmodel = \"tiago\"\nlisten = \"{edge}\"\nattach = true\n"
    ))
}

/// Waits until a subscriber receives the publisher's messages.
async fn heard<T>(publisher: &Publisher<T>) {
    let heard = async {
        while !publisher.may_be_heard() {
            tokio::task::yield_now().await;
        }
    };
    timeout(LONG, heard).await.expect("somebody listens");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn readings_of_the_far_future_are_not_believed_and_a_silent_body_is_named_while_a_stop_is_obeyed() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let world = deployment.start_served_world();
    let bus = deployment.bus().await;
    let mut parts = attached(&deployment);
    let mut robot = Observer::new(&bus, ROBOT);
    drive(&deployment, "-0.9", "-0.2");

    let forger = bus.publisher(&topics::READINGS, &[ROBOT]).unwrap();
    heard(&forger).await;
    for stamp in [Stamp(u64::MAX), Stamp::from_secs(1e6)] {
        forger.put(&Readings::new(stamp));
        robot.until("it goes on", LONG, |state| state.faults.are_none()).await;
    }
    drive(&deployment, "-0.9", "0.3");
    let stopped = deployment.client(&["stop"]);
    assert_eq!(stopped.status.code(), Some(0), "{}", said(&stopped));
    let resumed = deployment.client(&["resume"]);
    assert_eq!(resumed.status.code(), Some(0), "{}", said(&resumed));

    // The world freezes, and its router too: no more readings from the body.
    world.pause().unwrap();
    let own = deployment.bus_at(&deployment.edge).await;
    let mut alone = Observer::new(&own, ROBOT);
    let silent = alone
        .until("it says so", LONG, |state| state.faults.body.is_some())
        .await;
    assert!(silent.faults.body.unwrap().contains("no readings"));
    let at_its_own = |command: &[&str]| deployment.zenav(&[command, &["--connect", &deployment.edge]].concat());
    let stopped = at_its_own(&["stop"]);
    assert_eq!(stopped.status.code(), Some(0), "{}", said(&stopped));
    let health = said(&at_its_own(&["doctor"]));
    assert!(health.contains("body") && health.contains("no readings"), "{health}");

    world.resume().unwrap();
    let heard_again = |state: &EdgeState| state.faults.are_none() && state.mode == Mode::Stopped;
    robot.until("its body is heard again", LONG, heard_again).await;
    assert_eq!(deployment.client(&["resume"]).status.code(), Some(0));
    drive(&deployment, "-0.9", "-0.2");
    parts.assert_running();
}

/// The leader in the robot's lease.
async fn leader(robot: &mut Observer) -> Leader {
    let leads = |state: &EdgeState| state.lease.live && state.lease.leader.is_some();
    robot.until("a mission leads", LONG, leads).await.lease.leader.unwrap()
}

/// A plan with the holder's highest possible revision that cannot be driven.
fn last_word(plan: &Plan) -> Plan {
    Plan {
        revision: Revision {
            incarnation: plan.revision.incarnation,
            counter: u64::MAX,
        },
        trajectory_id: u64::MAX,
        valid_for: 0.0,
        ..plan.clone()
    }
}

async fn caught_up(bus: &Bus, leader: &Leader) {
    let forged = LeaseRequest {
        store: Some(leader.store.clone()),
        leads: Some(Leader {
            caught_up: vec![leader.store.clone(), "nobody".to_owned()],
            revision: u64::MAX,
            ..leader.clone()
        }),
        ..LeaseRequest::new("stranger", LeaseRole::Mission, LeaseAction::CaughtUp, "forged")
    };
    let answer = bus.ask(&topics::LEASE, &[ROBOT], &forged, LONG).await;
    assert!(answer.is_err(), "{answer:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn plans_reports_and_clocks_that_leap_change_nothing() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let mut up = deployment.start_up();
    let bus = deployment.bus().await;
    let mut robot = Observer::new(&bus, ROBOT);
    drive(&deployment, "-0.9", "-0.2");

    let plan = robot.plans().last().expect("it drove by a plan").clone();
    let plans = bus.publisher(&topics::PLAN, &[ROBOT]).unwrap();
    heard(&plans).await;
    plans.put(&last_word(&plan));
    let rejected = |events: &[EventKind]| {
        let forged = |event: &EventKind| matches!(event, EventKind::PlanRejected { trajectory_id, .. } if *trajectory_id == u64::MAX);
        events.iter().any(forged)
    };
    while !rejected(robot.events()) {
        robot.next(LONG).await;
    }
    drive(&deployment, "-0.9", "0.3");

    let leads = leader(&mut robot).await;
    caught_up(&bus, &leads).await;
    assert_eq!(leader(&mut robot).await.caught_up, leads.caught_up);

    let clock = bus.publisher(&topics::SIM_CLOCK, &[]).unwrap();
    heard(&clock).await;
    for stamp in [Stamp(u64::MAX), Stamp::from_secs(1e9)] {
        clock.put(&SimClock { stamp });
        robot.next(LONG).await;
    }
    drive(&deployment, "-0.9", "-0.2");

    // After a restart the mission leads with the same store, and the robot still drives.
    up.kill();
    let _up = deployment.start_up();
    bus.close().await;
    deployment.bus().await.close().await;
    drive(&deployment, "-0.9", "0.3");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_is_said_in_the_name_of_mapping_holds_for_seconds_only() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let mut up = deployment.start_up();
    let bus = deployment.bus().await;
    let mut robot = Observer::new(&bus, ROBOT);
    drive(&deployment, "-0.9", "-0.2");
    let state = robot.next(LONG).await;
    let map = robot.plans().last().expect("it drove by a plan").map.clone();

    let health = bus.publisher(&topics::LOCALISATION, &[ROBOT]).unwrap();
    heard(&health).await;
    health.put(&Localisation {
        stamp: state.stamp,
        boot_id: state.boot_id.clone(),
        health: Health::Lost,
        map_from_base: Pose2::IDENTITY,
        agreeing: 0.0,
        through_walls: 1.0,
    });
    let frames = bus.publisher(&topics::MAP_FRAME, &[ROBOT]).unwrap();
    heard(&frames).await;
    for frame in [u64::MAX, map.frame + 1] {
        frames.put(&MapFrame {
            map: MapRef { frame, ..map.clone() },
            ..MapFrame::default()
        });
        // Each is read: only the newest one is kept.
        robot.next(LONG).await;
        robot.next(LONG).await;
    }
    let annotations = bus.publisher(&topics::ANNOTATIONS, &[ROBOT]).unwrap();
    heard(&annotations).await;
    let corners = [(-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)];
    annotations.put(&Annotations {
        zones: vec![Zone {
            name: "everywhere".to_owned(),
            rule: ZoneRule::KeepOut,
            points: corners.map(|(x, y)| Point2::new(x, y)).into(),
        }],
        ..Annotations::default()
    });
    let corrections = bus.publisher(&topics::CORRECTION, &[ROBOT]).unwrap();
    heard(&corrections).await;
    corrections.put(&Correction {
        stamp: state.stamp,
        boot_id: state.boot_id,
        map_from_base: Pose2::IDENTITY,
        covariance: [1e-3, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1e-3],
        is_found_anew: true,
        frame: u64::MAX,
        moves: Vec::new(),
    });
    tokio::time::sleep(std::time::Duration::from_secs(3)).await;
    drive(&deployment, "-0.9", "0.3");
    up.assert_running();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_stranger_s_word_neither_ends_a_goal_nor_the_mission() {
    let deployment = Deployment::new(ZENAV, zenav_tests::deployment::CORRIDOR, 4.0);
    let _router = deployment.start_router();
    let bus = deployment.bus().await;
    // A stranger answers in the robot's name, from before the robot starts on.
    let mut stranger = bus.serve(&topics::EDGE_INFO, &[ROBOT]).unwrap();
    let lying = tokio::spawn(async move {
        while let Some(request) = stranger.next().await {
            request.reply(&InfoReply {
                component: "edge".to_owned(),
                version: "9.9.9".to_owned(),
                schema: SCHEMA_VERSION + 7,
                robot: ROBOT.to_owned(),
                ..InfoReply::default()
            });
        }
    });
    let mut cloud = deployment.start_cloud();
    let said = cloud.until("9.9.9", LONG);
    assert!(said.contains(&format!("schema {}", SCHEMA_VERSION + 7)), "{said}");
    lying.abort();
    let _edge = deployment.start_edge();
    let mut robot = Observer::new(&bus, ROBOT);
    let submitted = deployment.client(&["goal", "submit", "--place", "far_end", "--id", "far", "--timeout", "40"]);
    assert_eq!(submitted.status.code(), Some(0), "{submitted:?}");
    let driving = robot
        .until("it drives", LONG, |state| {
            state.velocity.v > 0.2 && state.plan.is_some()
        })
        .await;
    cloud.assert_running();

    let plan = driving.plan.unwrap();
    let events = bus.publisher(&topics::EVENT, &[ROBOT]).unwrap();
    heard(&events).await;
    events.put(&Event {
        stamp: driving.stamp,
        boot_id: driving.boot_id,
        sequence: 1_000_000,
        kind: EventKind::PlanFinished {
            goal_id: plan.goal_id,
            trajectory_id: plan.trajectory_id,
        },
    });
    robot.during(2.0).await;
    let listed = deployment.client(&["goal", "list", "-o", "json"]);
    let goals: serde_json::Value = serde_json::from_slice(&listed.stdout).unwrap();
    assert_eq!(goals[0]["state"], "Active", "{goals}");
    let watched = deployment.client(&["goal", "watch", "far", "-o", "json"]);
    assert_eq!(watched.status.code(), Some(0), "{watched:?}");
    robot
        .until("it rests there", LONG, |state| is_rest(state.velocity))
        .await;
    let pose = robot.pose().map_from_base;
    assert!((pose.x - 15.0).hypot(pose.y) < 0.3, "{pose:?}");
    cloud.assert_running();
}
