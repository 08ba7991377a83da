//! The thin binary for the robot: one edge, nothing of the cloud.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use miette::{IntoDiagnostic, WrapErr, miette};
use zenav_edge::{Body, EdgeConfig, ServiceConfig};
use zenav_protocol::bus::{Bus, BusConfig, Shutdown};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::robot::{RobotModel, shipped};

/// The robot's side of zenav.
#[derive(Debug, Parser)]
#[command(name = "zenav-edge", version)]
struct Arguments {
    /// The robot: the name of a shipped one, or a TOML file.
    #[arg(long, default_value = "tiago")]
    robot: String,
    /// The robot's name in every key.
    #[arg(long, default_value = "tiago")]
    id: String,
    /// Routers to connect to; the edge also works without one.
    #[arg(long, default_value = "tcp/127.0.0.1:7447")]
    connect: Vec<String>,
    /// The edge's own endpoint: an operator reaches it with no router.
    #[arg(long, default_value = "tcp/127.0.0.1:0")]
    listen: Vec<String>,
    /// Folder of the stored epoch and stop latch.
    #[arg(long, default_value = "zenav-state")]
    state_dir: PathBuf,
    /// Where the robot stands: X,Y,YAW in metres and radians (default: the world's start).
    #[arg(long, value_parser = pose, allow_hyphen_values = true)]
    start: Option<Pose2>,
    #[cfg(feature = "sim")]
    #[command(flatten)]
    simulation: SimulationArguments,
}

/// A simulated body.
#[cfg(feature = "sim")]
#[derive(Debug, clap::Args)]
struct SimulationArguments {
    /// Drive a simulated robot in this world: a shipped one's name, or a TOML file.
    #[arg(long)]
    world: Option<String>,
    /// Simulated time against wall time.
    #[arg(long, default_value_t = 1.0)]
    speed: f64,
    /// Seed of the simulation's noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn pose(text: &str) -> Result<Pose2, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    match numbers.as_deref() {
        Ok([x, y, yaw]) if [x, y, yaw].iter().all(|value| value.is_finite()) => Ok(Pose2::new(*x, *y, *yaw)),
        _ => Err("expected X,Y,YAW".to_owned()),
    }
}

fn main() -> ExitCode {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "info,zenoh=warn".into());
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_env_filter(filter)
        .init();
    match start(Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(report) => {
            tracing::error!("{report:?}");
            ExitCode::FAILURE
        }
    }
}

fn start(arguments: Arguments) -> miette::Result<()> {
    let model = match shipped(&arguments.robot) {
        Some(text) => RobotModel::from_toml(text, &arguments.robot),
        None => {
            let text = std::fs::read_to_string(&arguments.robot)
                .into_diagnostic()
                .wrap_err_with(|| arguments.robot.clone())?;
            RobotModel::from_toml(&text, &arguments.robot)
        }
    };
    let (model, id) = (
        model.into_diagnostic()?,
        Id::robot(arguments.id.clone()).into_diagnostic()?,
    );
    let (body, start, speed, simulated) = body(&arguments, &model, &id)?;
    let config = ServiceConfig {
        edge: EdgeConfig::new(id, model, start),
        state_dir: arguments.state_dir,
        speed,
        simulated,
    };
    let bus = BusConfig {
        connect: arguments.connect,
        listen: arguments.listen,
        name: format!("edge-{}", arguments.id),
        retry: true,
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .into_diagnostic()?;
    runtime.block_on(async {
        let bus = Bus::open(bus).await.into_diagnostic()?;
        tracing::info!(endpoints = ?bus.endpoints().await, "listening");
        let shutdown = Shutdown::new();
        tokio::spawn({
            let shutdown = shutdown.clone();
            async move {
                interrupted().await;
                shutdown.trigger();
            }
        });
        let result = zenav_edge::run(bus.clone(), config, body, shutdown).await;
        bus.close().await;
        result.into_diagnostic()
    })
}

/// Waits for Ctrl-C, or the service manager's request to end.
async fn interrupted() {
    #[cfg(unix)]
    if let Ok(mut terminate) = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
        tokio::select! {
            _ = tokio::signal::ctrl_c() => return,
            _ = terminate.recv() => return,
        }
    }
    let _ = tokio::signal::ctrl_c().await;
}

/// The body, where it stands, its speed against wall time, and whether it is simulated.
type Started = (Box<dyn Body>, Pose2, f64, bool);

#[cfg(feature = "sim")]
fn body(arguments: &Arguments, model: &RobotModel, id: &Id) -> miette::Result<Started> {
    use zenav_sim::{RobotSpec, Simulation, World, world};
    let simulation = &arguments.simulation;
    let Some(name) = &simulation.world else {
        return Err(miette!(
            "no driver for a real body is built in: name a simulated `--world`"
        ));
    };
    let world = if world::shipped(name).is_some() {
        World::shipped(name)
    } else {
        let text = std::fs::read_to_string(name)
            .into_diagnostic()
            .wrap_err_with(|| name.clone())?;
        World::from_toml(&text, name, &|_| {
            Err("this binary reads no map images; use `zenav edge`".to_owned())
        })
    };
    let world = world.into_diagnostic()?;
    let start = arguments.start.unwrap_or_else(|| world.start());
    let spec = RobotSpec {
        id: id.clone(),
        model: model.clone(),
        start,
    };
    let simulated = Simulation::new(&world, vec![spec], simulation.seed).into_diagnostic()?;
    let (body, _) = zenav_edge::SimBody::new(simulated, 0).into_diagnostic()?;
    Ok((Box::new(body), start, simulation.speed, true))
}

#[cfg(not(feature = "sim"))]
fn body(_: &Arguments, _: &RobotModel, _: &Id) -> miette::Result<Started> {
    Err(miette!(
        "no driver for a real body is built in, and this binary was built without the feature `sim`"
    ))
}
