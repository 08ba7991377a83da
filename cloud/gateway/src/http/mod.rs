//! HTTP interface. How do browsers and programs reach the gateway?
//!
//! | file | answers |
//! |---|---|
//! | `robots` | robots, their events and maps; stop and resume |
//! | `goals` | goals: submit, list, cancel, pause, move in the queue |
//! | `annotations` | places and zones of a robot's map, and setting the robot's pose |
//! | `live` | the WebSocket: frames out; the watched robot and hand control in |
//! | `connections` | how many connections may be open, and how long may a request take to arrive? |
//! | `extract` | how does a request become typed values, and may it pass? |
//! | `error` | which status and which message? |
//! | `openapi` | what does the API look like? |

mod annotations;
mod connections;
mod error;
mod extract;
mod goals;
mod live;
mod openapi;
mod robots;
#[cfg(test)]
mod tests;

use std::future::Future;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{DefaultBodyLimit, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{from_fn_with_state, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use serde::Serialize;
use tokio::net::TcpListener;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::set_header::SetResponseHeaderLayer;
use tower_http::timeout::RequestBodyDeadlineLayer;

use crate::access::Access;
use crate::hub::Hub;
use crate::operator::Operator;
use crate::page;
use error::ApiError;

/// Largest body of a request, bytes: a goal may hold a behaviour tree.
const MAX_BODY: usize = 512 * 1024;
/// A body is held in memory, for each of up to a thousand connections; a browser opens six.
const LIMITS: connections::Limits = connections::Limits {
    most: 1024,
    // Longer than proxies keep idle connections.
    head_within: Duration::from_secs(75),
    // A map of several megabytes over a slow link.
    answer_within: Duration::from_secs(30),
};
/// Time limit for receiving a request's body.
const BODY_WITHIN: Duration = Duration::from_secs(30);
/// The page runs only its own scripts and styles, connects only to its own origin, and cannot be framed.
const CONTENT_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
                              base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// State shared by all handlers.
pub(crate) struct Shared {
    pub(crate) hub: Arc<Hub>,
    pub(crate) operator: Arc<dyn Operator>,
    pub(crate) access: Access,
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shared").field("hub", &self.hub).finish_non_exhaustive()
    }
}

type App = State<Arc<Shared>>;

/// The page and the API.
///
/// ```
#[doc = include_str!("../doc_setup/operator.txt")]
/// # use tower::ServiceExt;
/// let hub = Hub::new(GatewaySettings::default(), BTreeMap::new());
/// hub.take("tiago", Update::Part { component: "edge".into(), alive: true });
/// let site = router(hub, Arc::new(MadeUp), Access::new(DEFAULT_LISTEN.parse()?, None, Vec::new())?);
/// let request = |path: &str| Request::post(path).header("host", DEFAULT_LISTEN).body(Body::empty());
/// let stop = site.clone().oneshot(request("/api/v1/robots/tiago/stop")?).await?;
/// let nowhere = site.oneshot(request("/api/v1/robot")?).await?;
/// assert_eq!((stop.status(), nowhere.status()), (StatusCode::OK, StatusCode::NOT_FOUND));
/// # Ok(())
/// # }
/// ```
pub fn router(hub: Arc<Hub>, operator: Arc<dyn Operator>, access: Access) -> Router {
    let shared = Arc::new(Shared { hub, operator, access });
    let api = Router::new()
        .route("/health", get(robots::health))
        .route("/openapi.json", get(openapi::document))
        .route("/places", get(robots::places))
        .route("/stop", post(robots::stop_all))
        .route("/robots", get(robots::list))
        .route("/robots/{robot}", get(robots::one))
        .route("/robots/{robot}/events", get(robots::events))
        .route("/robots/{robot}/map", get(robots::map))
        .route("/robots/{robot}/stop", post(robots::stop))
        .route("/robots/{robot}/resume", post(robots::resume))
        .route("/robots/{robot}/pose", post(annotations::set_pose))
        .route("/robots/{robot}/places", get(annotations::places))
        .route(
            "/robots/{robot}/places/{place}",
            put(annotations::put_place).delete(annotations::delete_place),
        )
        .route("/robots/{robot}/zones", get(annotations::zones))
        .route(
            "/robots/{robot}/zones/{zone}",
            put(annotations::put_zone).delete(annotations::delete_zone),
        )
        .route("/robots/{robot}/goals", get(goals::list).post(goals::submit))
        .route("/robots/{robot}/goals/{goal}", get(goals::one).delete(goals::cancel))
        .route("/robots/{robot}/goals/{goal}/pause", post(goals::pause))
        .route("/robots/{robot}/goals/{goal}/resume", post(goals::resume))
        .route("/robots/{robot}/goals/{goal}/move", post(goals::move_in_queue))
        .route("/live", get(live::upgrade))
        .fallback(nothing_here)
        .method_not_allowed_fallback(wrong_method)
        .layer(from_fn_with_state(Arc::clone(&shared), extract::guard));
    let site = Router::new()
        .route("/", get(page::index))
        .route("/page/{file}", get(page::file))
        .fallback(nothing_here)
        .method_not_allowed_fallback(wrong_method)
        .layer(from_fn_with_state(Arc::clone(&shared), extract::guard_page));
    let set = |name: HeaderName, value: &'static str| {
        SetResponseHeaderLayer::overriding(name, HeaderValue::from_static(value))
    };
    Router::new()
        .nest("/api/v1", api)
        .merge(site)
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .layer(RequestBodyDeadlineLayer::new(BODY_WITHIN))
        .layer(set(header::CONTENT_SECURITY_POLICY, CONTENT_POLICY))
        .layer(set(header::X_CONTENT_TYPE_OPTIONS, "nosniff"))
        .layer(set(header::REFERRER_POLICY, "no-referrer"))
        .layer(set(header::CACHE_CONTROL, "no-store"))
        .layer(map_response(in_json))
        .layer(CatchPanicLayer::new())
        .with_state(shared)
}

