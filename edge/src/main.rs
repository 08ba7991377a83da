//! The robot's own binary: one edge, no cloud.

mod deployment;

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use zenav_edge::config::TICK;
use zenav_edge::settings::BodySettings;
use zenav_edge::{AttachError, Attached, Body, EdgeConfig, RemoteBody, ServiceConfig, exit_code};
use zenav_observability::{logging, server, trace};
use zenav_protocol::bus::{
    Bus, BusConfig, BusError, DEFAULT_ENDPOINT, IdentityError, ROBOT_ENDPOINT, Security, Shutdown, interrupted,
    service_manager, threads,
};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::LostPolicy;
use zenav_protocol::robot::{OPTIONS, RobotError, RobotModel, SHIPPED};

use crate::deployment::RobotSection;

/// The robot's side of zenav.
#[derive(Debug, Parser)]
#[command(name = "zenav-edge", version)]
struct Arguments {
    /// The robot's model: the name of a shipped one, or a TOML file [default: that of the deployment file, or tiago].
    #[arg(long, alias = "robot")]
    model: Option<String>,
    /// The robot's name in every key.
    #[arg(long, default_value = "tiago")]
    id: String,
    /// Deployment file, of which `[security]` and `[robots.ID]` are read: of the latter model, listen, on_lost and edge. Flags win.
    #[arg(long, value_name = "FILE")]
    deployment: Option<PathBuf>,
    /// Routers to connect to, separated by commas; the edge also works without one.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = DEFAULT_ENDPOINT,
        env = "ZENAV_BUS__CONNECT",
        hide_env_values = true
    )]
    connect: Vec<String>,
    /// The edge's own endpoints: it can be stopped there without a router; port 0 picks a free one [default: that of the deployment file,
    /// or tcp/127.0.0.1:7450].
    #[arg(long, value_delimiter = ',')]
    listen: Vec<String>,
    /// Folder of the robot's identity in its fleet: `ca.pem`, `cert.pem`, `key.pem`, `members.txt`; links are encrypted then [default: that
    /// of the deployment file].
    #[arg(long, env = "ZENAV_IDENTITY")]
    identity: Option<PathBuf>,
    /// Listen to other machines without an identity, --metrics included: anyone who reaches the endpoint can command the robot.
    #[arg(long)]
    insecure: bool,
    /// Namespace of the deployment on its routers; none if empty.
    #[arg(long, default_value = "", env = "ZENAV_BUS__NAMESPACE", hide_env_values = true)]
    namespace: String,
    /// Folder of the stored epoch and stop latch.
    #[arg(long, default_value = "zenav-state")]
    state_dir: PathBuf,
    /// Start pose X,Y,YAW in metres and radians (default: the world's start).
    #[arg(long, value_parser = pose, allow_hyphen_values = true)]
    start: Option<Pose2>,
    /// Policy once the lease has expired: finish_horizon, stop, wall_follow or return_home [default: that of the deployment file, or
    /// finish_horizon].
    #[arg(long, value_parser = lost_policy)]
    on_lost: Option<LostPolicy>,
    /// Drive the robot of this name in a world served by `zenav sim serve`.
    #[arg(long)]
    attach: bool,
    /// What drives the motors: `bus`, a process that publishes readings and obeys wheel speeds.
    #[arg(long, conflicts_with = "attach")]
    body: Option<BodyKind>,
    /// Serve /livez, /readyz and /metrics here; port 0 picks a free one.
    #[arg(long, value_name = "ADDRESS:PORT", env = "ZENAV_METRICS", hide_env_values = true)]
    metrics: Option<String>,
    /// Write trace spans of messages between components into this file: OTLP in JSON, one per line.
    #[arg(long, value_name = "FILE", env = "ZENAV_TRACE", hide_env_values = true)]
    trace: Option<PathBuf>,
    /// Log lines as text or json.
    #[arg(
        long,
        value_name = "FORMAT",
        default_value = "text",
        env = "ZENAV_LOG_FORMAT",
        hide_env_values = true
    )]
    log_format: logging::Format,
    #[cfg(feature = "sim")]
    #[command(flatten)]
    simulation: SimulationArguments,
}

