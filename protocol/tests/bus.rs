//! What does the typed bus promise over real Zenoh sessions? Late joiners, slow readers, bad input, absent servers and routers.

#![cfg(feature = "bus")]
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use zenav_protocol::bus::{AskError, Bus, BusConfig, BusError, RawReply, Received, Router, RouterConfig};
use zenav_protocol::messages::{Event, EventKind, GoalState, Refusal, SimClock, StopReply, StopRequest};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

/// Longer than anything here takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(20);

async fn within<F: Future>(what: &str, future: F) -> F::Output {
    tokio::time::timeout(PATIENCE, future)
        .await
        .unwrap_or_else(|_| panic!("{what} did not happen in {PATIENCE:?}"))
}

/// Does it again and again until it yields something.
async fn until<T>(what: &str, mut attempt: impl AsyncFnMut() -> Option<T>) -> T {
    let mut pace = tokio::time::interval(Duration::from_millis(10));
    within(what, async {
        loop {
            pace.tick().await;
            if let Some(found) = attempt().await {
                return found;
            }
        }
    })
    .await
}

/// A router on a free port, and its endpoint.
async fn router() -> (Router, String) {
    let router = Router::open(&RouterConfig {
        listen: vec!["tcp/127.0.0.1:0".into()],
        ..RouterConfig::default()
    })
    .await
    .unwrap();
    let endpoint = router.endpoints().await.remove(0);
    (router, endpoint)
}

async fn router_at(endpoint: &str) -> Router {
    let config = RouterConfig {
        listen: vec![endpoint.to_owned()],
        ..RouterConfig::default()
    };
    until("the port is free again", async || Router::open(&config).await.ok()).await
}

async fn client(endpoint: &str, name: &str) -> Bus {
    within("joining", Bus::open(BusConfig::service(name, endpoint)))
        .await
        .unwrap()
}

/// A robot: connects to the router and listens itself. Its own endpoint.
async fn robot(endpoint: &str) -> (Bus, String) {
    let config = BusConfig {
        listen: vec!["tcp/127.0.0.1:0".into()],
        ..BusConfig::service("edge", endpoint)
    };
    let bus = within("opening", Bus::open(config)).await.unwrap();
    let own = bus.endpoints().await.remove(0);
    (bus, own)
}

/// A cable to the router that can be frozen: nothing passes, and nobody is told.
struct Cable {
    endpoint: String,
    frozen: watch::Sender<bool>,
}

impl Cable {
    async fn to(router: &str) -> Self {
        let target = router.strip_prefix("tcp/").unwrap().to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        let (frozen, state) = watch::channel(false);
        tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let Ok(far) = TcpStream::connect(&target).await else {
                    continue;
                };
                let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
                for (mut from, mut to) in [(near_in, far_out), (far_in, near_out)] {
                    let mut state = state.clone();
                    tokio::spawn(async move {
                        let mut buffer = vec![0; 64 * 1024];
                        loop {
                            let Ok(count @ 1..) = from.read(&mut buffer).await else {
                                return;
                            };
                            if state.wait_for(|frozen| !frozen).await.is_err()
                                || to.write_all(&buffer[..count]).await.is_err()
                            {
                                return;
                            }
                        }
                    });
                }
            }
        });
        Self { endpoint, frozen }
    }
}

fn event(sequence: u64) -> Event {
    Event {
        stamp: Stamp(sequence),
        boot_id: "b".into(),
        sequence,
        kind: EventKind::Started,
    }
}

fn clock(stamp: u64) -> SimClock {
    SimClock { stamp: Stamp(stamp) }
}

/// Answers every stop with yes.
fn serve_stop(bus: &Bus, robot: &str) -> tokio::task::JoinHandle<()> {
    let mut server = bus.serve(&topics::STOP, &[robot]).unwrap();
    tokio::spawn(async move {
        while let Some(request) = server.next().await {
            request.reply(&StopReply { stopped: true });
        }
    })
}

async fn stop(bus: &Bus, robot: &str, deadline: Duration) -> Result<StopReply, AskError> {
    bus.ask(&topics::STOP, &[robot], &StopRequest::default(), deadline)
        .await
}

