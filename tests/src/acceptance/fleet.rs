//! Fleet size. The number of robots' missions that one process runs on one core, and the cost of shards. Mission processes and router are
//! real; robots, planner and smoother are fakes that answer at once and drive every plan perfectly, so that only the missions are measured.
//! Simulated time may run slower than wall time, so that this machine can serve more robots than in real time.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Duration;

use nalgebra::Point2;
use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior, interval};
use zenav_fixtures::robot;
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::bus::{Bus, BusError, Publisher, Server};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::lease::LeaseArbiter;
use zenav_protocol::messages::{
    BasedOn, EdgeState, Event, EventKind, GoalPhase, GoalRequest, Heartbeat, InfoReply, LeaseReply, Link, MapInfo,
    MapPatch, MapRef, MapReply, Mode, MotionReply, MotionRequest, Plan, PlanOrigin, PlanOutcome, PlanProgress,
    PlanReply, PlanStatistics, PoseEstimate, Refusal, SimClock, SmoothReply, TILE, Tile, TrajectoryReply,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;
use zenav_smoothing::unsmoothed;

use crate::deployment::Deployment;
use crate::process::Process;
use crate::usage::{cpu_secs, memory};

/// Tick of the trial.
const TICK: Duration = Duration::from_millis(5);
/// Ticks between two messages of the clock; a mission's step is a multiple of it. Real robots have clocks of their own and no such messages:
/// one at each tick was a sixth of the router's work.
const CLOCK_EVERY: u32 = 5;
/// Ticks between two poses, and between two states, each of which comes with a pose.
const POSE_EVERY: u32 = 4;
const STATE_EVERY: u32 = 20;
/// Robots that share a session, as missions do. Zenoh compares what a session receives with all that is declared in it.
const ROBOTS_A_SESSION: usize = 8;
/// Sample period of trajectories, s.
const SAMPLES: f64 = 0.05;
/// Nominal heartbeat period, s.
const HEARTBEAT_PERIOD: f64 = 0.1;
/// Bytes of a MiB.
const MIB: f64 = 1024.0 * 1024.0;
/// Simulated time until every robot has a live lease.
const READY: Duration = Duration::from_secs(60);
/// Lease TTL.
const LEASE: Duration = Duration::from_secs(1);
/// Simulated time for maps and first goals before anything is measured.
const SETTLING: Duration = Duration::from_secs(10);
/// Simulated time within which all robots get their first goals, evenly.
const FIRST_GOALS: Duration = Duration::from_secs(7);
/// Every robot's map: 12.8 m square, free.
const MAP: GridSpec = GridSpec {
    origin: Point2::new(-6.4, -6.4),
    resolution: 0.05,
    width: 256,
    height: 256,
};
/// Goals, driven to in turn, m.
const PLACES: [(f64, f64); 4] = [(3.0, 0.0), (0.0, 3.0), (-3.0, 0.0), (0.0, -3.0)];

/// The results.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Robots.
    pub robots: usize,
    /// Deviation of each heartbeat interval from its nominal period, s. A mission sends heartbeats in its step and while it waits for the
    /// disk.
    pub jitter: Vec<f64>,
    /// Load of the mission processes, scaled to real time, cores.
    pub load: f64,
    /// The same for the router.
    pub router: f64,
    /// Resident memory of the mission processes, MiB.
    pub memory: f64,
    /// Goals driven.
    pub goals: usize,
    /// Number of robot ticks without a lease, of refused plans, of goals that did not succeed.
    pub faults: [usize; 3],
}

/// A heartbeat that reached its robot.
struct Heard {
    robot: String,
    at: Instant,
    heartbeat: Heartbeat,
}

/// A robot that drives every plan perfectly.
struct FakeRobot {
    bus: Bus,
    name: String,
    arbiter: LeaseArbiter,
    pose: Pose2,
    velocity: Twist2,
    plan: Option<(Plan, Stamp)>,
    finished: bool,
    place: usize,
    goals: u64,
    heartbeat: Option<Instant>,
    states: Publisher<EdgeState>,
    poses: Publisher<PoseEstimate>,
    events: Publisher<Event>,
    told: u64,
    is_mapped: bool,
    maps: (Publisher<MapInfo>, Publisher<MapPatch>),
}

