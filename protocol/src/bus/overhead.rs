//! Overhead. What does the typed bus cost over raw Zenoh, and what do protected links cost?
//!
//! Both send identical bytes with the same codec over the same sessions, alternating within one run. A sample is the time from before
//! encoding to after decoding, from one client to another over a router, all in this process on loopback TCP. Raw means Zenoh's own
//! publisher, subscriber channel, `get` and queryable, used as in its documentation.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use zenoh::bytes::Encoding as Wire;
use zenoh::qos::Priority;
use zenoh::query::{ConsolidationMode, QueryTarget};

use super::{Bus, BusConfig, BusError, Router, RouterConfig, Security};
use crate::codec::{self, Encoding};
use crate::messages::{Scan, StopReply, StopRequest};
use crate::time::Stamp;
use crate::topics::{SCAN, STOP};

/// Beams of the scan that is sent.
const BEAMS: usize = 720;
/// A message that takes longer counts as lost and is sent again.
const LOST: Duration = Duration::from_secs(1);
/// Most rounds: reached only on a machine that loses nearly every message.
const MOST_ROUNDS: usize = 1_000_000;
/// Pause between samples, so that each finds an idle link.
const PAUSE: Duration = Duration::from_micros(500);

/// Latency of one operation, typed and raw.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// Name of the operation.
    pub what: String,
    /// Protocol of the links.
    pub over: &'static str,
    /// Size of the payload, bytes.
    pub bytes: usize,
    /// Number of samples of each.
    pub samples: usize,
    /// Latency of the typed bus.
    pub typed: Latency,
    /// Latency of raw Zenoh.
    pub raw: Latency,
    /// Ratio of the medians, typed over raw.
    pub ratio_p50: f64,
    /// Ratio of the 99th percentiles, typed over raw.
    pub ratio_p99: f64,
}

/// Percentiles of a latency.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Latency {
    /// Median of the latency, µs.
    pub p50_us: f64,
    /// 99th percentile of the latency, µs.
    pub p99_us: f64,
}

impl Comparison {
    fn new(what: &str, over: &'static str, bytes: usize, typed: Vec<Duration>, raw: Vec<Duration>) -> Self {
        let samples = typed.len().min(raw.len());
        let (typed, raw) = (Latency::of(typed), Latency::of(raw));
        Self {
            what: what.to_owned(),
            over,
            bytes,
            samples,
            typed,
            raw,
            ratio_p50: typed.p50_us / raw.p50_us,
            ratio_p99: typed.p99_us / raw.p99_us,
        }
    }
}

impl Latency {
    fn of(mut samples: Vec<Duration>) -> Self {
        samples.sort_unstable();
        let at = |share: f64| {
            let index = ((samples.len() as f64 * share) as usize).min(samples.len().saturating_sub(1));
            samples.get(index).map_or(f64::NAN, |sample| sample.as_secs_f64() * 1e6)
        };
        Self {
            p50_us: at(0.5),
            p99_us: at(0.99),
        }
    }
}

/// Measures the publication of a scan and an ask, `samples` times each, typed and raw, over its own router on a free port. All links have
/// the same protection; an identity must be a router's.
///
/// # Errors
/// [`BusError`] when the router cannot listen, or a session cannot connect.
pub async fn measure(samples: usize, security: &Security) -> Result<Vec<Comparison>, BusError> {
    let router = Router::open(&RouterConfig {
        listen: vec!["tcp/127.0.0.1:0".to_owned()],
        security: security.clone(),
        ..RouterConfig::default()
    })
    .await?;
    let endpoint = router.endpoints().await.into_iter().next().ok_or(BusError::Closed)?;
    let open = |name| {
        Bus::open(BusConfig {
            security: security.clone(),
            ..BusConfig::service(name, &endpoint)
        })
    };
    let (near, far) = (open("near").await?, open("far").await?);
    let over = if security.identity().is_some() { "QUIC" } else { "TCP" };
    let results = vec![
        publications(&near, &far, samples, over).await?,
        asks(&near, &far, samples, over).await?,
    ];
    near.close().await;
    far.close().await;
    router.close().await;
    Ok(results)
}

/// Order of typed (`true`) and raw in a round: it alternates, so that neither benefits from the other's warm caches.
fn order(round: usize) -> [bool; 2] {
    if round.is_multiple_of(2) {
        [true, false]
    } else {
        [false, true]
    }
}

/// Latencies of an operation, typed and raw, `samples` of each at least. `carry_out` is told whether it is typed's turn, and says whether
/// it succeeded.
async fn in_turns(
    near: &Bus,
    samples: usize,
    mut carry_out: impl AsyncFnMut(bool) -> Result<bool, BusError>,
) -> Result<[Vec<Duration>; 2], BusError> {
    let (mut typed, mut raw) = (Vec::new(), Vec::new());
    for round in 0..MOST_ROUNDS {
        if typed.len() >= samples && raw.len() >= samples {
            break;
        }
        for typed_turn in order(round) {
            tokio::time::sleep(PAUSE).await;
            let start = Instant::now();
            let succeeded = carry_out(typed_turn).await?;
            let elapsed = start.elapsed();
            if succeeded {
                if typed_turn { &mut typed } else { &mut raw }.push(elapsed);
            } else if near.session.is_closed() {
                return Err(BusError::Closed);
            }
        }
    }
    Ok([typed, raw])
}