/// A simulated body.
#[cfg(feature = "sim")]
#[derive(Debug, clap::Args)]
struct SimulationArguments {
    /// Drive a simulated robot in this world: the name of a shipped one, or a TOML file.
    #[arg(long, conflicts_with_all = ["attach", "body"])]
    world: Option<String>,
    /// Rate of simulated time against wall time.
    #[arg(long, default_value_t = 1.0)]
    speed: f64,
    /// Seed of the simulation's noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Where the body is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum BodyKind {
    /// On the bus: `zenav/{robot}/body/readings` in, `zenav/{robot}/edge/wheels` out.
    Bus,
}

fn lost_policy(text: &str) -> Result<LostPolicy, String> {
    serde_json::from_value(text.into()).map_err(|error| error.to_string())
}

fn pose(text: &str) -> Result<Pose2, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    match numbers.as_deref() {
        Ok([x, y, yaw]) if [x, y, yaw].iter().all(|value| value.is_finite()) => Ok(Pose2::new(*x, *y, *yaw)),
        _ => Err("expected X,Y,YAW".to_owned()),
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    logging::init(arguments.log_format, "info,zenoh=warn", std::io::stderr);
    threads::ensure_enough();
    match start(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            let _ = writeln!(std::io::stderr(), "error: {}", failure.reason);
            ExitCode::from(failure.code)
        }
    }
}

/// What went wrong, as plain text, and the exit code for it. Plain text keeps the robot's binary small.
struct Failure {
    code: u8,
    reason: String,
}

impl Failure {
    fn new(code: u8, error: impl std::fmt::Display) -> Self {
        Self {
            code,
            reason: error.to_string(),
        }
    }

    fn usage(error: impl std::fmt::Display) -> Self {
        Self::new(exit_code::USAGE, error)
    }
}

impl From<BusError> for Failure {
    fn from(error: BusError) -> Self {
        Self::new(exit_code::of_bus(&error), error)
    }
}

impl From<IdentityError> for Failure {
    fn from(error: IdentityError) -> Self {
        Self::usage(error)
    }
}

impl From<AttachError> for Failure {
    fn from(error: AttachError) -> Self {
        Self::new(exit_code::of_attach(&error), error)
    }
}

/// Neither the name of a shipped item nor a file that can be read.
fn unknown(what: &str, name: &str, why: impl std::fmt::Display, shipped: &[&[(&str, &str)]]) -> Failure {
    let names: Vec<_> = shipped.iter().copied().flatten().map(|(name, _)| *name).collect();
    let reason = format!("{what} `{name}`: {why}; shipped ones are {}", names.join(", "));
    Failure::new(exit_code::NOT_FOUND, reason)
}

/// The robot's model, by a shipped name or a file, with its options. Relative paths begin at `folder`.
fn model(names: &str, folder: &Path) -> Result<RobotModel, Failure> {
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).map_err(|error| error.to_string());
    RobotModel::with_options(names, read).map_err(|error| match error {
        RobotError::Unknown { name, reason } => unknown("robot", &name, reason, &[SHIPPED, OPTIONS]),
        error => Failure::usage(error),
    })
}