impl FakeRobot {
    /// Heartbeats come over the link of its session, as with every robot, not over one link for all robots.
    fn new(bus: &Bus, name: String, heard: mpsc::UnboundedSender<Heard>) -> Result<Self, BusError> {
        let chunks = [name.as_str()];
        let mut heartbeats = bus.subscribe(&topics::HEARTBEAT, &chunks, 64)?;
        let robot = name.clone();
        tokio::spawn(async move {
            while let Some(received) = heartbeats.next().await {
                let heartbeat = received.message;
                if heard
                    .send(Heard {
                        robot: robot.clone(),
                        at: Instant::now(),
                        heartbeat,
                    })
                    .is_err()
                {
                    return;
                }
            }
        });
        Ok(Self {
            bus: bus.clone(),
            arbiter: LeaseArbiter::new(LEASE, 0, None),
            pose: Pose2::IDENTITY,
            velocity: Twist2::ZERO,
            plan: None,
            finished: false,
            place: 0,
            goals: 0,
            heartbeat: None,
            states: bus.publisher(&topics::STATE, &chunks)?,
            poses: bus.publisher(&topics::POSE, &chunks)?,
            events: bus.publisher(&topics::EVENT, &chunks)?,
            told: 0,
            is_mapped: false,
            maps: (
                bus.publisher(&topics::MAP_INFO, &chunks)?,
                bus.publisher(&topics::MAP_PATCH, &chunks)?,
            ),
            name,
        })
    }

    fn tell_map(&self, now: Stamp) {
        let grid = OccupancyGrid::filled(MAP, Occupancy::FREE);
        let info = map_info(now);
        let tiles = (0..MAP.height / TILE).flat_map(|y| (0..MAP.width / TILE).map(move |x| (x, y)));
        let values = grid.values().first().copied().unwrap_or_default();
        self.maps.0.put(&info);
        self.maps.1.put(&MapPatch {
            stamp: now,
            map: info.map,
            base_revision: 0,
            spec: MAP,
            tiles: tiles
                .map(|(x, y)| Tile {
                    x,
                    y,
                    values: vec![values; (TILE * TILE) as usize],
                })
                .collect(),
        });
    }

    fn tell(&mut self, now: Stamp, kind: EventKind) {
        self.told += 1;
        self.events.put(&Event {
            stamp: now,
            boot_id: "boot".to_owned(),
            sequence: self.told,
            kind,
        });
    }

    fn take(&mut self, now: Stamp, plan: Plan) -> bool {
        if !self.arbiter.admits(now, plan.epoch) {
            return false;
        }
        let known = self
            .plan
            .as_ref()
            .filter(|(old, _)| old.trajectory_id == plan.trajectory_id);
        let begun = known.map_or(now, |(_, begun)| *begun);
        if known.is_none() {
            self.finished = false;
            let (goal_id, revision, trajectory_id) = (plan.goal_id.clone(), plan.revision, plan.trajectory_id);
            self.tell(
                now,
                EventKind::PlanAccepted {
                    goal_id,
                    revision,
                    trajectory_id,
                },
            );
        }
        self.plan = Some((plan, begun));
        true
    }

