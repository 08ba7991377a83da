//! Which members of a secured fleet may do what? With real processes: a router, a world, a robot, a cloud, and keys of `zenav keys`.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::process::Output;
use std::time::{Duration, Instant};

use zenav_cloud::operator::LeaseSession;
use zenav_protocol::bus::{AskError, Bus, RawReply, RawSubscription};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{EdgeState, InfoRequest, Mode, StopReply, StopRequest, Teleop};
use zenav_protocol::topics;
use zenav_tests::http;
use zenav_tests::observer::{Observer, assert_rests, is_rest};
use zenav_tests::process::{Process, free_endpoint, run};
use zenav_tests::secured::SecuredFleet;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
const ROBOT: &str = "tiago";
/// Longest wait: far longer than anything here takes.
const LIMIT: Duration = Duration::from_secs(60);
/// Wait for an answer that must not come.
const IN_VAIN: Duration = Duration::from_secs(2);
const JSON: &str = "application/json";

fn said(output: &Output) -> String {
    let text = [&output.stdout[..], &output.stderr].concat();
    String::from_utf8_lossy(&text).into_owned()
}

/// A running fleet: its keys, and the processes of router, world, robot and cloud.
struct Running {
    fleet: SecuredFleet,
    router: Process,
    edge: Process,
    _parts: [Process; 2],
}

/// Starts everything in a namespace, or in none, and waits until the mission answers an operator.
async fn running(members: &[&str], namespace: &str) -> Running {
    let own = [
        "router.site1",
        "router.world",
        "robot.tiago",
        "service.site1",
        "operator.anna",
    ];
    let fleet = SecuredFleet::new(ZENAV, 4.0, &[&own[..], members].concat()).within(namespace);
    let mut router = fleet.start_router("router.site1");
    router.until("router up", LIMIT);
    let parts = [fleet.start_world("router.world"), fleet.start_cloud("service.site1")];
    let edge = fleet.start_edge("robot.tiago");
    let operator = fleet.join("operator.anna", &fleet.router).await;
    info(&operator, LIMIT).await.unwrap();
    let request = InfoRequest::default();
    operator
        .ask(&topics::CLOUD_INFO, &[ROBOT], &request, LIMIT)
        .await
        .unwrap();
    operator.close().await;
    Running {
        fleet,
        router,
        edge,
        _parts: parts,
    }
}

async fn info(bus: &Bus, within: Duration) -> Result<(), AskError> {
    let request = InfoRequest::default();
    bus.ask(&topics::EDGE_INFO, &[ROBOT], &request, within)
        .await
        .map(|_| ())
}

async fn stop(bus: &Bus, within: Duration) -> Result<StopReply, AskError> {
    let request = StopRequest::new("test");
    bus.ask(&topics::STOP, &[ROBOT], &request, within).await
}

/// Sends a stop that the sender may not ask for: its own program refuses, and without that check the endpoint does.
async fn assert_may_not_stop(bus: &Bus) {
    let denied = stop(bus, LIMIT).await;
    assert!(
        matches!(&denied, Err(AskError::Denied(denied)) if denied.others.contains(&"operator.NAME".to_owned())),
        "{denied:?}"
    );
    let request = serde_json::to_vec(&StopRequest::new("test")).unwrap();
    let key = topics::STOP.key(&[ROBOT]);
    let replies = bus.raw_query(&key, Some(request), IN_VAIN).await.unwrap();
    let is_answer = |reply: &RawReply| matches!(reply, RawReply::Ok(_));
    assert!(!replies.iter().any(is_answer), "{replies:?}");
}

/// Commands the robot to turn, with every state of two seconds by its clock; returns these states.
async fn turned(driver: &Bus, viewer: &Bus, epoch: u64) -> Vec<EdgeState> {
    let teleop = driver.publisher(&topics::TELEOP, &[ROBOT]).unwrap();
    let mut observer = Observer::new(viewer, ROBOT);
    let mut states = vec![observer.next(LIMIT).await];
    while states[states.len() - 1].stamp.secs_since(states[0].stamp) < 2.0 {
        let state = observer.next(LIMIT).await;
        teleop.put(&Teleop {
            epoch,
            twist: Twist2 { v: 0.0, w: 0.5 },
            echo: state.stamp,
        });
        states.push(state);
    }
    states
}