fn refusal(reply: &RawReply) -> Refusal {
    match reply {
        RawReply::Err { bytes, encoding } => {
            assert_eq!(encoding, "application/json");
            serde_json::from_slice(bytes).unwrap()
        }
        RawReply::Ok(sample) => panic!("not refused: {sample:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_joiner_gets_the_events_kept_in_order_and_then_the_new_ones() {
    let (_router, endpoint) = router().await;
    let writer = client(&endpoint, "writer").await;
    let publisher = writer.publisher(&topics::EVENT, &["r1"]).unwrap();
    for sequence in 1..=100 {
        publisher.put(&event(sequence));
    }
    let reader = client(&endpoint, "reader").await;
    let mut events = reader.subscribe(&topics::EVENT, &["*"], 1000).unwrap();
    for sequence in 1..=200 {
        if sequence > 100 {
            publisher.put(&event(sequence));
        }
        let received = within("an event", events.next()).await.unwrap();
        assert_eq!(
            (received.message.sequence, received.chunks.as_slice()),
            (sequence, ["r1".to_owned()].as_slice())
        );
    }
    assert_eq!((events.dropped(), events.unreadable(), publisher.failures()), (0, 0, 0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_joiner_gets_the_last_value_of_a_state() {
    let (_router, endpoint) = router().await;
    let writer = client(&endpoint, "writer").await;
    let mut info = serde_json::json!({"stamp": 1, "map": {"id": "m", "revision": 0}, "free": 0, "occupied": 0, "unknown": 0, "scans": 0, "stored": false,
        "spec": {"resolution": 0.05, "origin": [0.0, 0.0], "width": 1, "height": 1}});
    let publisher = writer.publisher(&topics::MAP_INFO, &["r1"]).unwrap();
    let mut last = None;
    for revision in 1..=5 {
        info["map"]["revision"] = revision.into();
        let message: zenav_protocol::messages::MapInfo = serde_json::from_value(info.clone()).unwrap();
        publisher.put(&message);
        last = Some(message);
    }
    let reader = client(&endpoint, "reader").await;
    let mut latest = reader.latest(&topics::MAP_INFO, &["r1"]).unwrap();
    // Older ones may still be on their way.
    until("the last value", async || {
        (latest.borrow() == last.as_ref()).then_some(())
    })
    .await;
    assert_eq!(latest.borrow(), last.as_ref(), "borrowing does not take");
    assert_eq!(latest.take(), None, "nothing newer");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_joiner_gets_the_last_state_of_every_goal() {
    let (_router, endpoint) = router().await;
    let writer = client(&endpoint, "writer").await;
    let state = |id: &str, state: &str| -> GoalState {
        serde_json::from_value(serde_json::json!({"id": id, "robot": "r1", "state": state, "accepted": 1, "request": {"x": 1.0, "y": 2.0}})).unwrap()
    };
    let mut publishers = Vec::new();
    for goal in 0..10 {
        let id = format!("g{goal}");
        let publisher = writer.publisher(&topics::GOAL_STATE, &["r1", &id]).unwrap();
        for phase in ["Accepted", "Succeeded"] {
            publisher.put(&state(&id, phase));
        }
        publishers.push(publisher);
    }
    let reader = client(&endpoint, "reader").await;
    let mut goals = reader.subscribe(&topics::GOAL_STATE, &["*", "*"], 100).unwrap();
    let mut done = std::collections::BTreeSet::new();
    while done.len() < publishers.len() {
        let Received { chunks, message } = within("a goal", goals.next()).await.unwrap();
        assert_eq!(chunks, ["r1", &message.id]);
        // An older one may still have been on its way, but never comes after the last.
        assert!(!done.contains(&message.id));
        if message == state(&message.id, "Succeeded") {
            done.insert(message.id);
        }
    }
    assert!(goals.try_next().is_none());
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_newest_value_is_seen_and_time_never_goes_back() {
    let (_router, endpoint) = router().await;
    let (writer, reader) = (client(&endpoint, "writer").await, client(&endpoint, "reader").await);
    let publisher = writer.publisher(&topics::SIM_CLOCK, &[]).unwrap();
    let mut latest = reader.latest(&topics::SIM_CLOCK, &[]).unwrap();
    let (ended, end) = std::sync::mpsc::channel::<()>();
    // From a plain thread, as the robot's control loop does. The last value is sent until it was seen: any message may be dropped.
    let control = std::thread::spawn(move || {
        let mut stamp = 0;
        while end.try_recv().is_err() {
            stamp = (stamp + 1).min(5_001);
            publisher.put(&clock(stamp));
            std::thread::yield_now();
        }
    });
    let mut seen = Vec::new();
    within("the last value", async {
        while seen.last() != Some(&Stamp(5_001)) {
            assert!(latest.changed().await, "the bus is open");
            seen.push(latest.borrow().unwrap().stamp);
        }
    })
    .await;
    ended.send(()).unwrap();
    control.join().unwrap();
    assert!(seen.is_sorted(), "an older value came after a newer one");
    assert!(seen.len() > 1, "nothing was read while it was written");
    assert_eq!(latest.borrow().unwrap().stamp, Stamp(5_001));
    assert_eq!(latest.unreadable(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clock_follows_the_simulation_on_the_bus() {
    let (_router, endpoint) = router().await;
    let (writer, reader) = (client(&endpoint, "sim").await, client(&endpoint, "reader").await);
    let publisher = writer.publisher(&topics::SIM_CLOCK, &[]).unwrap();
    let time = zenav_protocol::bus::Clock::follow(&reader).unwrap();
    let sleeper = tokio::spawn(async move {
        time.sleep_until(Stamp(700)).await;
        time.now()
    });
    let mut stamp = 0;
    until("waking", async || {
        stamp += 100;
        publisher.put(&clock(stamp));
        sleeper.is_finished().then_some(())
    })
    .await;
    assert!(sleeper.await.unwrap() >= Stamp(700));
}

#[tokio::test(flavor = "multi_thread")]
async fn asking_goes_on_until_a_server_appears() {
    let (_router, endpoint) = router().await;
    let (asker, server) = (client(&endpoint, "asker").await, client(&endpoint, "edge").await);
    let mut asking = tokio::spawn(async move { stop(&asker, "r1", PATIENCE).await });
    let early = tokio::time::timeout(Duration::from_millis(200), &mut asking).await;
    assert!(early.is_err(), "nobody is there to answer: {early:?}");
    let _serving = serve_stop(&server, "r1");
    assert_eq!(
        within("the answer", asking).await.unwrap(),
        Ok(StopReply { stopped: true })
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_timeout_names_the_key() {
    let (_router, endpoint) = router().await;
    let asker = client(&endpoint, "asker").await;
    let start = Instant::now();
    assert_eq!(
        stop(&asker, "r9", Duration::from_millis(300)).await,
        Err(AskError::Timeout {
            key: "zenav/r9/ask/edge/stop".into()
        })
    );
    assert!(start.elapsed() >= Duration::from_millis(300));
    let error = stop(&asker, "not a#key", PATIENCE).await;
    assert!(matches!(error, Err(AskError::Unaskable { .. })), "{error:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_requests_are_answered_and_change_nothing() {
    let (_router, endpoint) = router().await;
    let (asker, server) = (client(&endpoint, "asker").await, client(&endpoint, "edge").await);
    let _serving = serve_stop(&server, "r1");
    assert!(stop(&asker, "r1", PATIENCE).await.is_ok());
    let key = "zenav/r1/ask/edge/stop";
    let too_large = format!("{{\"by\": \"{}\"}}", "x".repeat(10 << 20));
    let deep = "[".repeat(10_000);
    for (payload, limit) in [
        (too_large.as_str(), Some(16 * 1024)),
        (deep.as_str(), None),
        ("{\"by\": NaN}", None),
        ("{\"by\"", None),
        ("\u{0}\u{1}", None),
        ("[1,2]", None),
        ("7", None),
    ] {
        let replies = within(
            "a refusal",
            asker.raw_query(key, Some(payload.as_bytes().to_vec()), PATIENCE),
        )
        .await
        .unwrap();
        assert_eq!(replies.len(), 1);
        match (refusal(&replies[0]), limit) {
            (Refusal::TooLarge { limit }, Some(expected)) => assert_eq!(limit, expected),
            (Refusal::BadRequest { reason }, None) => assert!(reason.len() < 400, "{reason}"),
            (other, _) => panic!("{other:?} to {}", &payload[..payload.len().min(20)]),
        }
    }
    // No payload at all is an empty request, and unknown fields are ignored.
    for payload in [
        None,
        Some(b"{}".to_vec()),
        Some(br#"{"by": "me", "mood": "calm"}"#.to_vec()),
    ] {
        let replies = within("an answer", asker.raw_query(key, payload, PATIENCE))
            .await
            .unwrap();
        assert!(
            matches!(replies.as_slice(), [RawReply::Ok(sample)] if sample.bytes == br#"{"stopped":true}"# && sample.encoding == "application/json"),
            "{replies:?}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_samples_are_counted_and_harmless() {
    let (_router, endpoint) = router().await;
    let (writer, reader) = (client(&endpoint, "writer").await, client(&endpoint, "reader").await);
    let mut events = reader.subscribe(&topics::EVENT, &["r1"], 100).unwrap();
    let key = "zenav/r1/edge/event";
    // The subscription is in place once anything arrives.
    until("the subscription", async || {
        writer.raw_put(key, b"?".to_vec(), "application/json").unwrap();
        assert!(events.try_next().is_none());
        (events.unreadable() > 0).then_some(())
    })
    .await;
    writer.raw_put(key, vec![b' '; 10 << 20], "application/json").unwrap();
    writer
        .raw_put(key, "[".repeat(16_000).into_bytes(), "text/plain")
        .unwrap();
    writer.raw_put(key, vec![0x81; 16_000], "application/cbor").unwrap();
    writer
        .raw_put(key, br#"{"stamp": NaN}"#.to_vec(), "application/json")
        .unwrap();
    // JSON typed into any client is a message, whatever encoding that client claims.
    writer
        .raw_put(key, serde_json::to_vec(&event(7)).unwrap(), "zenoh/bytes")
        .unwrap();
    let received = within("the good one", events.next()).await.unwrap();
    assert_eq!(received.message.sequence, 7);
    assert!(events.unreadable() >= 5);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_answers_a_wild_question_on_its_own_key() {
    let (_router, endpoint) = router().await;
    let (asker, server) = (client(&endpoint, "asker").await, client(&endpoint, "edge").await);
    let _serving = (serve_stop(&server, "r1"), serve_stop(&server, "r2"));
    let answers = until("both servers", async || {
        let answers = asker
            .ask_all(&topics::STOP, &["*"], &StopRequest::default(), PATIENCE)
            .await
            .unwrap();
        (answers.len() == 2).then_some(answers)
    })
    .await;
    let robots: Vec<_> = answers.iter().flat_map(|answer| answer.chunks.clone()).collect();
    assert_eq!(robots, ["r1", "r2"]);
    assert_eq!(stop(&asker, "*", PATIENCE).await, Ok(StopReply { stopped: true }));
}

#[tokio::test(flavor = "multi_thread")]
async fn one_server_for_all_robots_learns_which_one_is_meant() {
    let (_router, endpoint) = router().await;
    let (asker, server) = (client(&endpoint, "asker").await, client(&endpoint, "mapping").await);
    let mut stops = server.serve(&topics::STOP, &["*"]).unwrap();
    tokio::spawn(async move {
        while let Some(request) = stops.next().await {
            assert_eq!(request.chunks, ["r7"]);
            assert_eq!(request.parameters.get("format").map(String::as_str), Some("png"));
            request.reply_bytes(vec![1, 2, 3], "image/png");
        }
    });
    let reply = until("the picture", async || {
        asker
            .raw_query("zenav/r7/ask/edge/stop?format=png", None, PATIENCE)
            .await
            .unwrap()
            .pop()
    })
    .await;
    assert!(
        matches!(reply, RawReply::Ok(sample) if sample.key == "zenav/r7/ask/edge/stop" && sample.encoding == "image/png" && sample.bytes == [1, 2, 3])
    );
    let vague = asker.raw_query("zenav/*/ask/edge/stop", None, PATIENCE).await.unwrap();
    assert!(matches!(refusal(&vague[0]), Refusal::BadRequest { .. }));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_standby_is_passed_over_and_a_refusal_is_final() {
    let (_router, endpoint) = router().await;
    let (asker, standby, leader) = (
        client(&endpoint, "asker").await,
        client(&endpoint, "standby").await,
        client(&endpoint, "leader").await,
    );
    let mut standing_by = standby.serve(&topics::STOP, &["r1"]).unwrap();
    tokio::spawn(async move {
        while let Some(request) = standing_by.next().await {
            request.refuse(&Refusal::NotLeader);
        }
    });
    let none_leads = until("the standby", async || {
        stop(&asker, "r1", Duration::from_millis(300))
            .await
            .err()
            .filter(|error| !matches!(error, AskError::Timeout { .. }))
    })
    .await;
    assert_eq!(none_leads, AskError::Refused(Refusal::NotLeader));
    let mut leading = leader.serve(&topics::STOP, &["r1"]).unwrap();
    tokio::spawn(async move {
        while let Some(request) = leading.next().await {
            if request.body.by.is_some() {
                request.refuse(&Refusal::rejected("not you"));
            } else {
                request.reply(&StopReply { stopped: true });
            }
        }
    });
    assert_eq!(stop(&asker, "r1", PATIENCE).await, Ok(StopReply { stopped: true }));
    let refused = asker
        .ask(&topics::STOP, &["r1"], &StopRequest { by: Some("me".into()) }, PATIENCE)
        .await;
    assert_eq!(refused, Err(AskError::Refused(Refusal::rejected("not you"))));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_dropped_without_a_reply_is_asked_again() {
    let (_router, endpoint) = router().await;
    let (asker, server) = (client(&endpoint, "asker").await, client(&endpoint, "edge").await);
    let mut stops = server.serve(&topics::STOP, &["r1"]).unwrap();
    tokio::spawn(async move {
        let mut heard = 0;
        while let Some(request) = stops.next().await {
            heard += 1;
            if heard == 3 {
                request.reply(&StopReply { stopped: true });
            }
        }
    });
    assert_eq!(stop(&asker, "r1", PATIENCE).await, Ok(StopReply { stopped: true }));
    let start = Instant::now();
    assert!(matches!(
        stop(&asker, "r1", Duration::from_millis(300)).await,
        Err(AskError::Timeout { .. })
    ));
    assert!(start.elapsed() < Duration::from_secs(5));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frozen_server_does_not_keep_another_from_answering() {
    let (_router, endpoint) = router().await;
    let (asker, frozen, server) = (
        client(&endpoint, "asker").await,
        client(&endpoint, "frozen").await,
        client(&endpoint, "edge").await,
    );
    let mut stops = frozen.serve(&topics::STOP, &["r1"]).unwrap();
    let asking = tokio::spawn(async move { stop(&asker, "r1", Duration::from_secs(6)).await });
    let held = within("the question", stops.next()).await.unwrap();
    let _serving = serve_stop(&server, "r1");
    assert_eq!(
        within("the answer", asking).await.unwrap(),
        Ok(StopReply { stopped: true })
    );
    drop(held);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_server_says_that_it_is_busy() {
    let (_router, endpoint) = router().await;
    let (asker, server) = (client(&endpoint, "asker").await, client(&endpoint, "edge").await);
    let stops = server.serve(&topics::STOP, &["r1"]).unwrap();
    let busy = until("the refusal", async || {
        let replies = asker
            .raw_query("zenav/r1/ask/edge/stop", None, Duration::from_millis(50))
            .await
            .unwrap();
        replies
            .into_iter()
            .find(|reply| matches!(reply, RawReply::Err { bytes, .. } if bytes.starts_with(b"{")))
    })
    .await;
    assert!(matches!(refusal(&busy), Refusal::Busy { .. }));
    drop(stops);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_reader_holds_nobody_up() {
    let (_router, endpoint) = router().await;
    let (writer, reader) = (client(&endpoint, "writer").await, client(&endpoint, "reader").await);
    let mut slow = reader.subscribe(&topics::EVENT, &["r1"], 8).unwrap();
    let mut quick = reader.latest(&topics::EVENT, &["r1"]).unwrap();
    let publisher = writer.publisher(&topics::EVENT, &["r1"]).unwrap();
    let mut sequence = 0;
    until(
        "the newest event at the quick reader, far behind which the slow one is",
        async || {
            for _ in 0..100 {
                sequence += 1;
                publisher.put(&event(sequence));
            }
            let newest = quick.borrow().map_or(0, |event| event.sequence);
            (newest > 1000 && slow.dropped() > 500).then_some(())
        },
    )
    .await;
    let first = slow.next().await.unwrap().message.sequence;
    assert!(first > 500, "the oldest are dropped, the last eight kept");
}

#[tokio::test(flavor = "multi_thread")]
async fn bulk_is_binary_on_the_wire_and_typed_askers_get_it_so() {
    let (_router, endpoint) = router().await;
    let (writer, reader) = (client(&endpoint, "writer").await, client(&endpoint, "reader").await);
    let spec = serde_json::json!({"resolution": 0.05, "origin": [0.0, 0.0], "width": 64, "height": 64});
    let patch: zenav_protocol::messages::MapPatch = serde_json::from_value(serde_json::json!({"stamp": 1, "map": {"id": "m", "revision": 2}, "base_revision": 1,
        "spec": spec, "tiles": (0..200).map(|x| serde_json::json!({"x": x, "y": 0, "values": vec![-1; 4096]})).collect::<Vec<_>>()}))
    .unwrap();
    let mut raw = reader.raw_subscribe("zenav/*/cloud/map_patch", 10).unwrap();
    let mut typed = reader.subscribe(&topics::MAP_PATCH, &["r1"], 10).unwrap();
    let publisher = writer.publisher(&topics::MAP_PATCH, &["r1"]).unwrap();
    publisher.put(&patch);
    assert_eq!(within("the patch", typed.next()).await.unwrap().message, patch);
    // The raw subscription has no history: it may have missed the first one.
    until("the sample", async || {
        publisher.put(&patch);
        tokio::time::timeout(Duration::from_millis(100), raw.next())
            .await
            .ok()
            .flatten()
            .map(|sample| {
                assert_eq!(sample.encoding, "application/cbor");
                assert!(sample.bytes.len() < 200 * 4200, "{} bytes", sample.bytes.len());
                assert!(sample.stamp.is_some());
            })
    })
    .await;

    let mut maps = writer.serve(&topics::MAP, &["r1"]).unwrap();
    let whole: zenav_protocol::messages::MapReply = serde_json::from_value(serde_json::json!({"values": vec![0; 4096], "info": {"stamp": 1,
        "map": {"id": "m", "revision": 0}, "free": 0, "occupied": 0, "unknown": 0, "scans": 0, "stored": false, "spec": spec}}))
    .unwrap();
    let answer = whole.clone();
    tokio::spawn(async move {
        while let Some(request) = maps.next().await {
            request.reply(&answer);
        }
    });
    let request = zenav_protocol::messages::MapRequest::default();
    assert_eq!(reader.ask(&topics::MAP, &["r1"], &request, PATIENCE).await, Ok(whole));
    let mut human = reader
        .raw_query("zenav/r1/ask/cloud/map", None, PATIENCE)
        .await
        .unwrap();
    assert!(
        matches!(human.pop(), Some(RawReply::Ok(sample)) if sample.encoding == "application/json" && sample.bytes.starts_with(b"{\"info\""))
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn coming_and_going_is_seen() {
    let (_router, endpoint) = router().await;
    let (worker, watcher) = (client(&endpoint, "worker").await, client(&endpoint, "watcher").await);
    let key = |name: &str| topics::alive_key(topics::ALIVE_WORKER, &["plan", name]);
    let early = worker.declare_alive(key("w1")).unwrap();
    let mut watch = watcher.watch_alive(key("*")).unwrap();
    assert_eq!(within("w1", watch.next()).await, Some((key("w1"), true)));
    let _late = worker.declare_alive(key("w2")).unwrap();
    assert_eq!(within("w2", watch.next()).await, Some((key("w2"), true)));
    let lister = client(&endpoint, "lister").await;
    assert_eq!(
        lister.list_alive(key("*"), PATIENCE).await.unwrap(),
        [key("w1"), key("w2")]
    );
    drop(early);
    let mut next = within("w1 gone", watch.next()).await;
    // That it is there may be told twice.
    while next == Some((key("w2"), true)) {
        next = within("w1 gone", watch.next()).await;
    }
    assert_eq!(next, Some((key("w1"), false)));
    worker.close().await;
    assert_eq!(within("w2 gone", watch.next()).await, Some((key("w2"), false)));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_comes_right_after_another_left_is_told_of_everybody() {
    let (_router, endpoint) = router().await;
    let server = client(&endpoint, "server").await;
    let serving = serve_stop(&server, "r1");
    for turn in 0..6 {
        let (bus, _) = robot(&endpoint).await;
        let answer = stop(&bus, "r1", PATIENCE / 4).await;
        assert_eq!(answer, Ok(StopReply { stopped: true }), "turn {turn}");
        bus.close().await;
    }
    serving.abort();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_fails_at_once_without_a_router_and_a_service_waits_for_it() {
    let (first, endpoint) = router().await;
    first.close().await;
    let start = Instant::now();
    let error = Bus::open(BusConfig::command("cli", &endpoint)).await.unwrap_err();
    assert_eq!(
        error,
        BusError::CannotConnect {
            endpoint: endpoint.clone()
        }
    );
    assert!(start.elapsed() < Duration::from_secs(3), "{:?}", start.elapsed());
    let service = tokio::spawn({
        let endpoint = endpoint.clone();
        async move { Bus::open(BusConfig::service("mapping", &endpoint)).await }
    });
    let _second = router_at(&endpoint).await;
    assert!(within("joining", service).await.unwrap().unwrap().is_connected().await);
    let taken = Bus::open(BusConfig {
        connect: vec![],
        listen: vec![endpoint.clone()],
        ..BusConfig::default()
    })
    .await
    .unwrap_err();
    assert!(matches!(taken, BusError::CannotListen { .. }), "{taken}");
    let nonsense = Bus::open(BusConfig::service("x", "nonsense")).await.unwrap_err();
    assert!(matches!(nonsense, BusError::Config { .. }), "{nonsense}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_answers_on_its_own_endpoint_with_and_without_a_router() {
    let (first, endpoint) = router().await;
    let (edge, own) = robot(&endpoint).await;
    let _serving = serve_stop(&edge, "r1");
    let publisher = edge.publisher(&topics::EVENT, &["r1"]).unwrap();
    publisher.put(&event(1));
    let (cloud, direct) = (
        client(&endpoint, "cloud").await,
        within("joining", Bus::open(BusConfig::command("cli", &own)))
            .await
            .unwrap(),
    );

    // Both ways while all is well: asks, topics, tokens, and through the robot to the cloud.
    let _cloud_serving = serve_stop(&cloud, "cloud");
    let _token = cloud.declare_alive("zenav/r1/alive/mission".into()).unwrap();
    let mut from_cloud = cloud.subscribe(&topics::EVENT, &["r1"], 1000).unwrap();
    let mut from_robot = direct.subscribe(&topics::EVENT, &["r1"], 1000).unwrap();
    for bus in [&cloud, &direct] {
        assert!(stop(bus, "r1", PATIENCE).await.is_ok());
        assert!(stop(bus, "cloud", PATIENCE).await.is_ok());
        until("the token", async || {
            (bus.list_alive("zenav/r1/alive/*".into(), PATIENCE).await.unwrap().len() == 1).then_some(())
        })
        .await;
    }
    for events in [&mut from_cloud, &mut from_robot] {
        assert_eq!(
            within("the first event", events.next()).await.unwrap().message.sequence,
            1
        );
    }

    // The router is gone: a new command that connects straight to the robot is answered at once.
    first.close().await;
    publisher.put(&event(2));
    assert_eq!(
        within("an event past the router", from_robot.next())
            .await
            .unwrap()
            .message
            .sequence,
        2
    );
    let start = Instant::now();
    let late = Bus::open(BusConfig::command("cli", &own)).await.unwrap();
    assert!(stop(&late, "r1", PATIENCE).await.is_ok());
    assert!(start.elapsed() < Duration::from_secs(3), "{:?}", start.elapsed());
    assert!(matches!(
        stop(&cloud, "r1", Duration::from_millis(200)).await,
        Err(AskError::Timeout { .. })
    ));

    // It is back: all is linked again, and the cloud gets the event it missed.
    let start = Instant::now();
    let _second = router_at(&endpoint).await;
    assert!(stop(&cloud, "r1", PATIENCE).await.is_ok());
    assert_eq!(
        within("the event that was missed", from_cloud.next())
            .await
            .unwrap()
            .message
            .sequence,
        2
    );
    publisher.put(&event(3));
    assert_eq!(
        within("the next event", from_cloud.next())
            .await
            .unwrap()
            .message
            .sequence,
        3
    );
    println!("whole again {:?} after the router", start.elapsed());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_cut_neither_blocks_the_writer_nor_loses_an_event() {
    let (_router, endpoint) = router().await;
    let cable = Cable::to(&endpoint).await;
    let ((edge, _), reader) = (robot(&cable.endpoint).await, client(&endpoint, "reader").await);
    let mut events = reader.subscribe(&topics::EVENT, &["r1"], 1000).unwrap();
    let publisher = edge.publisher(&topics::EVENT, &["r1"]).unwrap();
    let scans = edge.publisher(&topics::SCAN, &["r1"]).unwrap();
    let _reading = reader.latest(&topics::SCAN, &["r1"]).unwrap();
    publisher.put(&event(1));
    assert_eq!(
        within("the first event", events.next()).await.unwrap().message.sequence,
        1
    );

    cable.frozen.send_replace(true);
    let scan = serde_json::from_value(serde_json::json!({"stamp": 1, "angle_min": 0.0, "angle_increment": 0.01, "range_min": 0.0, "range_max": 9.0,
        "ranges": vec![1.2345; 2000], "base_from_laser": {"x": 0, "y": 0}, "map_from_odom": {"x": 0, "y": 0}, "odom_from_base": {"x": 0, "y": 0}}))
    .unwrap();
    // From the control loop's own thread: what fills every buffer on the way costs it no time.
    let control = std::thread::spawn(move || {
        let start = Instant::now();
        let mut longest = Duration::ZERO;
        let mut sequence = 1;
        while start.elapsed() < Duration::from_secs(4) {
            let put = Instant::now();
            scans.put(&scan);
            longest = longest.max(put.elapsed());
            if sequence < start.elapsed().as_millis() as u64 / 40 {
                sequence += 1;
                publisher.put(&event(sequence));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        (publisher, sequence, longest)
    });
    let (_publisher, last, longest) = tokio::task::spawn_blocking(|| control.join().unwrap()).await.unwrap();
    assert!(last > 50);
    assert!(events.try_next().is_none(), "nothing passes a cut cable");
    let start = Instant::now();
    cable.frozen.send_replace(false);
    for sequence in 2..=last {
        assert_eq!(
            within("an event from the time of the cut", events.next())
                .await
                .unwrap()
                .message
                .sequence,
            sequence
        );
    }
    println!(
        "{} events of a 4 s cut caught up {:?} after it; the longest put took {longest:?}",
        last - 1,
        start.elapsed()
    );
    assert!(longest < Duration::from_millis(200), "{longest:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_starts_without_a_router() {
    let (first, endpoint) = router().await;
    first.close().await;
    let start = Instant::now();
    let (edge, own) = robot(&endpoint).await;
    assert!(start.elapsed() < Duration::from_secs(3), "{:?}", start.elapsed());
    let _serving = serve_stop(&edge, "r1");
    let direct = within("joining", Bus::open(BusConfig::command("cli", &own)))
        .await
        .unwrap();
    assert!(stop(&direct, "r1", PATIENCE).await.is_ok());
    assert!(!edge.is_connected().await);
    let _second = router_at(&endpoint).await;
    let cloud = client(&endpoint, "cloud").await;
    assert!(stop(&cloud, "r1", PATIENCE).await.is_ok());
    assert!(edge.is_connected().await);
}

#[tokio::test(flavor = "multi_thread")]
async fn closing_ends_what_waits() {
    let (_router, endpoint) = router().await;
    let bus = client(&endpoint, "closing").await;
    let mut events = bus.subscribe(&topics::EVENT, &["r1"], 10).unwrap();
    let mut latest = bus.latest(&topics::SCAN, &["r1"]).unwrap();
    let mut stops = bus.serve(&topics::STOP, &["r1"]).unwrap();
    let publisher = bus.publisher(&topics::SIM_CLOCK, &[]).unwrap();
    bus.close().await;
    assert!(within("the end", events.next()).await.is_none());
    assert!(!within("the end", latest.changed()).await);
    assert!(within("the end", stops.next()).await.is_none());
    assert_eq!(stop(&bus, "r1", PATIENCE).await, Err(AskError::Closed));
    assert_eq!(bus.publisher(&topics::SIM_CLOCK, &[]).unwrap_err(), BusError::Closed);
    publisher.put(&clock(1));
    assert_eq!(publisher.failures(), 1);
}
