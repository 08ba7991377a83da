//! The simulator's commands. Measures rays per second and the real-time factor, draws worlds, and serves one.

use std::time::Duration;

use zenav_sim::{capacity, made_worlds};

use super::show::{self, ShowArgs};
use super::thread_time;
use crate::arguments::{self, positive};
use crate::completion;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{self, Format};
use crate::world_server::{self, ServeArgs};

/// Most robots in one world.
const MAX_ROBOTS: usize = zenav_sim::simulation::MAX_ROBOTS;

/// The simulator.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav sim show house --out house.png\n  zenav sim bench --robots 10\n  zenav sim serve --world house    for `zenav edge --attach`"
)]
pub struct SimArgs {
    #[command(subcommand)]
    command: SimCommand,
}

#[derive(Debug, clap::Subcommand)]
enum SimCommand {
    /// Measure rays per second and the real-time factor
    Bench(SimBenchArgs),
    /// Draw a world with its robots, movers and doors as a PNG
    Show(ShowArgs),
    /// Serve one world for robots on several machines
    Serve(ServeArgs),
}

#[derive(Debug, clap::Args)]
struct SimBenchArgs {
    /// World: a file or shipped name [default: a floor with space for all robots, and obstacles]
    #[arg(long, value_name = "W", add = completion::worlds())]
    world: Option<String>,
    /// Robot: a file or shipped name
    #[arg(long, value_name = "R", default_value = "tiago", add = completion::models())]
    robot: String,
    /// Robots in the world, as many as fit
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = arguments::whole::<usize>)]
    robots: usize,
    /// Beams of each lidar [default: the robot's own]
    #[arg(long, value_name = "B", value_parser = arguments::whole::<usize>)]
    beams: Option<usize>,
    /// Scans per second of each lidar
    #[arg(long, value_name = "HZ", default_value_t = 10.0, value_parser = positive)]
    rate: f64,
    /// Simulated time, s
    #[arg(long, value_name = "SECS", default_value_t = 10.0, value_parser = positive)]
    time: f64,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Runs a command of the simulator.
///
/// # Errors
/// [`crate::exit_code::USAGE`] for an invalid world, robot or number; a taken port.
pub fn sim(args: &SimArgs) -> Outcome {
    match &args.command {
        SimCommand::Bench(args) => bench_simulator(args),
        SimCommand::Show(args) => show::show(args),
        SimCommand::Serve(args) => world_server::serve(args),
    }
}

fn bench_simulator(args: &SimBenchArgs) -> Outcome {
    let mut model = files::robot(&args.robot)?;
    for (_, lidar) in model.all_lidars_mut() {
        lidar.beams = args.beams.unwrap_or(lidar.beams);
        lidar.rate_hz = args.rate;
    }
    let model = model.checked("--beams, --rate").map_err(Failure::usage)?;
    if !(1..=MAX_ROBOTS).contains(&args.robots) {
        return Err(Failure::usage(format!(
            "--robots {}: expected 1 to {MAX_ROBOTS}",
            args.robots
        )));
    }
    let world = match &args.world {
        Some(name) => files::world(name)?,
        None => made_worlds::floor(&model, args.robots).map_err(Failure::failed)?,
    };
    let time = Duration::try_from_secs_f64(args.time)
        .map_err(|error| Failure::usage(format!("--time {}: {error}", args.time)))?;
    let report = capacity::run(&world, &model, args.robots, time, &thread_time).map_err(Failure::failed)?;
    if report.robots < args.robots {
        tracing::warn!(
            "there is room for {} of {} robots in {}",
            report.robots,
            args.robots,
            world.name()
        );
    }
    output::value(args.output, &report, |report| {
        format!(
            "{} robots with {} beams at {} Hz: {:.1} M rays/s, {:.1} times real time over {} steps; one alone {:.0} times",
            report.robots,
            report.beams,
            report.rate_hz,
            report.rays_per_s / 1e6,
            report.real_time_factor,
            report.steps,
            report.single_real_time_factor
        )
    })
}
