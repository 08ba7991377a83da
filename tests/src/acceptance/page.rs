//! The page under load. The gateway's cost with many robots, and with many browsers that do not read: a router and `zenav gateway` as
//! separate processes, and fake robots of this process with state, pose and scan at 10 Hz each, as real ones.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::time::Duration;

use serde_json::json;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep};
use zenav_protocol::bus::{Bus, BusConfig, BusError};
use zenav_protocol::messages::{EdgeState, PoseEstimate, Scan};
use zenav_protocol::topics::{POSE, SCAN, STATE};

use crate::browser::Browser;
use crate::http::request;
use crate::process::{Process, free_endpoint, words};
use crate::usage::{Unknown, cpu_secs, memory};

/// Publishing period of a robot.
const PERIOD: Duration = Duration::from_millis(100);
/// Beams of a fake scan.
const BEAMS: usize = 360;
/// Longest wait for a process to come up.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time at the beginning that is not measured.
const SETTLING: Duration = Duration::from_secs(3);
/// Sampling interval of the memory.
const LOOK: Duration = Duration::from_millis(500);

/// Why nothing was measured.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// The bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A socket or a file.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// An invalid fake message.
    #[error(transparent)]
    Message(#[from] serde_json::Error),
    /// `/proc` cannot be read; only Linux has it.
    #[error(transparent)]
    Proc(#[from] Unknown),
    /// The gateway did not accept a WebSocket.
    #[error("the gateway answers {0:?} to a WebSocket")]
    Refused(String),
}

/// A router, a gateway, and fake robots; all end when this is dropped.
#[derive(Debug)]
pub struct MadeUpFleet {
    /// The gateway's own process.
    pub gateway: Process,
    /// Address of the page.
    pub address: String,
    _router: Process,
    robots: JoinHandle<()>,
}

impl MadeUpFleet {
    /// Starts everything; `zenav` is the program, `folder` holds its files.
    ///
    /// # Errors
    /// [`PageError`] when a file or a key cannot be created.
    ///
    /// # Panics
    /// When a process does not come up.
    pub async fn start(zenav: &Path, folder: &Path, robots: usize) -> Result<Self, PageError> {
        let endpoint = free_endpoint();
        let router = Process::start(zenav, &["router", "--listen", &endpoint], folder);
        let file = folder.join("gateway.toml");
        std::fs::write(&file, "[gateway]\nmax_clients = 5000\nrequests_hz = 10000.0\n")?;
        let line = format!("gateway --connect {endpoint} --listen 127.0.0.1:0 --deployment gateway.toml");
        let mut gateway = Process::start(zenav, &words(&line), folder);
        let bus = Bus::open(BusConfig::service("made-up", &endpoint)).await?;
        let robots = tokio::spawn(publish(bus, robots));
        let line = tokio::task::block_in_place(|| gateway.until("mission control: ", PATIENCE));
        let (_, address) = line.split_once("mission control: ").unwrap_or_default();
        Ok(Self {
            gateway,
            address: address.to_owned(),
            _router: router,
            robots,
        })
    }
}

impl Drop for MadeUpFleet {
    fn drop(&mut self) {
        self.robots.abort();
    }
}

/// The messages of a robot after `secs` of driving in a circle.
fn messages(number: usize, secs: f64) -> Result<(EdgeState, PoseEstimate, Scan), serde_json::Error> {
    let (radius, stamp) = (1.0 + 0.2 * number as f64, (secs * 1e9) as u64);
    let angle = 0.4 * secs / radius;
    let pose = json!({ "x": radius * angle.cos(), "y": radius * angle.sin(), "yaw": (angle + std::f64::consts::FRAC_PI_2).rem_euclid(std::f64::consts::TAU) });
    let twist = json!({ "v": 0.4, "w": 0.4 / radius });
    let ranges: Vec<f64> = (0..BEAMS)
        .map(|beam| 2.0 + ((beam as f64) * 0.3 + secs).sin())
        .collect();
    Ok((
        serde_json::from_value(json!({
            "stamp": stamp, "boot_id": "made-up", "mode": "follow", "link": "Connected",
            "lease": { "holder": "mission", "role": "mission", "epoch": 1, "live": true },
            "velocity": twist, "guard": "clear", "battery": 0.8,
        }))?,
        serde_json::from_value(json!({
            "stamp": stamp, "covariance": [1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4], "map_from_base": pose, "velocity": twist,
        }))?,
        serde_json::from_value(json!({
            "stamp": stamp, "angle_min": -std::f64::consts::PI, "angle_increment": std::f64::consts::TAU / BEAMS as f64,
            "range_min": 0.05, "range_max": 8.0, "ranges": ranges,
            "base_from_laser": { "x": 0.0, "y": 0.0, "yaw": 0.0 }, "map_from_odom": pose, "odom_from_base": { "x": 0.0, "y": 0.0, "yaw": 0.0 },
        }))?,
    ))
}

/// Publishes for all robots until it is aborted.
async fn publish(bus: Bus, robots: usize) {
    let mut publishers = Vec::new();
    for number in 1..=robots {
        let name = format!("robot_{number:02}");
        let all = (
            bus.publisher(&STATE, &[&name]),
            bus.publisher(&POSE, &[&name]),
            bus.publisher(&SCAN, &[&name]),
        );
        if let (Ok(state), Ok(pose), Ok(scan)) = all {
            publishers.push((number, state, pose, scan));
        }
    }
    let (start, mut pace) = (Instant::now(), interval(PERIOD));
    pace.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        pace.tick().await;
        for (number, states, poses, scans) in &publishers {
            if let Ok((state, pose, scan)) = messages(*number, start.elapsed().as_secs_f64()) {
                states.put(&state);
                poses.put(&pose);
                scans.put(&scan);
            }
        }
    }
}

