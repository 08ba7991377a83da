//! Live view. Shows a running deployment in Foxglove, over Foxglove's WebSocket protocol, with the messages that a record also holds.
//!
//! Channels are Foxglove's own messages ([`super::foxglove`]) and every key whose samples are JSON objects. A late viewer gets the last
//! message of each channel that is still meaningful; a slow one loses messages but delays nobody. A pose published on `/goal` (or
//! `/ROBOT/goal`, `/move_base_simple/goal`) becomes a goal if that is enabled.
//!
//! The protocol has no access control, and a browser lets any page open such a connection. Therefore the server listens on loopback only,
//! and accepts goals only with `--goals`.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use foxglove::websocket::{Capability, ChannelView, Client, ClientChannel, ServerListener};
use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, SinkId, WebSocketServer, WebSocketServerHandle};
use serde::Deserialize;
use tokio::sync::mpsc;
use zenav_protocol::bus::{Bus, interrupted};
use zenav_protocol::codec::Encoding;
use zenav_protocol::geometry::wrap_angle;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{GoalRequest, OnBusy};
use zenav_protocol::topics;

use super::format::{Kind, Sample};
use super::foxglove::{Artist, Drawn, ENCODING, MAP};
use super::listener::Listener;
use super::maps::Maps;
use super::schema;
use crate::connect::{self, RobotArgs, fresh_id};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::tasks;

/// Foxglove's own port, on loopback.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:8765";
/// Most messages queued for a slow viewer.
const BACKLOG: usize = 256;
/// Most channels: keys that contain names come and go. Of goals, the one that was heard least recently goes.
const MOST_CHANNELS: usize = 1024;
/// Most viewer requests queued.
const REQUESTS: usize = 64;
/// Period of asking for missing maps.
const EVERY: Duration = Duration::from_secs(1);
/// Longest wait for a goal to be accepted.
const PATIENCE: Duration = Duration::from_secs(5);

/// Arguments of `zenav view`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav view\n  zenav view --goals --listen 127.0.0.1:0\n\nIn Foxglove: Open connection, Foxglove WebSocket, ws://localhost:8765; then import the layout deploy/foxglove/zenav.json.\nWith --goals a pose that the 3D panel publishes on /goal becomes a goal: only where no page of another site is open in a browser here."
)]
pub struct ViewArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Loopback address to listen on; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS:PORT", default_value = DEFAULT_LISTEN)]
    listen: String,
    /// Accept poses published on `/goal` as goals
    #[arg(long)]
    goals: bool,
}

/// `zenav view`.
///
/// # Errors
/// No connection, an address that is taken or that other machines can reach.
pub fn view(args: &ViewArgs) -> Outcome {
    connect::on_bus(&args.robot.link, async |bus| {
        let robot = args.robot.robot.as_deref();
        connect::tell_absence(&bus, robot).await;
        let mut view = LiveView::start(&bus, robot, &args.listen, args.goals).await?;
        crate::output::note(format_args!("Foxglove: {}", view.address()));
        tokio::select! {
            () = interrupted() => {}
            () = view.ended() => {}
        }
        Ok(exit_code::OK)
    })
}

/// A running live view; dropping it ends it.
#[derive(Debug)]
pub struct LiveView {
    server: Option<WebSocketServerHandle>,
    address: String,
    task: tokio::task::JoinHandle<()>,
}

impl Drop for LiveView {
    fn drop(&mut self) {
        self.task.abort();
        if let Some(server) = self.server.take() {
            let _ = server.stop();
        }
    }
}

