//! Motion workers. The gain from a second worker, and the cost of a frozen one: real worker processes, and robots that ask for a trajectory
//! across a hall of pillars once a second.

use std::sync::Arc;
use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval_at};
use zenav_cloud::mission::Workers;
use zenav_cloud::motion::SERVICE;
use zenav_fixtures::robot;
use zenav_protocol::bus::{Bus, BusError};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::{GridSpec, Occupancy};
use zenav_protocol::messages::{
    DrivingProfile, MapInfo, MapRef, MapReply, MotionReply, MotionRequest, PlanRequest, TrajectoryRequest,
};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use crate::deployment::Deployment;
use crate::process::Process;

/// A hall of 25.6 m a side.
const HALL: GridSpec = GridSpec {
    origin: nalgebra::Point2::new(0.0, 0.0),
    resolution: 0.05,
    width: 512,
    height: 512,
};
/// Spacing of pillars, and their width, cells.
const PILLARS: (u32, u32) = (50, 8);
/// Period of each robot's requests.
const PERIOD: Duration = Duration::from_secs(1);
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest wait until all workers are there.
const READY: Duration = Duration::from_secs(30);

/// The results with a number of workers.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Workers.
    pub workers: usize,
    /// Time to each answer while every robot asks once a second, s.
    pub answers: Vec<f64>,
    /// Answers per second when robots ask again at once.
    pub throughput: f64,
    /// Time to each answer while one worker is frozen, s.
    pub frozen: Vec<f64>,
    /// Requests that got no trajectory.
    pub lost: usize,
}

/// Runs `workers` workers, and robots that ask them, for `secs` in each of three phases; in the last one the first worker is frozen.
///
/// # Errors
/// When a part cannot be started or joined.
pub async fn run(binary: &str, workers: usize, robots: usize, secs: f64, seed: u64) -> Result<Findings, String> {
    let text = |error: BusError| error.to_string();
    let deployment = Deployment::new(binary, "kitchen", 1.0);
    let _router = deployment.start_router();
    let processes: Vec<Process> = (0..workers)
        .map(|nth| deployment.start_motion_worker(&format!("worker{nth}")))
        .collect();
    let bus = deployment.bus().await;
    let mut maps = bus.serve(&topics::MAP, &["*"]).map_err(text)?;
    let hall = Arc::new(hall());
    let served = Arc::clone(&hall);
    let _maps = tokio::spawn(async move {
        while let Some(request) = maps.next().await {
            request.reply(&served);
        }
    });
    let names: Vec<String> = (1..=robots).map(|number| format!("robot{number:03}")).collect();
    let mut told = Vec::new();
    for name in &names {
        let info = bus.publisher(&topics::MAP_INFO, &[name]).map_err(text)?;
        info.put(&hall.info);
        told.push(info);
    }
    let alive = topics::alive_key(topics::ALIVE_WORKER, &[SERVICE, "*"]);
    let begin = Instant::now();
    while bus.list_alive(alive.clone(), READY).await.map_err(text)?.len() < workers {
        if begin.elapsed() > READY {
            return Err(format!("{workers} workers are not there after {READY:?}"));
        }
    }
    let mut clients = Vec::new();
    for (nth, name) in names.iter().enumerate() {
        clients.push(Client {
            bus: bus.clone(),
            // As in the mission, each robot has its own pool.
            workers: Workers::watch(&bus, SERVICE).map_err(text)?,
            robot: name.clone(),
            model: robot("tiago"),
            map: hall.info.map.clone(),
            random: Pcg64Mcg::seed_from_u64(seed + nth as u64),
        });
    }
    let mut findings = Findings {
        workers,
        ..Findings::default()
    };
    // The first requests fetch the map.
    let (_, back) = ask(clients, 2.0, Some(PERIOD)).await;
    let (answers, back) = ask(back, secs, Some(PERIOD)).await;
    findings.lost += answers.iter().filter(|answer| answer.is_none()).count();
    findings.answers = answers.into_iter().flatten().collect();
    let (answers, back) = ask(back, secs, None).await;
    findings.lost += answers.iter().filter(|answer| answer.is_none()).count();
    findings.throughput = answers.iter().flatten().count() as f64 / secs;
    if workers > 1 {
        processes[0].pause()?;
        let (answers, _) = ask(back, secs, Some(PERIOD)).await;
        processes[0].resume()?;
        findings.lost += answers.iter().filter(|answer| answer.is_none()).count();
        findings.frozen = answers.into_iter().flatten().collect();
    }
    bus.close().await;
    Ok(findings)
}