/// The robot's section of the deployment file, if there is one, and its model.
fn section(arguments: &Arguments) -> Result<(RobotSection, RobotModel), Failure> {
    let section = match &arguments.deployment {
        Some(path) => {
            let text = std::fs::read_to_string(path)
                .map_err(|error| Failure::new(exit_code::NOT_FOUND, format!("{}: {error}", path.display())))?;
            RobotSection::of(path, &text, &arguments.id).map_err(Failure::usage)?
        }
        None => RobotSection::default(),
    };
    let model = match (&arguments.model, &section.model, &arguments.deployment) {
        (Some(names), ..) => model(names, Path::new("")),
        // Beside the deployment file.
        (None, Some(names), Some(file)) => model(names, file.parent().unwrap_or(Path::new(""))),
        _ => model("tiago", Path::new("")),
    }?;
    if let (Some(path), Err(error)) = (&arguments.deployment, section.edge.check_for(&model, TICK)) {
        let error = error.within("edge").within(&arguments.id).within("robots");
        return Err(Failure::usage(format!("{}: {error}", path.display())));
    }
    Ok((section, model))
}

/// Runs the edge until it is interrupted, or until a member of the fleet was revoked: its process then starts anew.
fn start(arguments: Arguments) -> Result<(), Failure> {
    let (section, model) = section(&arguments)?;
    let id = Id::robot(arguments.id.clone()).map_err(Failure::usage)?;
    let security = section
        .security
        .security(arguments.identity.as_deref(), arguments.insecure)?;
    if let Some(address) = &arguments.metrics {
        security.check_metrics(address)?;
    }
    let is_remote = arguments.attach || arguments.body.is_some();
    security.check_robot(&id, !is_remote)?;
    // Bad files are reported before waiting for a router.
    let here = match is_remote {
        true => None,
        false => Some(simulated(&arguments, &model, &id)?),
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|error| Failure::new(exit_code::FAILED, error))?;
    let is_outdated = runtime.block_on(async {
        serve_health(&arguments).await?;
        run(arguments, section, security, (id, model), here).await
    })?;
    if is_outdated {
        let error = threads::restart();
        return Err(Failure::new(exit_code::FAILED, format!("cannot start anew: {error}")));
    }
    Ok(())
}

/// Begins to serve health and metrics, and to write spans, as far as that was asked for.
async fn serve_health(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(address) = &arguments.metrics {
        let served = server::serve(address)
            .await
            .map_err(|error| Failure::new(exit_code::CANNOT_CONNECT, format!("--metrics {address}: {error}")))?;
        tracing::info!("health: http://{served}/readyz, http://{served}/metrics");
    }
    if let Some(file) = &arguments.trace {
        let wrong =
            |error: std::io::Error| Failure::new(exit_code::FAILED, format!("--trace {}: {error}", file.display()));
        trace::start(file).map_err(wrong)?;
    }
    Ok(())
}

/// Runs the robot with a body that is `here`, or else on the bus. Returns whether a member of the fleet was revoked meanwhile.
async fn run(
    arguments: Arguments,
    section: RobotSection,
    security: Security,
    (id, model): (Id, RobotModel),
    here: Option<Started>,
) -> Result<bool, Failure> {
    let mut listen = arguments.listen;
    if listen.is_empty() {
        listen.push(section.listen.unwrap_or_else(|| ROBOT_ENDPOINT.to_owned()));
    }
    let bus = BusConfig {
        connect: arguments.connect,
        listen,
        name: format!("edge-{}", arguments.id),
        retry: true,
        security: security.clone(),
        namespace: arguments.namespace,
        is_narrow: true,
    };
    let gives_the_time = here.is_some();
    let (bus, started) = match here {
        Some(here) => (Bus::open(bus).await?, here),
        None if arguments.body == Some(BodyKind::Bus) => {
            on_the_bus(bus, &id, arguments.start, &section.edge.body).await?
        }
        None => attached(&bus, &id, &model, arguments.start, &section.edge.body).await?,
    };
    tracing::info!(endpoints = ?bus.endpoints().await, "listening");
    service_manager::ready();
    let Started {
        body,
        start,
        tick,
        speed,
    } = started;
    let mut edge = EdgeConfig::new(id, model, start);
    edge.tick = tick.unwrap_or(edge.tick);
    edge.on_lost = arguments.on_lost.or(section.on_lost).unwrap_or_default();
    edge.settings = section.edge;
    let config = ServiceConfig {
        edge,
        state_dir: arguments.state_dir,
        speed,
        gives_the_time,
    };
    let shutdown = Shutdown::on_interrupt();
    let interrupt = tokio::spawn(interrupted());
    let ender = shutdown.clone();
    let revoked = tokio::spawn(async move {
        security.revoked().await;
        tracing::info!("a member of the fleet was revoked: the robot comes to rest, and its process starts anew");
        ender.trigger();
    });
    let result = zenav_edge::run(bus.clone(), config, body, shutdown).await;
    bus.close().await;
    result.map_err(|error| Failure::new(exit_code::FAILED, error))?;
    // An interrupt while the robot came to rest still ends the process.
    Ok(revoked.is_finished() && !interrupt.is_finished())
}