async fn publications(near: &Bus, far: &Bus, samples: usize, over: &'static str) -> Result<Comparison, BusError> {
    let topic = SCAN.without_rate();
    let publisher = near.publisher(&topic, &["typed"])?;
    let mut latest = far.latest(&topic, &["typed"])?;
    let key = Bus::key(SCAN.key(&["raw"]))?;
    let raw_publisher = near.declared(
        near.session
            .declare_publisher(key.clone())
            .encoding(Wire::APPLICATION_JSON)
            .await,
    )?;
    let raw_subscriber = far.declared(far.session.declare_subscriber(key).await)?;
    let mut scan = scan();
    let [typed, raw] = in_turns(near, samples, async |typed_turn| {
        scan.stamp = Stamp(scan.stamp.0 + 1);
        let received = if typed_turn {
            publisher.put(&scan);
            let received = tokio::time::timeout(LOST, latest.next()).await.ok().flatten();
            received.map(|received| received.message)
        } else {
            let bytes = codec::encode(&scan, Encoding::Json).unwrap_or_default();
            near.declared(raw_publisher.put(bytes).await)?;
            let sample = tokio::time::timeout(LOST, raw_subscriber.recv_async()).await;
            sample.ok().and_then(Result::ok).and_then(|sample| {
                codec::decode::<Scan>(&sample.payload().to_bytes(), Encoding::Json, SCAN.max_bytes).ok()
            })
        };
        // The first messages are lost before the router knows the subscriptions.
        Ok(received.is_some_and(|received| received.stamp == scan.stamp))
    })
    .await?;
    let bytes = codec::encode(&scan, Encoding::Json).unwrap_or_default().len();
    Ok(Comparison::new("scan, publish to receive", over, bytes, typed, raw))
}

async fn asks(near: &Bus, far: &Bus, samples: usize, over: &'static str) -> Result<Comparison, BusError> {
    let mut server = far.serve(&STOP, &["typed"])?;
    let key = Bus::key(STOP.key(&["raw"]))?;
    let queryable = far.declared(far.session.declare_queryable(key.clone()).await)?;
    let serving = tokio::spawn(async move {
        while let Some(request) = server.next().await {
            request.reply(&StopReply { stopped: true });
        }
    });
    let raw_key = key.clone();
    let raw_serving = tokio::spawn(async move {
        while let Ok(query) = queryable.recv_async().await {
            let asked = query.payload().is_some_and(|payload| {
                codec::decode::<StopRequest>(&payload.to_bytes(), Encoding::Json, STOP.max_bytes).is_ok()
            });
            let bytes = codec::encode(&StopReply { stopped: asked }, Encoding::Json).unwrap_or_default();
            if query
                .reply(&raw_key, bytes)
                .encoding(Wire::APPLICATION_JSON)
                .await
                .is_err()
            {
                tracing::debug!("the client is gone");
            }
        }
    });
    let request = StopRequest::new("bench");
    let [typed, raw] = in_turns(near, samples, async |typed_turn| {
        if typed_turn {
            return Ok(near.ask(&STOP, &["typed"], &request, LOST).await.is_ok());
        }
        let bytes = codec::encode(&request, Encoding::Json).unwrap_or_default();
        let replies = near
            .session
            .get(&key)
            .payload(bytes)
            .encoding(Wire::APPLICATION_JSON)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .priority(Priority::InteractiveHigh)
            .timeout(LOST)
            .await;
        let reply = near.declared(replies)?.recv_async().await;
        Ok(reply.is_ok_and(|reply| {
            reply.result().is_ok_and(|sample| {
                codec::decode::<StopReply>(&sample.payload().to_bytes(), Encoding::Json, STOP.max_bytes).is_ok()
            })
        }))
    })
    .await?;
    serving.abort();
    raw_serving.abort();
    let bytes = codec::encode(&request, Encoding::Json).unwrap_or_default().len();
    Ok(Comparison::new("ask, question to answer", over, bytes, typed, raw))
}

/// A scan as a robot sends it, with all digits of a float.
fn scan() -> Scan {
    let ranges = (0..BEAMS).map(|beam| 2.0 + (beam as f32 * 0.1).sin()).collect();
    Scan {
        stamp: Stamp(1),
        angle_min: -std::f64::consts::PI,
        angle_increment: std::f64::consts::TAU / BEAMS as f64,
        range_min: 0.05,
        range_max: 12.0,
        ranges,
        ..Scan::default()
    }
}
