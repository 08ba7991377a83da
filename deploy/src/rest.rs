//! REST of the router. `GET /KEY` answers with the value of a key, for programs that only speak HTTP.
//!
//! - A key with a queryable (`zenav/tiago/ask/cloud/map?format=png`) is queried; for any other key, the retained value is returned, or the
//!   next one published.
//! - A key without wildcards returns its bytes unchanged, under their own media type. A pattern returns a JSON list of
//!   `{key, value, encoding, time}`, as Zenoh's own REST plugin does.
//! - It is read-only: an ask that could change something is refused. Commands go through `zenav gateway`, which checks authorisation.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{Path, RawQuery, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use tokio::sync::Semaphore;
use tokio::time::{Instant, timeout_at};
use zenav_gateway::Access;
use zenav_protocol::bus::{Bus, BusError, RawReply, RawSample};
use zenav_protocol::topics::{ANNOTATE, Asker, EDGE_LOG, LOCALISE, MAP, MODE, PARAM, PART_LOG, Row, row_of};

use crate::failure::Failure;
use crate::tasks;

/// Default address: that of Zenoh's own REST plugin, on loopback.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:8000";
/// Longest wait for an answer or a sample.
const WITHIN: Duration = Duration::from_secs(2);
/// Time for gathering samples of a pattern.
const GATHERED: Duration = Duration::from_millis(500);
/// Most values in one answer.
const MOST_VALUES: usize = 1024;
/// Most requests at once; further ones are told to try again.
const MOST_REQUESTS: usize = 64;
/// Media type of the server's own messages.
const JSON: &str = "application/json";

struct Shared {
    bus: Bus,
    access: Access,
    places: Semaphore,
}

/// Serves the values of all keys at a loopback address as long as this process runs; returns the bound address.
///
/// # Errors
/// An address that is invalid, taken, or reachable from other machines.
pub async fn start(listen: &str, bus: Bus) -> Result<SocketAddr, Failure> {
    let failed = |error: std::io::Error| Failure::usage(format!("REST cannot listen on {listen}: {error}"));
    let (listener, address) = zenav_gateway::listen(listen).await.map_err(failed)?;
    let access = Access::new(address, None, Vec::new()).map_err(|_| {
        Failure::usage(format!(
            "REST on {listen}: expected an address of loopback, as {DEFAULT_LISTEN}: whoever reaches it sees everything; for other machines \
             there is `zenav gateway` with a token"
        ))
    })?;
    let shared = Arc::new(Shared {
        bus,
        access,
        places: Semaphore::new(MOST_REQUESTS),
    });
    let router = Router::new()
        .route("/{*key}", get(value))
        .method_not_allowed_fallback(read_only)
        .fallback(async || said(StatusCode::NOT_FOUND, "expected a key: GET /zenav/ROBOT/edge/pose"))
        .with_state(shared);
    tasks::spawn(async move {
        if let Err(error) = zenav_gateway::serve(listener, router, std::future::pending()).await {
            tracing::error!(%error, "REST ended");
        }
    });
    Ok(address)
}

async fn value(
    State(shared): State<Arc<Shared>>,
    Path(key): Path<String>,
    RawQuery(query): RawQuery,
    headers: HeaderMap,
) -> Response {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    if shared
        .access
        .admit(text(header::HOST), text(header::ORIGIN), None)
        .is_err()
    {
        return said(
            StatusCode::FORBIDDEN,
            "REST answers on this machine only, and to no page of another site",
        );
    }
    let Ok(_place) = shared.places.try_acquire() else {
        return said(StatusCode::SERVICE_UNAVAILABLE, "too many requests at once");
    };
    if row_of(&key).is_some_and(|row| !is_read(row)) {
        return read_only().await;
    }
    let selector = match query {
        Some(parameters) => format!("{key}?{}", parameters.replace('&', ";")),
        None => key.clone(),
    };
    let found = if key.contains('*') {
        pattern(&shared.bus, &key, &selector).await
    } else {
        one(&shared.bus, &key, &selector).await
    };
    found.unwrap_or_else(|error| said(StatusCode::BAD_REQUEST, &error.to_string()))
}

