//! Requests. The same bytes as what arrives on a connection of the mission-control page's server and on one of a health endpoint.

#![allow(
    clippy::expect_used,
    reason = "a server that ends a connection with an error is a finding"
)]

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::future::ready;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper::{Request, StatusCode, body::Incoming};
use hyper_util::rt::TokioIo;
use hyper_util::service::TowerToHyperService;
use serde::de::DeserializeOwned;
use serde_json::Value;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _, DuplexStream, duplex, split};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::watch;
use zenav_gateway::{Access, Answer, DEFAULT_LISTEN, Drive, GatewaySettings, Hub, Operator, Update, router};
use zenav_observability::server;
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    AnnotateAction, Annotations, CancelRequest, GoalPoint, GoalReply, GoalRequest, GoalsReply, GoalsRequest,
    LocaliseReply, MapReply, MoveGoalRequest, PauseRequest, ResumeRequest, StopReply,
};

use super::wire::golden;

/// The robot of the fleet.
const ROBOT: &str = "tiago";
/// Token of the server that listens for other machines.
const TOKEN: &str = "0123456789abcdef";
/// Answers of a health endpoint to what it knows: a process without parts is not ready.
const KNOWN: [&str; 2] = ["HTTP/1.1 200 ", "HTTP/1.1 503 "];
/// Bytes under way in each direction.
const ROOM: usize = 1 << 16;
/// Head of an upgrade to the WebSocket, without its empty line.
const UPGRADE: &str = "connection: upgrade\r\nupgrade: websocket\r\nsec-websocket-version: 13\r\n\
                       sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\nsec-websocket-protocol: zenav.v1\r\n";

/// A request of every operation of the API, of a file of the page, and of every path of a health endpoint.
///
/// # Panics
/// When the API has no description.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let described = said_by(&runtime(), None, request("get", "/api/v1/openapi.json", "").as_bytes());
    let body = described.text.split_once("\r\n\r\n").expect("a body").1;
    let document: Value = serde_json::from_str(body).expect("an OpenAPI document");
    let mut seeds = Vec::new();
    for (path, item) in document["paths"].as_object().expect("paths") {
        let path = path.replace("{robot}", ROBOT);
        let path = ["{goal}", "{place}", "{zone}"]
            .iter()
            .fold(path, |path, name| path.replace(name, "g1"));
        for method in ["get", "put", "post", "delete"]
            .into_iter()
            .filter(|method| item[method].is_object())
        {
            let schema = &item[method]["requestBody"]["content"]["application/json"]["schema"]["$ref"];
            seeds.push(request(method, &path, body_of(schema)).into_bytes());
        }
    }
    seeds.push(request("get", "/page/style.css", "").into_bytes());
    seeds.extend(["/livez", "/readyz?verbose", "/metrics"].map(|path| request("get", path, "").into_bytes()));
    seeds.push(conversation());
    seeds
}

/// A valid body of a schema of the API.
fn body_of(schema: &Value) -> &'static str {
    let name = schema.as_str().and_then(|path| path.rsplit('/').next());
    match name {
        Some("Goal") => r#"{"x":1.5,"y":-0.5,"yaw":1.57,"on_busy":"queue","priority":2,"blackboard":{"laps":3}}"#,
        Some("Move") => r#"{"before":"g0"}"#,
        Some("Pose") => r#"{"x":1.5,"y":-0.5,"yaw":1.57}"#,
        Some("Place") => r#"{"x":1.5,"y":-0.5}"#,
        Some("NewZone") => r#"{"rule":{"speed_limit":{"max_speed":0.3}},"points":[[0,0],[2,0],[2,1]]}"#,
        _ => "",
    }
}

