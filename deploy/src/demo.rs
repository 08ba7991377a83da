//! Does everything work on this machine? One scenario over real Zenoh sessions, to its end, with a report.
//!
//! The parts meet at a router on a free loopback port; the demo itself is one more client that submits the mission as one
//! goal and watches. Clearance, contacts and errors come from the simulator's truth, which no part sees.

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use zenav_edge::Referee;
use zenav_protocol::bus::{Bus, BusConfig, Latest, Router, RouterConfig, Subscription};
use zenav_protocol::id::Id;
use zenav_protocol::messages::*;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;
use zenav_sim::{Truth, World};

use crate::config::{self, Deployment};
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::launch::{CloudPart, Parts, interrupted, runtime};
use crate::output::{Format, value};
use crate::report::{DemoReport, GoalReport, Latency, Percentiles, ScenarioOutcome};

/// The robot of every scenario.
const ROBOT: &str = "tiago";
/// Time for the parts to come up, wall.
const START_UP: Duration = Duration::from_secs(20);
/// How often truth is sampled, wall.
const SAMPLE: Duration = Duration::from_millis(10);
/// How often a plain log tells how it goes, wall.
const LOG_EVERY: Duration = Duration::from_secs(5);
/// Faster than this counts as motion, m/s or rad/s.
const MOVING: f64 = 0.02;
/// At this speed and above wall-clock effects show.
const FAST: f64 = 4.0;

/// Scenarios.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Scenario {
    /// Map a kitchen, then drive to its corner and to the sink
    Kitchen,
}

impl Scenario {
    const fn name(self) -> &'static str {
        match self {
            Self::Kitchen => "kitchen",
        }
    }

    /// Simulated time after which the scenario has failed, s.
    const fn time_limit(self) -> f64 {
        match self {
            Self::Kitchen => 300.0,
        }
    }
}

/// Arguments of `zenav demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Which scenario
    #[arg(value_enum, default_value = "kitchen")]
    scenario: Scenario,
    /// Simulated seconds a second of wall time
    #[arg(long, default_value_t = 1.0)]
    speed: f64,
    /// Seed of all noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder for `report.json`, `map.pgm` and `map.yaml`; a map that is there already is used
    #[arg(long, default_value = "zenav-out")]
    out: PathBuf,
    /// Plain log lines instead of a live display
    #[arg(long)]
    no_ui: bool,
    /// Form of the report on stdout
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// `zenav demo`.
///
/// # Errors
/// Bad arguments, or a part that failed.
pub fn run(args: &DemoArgs) -> Outcome {
    if !(args.speed.is_finite() && args.speed > 0.0) {
        return Err(Failure::usage("--speed: expected a positive number"));
    }
    crate::receivers::ensure_enough();
    std::fs::create_dir_all(&args.out).map_err(|error| Failure::failed(format!("{}: {error}", args.out.display())))?;
    let report = runtime()?.block_on(scenario(args))?;
    let text = serde_json::to_string_pretty(&report).map_err(|error| Failure::failed(error.to_string()))?;
    let file = args.out.join("report.json");
    std::fs::write(&file, text + "\n").map_err(|error| Failure::failed(format!("{}: {error}", file.display())))?;
    value(args.output, &report, DemoReport::text)?;
    Ok(if report.outcome == ScenarioOutcome::Succeeded {
        exit_code::OK
    } else {
        exit_code::FAILED
    })
}

/// The shipped deployment on free ports, with its files in a folder of the run.
fn deployment(args: &DemoArgs, endpoint: &str, state: &Path) -> Result<Deployment, Failure> {
    let mut deployment = config::load(None)?;
    deployment.bus.connect = endpoint.to_owned();
    deployment.simulation = config::SimulationSection {
        world: args.scenario.name().to_owned(),
        seed: args.seed,
        speed: args.speed,
    };
    deployment.data.dir = state.to_path_buf();
    for section in deployment.robots.values_mut() {
        section.listen = "tcp/127.0.0.1:0".to_owned();
    }
    Ok(deployment)
}

/// The files of a stored map.
const MAP_FILES: [&str; 3] = ["map.pgm", "map.yaml", "map.json"];

fn copy_map(from: &Path, to: &Path) -> Result<bool, Failure> {
    std::fs::create_dir_all(to).map_err(|error| Failure::failed(format!("{}: {error}", to.display())))?;
    let mut found = false;
    for name in MAP_FILES {
        if from.join(name).is_file() {
            std::fs::copy(from.join(name), to.join(name))
                .map_err(|error| Failure::failed(format!("{}: {error}", to.join(name).display())))?;
            found |= name == "map.yaml";
        }
    }
    Ok(found)
}