/// The keys of what has arrived.
async fn arrived(samples: &mut RawSubscription) -> Vec<String> {
    let mut keys = Vec::new();
    while let Ok(Some(sample)) = tokio::time::timeout(Duration::ZERO, samples.next()).await {
        keys.push(sample.key);
    }
    keys
}

/// Asserts that a session of neato receives what concerns neato, and nothing of the other robot, which `viewer` receives meanwhile.
async fn assert_hears_itself_alone(neato: &Bus, service: &Bus, viewer: &Bus) {
    let keys = ["edge/scan", "edge/state", "edge/*"].map(|key| format!("zenav/{ROBOT}/{key}"));
    let keys = keys
        .into_iter()
        .chain(["zenav/*/edge/state", "zenav/**"].map(str::to_owned));
    let mut others: Vec<RawSubscription> = keys.map(|key| neato.raw_subscribe(&key, 4096).unwrap()).collect();
    let mut own = neato.raw_subscribe("zenav/neato/cloud/correction", 16).unwrap();
    let correction = async {
        loop {
            service
                .raw_put("zenav/neato/cloud/correction", b"{}".to_vec(), JSON)
                .unwrap();
            if tokio::time::timeout(Duration::from_millis(100), own.next())
                .await
                .is_ok()
            {
                return;
            }
        }
    };
    tokio::time::timeout(LIMIT, correction)
        .await
        .expect("it hears its own keys");
    Observer::new(viewer, ROBOT).during(4.0).await;
    for samples in &mut others {
        let keys = arrived(samples).await;
        let of_another = |key: &String| key.starts_with("zenav/tiago/");
        assert!(!keys.iter().any(of_another), "{keys:?}");
    }
}

/// Asserts that a session of neato sees the token of its own mission, and no other part of the fleet.
async fn assert_sees_itself_alone(neato: &Bus, service: &Bus, viewer: &Bus) {
    let all = || "zenav/**".to_owned();
    let mission = topics::alive_key(topics::ALIVE_COMPONENT, &["neato", "mission"]);
    let _token = service.declare_alive(mission.clone()).unwrap();
    let seen = async {
        loop {
            let seen = neato.list_alive(all(), IN_VAIN).await.unwrap();
            if seen.contains(&mission) {
                return seen;
            }
        }
    };
    let seen = tokio::time::timeout(LIMIT, seen)
        .await
        .expect("it sees its own mission");
    assert!(seen.iter().all(|key| key.starts_with("zenav/neato/")), "{seen:?}");
    let there = viewer.list_alive(all(), IN_VAIN).await.unwrap();
    for part in ["zenav/tiago/alive/edge", "zenav/svc/alive/motion/"] {
        assert!(there.iter().any(|key| key.starts_with(part)), "{part}: {there:?}");
    }
}

/// Runs a command that the member may not do: it fails, and names the member, the key and who may.
fn assert_told(fleet: &SecuredFleet, member: &str, arguments: &[&str], told: [&str; 2]) {
    let output = fleet.client(member, &fleet.router, arguments);
    let text = said(&output);
    assert_eq!(output.status.code(), Some(7), "{arguments:?}: {text}");
    let words = [&[member][..], &told].concat();
    assert!(words.iter().all(|word| text.contains(word)), "{arguments:?}: {text}");
}

/// Publishes `forged`, which the sender may not, then `fair`, which it may: a viewer of everything must receive only `fair`, which came
/// later over the same link.
async fn only_the_second_passes(sender: &Bus, viewer: &Bus, forged: &str, fair: &str) {
    only_the_second_of_these_passes(sender, viewer, (forged, 0), (fair, 0)).await;
}