impl LiveView {
    /// Shows one robot, or all, at a loopback address.
    ///
    /// # Errors
    /// An address that is invalid, taken, or reachable from other machines.
    pub async fn start(bus: &Bus, robot: Option<&str>, listen: &str, goals: bool) -> Result<Self, Failure> {
        let expected = || {
            Failure::usage(format!(
                "{listen}: expected an address of loopback, such as {DEFAULT_LISTEN}"
            ))
        };
        let address: SocketAddr = listen.parse().map_err(|_| expected())?;
        if !address.ip().is_loopback() {
            return Err(expected());
        }
        let mut patterns = vec![format!("zenav/{}/**", robot.unwrap_or("*"))];
        patterns.extend(robot.map(|_| topics::SIM_CLOCK.key(&[])));
        let listener = Listener::new(bus, &patterns)?;
        let (requests, wanted) = mpsc::channel(REQUESTS);
        let context = Context::new();
        let mut server = WebSocketServer::new()
            .name("zenav")
            .bind(address.ip().to_string(), address.port())
            .context(&context)
            .message_backlog_size(BACKLOG)
            .listener(Arc::new(Viewers { requests }));
        if goals {
            server = server
                .capabilities([Capability::ClientPublish])
                .supported_encodings(["json"]);
        }
        let server = server.start().await.map_err(|error| {
            Failure::failed(format!(
                "Foxglove cannot be served on {listen}: {error}; another `zenav view`? see --listen"
            ))
        })?;
        let port = server.port();
        let show = Show {
            bus: bus.clone(),
            only: robot.map(str::to_owned),
            channels: Channels::new(context),
            artist: Artist::default(),
            maps: Maps::default(),
            robots: BTreeSet::new(),
        };
        Ok(Self {
            server: Some(server),
            address: format!("ws://{}", SocketAddr::new(address.ip(), port)),
            task: tasks::spawn(show.run(listener, wanted)),
        })
    }

    /// Address for viewers.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Waits until the bus is closed.
    pub async fn ended(&mut self) {
        let _ = (&mut self.task).await;
    }
}

/// A viewer's request.
#[derive(Debug)]
enum Wanted {
    /// The last message of a channel, for one viewer.
    Last { topic: String, viewer: SinkId },
    /// A goal at a pose.
    Goal { topic: String, payload: Vec<u8> },
}

/// Receives viewers' requests, on threads that must not block.
struct Viewers {
    requests: mpsc::Sender<Wanted>,
}

impl ServerListener for Viewers {
    fn on_subscribe(&self, client: Client, channel: ChannelView) {
        if let Some(viewer) = client.sink_id() {
            let topic = channel.topic().to_owned();
            let _ = self.requests.try_send(Wanted::Last { topic, viewer });
        }
    }

    fn on_message_data(&self, _: Client, channel: &ClientChannel, payload: &[u8]) {
        let (topic, payload) = (channel.topic.clone(), payload.to_vec());
        let _ = self.requests.try_send(Wanted::Goal { topic, payload });
    }
}

/// A channel, and its last message for each key it shows.
struct Shown {
    channel: Arc<RawChannel>,
    last: BTreeMap<String, (u64, Vec<u8>)>,
}

/// The channels that viewers see.
struct Channels {
    context: Arc<Context>,
    shown: BTreeMap<String, Shown>,
    is_full: bool,
}

impl Channels {
    fn new(context: Arc<Context>) -> Self {
        Self {
            context,
            shown: BTreeMap::new(),
            is_full: false,
        }
    }

