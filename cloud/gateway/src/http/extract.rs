//! Extractors. How does a request become typed values, and what is the reason if it cannot?

use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::{FromRequest, FromRequestParts, Path, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde::de::DeserializeOwned;
use zenav_protocol::id::Id;

use super::Shared;
use super::error::ApiError;
use crate::access::Denied;

/// A header as text.
fn text<'h>(headers: &'h HeaderMap, name: &header::HeaderName) -> Option<&'h str> {
    headers.get(name)?.to_str().ok()
}

/// The token of a request, from a header or from the subprotocol of a WebSocket. The scheme's name has no case (RFC 9110, section 11.1).
fn token(headers: &HeaderMap) -> Option<&str> {
    let credentials = text(headers, &header::AUTHORIZATION).and_then(|value| value.split_once(' '));
    let bearer = credentials.filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"));
    let bearer = bearer.map(|(_, token)| token);
    let protocols = text(headers, &header::SEC_WEBSOCKET_PROTOCOL);
    let offered = || {
        protocols?
            .split(',')
            .find_map(|protocol| protocol.trim().strip_prefix("bearer."))
    };
    bearer.or_else(offered).map(str::trim)
}

/// Refuses requests for data that may not pass, before any of them is read.
pub(super) async fn guard(
    axum::extract::State(shared): axum::extract::State<Arc<Shared>>,
    request: Request,
    next: Next,
) -> Response {
    let headers = request.headers();
    let host = text(headers, &header::HOST);
    // An origin that is not text matches none.
    let origin = headers
        .get(header::ORIGIN)
        .map(|origin| origin.to_str().unwrap_or("null"));
    // Images and scripts embedded by another site carry no `Origin`, but browsers mark them (Fetch Metadata). Following a link from there
    // is harmless: the user sees the answer, the other site does not.
    let is_followed = request.method() == Method::GET
        && ["sec-fetch-mode", "sec-fetch-dest"].map(|name| headers.get(name).map(|value| value.as_bytes()))
            == [Some(b"navigate".as_slice()), Some(b"document".as_slice())];
    let is_of_another = origin.is_none()
        && !is_followed
        && headers
            .get("sec-fetch-site")
            .is_some_and(|site| site == "cross-site" || site == "same-site");
    if is_of_another {
        return ApiError::from(Denied::Origin).into_response();
    }
    if let Err(denied) = shared.access.admit(host, origin, token(headers)) {
        return ApiError::from(denied).into_response();
    }
    // Stops are never rate-limited.
    let is_stop = request.method() == Method::POST && request.uri().path().ends_with("/stop");
    if !is_stop && !shared.hub.admits() {
        return ApiError::too_many().into_response();
    }
    next.run(request).await
}

/// Refuses requests for the page under a host name that is not the gateway's.
pub(super) async fn guard_page(
    axum::extract::State(shared): axum::extract::State<Arc<Shared>>,
    request: Request,
    next: Next,
) -> Response {
    match shared.access.admit_page(text(request.headers(), &header::HOST)) {
        Ok(()) => next.run(request).await,
        Err(denied) => ApiError::from(denied).into_response(),
    }
}

/// Names in the path, validated: `{robot}`, and `{goal}` if present.
#[derive(Debug)]
pub(super) struct Named<const N: usize>(pub(super) [String; N]);

impl<const N: usize, S: Send + Sync> FromRequestParts<S> for Named<N> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let chunks = chunks_of::<N, S>(parts, state).await?;
        for chunk in &chunks {
            checked(chunk)?;
        }
        Ok(Self(chunks))
    }
}

/// A robot, and a name that people gave to something on its map: it is not part of a key, so the mapping service decides what is valid.
#[derive(Debug)]
pub(super) struct RobotAnd(pub(super) String, pub(super) String);

impl<S: Send + Sync> FromRequestParts<S> for RobotAnd {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let [robot, name] = chunks_of::<2, S>(parts, state).await?;
        checked(&robot)?;
        Ok(Self(robot, name))
    }
}

async fn chunks_of<const N: usize, S: Send + Sync>(parts: &mut Parts, state: &S) -> Result<[String; N], ApiError> {
    let Path(chunks) = Path::<Vec<(String, String)>>::from_request_parts(parts, state)
        .await
        .map_err(|error| ApiError::not_found(error.body_text()))?;
    let values: Vec<String> = chunks.into_iter().map(|(_, value)| value).collect();
    values
        .try_into()
        .map_err(|_| ApiError::not_found("this path has other names"))
}

fn checked(name: &str) -> Result<(), ApiError> {
    match Id::new(name) {
        Ok(_) => Ok(()),
        Err(error) => Err(ApiError::not_found(error.to_string())),
    }
}

/// A body in JSON.
#[derive(Debug)]
pub(super) struct JsonBody<T>(pub(super) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for JsonBody<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> Result<Self, ApiError> {
        let kind = text(request.headers(), &header::CONTENT_TYPE).unwrap_or_default();
        let is_json = kind
            .split(';')
            .next()
            .is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"));
        if !is_json {
            return Err(ApiError::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "UnsupportedMediaType",
                "expected `Content-Type: application/json`",
            ));
        }
        let bytes = Bytes::from_request(request, state).await.map_err(|error| {
            let status = error.status();
            let name = if status == StatusCode::PAYLOAD_TOO_LARGE {
                "TooLarge"
            } else {
                "BadRequest"
            };
            ApiError::new(status, name, error.body_text())
        })?;
        serde_json::from_slice(&bytes)
            .map(Self)
            .map_err(|error| ApiError::bad_request(error.to_string()))
    }
}