/// Rates and load while a browser shows the fleet.
#[derive(Clone, Copy, Debug)]
pub struct Watched {
    /// Processor time of the gateway over wall time: share of one core.
    pub core: f64,
    /// Frames that the page drew per second.
    pub drawn_hz: f64,
    /// Animation frames that the browser offered per second.
    pub screen_hz: f64,
    /// Data frames received per second.
    pub frames_hz: f64,
    /// Robots that the page showed moving.
    pub moving: u64,
}

/// Shows the fleet in a browser for a time.
///
/// # Errors
/// [`PageError`] without `/proc`.
///
/// # Panics
/// Without Chromium, or when the page does not come.
pub fn watch(fleet: &MadeUpFleet, browser: &Browser, robots: usize, time: Duration) -> Result<Watched, PageError> {
    browser.go(&fleet.address);
    browser.until(
        "all robots show",
        PATIENCE,
        &format!("zenav.store.fleet.length === {robots} && zenav.store.detail.has('scan')"),
    );
    let _ = browser.script(
        "const count = window.counted = { screen: 0, frames: 0, from: new Map() }; \
         const screen = () => { count.screen += 1; requestAnimationFrame(screen); }; requestAnimationFrame(screen); \
         zenav.store.on('frame', () => { count.frames += 1; }); \
         document.getElementById('fit').click(); zenav.view.camera.fit([-6, -6, 6, 6]);",
    );
    std::thread::sleep(SETTLING);
    let read = || {
        let counts = browser.script("return [performance.now(), zenav.view.drawn, counted.screen, counted.frames]");
        [0, 1, 2, 3].map(|at| counts[at].as_f64().unwrap_or_default())
    };
    let _ = browser
        .script("for (const robot of zenav.store.fleet) counted.from.set(robot, zenav.store.data('pose', robot)?.x);");
    let (used, start, before) = (cpu_secs(fleet.gateway.id())?, std::time::Instant::now(), read());
    std::thread::sleep(time);
    let (used, elapsed, after) = (cpu_secs(fleet.gateway.id())? - used, start.elapsed(), read());
    let moving = browser.script("return zenav.store.fleet.filter((robot) => zenav.store.data('pose', robot)?.x !== counted.from.get(robot)).length");
    let hz = |at: usize| (after[at] - before[at]) / (after[0] - before[0]) * 1e3;
    Ok(Watched {
        core: used / elapsed.as_secs_f64(),
        drawn_hz: hz(1),
        screen_hz: hz(2),
        frames_hz: hz(3),
        moving: moving.as_u64().unwrap_or_default(),
    })
}

