//! `zenav run`: one goal in a world, from a seed, to its end. The report is the simulator's truth.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args;
use nalgebra::Point2;
use serde::Serialize;
use zenav_mission::MissionConfig;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::id::{Id, InvalidId};
use zenav_protocol::messages::{DrivingProfile, GoalPhase, GoalRequest};
use zenav_protocol::topics::MissionRequest;
use zenav_protocol::trajectory::TrajectoryPoint;
use zenav_sim::{RobotSpec, Simulation, World};

use super::closed_loop::{ClosedLoop, ClosedLoopConfig};
use crate::components::{edge_config, places};
use crate::config::Layers;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{Format, value};
use crate::report::per_metre;

/// The robot's name in a run.
const ROBOT: &str = "robot";
/// Largest side of a known map, cells.
const MAX_CELLS: f64 = 16_384.0;

/// Arguments of `zenav run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Deployment file: its settings, world and first robot; without it, the shipped one
    #[arg(long, value_name = "FILE")]
    deployment: Option<PathBuf>,
    /// World file or shipped name, instead of the deployment's
    #[arg(long)]
    world: Option<String>,
    /// A robot of the deployment by name, or a robot file or shipped name instead of its first robot's model
    #[arg(long)]
    robot: Option<String>,
    /// Goal, m in the world
    #[arg(long, num_args = 2, value_names = ["X", "Y"], allow_negative_numbers = true, required = true)]
    goal: Vec<f64>,
    /// Simulated time after which the run has failed, s
    #[arg(long, default_value_t = 100.0)]
    timeout: f64,
    /// Seed of all noise and delays, instead of the deployment's
    #[arg(long)]
    seed: Option<u64>,
    /// Distance that counts as reached, m, instead of the deployment's
    #[arg(long)]
    tolerance: Option<f64>,
    /// Start with the true map
    #[arg(long)]
    known_map: bool,
    /// File of keep-out and speed zones, instead of the deployment's
    #[arg(long, value_name = "FILE")]
    zones: Option<PathBuf>,
    /// Mean delay from scan to plan, ms; the latency budget is twice that where the deployment sets none
    #[arg(long, default_value_t = 100.0)]
    cloud_delay_ms: f64,
    /// Driving profile, `fastest` or `economy`, instead of the deployment's
    #[arg(long)]
    profile: Option<DrivingProfile>,
    /// Write the driven path as CSV `t,x,y,yaw,v,w`
    #[arg(long, value_name = "FILE")]
    trajectory: Option<PathBuf>,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RunOutcome {
    /// Within the tolerance of the goal.
    Reached,
    /// Not in time.
    Timeout,
    /// The robot touched something.
    Collision,
    /// The mission found no path.
    NoPath,
    /// The mission refused the goal.
    Rejected,
    /// The mission gave up.
    Aborted,
}

/// Report of `zenav run`.
#[derive(Clone, Debug, Serialize)]
pub struct RunReport {
    /// How it ended.
    pub outcome: RunOutcome,
    /// Why, where the mission said so.
    pub reason: Option<String>,
    /// Simulated time, s.
    pub time_s: f64,
    /// Driven, m.
    pub length_m: f64,
    /// Least distance of the footprint to an obstacle, m.
    pub min_clearance_m: f64,
    /// Contacts.
    pub collisions: u32,
    /// Motions that replaced another one.
    pub replans: u64,
    /// Motions published.
    pub plans: u64,
    /// Distance from the goal at the end, m.
    pub final_error_m: f64,
    /// Energy drawn, J.
    pub energy_j: f64,
    /// Energy drawn for each metre driven, J/m.
    pub energy_per_m: f64,
    /// Seed of all noise and delays.
    pub seed: u64,
    /// Mean delay from scan to plan, ms.
    pub cloud_delay_ms: f64,
}

