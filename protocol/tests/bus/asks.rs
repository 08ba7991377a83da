//! Asks. Which answer does a client get from absent, frozen, busy and standby servers?

use std::time::{Duration, Instant};

use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::bus::{AskError, RawReply};
use zenav_protocol::messages::{Refusal, StopReply, StopRequest};
use zenav_protocol::topics;

use super::rig::{PATIENCE, client, refusal, router, serve_stop, stop, until, within};

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
        .ask(&topics::STOP, &["r1"], &StopRequest::new("me"), PATIENCE)
        .await;
    assert_eq!(refused, Err(AskError::Refused(Refusal::rejected("not you"))));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_program_of_another_schema_is_refused_and_may_still_stop_a_robot() {
    let (_router, endpoint) = router().await;
    let (asker, server) = (client(&endpoint, "asker").await, client(&endpoint, "edge").await);
    let mut resumes = server.serve(&topics::RESUME, &["r1"]).unwrap();
    let mut stops = server.serve(&topics::STOP, &["r1"]).unwrap();
    tokio::spawn(async move {
        loop {
            tokio::select! {
                Some(request) = resumes.next() => request.reply(&StopReply { stopped: false }),
                Some(request) = stops.next() => request.reply(&StopReply { stopped: true }),
                else => break,
            }
        }
    });
    assert_eq!(stop(&asker, "r1", PATIENCE).await, Ok(StopReply { stopped: true }));
    let other = SCHEMA_VERSION + 1;
    let ask = async |what: &str| {
        let selector = format!("zenav/r1/ask/edge/{what}?schema={other}");
        let replies = asker
            .raw_query(&selector, Some(b"{}".to_vec()), PATIENCE)
            .await
            .unwrap();
        match replies.into_iter().next().unwrap() {
            RawReply::Ok(sample) => String::from_utf8(sample.bytes).unwrap(),
            RawReply::Err { bytes, .. } => String::from_utf8(bytes).unwrap(),
        }
    };
    let refused = ask("resume").await;
    assert!(
        refused.contains(&format!("schema {other}")) && refused.contains(&format!("schema {SCHEMA_VERSION}")),
        "{refused}"
    );
    assert!(ask("stop").await.contains("true"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_on_a_pattern_without_a_payload_reaches_only_what_changes_nothing() {
    let (_router, endpoint) = router().await;
    let (asker, server) = (client(&endpoint, "asker").await, client(&endpoint, "edge").await);
    let mut stops = server.serve(&topics::STOP, &["r1"]).unwrap();
    tokio::spawn(async move {
        while let Some(request) = stops.next().await {
            request.reply(&StopReply { stopped: true });
        }
    });
    assert_eq!(stop(&asker, "r1", PATIENCE).await, Ok(StopReply { stopped: true }));
    for (selector, payload, obeyed) in [
        ("zenav/**", None, false),
        ("zenav/*/ask/edge/stop", None, false),
        ("zenav/*/ask/edge/stop", Some(b"{}".to_vec()), true),
        ("zenav/r1/ask/edge/stop", None, true),
    ] {
        let replies = asker.raw_query(selector, payload.clone(), PATIENCE).await.unwrap();
        let is_ok = |reply: &RawReply| matches!(reply, RawReply::Ok(sample) if sample.key.ends_with("stop"));
        assert_eq!(replies.iter().any(is_ok), obeyed, "{selector} {payload:?}");
    }
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
