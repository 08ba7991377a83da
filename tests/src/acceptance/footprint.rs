//! Resources of the robot's binary. Runs `zenav-edge` in its own process, attached to a served world, teleoperated, with a client that
//! subscribes like the cloud. Processor time, memory and loop jitter are as reported by the system and by the edge itself.

use std::path::Path;
use std::time::Duration;

use tokio::time::{Instant, MissedTickBehavior, interval, timeout};
use zenav_protocol::bus::{AskError, Bus, BusConfig, BusError, Latest, Publisher, Subscription};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{
    EdgeState, Event, Heartbeat, InfoReply, InfoRequest, LeaseAction, LeaseReply, LeaseRequest, LeaseRole, Pacing,
    PoseEstimate, Scan, Teleop,
};
use zenav_protocol::topics;

use crate::process::{Process, free_endpoint, words};
use crate::usage::{Unknown, busy_secs, cpu_secs, peak_memory};

/// The robot, by its shipped name.
const ROBOT: &str = "tiago";
/// Turn rate of the robot on the spot, rad/s: its lidar sees the whole room, and it meets no obstacle.
const TURN: f64 = 0.5;
/// Wall time for the edge to come up.
const PATIENCE: Duration = Duration::from_secs(20);
/// Time at the beginning that is not measured, while processes start.
const SETTLING: Duration = Duration::from_secs(3);
/// Time between two teleop commands, each with a heartbeat.
const TELEOP_PERIOD: Duration = Duration::from_millis(100);

/// Why nothing was measured.
#[derive(Debug, thiserror::Error)]
pub enum FootprintError {
    /// The bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The edge does not answer.
    #[error(transparent)]
    Ask(#[from] AskError),
    /// A file.
    #[error("{0}: {1}")]
    File(String, std::io::Error),
    /// `/proc` cannot be read; only Linux has it.
    #[error(transparent)]
    Proc(#[from] Unknown),
    /// The edge did not come up, or did not report.
    #[error("the edge {0}")]
    Silent(&'static str),
}

/// The measured resources.
#[derive(Clone, Copy, Debug)]
pub struct Footprint {
    /// Size of the binary, bytes.
    pub size: u64,
    /// Processor time over wall time: share of one core.
    pub core: f64,
    /// Peak resident memory, bytes.
    pub memory: u64,
    /// Pacing of the control loop.
    pub pacing: Pacing,
    /// Control ticks per second.
    pub ticks_hz: f64,
    /// Scans per second, and beams of each.
    pub scans: (f64, usize),
    /// Cores that other processes kept busy meanwhile, the served world's among them.
    pub others: f64,
}

/// Runs `edge` (the robot's binary) for a time in a world that `zenav` serves.
///
/// # Errors
/// [`FootprintError`].
pub async fn measure(zenav: &Path, edge: &Path, time: Duration) -> Result<Footprint, FootprintError> {
    let file = |name: &Path| {
        let name = name.display().to_string();
        move |error| FootprintError::File(name, error)
    };
    let size = std::fs::metadata(edge).map_err(file(edge))?.len();
    let folder = tempfile::tempdir().map_err(file(&std::env::temp_dir()))?;
    let (router, own) = (free_endpoint(), free_endpoint());
    let world = ["sim", "serve", "--world", "kitchen", "--listen", &router];
    let _world = Process::start(zenav, &world, folder.path());
    let opening = Bus::open(BusConfig::service("footprint", &router));
    let bus = timeout(PATIENCE, opening)
        .await
        .map_err(|_| FootprintError::Silent("found no world"))??;
    let line = format!("--attach --robot {ROBOT} --id {ROBOT} --connect {router} --listen {own}");
    let process = Process::start(edge, &words(&line), folder.path());
    let mut client = Client::new(&bus).await?;
    client.drive(SETTLING).await;
    let before = (client.pacing().await?.ticks, cpu_secs(process.id())?, busy_secs()?);
    let begun = Instant::now();
    let (scans, beams) = client.drive(time).await;
    let secs = begun.elapsed().as_secs_f64();
    let (used, busy) = (cpu_secs(process.id())? - before.1, busy_secs()? - before.2);
    let pacing = client.pacing().await?;
    Ok(Footprint {
        size,
        core: used / secs,
        memory: peak_memory(process.id())?,
        pacing,
        ticks_hz: pacing.ticks.saturating_sub(before.0) as f64 / secs,
        scans: (f64::from(scans) / secs, beams),
        others: (busy - used) / secs,
    })
}

/// A client that teleoperates the robot, with the same subscriptions as mapping and mission.
struct Client {
    bus: Bus,
    epoch: u64,
    scans: Subscription<Scan>,
    events: Subscription<Event>,
    states: Latest<EdgeState>,
    poses: Latest<PoseEstimate>,
    heartbeats: Publisher<Heartbeat>,
    teleop: Publisher<Teleop>,
    beats: u64,
}

/// Holder of the lease.
const HOLDER: &str = "footprint";

impl Client {
    async fn new(bus: &Bus) -> Result<Self, FootprintError> {
        let robot = &[ROBOT];
        let mut states = bus.latest(&topics::STATE, robot)?;
        if timeout(PATIENCE, states.changed()).await != Ok(true) {
            return Err(FootprintError::Silent("does not come up"));
        }
        let request = LeaseRequest::new(HOLDER, LeaseRole::Operator, LeaseAction::Acquire, HOLDER);
        let lease: LeaseReply = bus.ask(&topics::LEASE, robot, &request, PATIENCE).await?;
        Ok(Self {
            bus: bus.clone(),
            epoch: lease.epoch,
            scans: bus.subscribe(&topics::SCAN, robot, 64)?,
            events: bus.subscribe(&topics::EVENT, robot, 64)?,
            states,
            poses: bus.latest(&topics::POSE, robot)?,
            heartbeats: bus.publisher(&topics::HEARTBEAT, robot)?,
            teleop: bus.publisher(&topics::TELEOP, robot)?,
            beats: 0,
        })
    }

    /// Keeps the robot turning; returns the number of scans, and the beams of the last.
    async fn drive(&mut self, time: Duration) -> (u32, usize) {
        let end = Instant::now() + time;
        let mut beat = interval(TELEOP_PERIOD);
        beat.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let (mut scans, mut beams) = (0, 0);
        while beat.tick().await < end {
            self.command();
            while let Some(scan) = self.scans.try_next() {
                (scans, beams) = (scans + 1, scan.message.ranges.len());
            }
            while self.events.try_next().is_some() {}
            let _ = self.poses.take();
        }
        (scans, beams)
    }

    fn command(&mut self) {
        self.beats += 1;
        self.heartbeats.put(&Heartbeat {
            holder: HOLDER.to_owned(),
            epoch: self.epoch,
            counter: self.beats,
            echo: None,
        });
        if let Some(state) = self.states.borrow() {
            self.teleop.put(&Teleop {
                epoch: self.epoch,
                twist: Twist2::new(0.0, TURN),
                echo: state.stamp,
            });
        }
    }

    async fn pacing(&self) -> Result<Pacing, FootprintError> {
        let info: InfoReply = self
            .bus
            .ask(&topics::EDGE_INFO, &[ROBOT], &InfoRequest {}, PATIENCE)
            .await?;
        info.pacing
            .ok_or(FootprintError::Silent("does not report its loop jitter"))
    }
}
