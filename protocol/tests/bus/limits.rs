//! Limits. What happens to messages above the size or the rate of their key?

use std::time::Duration;

use zenav_observability::metrics::BUS_DISCARDED;
use zenav_protocol::sensors::Battery;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{BATTERY, SCAN, SIM_CLOCK};

use super::rig::{client, clock, router, until, within};

/// A message that differs from others by this number, 0 to 1000.
fn battery(number: u32) -> Battery {
    Battery {
        stamp: Stamp(1),
        charge: f64::from(number) / 1000.0,
        drawn_j: 0.0,
    }
}

/// What the part has discarded on a key, for this reason.
fn discarded(part: &str, pattern: &str, reason: &str) -> u64 {
    BUS_DISCARDED.with_label_values(&[part, pattern, reason]).get()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_is_cut_and_counted_and_costs_the_other_writer_of_the_key_nothing() {
    let (_router, endpoint) = router().await;
    let (writer, flooder) = (client(&endpoint, "writer").await, client(&endpoint, "flooder").await);
    let reader = client(&endpoint, "flooded").await;
    let mut heard = reader.subscribe(&BATTERY, &["r1"], 4096).unwrap();
    let publisher = writer.publisher(&BATTERY, &["r1"]).unwrap();
    until("the first message", async || {
        publisher.put(&battery(0));
        heard.try_next()
    })
    .await;
    let flood = tokio::spawn(async move {
        let bytes = serde_json::to_vec(&battery(1000)).unwrap();
        for _ in 0..100 {
            for _ in 0..10 {
                flooder
                    .raw_put("zenav/r1/edge/battery", bytes.clone(), "application/json")
                    .unwrap();
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        flooder
    });
    for number in 1..=20 {
        publisher.put(&battery(number));
        let arrived = async { while heard.next().await.unwrap().message != battery(number) {} };
        within("a message beside the flood", arrived).await;
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let _flooder = flood.await.unwrap();
    // 100 at once and 40 a second of the flood's 1000 pass.
    until("the flood is counted", async || {
        (discarded("flooded", BATTERY.pattern, "rate") > 500).then_some(())
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_on_a_key_with_wildcards_is_not_received_and_counted() {
    let (_router, endpoint) = router().await;
    let (writer, reader) = (client(&endpoint, "wild").await, client(&endpoint, "tamed").await);
    let mut heard = reader.subscribe(&BATTERY, &["r1"], 4096).unwrap();
    let put = |key: &str, number: u32| {
        let bytes = serde_json::to_vec(&battery(number)).unwrap();
        writer.raw_put(key, bytes, "application/json").unwrap();
    };
    until("the first message", async || {
        put("zenav/r1/edge/battery", 0);
        heard.try_next()
    })
    .await;
    for key in ["zenav/r$*/edge/battery", "zenav/*/edge/battery", "zenav/r1/**"] {
        put(key, 1);
    }
    put("zenav/r1/edge/battery", 2);
    loop {
        let message = within("the last message", heard.next()).await.unwrap().message;
        assert_ne!(message, battery(1));
        if message == battery(2) {
            break;
        }
    }
    assert_eq!(discarded("tamed", BATTERY.pattern, "rate"), 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulation_far_faster_than_real_time_loses_nothing() {
    let (_router, endpoint) = router().await;
    let (world, reader) = (client(&endpoint, "world").await, client(&endpoint, "hurried").await);
    let mut heard = reader.subscribe(&BATTERY, &["r1"], 16).unwrap();
    let publisher = world.publisher(&BATTERY, &["r1"]).unwrap();
    let time = world.publisher(&SIM_CLOCK, &[]).unwrap();
    until("the first message", async || {
        publisher.put(&battery(0));
        heard.try_next()
    })
    .await;
    // A minute at the key's rate, as fast as the messages arrive.
    for number in 1..=600_u32 {
        time.put(&clock(100_000_000 * u64::from(number)));
        publisher.put(&battery(number));
        let arrived = async { while heard.next().await.unwrap().message != battery(number) {} };
        within("the next message", arrived).await;
    }
    assert_eq!(discarded("hurried", BATTERY.pattern, "rate"), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_above_its_size_is_not_sent_and_counted_at_its_writer() {
    let (_router, endpoint) = router().await;
    let writer = client(&endpoint, "boaster").await;
    let scan = |beams: usize| {
        serde_json::from_value(serde_json::json!({"stamp": 1, "angle_min": 0.0, "angle_increment": 0.01, "range_min": 0.0, "range_max": 9.0,
            "ranges": vec![1.25; beams], "base_from_laser": {"x": 0, "y": 0}, "map_from_odom": {"x": 0, "y": 0}, "odom_from_base": {"x": 0, "y": 0}}))
        .unwrap()
    };
    let publisher = writer.publisher(&SCAN, &["r1"]).unwrap();
    publisher.put(&scan(40_000));
    assert_eq!(publisher.failures(), 0);
    publisher.put(&scan(60_000));
    assert_eq!(publisher.failures(), 1);
    assert_eq!(discarded("boaster", SCAN.pattern, "unpublished"), 1);
}