/// Whether a request without a body changes nothing: a topic, an ask of viewers, or one that then shows something.
fn is_read(row: &Row) -> bool {
    let shows = [
        MAP.pattern,
        LOCALISE.pattern,
        ANNOTATE.pattern,
        MODE.pattern,
        PARAM.pattern,
        EDGE_LOG.pattern,
        PART_LOG.pattern,
    ];
    matches!(row.asked_by, None | Some(Asker::Viewer)) || shows.contains(&row.pattern)
}

/// The answer of the key's queryable, otherwise its value.
async fn one(bus: &Bus, key: &str, selector: &str) -> Result<Response, BusError> {
    let deadline = Instant::now() + WITHIN;
    let mut samples = bus.raw_subscribe_kept(key, 1)?;
    if let Some(reply) = bus.raw_query(selector, None, WITHIN).await?.into_iter().next() {
        return Ok(match reply {
            RawReply::Ok(sample) => body(StatusCode::OK, &sample.encoding, sample.bytes),
            RawReply::Err { bytes, encoding } => body(StatusCode::UNPROCESSABLE_ENTITY, &encoding, bytes),
        });
    }
    while let Ok(Some(sample)) = timeout_at(deadline, samples.next()).await {
        if !sample.deleted {
            return Ok(body(StatusCode::OK, &sample.encoding, sample.bytes));
        }
    }
    let reason = format!("nobody serves {key}, and nothing came in {} s", WITHIN.as_secs());
    Ok(said(StatusCode::NOT_FOUND, &reason))
}

/// All answers to a pattern, and the newest value of each matching key.
async fn pattern(bus: &Bus, key: &str, selector: &str) -> Result<Response, BusError> {
    let deadline = Instant::now() + GATHERED;
    let mut samples = bus.raw_subscribe_kept(key, MOST_VALUES)?;
    let mut found = std::collections::BTreeMap::new();
    for reply in bus.raw_query(selector, None, WITHIN).await? {
        if let RawReply::Ok(sample) = reply {
            found.insert(sample.key.clone(), sample);
        }
    }
    while let Ok(Some(sample)) = timeout_at(deadline, samples.next()).await {
        if sample.deleted {
            found.remove(&sample.key);
        } else {
            found.insert(sample.key.clone(), sample);
        }
    }
    let list: Vec<Value> = found.values().take(MOST_VALUES).map(listed).collect();
    Ok(body(StatusCode::OK, JSON, Value::from(list).to_string().into_bytes()))
}

/// A sample in a list: JSON unchanged, anything else in base 64.
fn listed(sample: &RawSample) -> Value {
    let encoded = || Value::from(STANDARD.encode(&sample.bytes));
    let value = if sample.encoding == JSON {
        serde_json::from_slice(&sample.bytes).unwrap_or_else(|_| encoded())
    } else {
        encoded()
    };
    json!({ "key": sample.key, "value": value, "encoding": sample.encoding, "time": sample.stamp })
}

async fn read_only() -> Response {
    let mut response = said(
        StatusCode::METHOD_NOT_ALLOWED,
        "REST only reads: `zenav gateway` has an API that commands robots",
    );
    response
        .headers_mut()
        .insert(header::ALLOW, header::HeaderValue::from_static("GET, HEAD"));
    response
}

fn said(status: StatusCode, reason: &str) -> Response {
    let error = status.canonical_reason().unwrap_or("Error").replace(' ', "");
    body(
        status,
        JSON,
        json!({ "error": error, "reason": reason }).to_string().into_bytes(),
    )
}

fn body(status: StatusCode, encoding: &str, bytes: Vec<u8>) -> Response {
    // An encoding may name a schema behind a semicolon; an encoding that is not a media type counts as bytes.
    let kind = encoding
        .split(';')
        .next()
        .filter(|kind| kind.contains('/') && !kind.starts_with("zenoh/"));
    let kind = kind.unwrap_or("application/octet-stream").to_owned();
    let headers = [
        (header::CONTENT_TYPE, kind),
        (header::CACHE_CONTROL, "no-store".to_owned()),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned()),
    ];
    (status, headers, bytes).into_response()
}
