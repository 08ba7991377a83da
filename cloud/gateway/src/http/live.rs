//! Live feed. What is sent over a browser's WebSocket?
//!
//! Out: `hello` once, then a frame whenever something changed, at most `live_hz` times a second, each with the newest values that the
//! browser lacks ([`crate::client`]). The next frame is made after the previous one was sent: a browser that does not read costs one frame.
//! In: `{"type": "watch", "robot": …}`, `{"type": "ping", "t": …}`, and hand control: `arm`, `drive`, `disarm`.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval, timeout};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::id::Id;
use zenav_protocol::token_bucket::TokenBucket;

use super::error::ApiError;
use super::robots::BY;
use super::{App, Shared};
use crate::client::Client;
use crate::hold::Hold;
use crate::hub::Joined;
use crate::operator::Drive;

/// Requested subprotocol; a browser may offer its token beside it.
const PROTOCOL: &str = "zenav.v1";
/// Largest message from a browser, bytes.
const MAX_MESSAGE: usize = 4096;
/// Most messages per second from a browser; a held key sends 20.
const MESSAGES_HZ: f64 = 100.0;
/// Most consecutive messages that are ignored: about as many as accumulate on a link that is held up for a while.
const MOST_LEFT_OUT: u32 = 500;
/// Time after which a browser that has not taken a frame counts as gone.
const SEND_WITHIN: Duration = Duration::from_secs(20);
/// Longest wait for a lease that is being given back.
const GIVEN_BACK_WITHIN: Duration = Duration::from_secs(1);
/// Time without a held key after which hand control is released, s.
const IDLE_DRIVE: f64 = 30.0;
/// Silence after which a driving browser counts as lost, s: it pings each second.
const SILENT_DRIVE: f64 = 3.0;

/// A message from a browser.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
enum Incoming {
    Watch {
        robot: Option<String>,
    },
    Ping {
        t: f64,
    },
    Arm {
        robot: String,
    },
    /// Velocities, m/s and rad/s, and the time of sending by the clock given in frames, s.
    Drive {
        v: f64,
        w: f64,
        #[serde(default)]
        sent: Option<f64>,
    },
    Disarm {},
}

pub(super) async fn upgrade(
    State(shared): App,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Response {
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(error) => return ApiError::new(error.status(), "BadRequest", error.body_text()).into_response(),
    };
    let Some(joined) = shared.hub.join() else {
        return ApiError::busy("too many browsers: `[gateway] max_clients` is the limit").into_response();
    };
    upgrade
        .protocols([PROTOCOL])
        .max_message_size(MAX_MESSAGE)
        .max_frame_size(MAX_MESSAGE)
        .read_buffer_size(MAX_MESSAGE)
        .write_buffer_size(0)
        .on_upgrade(move |socket| async move {
            let mut session = Session {
                client: Client::new(),
                joined,
                drive: None,
                ending: None,
                heard: shared.hub.now(),
                rate: TokenBucket::full(MESSAGES_HZ, MESSAGES_HZ, Duration::ZERO),
                left_out: 0,
                shared,
            };
            session.run(socket).await;
            session.leave();
        })
}

/// A robot driven by hand from this browser.
struct Driving {
    robot: String,
    drive: Drive,
    /// Last time at which a key was held, s.
    held: f64,
}

struct Session {
    shared: Arc<Shared>,
    client: Client,
    joined: Joined,
    drive: Option<Driving>,
    /// The drive before it, until the robot's lease is given back.
    ending: Option<watch::Receiver<Option<String>>>,
    /// Last time at which it sent anything, s.
    heard: f64,
    rate: TokenBucket,
    /// Consecutive ignored messages.
    left_out: u32,
}

/// The browser is gone.
struct Gone;

impl Session {
    async fn run(&mut self, mut socket: WebSocket) {
        let hub = Arc::clone(&self.shared.hub);
        let hello = json!({
            "type": "hello", "version": env!("CARGO_PKG_VERSION"), "live_hz": hub.settings().live_hz, "places": hub.places(),
        });
        if send_json(&mut socket, &hello).await.is_err() {
            return;
        }
        let mut pace = interval(Duration::from_secs_f64(1.0 / hub.settings().live_hz));
        pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut ended = hub.ended();
        loop {
            let done = tokio::select! {
                // Messages that arrived while a frame was sent are read before silence is checked.
                biased;
                () = over(&mut ended) => return,
                message = socket.recv() => match message {
                    Some(Ok(Message::Text(text))) => self.hear(&mut socket, &text).await,
                    Some(Ok(Message::Binary(_) | Message::Close(_)) | Err(_)) | None => return,
                    Some(Ok(Message::Ping(_) | Message::Pong(_))) => self.admit(self.shared.hub.now()).map(drop),
                },
                _ = pace.tick() => self.tell(&mut socket).await,
            };
            if done.is_err() {
                return;
            }
        }
    }

    async fn tell(&mut self, socket: &mut WebSocket) -> Result<(), Gone> {
        self.look_after_drive(socket).await?;
        let hub = &self.shared.hub;
        let frame = self.client.frame(&hub.view(), hub.now(), hub.is_connected());
        if let Some(text) = frame.text {
            send(socket, Message::Text(text.into())).await?;
        }
        if let Some(map) = frame.map {
            send(socket, Message::Binary(Bytes::from(map))).await?;
        }
        Ok(())
    }