/// As [`only_the_second_passes`], with each message padded by a number of spaces.
async fn only_the_second_of_these_passes(sender: &Bus, viewer: &Bus, forged: (&str, usize), fair: (&str, usize)) {
    let mut heard = viewer.raw_subscribe("zenav/**", 4096).unwrap();
    let mark = format!("{{\"mark\":\"{}\"}}", zenav_protocol::id::Id::unique());
    let deadline = tokio::time::Instant::now() + LIMIT;
    loop {
        for (key, padding) in [forged, fair] {
            let text = format!("{mark}{:padding$}", "");
            sender.raw_put(key, text.into_bytes(), JSON).unwrap();
        }
        let next = async {
            loop {
                let sample = heard.next().await.unwrap();
                if sample.bytes.starts_with(mark.as_bytes()) {
                    return (sample.key, sample.bytes.len() - mark.len());
                }
            }
        };
        match tokio::time::timeout(Duration::from_millis(500), next).await {
            Ok((key, padding)) => return assert_eq!((key.as_str(), padding), fair, "{forged:?} passed"),
            // The router did not know the subscription yet.
            Err(_) => assert!(tokio::time::Instant::now() < deadline, "{fair:?} does not pass either"),
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn every_role_does_its_part_in_a_mission_and_no_other() {
    let running = running(&["robot.neato", "viewer.wall"], "acme/site1").await;
    let fleet = &running.fleet;
    let viewer = fleet.join("viewer.wall", &fleet.router).await;
    let operator = fleet.join("operator.anna", &fleet.router).await;
    let service = fleet.join("service.site1", &fleet.router).await;
    let neato = fleet.join("robot.neato", &fleet.router).await;
    let mut observer = Observer::new(&viewer, ROBOT);
    let commands = ["cloud/plan", "cloud/heartbeat", "operator/teleop", "edge/wheels"];
    let mut recorded = viewer
        .tap(&commands.map(|key| format!("zenav/{ROBOT}/{key}")), 64 << 20)
        .unwrap();

    // Positive control: the operator's goal makes the robot drive there.
    let goal = [
        "goal",
        "submit",
        "0.88",
        "0.09",
        "--robot",
        ROBOT,
        "--wait",
        "--timeout",
        "60",
    ];
    let drive = fleet.client("operator.anna", &fleet.router, &goal);
    assert!(drive.status.success(), "{}", said(&drive));
    observer.assert_untouched();
    let there = observer.pose().map_from_base;
    assert!((there.x - 0.88).hypot(there.y - 0.09) < 0.5, "{there:?}");

    // Strangers: without an identity, with plain TCP, with an identity of another fleet.
    let plain = fleet.router.replace("quic/", "tcp/");
    assert!(fleet.try_to_join(None, &plain).await.is_err());
    let other = tempfile::tempdir().unwrap();
    let of_another_fleet = zenav::keys::make(&other.path().join("fleet"), "router.site1").unwrap();
    assert!(fleet.try_to_join(Some(&of_another_fleet), &fleet.router).await.is_err());
    let nobody = fleet.zenav(&["stop", "--connect", &fleet.router]);
    assert!(
        nobody.status.code() == Some(2) && said(&nobody).contains("--identity"),
        "{}",
        said(&nobody)
    );

    // A robot may publish only under its own name.
    let own = |key: &str| format!("zenav/neato/edge/{key}");
    for forged in ["edge/state", "cloud/plan", "operator/teleop", "body/readings"] {
        only_the_second_passes(&neato, &viewer, &format!("zenav/{ROBOT}/{forged}"), &own("state")).await;
    }
    assert_may_not_stop(&neato).await;
    // What is larger than its key allows ends where it arrives.
    let too_large = topics::STATE.max_bytes + 2048;
    only_the_second_of_these_passes(&neato, &viewer, (&own("state"), too_large), (&own("state"), 1024)).await;
    // And it learns nothing of another robot, as a client and as a router, which a robot with an endpoint of its own is.
    assert_hears_itself_alone(&neato, &service, &viewer).await;
    let neato_router = fleet.join_as_router("robot.neato", &fleet.router).await;
    assert_hears_itself_alone(&neato_router, &service, &viewer).await;
    assert_sees_itself_alone(&neato_router, &service, &viewer).await;
    neato_router.close().await;
    // An operator may drive by hand, but not publish plans.
    let teleop = format!("zenav/{ROBOT}/operator/teleop");
    for forged in ["cloud/plan", "edge/wheels", "body/readings"] {
        only_the_second_passes(&operator, &viewer, &format!("zenav/{ROBOT}/{forged}"), &teleop).await;
    }
    // A service may plan, but not move wheels.
    let correction = format!("zenav/{ROBOT}/cloud/correction");
    for forged in ["edge/wheels", "body/readings", "edge/event"] {
        only_the_second_passes(&service, &viewer, &format!("zenav/{ROBOT}/{forged}"), &correction).await;
    }
    // A viewer may look, but neither stop nor steer.
    info(&viewer, LIMIT).await.unwrap();
    assert_may_not_stop(&viewer).await;
    let lease = LeaseSession::acquire(&operator, ROBOT, "anna", LIMIT).await.unwrap();
    let by_the_viewer = turned(&viewer, &viewer, lease.grant.epoch).await;
    assert_rests(&by_the_viewer, "a viewer with the epoch in force does not steer");
    // Positive control: the same commands of the operator do, once one of them is in time.
    let steers = async {
        while turned(&operator, &viewer, lease.grant.epoch)
            .await
            .iter()
            .all(|state| is_rest(state.velocity))
        {}
    };
    tokio::time::timeout(LIMIT, steers).await.expect("the operator steers");
    lease.release().await.unwrap();
    Observer::new(&viewer, ROBOT)
        .until("it rests again", LIMIT, |state| is_rest(state.velocity))
        .await;

    // A replay of everything that drove the robot, by a member that may write plans.
    let mut replayed = 0;
    while let Some(tapped) = recorded.try_next() {
        service
            .raw_put(&tapped.sample.key, tapped.sample.bytes, &tapped.sample.encoding)
            .unwrap();
        replayed += 1;
    }
    assert!(replayed > 10, "{replayed}");
    let states = Observer::new(&viewer, ROBOT).during(4.0).await;
    assert_rests(
        &states,
        "commands of the past, and of who may not command, move nothing",
    );
    assert!(
        states.iter().all(|state| state.mode != Mode::Stopped),
        "nobody who may has stopped it"
    );

    // An operator stops it; on the robot's own endpoint a viewer has as few rights as at the router.
    let at_the_robot = fleet.join("viewer.wall", &fleet.edge).await;
    info(&at_the_robot, LIMIT).await.unwrap();
    assert_may_not_stop(&at_the_robot).await;
    let stopped = fleet.client("operator.anna", &fleet.edge, &["stop", "--robot", ROBOT]);
    assert!(stopped.status.success(), "{}", said(&stopped));
    observer
        .until("it is stopped", LIMIT, |state| state.mode == Mode::Stopped)
        .await;
}

#[test]
fn what_a_member_may_not_do_is_told_before_it_is_sent() {
    let fleet = SecuredFleet::new(ZENAV, 1.0, &["router.site1", "robot.neato", "viewer.wall"]);
    let mut router = fleet.start_router("router.site1");
    router.until("router up", LIMIT);
    let teleop = "zenav/tiago/operator/teleop";
    let command = r#"{"epoch": 1, "twist": {"v": 0.3, "w": 0.0}, "echo": 0}"#;
    for (member, arguments, told) in [
        (
            "viewer.wall",
            &["topic", "pub", teleop, command][..],
            [teleop, "operator.NAME"],
        ),
        (
            "viewer.wall",
            &["ask", "zenav/tiago/ask/edge/stop"][..],
            ["zenav/tiago/ask/edge/stop", "operator.NAME"],
        ),
        ("viewer.wall", &["logs"][..], ["zenav/*/ask/edge/log", "operator.NAME"]),
        (
            "viewer.wall",
            &["stop", "--robot", "tiago"][..],
            ["zenav/tiago/ask/edge/stop", "operator.NAME"],
        ),
        ("robot.neato", &["ps"][..], ["ask/", "viewer.NAME"]),
        (
            "robot.neato",
            &["stop", "--all"][..],
            ["zenav/*/alive/*", "viewer.NAME"],
        ),
        ("robot.neato", &["goal", "list"][..], ["zenav/*/alive/*", "viewer.NAME"]),
        (
            "robot.neato",
            &["pose", "show", "--robot", "tiago"][..],
            ["zenav/tiago/edge/state", "robot.tiago"],
        ),
        (
            "robot.neato",
            &["topic", "echo", "zenav/tiago/edge/scan"][..],
            ["zenav/tiago/edge/scan", "robot.tiago"],
        ),
    ] {
        assert_told(&fleet, member, arguments, told);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn who_was_revoked_is_let_in_no_more_and_the_others_are() {
    let mut running = running(&["operator.bert"], "").await;
    let fleet = &running.fleet;
    // At the router, and at the robot's own endpoint: only these two listen.
    let service = fleet.join("service.site1", &fleet.router).await;
    assert_eq!(service.endpoints().await, Vec::<String>::new());
    let linked = fleet.join("operator.bert", &fleet.router).await;
    let linked_to_the_robot = fleet.join("operator.bert", &fleet.edge).await;
    for bert in [&linked, &linked_to_the_robot] {
        info(bert, LIMIT).await.unwrap();
    }
    fleet.keys(&["revoke", "operator.bert"]);
    running.router.until("starts anew", LIMIT);
    running.edge.until("starts anew", LIMIT);
    let anna = fleet.join("operator.anna", &fleet.router).await;
    info(&anna, LIMIT).await.unwrap();
    let anna_at_the_robot = fleet.join("operator.anna", &fleet.edge).await;
    info(&anna_at_the_robot, LIMIT).await.unwrap();
    for bert in [&linked, &linked_to_the_robot] {
        assert!(matches!(info(bert, IN_VAIN).await, Err(AskError::Timeout { .. })));
        assert!(matches!(stop(bert, IN_VAIN).await, Err(AskError::Timeout { .. })));
    }
    for endpoint in [&fleet.router, &fleet.edge] {
        let stopped = fleet.client("operator.bert", endpoint, &["stop", "--robot", ROBOT, "--timeout", "3"]);
        assert!(!stopped.status.success());
    }
    // What is not answered is not taken for a fleet that does not run.
    for (command, code) in [("ps", 5), ("logs", 5), ("doctor", 1)] {
        let told = fleet.client("operator.bert", &fleet.router, &[command]);
        assert!(
            told.status.code() == Some(code) && said(&told).contains("members.txt"),
            "{command}: {}",
            said(&told)
        );
    }
    let at_the_robot = fleet.client("operator.anna", &fleet.edge, &["doctor"]);
    assert!(
        said(&at_the_robot).contains("this is its own endpoint") && !said(&at_the_robot).contains("no worker shows"),
        "{}",
        said(&at_the_robot)
    );
    let mut observer = Observer::new(&anna, ROBOT);
    assert!(
        observer
            .during(1.0)
            .await
            .iter()
            .all(|state| state.mode != Mode::Stopped)
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_link_ends_with_its_certificate() {
    let running = running(&[], "").await;
    let fleet = &running.fleet;
    // 26 s.
    fleet.keys(&["issue", "operator.guest", "--days", "0.0003"]);
    let mut router = running.router;
    router.until("starts anew", LIMIT);
    let guest = fleet.join("operator.guest", &fleet.router).await;
    info(&guest, LIMIT).await.unwrap();
    let deadline = tokio::time::Instant::now() + LIMIT;
    while guest.is_connected().await {
        assert!(
            tokio::time::Instant::now() < deadline,
            "the link outlives its certificate"
        );
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert!(info(&guest, IN_VAIN).await.is_err());
    let late = fleet.client("operator.guest", &fleet.router, &["stop", "--robot", ROBOT]);
    assert!(
        late.status.code() == Some(2) && said(&late).contains("expired"),
        "{}",
        said(&late)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_tries_its_slow_link_with_more_patience_gets_its_endpoint_back_from_whoever_is_linked_to_it() {
    let fleet = SecuredFleet::new(ZENAV, 1.0, &["router.site1", "router.tiago", "operator.anna"]);
    let _router = fleet.start_router("router.site1");
    let slow = free_endpoint().replace("tcp/", "quic/");
    let link = ["--listen", &slow, "--to", &fleet.router, "--delay", "600ms"];
    let _slow = Process::start(ZENAV, &[&["netem"], &link[..]].concat(), fleet.folder());
    let identity = fleet.identity("router.tiago").display().to_string();
    let ends = ["--connect", &slow, "--listen", &fleet.edge, "--identity", &identity];
    let mut edge = Process::start(
        ZENAV,
        &[&["edge", "--data", "edge"], &ends[..]].concat(),
        fleet.folder(),
    );
    let anna = fleet.join("operator.anna", &fleet.edge).await;
    edge.until("the link is slow", LIMIT);
    edge.until("ready part=\"edge", LIMIT);
    edge.assert_running();
    anna.close().await;
}

/// Longer than the lease of a link and a handshake: who dials a frozen router has given up once or twice.
const FROZEN: Duration = Duration::from_secs(10);

#[test]
fn a_router_that_was_frozen_lets_parts_in_again_within_seconds() {
    let fleet = SecuredFleet::new(ZENAV, 1.0, &["router.site1", "service.site1"]);
    let mut router = fleet.start_router("router.site1");
    router.until("router up", LIMIT);
    let mut cloud = fleet.start_cloud("service.site1");
    cloud.until("ready part=\"motion", LIMIT);
    router.pause().unwrap();
    cloud.until("router lost part=\"motion", LIMIT);
    std::thread::sleep(FROZEN);
    router.resume().unwrap();
    let woken = Instant::now();
    router.until("starts anew", LIMIT);
    cloud.until("router back part=\"motion", LIMIT);
    // Without a new process Zenoh waits half a minute for what was given up.
    assert!(woken.elapsed() < Duration::from_secs(12), "{:?}", woken.elapsed());
}

#[test]
fn nobody_listens_to_other_machines_by_mistake() {
    let folder = tempfile::tempdir().unwrap();
    let everywhere = "tcp/0.0.0.0:0";
    for arguments in [
        &["router", "--listen", everywhere][..],
        &["up", "--listen", everywhere, "--no-gateway"],
        &["sim", "serve", "--listen", everywhere],
        &["edge", "--listen", everywhere],
        &["router", "--listen", "tcp/127.0.0.1:0", "--metrics", "0.0.0.0:0"],
        &["cloud", "motion", "--metrics", "0.0.0.0:0"],
        &["gateway", "--listen", "127.0.0.1:0", "--metrics", "0.0.0.0:0"],
    ] {
        let output = run(ZENAV, arguments, folder.path(), LIMIT);
        let text = said(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        assert!(
            text.contains("--identity") && text.contains("--insecure"),
            "{arguments:?}: {text}"
        );
    }
    let mut router = Process::start(ZENAV, &["router", "--listen", everywhere, "--insecure"], folder.path());
    router.until("router up", LIMIT);
    let output = run(ZENAV, &["router", "--listen", "quic/127.0.0.1:0"], folder.path(), LIMIT);
    assert!(
        output.status.code() == Some(2) && said(&output).contains("--identity"),
        "{}",
        said(&output)
    );
}

#[test]
fn no_secret_is_logged_or_shown() {
    const TOKEN: &str = "a-token-that-nobody-may-read-anywhere";
    let fleet = SecuredFleet::new(ZENAV, 1.0, &["router.site1", "operator.anna"]);
    let identity = fleet.identity("operator.anna").to_string_lossy().into_owned();
    std::fs::write(fleet.folder().join("token.txt"), TOKEN).unwrap();
    let file = format!("[gateway]\ntoken_file = \"token.txt\"\n[security]\nidentity = \"{identity}\"\n");
    std::fs::write(fleet.folder().join("site.toml"), file).unwrap();

    let mut router = fleet.start_traced("router.site1", &["router", "--listen", &fleet.router]);
    router.until("router up", LIMIT);
    let page = ["--listen", "127.0.0.1:0", "--token-file", "token.txt"];
    let gateway = [&["gateway", "--connect", &fleet.router][..], &page].concat();
    let mut gateway = fleet.start_traced("operator.anna", &gateway);
    let address = gateway.until("mission control: http://", LIMIT);
    let address = address.split("http://").nth(1).unwrap();
    let address = address.split(['/', '#']).next().unwrap().to_owned();
    assert_eq!(http::request(&address, "GET", "/api/v1/robots", &address).status, 401);
    assert_eq!(http::get_with_token(&address, "/api/v1/robots", TOKEN).status, 200);
    // It is linked by its identity.
    gateway.until("ready part=\"gateway\"", LIMIT);

    let mut shown = vec![router.log(), gateway.log()];
    for arguments in [
        &["config", "show", "site.toml"][..],
        &["config", "show", "site.toml", "--origin"],
    ] {
        let output = fleet.zenav(arguments);
        assert!(output.status.success(), "{}", said(&output));
        shown.push(said(&output));
    }
    assert!(shown[2].contains("token.txt") && shown[3].contains(&identity));
    assert!(shown[0].contains("TRACE") && shown[1].contains("TRACE"));
    let key = |member: &str| std::fs::read_to_string(fleet.identity(member).join("key.pem")).unwrap();
    let keys = [key("router.site1"), key("operator.anna")].concat();
    let lines = keys.lines().filter(|line| !line.starts_with("-----"));
    for secret in lines.chain([TOKEN, "PRIVATE KEY"]) {
        let place = shown.iter().position(|text| text.contains(secret));
        assert_eq!(place, None, "a secret is shown in output {place:?}");
    }
}

#[test]
fn a_part_does_not_start_with_an_identity_of_another_role() {
    let fleet = SecuredFleet::new(ZENAV, 1.0, &["robot.tiago", "operator.anna"]);
    let listen = ["--listen", "quic/127.0.0.1:0"];
    for (member, part, needed) in [
        ("operator.anna", &["cloud", "motion"][..], "service.NAME"),
        ("operator.anna", &["cloud", "mission"][..], "service.NAME"),
        ("robot.tiago", &["cloud", "mapping"][..], "service.NAME"),
        (
            "robot.tiago",
            &["gateway", "--listen", "127.0.0.1:0"][..],
            "operator.NAME",
        ),
        ("robot.tiago", &["sim", "serve"][..], "router.NAME"),
        ("robot.tiago", &["router", listen[0], listen[1]][..], "router.NAME"),
    ] {
        let output = fleet.client(member, &fleet.router, part);
        let text = said(&output);
        assert_eq!(output.status.code(), Some(2), "{part:?}: {text}");
        let cure = format!("`zenav keys issue {needed}`");
        assert!(text.contains(member) && text.contains(&cure), "{part:?}: {text}");
    }
}

#[test]
fn an_identity_is_of_the_robot_that_it_is_used_for() {
    let fleet = SecuredFleet::new(ZENAV, 1.0, &["robot.neato", "service.site1"]);
    for member in ["robot.neato", "service.site1"] {
        let edge = ["edge", "--attach", "--listen", "quic/127.0.0.1:0"];
        let output = fleet.client(member, &fleet.router, &edge);
        let text = said(&output);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains(member) && text.contains("robot.tiago"), "{text}");
    }
}
