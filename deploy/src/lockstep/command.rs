//! `zenav run`: one goal in a world, or one per robot, from a seed to the end. The report is from the simulator's ground truth.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args;
use nalgebra::Point2;
use serde::Serialize;
use zenav_cloud::mapping::PoseSource;
use zenav_mission::GOAL_TOLERANCE;
use zenav_protocol::config_text::Number;
use zenav_protocol::messages::DrivingProfile;
use zenav_protocol::trajectory::TrajectoryPoint;
use zenav_sim::World;

use super::recorder::Recorder;
use super::referee::{ContactKind, ContactReport};
use super::scenario::{Entrant, Scenario};
use crate::arguments::{finite, not_negative, pose, whole};
use crate::completion;
use crate::config::Layers;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{Format, counted, piece, value};
use crate::report::{energy, least_clearance};

/// Arguments of `zenav run`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav run --world kitchen --robot tiago --goal 0.88 0.09 --seed 3\n  zenav run --world house --goal 6 2 --known-map --trajectory driven.csv"
)]
pub struct RunArgs {
    /// Deployment file: its settings, world and first robot; without it, the shipped one
    #[arg(long, value_name = "FILE")]
    deployment: Option<PathBuf>,
    /// World file or shipped name, instead of the deployment's
    #[arg(long, add = completion::worlds())]
    world: Option<String>,
    /// A robot of the deployment by name, or a robot file or shipped name that replaces its first robot's model; with several robots, give
    /// it once for all or once per goal
    #[arg(long, add = completion::models())]
    robot: Vec<String>,
    /// Start pose, m and rad in the world, instead of the deployment's; with several robots, once per goal
    #[arg(long, num_args = 3, value_names = ["X", "Y", "YAW"], value_parser = finite)]
    start: Vec<f64>,
    /// Goal, m in the world; repeat for each further robot
    #[arg(long, num_args = 2, value_names = ["X", "Y"], required = true, value_parser = finite)]
    goal: Vec<f64>,
    /// Time limit of the run, simulated, s
    #[arg(long, default_value_t = 100.0, value_parser = not_negative)]
    timeout: f64,
    /// Seed of all noise and delays, instead of the deployment's
    #[arg(long, value_parser = whole::<u64>)]
    seed: Option<u64>,
    /// Distance that counts as reached, m, instead of the deployment's
    #[arg(long, value_parser = finite)]
    tolerance: Option<f64>,
    /// Start with the true map
    #[arg(long)]
    known_map: bool,
    /// Source of mapping's poses, `edge`, `slam` or `localise` (with --known-map), instead of the deployment's
    #[arg(long, value_name = "SOURCE")]
    poses: Option<PoseSource>,
    /// File of keep-out and speed zones, instead of the deployment's
    #[arg(long, value_name = "FILE")]
    zones: Option<PathBuf>,
    /// Mean delay from scan to plan, ms; the latency budget is twice that, unless the deployment sets one
    #[arg(long, default_value_t = 100.0, value_parser = not_negative)]
    cloud_delay_ms: f64,
    /// Driving profile, `fastest` or `economy`, instead of the deployment's
    #[arg(long)]
    profile: Option<DrivingProfile>,
    /// Report the processor time of robot, mapper, mission and motion as `cpu_s`; it differs between runs
    #[arg(long)]
    cpu: bool,
    /// Write the driven path as CSV `t,x,y,yaw,v,w`; with several robots, the robot's number comes first
    #[arg(long, value_name = "FILE")]
    trajectory: Option<PathBuf>,
    /// Record the run in this file; it must not exist yet
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Outcome of a run; later ones are worse.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RunOutcome {
    /// At rest within the tolerance of the goal, by ground truth; other things may have touched the robot.
    Reached,
    /// Time limit exceeded.
    Timeout,
    /// The mission gave up, or wrongly reported success.
    Aborted,
    /// The mission found no path.
    NoPath,
    /// The mission refused the goal.
    Rejected,
    /// The robot touched something by its own motion, however the run continued.
    Collision,
}

/// Report of `zenav run`.
#[derive(Clone, Debug, Serialize)]
pub struct RunReport {
    /// Outcome.
    pub outcome: RunOutcome,
    /// Reason, unless the goal was reached.
    pub reason: Option<String>,
    /// Simulated time, s.
    pub time_s: f64,
    /// When the robot first came within the tolerance, at any speed, s.
    pub time_entered_s: Option<f64>,
    /// Driven, m.
    pub length_m: f64,
    /// Smallest distance of the footprint to an obstacle, m.
    pub min_clearance_m: f64,
    /// Number of contacts.
    pub collisions: u32,
    /// Each contact.
    pub contacts: Vec<ContactReport>,
    /// Motions that replaced an earlier one.
    pub replans: u64,
    /// Motions published.
    pub plans: u64,
    /// Recoveries started.
    pub recoveries: u64,
    /// Final distance from the goal, m.
    pub final_error_m: f64,
    /// Final error of the position estimate, m.
    pub pose_error_m: f64,
    /// Final error of the heading estimate, rad.
    pub pose_error_rad: f64,
    /// Energy drawn, J.
    pub energy_j: f64,
    /// Energy drawn per metre driven, J/m; `None` for hardly any distance.
    pub energy_per_m: Option<f64>,
    /// Seed of all noise and delays.
    pub seed: u64,
    /// Mean delay from scan to plan, ms.
    pub cloud_delay_ms: f64,
    /// Processor time of robot, mapper, mission and motion, s, on request.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpu_s: Option<f64>,
}

/// Report of `zenav run` with several robots.
#[derive(Clone, Debug, Serialize)]
struct FleetReport {
    /// The worst outcome of all robots.
    outcome: RunOutcome,
    /// When the last robot was done, s.
    makespan_s: f64,
    /// Each robot, in the order of the goals.
    robots: Vec<RunReport>,
}

/// `zenav run`.
///
/// # Errors
/// Bad files or arguments.
pub fn run(args: &RunArgs) -> Outcome {
    check(args)?;
    let layers = Layers::load(args.deployment.as_deref())?;
    let world = files::world(args.world.as_ref().unwrap_or(&layers.deployment.simulation.world))?;
    let entrants = entrants(args)?;
    check_goals(&world, &entrants)?;
    let scenario = Scenario {
        world: &world,
        entrants,
        seed: args.seed,
        known_map: args.known_map,
        poses: args.poses,
        zones: args.zones.as_deref(),
        cloud_delay_ms: args.cloud_delay_ms,
        tolerance: args.tolerance,
        profile: args.profile,
        timeout: args.timeout,
    };
    let several = scenario.entrants.len() > 1;
    let mut rows = format!(
        "{}{}\n",
        if several { "robot," } else { "" },
        TrajectoryPoint::CSV_HEADER
    );
    let title = || {
        let seed = args.seed.unwrap_or(layers.deployment.simulation.seed);
        format!("{}, seed {seed}", world.name())
    };
    let prepared = scenario.prepare(&layers)?;
    // Only a run that begins creates files.
    args.trajectory.as_deref().map_or(Ok(()), files::writable)?;
    let recorder = args.record.as_deref().map(|file| Recorder::create(file, title()));
    let mut recorder = recorder.transpose()?;
    let mut reports = prepared.run(recorder.as_mut(), |robot, now, truth| {
        let point = TrajectoryPoint::new(now.as_secs(), truth.map_from_base, truth.twist);
        // Writing to a String cannot fail.
        let _ = match several {
            true => writeln!(rows, "{},{point}", robot + 1),
            false => writeln!(rows, "{point}"),
        };
    });
    for report in &mut reports {
        report.cpu_s = report.cpu_s.filter(|_| args.cpu);
    }
    let written = args
        .trajectory
        .as_deref()
        .map_or(Ok(()), |file| files::write(file, rows));
    let recorded = recorder.map_or(Ok(()), |recorder| recorder.finish().map(drop));
    let outcome = worst(&reports);
    match reports.as_slice() {
        [report] => {
            value(args.output, report, text)?;
        }
        _ => {
            let report = FleetReport {
                outcome,
                makespan_s: reports.iter().map(|report| report.time_s).fold(0.0, f64::max),
                robots: reports,
            };
            value(args.output, &report, fleet_text)?;
        }
    }
    // The report is printed even if a file could not be written.
    written.and(recorded)?;
    Ok(match outcome {
        RunOutcome::Reached => exit_code::OK,
        RunOutcome::Timeout => exit_code::TIMEOUT,
        RunOutcome::Rejected => exit_code::REJECTED,
        RunOutcome::Collision | RunOutcome::NoPath | RunOutcome::Aborted => exit_code::FAILED,
    })
}

fn check(args: &RunArgs) -> Result<(), Failure> {
    if args.poses == Some(PoseSource::Localise) && !args.known_map {
        return Err(Failure::usage(
            "--poses localise: expected --known-map, the map to localise in",
        ));
    }
    if let Some(tolerance) = args.tolerance.filter(|tolerance| !GOAL_TOLERANCE.contains(tolerance)) {
        return Err(Failure::usage(format!(
            "--tolerance {tolerance}: expected {} to {} m",
            GOAL_TOLERANCE.start(),
            GOAL_TOLERANCE.end()
        )));
    }
    Ok(())
}

/// One robot per goal.
fn entrants(args: &RunArgs) -> Result<Vec<Entrant<'_>>, Failure> {
    let goals = args.goal.chunks_exact(2).map(|goal| Point2::new(goal[0], goal[1]));
    let (count, robots, starts) = (goals.len(), args.robot.len(), args.start.len() / 3);
    if robots > 1 && robots != count {
        return Err(Failure::usage(format!(
            "--robot: given {robots} times for {count} goals; expected once, or once for each goal"
        )));
    }
    if (starts > 0 || count > 1) && starts != count {
        return Err(Failure::usage(format!(
            "--start: given {starts} times for {count} goals; expected once for each goal"
        )));
    }
    let mut starts = args.start.chunks_exact(3).map(|start| pose("--start", start));
    let entrants = goals.enumerate().map(|(index, goal)| -> Result<_, Failure> {
        Ok(Entrant {
            robot: args.robot.get(index).or(args.robot.first()).map(String::as_str),
            start: starts.next().transpose()?,
            goal,
        })
    });
    entrants.collect()
}