/// `zenav run`.
///
/// # Errors
/// Bad files or arguments.
pub fn run(args: &RunArgs) -> Outcome {
    for (name, number) in [
        ("--goal", args.goal[0]),
        ("--goal", args.goal[1]),
        ("--timeout", args.timeout),
        ("--tolerance", args.tolerance.unwrap_or_default()),
        ("--cloud-delay-ms", args.cloud_delay_ms),
    ] {
        if !number.is_finite() || (name != "--goal" && number < 0.0) {
            return Err(Failure::usage(format!(
                "{name} {number}: expected a finite number{}",
                if name == "--goal" { "" } else { ", not negative" }
            )));
        }
    }
    let layers = Layers::load(args.deployment.as_deref())?;
    let deployment = &layers.deployment;
    let world = files::world(args.world.as_ref().unwrap_or(&deployment.simulation.world))?;
    let config = closed_loop(args, &layers, &world)?;
    let spec = RobotSpec {
        id: config.edge.robot.clone(),
        model: config.edge.model.clone(),
        start: config.edge.start,
    };
    let seed = config.seed;
    let tolerance = args.tolerance.unwrap_or(config.mission.settings.tolerance);
    let simulation =
        Simulation::new(&world, vec![spec], config.seed).map_err(|error| Failure::usage(error.to_string()))?;
    let mut stage = ClosedLoop::new(simulation, config);
    let mut rows = format!("{}\n", TrajectoryPoint::CSV_HEADER);
    let report = drive(args, tolerance, seed, &mut stage, &mut rows);
    if let Some(file) = &args.trajectory {
        files::write(file, rows)?;
    }
    value(args.output, &report, text)?;
    Ok(match report.outcome {
        RunOutcome::Reached => exit_code::OK,
        RunOutcome::Timeout => exit_code::TIMEOUT,
        RunOutcome::Rejected => exit_code::REJECTED,
        RunOutcome::Collision | RunOutcome::NoPath | RunOutcome::Aborted => exit_code::FAILED,
    })
}

/// The parts of a run, with the deployment's settings.
fn closed_loop(args: &RunArgs, layers: &Layers, world: &World) -> Result<ClosedLoopConfig, Failure> {
    let deployment = &layers.deployment;
    let failed = |error: InvalidId| Failure::failed(error.to_string());
    let id = Id::robot(ROBOT).map_err(failed)?;
    let named = args.robot.as_ref().and_then(|robot| deployment.robots.get(robot));
    let mut section = named.or(deployment.robots.values().next()).cloned().unwrap_or_default();
    if let (Some(robot), None) = (&args.robot, named) {
        section.model.clone_from(robot);
    }
    let start = section
        .start
        .map_or_else(|| world.start(), |start| Pose2::new(start.x, start.y, start.yaw));
    let mut mission = deployment.mission.settings.clone();
    if !layers.sets("mission.latency_budget") {
        mission.latency_budget = (1e-3 * args.cloud_delay_ms * 2.0).max(0.1);
    }
    let mut mapping = deployment.mapping.settings.clone();
    let known_map = args
        .known_map
        .then(|| true_map(world, mapping.resolution))
        .transpose()?;
    if let Some(map) = &known_map {
        mapping.resolution = map.spec().resolution;
    }
    Ok(ClosedLoopConfig {
        edge: edge_config(&id, &section, files::robot(&section.model)?, start),
        mission: MissionConfig {
            robot: id,
            holder: "lockstep".to_owned(),
            store: PathBuf::new(),
            places: places(world),
            zones: files::zones(args.zones.as_deref().or(deployment.zones.file.as_deref()))?,
            planner: deployment.planning.run.planner.clone(),
            settings: mission,
        },
        mapping,
        motion: deployment.motion(),
        known_map,
        cloud_delay: 1e-3 * args.cloud_delay_ms,
        seed: args.seed.unwrap_or(deployment.simulation.seed),
    })
}