    fn tick(&mut self, now: Stamp, count: u32) {
        if !count.is_multiple_of(POSE_EVERY) {
            return;
        }
        self.velocity = Twist2::ZERO;
        let mut progress = None;
        if let Some((plan, begun)) = &self.plan {
            let time = now.secs_since(*begun);
            let left = (plan.trajectory.end_time() - time).max(0.0);
            if !plan.trajectory.is_empty() {
                let point = plan.trajectory.sample(time);
                self.pose = point.pose();
                self.finished = left == 0.0;
                if !self.finished {
                    self.velocity = point.twist();
                }
            }
            progress = Some(PlanProgress {
                goal_id: plan.goal_id.clone(),
                epoch: plan.epoch,
                revision: plan.revision,
                trajectory_id: plan.trajectory_id,
                time,
                waypoint: 0,
                distance_left: left * self.velocity.v,
                time_left: left,
                valid_for: (plan.valid_for - now.secs_since(plan.based_on.stamp)).max(0.0),
                finished: self.finished,
            });
        }
        self.poses.put(&PoseEstimate {
            stamp: now,
            map_from_base: self.pose,
            covariance: [0.0; 9],
            velocity: self.velocity,
            frame: 0,
        });
        if count.is_multiple_of(STATE_EVERY) {
            self.states.put(&EdgeState {
                stamp: now,
                boot_id: "boot".to_owned(),
                mode: if progress.is_some() { Mode::Follow } else { Mode::Idle },
                link: Link::Connected,
                lease: self.arbiter.state(now),
                plan: progress,
                velocity: self.velocity,
                battery: 1.0,
                uplink: 1.0,
                ..EdgeState::default()
            });
        }
    }

    /// The next goal, submitted when the previous one has ended.
    fn next_goal(&mut self) -> GoalRequest {
        let (x, y) = PLACES[self.place % PLACES.len()];
        self.place += 1;
        self.goals += 1;
        GoalRequest {
            id: Some(format!("{}-{}", self.name, self.goals)),
            x: Some(x),
            y: Some(y),
            ..GoalRequest::default()
        }
    }
}

fn map_info(now: Stamp) -> MapInfo {
    MapInfo {
        stamp: now,
        map: MapRef {
            id: "hall".to_owned(),
            revision: 1,
            frame: 0,
        },
        spec: MAP,
        free: u64::from(MAP.width) * u64::from(MAP.height),
        occupied: 0,
        unknown: 0,
        scans: 1,
        stored: true,
    }
}

/// Parameters of a run
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Fleet {
    /// Robots
    pub robots: usize,
    /// Simulated time that is measured, s
    #[arg(default_value_t = 60.0)]
    pub secs: f64,
    /// Mission processes that share the robots; a single one is pinned to the first core
    #[arg(long, default_value_t = 1)]
    pub shards: usize,
    /// Simulated seconds per second of wall time: below 1 for more robots than this machine can serve
    #[arg(long, default_value_t = 1.0)]
    pub speed: f64,
}