/// Serves connections until `ended`; then closes open connections.
///
/// ```
#[doc = include_str!("../doc_setup/operator.txt")]
/// # use tokio::{io::{AsyncReadExt, AsyncWriteExt}, net::TcpStream, sync::oneshot};
/// let (listener, address) = listen("127.0.0.1:0").await?;
/// let hub = Hub::new(GatewaySettings::default(), BTreeMap::new());
/// let site = router(hub, Arc::new(MadeUp), Access::new(address, None, Vec::new())?);
/// let (end, ended) = oneshot::channel::<()>();
/// let serving = tokio::spawn(serve(listener, site, async { _ = ended.await }));
/// let (mut browser, mut reply) = (TcpStream::connect(address).await?, [0; 12]);
/// browser.write_all(format!("GET / HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).await?;
/// browser.read_exact(&mut reply).await?;
/// assert_eq!(&reply, b"HTTP/1.1 200");
/// drop(end);
/// serving.await??;
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// When the listener fails.
pub async fn serve(
    listener: TcpListener,
    router: Router,
    ended: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    connections::serve(listener, router, LIMITS, ended).await
}

/// Listens on an address; port 0 picks a free one.
///
/// ```
/// # #[tokio::main(flavor = "current_thread")]
/// # async fn main() -> std::io::Result<()> {
/// use zenav_gateway::listen;
///
/// let (_listener, address) = listen("127.0.0.1:0").await?;
/// assert!(address.ip().is_loopback() && address.port() != 0);
/// assert!(listen(&address.to_string()).await.is_err(), "in use");
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// When the address is invalid or in use.
pub async fn listen(address: &str) -> std::io::Result<(TcpListener, SocketAddr)> {
    let listener = TcpListener::bind(address).await?;
    let address = listener.local_addr()?;
    Ok((listener, address))
}

async fn nothing_here(uri: axum::http::Uri) -> ApiError {
    let path: String = uri.path().chars().take(200).collect();
    ApiError::not_found(format!("nothing at {path}: /api/v1/openapi.json lists what there is"))
}

async fn wrong_method() -> ApiError {
    ApiError::new(
        StatusCode::METHOD_NOT_ALLOWED,
        "MethodNotAllowed",
        "this path takes other methods: see `Allow`",
    )
}

/// Converts plain-text answers of other layers to JSON.
async fn in_json(response: Response) -> Response {
    let status = response.status();
    let is_text = response
        .headers()
        .get(header::CONTENT_TYPE)
        .is_none_or(|kind| kind.as_bytes().starts_with(b"text/plain"));
    if (status.is_client_error() || status.is_server_error()) && is_text {
        let reason = status.canonical_reason().unwrap_or("error");
        let mut answer = ApiError::new(status, "Error", reason).into_response();
        for (name, value) in response.headers() {
            if *name != header::CONTENT_TYPE && *name != header::CONTENT_LENGTH {
                answer.headers_mut().insert(name, value.clone());
            }
        }
        return answer;
    }
    response
}

/// A reply in JSON.
fn json(status: StatusCode, value: &impl Serialize) -> Response {
    match serde_json::to_string(value) {
        Ok(text) => json_text(status, text),
        Err(error) => {
            tracing::error!(%error, "a reply cannot be written as JSON");
            StatusCode::INTERNAL_SERVER_ERROR.into_response()
        }
    }
}

/// A reply that is already JSON.
fn json_text(status: StatusCode, text: String) -> Response {
    (status, [(header::CONTENT_TYPE, "application/json")], text).into_response()
}

/// A missing file of the page.
pub(crate) fn no_such_file(name: &str) -> Response {
    let name: String = name.chars().take(100).collect();
    ApiError::not_found(format!("the page has no file `{name}`")).into_response()
}