    async fn hear(&mut self, socket: &mut WebSocket, text: &str) -> Result<(), Gone> {
        let now = self.shared.hub.now();
        self.heard = now;
        if !self.admit(now)? {
            return Ok(());
        }
        let message: Incoming = match serde_json::from_str(text) {
            Ok(message) => message,
            Err(error) => {
                let reason = error.to_string();
                return send_json(socket, &json!({ "type": "error", "reason": reason })).await;
            }
        };
        match message {
            Incoming::Watch { robot } => {
                let robot =
                    robot.filter(|robot| Id::robot(robot.clone()).is_ok() && self.shared.hub.view().knows(robot));
                self.joined.watch(robot.as_deref());
                self.client.watch(robot);
                Ok(())
            }
            Incoming::Ping { t } => send_json(socket, &json!({ "type": "pong", "t": t })).await,
            Incoming::Arm { robot } => self.arm(socket, robot).await,
            Incoming::Drive { v, w, sent } => {
                if let Some(driving) = &mut self.drive {
                    driving.held = now;
                    // The age of a command counts from its sending, however long it was under way.
                    let sent = sent.filter(|sent| sent.is_finite()).map_or(now, |sent| sent.min(now));
                    let hold = Hold::new(Twist2::new(v, w), sent);
                    driving.drive.commands.send_replace(Some(hold));
                }
                Ok(())
            }
            Incoming::Disarm {} => {
                self.let_go();
                send_json(socket, &teleop("released", None, "")).await
            }
        }
    }

    /// Whether a message may pass. A slow link delivers many at once: the excess is ignored, and only a client that continues at that rate
    /// is disconnected.
    fn admit(&mut self, now: f64) -> Result<bool, Gone> {
        let passes = self.rate.take(Duration::from_secs_f64(now));
        self.left_out = if passes { 0 } else { self.left_out + 1 };
        if self.left_out > MOST_LEFT_OUT {
            Err(Gone)
        } else {
            Ok(passes)
        }
    }

    /// Ends the drive, if there is one: the robot's lease is given back.
    fn let_go(&mut self) {
        self.ending = self
            .drive
            .take()
            .map(|driving| driving.drive.ended)
            .or(self.ending.take());
    }

    async fn arm(&mut self, socket: &mut WebSocket, robot: String) -> Result<(), Gone> {
        self.let_go();
        if let Some(mut ending) = self.ending.take() {
            // The robot would refuse a second holder before the first has given the lease back.
            let _ = timeout(GIVEN_BACK_WITHIN, ending.changed()).await;
        }
        if !self.shared.hub.view().knows(&robot) {
            return send_json(socket, &teleop("refused", Some(&robot), "there is no such robot")).await;
        }
        match self.shared.operator.drive(&robot, BY).await {
            Ok(drive) => {
                let armed = teleop("armed", Some(&robot), "");
                self.drive = Some(Driving {
                    robot,
                    drive,
                    held: self.shared.hub.now(),
                });
                send_json(socket, &armed).await
            }
            Err(error) => send_json(socket, &teleop("refused", Some(&robot), &error.to_string())).await,
        }
    }

    /// Ends a drive that the robot ended, or that is not in use.
    async fn look_after_drive(&mut self, socket: &mut WebSocket) -> Result<(), Gone> {
        let Some(driving) = &self.drive else { return Ok(()) };
        if self.shared.hub.now() - self.heard > SILENT_DRIVE {
            return Err(Gone);
        }
        let ended = driving.drive.ended.borrow().clone();
        let idle = self.shared.hub.now() - driving.held > IDLE_DRIVE;
        let why = match ended {
            Some(why) => why,
            None if idle => format!("no key was held for {IDLE_DRIVE:.0} s"),
            None => return Ok(()),
        };
        let told = teleop("released", Some(&driving.robot), &why);
        self.let_go();
        send_json(socket, &told).await
    }

    /// If a browser is lost while driving, the robot is stopped: nobody is watching it any more.
    fn leave(self) {
        if let Some(driving) = self.drive {
            let stopping = self
                .shared
                .operator
                .stop(&driving.robot, "gateway: the browser that drove was lost");
            tokio::spawn(async move {
                if let Err(error) = stopping.await {
                    tracing::error!(robot = driving.robot, %error, "the robot did not confirm its stop");
                }
            });
        }
    }
}

/// Waits until the gateway ends.
async fn over(ended: &mut watch::Receiver<bool>) {
    // The returned value holds a lock and must not live on.
    let _ = ended.wait_for(|ended| *ended).await.is_ok();
}

fn teleop(state: &str, robot: Option<&str>, reason: &str) -> Value {
    json!({ "type": "teleop", "state": state, "robot": robot, "reason": reason })
}

async fn send_json(socket: &mut WebSocket, value: &Value) -> Result<(), Gone> {
    send(socket, Message::Text(value.to_string().into())).await
}

async fn send(socket: &mut WebSocket, message: Message) -> Result<(), Gone> {
    match timeout(SEND_WITHIN, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(Gone),
    }
}
