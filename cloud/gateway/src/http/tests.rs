//! Tests of the HTTP interface, without a network.

use std::collections::BTreeMap;
use std::sync::Mutex;

use axum::body::{Body, to_bytes};
use axum::http::{Method, Request};
use serde_json::{Value, json};
use tokio::sync::watch;
use tower::ServiceExt as _;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    AnnotateAction, Annotations, CancelRequest, GoalPhase, GoalPoint, GoalReply, GoalRequest, GoalsReply, GoalsRequest,
    Health, LocaliseReply, MapReply, MoveGoalRequest, PauseRequest, Refusal, ResumeRequest, StopReply,
};

use super::*;
use crate::operator::{Answer, AskFailure, Drive};
use crate::settings::GatewaySettings;
use crate::view::Update;

/// Records all requests; refuses goals with x above 100, and never answers for the robot `mute`.
#[derive(Debug, Default)]
struct Scribe {
    asked: Mutex<Vec<String>>,
}

impl Scribe {
    fn note<T: Send + 'static>(&self, what: String, answer: Result<T, AskFailure>) -> Answer<T> {
        self.asked.lock().unwrap().push(what);
        Box::pin(std::future::ready(answer))
    }

    fn reply(id: &str, state: GoalPhase) -> GoalReply {
        GoalReply {
            id: id.to_owned(),
            state,
            reason: None,
            robot: None,
        }
    }
}

impl Operator for Scribe {
    fn submit(&self, robot: &str, goal: GoalRequest) -> Answer<GoalReply> {
        let id = goal.id.clone().unwrap();
        let answer = if goal.x.is_some_and(|x| x > 100.0) {
            Err(AskFailure::Refused(Refusal::Rejected {
                reason: "occupied".into(),
                nearest_free: Some(GoalPoint::at(1.0, 2.0)),
            }))
        } else {
            Ok(Self::reply(&id, GoalPhase::Accepted))
        };
        self.note(
            format!("submit {robot} {:?} {:?} {:?}", goal.x, goal.y, goal.yaw),
            answer,
        )
    }

    fn cancel(&self, robot: &str, request: CancelRequest) -> Answer<GoalReply> {
        let id = request.id.unwrap();
        self.note(
            format!("cancel {robot} {id}"),
            Ok(Self::reply(&id, GoalPhase::Canceled)),
        )
    }

    fn pause(&self, robot: &str, request: PauseRequest) -> Answer<GoalReply> {
        let id = request.id.unwrap();
        self.note(
            format!("pause {robot} {id} {}", request.resume),
            Ok(Self::reply(&id, GoalPhase::Paused)),
        )
    }

    fn goals(&self, robot: &str, _: GoalsRequest) -> Answer<GoalsReply> {
        self.note(format!("goals {robot}"), Ok(GoalsReply::default()))
    }

    fn move_goal(&self, robot: &str, request: MoveGoalRequest) -> Answer<GoalReply> {
        let reply = Self::reply(&request.id, GoalPhase::Accepted);
        self.note(format!("move {robot} {} {:?}", request.id, request.before), Ok(reply))
    }

    fn annotate(&self, robot: &str, action: AnnotateAction) -> Answer<Annotations> {
        let what = serde_json::to_string(&action).unwrap();
        self.note(format!("annotate {robot} {what}"), Ok(Annotations::default()))
    }

    fn set_pose(&self, robot: &str, pose: Pose2, by: &str) -> Answer<LocaliseReply> {
        let reply = LocaliseReply {
            health: Health::default(),
        };
        self.note(
            format!("pose {robot} {} {} {} {by}", pose.x, pose.y, pose.yaw),
            Ok(reply),
        )
    }

    fn stop(&self, robot: &str, by: &str) -> Answer<StopReply> {
        let answer = match robot {
            "mute" | "nobody" => Err(AskFailure::Timeout { key: "stop".into() }),
            _ => Ok(StopReply { stopped: true }),
        };
        self.note(format!("stop {robot} {by}"), answer)
    }

    fn resume(&self, robot: &str, request: ResumeRequest) -> Answer<StopReply> {
        let (boot_id, stop) = (request.boot_id.unwrap(), request.stop.unwrap());
        self.note(
            format!("resume {robot} {boot_id} {stop}"),
            Ok(StopReply { stopped: false }),
        )
    }

    fn map(&self, _: &str) -> Answer<MapReply> {
        self.note(
            "map".into(),
            Err(AskFailure::Refused(Refusal::Busy {
                reason: "4 maps".into(),
            })),
        )
    }