async fn scenario(args: &DemoArgs) -> Result<DemoReport, Failure> {
    let began = Instant::now();
    // Goals and epochs of a demo are its own; the map alone outlives it.
    let state = args.out.join(format!(".run-{}", std::process::id()));
    let robot_dir = state.join(ROBOT);
    let map_found = copy_map(&args.out, &robot_dir)?;
    let result = async {
        let router = Router::open(&RouterConfig {
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            ..RouterConfig::default()
        })
        .await?;
        let endpoint = router
            .endpoints()
            .await
            .into_iter()
            .next()
            .ok_or_else(|| Failure::failed("the router has no endpoint"))?;
        let deployment = deployment(args, &endpoint, &state)?;
        let world = files::world(&deployment.simulation.world)?;
        let mut parts = Parts::default();
        let played = play(args, &deployment, &world, &mut parts, &endpoint).await;
        parts.end().await;
        router.close().await;
        played
    }
    .await;
    let kept = copy_map(&robot_dir, &args.out);
    let _ = std::fs::remove_dir_all(&state);
    let mut report = result?;
    kept?;
    report.map_found = map_found;
    report.wall_time_s = began.elapsed().as_secs_f64();
    Ok(report)
}

async fn play(
    args: &DemoArgs,
    deployment: &Deployment,
    world: &World,
    parts: &mut Parts,
    endpoint: &str,
) -> Result<DemoReport, Failure> {
    let robots = deployment.robot_ids()?;
    let (id, section) = robots
        .first()
        .ok_or_else(|| Failure::failed("the deployment has no robot"))?;
    let referee = parts.edge(deployment, world, id, section)?;
    parts.cloud(deployment, world, CloudPart::All, "demo")?;
    let bus = Bus::open(BusConfig::command("demo", endpoint)).await?;
    let mut watch = Watch::new(&bus, id, referee)?;
    let request = GoalRequest {
        id: Some(format!("{}-{}", args.scenario.name(), args.seed)),
        tree: Some(args.scenario.name().to_owned()),
        ..GoalRequest::default()
    };
    watch.narrate("waiting for the parts");
    let robot = [id.as_str()];
    let reply = tokio::select! {
        reply = bus.ask(&topics::GOAL, &robot, &request, START_UP) => reply?,
        ended = parts.first_end() => { ended?; return Err(Failure::failed("the parts ended")); }
    };
    if !args.no_ui && std::io::stderr().is_terminal() {
        watch.bar = Some(progress_bar());
    }
    watch.narrate(&format!("goal {} accepted", reply.id));
    let end = tokio::select! {
        end = watch.until_end(&reply.id, args.scenario.time_limit()) => end,
        ended = parts.first_end() => { ended?; None }
        () = interrupted() => {
            if let Some(bar) = &watch.bar {
                bar.finish_and_clear();
            }
            return Err(Failure::new(exit_code::INTERRUPTED, "interrupted"));
        }
    };
    if let Some(bar) = &watch.bar {
        bar.finish_and_clear();
    }
    bus.close().await;
    Ok(watch.report(args, end))
}

fn progress_bar() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(120));
    bar
}

/// Truth at a moment.
#[derive(Clone, Copy)]
struct Sample {
    now: Stamp,
    truth: Truth,
}

/// What the demo sees, as any client would, and the referee's truth.
struct Watch {
    referee: Referee,
    scans: Latest<Scan>,
    poses: Latest<PoseEstimate>,
    states: Latest<EdgeState>,
    map: Latest<MapInfo>,
    plans: Subscription<Plan>,
    goals: Subscription<GoalState>,
    samples: Vec<Sample>,
    /// Arrival of recent scans and poses, by their stamp.
    arrivals: Vec<(Stamp, Instant)>,
    /// Scan that is the newest in each recent revision of the map.
    revisions: Vec<(MapRef, Stamp)>,
    scan_to_plan: Vec<f64>,
    goal_to_motion: Vec<f64>,
    waiting_for_motion: Option<Instant>,
    seen_motion: Option<u64>,
    motions: u64,
    goal: Option<GoalState>,
    state: Option<EdgeState>,
    told: String,
    last_log: Instant,
    bar: Option<ProgressBar>,
}

