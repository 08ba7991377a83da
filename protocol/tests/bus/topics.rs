//! Topics. What does a reader receive: late joiners, slow readers, bulk?

use std::sync::Arc;
use std::time::Duration;

use zenav_protocol::bus::{RawReply, Received};
use zenav_protocol::messages::GoalState;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::rig::{PATIENCE, client, clock, event, router, until, within};

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
    // Older values may still be on their way.
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
        let Received { chunks, message, .. } = within("a goal", goals.next()).await.unwrap();
        assert_eq!(chunks, ["r1", &message.id]);
        // An older value may still have been on its way, but never comes after the last.
        assert!(!done.contains(&message.id));
        if message == state(&message.id, "Succeeded") {
            done.insert(message.id);
        }
    }
    assert!(goals.try_next().is_none());
}

#[tokio::test(flavor = "multi_thread")]
async fn values_are_skipped_but_time_never_goes_back() {
    let (_router, endpoint) = router().await;
    let (writer, reader) = (client(&endpoint, "writer").await, client(&endpoint, "reader").await);
    let publisher = Arc::new(writer.publisher(&topics::SIM_CLOCK, &[]).unwrap());
    let mut latest = reader.latest(&topics::SIM_CLOCK, &[]).unwrap();
    // From a plain thread, like the robot's control loop.
    let control = std::thread::spawn({
        let publisher = Arc::clone(&publisher);
        move || {
            for stamp in 1..=5_000 {
                publisher.put(&clock(stamp));
                std::thread::yield_now();
            }
        }
    });
    let mut seen = Vec::new();
    until("the last value", async || {
        if control.is_finished() {
            publisher.put(&clock(5_001));
        }
        seen.extend(latest.take().map(|message| message.stamp));
        (seen.last() == Some(&Stamp(5_001))).then_some(())
    })
    .await;
    assert!(seen.is_sorted_by(|earlier, later| earlier < later), "{seen:?}");
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
async fn the_last_values_of_many_keys_reach_early_and_late_readers_of_one_key_and_of_all() {
    let (_router, endpoint) = router().await;
    let (writer, reader) = (client(&endpoint, "writer").await, client(&endpoint, "reader").await);
    let topic = &topics::GOAL_STATE;
    let mut early = reader.subscribe(topic, &["r1", "*"], 1000).unwrap();
    let mut early_one = reader.subscribe(topic, &["r1", "g7"], 1000).unwrap();
    let publisher = writer.keyed_publisher(topic, &["r1", "*"], 8).unwrap();
    let goal = |id: &str, queued: f64| -> zenav_protocol::messages::GoalState {
        serde_json::from_value(serde_json::json!({"id": id, "robot": "r1", "state": "Active", "accepted": 1, "started": null, "ended": null,
            "feedback": {"step": "driving", "distance_left": queued, "time_left": null}, "request": {"x": 1.0, "y": 2.0, "on_busy": "queue", "priority": 0}}))
        .unwrap()
    };
    let left = |state: &zenav_protocol::messages::GoalState| state.feedback.distance_left.unwrap();
    for number in 0..10 {
        let id = format!("g{number}");
        for step in [3.0, 2.0, 1.0] {
            publisher.put(&["r1", &id], &goal(&id, step));
        }
    }
    let mut seen = std::collections::BTreeMap::new();
    while seen.get("g9") != Some(&1.0) {
        let state = within("the last value", early.next()).await.unwrap().message;
        if let Some(before) = seen.insert(state.id.clone(), left(&state)) {
            assert!(before > left(&state), "{} goes back", state.id);
        }
    }
    let mut last = 9.0;
    while last > 1.0 {
        let state = within("its own last value", early_one.next()).await.unwrap().message;
        assert_eq!(state.id, "g7");
        assert!(left(&state) < last);
        last = left(&state);
    }
    // A subscription to all keys, one to a single key, and a tool's.
    let mut late = reader.subscribe(topic, &["r1", "*"], 1000).unwrap();
    let mut late_ids = std::collections::BTreeSet::new();
    while late_ids.len() < 8 {
        let state = within("a kept value", late.next()).await.unwrap().message;
        assert!((left(&state) - 1.0).abs() < 1e-9);
        assert!(late_ids.insert(state.id), "once each");
    }
    assert_eq!(late_ids.first().map(String::as_str), Some("g2"), "the newest eight");
    // Kept values bear their writer's stamp: by it the rates of several writers are told apart.
    let mut tool = reader.raw_subscribe_kept(&topic.key(&["r1", "*"]), 1000).unwrap();
    for _ in 0..8 {
        assert!(within("a kept sample", tool.next()).await.unwrap().stamp.is_some());
    }
    let mut one = reader.latest(topic, &["r1", "g5"]).unwrap();
    assert_eq!(within("the kept value", one.next()).await.unwrap().message.id, "g5");
    // The next value of a key that a late reader already has arrives once.
    publisher.put(&["r1", "g5"], &goal("g5", 0.0));
    assert!(left(&within("the next", one.next()).await.unwrap().message).abs() < 1e-9);
    assert!(left(&within("the next", late.next()).await.unwrap().message).abs() < 1e-9);
    // Another writer on the same keys, as after a restart.
    drop(publisher);
    let again = client(&endpoint, "again").await;
    let publisher = again.keyed_publisher(topic, &["r1", "*"], 8).unwrap();
    publisher.put(&["r1", "g5"], &goal("g5", 7.0));
    assert!((left(&within("the new writer's", one.next()).await.unwrap().message) - 7.0).abs() < 1e-9);
}

/// Missions of an orchestrator share a session.
#[tokio::test(flavor = "multi_thread")]
async fn goals_of_two_robots_whose_missions_share_a_session_reach_early_and_late_readers_of_all() {
    let (_router, endpoint) = router().await;
    let (writer, reader) = (client(&endpoint, "writer").await, client(&endpoint, "reader").await);
    let topic = &topics::GOAL_STATE;
    let mut early = reader.subscribe(topic, &["*", "*"], 1000).unwrap();
    let robots = ["r1", "r2"];
    let mut publishers = Vec::new();
    // One after the other: Zenoh asserts something about its routes, in debug builds alone, that does not hold while keys are declared and used at
    // the same time.
    for robot in robots {
        let publisher = writer.keyed_publisher(topic, &[robot, "*"], 8).unwrap();
        tokio::time::sleep(Duration::from_millis(200)).await;
        for told in ["Active", "Succeeded"] {
            let state = serde_json::json!({"id": "g", "robot": robot, "state": told, "accepted": 1, "request": {"x": 1.0, "y": 2.0}});
            let state: GoalState = serde_json::from_value(state).unwrap();
            publisher.put(&[robot, "g"], &state);
            assert_eq!(within("each state", early.next()).await.unwrap().message, state);
        }
        publishers.push(publisher);
    }
    let mut late = reader.subscribe(topic, &["*", "*"], 1000).unwrap();
    let mut kept = std::collections::BTreeSet::new();
    while kept.len() < robots.len() {
        kept.insert(
            within("the last state of each robot's goal", late.next())
                .await
                .unwrap()
                .message
                .robot,
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_of_two_namespaces_on_one_router_do_not_see_one_another() {
    let (_router, endpoint) = router().await;
    let open = async |namespace: &str| {
        let config = zenav_protocol::bus::BusConfig::service("test", &endpoint).within(namespace);
        within("joining", zenav_protocol::bus::Bus::open(config)).await
    };
    let (one, two, reader) = (
        open("site1").await.unwrap(),
        open("site2").await.unwrap(),
        open("site2").await.unwrap(),
    );
    let mut heard = reader.subscribe(&topics::EVENT, &["*"], 100).unwrap();
    let of_one = one.publisher(&topics::EVENT, &["r1"]).unwrap();
    let of_two = two.publisher(&topics::EVENT, &["r2"]).unwrap();
    of_one.put(&event(1));
    of_two.put(&event(2));
    let received = within("its own site's event", heard.next()).await.unwrap();
    assert_eq!((received.chunks, received.message.sequence), (vec!["r2".to_owned()], 2));
    let key = |robot| topics::alive_key(topics::ALIVE_COMPONENT, &[robot, "edge"]);
    let _tokens = (
        one.declare_alive(key("r1")).unwrap(),
        two.declare_alive(key("r2")).unwrap(),
    );
    until("its own site's token", async || {
        let shown = reader.list_alive(key("*"), PATIENCE).await.unwrap();
        assert!(!shown.contains(&key("r1")), "{shown:?}");
        shown.contains(&key("r2")).then_some(())
    })
    .await;
    assert!(open("site*").await.is_err());
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
    // The raw subscription has no history: it may have missed the first sample.
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
