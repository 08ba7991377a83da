//! Can Foxglove see a running robot, and send it somewhere? Its protocol, spoken by a third-party client.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::collections::BTreeMap;
use std::time::Duration;

use foxglove::Decode as _;
use foxglove::messages::{Grid, LaserScan};
use futures_util::{SinkExt as _, StreamExt as _};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};
use zenav_protocol::messages::{GoalPhase, GoalState};
use zenav_protocol::topics;
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::observer::Observer;
use zenav_tests::process::Process;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest wait, wall time: far longer than needed even on a busy machine.
const LONG: Duration = Duration::from_secs(60);
/// First byte of a channel's message, in either direction; a number follows, and from the server the time.
const MESSAGE_DATA: u8 = 1;

/// A viewer.
struct Viewer {
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    /// Channels by topic: number, schema, encoding.
    channels: BTreeMap<String, (u64, String, String)>,
    subscribed: BTreeMap<u32, String>,
}

impl Viewer {
    async fn connect(address: &str) -> Self {
        let mut request = address.into_client_request().unwrap();
        let protocol = "foxglove.sdk.v1".parse().unwrap();
        request.headers_mut().insert("Sec-WebSocket-Protocol", protocol);
        let (socket, response) = connect_async(request).await.unwrap();
        assert_eq!(response.headers()["sec-websocket-protocol"], "foxglove.sdk.v1");
        Self {
            socket,
            channels: BTreeMap::new(),
            subscribed: BTreeMap::new(),
        }
    }

    async fn say(&mut self, message: Value) {
        self.socket.send(Message::text(message.to_string())).await.unwrap();
    }

    /// The next message of a subscribed channel, with its topic. Other messages are taken in on the way.
    async fn next(&mut self) -> Option<(String, Vec<u8>)> {
        match timeout(LONG, self.socket.next()).await.unwrap().unwrap().unwrap() {
            Message::Text(text) => {
                let message: Value = serde_json::from_str(&text).unwrap();
                if message["op"] == "advertise" {
                    for channel in message["channels"].as_array().unwrap() {
                        let text = |field: &str| channel[field].as_str().unwrap().to_owned();
                        let told = (channel["id"].as_u64().unwrap(), text("schemaName"), text("encoding"));
                        assert!(!text("schema").is_empty());
                        self.channels.insert(text("topic"), told);
                    }
                }
                None
            }
            Message::Binary(bytes) if bytes[0] == MESSAGE_DATA => {
                let number = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                let topic = self.subscribed[&number].clone();
                Some((topic, bytes[13..].to_vec()))
            }
            _ => None,
        }
    }

    /// The first message of a channel after subscribing to it.
    async fn first(&mut self, topic: &str, schema: &str, encoding: &str) -> Vec<u8> {
        while !self.channels.contains_key(topic) {
            self.next().await;
        }
        let (channel, name, told) = self.channels[topic].clone();
        assert_eq!((name.as_str(), told.as_str()), (schema, encoding), "{topic}");
        let number = self.subscribed.len() as u32 + 1;
        self.subscribed.insert(number, topic.to_owned());
        self.say(json!({ "op": "subscribe", "subscriptions": [{ "id": number, "channelId": channel }] }))
            .await;
        loop {
            if let Some((from, message)) = self.next().await
                && from == topic
            {
                return message;
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn foxglove_sees_a_robot_and_a_pose_published_there_becomes_its_goal() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let _up = deployment.start_up();
    let bus = deployment.bus().await;
    Observer::new(&bus, ROBOT)
        .until("a mission commands the robot", LONG, |state| state.lease.live)
        .await;
    let arguments = [
        "view",
        "--listen",
        "127.0.0.1:0",
        "--goals",
        "--connect",
        &deployment.router,
    ];
    let mut view = Process::start(ZENAV, &arguments, deployment.folder());
    let address = view.until("Foxglove: ", LONG).replace("Foxglove: ", "");
    let mut viewer = Viewer::connect(address.trim()).await;

    let scan = viewer.first("/tiago/scan", "foxglove.LaserScan", "protobuf").await;
    let scan = LaserScan::decode(scan.as_slice()).unwrap();
    let returns = scan.ranges.iter().filter(|range| **range > 0.0).count();
    assert!(
        scan.frame_id == "map" && scan.pose.is_some() && returns > 100,
        "{returns} returns"
    );
    let state = viewer.first("zenav/tiago/edge/state", "zenav.EdgeState", "json").await;
    let state: Value = serde_json::from_slice(&state).unwrap();
    assert!(state["velocity"]["v"].is_number(), "{state}");
    // Nothing changes the map of a robot at rest: a new viewer gets the last one.
    let map = viewer.first("/tiago/map", "foxglove.Grid", "protobuf").await;
    let map = Grid::decode(map.as_slice()).unwrap();
    let (rows, left_over) = (
        map.data.len() / map.row_stride as usize,
        map.data.len() % map.row_stride as usize,
    );
    assert_eq!((map.row_stride, left_over), (4 * map.column_count, 0));
    let known = map.data.chunks(4).filter(|cell| cell[3] > 0).count();
    assert!(rows > 10 && known > 100, "{known} cells in {rows} rows");

    let mut goals = bus.latest::<GoalState>(&topics::GOAL_STATE, &[ROBOT, "*"]).unwrap();
    viewer
        .say(json!({
            "op": "advertise",
            "channels": [{ "id": 7, "topic": "/goal", "encoding": "json", "schemaName": "foxglove.PoseInFrame" }],
        }))
        .await;
    let pose = json!({
        "frame_id": "map",
        "pose": { "position": { "x": 0.3, "y": -0.5, "z": 0.0 }, "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 } },
    });
    let mut message = vec![MESSAGE_DATA];
    message.extend(7_u32.to_le_bytes());
    message.extend(pose.to_string().as_bytes());
    viewer.socket.send(Message::binary(message)).await.unwrap();
    let ended = async {
        loop {
            let goal = goals.next().await.expect("the bus is open").message;
            if goal.state.is_end() {
                return goal;
            }
        }
    };
    // A viewer that never reads must not stop the others: this one reads nothing during the drive.
    let ended = timeout(LONG, ended).await.unwrap();
    assert_eq!(ended.state, GoalPhase::Succeeded, "{ended:?}");
}

/// Whether a server takes what its viewers publish.
async fn takes_goals(address: &str) -> bool {
    let mut viewer = Viewer::connect(address).await;
    loop {
        let message = timeout(LONG, viewer.socket.next()).await.unwrap().unwrap().unwrap();
        let Message::Text(text) = message else { continue };
        let message: Value = serde_json::from_str(&text).unwrap();
        if message["op"] == "serverInfo" {
            let capabilities = message["capabilities"].as_array().unwrap();
            return capabilities.iter().any(|capability| capability == "clientPublish");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_deployment_takes_goals_from_foxglove_only_where_it_was_told_to() {
    for (more, expected) in [(&[][..], false), (&["--goals"], true)] {
        let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
        let mut up = deployment.start_up_with(&[&["--foxglove", "127.0.0.1:0"], more].concat());
        let line = up.until("Foxglove: ", LONG);
        let (_, address) = line.split_once("Foxglove: ").unwrap();
        assert_eq!(takes_goals(address.trim()).await, expected, "{more:?}");
    }
}