/// Runs the missions of a fleet for a time.
///
/// # Errors
/// When a part cannot be started or joined, or a robot gets no leader.
pub async fn run(binary: &str, fleet: Fleet) -> Result<Findings, String> {
    let Fleet {
        robots,
        shards,
        speed,
        secs,
    } = fleet;
    let text = |error: BusError| error.to_string();
    let model = robot("tiago");
    let deployment = Deployment::new(binary, "kitchen", 1.0);
    let names: Vec<String> = (1..=robots).map(|number| format!("robot{number:04}")).collect();
    let sections = |names: &[String]| {
        let mut sections = String::new();
        for name in names {
            let _ = writeln!(
                sections,
                "[robots.{name}]\nmodel = \"tiago\"\nlisten = \"tcp/127.0.0.1:0\""
            );
        }
        sections
    };
    let router = deployment.start_router();
    let bus = deployment.bus().await;
    let mut fakes = BTreeMap::new();
    let (heard, mut heartbeats) = mpsc::unbounded_channel();
    for names in names.chunks(ROBOTS_A_SESSION) {
        let bus = deployment.bus().await;
        for name in names {
            fakes.insert(
                name.clone(),
                FakeRobot::new(&bus, name.clone(), heard.clone()).map_err(text)?,
            );
        }
    }
    let mut leases = bus.serve(&topics::LEASE, &["*"]).map_err(text)?;
    let mut infos = bus.serve(&topics::EDGE_INFO, &["*"]).map_err(text)?;
    let mut maps = bus.serve(&topics::MAP, &["*"]).map_err(text)?;
    let motions = bus.serve(&topics::MOTION_SERVICE, &["fake"]).map_err(text)?;
    let _worker = tokio::spawn(motion(motions));
    let alive = topics::alive_key(topics::ALIVE_WORKER, &["motion", "fake"]);
    let _alive = bus.declare_alive(alive).map_err(text)?;
    let clock = bus.publisher(&topics::SIM_CLOCK, &[]).map_err(text)?;
    let mut written = bus.subscribe(&topics::PLAN, &["*"], 65536).map_err(text)?;
    let mut ended = bus.subscribe(&topics::GOAL_STATE, &["*", "*"], 65536).map_err(text)?;
    let mut shards_left = names.chunks(robots.div_ceil(shards.max(1))).enumerate();
    let (mut orchestrators, mut started) = (Vec::<Process>::new(), 0);
    let used = |orchestrators: &[Process]| -> Result<[f64; 2], String> {
        let of = |process: &Process| cpu_secs(process.id()).map_err(|error| error.to_string());
        let missions: Vec<f64> = orchestrators.iter().map(of).collect::<Result<_, _>>()?;
        Ok([missions.iter().sum(), of(&router)?])
    };
    let start = Instant::now();
    // Simulated time since an instant.
    let since = |instant: Instant| instant.elapsed().mul_f64(speed);
    let now = || Stamp::from_secs(1.0 + since(start).as_secs_f64());
    let mut findings = Findings {
        robots,
        ..Findings::default()
    };
    let mut ticks = interval(TICK.div_f64(speed));
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let (mut count, mut settling) = (0_u32, None::<Instant>);
    let mut measured: Option<(Instant, [f64; 2])> = None;
    loop {
        tokio::select! {
            biased;
            Some(Heard { robot, at, heartbeat }) = heartbeats.recv() => {
                let Some(fake) = fakes.get_mut(&robot) else { continue };
                fake.arbiter.renew(now(), &heartbeat);
                let last = fake.heartbeat.replace(at);
                if let (Some(last), Some(_)) = (last, measured) {
                    findings.jitter.push(((at - last).mul_f64(speed).as_secs_f64() - HEARTBEAT_PERIOD).abs());
                }
            }
            _ = ticks.tick() => {
                count += 1;
                if count.is_multiple_of(CLOCK_EVERY) {
                    clock.put(&SimClock { stamp: on_the_grid(now()) });
                }
                // In turn: robots do not publish all at once.
                for (turn, fake) in (0..).zip(fakes.values_mut()) {
                    fake.tick(now(), count + turn);
                }
                let led = fakes.values().filter(|fake| fake.arbiter.is_live(now())).count();
                match measured {
                    None if settling.is_some_and(|begun: Instant| since(begun) > SETTLING) => {
                        measured = Some((Instant::now(), used(&orchestrators)?));
                    }
                    None if settling.is_some() => {}
                    // One shard after another: the router compares what a thousand missions declare with all that is declared.
                    None if led == started && started < robots => {
                        if let Some((nth, names)) = shards_left.next() {
                            started += names.len();
                            let holder = format!("shard{nth}");
                            orchestrators.push(deployment.start_missions(&holder, &sections(names), shards == 1));
                        }
                    }
                    None if led == robots => {
                        for (turn, fake) in (0_u32..).zip(fakes.values_mut()) {
                            let share = f64::from(turn) / robots as f64;
                            submit(fake, FIRST_GOALS.mul_f64(share).div_f64(speed));
                        }
                        settling = Some(Instant::now());
                    }
                    None if since(start) > READY => {
                        return Err(format!("{led} of {robots} robots are led after {READY:?}"));
                    }
                    None => {}
                    Some((begun, before)) => {
                        findings.faults[0] += robots - led;
                        let took = since(begun).as_secs_f64();
                        if took >= secs {
                            let after = used(&orchestrators)?;
                            findings.load = (after[0] - before[0]) / took;
                            findings.router = (after[1] - before[1]) / took;
                            for process in &orchestrators {
                                let bytes = memory(process.id()).map_err(|error| error.to_string())?;
                                findings.memory += bytes as f64 / MIB;
                            }
                            break;
                        }
                    }
                }
            }
            Some(request) = leases.next() => {
                let Some(fake) = request.chunks.first().and_then(|name| fakes.get_mut(name)) else { continue };
                match fake.arbiter.request(now(), &request.body) {
                    Ok(granted) => {
                        request.reply(&LeaseReply {
                            epoch: granted.epoch,
                            ttl_secs: LEASE.as_secs_f64(),
                            boot_id: "boot".to_owned(),
                            round_trip_secs: None,
                        });
                        if std::mem::replace(&mut fake.is_mapped, true) {
                            continue;
                        }
                        fake.tell_map(now());
                    }
                    Err(refusal) => request.refuse(&refusal),
                }
            }
            Some(request) = infos.next() => {
                let robot = request.chunks.first().cloned().unwrap_or_default();
                request.reply(&InfoReply {
                    component: "edge".to_owned(),
                    version: env!("CARGO_PKG_VERSION").to_owned(),
                    schema: SCHEMA_VERSION,
                    robot,
                    boot: Some(BasedOn { stamp: now(), boot_id: "boot".to_owned() }),
                    model: Some(model.clone()),
                    ..InfoReply::default()
                });
            }
            Some(request) = maps.next() => request.reply(&MapReply {
                info: map_info(now()),
                values: OccupancyGrid::filled(MAP, Occupancy::FREE).values().to_vec(),
                trajectory: Vec::new(),
                stored: Vec::new(),
            }),
            Some(plan) = written.next() => {
                let Some(fake) = plan.chunks.first().and_then(|name| fakes.get_mut(name)) else { continue };
                findings.faults[1] += usize::from(!fake.take(now(), plan.message) && measured.is_some());
            }
            Some(goal) = ended.next() => {
                let Some(fake) = goal.chunks.first().and_then(|name| fakes.get_mut(name)) else { continue };
                if goal.message.state.is_end() && goal.message.id == format!("{}-{}", fake.name, fake.goals) {
                    let good = goal.message.state == GoalPhase::Succeeded;
                    findings.goals += usize::from(good && measured.is_some());
                    findings.faults[2] += usize::from(!good);
                    submit(fake, Duration::ZERO);
                }
            }
        }
    }
    bus.close().await;
    Ok(findings)
}