    /// Sends a message to the viewers of its channel; the first message of a channel describes it.
    fn publish(
        &mut self,
        topic: &str,
        key: &str,
        message: &[u8],
        now: u64,
        describe: impl FnOnce() -> Option<(foxglove::Schema, &'static str)>,
    ) {
        if !self.shown.contains_key(topic) {
            if self.shown.len() >= MOST_CHANNELS && !self.forget_goal() {
                if !std::mem::replace(&mut self.is_full, true) {
                    tracing::warn!("over {MOST_CHANNELS} keys: Foxglove sees the first");
                }
                return;
            }
            let Some((schema, encoding)) = describe() else { return };
            let channel = ChannelBuilder::new(topic)
                .message_encoding(encoding)
                .schema(schema)
                .context(&self.context)
                .build_raw();
            let Ok(channel) = channel else { return };
            let last = BTreeMap::new();
            self.shown.insert(topic.to_owned(), Shown { channel, last });
        }
        if let Some(shown) = self.shown.get_mut(topic) {
            shown
                .channel
                .log_with_meta(message, PartialMetadata::with_log_time(now));
            // Most channels show a few keys; only a log has one per goal.
            if shown.last.len() < REQUESTS || shown.last.contains_key(key) {
                shown.last.insert(key.to_owned(), (now, message.to_vec()));
            }
        }
    }

    /// Makes room for a channel: the goal that was heard least recently is no longer shown. Whether there was one.
    fn forget_goal(&mut self) -> bool {
        let heard = |shown: &Shown| shown.last.values().map(|(now, _)| *now).max();
        let goals = self.shown.iter();
        let goals = goals.filter(|(topic, _)| !topics::GOAL_STATE.chunks(topic).is_empty());
        let oldest = goals.min_by_key(|(_, shown)| heard(shown));
        let oldest = oldest.map(|(topic, _)| topic.clone());
        let forgotten = oldest.and_then(|topic| self.shown.remove(&topic));
        forgotten.inspect(|shown| shown.channel.close()).is_some()
    }
}

struct Show {
    bus: Bus,
    only: Option<String>,
    channels: Channels,
    artist: Artist,
    maps: Maps,
    robots: BTreeSet<String>,
}

impl Show {
    async fn run(mut self, mut listener: Listener, mut wanted: mpsc::Receiver<Wanted>) {
        let mut every = tokio::time::interval(EVERY);
        every.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                sample = listener.next() => match sample {
                    Some(sample) => self.show(&sample),
                    None => return,
                },
                Some(wanted) = wanted.recv() => self.answer(wanted),
                _ = every.tick() => {
                    listener.ask_for_maps(self.maps.incomplete().map(str::to_owned).collect());
                    for robot in self.artist.undrawn() {
                        self.draw_map(&robot, listener.now());
                    }
                }
            }
        }
    }

    fn show(&mut self, sample: &Sample) {
        if let Some(robot) = sample.key.split('/').nth(1).filter(|robot| Id::robot(*robot).is_ok()) {
            self.robots.insert(robot.to_owned());
        }
        for drawn in self.artist.draw(sample) {
            self.publish_drawn(&sample.key, &drawn, sample.logged);
        }
        if let Some(robot) = self.maps.see(sample) {
            self.draw_map(&robot, sample.logged);
        }
        if sample.kind == Kind::Put && Encoding::of(&sample.encoding) == Encoding::Json {
            let describe = || {
                let schema = schema::of(&sample.key, &sample.bytes)?.to_string().into_bytes();
                let schema = foxglove::Schema::new(schema::title(&sample.key), schema::ENCODING, schema);
                Some((schema, "json"))
            };
            self.channels
                .publish(&sample.key, &sample.key, &sample.bytes, sample.logged, describe);
        }
    }

    fn draw_map(&mut self, robot: &str, now: u64) {
        let drawn = self
            .maps
            .grid(robot)
            .and_then(|map| self.artist.draw_map(robot, map, now, false));
        if let Some(drawn) = drawn {
            self.publish_drawn(&drawn.topic, &drawn, now);
        }
    }

    fn publish_drawn(&mut self, key: &str, drawn: &Drawn, now: u64) {
        let describe = || Some((drawn.schema.clone(), ENCODING));
        self.channels.publish(&drawn.topic, key, &drawn.bytes, now, describe);
    }

    fn answer(&mut self, wanted: Wanted) {
        match wanted {
            Wanted::Last { topic, viewer } => {
                let Some(shown) = self.channels.shown.get(&topic) else {
                    return;
                };
                for (now, message) in shown.last.values() {
                    let meta = PartialMetadata::with_log_time(*now);
                    shown.channel.log_with_meta_to_sink(message, meta, Some(viewer));
                }
            }
            Wanted::Goal { topic, payload } => match self.goal(&topic, &payload) {
                Ok((robot, request)) => {
                    let bus = self.bus.clone();
                    tasks::spawn(async move {
                        match bus.ask(&topics::GOAL, &[&robot], &request, PATIENCE).await {
                            Ok(reply) => tracing::info!(robot, goal = reply.id, "goal from Foxglove"),
                            Err(error) => tracing::warn!(robot, %error, "goal from Foxglove was refused"),
                        }
                    });
                }
                Err(reason) => tracing::warn!(topic, "no goal: {reason}"),
            },
        }
    }

    /// The goal that a published pose stands for, and its robot.
    fn goal(&self, topic: &str, payload: &[u8]) -> Result<(String, GoalRequest), String> {
        let named = match topic.trim_matches('/').split('/').collect::<Vec<_>>()[..] {
            ["goal"] | ["move_base_simple", "goal"] => self.only.clone(),
            [robot, "goal"] => Some(robot.to_owned()),
            _ => return Err("expected a pose on /goal or /ROBOT/goal".to_owned()),
        };
        let robot = match (named, self.robots.len()) {
            (Some(robot), _) => robot,
            (None, 1) => self.robots.first().cloned().unwrap_or_default(),
            (None, count) => return Err(format!("{count} robots here: expected /ROBOT/goal")),
        };
        if !self.robots.contains(&robot) {
            return Err(format!("no robot `{robot}` here"));
        }
        let posed: Posed = serde_json::from_slice(payload).map_err(|error| format!("expected a pose: {error}"))?;
        Ok((robot, posed.request()?))
    }
}