/// Refuses goals outside of the world.
fn check_goals(world: &World, entrants: &[Entrant<'_>]) -> Result<(), Failure> {
    let Some(outside) = entrants.iter().find(|entrant| !world.holds(entrant.goal)) else {
        return Ok(());
    };
    let (goal, (low, high)) = (outside.goal, world.bounds());
    Err(Failure::usage(format!(
        "--goal {} {} lies outside of the world: expected {} to {} by {} to {}",
        Number(goal.x),
        Number(goal.y),
        millimetres(low.x),
        millimetres(high.x),
        millimetres(low.y),
        millimetres(high.y)
    )))
}

/// A length in whole millimetres, m, without the digits that only rounding left, as in 9.200000000000003.
fn millimetres(metres: f64) -> Number {
    // Adding zero takes the sign from -0.
    Number((1e3 * metres).round() / 1e3 + 0.0)
}

/// The worst outcome of several robots.
pub(crate) fn worst(reports: &[RunReport]) -> RunOutcome {
    let worst = reports.iter().map(|report| report.outcome).max();
    worst.unwrap_or(RunOutcome::Reached)
}

fn fleet_text(report: &FleetReport) -> String {
    let mut lines = vec![format!("{:?} after {:.2} s", report.outcome, report.makespan_s)];
    for (index, report) in report.robots.iter().enumerate() {
        lines.push(format!("robot {}: {}", index + 1, text(report)));
    }
    lines.join("\n")
}

fn text(report: &RunReport) -> String {
    let mut lines = vec![format!(
        "{:?}{} after {:.2} s, {:.2} m driven, {}, error {:.3} m, {}, {}, {}, {}",
        report.outcome,
        piece(report.reason.as_ref(), |reason| format!(" ({reason})")),
        report.time_s,
        report.length_m,
        least_clearance(report.min_clearance_m),
        report.final_error_m,
        counted(report.collisions, "collision"),
        counted(report.replans, "replan"),
        if report.recoveries == 1 {
            "1 recovery".to_owned()
        } else {
            format!("{} recoveries", report.recoveries)
        },
        energy(report.energy_j, report.energy_per_m)
    )];
    lines.push(format!(
        "the estimate is off by {:.3} m and {:.3} rad{}",
        report.pose_error_m,
        report.pose_error_rad,
        piece(report.cpu_s, |cpu| format!("; {cpu:.2} s of processor time"))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trajectory_that_cannot_be_written_is_refused_before_the_run() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        let (rows, record) = (path("none/driven.csv"), path("run.mcap"));
        let words = [
            "--world",
            "empty",
            "--goal",
            "3",
            "0",
            "--trajectory",
            &rows,
            "--record",
            &record,
        ];
        let refused = run(&crate::cli::parsed(&words).unwrap()).unwrap_err();
        assert!(refused.message.contains("driven.csv"), "{refused}");
        assert!(!std::path::Path::new(&record).exists());
    }

    #[test]
    fn bounds_are_told_to_the_millimetre() {
        let told = [9.200000000000003, -1e-7, -10.0].map(|metres| millimetres(metres).to_string());
        assert_eq!(told, ["9.2", "0", "-10"]);
    }

    #[test]
    fn a_run_that_is_refused_creates_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        let (rows, record, zones) = (path("driven.csv"), path("run.mcap"), path("zones.toml"));
        std::fs::write(&zones, "[[keep_out]]\nname = 3\n").unwrap();
        for wrong in [
            &["--robot", "no_such_robot"][..],
            &["--zones", &zones],
            &["--start", "99", "0", "0"],
        ] {
            let files = ["--trajectory", &rows, "--record", &record];
            let words = [&["--world", "empty", "--goal", "3", "0"][..], &files[..], wrong].concat();
            assert!(run(&crate::cli::parsed(&words).unwrap()).is_err(), "{wrong:?}");
            let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().collect();
            assert_eq!(left.len(), 1, "{wrong:?}: {left:?}");
        }
    }

    #[test]
    fn a_goal_outside_of_the_world_is_refused() {
        let world = World::shipped("empty").unwrap();
        let entrant = |x, y| Entrant {
            robot: None,
            start: None,
            goal: Point2::new(x, y),
        };
        assert!(check_goals(&world, &[entrant(3.0, -10.0)]).is_ok());
        let refused = check_goals(&world, &[entrant(3.0, 0.0), entrant(100.0, 0.5)]).unwrap_err();
        assert_eq!(
            refused.to_string(),
            "--goal 100 0.5 lies outside of the world: expected -10 to 10 by -10 to 10"
        );
    }
}