    fn drive(&self, _: &str, _: &str) -> Answer<Drive> {
        let drive = Drive {
            commands: watch::channel(None).0,
            ended: watch::channel(None).1,
        };
        self.note("drive".into(), Ok(drive))
    }
}

const HOST: &str = "127.0.0.1:7480";
const TOKEN: &str = "0123456789abcdef";

struct Site {
    hub: Arc<Hub>,
    router: Router,
    scribe: Arc<Scribe>,
}

fn site(token: Option<&str>, settings: GatewaySettings) -> Site {
    let places = BTreeMap::from([("sink".to_owned(), GoalPoint::at(0.9, 0.1))]);
    let hub = Hub::new(settings, places);
    for robot in ["tiago", "mute"] {
        let (component, alive) = ("edge".to_owned(), true);
        hub.take(robot, Update::Part { component, alive });
    }
    let scribe = Arc::new(Scribe::default());
    let access = Access::new(HOST.parse().unwrap(), token.map(str::to_owned), Vec::new()).unwrap();
    Site {
        router: router(Arc::clone(&hub), Arc::clone(&scribe) as Arc<dyn Operator>, access),
        hub,
        scribe,
    }
}

impl Site {
    async fn send(&self, request: Request<Body>) -> (StatusCode, Value) {
        let reply = self.router.clone().oneshot(request).await.unwrap();
        let status = reply.status();
        assert_eq!(reply.headers()["x-content-type-options"], "nosniff");
        let bytes = to_bytes(reply.into_body(), 1 << 20).await.unwrap();
        (status, serde_json::from_slice(&bytes).unwrap_or(Value::Null))
    }

    async fn ask(&self, method: Method, path: &str, body: Option<&str>) -> (StatusCode, Value) {
        let mut request = Request::builder().method(method).uri(path).header("host", HOST);
        if body.is_some() {
            request = request.header("content-type", "application/json");
        }
        let body = body.map_or_else(Body::empty, |text| Body::from(text.to_owned()));
        self.send(request.body(body).unwrap()).await
    }

    fn asked(&self) -> Vec<String> {
        std::mem::take(&mut self.scribe.asked.lock().unwrap())
    }
}

const POSE: &str = "/api/v1/robots/tiago/pose";
const ZONE: &str = "/api/v1/robots/tiago/zones/wet";
const GOALS: &str = "/api/v1/robots/tiago/goals";

#[tokio::test]
async fn a_resume_names_the_newest_stop_that_the_robot_has_reported() {
    let site = site(None, GatewaySettings::default());
    let report = |boot_id: &str, stops: u64| {
        let state = json!({
            "stamp": 1, "boot_id": boot_id, "mode": "stopped", "link": "Connected", "battery": 1.0, "guard": "clear", "stops": stops,
            "lease": { "holder": null, "role": null, "epoch": 1, "live": false }, "velocity": { "v": 0.0, "w": 0.0 },
        });
        let state = serde_json::from_value(state).unwrap();
        site.hub.take("tiago", Update::State(state));
    };
    let resume = || site.ask(Method::POST, "/api/v1/robots/tiago/resume", None);
    report("b", 1);
    assert_eq!(resume().await.0, StatusCode::OK);
    site.ask(Method::POST, "/api/v1/robots/tiago/stop", None).await;
    assert_eq!(resume().await.0, StatusCode::SERVICE_UNAVAILABLE, "no state since");
    report("b", 2);
    assert_eq!(resume().await.0, StatusCode::OK);
    report("c", 0);
    assert_eq!(resume().await.0, StatusCode::OK);
    let asked = [
        "resume tiago b 1",
        "stop tiago gateway",
        "resume tiago b 2",
        "resume tiago c 0",
    ];
    assert_eq!(site.asked(), asked);
}