/// A message with a pose: Foxglove's `PoseInFrame`, ROS's `PoseStamped`.
#[derive(Deserialize)]
struct Posed {
    pose: Pose,
    #[serde(default)]
    frame_id: String,
    #[serde(default)]
    header: Header,
}

#[derive(Default, Deserialize)]
struct Header {
    #[serde(default)]
    frame_id: String,
}

#[derive(Deserialize)]
struct Pose {
    position: Position,
    orientation: Quaternion,
}

#[derive(Deserialize)]
struct Position {
    x: f64,
    y: f64,
}

#[derive(Deserialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

impl Posed {
    /// A goal at this pose, which a 3D panel publishes in the frame that it displays.
    ///
    /// # Errors
    /// In words: the pose is in another frame than the map.
    fn request(&self) -> Result<GoalRequest, String> {
        let frames = [&self.frame_id, &self.header.frame_id];
        match frames.into_iter().find(|frame| !["", MAP].contains(&frame.as_str())) {
            Some(frame) => Err(format!(
                "the pose is in the frame `{frame}`: expected `{MAP}`, the display frame of the 3D panel"
            )),
            None => Ok(self.pose.request()),
        }
    }
}

impl Pose {
    /// A goal at this pose, map frame.
    fn request(&self) -> GoalRequest {
        let Quaternion { x, y, z, w } = self.orientation;
        // Heading of a unit quaternion; (0, 0, 0, 0) has none.
        let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
        GoalRequest {
            id: Some(fresh_id("goal")),
            x: Some(self.position.x),
            y: Some(self.position.y),
            yaw: (w != 0.0 || z != 0.0).then(|| wrap_angle(yaw)),
            on_busy: OnBusy::Preempt,
            ..GoalRequest::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_of_foxglove_or_ros_is_a_goal_with_its_heading() {
        let turned = std::f64::consts::FRAC_PI_4;
        let message = format!(
            r#"{{"header":{{}},"frame_id":"map","pose":{{"position":{{"x":1.5,"y":-2.0,"z":0.0}},"orientation":{{"x":0,"y":0,"z":{},"w":{}}}}}}}"#,
            turned.sin(),
            turned.cos()
        );
        let posed: Posed = serde_json::from_str(&message).unwrap();
        let request = posed.request().unwrap();
        assert_eq!((request.x, request.y), (Some(1.5), Some(-2.0)));
        assert!((request.yaw.unwrap() - 2.0 * turned).abs() < 1e-12);
    }

    #[test]
    fn old_goals_make_room_for_what_is_new() {
        let mut channels = Channels::new(Context::new());
        let mut publish = |key: &str, now: u64| {
            let describe = || Some((foxglove::Schema::new("x", schema::ENCODING, b"{}".to_vec()), "json"));
            channels.publish(key, key, b"{}", now, describe);
        };
        publish("zenav/a/edge/state", 0);
        for nth in 1..=MOST_CHANNELS as u64 {
            publish(&format!("zenav/a/cloud/goal/g{nth}"), nth);
        }
        publish("zenav/b/edge/state", 1);
        let shown = channels.shown;
        assert_eq!(shown.len(), MOST_CHANNELS);
        for (key, shows) in [
            ("zenav/a/edge/state", true),
            ("zenav/b/edge/state", true),
            ("zenav/a/cloud/goal/g2", false),
            ("zenav/a/cloud/goal/g3", true),
        ] {
            assert_eq!(shown.contains_key(key), shows, "{key}");
        }
    }

    #[test]
    fn a_pose_in_another_frame_than_the_map_is_no_goal() {
        let pose = r#""pose":{"position":{"x":1,"y":0,"z":0},"orientation":{"x":0,"y":0,"z":0,"w":1}}"#;
        for (frame, is_goal) in [
            (r#""frame_id":"map","#, true),
            (r#""header":{"frame_id":"map"},"#, true),
            ("", true),
            (r#""frame_id":"tiago/base_link","#, false),
            (r#""header":{"frame_id":"odom"},"#, false),
        ] {
            let posed: Posed = serde_json::from_str(&format!("{{{frame}{pose}}}")).unwrap();
            assert_eq!(posed.request().is_ok(), is_goal, "{frame}");
        }
    }
}