/// A body and its start conditions.
struct Started {
    body: Box<dyn Body>,
    start: Pose2,
    /// Time between its readings, if not the default, s.
    tick: Option<f64>,
    speed: f64,
}

/// A body in a process of the user's own. It is silent until its first readings.
async fn on_the_bus(
    bus: BusConfig,
    robot: &Id,
    start: Option<Pose2>,
    settings: &BodySettings,
) -> Result<(Bus, Started), Failure> {
    let bus = Bus::open(bus).await?;
    let body = RemoteBody::new(&bus, robot.as_str(), u64::from(std::process::id()), settings)?;
    let started = Started {
        body: Box::new(body),
        start: start.unwrap_or_default(),
        tick: None,
        speed: 1.0,
    };
    Ok((bus, started))
}

async fn attached(
    bus: &BusConfig,
    robot: &Id,
    model: &RobotModel,
    start: Option<Pose2>,
    settings: &BodySettings,
) -> Result<(Bus, Started), Failure> {
    let Attached { bus, body, reply } = RemoteBody::attach(bus, robot, model, start, settings).await?;
    tracing::info!(world = reply.world, "attached");
    let started = Started {
        body: Box::new(body),
        start: reply.start,
        tick: Some(reply.tick_secs),
        speed: reply.speed,
    };
    Ok((bus, started))
}

#[cfg(feature = "sim")]
fn simulated(arguments: &Arguments, model: &RobotModel, id: &Id) -> Result<Started, Failure> {
    use zenav_sim::{RobotSpec, Simulation, World, world};
    let simulation = &arguments.simulation;
    let Some(name) = &simulation.world else {
        let reason = "no driver for a real body is built in: name a simulated `--world`, `--attach` to one that is served, or `--body bus` for a process of your own";
        return Err(Failure::usage(reason));
    };
    let world = if world::shipped(name).is_some() {
        World::shipped(name)
    } else {
        let no_images = |_: &str| Err("this binary reads no map images; use `zenav edge`".to_owned());
        let text = std::fs::read_to_string(name);
        let text = text.map_err(|error| unknown("world", name, error, &[world::SHIPPED]))?;
        World::from_toml(&text, name, &no_images)
    };
    let world = world.map_err(Failure::usage)?;
    let start = arguments.start.unwrap_or_else(|| world.start());
    let spec = RobotSpec {
        id: id.clone(),
        model: model.clone(),
        start,
    };
    let simulated = Simulation::new(&world, vec![spec], simulation.seed).map_err(Failure::usage)?;
    let (body, _) = zenav_edge::SimBody::all(simulated).remove(0);
    Ok(Started {
        body: Box::new(body),
        start,
        tick: None,
        speed: simulation.speed,
    })
}

#[cfg(not(feature = "sim"))]
fn simulated(_: &Arguments, _: &RobotModel, _: &Id) -> Result<Started, Failure> {
    let reason = "no driver for a real body is built in, and this binary was built without the feature `sim`: `--attach` to a served world, or `--body bus` for a process of your own";
    Err(Failure::usage(reason))
}
