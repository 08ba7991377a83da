//! What happens to a robot when the parts around it die, and when it gets plans that are not meant for it? With real processes, killed
//! like the machines they stand for.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::path::Path;
use std::time::{Duration, Instant};

use nalgebra::Point2;
use tokio::time::timeout;
use zenav_mission::{MissionStore, Record, StoredGoal};
use zenav_protocol::bus::{Bus, RawSample};
use zenav_protocol::grid::{Cell, Occupancy};
use zenav_protocol::messages::{
    AnnotateAction, AnnotateRequest, BasedOn, EdgeState, GoalPhase, GoalPoint, GoalState, Heartbeat, LeaseAction,
    LeaseRequest, LeaseRole, Link, MapRef, MapReply, MapRequest, Mode, Plan, PlanStatistics, Revision,
};
use zenav_protocol::topics;
use zenav_tests::acceptance::handover::Fault;
use zenav_tests::deployment::{CORRIDOR, Deployment, ROBOT};
use zenav_tests::http::request;
use zenav_tests::observer::{Observer, assert_rests, is_rest};
use zenav_tests::process::Process;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest wait, wall time: far longer than needed even on a busy machine.
const LONG: Duration = Duration::from_secs(30);
/// Simulated seconds per second.
const SPEED: f64 = 4.0;
/// The far end of the corridor, m.
const FAR_END: f64 = 15.0;