fn request(method: &str, path: &str, body: &str) -> String {
    let method = method.to_uppercase();
    let head = format!("{method} {path} HTTP/1.1\r\nhost: {DEFAULT_LISTEN}\r\nauthorization: Bearer {TOKEN}\r\n");
    let content = match body.len() {
        0 => String::new(),
        length => format!("content-type: application/json\r\ncontent-length: {length}\r\n"),
    };
    let upgrade = if path.ends_with("/live") { UPGRADE } else { "" };
    format!("{head}{content}{upgrade}\r\n{body}")
}

/// A WebSocket on which a robot is watched and driven.
fn conversation() -> Vec<u8> {
    let mut bytes = request("get", "/api/v1/live", "").into_bytes();
    for text in [
        r#"{"type":"watch","robot":"tiago"}"#,
        r#"{"type":"ping","t":1.5}"#,
        r#"{"type":"arm","robot":"tiago"}"#,
        r#"{"type":"drive","v":0.2,"w":-0.5,"sent":0.5}"#,
        r#"{"type":"disarm"}"#,
    ] {
        // A text in one frame, with a mask of zeros.
        bytes.extend([0x81, 0x80 | text.len() as u8, 0, 0, 0, 0]);
        bytes.extend(text.as_bytes());
    }
    bytes
}

/// Sends the bytes to a server for this machine alone, to one with a token, and to a health endpoint.
///
/// # Panics
/// When an answer blames the server, or somebody without the token reaches a robot.
pub fn exercise(bytes: &[u8]) -> usize {
    let runtime = runtime();
    let [open, closed] = [None, Some(TOKEN)].map(|token| said_by(&runtime, token, bytes));
    let has_token = bytes.windows(TOKEN.len()).any(|window| window == TOKEN.as_bytes());
    assert!(has_token || closed.asked == 0, "a robot was asked without the token");
    for status in [&open, &closed].into_iter().flat_map(|said| &said.statuses) {
        assert!(
            *status != StatusCode::INTERNAL_SERVER_ERROR,
            "a request fails in the server"
        );
    }
    let health = runtime.block_on(async {
        let (here, there) = duplex(ROOM);
        let (answered, said) = tokio::join!(server::answer(here), tell(there, bytes));
        answered.expect("no error of the connection");
        said
    });
    assert!(health.is_empty() || health.starts_with("HTTP/1.1 "), "{health}");
    let is_taken = |status: &&StatusCode| status.is_success() || **status == StatusCode::SWITCHING_PROTOCOLS;
    let taken = |said: &Said| said.statuses.iter().filter(is_taken).count();
    taken(&open) + taken(&closed) + usize::from(KNOWN.iter().any(|status| health.starts_with(status)))
}

fn runtime() -> Runtime {
    Builder::new_current_thread().enable_time().build().expect("a runtime")
}

/// What a server did with one connection.
struct Said {
    text: String,
    statuses: Vec<StatusCode>,
    /// Number of requests to robots.
    asked: usize,
}

/// Serves one connection on which these bytes arrive, and nothing after them.
fn said_by(runtime: &Runtime, token: Option<&str>, bytes: &[u8]) -> Said {
    let home = GoalPoint {
        x: 0.0,
        y: 0.0,
        yaw: None,
    };
    let hub = Hub::new(GatewaySettings::default(), BTreeMap::from([("home".to_owned(), home)]));
    hub.take(ROBOT, Update::State(message("EdgeState")));
    hub.take(ROBOT, Update::Pose(message("PoseEstimate")));
    hub.announce(true);
    let obedient = Arc::new(Obedient {
        hub: Arc::clone(&hub),
        asked: AtomicUsize::new(0),
    });
    let address = DEFAULT_LISTEN.parse().expect("an address");
    let access = Access::new(address, token.map(str::to_owned), Vec::new()).expect("a token");
    let operator: Arc<dyn Operator> = Arc::<Obedient>::clone(&obedient);
    let site = TowerToHyperService::new(router(hub, operator, access));
    let statuses = Arc::new(Mutex::new(Vec::new()));
    let noted = Arc::clone(&statuses);
    let service = service_fn(move |request: Request<Incoming>| {
        let (answer, noted) = (site.call(request), Arc::clone(&noted));
        async move {
            let response = answer.await?;
            noted
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(response.status());
            Ok::<_, Infallible>(response)
        }
    });
    let text = runtime.block_on(async {
        let (here, there) = duplex(ROOM);
        let mut http = http1::Builder::new();
        let connection = http.half_close(true).serve_connection(TokioIo::new(here), service);
        // A request that is none is an error of the connection.
        tokio::join!(connection.with_upgrades(), tell(there, bytes)).1
    });
    let statuses = statuses.lock().unwrap_or_else(PoisonError::into_inner).clone();
    Said {
        text,
        statuses,
        asked: obedient.asked.load(Ordering::Relaxed),
    }
}