/// The world as a map: its own, or every cell that something solid touches.
///
/// # Errors
/// A world that is too large to be a map.
fn true_map(world: &World, resolution: f64) -> Result<OccupancyGrid, Failure> {
    if let Some(map) = world.map() {
        return Ok(map.clone());
    }
    let (lower, upper) = world.bounds();
    let cells = |length: f64| (length / resolution).ceil();
    let (width, height) = (cells(upper.x - lower.x), cells(upper.y - lower.y));
    if !(width <= MAX_CELLS && height <= MAX_CELLS) {
        return Err(Failure::usage(format!(
            "--known-map: a world of {width} by {height} cells: expected at most {MAX_CELLS} a side"
        )));
    }
    let spec = GridSpec {
        origin: lower,
        resolution,
        width: width as u32,
        height: height as u32,
    };
    let mut map = Grid::filled(spec, Occupancy::FREE);
    let cell = zenav_protocol::robot::Footprint::Polygon(
        [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
            .map(|(x, y)| Point2::new(x * resolution, y * resolution))
            .to_vec(),
    );
    for y in 0..spec.height {
        for x in 0..spec.width {
            let center = spec.center(Cell::new(x, y));
            if world.clearance(&cell, Pose2::new(center.x, center.y, 0.0)) <= 0.0 {
                map[Cell::new(x, y)] = Occupancy::OCCUPIED;
            }
        }
    }
    Ok(map)
}

fn drive(args: &RunArgs, tolerance: f64, seed: u64, stage: &mut ClosedLoop, rows: &mut String) -> RunReport {
    let goal = Point2::new(args.goal[0], args.goal[1]);
    stage.ask(MissionRequest::Goal(GoalRequest {
        id: Some("run".to_owned()),
        x: Some(goal.x),
        y: Some(goal.y),
        tolerance: Some(tolerance),
        profile: args.profile,
        ..GoalRequest::default()
    }));
    let mut reason = None;
    let outcome = loop {
        stage.tick();
        let truth = stage.truth();
        let (pose, twist) = (truth.map_from_base, truth.twist);
        // Writing to a String cannot fail.
        let _ = writeln!(rows, "{}", TrajectoryPoint::new(stage.now().as_secs(), pose, twist));
        if truth.collisions > 0 {
            break RunOutcome::Collision;
        }
        if (pose.position() - goal).norm() <= tolerance {
            break RunOutcome::Reached;
        }
        if let Some(Err(refusal)) = stage.replies().first() {
            reason = Some(refusal.to_string());
            break RunOutcome::Rejected;
        }
        if let Some(state) = stage.goal().filter(|state| state.state.is_end()) {
            reason.clone_from(&state.reason);
            break match state.state {
                GoalPhase::Rejected => RunOutcome::Rejected,
                _ if reason
                    .as_ref()
                    .is_some_and(|reason| reason.contains("no path") || reason.contains("the goal is occupied")) =>
                {
                    RunOutcome::NoPath
                }
                _ => RunOutcome::Aborted,
            };
        }
        if stage.now().as_secs() >= args.timeout {
            break RunOutcome::Timeout;
        }
    };
    let truth = stage.truth();
    let feedback = stage.goal().map(|goal| goal.feedback.clone()).unwrap_or_default();
    RunReport {
        outcome,
        reason,
        time_s: stage.now().as_secs(),
        length_m: truth.length,
        min_clearance_m: truth.min_clearance,
        collisions: truth.collisions,
        replans: feedback.replans,
        plans: feedback.plans,
        final_error_m: (truth.map_from_base.position() - goal).norm(),
        energy_j: truth.drawn_j,
        energy_per_m: per_metre(truth.drawn_j, truth.length),
        seed,
        cloud_delay_ms: args.cloud_delay_ms,
    }
}

fn text(report: &RunReport) -> String {
    format!(
        "{:?}{} after {:.2} s, {:.2} m driven, least clearance {:.3} m, error {:.3} m, {} collisions, {} replans, {:.0} J ({:.0} J/m)",
        report.outcome,
        report
            .reason
            .as_ref()
            .map(|reason| format!(" ({reason})"))
            .unwrap_or_default(),
        report.time_s,
        report.length_m,
        report.min_clearance_m,
        report.final_error_m,
        report.collisions,
        report.replans,
        report.energy_j,
        report.energy_per_m
    )
}