/// Submits a goal at the far end and waits until the robot is well under way, with more than 10 s left.
async fn set_out(deployment: &Deployment, robot: &mut Observer, id: &str) -> EdgeState {
    // A command does not wait for a router that is still starting.
    deployment.bus().await.close().await;
    let submitted = deployment.client(&["goal", "submit", "--place", "far_end", "--id", id, "--timeout", "30"]);
    assert_eq!(submitted.status.code(), Some(0), "{submitted:?}");
    let under_way = |state: &EdgeState| {
        let plan = state.plan.as_ref().filter(|plan| plan.goal_id == id);
        state.mode == Mode::Follow && state.velocity.v > 0.2 && plan.is_some_and(|plan| plan.time_left > 10.0)
    };
    robot.until("well on its way", LONG, under_way).await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn without_its_cloud_a_robot_is_at_rest_by_its_plan_s_expiry_and_drives_on_when_the_cloud_is_back() {
    let deployment = Deployment::new(ZENAV, CORRIDOR, SPEED);
    let _router = deployment.start_router();
    let mut edge = deployment.start_edge();
    let mut cloud = deployment.start_cloud();
    let bus = deployment.bus().await;
    let mut robot = Observer::new(&bus, ROBOT);
    let driving = set_out(&deployment, &mut robot, "far").await;

    cloud.kill();
    let alone = robot.until("the lease lapses", LONG, |state| !state.lease.live).await;
    assert!(alone.velocity.v > 0.2, "it finishes what is valid: {alone:#?}");
    let in_force = alone.plan.clone().expect("the plan in force");
    let plan = robot
        .plans()
        .iter()
        .find(|plan| plan.revision == in_force.revision)
        .expect("the plan was seen")
        .clone();
    // 5 s, plus the delay that a busy machine adds to the round trip, times `SPEED`.
    let late = (driving.round_trip_secs.unwrap_or_default() - 0.3).max(0.0);
    assert!(plan.valid_for <= 5.5 + late, "{}", plan.valid_for);
    let expiry = plan.based_on.stamp.plus_secs(plan.valid_for);
    assert!(expiry.secs_since(driving.stamp) < 8.0 && plan.based_on.boot_id == alone.boot_id);

    let seen = robot.up_to(expiry.plus_secs(2.0), vec![alone]).await;
    let late: Vec<EdgeState> = seen.into_iter().filter(|state| state.stamp >= expiry).collect();
    assert_rests(&late, "its plan has expired");
    assert_eq!(late.last().unwrap().link, Link::Lost);
    let rest = robot.pose().map_from_base;
    assert!(rest.x > 0.5 && rest.x < FAR_END - 3.0, "short of the goal: {rest:?}");
    robot.assert_untouched();
    edge.assert_running();

    let _cloud = deployment.start_cloud();
    robot
        .until("it drives on, for the same goal", LONG, |state| {
            state.velocity.v > 0.2 && state.plan.as_ref().is_some_and(|plan| plan.goal_id == "far")
        })
        .await;
    let watched = deployment.client(&["goal", "watch", "far", "-o", "json"]);
    assert_eq!(watched.status.code(), Some(0), "{watched:?}");
    let there = robot
        .until("it rests there", LONG, |state| is_rest(state.velocity))
        .await;
    assert_eq!(there.boot_id, late[0].boot_id);
    let pose = robot.pose().map_from_base;
    assert!((pose.x - FAR_END).hypot(pose.y) < 0.3, "{pose:?}");
    robot.assert_untouched();
    let listed = deployment.client(&["goal", "list", "-o", "json"]);
    let goals: Vec<GoalState> = serde_json::from_slice(&listed.stdout).unwrap();
    assert_eq!(
        goals
            .iter()
            .map(|goal| (goal.id.as_str(), goal.state))
            .collect::<Vec<_>>(),
        [("far", GoalPhase::Succeeded)]
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn without_a_router_a_stop_still_reaches_the_robot_and_outlives_its_restart() {
    let deployment = Deployment::new(ZENAV, CORRIDOR, SPEED);
    let mut router = deployment.start_router();
    let mut edge = deployment.start_edge();
    let _cloud = deployment.start_cloud();
    // On the robot's own endpoint, like an operator who stops it.
    let bus = deployment.bus_at(&deployment.edge).await;
    let mut robot = Observer::new(&bus, ROBOT);
    set_out(&deployment, &mut robot, "far").await;

    router.kill();
    let stopped = deployment.zenav(&["stop", "--connect", &deployment.edge]);
    assert_eq!(stopped.status.code(), Some(0), "{stopped:?}");
    let resting = robot
        .until("stopped, at rest", LONG, |state| {
            state.mode == Mode::Stopped && is_rest(state.velocity)
        })
        .await;
    assert_eq!(resting.plan, None, "a stop discards the plan");
    robot.assert_untouched();

    edge.kill();
    bus.close().await;
    let _edge = deployment.start_edge();
    let bus = deployment.bus_at(&deployment.edge).await;
    let mut robot = Observer::new(&bus, ROBOT);
    let again = robot.next(LONG).await;
    assert_ne!(again.boot_id, resting.boot_id);
    assert_eq!(again.mode, Mode::Stopped, "a stop latches across a restart");

    // The goal is still to be driven, and its mission returns with the router: nothing may move until a resume.
    let _router = deployment.start_router();
    robot.until("the mission is back", LONG, |state| state.lease.live).await;
    let states = robot.during(3.0).await;
    assert_rests(&states, "it is stopped");
    assert!(
        states
            .iter()
            .all(|state| state.mode == Mode::Stopped && state.plan.is_none())
    );

    let resumed = deployment.client(&["resume"]);
    assert_eq!(resumed.status.code(), Some(0), "{resumed:?}");
    robot.until("it drives on", LONG, |state| state.velocity.v > 0.2).await;
    robot.assert_untouched();
}

/// A mission made by the test: holds the robot's lease and publishes plans.
struct Writer {
    bus: Bus,
    epoch: u64,
    heart: tokio::task::JoinHandle<()>,
}

impl Writer {
    async fn new(bus: &Bus, holder: &str) -> Self {
        let request = LeaseRequest::new(
            holder.to_owned(),
            LeaseRole::Mission,
            LeaseAction::Acquire,
            format!("{holder}-1"),
        );
        let epoch = bus.ask(&topics::LEASE, &[ROBOT], &request, LONG).await.unwrap().epoch;
        let (beat, key, holder) = (bus.clone(), topics::HEARTBEAT.key(&[ROBOT]), holder.to_owned());
        let heart = tokio::spawn(async move {
            let mut interval = tokio::time::interval(Duration::from_millis(20));
            for counter in 1.. {
                interval.tick().await;
                let bytes = serde_json::to_vec(&Heartbeat {
                    holder: holder.clone(),
                    epoch,
                    counter,
                    echo: None,
                })
                .unwrap();
                if beat.raw_put(&key, bytes, "application/json").is_err() {
                    return;
                }
            }
        });
        Self {
            bus: bus.clone(),
            epoch,
            heart,
        }
    }

    /// A plan of a metre straight ahead from the robot's pose.
    fn plan(&self, robot: &mut Observer, now: &EdgeState, counter: u64) -> Plan {
        let pose = robot.pose().map_from_base;
        Plan {
            goal_id: "test".into(),
            epoch: self.epoch,
            revision: Revision {
                incarnation: 7,
                counter,
            },
            trajectory_id: 1000 + counter,
            map: MapRef::default(),
            frame: "map".into(),
            based_on: BasedOn {
                stamp: now.stamp,
                boot_id: now.boot_id.clone(),
            },
            valid_for: 5.0,
            waypoints: vec![Point2::new(pose.x + pose.yaw.cos(), pose.y + pose.yaw.sin())],
            trajectory: Default::default(),
            splice: None,
            statistics: PlanStatistics::default(),
        }
    }

    fn write(&self, plan: &Plan) {
        put(&self.bus, &serde_json::to_vec(plan).unwrap(), "application/json");
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.heart.abort();
    }
}

fn put(bus: &Bus, bytes: &[u8], encoding: &str) {
    bus.raw_put(&topics::PLAN.key(&[ROBOT]), bytes.to_vec(), encoding)
        .unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_stale_replayed_reordered_or_foreign_plan_never_moves_the_robot() {
    let deployment = Deployment::new(ZENAV, CORRIDOR, SPEED);
    let _router = deployment.start_router();
    let mut edge = deployment.start_edge();
    let mut cloud = deployment.start_cloud();
    let bus = deployment.bus().await;
    let mut wire = bus.raw_subscribe(&topics::PLAN.key(&[ROBOT]), 4096).unwrap();
    let mut robot = Observer::new(&bus, ROBOT);
    set_out(&deployment, &mut robot, "far").await;
    let renewed = |state: &EdgeState| state.plan.as_ref().is_some_and(|plan| plan.revision.counter >= 3);
    robot.until("its plan has been renewed twice", LONG, renewed).await;
    let mut recorded: Vec<RawSample> = Vec::new();
    while let Ok(Some(sample)) = timeout(Duration::from_millis(1), wire.next()).await {
        recorded.push(sample);
    }
    assert!(recorded.len() >= 3);

    // Stopped and resumed: the recorded plans, still valid, are replayed at once under their original lease.
    cloud.kill();
    assert_eq!(deployment.client(&["stop"]).status.code(), Some(0));
    robot
        .until("stopped, at rest", LONG, |state| {
            state.mode == Mode::Stopped && is_rest(state.velocity)
        })
        .await;
    assert_eq!(deployment.client(&["resume"]).status.code(), Some(0));
    robot.until("resumed", LONG, |state| state.mode == Mode::Idle).await;
    let replay = |bus: &Bus| {
        recorded
            .iter()
            .chain(recorded.iter().rev())
            .for_each(|sample| put(bus, &sample.bytes, &sample.encoding))
    };
    replay(&bus);
    assert_rests(&robot.during(2.0).await, "replayed after a stop");

    // Another holder gets another epoch.
    robot
        .until("the dead mission's lease lapses", LONG, |state| !state.lease.live)
        .await;
    let writer = Writer::new(&bus, "tester").await;
    let now = robot
        .until("the lease is the test's", LONG, |state| {
            state.lease.live && state.lease.epoch == writer.epoch
        })
        .await;
    replay(&bus);
    assert_rests(&robot.during(2.0).await, "replayed under another epoch");
    let good = writer.plan(&mut robot, &now, 5);
    for foreign in [
        Plan {
            epoch: writer.epoch - 1,
            ..good.clone()
        },
        Plan {
            epoch: writer.epoch + 1,
            ..good.clone()
        },
        Plan {
            epoch: u64::MAX,
            ..good.clone()
        },
        Plan {
            based_on: BasedOn {
                boot_id: "another".into(),
                ..good.based_on.clone()
            },
            ..good.clone()
        },
        Plan {
            based_on: BasedOn {
                stamp: now.stamp.plus_secs(1e6),
                ..good.based_on.clone()
            },
            ..good.clone()
        },
    ] {
        writer.write(&foreign);
    }
    assert_rests(&robot.during(2.0).await, "foreign plans");

    // A plan of the rightful holder does move it; older plans change nothing meanwhile.
    let now = robot.next(LONG).await;
    let good = writer.plan(&mut robot, &now, 6);
    writer.write(&good);
    robot
        .until("the rightful plan is driven", LONG, |state| state.velocity.v > 0.1)
        .await;
    writer.write(&Plan {
        revision: Revision {
            incarnation: 7,
            counter: 4,
        },
        trajectory_id: 4,
        waypoints: vec![Point2::new(0.0, 0.0)],
        ..good.clone()
    });
    writer.write(&Plan {
        revision: Revision {
            incarnation: 6,
            counter: 9,
        },
        trajectory_id: 9,
        waypoints: vec![Point2::new(0.0, 0.0)],
        ..good.clone()
    });
    for state in robot.during(0.5).await {
        assert_eq!(state.plan.map(|plan| plan.trajectory_id), Some(good.trajectory_id));
    }

    // It does not return either: not after a stop, not as a newer revision of the discarded motion.
    assert_eq!(deployment.client(&["stop"]).status.code(), Some(0));
    robot
        .until("stopped, at rest", LONG, |state| {
            state.mode == Mode::Stopped && is_rest(state.velocity)
        })
        .await;
    writer.write(&writer.plan(&mut robot, &now, 7));
    assert_rests(&robot.during(1.0).await, "stopped");
    assert_eq!(deployment.client(&["resume"]).status.code(), Some(0));
    let now = robot
        .until("resumed", LONG, |state| state.mode == Mode::Idle && state.lease.live)
        .await;
    writer.write(&good);
    writer.write(&Plan {
        trajectory_id: good.trajectory_id,
        ..writer.plan(&mut robot, &now, 8)
    });
    assert_rests(&robot.during(2.0).await, "discarded by a stop");
    let now = robot.next(LONG).await;
    writer.write(&writer.plan(&mut robot, &now, 9));
    robot
        .until("a new plan is driven", LONG, |state| state.velocity.v > 0.1)
        .await;
    robot.assert_untouched();
    edge.assert_running();
}

#[test]
fn goals_and_stops_are_given_from_the_command_line_and_answered_by_exit_codes() {
    let deployment = Deployment::new(ZENAV, "kitchen", 8.0);
    let mut up = deployment.start_up();
    // The robot and its mission may still be starting: a command waits for them, but not for a router.
    tokio::runtime::Runtime::new()
        .unwrap()
        .block_on(async { deployment.bus().await.close().await });
    let code = |arguments: &[&str]| {
        let output = deployment.client(arguments);
        (
            output.status.code(),
            String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr),
        )
    };
    let assert_code = |arguments: &[&str], expected: i32| {
        let (got, text) = code(arguments);
        assert_eq!(got, Some(expected), "{arguments:?}: {text}");
        text
    };
    let text = assert_code(
        &["goal", "submit", "--wait", "--id", "first", "-o", "json", "-0.9", "0.2"],
        0,
    );
    assert!(text.contains("\"state\": \"Succeeded\""), "{text}");
    // A repeated id is the same goal: it is not driven again, and the id cannot be reused for another goal.
    let text = assert_code(&["goal", "submit", "--id", "first", "-o", "json", "-0.9", "0.2"], 0);
    assert!(text.contains("\"state\": \"Succeeded\""), "{text}");
    assert_code(&["goal", "submit", "--id", "first", "0.9", "0.0"], 7);
    assert_code(&["goal", "submit", "--id", "second", "--place", "corner"], 0);
    let text = assert_code(&["goal", "list", "-o", "ndjson"], 0);
    assert_eq!(text.lines().filter(|line| line.starts_with('{')).count(), 2, "{text}");
    assert_code(&["stop"], 0);
    // No goal ends while the robot is stopped: the queued ones wait, and can be moved.
    for id in ["third", "fourth", "fifth"] {
        assert_code(&["goal", "submit", "--id", id, "0.9", "0.0"], 0);
    }
    let moved = |place: &[&str]| {
        let text = assert_code(&[&["goal", "move", "fifth"], place].concat(), 0);
        let rows = text.lines().filter_map(|line| line.split_whitespace().nth(1));
        rows.filter(|id| ["third", "fourth", "fifth"].contains(id))
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    assert_eq!(moved(&["--before", "fourth"]), ["third", "fifth", "fourth"]);
    assert_eq!(moved(&["--first"]), ["fifth", "third", "fourth"]);
    assert_eq!(moved(&["--last"]), ["third", "fourth", "fifth"]);
    let text = assert_code(&["goal", "move", "first", "--last"], 7);
    assert!(text.contains("only goals that wait can be moved"), "{text}");
    assert_code(&["goal", "move", "no_such_goal", "--first"], 3);
    assert_code(&["goal", "move", "third", "--before", "no_such_goal"], 3);
    assert_code(&["goal", "move", "third"], 2);
    for id in ["third", "fourth", "fifth"] {
        assert_code(&["goal", "cancel", id], 0);
    }
    assert_code(&["resume"], 0);
    assert_code(&["goal", "cancel", "second"], 0);
    assert_code(&["goal", "watch", "second"], 6);
    assert_code(&["goal", "watch", "no_such_goal"], 3);
    assert_code(&["goal", "cancel", "no_such_goal"], 3);
    assert_code(&["goal", "submit", "--place", "no_such_place"], 3);
    assert_code(&["goal", "submit", "--robot", "nobody", "0", "0"], 3);
    assert_code(&["goal", "submit", "NaN", "0"], 2);
    up.assert_running();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn whenever_an_orchestrator_is_killed_no_goal_is_lost_ends_twice_or_is_driven_after_its_end() {
    let findings = zenav_tests::acceptance::kills::run(ZENAV, 5, 1).await.unwrap();
    assert!(findings.failures().is_empty(), "{findings:#?}");
}

/// An acknowledged goal of the store that has ended, or not.
fn stored(store: &Path, acknowledged: &[String], has_ended: bool) -> Option<(MissionStore, StoredGoal)> {
    let store = MissionStore::open(store, ROBOT).unwrap();
    let goals = store.goals().unwrap().into_iter();
    let goal = goals
        .filter(|goal| acknowledged.contains(&goal.state.id))
        .find(|goal| goal.state.state.is_end() == has_ended)?;
    Some((store, goal))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_store_that_forgets_an_acknowledged_goal_is_found_out() {
    let mut lost = String::new();
    let forget = |store: &Path, acknowledged: &[String]| {
        let Some((store, goal)) = stored(store, acknowledged, false) else {
            return false;
        };
        lost.clone_from(&goal.state.id);
        store.write(&[Record::ForgetGoal(goal.state.id)]).unwrap();
        true
    };
    let findings = zenav_tests::acceptance::kills::run_tampered(ZENAV, 1, 2, forget)
        .await
        .unwrap();
    let told = format!("{lost} was acknowledged and is lost");
    assert!(findings.failures().contains(&told), "{told}: {findings:#?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_store_that_puts_back_an_old_state_of_a_goal_is_found_out() {
    let mut repeated = String::new();
    let repeat = |store: &Path, acknowledged: &[String]| {
        let Some((store, mut goal)) = stored(store, acknowledged, true) else {
            return false;
        };
        repeated.clone_from(&goal.state.id);
        (goal.state.state, goal.state.ended) = (GoalPhase::Accepted, None);
        store.write(&[Record::Goal(Box::new(goal))]).unwrap();
        true
    };
    let findings = zenav_tests::acceptance::kills::run_tampered(ZENAV, 1, 3, repeat)
        .await
        .unwrap();
    let told = format!("{repeated} ended as");
    let failures = findings.failures();
    assert!(
        failures.iter().any(|failure| failure.starts_with(&told)),
        "{told}: {findings:#?}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn when_the_leading_orchestrator_dies_or_freezes_the_other_goes_on_and_a_woken_one_does_not() {
    let faults = [Fault::LeaderKilled, Fault::StandbyPaused(1.0), Fault::LeaderPaused(6.0)];
    let findings = zenav_tests::acceptance::handover::run(ZENAV, &faults, 1).await.unwrap();
    assert!(findings.failures().is_empty(), "{findings:#?}");
    assert_eq!(findings.takeovers.len(), 2, "{findings:#?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_robot_that_no_running_orchestrator_may_lead_is_told_at_once_with_the_cure() {
    let deployment = Deployment::new(ZENAV, "kitchen", SPEED);
    let (_router, _edge) = (deployment.start_router(), deployment.start_edge());
    let mut anna = deployment.start_mission("anna");
    let bus = deployment.bus().await;
    let mut robot = Observer::new(&bus, ROBOT);
    robot.until("anna leads", LONG, |state| state.lease.leader_live).await;
    // Its disk is lost with it.
    anna.kill();
    robot
        .until("anna is gone", LONG, |state| !state.lease.leader_live)
        .await;
    let mut bert = deployment.start_mission("bert");
    bert.until("stands by", LONG);
    for words in [&["goal", "list"][..], &["goal", "submit", "0", "0"], &["ask", "goals"]] {
        let begun = Instant::now();
        let refused = deployment.client(&[words, &["--timeout", "50"]].concat());
        let told = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(1), "{words:?}: {told}");
        assert!(
            told.contains("not the leader") && told.contains("`zenav lease forget`"),
            "{words:?}: {told}"
        );
        assert!(begun.elapsed() < LONG, "{words:?} took {:?}", begun.elapsed());
    }
}

/// The robot's map, once it is not that of an earlier leader.
async fn map_after(bus: &Bus, before: Option<&MapReply>) -> MapReply {
    let deadline = Instant::now() + LONG;
    while Instant::now() < deadline {
        // A frozen leader does not answer, and a request is not repeated at once.
        let asked = bus
            .ask(&topics::MAP, &[ROBOT], &MapRequest::default(), Duration::from_secs(1))
            .await;
        if let Ok(map) = asked
            && map.info.free > 0
            && before.is_none_or(|before| before.info.map.id != map.info.map.id)
        {
            return map;
        }
    }
    panic!("no such map within {LONG:?}");
}

/// Share of the known cells of a map that are known in a later one.
fn still_known(before: &MapReply, after: &MapReply) -> f64 {
    let [before, after] = [before, after].map(|map| map.grid().unwrap());
    let width = before.spec().width;
    let is_known = |value: &i8| Occupancy::of(*value) != Occupancy::Unknown;
    let known: Vec<u32> = (0..)
        .zip(before.values())
        .filter(|(_, value)| is_known(value))
        .map(|(index, _)| index)
        .collect();
    let still = known.iter().filter(|index| {
        let cell = Cell {
            x: **index % width,
            y: **index / width,
        };
        after.at(before.spec().center(cell)).is_some_and(is_known)
    });
    still.count() as f64 / known.len() as f64
}

/// A robot under way with two mapping services, of which the first leads; a place is added to its map.
struct MappedTwice {
    bus: Bus,
    robot: Observer,
    edge: Process,
    mappers: [Process; 2],
    /// Addresses of the mapping services' metrics.
    health: [String; 2],
    /// The map before anything happens.
    before: MapReply,
    _others: [Process; 3],
    // Dropped after the processes that use its folder.
    deployment: Deployment,
}

impl MappedTwice {
    async fn new() -> Self {
        let deployment = Deployment::new(ZENAV, CORRIDOR, 1.0);
        let (router, edge) = (deployment.start_router(), deployment.start_edge());
        let [motion, mission] = ["motion", "mission"].map(|service| deployment.start_service(service));
        let bus = deployment.bus().await;
        let mut robot = Observer::new(&bus, ROBOT);
        let start = |folder| deployment.start_service_in("mapping --metrics 127.0.0.1:0", folder);
        let mut first = start("mapper_a");
        map_after(&bus, None).await;
        let mut second = start("mapper_b");
        second.until("holds the leader's map", LONG);
        let health = [&mut first, &mut second].map(|mapper| {
            let line = mapper.until("health: http://", LONG);
            let address = line.split("http://").nth(1).and_then(|rest| rest.split('/').next());
            address.unwrap().to_owned()
        });
        let driving = set_out(&deployment, &mut robot, "far").await;
        let add = AnnotateRequest {
            action: AnnotateAction::AddPlace {
                name: "half_way".to_owned(),
                at: GoalPoint {
                    x: 7.0,
                    y: 0.0,
                    yaw: None,
                },
            },
            request_id: Some("half_way".to_owned()),
            epoch: Some(driving.lease.epoch),
        };
        bus.ask(&topics::ANNOTATE, &[ROBOT], &add, LONG).await.unwrap();
        Self {
            before: map_after(&bus, None).await,
            bus,
            robot,
            edge,
            mappers: [first, second],
            health,
            _others: [router, motion, mission],
            deployment,
        }
    }

    /// Whether each service leads, and how often it has taken over, by its metrics.
    fn roles(&self) -> [(f64, f64); 2] {
        self.health.each_ref().map(|address| {
            let text = request(address, "GET", "/metrics", address).text();
            let value = |name: &str| -> f64 {
                let line = text.lines().find(|line| line.starts_with(&format!("{name}{{")));
                let value = line.and_then(|line| line.rsplit(' ').next()?.parse().ok());
                value.unwrap_or_else(|| panic!("no {name}:\n{text}"))
            };
            let leads = value("zenav_mapping_leads");
            assert!(leads == 0.0 || value("zenav_map_copy_age_seconds") == 0.0, "{text}");
            (leads, value("zenav_mapping_takeovers_total"))
        })
    }

    /// The goal succeeds, once, and the robot has touched nothing.
    fn assert_arrives(&mut self) {
        let watched = self.deployment.client(&["goal", "watch", "far", "-o", "json"]);
        assert_eq!(watched.status.code(), Some(0), "{watched:?}");
        let pose = self.robot.pose().map_from_base;
        assert!((pose.x - FAR_END).hypot(pose.y) < 0.3, "{pose:?}");
        self.robot.assert_untouched();
        let listed = self.deployment.client(&["goal", "list", "-o", "json"]);
        let goals: Vec<GoalState> = serde_json::from_slice(&listed.stdout).unwrap();
        let ends: Vec<_> = goals.iter().map(|goal| (goal.id.as_str(), goal.state)).collect();
        assert_eq!(ends, [("far", GoalPhase::Succeeded)]);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn when_the_leading_mapping_service_is_killed_its_copy_keeps_the_map_and_no_goal_is_lost() {
    let mut rig = MappedTwice::new().await;
    assert_eq!(rig.roles(), [(1.0, 0.0), (0.0, 0.0)]);
    rig.mappers[0].kill();
    let after = map_after(&rig.bus, Some(&rig.before)).await;
    let share = still_known(&rig.before, &after);
    assert!(share > 0.97, "only {share:.3} of the cells are still known");
    let told = rig
        .bus
        .ask(&topics::ANNOTATE, &[ROBOT], &AnnotateRequest::default(), LONG)
        .await
        .unwrap();
    assert!(
        told.places.contains_key("half_way") && told.places.contains_key("far_end"),
        "{told:?}"
    );
    let state = rig.robot.next(LONG).await;
    assert_eq!(
        state.plan.map(|plan| plan.goal_id).as_deref(),
        Some("far"),
        "it drives on"
    );
    rig.assert_arrives();
    let last = map_after(&rig.bus, None).await;
    assert_eq!(last.info.map.id, after.info.map.id);
    assert!(last.info.scans > after.info.scans, "the copy goes on mapping");
    rig.edge.assert_running();
    rig.mappers[1].assert_running();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_mapping_service_that_wakes_up_steps_back_and_takes_over_again_when_the_other_one_dies() {
    let mut rig = MappedTwice::new().await;
    let mut patches = rig.bus.subscribe(&topics::MAP_PATCH, &[ROBOT], 4096).unwrap();
    rig.mappers[0].pause().unwrap();
    let after = map_after(&rig.bus, Some(&rig.before)).await;
    assert!(still_known(&rig.before, &after) > 0.97);
    while patches.try_next().is_some() {}
    let first = &mut rig.mappers[0];
    first.resume().unwrap();
    first.until("this process was suspended", LONG);
    // Its copy of the map that the other one draws by now.
    first.until("holds the leader's map", LONG);
    let mut strays = 0;
    let mut count = 0;
    while let Some(patch) = patches.try_next() {
        count += 1;
        strays += usize::from(patch.message.map.id != after.info.map.id);
    }
    // What was on its way when it was suspended may still arrive.
    assert!(strays <= 2, "{strays} of {count} patches");
    assert_eq!(rig.roles(), [(0.0, 0.0), (1.0, 1.0)]);

    rig.mappers[1].kill();
    let again = map_after(&rig.bus, Some(&after)).await;
    assert_ne!(again.info.map.id, rig.before.info.map.id);
    assert!(still_known(&after, &again) > 0.97);
    rig.assert_arrives();
    rig.mappers[0].assert_running();
}
