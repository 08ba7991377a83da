//! Tests of the mission service on a bus.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::time::Duration;

use zenav_protocol::bus::{AskError, BusConfig, Latest, Router};
use zenav_protocol::id::Id;
use zenav_protocol::lease::LeaseArbiter;
use zenav_protocol::messages::{
    CancelRequest, EdgeState, GoalPhase, GoalRequest, GoalsRequest, LeaseReply, Link, MissionStatus,
};
use zenav_protocol::time::Stamp;

use super::*;
use crate::testing;
use zenav_behaviour_tree::{Leaf, LeafIo, NodeSpec, Status};
use zenav_mission::{Context, trees};

const DEADLINE: Duration = Duration::from_secs(10);

fn to(id: &str) -> GoalRequest {
    GoalRequest {
        id: Some(id.into()),
        x: Some(1.0),
        y: Some(2.0),
        ..GoalRequest::default()
    }
}

/// Keeps the mission's thread busy for longer than the TTL of a lease.
struct Ponder;

impl Leaf<Context> for Ponder {
    fn start(&mut self, _: &mut LeafIo<'_>, _: &mut Context) -> Status {
        std::thread::sleep(Duration::from_millis(2500));
        Status::Success
    }
}

/// A router, and its endpoint.
async fn router() -> (Router, String) {
    // Before any of these tests builds a tree.
    static LEAVES: std::sync::Once = std::sync::Once::new();
    LEAVES.call_once(|| {
        trees::add_leaves(|registry| {
            let spec = NodeSpec::action("Ponder", "Takes longer than a lease lives.");
            registry.leaf(spec, |_| Box::new(Ponder))
        })
        .unwrap();
    });
    testing::router().await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_is_answered_kept_over_a_restart_and_told_to_whoever_listens() {
    let (router, endpoint) = router().await;
    let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
    let folder = tempfile::tempdir().unwrap();
    let config = MissionConfig::new(
        Id::robot("tiago").unwrap(),
        "mission",
        folder.path().join("mission.redb"),
    );
    let (client, chunks) = (open("client").await.unwrap(), ["tiago"]);
    let begin = async || {
        let shutdown = Shutdown::new();
        let bus = open("mission").await.unwrap();
        (
            tokio::spawn(run(bus, Clock::wall(), config.clone(), shutdown.clone())),
            shutdown,
        )
    };

    let (service, shutdown) = begin().await;
    let reply = client.ask(&topics::GOAL, &chunks, &to("a"), DEADLINE).await.unwrap();
    assert_eq!((reply.id.as_str(), reply.state), ("a", GoalPhase::Accepted));
    let second = run(
        open("second").await.unwrap(),
        Clock::wall(),
        config.clone(),
        Shutdown::new(),
    )
    .await;
    assert!(matches!(second, Err(MissionError::Store(StoreError::Locked { .. }))));
    let bad = client
        .ask(&topics::GOAL, &chunks, &GoalRequest::default(), DEADLINE)
        .await;
    assert!(matches!(bad, Err(AskError::Refused(Refusal::BadRequest { .. }))));
    shutdown.trigger();
    service.await.unwrap().unwrap();

    let (service, shutdown) = begin().await;
    let again = client.ask(&topics::GOAL, &chunks, &to("a"), DEADLINE).await.unwrap();
    assert_eq!(again.state, GoalPhase::Active);
    let mut states = client.latest(&topics::GOAL_STATE, &["tiago", "a"]).unwrap();
    let cancel = CancelRequest {
        id: None,
        request_id: Some("c".into()),
    };
    let ended = client.ask(&topics::CANCEL, &chunks, &cancel, DEADLINE).await.unwrap();
    assert_eq!(ended.state, GoalPhase::Canceled);
    let told = async {
        loop {
            let state = states.next().await.unwrap().message;
            if state.state.is_end() {
                return state;
            }
        }
    };
    assert_eq!(
        tokio::time::timeout(DEADLINE, told).await.unwrap().state,
        GoalPhase::Canceled
    );
    let goals = client
        .ask(&topics::GOALS, &chunks, &GoalsRequest::default(), DEADLINE)
        .await
        .unwrap();
    assert_eq!(goals.goals.len(), 1);
    shutdown.trigger();
    service.await.unwrap().unwrap();
    router.close().await;
}

/// A robot that grants and reports leases, and nothing else.
async fn arbiter(bus: Bus, shutdown: Shutdown) {
    let mut book = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    let mut server = bus.serve(&topics::LEASE, &["tiago"]).unwrap();
    let mut beats = bus.subscribe(&topics::HEARTBEAT, &["tiago"], 256).unwrap();
    let states = bus.publisher(&topics::STATE, &["tiago"]).unwrap();
    let start = tokio::time::Instant::now();
    let now = || Stamp::from_secs(1.0 + start.elapsed().as_secs_f64());
    let mut ticks = tokio::time::interval(Duration::from_millis(50));
    let mut answered: Vec<(String, Result<LeaseReply, Refusal>)> = Vec::new();
    loop {
        tokio::select! {
            () = shutdown.wait() => return,
            _ = ticks.tick() => states.put(&EdgeState { stamp: now(), lease: book.state(now()), ..state() }),
            Some(beat) = beats.next() => { book.renew(now(), &beat.message); }
            Some(request) = server.next() => {
                let id = format!("{:?}{}", request.body.store, request.body.request_id);
                let known = answered.iter().find(|(known, _)| *known == id).map(|(_, answer)| answer.clone());
                let answer = known.unwrap_or_else(|| book.request(now(), &request.body).map(|granted| LeaseReply {
                    epoch: granted.epoch,
                    ttl_secs: 1.0,
                    boot_id: "boot".into(), round_trip_secs: None,
                }));
                answered.push((id, answer.clone()));
                match answer {
                    Ok(reply) => request.reply(&reply),
                    Err(refusal) => request.refuse(&refusal),
                }
            }
        }
    }
}

fn state() -> EdgeState {
    EdgeState {
        boot_id: "boot".into(),
        link: Link::Connected,
        battery: 1.0,
        uplink: 1.0,
        ..EdgeState::default()
    }
}

/// A mission as a process has it: when it ends, only its store remains.
struct Member {
    store: std::path::PathBuf,
    bus: Bus,
    task: tokio::task::JoinHandle<Result<(), MissionError>>,
}

impl Member {
    async fn start(endpoint: &str, store: std::path::PathBuf) -> Self {
        let bus = Bus::open(BusConfig::service("mission", endpoint)).await.unwrap();
        let config = MissionConfig::new(Id::robot("tiago").unwrap(), "mission", store.clone());
        let task = tokio::spawn(run(bus.clone(), Clock::wall(), config, Shutdown::new()));
        Self { store, bus, task }
    }

    /// Aborts it in the middle of whatever it does.
    async fn kill(self) -> std::path::PathBuf {
        self.task.abort();
        let _ = self.task.await;
        self.bus.close().await;
        self.store
    }
}

async fn until(status: &mut Latest<MissionStatus>, what: &str, fits: impl Fn(&MissionStatus) -> bool) -> MissionStatus {
    let mut last = None;
    let found = tokio::time::timeout(DEADLINE, async {
        loop {
            let news = status.next().await.unwrap().message;
            if fits(&news) {
                return news;
            }
            last = Some(news);
        }
    })
    .await;
    found.unwrap_or_else(|_| panic!("{what}; last: {last:?}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn what_one_mission_has_acknowledged_another_goes_on_with_and_only_one_that_has_caught_up_leads() {
    let (router, endpoint) = router().await;
    let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
    let folder = tempfile::tempdir().unwrap();
    let shutdown = Shutdown::new();
    let robot = tokio::spawn(arbiter(open("edge").await.unwrap(), shutdown.clone()));
    let (client, chunks) = (open("client").await.unwrap(), ["tiago"]);
    let mut status = client.latest(&topics::MISSION, &chunks).unwrap();
    let submit = async |id: &str| client.ask(&topics::GOAL, &chunks, &to(id), DEADLINE).await;
    let known = async |ids: &[&str]| {
        let goals = client
            .ask(&topics::GOALS, &chunks, &GoalsRequest::default(), DEADLINE)
            .await
            .unwrap();
        let listed: Vec<&str> = goals.goals.iter().map(|goal| goal.id.as_str()).collect();
        assert_eq!(listed, ids);
    };

    let a = Member::start(&endpoint, folder.path().join("a.redb")).await;
    until(&mut status, "the first leads, alone", |status| {
        status.leads && status.standbys.is_empty()
    })
    .await;
    submit("first").await.unwrap();
    let b = Member::start(&endpoint, folder.path().join("b.redb")).await;
    let led = until(&mut status, "the second has caught up", |status| {
        !status.standbys.is_empty()
    })
    .await;
    submit("second").await.unwrap();

    // The leader dies: the other mission has all goals, including the one from before it joined.
    let a = a.kill().await;
    let took_over = until(&mut status, "the second leads", |status| {
        status.leads && status.epoch > led.epoch
    })
    .await;
    assert!(took_over.standbys.is_empty(), "it says that it works alone");
    known(&["second", "first"]).await;
    submit("third").await.unwrap();

    // A mission that has missed something does not lead.
    let b = b.kill().await;
    let a = Member::start(&endpoint, a).await;
    let refused = client
        .ask(&topics::GOAL, &chunks, &to("lost"), Duration::from_secs(3))
        .await;
    assert_eq!(refused, Err(AskError::Refused(Refusal::NotLeader)));

    // Once it has caught up, it may lead.
    let b = Member::start(&endpoint, b).await;
    until(&mut status, "the first has caught up", |status| {
        !status.standbys.is_empty()
    })
    .await;
    b.kill().await;
    until(&mut status, "the first leads again", |status| {
        status.leads && status.epoch > took_over.epoch + 1
    })
    .await;
    known(&["third", "second", "first"]).await;
    a.kill().await;
    shutdown.trigger();
    robot.await.unwrap();
    router.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_step_that_takes_longer_than_a_lease_lives_does_not_cost_the_lease() {
    let (router, endpoint) = router().await;
    let folder = tempfile::tempdir().unwrap();
    let client = Bus::open(BusConfig::service("client", &endpoint)).await.unwrap();
    let chunks = ["tiago"];
    let shutdown = Shutdown::new();
    let bus = Bus::open(BusConfig::service("edge", &endpoint)).await.unwrap();
    let robot = tokio::spawn(arbiter(bus, shutdown.clone()));
    let mut status = client.latest(&topics::MISSION, &chunks).unwrap();
    let mission = Member::start(&endpoint, folder.path().join("a.redb")).await;
    let epoch = until(&mut status, "it leads", |status| status.leads).await.epoch;
    let mut states = client.subscribe(&topics::STATE, &chunks, 1024).unwrap();
    let goal = GoalRequest {
        id: Some("g".into()),
        tree: Some(r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Ponder/></BehaviorTree></root>"#.into()),
        ..GoalRequest::default()
    };
    client.ask(&topics::GOAL, &chunks, &goal, DEADLINE).await.unwrap();
    let mut ends = client.latest(&topics::GOAL_STATE, &["tiago", "g"]).unwrap();
    let ended = async {
        loop {
            let goal = ends.next().await.unwrap().message;
            if goal.state.is_end() {
                return goal.state;
            }
        }
    };
    assert_eq!(
        tokio::time::timeout(DEADLINE, ended).await.unwrap(),
        GoalPhase::Succeeded
    );
    while let Some(state) = states.try_next() {
        let lease = state.message.lease;
        assert!(lease.live && lease.epoch == epoch, "{lease:?}");
    }
    let after = until(&mut status, "it still leads", |status| status.goal_id.is_none()).await;
    assert!(after.leads && after.epoch == epoch);
    mission.kill().await;
    shutdown.trigger();
    robot.await.unwrap();
    router.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn while_no_robot_is_there_one_of_two_new_missions_takes_goals_and_the_other_hands_its_own_over_later() {
    let (router, endpoint) = router().await;
    let folder = tempfile::tempdir().unwrap();
    let members = tokio::join!(
        Member::start(&endpoint, folder.path().join("a.redb")),
        Member::start(&endpoint, folder.path().join("b.redb"))
    );
    let client = Bus::open(BusConfig::service("client", &endpoint)).await.unwrap();
    let chunks = ["tiago"];
    client
        .ask(&topics::GOAL, &chunks, &to("early"), DEADLINE)
        .await
        .unwrap();
    let answers = client
        .ask_all(
            &topics::GOALS,
            &chunks,
            &GoalsRequest::default(),
            Duration::from_secs(1),
        )
        .await
        .unwrap();
    let taken = answers.iter().filter(|answer| answer.result.is_ok()).count();
    assert_eq!((taken, answers.len()), (1, 2), "{answers:?}");

    // The robot appears, and one mission has caught up with the other: no goal is lost, whichever leads.
    let shutdown = Shutdown::new();
    let bus = Bus::open(BusConfig::service("edge", &endpoint)).await.unwrap();
    let robot = tokio::spawn(arbiter(bus, shutdown.clone()));
    let mut status = client.latest(&topics::MISSION, &chunks).unwrap();
    until(&mut status, "one leads, the other has caught up", |status| {
        status.leads && !status.standbys.is_empty()
    })
    .await;
    let goals = client
        .ask(&topics::GOALS, &chunks, &GoalsRequest::default(), DEADLINE)
        .await
        .unwrap();
    assert_eq!(goals.goals.len(), 1);
    members.0.kill().await;
    members.1.kill().await;
    shutdown.trigger();
    robot.await.unwrap();
    router.close().await;
}