/// The part of a robot's mission that asks for motions.
struct Client {
    bus: Bus,
    workers: Workers,
    robot: String,
    model: RobotModel,
    map: MapRef,
    random: Pcg64Mcg,
}

impl Client {
    /// Asks for a trajectory and returns the time until it came, s.
    async fn ask(&mut self) -> Option<f64> {
        let [start, goal] = [(); 2].map(|()| {
            // In a lane between pillars.
            let lane = f64::from(self.random.random_range(1..10_u32)) - 0.42;
            let (along, across) = (self.random.random_range(1.5..24.0), lane * 2.5);
            Pose2::new(along, across.clamp(1.0, 24.5), 0.0)
        });
        let request = MotionRequest::Trajectory(TrajectoryRequest {
            plan: PlanRequest {
                robot: self.robot.clone(),
                model: self.model.clone(),
                map: self.map.clone(),
                start,
                via: Vec::new(),
                goal,
                planner: "astar".to_owned(),
                cleared: Vec::new(),
                yield_to: Vec::new(),
                unknown_is_free: false,
                escape: 0.0,
                goal_tolerance: 0.5,
                budget_ms: 1000,
                seed: 1,
            },
            start_velocity: Twist2::ZERO,
            goal_yaw: None,
            profile: DrivingProfile::default(),
        });
        let begin = Instant::now();
        let reply = self
            .workers
            .ask(&self.bus, &self.robot, Arc::new(request), PATIENCE)
            .await;
        let is_driven = matches!(reply, Ok(MotionReply::Trajectory(ref reply)) if reply.smooth.is_some());
        is_driven.then(|| begin.elapsed().as_secs_f64())
    }
}

/// All robots ask for `secs`, each once per period, or again at once without one. Returns the answers and the robots.
async fn ask(clients: Vec<Client>, secs: f64, period: Option<Duration>) -> (Vec<Option<f64>>, Vec<Client>) {
    let count = clients.len().max(1) as u32;
    let end = Instant::now() + Duration::from_secs_f64(secs);
    let mut asking = JoinSet::new();
    for (nth, mut client) in (0_u32..).zip(clients) {
        asking.spawn(async move {
            let mut answers = Vec::new();
            // The robots' requests are staggered.
            let first = Instant::now() + period.unwrap_or_default() * nth / count;
            let mut pace = interval_at(first, period.unwrap_or(Duration::from_micros(1)));
            pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
            while Instant::now() < end {
                pace.tick().await;
                answers.push(client.ask().await);
            }
            (answers, client)
        });
    }
    let (answers, clients): (Vec<_>, Vec<_>) = asking.join_all().await.into_iter().unzip();
    (answers.into_iter().flatten().collect(), clients)
}

fn hall() -> MapReply {
    let (pitch, width) = PILLARS;
    let cell = |index: u32| {
        let at = [index / HALL.width, index % HALL.width];
        let is_wall = at.iter().any(|at| *at == 0 || *at == HALL.width - 1);
        let is_pillar = at.iter().all(|at| at % pitch < width);
        if is_wall || is_pillar {
            Occupancy::OCCUPIED
        } else {
            Occupancy::FREE
        }
    };
    let values: Vec<_> = (0..HALL.width * HALL.height).map(cell).collect();
    let count = |class| values.iter().filter(|value| Occupancy::of(**value) == class).count() as u64;
    MapReply {
        info: MapInfo {
            stamp: Stamp::from_secs(1.0),
            map: MapRef {
                id: "hall".to_owned(),
                revision: 1,
                frame: 0,
            },
            spec: HALL,
            free: count(Occupancy::Free),
            occupied: count(Occupancy::Occupied),
            unknown: 0,
            scans: 1,
            stored: true,
        },
        values,
        trajectory: Vec::new(),
        stored: Vec::new(),
    }
}