impl Watch {
    fn new(bus: &Bus, id: &Id, referee: Referee) -> Result<Self, Failure> {
        let robot = &[id.as_str()];
        Ok(Self {
            referee,
            scans: bus.latest(&topics::SCAN, robot)?,
            poses: bus.latest(&topics::POSE, robot)?,
            states: bus.latest(&topics::STATE, robot)?,
            map: bus.latest(&topics::MAP_INFO, robot)?,
            plans: bus.subscribe(&topics::PLAN, robot, 64)?,
            goals: bus.subscribe(&topics::GOAL_STATE, &[id.as_str(), "*"], 64)?,
            samples: Vec::new(),
            arrivals: Vec::new(),
            revisions: Vec::new(),
            scan_to_plan: Vec::new(),
            goal_to_motion: Vec::new(),
            waiting_for_motion: None,
            seen_motion: None,
            motions: 0,
            goal: None,
            state: None,
            told: String::new(),
            last_log: Instant::now(),
            bar: None,
        })
    }

    /// Watches until the goal ends or the limit of simulated time has passed; `None` for the latter.
    async fn until_end(&mut self, goal_id: &str, limit_secs: f64) -> Option<GoalState> {
        let mut sampling = tokio::time::interval(SAMPLE);
        sampling.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                biased;
                plan = self.plans.next() => self.see_plan(&plan?.message),
                goal = self.goals.next() => {
                    let goal = goal?.message;
                    if goal.id == goal_id {
                        self.see_goal(&goal);
                        if goal.state.is_end() {
                            self.sample();
                            return Some(goal);
                        }
                    }
                }
                open = self.scans.changed() => { open.then_some(())?; if let Some(scan) = self.scans.take() { self.arrived(scan.stamp); } }
                open = self.poses.changed() => { open.then_some(())?; if let Some(pose) = self.poses.take() { self.arrived(pose.stamp); } }
                open = self.states.changed() => { open.then_some(())?; self.see_state(); }
                open = self.map.changed() => {
                    open.then_some(())?;
                    if let Some(info) = self.map.take() {
                        self.revisions.push((info.map, info.stamp));
                        let excess = self.revisions.len().saturating_sub(64);
                        self.revisions.drain(..excess);
                    }
                }
                _ = sampling.tick() => {
                    self.sample();
                    if self.referee.now().as_secs() > limit_secs {
                        return None;
                    }
                    self.tell();
                }
            }
        }
    }

    fn sample(&mut self) {
        let sample = Sample {
            now: self.referee.now(),
            truth: self.referee.truth(),
        };
        if self.samples.last().is_none_or(|last| last.now < sample.now) {
            self.samples.push(sample);
        }
    }

    fn arrived(&mut self, stamp: Stamp) {
        self.arrivals.push((stamp, Instant::now()));
        let excess = self.arrivals.len().saturating_sub(512);
        self.arrivals.drain(..excess);
    }

    /// A new motion: what it is based on arrived some time before it.
    fn see_plan(&mut self, plan: &Plan) {
        if self.seen_motion == Some(plan.trajectory_id) || (plan.trajectory.is_empty() && plan.waypoints.is_empty()) {
            return;
        }
        self.seen_motion = Some(plan.trajectory_id);
        self.motions += 1;
        // The newest scan in the map it was checked on; where the map is not growing, the pose it starts from.
        let scan = self
            .revisions
            .iter()
            .rev()
            .find(|(map, _)| *map == plan.map)
            .map(|(_, stamp)| *stamp);
        let basis = scan
            .filter(|stamp| plan.based_on.stamp.secs_since(*stamp).abs() < 1.0)
            .unwrap_or(plan.based_on.stamp);
        if let Some((_, arrival)) = self.arrivals.iter().rev().find(|(stamp, _)| *stamp <= basis) {
            self.scan_to_plan.push(arrival.elapsed().as_secs_f64() * 1e3);
        }
    }

    fn see_goal(&mut self, goal: &GoalState) {
        let begun = |goal: &GoalState| (goal.feedback.step.clone(), goal.legs.len());
        let at_rest = self
            .state
            .as_ref()
            .is_none_or(|state| state.velocity.v.abs() < MOVING && state.velocity.w.abs() < MOVING);
        if self.goal.as_ref().map(begun) != Some(begun(goal)) && at_rest {
            self.waiting_for_motion = Some(Instant::now());
        }
        self.goal = Some(goal.clone());
    }

    fn see_state(&mut self) {
        let Some(state) = self.states.take() else { return };
        let moving = state.velocity.v.abs() >= MOVING || state.velocity.w.abs() >= MOVING;
        if moving && let Some(since) = self.waiting_for_motion.take() {
            self.goal_to_motion.push(since.elapsed().as_secs_f64() * 1e3);
        }
        self.state = Some(state);
    }

    /// Tells a person how it goes: a live line, or log lines at every new step and now and then.
    fn tell(&mut self) {
        let Some(goal) = &self.goal else { return };
        let step = goal.feedback.step.clone();
        let line = format!(
            "t {:5.1} s  {}  {}{}",
            self.referee.now().as_secs(),
            if step.is_empty() { "starting" } else { &step },
            goal.feedback
                .distance_left
                .map(|left| format!("{left:.1} m left  "))
                .unwrap_or_default(),
            self.state
                .as_ref()
                .map(|state| format!("{:.2} m/s  {:?}  {:?}", state.velocity.v, state.mode, state.link))
                .unwrap_or_default()
        );
        if let Some(bar) = &self.bar {
            bar.set_message(line);
        } else if step != self.told || self.last_log.elapsed() > LOG_EVERY {
            tracing::info!("{line}");
            self.told = step;
            self.last_log = Instant::now();
        }
    }

    fn narrate(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(text.to_owned()),
            None => tracing::info!("{text}"),
        }
    }

    fn report(&self, args: &DemoArgs, end: Option<GoalState>) -> DemoReport {
        let truth = self.referee.truth();
        let goal = end.clone().or_else(|| self.goal.clone());
        let legs = goal.as_ref().map(|goal| goal.legs.clone()).unwrap_or_default();
        let goals: Vec<GoalReport> = legs.iter().map(|leg| self.leg_report(leg)).collect();
        let reason = match &end {
            None => Some("it did not come to an end in time".to_owned()),
            Some(goal) if goal.state != GoalPhase::Succeeded => {
                Some(format!("{:?}: {}", goal.state, goal.reason.clone().unwrap_or_default()))
            }
            Some(_) if truth.collisions > 0 => Some("the robot touched something".to_owned()),
            Some(_) => None,
        };
        let feedback = goal.map(|goal| goal.feedback).unwrap_or_default();
        let mut notes = Vec::new();
        if args.speed >= FAST {
            notes.push("at speed 4 and above a delay on the wall clock counts as so many times more simulated time: a plan that comes later than its lead is refused and made anew".to_owned());
        }
        DemoReport {
            scenario: args.scenario.name().to_owned(),
            seed: args.seed,
            speed: args.speed,
            outcome: if reason.is_none() {
                ScenarioOutcome::Succeeded
            } else {
                ScenarioOutcome::Failed
            },
            reason,
            map_found: false,
            goals,
            collisions: truth.collisions.into(),
            min_clearance_m: truth.min_clearance,
            sim_time_s: self.referee.now().as_secs(),
            wall_time_s: 0.0,
            plans: self.motions,
            replans: feedback.replans,
            latency: Latency {
                scan_to_plan_ms: Percentiles::of(&self.scan_to_plan),
                goal_to_motion_ms: Percentiles::of(&self.goal_to_motion),
            },
            energy_j: truth.drawn_j,
            notes,
        }
    }

    fn leg_report(&self, leg: &Leg) -> GoalReport {
        let end = leg.ended.unwrap_or(Stamp(u64::MAX));
        let during: Vec<&Sample> = self
            .samples
            .iter()
            .filter(|sample| sample.now >= leg.started && sample.now <= end)
            .collect();
        let length = match (during.first(), during.last()) {
            (Some(first), Some(last)) => last.truth.length - first.truth.length,
            _ => 0.0,
        };
        let last = during.last().map(|sample| sample.truth.map_from_base);
        let error = leg
            .goal
            .zip(last)
            .map(|(goal, pose)| (goal.x - pose.x).hypot(goal.y - pose.y));
        GoalReport {
            name: leg.name.clone(),
            outcome: if leg.state == GoalPhase::Succeeded {
                "reached".to_owned()
            } else {
                leg.reason.clone().unwrap_or_else(|| format!("{:?}", leg.state))
            },
            time_s: leg.ended.map_or_else(
                || self.referee.now().secs_since(leg.started),
                |ended| ended.secs_since(leg.started),
            ),
            length_m: length,
            min_clearance_m: during
                .iter()
                .map(|sample| sample.truth.clearance)
                .fold(f64::INFINITY, f64::min),
            final_error_m: error,
        }
    }
}