#[tokio::test]
async fn goals_and_stops_reach_the_robot() {
    let site = site(None, GatewaySettings::default());
    let (status, reply) = site
        .ask(
            Method::POST,
            GOALS,
            Some(r#"{"x": 1.0, "y": -2.0, "yaw": 0.5, "id": "g1"}"#),
        )
        .await;
    assert_eq!(
        (status, &reply["id"], &reply["state"]),
        (StatusCode::ACCEPTED, &json!("g1"), &json!("Accepted"))
    );
    let (status, reply) = site.ask(Method::POST, GOALS, Some(r#"{"place": "sink"}"#)).await;
    assert_eq!(status, StatusCode::ACCEPTED);
    assert!(
        reply["id"].as_str().unwrap().starts_with("goal-"),
        "an id is made before the goal is sent"
    );
    for (method, path, wanted) in [
        (Method::DELETE, "/goals/g1", "cancel tiago g1"),
        (Method::POST, "/goals/g1/pause", "pause tiago g1 false"),
        (Method::POST, "/goals/g1/resume", "pause tiago g1 true"),
        (Method::POST, "/stop", "stop tiago gateway"),
    ] {
        site.asked();
        let (status, _) = site.ask(method, &format!("/api/v1/robots/tiago{path}"), None).await;
        assert_eq!((status, site.asked()), (StatusCode::OK, vec![wanted.to_owned()]));
    }
    let (status, reply) = site.ask(Method::POST, "/api/v1/stop", None).await;
    assert_eq!(status, StatusCode::GATEWAY_TIMEOUT, "one robot does not answer");
    assert_eq!(reply["robots"][1], json!({ "robot": "tiago", "stopped": true }));
    // Without known robots, nothing was stopped.
    let hub = Hub::new(GatewaySettings::default(), BTreeMap::new());
    let access = Access::new(HOST.parse().unwrap(), None, Vec::new()).unwrap();
    let empty = Site {
        router: router(Arc::clone(&hub), Arc::clone(&site.scribe) as Arc<dyn Operator>, access),
        hub,
        scribe: Arc::clone(&site.scribe),
    };
    let (status, reply) = empty.ask(Method::POST, "/api/v1/stop", None).await;
    assert_eq!(
        (status, &reply["robots"]),
        (StatusCode::SERVICE_UNAVAILABLE, &json!([]))
    );
}

#[tokio::test]
async fn what_is_drawn_on_the_map_and_where_the_robot_is_reach_whoever_keeps_it() {
    let site = site(None, GatewaySettings::default());
    for (method, path, body, wanted) in [
        (
            Method::POST,
            "pose",
            Some(r#"{"x": 1, "y": 2, "yaw": 0.5}"#),
            "pose tiago 1 2 0.5 gateway",
        ),
        (Method::GET, "places", None, r#"annotate tiago "get""#),
        (
            Method::PUT,
            "places/break%20room",
            Some(r#"{"x": 1, "y": 2}"#),
            r#"annotate tiago {"add_place":{"name":"break room","at":{"x":1.0,"y":2.0}}}"#,
        ),
        (
            Method::DELETE,
            "places/a%2Fb",
            None,
            r#"annotate tiago {"remove_place":{"name":"a/b"}}"#,
        ),
        (
            Method::PUT,
            "zones/wet",
            Some(r#"{"rule": {"speed_limit": {"max_speed": 0.2}}, "points": [[0, 0], [1, 0], [1, 1]]}"#),
            r#"annotate tiago {"add_zone":{"zone":{"name":"wet","rule":{"speed_limit":{"max_speed":0.2}},"points":[[0.0,0.0],[1.0,0.0],[1.0,1.0]]}}}"#,
        ),
        (
            Method::DELETE,
            "zones/wet",
            None,
            r#"annotate tiago {"remove_zone":{"name":"wet"}}"#,
        ),
        (
            Method::POST,
            "goals/g2/move",
            Some(r#"{"before": "g1"}"#),
            r#"move tiago g2 Some("g1")"#,
        ),
        (Method::POST, "goals/g2/move", Some("{}"), "move tiago g2 None"),
    ] {
        let (status, reply) = site
            .ask(method.clone(), &format!("/api/v1/robots/tiago/{path}"), body)
            .await;
        assert_eq!(
            (status, site.asked()),
            (StatusCode::OK, vec![wanted.to_owned()]),
            "{method} {path}: {reply}"
        );
    }
}

#[tokio::test]
async fn every_error_is_json_with_a_reason_and_its_status() {
    let site = site(None, GatewaySettings::default());
    let large = format!(r#"{{"tree": "{}"}}"#, "x".repeat(MAX_BODY));
    for (method, path, body, status, words) in [
        (Method::GET, "/api/v1/nothing", None, 404, "nothing at"),
        (Method::GET, "/nothing", None, 404, "nothing at"),
        (Method::GET, "/page/nothing.js", None, 404, "nothing.js"),
        (Method::GET, "/api/v1/robots/other", None, 404, "there is mute, tiago"),
        (Method::GET, "/api/v1/robots/a%2Fb", None, 404, "not a valid name"),
        (Method::GET, "/api/v1/robots/ti$*", None, 404, "not a valid name"),
        (Method::GET, "/api/v1/robots/ti%24o", None, 404, "not a valid name"),
        (Method::GET, "/api/v1/robots/%FF", None, 404, "UTF-8"),
        (Method::PUT, GOALS, None, 405, "other methods"),
        (Method::POST, GOALS, Some("{"), 400, "EOF"),
        (
            Method::POST,
            GOALS,
            Some(r#"{"x": 1, "tolerence": 2}"#),
            400,
            "tolerence",
        ),
        (
            Method::POST,
            GOALS,
            Some(r#"{"x": 1, "y": 1, "yaw": 90}"#),
            400,
            "radians",
        ),
        (
            Method::POST,
            GOALS,
            Some(r#"{"x": 1, "y": 1, "id": "a/b"}"#),
            400,
            "not a valid name",
        ),
        (Method::POST, GOALS, Some(large.as_str()), 413, "limit"),
        (Method::POST, POSE, Some(r#"{"x": 1, "y": 1}"#), 400, "yaw"),
        (
            Method::POST,
            POSE,
            Some(r#"{"x": 1, "y": 1, "yaw": 90}"#),
            400,
            "radians",
        ),
        (
            Method::PUT,
            ZONE,
            Some(r#"{"rule": "keepout", "points": []}"#),
            400,
            "keep_out",
        ),
        (
            Method::PUT,
            ZONE,
            Some(r#"{"rule": "keep_out", "points": [[1]]}"#),
            400,
            "length 1",
        ),
        (Method::GET, ZONE, None, 405, "other methods"),
        (Method::POST, GOALS, None, 415, "application/json"),
        (Method::POST, GOALS, Some(r#"{"x": 200, "y": 1}"#), 422, "occupied"),
        (Method::GET, "/api/v1/robots/tiago/map", None, 503, "4 maps"),
        (Method::POST, "/api/v1/robots/mute/stop", None, 504, "no answer"),
        (Method::POST, "/api/v1/robots/nobody/stop", None, 404, "there is mute"),
        (Method::GET, "/api/v1/live", None, 400, ""),
    ] {
        let (got, reply) = site.ask(method.clone(), path, body).await;
        assert_eq!(got.as_u16(), status, "{method} {path}: {reply}");
        let reason = reply["reason"]
            .as_str()
            .unwrap_or_else(|| panic!("{method} {path}: {reply}"));
        assert!(
            reason.contains(words) && reply["error"].is_string(),
            "{method} {path}: {reply}"
        );
    }
    let (_, reply) = site.ask(Method::POST, GOALS, Some(r#"{"x": 200, "y": 1}"#)).await;
    assert_eq!(reply["nearest_free"], json!({ "x": 1.0, "y": 2.0 }));
}

#[tokio::test]
async fn other_origins_other_hosts_and_wrong_tokens_get_nothing() {
    let (open, closed) = (
        site(None, GatewaySettings::default()),
        site(Some(TOKEN), GatewaySettings::default()),
    );
    let request = |headers: &[(&str, &str)]| {
        let mut request = Request::builder().uri("/api/v1/robots");
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        request.body(Body::empty()).unwrap()
    };
    let (bearer, lower) = (format!("Bearer {TOKEN}"), format!("bearer {TOKEN}"));
    let offered = format!("zenav.v1, bearer.{TOKEN}");
    for (site, headers, status) in [
        (&open, vec![("host", HOST)], 200),
        (&open, vec![("host", HOST), ("origin", "http://127.0.0.1:7480")], 200),
        (&open, vec![("host", HOST), ("origin", "http://evil.example")], 403),
        (
            &open,
            vec![("host", "evil.example"), ("origin", "http://evil.example")],
            403,
        ),
        (&open, vec![], 403),
        (&closed, vec![("host", HOST)], 401),
        (&closed, vec![("host", HOST), ("authorization", "Bearer wrong")], 401),
        (
            &closed,
            vec![("host", "robots.lan"), ("authorization", bearer.as_str())],
            200,
        ),
        (
            &closed,
            vec![("host", "robots.lan"), ("authorization", lower.as_str())],
            200,
        ),
        (
            &closed,
            vec![("host", "robots.lan"), ("sec-websocket-protocol", offered.as_str())],
            200,
        ),
    ] {
        let (got, reply) = site.send(request(&headers)).await;
        assert_eq!(got.as_u16(), status, "{headers:?}: {reply}");
    }
    let page = Request::builder()
        .uri("/")
        .header("host", "robots.lan")
        .body(Body::empty())
        .unwrap();
    assert_eq!(closed.send(page).await.0, StatusCode::OK, "the page holds no data");
}

#[tokio::test]
async fn too_many_requests_are_told_so_and_a_stop_is_never_one_of_them() {
    let settings = GatewaySettings {
        requests_hz: 3.0,
        ..GatewaySettings::default()
    };
    let site = site(None, settings);
    let mut statuses = Vec::new();
    for _ in 0..6 {
        statuses.push(site.ask(Method::GET, "/api/v1/health", None).await.0.as_u16());
    }
    assert_eq!(statuses[..3], [200; 3]);
    assert!(statuses.contains(&429), "{statuses:?}");
    assert_eq!(
        site.ask(Method::POST, "/api/v1/robots/tiago/stop", None).await.0,
        StatusCode::OK
    );
}

#[tokio::test]
async fn the_openapi_document_lists_what_there_is_and_nothing_else() {
    let settings = GatewaySettings {
        requests_hz: 1000.0,
        ..GatewaySettings::default()
    };
    let site = site(None, settings);
    let (status, document) = site.ask(Method::GET, "/api/v1/openapi.json", None).await;
    assert_eq!(status, StatusCode::OK);
    let mut routes = 0;
    for (path, item) in document["paths"].as_object().unwrap() {
        let concrete = path
            .replace("{robot}", "tiago")
            .replace("{goal}", "g1")
            .replace("{place}", "sink")
            .replace("{zone}", "wet");
        for (method, operation) in item
            .as_object()
            .unwrap()
            .iter()
            .filter(|(name, _)| *name != "parameters")
        {
            let method: Method = method.to_uppercase().parse().unwrap();
            let (got, _) = site.ask(method.clone(), &concrete, Some("{}")).await;
            let told = &operation["responses"][got.as_str()];
            assert!(
                told.is_object(),
                "{method} {path} answers {got}, which the document does not tell"
            );
            assert_ne!(got, StatusCode::METHOD_NOT_ALLOWED);
            routes += 1;
        }
    }
    let written = include_str!("mod.rs").split("    let site = ").next().unwrap();
    let written = written.split("    let api = ").nth(1).unwrap();
    let verbs = ["get(", "post(", "put(", "delete("].into_iter();
    let declared: usize = verbs.map(|verb| written.matches(verb).count()).sum();
    assert_eq!(routes, declared, "every route stands in the document");
    let text = document.to_string();
    for (at, _) in text.match_indices("#/components/schemas/") {
        let name = text[at + 21..].split('"').next().unwrap();
        assert!(document["components"]["schemas"][name].is_object(), "{name}");
    }
}

#[tokio::test]
async fn every_file_that_the_page_names_is_served() {
    let site = site(None, GatewaySettings::default());
    let get = async |path: &str| {
        let request = Request::builder()
            .uri(path)
            .header("host", HOST)
            .body(Body::empty())
            .unwrap();
        let reply = site.router.clone().oneshot(request).await.unwrap();
        assert_eq!(reply.status(), StatusCode::OK, "{path}");
        assert!(
            reply.headers()["content-security-policy"]
                .to_str()
                .unwrap()
                .contains("default-src 'none'")
        );
        String::from_utf8(to_bytes(reply.into_body(), 1 << 20).await.unwrap().to_vec()).unwrap()
    };
    let index = get("/").await;
    let mut named: Vec<String> = index
        .split('"')
        .filter(|text| text.starts_with("/page/"))
        .map(str::to_owned)
        .collect();
    let mut at = 0;
    while let Some(path) = named.get(at).cloned() {
        let text = get(&path).await;
        if path.ends_with(".js") {
            let imports = text
                .lines()
                .filter(|line| line.starts_with("import ") || line.starts_with("} from"));
            for line in imports {
                let file = line
                    .split("\"./")
                    .nth(1)
                    .and_then(|rest| rest.split('"').next())
                    .unwrap();
                let path = format!("/page/{file}");
                if !named.contains(&path) {
                    named.push(path);
                }
            }
        }
        at += 1;
    }
    assert!(named.len() > 15, "{named:?}");
}
