//! Errors of the API. Which status and which message? Always JSON: `{"error": NAME, "reason": WORDS}`.

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use zenav_protocol::messages::{GoalPoint, Refusal};

use super::json;
use crate::access::Denied;
use crate::operator::AskFailure;

/// An error reply.
#[derive(Debug)]
pub(crate) struct ApiError {
    pub(crate) status: StatusCode,
    body: Body,
}

#[derive(Debug, Serialize)]
struct Body {
    error: &'static str,
    reason: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    nearest_free: Option<GoalPoint>,
}

impl ApiError {
    pub(crate) fn new(status: StatusCode, error: &'static str, reason: impl Into<String>) -> Self {
        Self {
            status,
            body: Body {
                error,
                reason: reason.into(),
                nearest_free: None,
            },
        }
    }

    pub(crate) fn bad_request(reason: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "BadRequest", reason)
    }

    pub(crate) fn not_found(reason: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, "NotFound", reason)
    }

    pub(crate) fn busy(reason: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, "Busy", reason)
    }

    pub(crate) fn too_many() -> Self {
        Self::new(
            StatusCode::TOO_MANY_REQUESTS,
            "TooManyRequests",
            "too many requests a second: `[gateway] requests_hz` is the limit",
        )
    }
}

impl From<Denied> for ApiError {
    fn from(denied: Denied) -> Self {
        match denied {
            Denied::Token => Self::new(
                StatusCode::UNAUTHORIZED,
                "Unauthorized",
                "expected the gateway's token: `Authorization: Bearer TOKEN`",
            ),
            Denied::Origin => Self::new(
                StatusCode::FORBIDDEN,
                "Forbidden",
                "a page of this origin may not use the gateway: `[gateway] origins` names others than its own",
            ),
            Denied::Host => Self::new(
                StatusCode::FORBIDDEN,
                "Forbidden",
                "the gateway has no token: it answers to `localhost` and addresses of loopback only",
            ),
        }
    }
}

impl From<Refusal> for ApiError {
    fn from(refusal: Refusal) -> Self {
        let reason = refusal.to_string();
        match refusal {
            Refusal::Rejected { reason, nearest_free } => {
                let mut error = Self::new(StatusCode::UNPROCESSABLE_ENTITY, "Rejected", reason);
                error.body.nearest_free = nearest_free;
                error
            }
            // The request was well-formed; the server found its content invalid.
            Refusal::BadRequest { reason } => Self::new(StatusCode::UNPROCESSABLE_ENTITY, "Rejected", reason),
            Refusal::TooLarge { .. } => Self::new(StatusCode::PAYLOAD_TOO_LARGE, "TooLarge", reason),
            Refusal::NotFound { .. } => Self::not_found(reason),
            Refusal::NotLeader | Refusal::NotCaughtUp { .. } => Self::new(
                StatusCode::SERVICE_UNAVAILABLE,
                "NotLeader",
                format!("{reason}: `zenav doctor` says why, `zenav lease forget` lets another mission lead"),
            ),
            Refusal::Held { .. } => Self::new(StatusCode::CONFLICT, "Held", reason),
            Refusal::WrongEpoch { .. } => Self::new(StatusCode::CONFLICT, "WrongEpoch", reason),
            Refusal::Busy { .. } => Self::busy(reason),
            Refusal::Internal { .. } => Self::new(StatusCode::BAD_GATEWAY, "Internal", reason),
        }
    }
}

impl From<AskFailure> for ApiError {
    fn from(failure: AskFailure) -> Self {
        let reason = failure.to_string();
        match failure {
            AskFailure::Refused(refusal) => refusal.into(),
            AskFailure::Timeout { .. } => Self::new(StatusCode::GATEWAY_TIMEOUT, "Timeout", reason),
            AskFailure::Unavailable { .. } => Self::new(StatusCode::SERVICE_UNAVAILABLE, "Unavailable", reason),
        }
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let mut response = json(self.status, &self.body);
        let headers = response.headers_mut();
        match self.status {
            StatusCode::UNAUTHORIZED => {
                headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
            }
            StatusCode::TOO_MANY_REQUESTS | StatusCode::SERVICE_UNAVAILABLE => {
                headers.insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
            }
            _ => {}
        }
        response
    }
}