/// Sends bytes, then nothing more, and hears what comes back.
async fn tell(stream: DuplexStream, bytes: &[u8]) -> String {
    let (mut from, mut to) = split(stream);
    let mut heard = Vec::new();
    let telling = async {
        // Whoever has heard enough closes the connection.
        let _ = to.write_all(bytes).await;
        let _ = to.shutdown().await;
    };
    let (_, all) = tokio::join!(telling, from.read_to_end(&mut heard));
    all.expect("no error of the connection");
    String::from_utf8_lossy(&heard).into_owned()
}

/// A golden message.
fn message<T: DeserializeOwned>(name: &str) -> T {
    let (_, json) = golden().find(|(known, _)| *known == name).expect(name);
    codec::decode(json.as_bytes(), Encoding::Json, usize::MAX).expect(name)
}

/// Does whatever it is asked.
struct Obedient {
    hub: Arc<Hub>,
    asked: AtomicUsize,
}

impl Obedient {
    fn reply<T: DeserializeOwned + Send + 'static>(&self, name: &str) -> Answer<T> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        Box::pin(ready(Ok(message(name))))
    }
}

impl Operator for Obedient {
    fn submit(&self, _: &str, _: GoalRequest) -> Answer<GoalReply> {
        self.reply("GoalReply")
    }

    fn cancel(&self, _: &str, _: CancelRequest) -> Answer<GoalReply> {
        self.reply("GoalReply")
    }

    fn pause(&self, _: &str, _: PauseRequest) -> Answer<GoalReply> {
        self.reply("GoalReply")
    }

    fn goals(&self, _: &str, _: GoalsRequest) -> Answer<GoalsReply> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        let goals = vec![message("GoalState")];
        Box::pin(ready(Ok(GoalsReply {
            goals,
            ..GoalsReply::default()
        })))
    }

    fn move_goal(&self, _: &str, _: MoveGoalRequest) -> Answer<GoalReply> {
        self.reply("GoalReply")
    }

    fn annotate(&self, _: &str, _: AnnotateAction) -> Answer<Annotations> {
        self.reply("Annotations")
    }

    fn set_pose(&self, _: &str, _: Pose2, _: &str) -> Answer<LocaliseReply> {
        self.reply("LocaliseReply")
    }

    fn stop(&self, robot: &str, _: &str) -> Answer<StopReply> {
        let (hub, robot) = (Arc::clone(&self.hub), robot.to_owned());
        // The robot reports its stop at once.
        tokio::spawn(async move { hub.take(&robot, Update::State(message("EdgeState"))) });
        self.reply("StopReply")
    }

    fn resume(&self, _: &str, _: ResumeRequest) -> Answer<StopReply> {
        self.reply("StopReply")
    }

    fn map(&self, _: &str) -> Answer<MapReply> {
        self.reply("MapReply")
    }

    fn drive(&self, _: &str, _: &str) -> Answer<Drive> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        let drive = Drive {
            commands: watch::channel(None).0,
            ended: watch::channel(None).1,
        };
        Box::pin(ready(Ok(drive)))
    }
}
