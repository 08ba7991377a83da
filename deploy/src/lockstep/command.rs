//! `zenav run`: one goal in a world, from a seed, to its end. The report is the simulator's truth.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args;
use nalgebra::Point2;
use serde::Serialize;
use zenav_protocol::messages::DrivingProfile;
use zenav_protocol::trajectory::TrajectoryPoint;

use super::referee::{ContactKind, ContactReport};
use super::scenario::Scenario;
use crate::config::Layers;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{Format, value};

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
    /// Report the processor time of robot, mapper, mission and motion as `cpu_s`: no two runs give the same
    #[arg(long)]
    cpu: bool,
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
    /// At rest within the tolerance of the goal, by truth; something may have touched the robot on its way.
    Reached,
    /// Not in time.
    Timeout,
    /// The robot touched something by its own motion, however the run went on.
    Collision,
    /// The mission found no path.
    NoPath,
    /// The mission refused the goal.
    Rejected,
    /// The mission gave up, or took itself for being there.
    Aborted,
}

/// Report of `zenav run`.
#[derive(Clone, Debug, Serialize)]
pub struct RunReport {
    /// How it ended.
    pub outcome: RunOutcome,
    /// Why, unless the goal was reached.
    pub reason: Option<String>,
    /// Simulated time, s.
    pub time_s: f64,
    /// When the robot came within the tolerance first, at whatever speed, s.
    pub time_entered_s: Option<f64>,
    /// Driven, m.
    pub length_m: f64,
    /// Least distance of the footprint to an obstacle, m.
    pub min_clearance_m: f64,
    /// Contacts.
    pub collisions: u32,
    /// Each contact.
    pub contacts: Vec<ContactReport>,
    /// Motions that replaced another one.
    pub replans: u64,
    /// Motions published.
    pub plans: u64,
    /// Recoveries started.
    pub recoveries: u64,
    /// Distance from the goal at the end, m.
    pub final_error_m: f64,
    /// How far the robot's estimate lies from its true place at the end, m.
    pub pose_error_m: f64,
    /// How far its estimated heading lies from the true one at the end, rad.
    pub pose_error_rad: f64,
    /// Energy drawn, J.
    pub energy_j: f64,
    /// Energy drawn for each metre driven, J/m.
    pub energy_per_m: f64,
    /// Seed of all noise and delays.
    pub seed: u64,
    /// Mean delay from scan to plan, ms.
    pub cloud_delay_ms: f64,
    /// Processor time of robot, mapper, mission and motion, s, where asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpu_s: Option<f64>,
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
    let world = files::world(args.world.as_ref().unwrap_or(&layers.deployment.simulation.world))?;
    let scenario = Scenario {
        world: &world,
        robot: args.robot.as_deref(),
        seed: args.seed,
        known_map: args.known_map,
        zones: args.zones.as_deref(),
        cloud_delay_ms: args.cloud_delay_ms,
        goal: Point2::new(args.goal[0], args.goal[1]),
        tolerance: args.tolerance,
        profile: args.profile,
        timeout: args.timeout,
    };
    let mut rows = format!("{}\n", TrajectoryPoint::CSV_HEADER);
    let mut report = scenario.run(&layers, |now, truth| {
        let point = TrajectoryPoint::new(now.as_secs(), truth.map_from_base, truth.twist);
        // Writing to a String cannot fail.
        let _ = writeln!(rows, "{point}");
    })?;
    report.cpu_s = report.cpu_s.filter(|_| args.cpu);
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

fn text(report: &RunReport) -> String {
    let mut lines = vec![format!(
        "{:?}{} after {:.2} s, {:.2} m driven, least clearance {:.3} m, error {:.3} m, {} collisions, {} replans, {} recoveries, {:.0} J ({:.0} J/m)",
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
        report.recoveries,
        report.energy_j,
        report.energy_per_m
    )];
    lines.push(format!(
        "the estimate is off by {:.3} m and {:.3} rad{}",
        report.pose_error_m,
        report.pose_error_rad,
        report
            .cpu_s
            .map(|cpu| format!("; {cpu:.2} s of processor time"))
            .unwrap_or_default()
    ));
    lines.extend(report.contacts.iter().map(|contact| {
        let kind = match contact.kind {
            ContactKind::Own => "by its own motion",
            ContactKind::AfterOwnMotion => "within 2 s of its own motion",
            ContactKind::AtRest => "at rest",
        };
        format!(
            "contact after {:.2} s {kind}, at {:.3} m/s of its own",
            contact.time_s, contact.own_speed
        )
    }));
    lines.join("\n")
}