/// Effect of sockets that do not read on the gateway.
#[derive(Clone, Copy, Debug)]
pub struct Slow {
    /// Resident memory before the first socket, bytes.
    pub before: u64,
    /// Most resident memory while they were open, bytes.
    pub most: u64,
    /// Resident memory in the last sample, bytes.
    pub last: u64,
    /// Number of sockets that the gateway had closed by then.
    pub closed: usize,
    /// Longest answer to another client's request meanwhile, s.
    pub answer: f64,
}

/// Opens `count` WebSockets that watch a robot and never read, and keeps them for a time.
///
/// # Errors
/// [`PageError`] when one is refused.
pub async fn slow_sockets(fleet: &MadeUpFleet, count: usize, time: Duration) -> Result<Slow, PageError> {
    let host = fleet
        .address
        .trim_start_matches("http://")
        .trim_end_matches('/')
        .to_owned();
    sleep(SETTLING).await;
    let id = fleet.gateway.id();
    let before = memory(id)?;
    let mut sockets = Vec::with_capacity(count);
    for number in 0..count {
        let host = host.clone();
        let opened = tokio::task::block_in_place(|| open_socket(&host, &format!("robot_{:02}", number % 20 + 1)));
        sockets.push(opened?);
    }
    let mut found = Slow {
        before,
        most: before,
        last: before,
        closed: 0,
        answer: 0.0,
    };
    let end = Instant::now() + time;
    while Instant::now() < end {
        sleep(LOOK).await;
        found.last = memory(id)?;
        found.most = found.most.max(found.last);
        let asked = Instant::now();
        let answer = tokio::task::block_in_place(|| request(&host, "GET", "/api/v1/health", &host));
        if answer.status != 200 {
            return Err(PageError::Refused(answer.head));
        }
        found.answer = found.answer.max(asked.elapsed().as_secs_f64());
    }
    for socket in &mut sockets {
        found.closed += usize::from(is_closed(socket)?);
    }
    Ok(found)
}

/// Opens a WebSocket and watches a robot on it.
fn open_socket(host: &str, robot: &str) -> Result<TcpStream, PageError> {
    let mut stream = TcpStream::connect(host)?;
    write!(
        stream,
        "GET /api/v1/live HTTP/1.1\r\nHost: {host}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: zenav.v1\r\n\r\n"
    )?;
    let mut head = Vec::new();
    let mut byte = [0; 1];
    while !head.ends_with(b"\r\n\r\n") && head.len() < 4096 {
        stream.read_exact(&mut byte)?;
        head.push(byte[0]);
    }
    let head = String::from_utf8_lossy(&head);
    if !head.contains(" 101 ") {
        return Err(PageError::Refused(head.lines().next().unwrap_or_default().to_owned()));
    }
    let text = format!(r#"{{"type":"watch","robot":"{robot}"}}"#);
    // A text frame of less than 126 bytes with a mask of zeros.
    let mut frame = vec![0x81, 0x80 | text.len() as u8, 0, 0, 0, 0];
    frame.extend_from_slice(text.as_bytes());
    stream.write_all(&frame)?;
    Ok(stream)
}

/// Whether the other side has closed, after reading what was sent until then.
fn is_closed(socket: &mut TcpStream) -> Result<bool, PageError> {
    socket.set_read_timeout(Some(Duration::from_millis(20)))?;
    let mut buffer = vec![0; 1 << 16];
    // The gateway sends ten times a second, so the received data is soon drained if the connection is still open.
    for _ in 0..1000 {
        match socket.read(&mut buffer) {
            Ok(0) => return Ok(true),
            Ok(_) => {}
            Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => return Ok(true),
            Err(_) => return Ok(false),
        }
    }
    Ok(false)
}
