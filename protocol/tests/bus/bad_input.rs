//! Bad input. What effect do malformed payloads have?

use zenav_protocol::bus::RawReply;
use zenav_protocol::messages::Refusal;
use zenav_protocol::topics;

use super::rig::{PATIENCE, client, event, refusal, router, serve_stop, stop, until, within};

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
    // Zenoh may drop a sample under congestion, and before the subscription is in place: each is sent until it is counted.
    let bad: [(Vec<u8>, &str); 5] = [
        (b"?".to_vec(), "application/json"),
        (vec![b' '; 10 << 20], "application/json"),
        ("[".repeat(16_000).into_bytes(), "text/plain"),
        (vec![0x81; 16_000], "application/cbor"),
        (br#"{"stamp": NaN}"#.to_vec(), "application/json"),
    ];
    for (payload, encoding) in bad {
        let before = events.unreadable();
        until("a bad sample", async || {
            writer.raw_put(key, payload.clone(), encoding).unwrap();
            assert!(events.try_next().is_none());
            (events.unreadable() > before).then_some(())
        })
        .await;
    }
    // JSON typed into any client is a message, whatever encoding that client declares.
    let good = serde_json::to_vec(&event(7)).unwrap();
    let received = until("the good one", async || {
        writer.raw_put(key, good.clone(), "zenoh/bytes").unwrap();
        events.try_next()
    })
    .await;
    assert_eq!(received.message.sequence, 7);
}
