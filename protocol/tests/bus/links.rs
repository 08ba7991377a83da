//! Links. What happens when components and routers come and go?

use std::time::{Duration, Instant};

use zenav_protocol::bus::{AskError, Bus, BusConfig, BusError, RawReply, Router, RouterConfig};
use zenav_protocol::messages::{Event, StopReply, StopRequest};
use zenav_protocol::topics;

use super::rig::{Cable, PATIENCE, client, clock, event, robot, router, router_at, serve_stop, stop, until, within};

#[tokio::test(flavor = "multi_thread")]
async fn coming_and_going_is_seen() {
    let (_router, endpoint) = router().await;
    let (worker, watcher) = (client(&endpoint, "worker").await, client(&endpoint, "watcher").await);
    let key = |name: &str| topics::alive_key(topics::ALIVE_WORKER, &["motion", name]);
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
    // The presence of a token may be reported twice.
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
async fn a_robot_whose_links_all_broke_at_once_is_known_to_every_router_again() {
    let (_first, first) = router().await;
    let second = Router::open(&RouterConfig {
        listen: vec!["tcp/127.0.0.1:0".into()],
        connect: vec![first.clone()],
        ..RouterConfig::default()
    })
    .await
    .unwrap();
    let routers = [first, second.endpoints().await.remove(0)];
    let cables = [Cable::to(&routers[0]).await, Cable::to(&routers[1]).await];
    let ends = cables.each_ref().map(|cable| cable.endpoint.clone());
    let robot = Bus::open(BusConfig {
        listen: vec!["tcp/127.0.0.1:0".into()],
        ..BusConfig::service("edge", &ends.join(","))
    });
    let robot = within("opening", robot).await.unwrap();
    let serving = serve_stop(&robot, "r1");
    let askers = [client(&routers[0], "a").await, client(&routers[1], "b").await];
    for turn in 0..6 {
        for asker in &askers {
            until("an answer", async || stop(asker, "r1", PATIENCE / 20).await.ok()).await;
        }
        // Longer than the routers' pause between two looks at the net.
        tokio::time::sleep(Duration::from_millis(300)).await;
        println!("turn {turn}: pulled");
        for cable in &cables {
            cable.pulled.send_replace(());
        }
    }
    serving.abort();
}

#[tokio::test(flavor = "multi_thread")]
async fn zenoh_s_admin_space_shows_every_part_with_its_name_and_no_command() {
    let (_router, endpoint) = router().await;
    let _command = within("joining", Bus::open(BusConfig::command("cli", &endpoint)))
        .await
        .unwrap();
    let (watcher, _robot) = (client(&endpoint, "watcher").await, robot(&endpoint).await);
    let names = async || {
        let replies = watcher.raw_query("@/*/*", None, PATIENCE).await.ok()?;
        let mut names: Vec<(String, String)> = replies
            .into_iter()
            .filter_map(|reply| match reply {
                RawReply::Ok(sample) => {
                    let shown: serde_json::Value = serde_json::from_slice(&sample.bytes).ok()?;
                    let kind = sample.key.rsplit('/').next()?.to_owned();
                    Some((shown["metadata"]["name"].as_str()?.to_owned(), kind))
                }
                RawReply::Err { .. } => None,
            })
            .collect();
        names.sort();
        names.dedup();
        Some(names)
    };
    let wanted = [("edge", "router"), ("watcher", "client"), ("zenav-router", "router")]
        .map(|(name, kind)| (name.to_owned(), kind.to_owned()));
    until("all names", async || (names().await? == wanted).then_some(())).await;
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

    // With all links up, both ways work: asks, topics, tokens, and from the robot to the cloud.
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

    // Without the router, a new command that connects directly to the robot is answered at once.
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

    // The router is back: all links are up again, and the cloud gets the event it missed.
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
    // From the control loop's own thread: full buffers along the way must not delay it.
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

/// Text that links cannot compress much.
fn noise(seed: u64, letters: usize) -> String {
    let mut state = seed;
    let letter = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        char::from(b'?' + (state >> 58) as u8)
    };
    std::iter::repeat_with(letter).take(letters).collect()
}

/// The link is cut for less than the time after which it would be opened anew, and no later event shows that the last ones are missing.
#[tokio::test(flavor = "multi_thread")]
async fn the_last_events_lost_in_a_short_cut_are_requested_again() {
    let (_router, endpoint) = router().await;
    let cable = Cable::to(&endpoint).await;
    let config = BusConfig {
        listen: vec!["tcp/127.0.0.1:0".into()],
        is_narrow: true,
        ..BusConfig::service("edge", &cable.endpoint)
    };
    let edge = within("opening", Bus::open(config)).await.unwrap();
    let reader = client(&endpoint, "reader").await;
    let mut events = reader.subscribe(&topics::EVENT, &["r1"], 1000).unwrap();
    let publisher = edge.publisher(&topics::EVENT, &["r1"]).unwrap();
    publisher.put(&event(1));
    within("the first event", events.next()).await.unwrap();

    cable.frozen.send_replace(true);
    let last = 200;
    for sequence in 2..=last {
        // More than all buffers along the way take.
        publisher.put(&Event {
            boot_id: noise(sequence, 15_000),
            ..event(sequence)
        });
    }
    tokio::time::sleep(Duration::from_secs(1)).await;
    cable.frozen.send_replace(false);
    let start = Instant::now();
    for sequence in 2..=last {
        let event = within("an event from the time of the cut", events.next())
            .await
            .unwrap();
        assert_eq!(event.message.sequence, sequence);
    }
    println!(
        "{} events of a cut of 1 s caught up {:?} after it",
        last - 1,
        start.elapsed()
    );
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

#[tokio::test(flavor = "multi_thread")]
async fn a_router_that_comes_after_one_of_two_servers_ended_is_told_of_the_other() {
    let (_first, first) = router().await;
    let linked = |to: &str| RouterConfig {
        listen: vec!["tcp/127.0.0.1:0".into()],
        connect: vec![to.to_owned()],
        ..RouterConfig::default()
    };
    let other = Router::open(&linked(&first)).await.unwrap();
    let second = other.endpoints().await.remove(0);
    let (stays, goes) = (client(&first, "a").await, client(&second, "b").await);
    let (serving, ending) = (serve_stop(&stays, "r1"), serve_stop(&goes, "r1"));
    let asker = client(&first, "asker").await;
    let servers = async || {
        let request = StopRequest::default();
        let all = asker.ask_all(&topics::STOP, &["r1"], &request, PATIENCE / 20);
        all.await.unwrap().len()
    };
    until("two answers", async || (servers().await == 2).then_some(())).await;
    ending.abort();
    goes.close().await;
    until("one answer", async || (servers().await == 1).then_some(())).await;

    let third = Router::open(&linked(&first)).await.unwrap();
    let late = client(&third.endpoints().await.remove(0), "late").await;
    assert_eq!(stop(&late, "r1", PATIENCE / 4).await, Ok(StopReply { stopped: true }));
    serving.abort();
}