/// The nearest multiple of the clock's period: a stamp just before a step's time would delay the step by a period.
fn on_the_grid(now: Stamp) -> Stamp {
    let period = (TICK * CLOCK_EVERY).as_secs_f64();
    Stamp::from_secs((now.as_secs() / period).round() * period)
}

fn submit(fake: &mut FakeRobot, after: Duration) {
    let (bus, name, goal) = (fake.bus.clone(), fake.name.clone(), fake.next_goal());
    tokio::spawn(async move {
        tokio::time::sleep(after).await;
        if let Err(error) = bus.ask(&topics::GOAL, &[&name], &goal, Duration::from_secs(10)).await {
            eprintln!("{name}: {error}");
        }
    });
}

/// A fake motion worker: a straight path to the goal, without smoothing.
async fn motion(mut requests: Server<MotionRequest, MotionReply>) {
    while let Some(request) = requests.next().await {
        let MotionRequest::Trajectory(wanted) = &request.body else {
            request.refuse(&Refusal::bad_request("a puppet plans trajectories only"));
            continue;
        };
        let path = vec![wanted.plan.start.position(), wanted.plan.goal.position()];
        let length = (path[1] - path[0]).norm();
        let (start, velocity) = (wanted.plan.start, wanted.start_velocity);
        let safe = unsmoothed(&path, start, velocity, wanted.goal_yaw, &wanted.plan.model);
        let smooth = SmoothReply {
            map: wanted.plan.map.clone(),
            trajectory: safe.sampled(SAMPLES).thinned(),
            statistics: PlanStatistics {
                status: "unsmoothed".to_owned(),
                ..PlanStatistics::default()
            },
            corridor: Vec::new(),
        };
        let plan = PlanReply {
            map: wanted.plan.map.clone(),
            outcome: PlanOutcome::Found { path, length },
            backwards: Vec::new(),
            leg: 0,
            escapes: false,
            search_ms: 0.0,
            expansions: 0,
            origin: PlanOrigin::Searched,
        };
        request.reply(&MotionReply::Trajectory(TrajectoryReply {
            plan,
            smooth: Some(smooth),
            arrival_secs: None,
        }));
    }
}
