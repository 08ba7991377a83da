//! Launcher. What `zenav up`, `router`, `edge` and `cloud` run: the parts of a deployment, all in one process or each in its own.

use std::path::PathBuf;
use std::time::Instant;

use clap::{Args, ValueEnum};
use tokio::task::JoinHandle;
use zenav_protocol::bus::{Bus, BusConfig, Router, RouterConfig, SETTLING, interrupted, service_manager, threads};
use zenav_protocol::member::Role;
use zenav_sim::World;

use crate::arguments::{self, finite};
use crate::completion;
use crate::components::{CloudPart, Parts};
use crate::config::{Deployment, Layers, RobotSection, SecurityArgs};
use crate::connect::{DEFAULT_ENDPOINT, ROBOT_ENDPOINT};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::farewell::Farewell;
use crate::files;
use crate::gateway::{self, PageArgs};
use crate::greeting::Greeting;
use crate::health::HealthArgs;
use crate::inspect::serve_schemas;
use crate::output::listed;
use crate::record::{self, LiveView};
use crate::rest;
use crate::tasks;

/// Known map that mapping starts with.
#[derive(Debug, Default, Args)]
pub(crate) struct KnownMapArgs {
    /// Known map to start with, instead of the stored one: a `map_server` YAML file or an image; scans do not change it
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Keep mapping into the map of --map, instead of leaving it unchanged
    #[arg(long, requires = "map")]
    live: bool,
}

impl KnownMapArgs {
    /// Applies the arguments to a deployment.
    pub(crate) fn apply(&self, deployment: &mut Deployment) {
        if let Some(map) = &self.map {
            deployment.mapping.run.map = Some(map.clone());
            deployment.mapping.run.live = self.live;
        }
    }

    /// Checks that the files of services exist, before anything starts that would only have to stop again. The deployment's map is skipped
    /// if another was named.
    fn check_files(&self, layers: &Layers, which: CloudPart) -> Result<(), Failure> {
        let is_mapped = matches!(which, CloudPart::All | CloudPart::Mapping) && layers.deployment.mapping.run.enabled;
        if is_mapped && !self.names_map() {
            layers.check_file("mapping.map")?;
        }
        layers.check_file("zones.file")
    }

    /// Whether a map was named.
    pub(crate) fn names_map(&self) -> bool {
        self.map.is_some()
    }
}

/// Start pose of a robot.
#[derive(Debug, Default, Args)]
pub(crate) struct PoseArgs {
    /// Initial pose of the robot on the map, m and rad
    #[arg(long, num_args = 3, value_names = ["X", "Y", "YAW"], value_parser = finite)]
    pose: Option<Vec<f64>>,
}

impl PoseArgs {
    /// Applies the pose to a deployment of one robot.
    ///
    /// # Errors
    /// Several robots, or a heading that is probably not in radians.
    pub(crate) fn apply(&self, deployment: &mut Deployment) -> Result<(), Failure> {
        let Some(pose) = self.pose.as_deref() else {
            return Ok(());
        };
        let pose = arguments::pose("--pose", pose)?;
        let count = deployment.robots.len();
        match deployment.robots.values_mut().next() {
            Some(robot) if count == 1 => {
                robot.start = Some(pose);
                Ok(())
            }
            _ => Err(Failure::usage(format!(
                "--pose: the deployment has {count} robots: expected one, or a `start` in each [robots.NAME]"
            ))),
        }
    }
}

/// Arguments of `zenav up`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav up\n  zenav up --world house --speed 4\n  zenav up --model jackal\n  zenav up --map kitchen.yaml --pose -1 -0.5 0\n  zenav up two_robots.toml --listen tcp/127.0.0.1:0\n\nWith ZENAV_SECTION__KEY any value of the deployment can be set; `zenav config show --origin` prints all."
)]
pub struct UpArgs {
    /// Deployment file; without it, one simulated robot and every service on this machine
    file: Option<PathBuf>,
    /// Endpoints of the router, instead of the deployment's
    #[arg(long, value_parser = arguments::endpoint)]
    listen: Vec<String>,
    #[command(flatten)]
    outside: OutsideArgs,
    /// World, instead of the deployment's
    #[arg(long, add = completion::worlds())]
    world: Option<String>,
    /// Robot file or shipped name, instead of the deployment's
    #[arg(long, add = completion::models())]
    model: Option<String>,
    /// Simulated time relative to wall time, instead of the deployment's
    #[arg(long, value_parser = arguments::speed)]
    speed: Option<f64>,
    /// Data folder, instead of the deployment's
    #[arg(long)]
    data: Option<PathBuf>,
    #[command(flatten)]
    known: KnownMapArgs,
    #[command(flatten)]
    begin: PoseArgs,
    #[command(flatten)]
    page: PageArgs,
    /// Serve live bus traffic to Foxglove, at a loopback address
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = record::FOXGLOVE_LISTEN, value_parser = arguments::address)]
    foxglove: Option<String>,
    /// Accept poses that Foxglove publishes on `/goal` as goals
    #[arg(long, requires = "foxglove")]
    goals: bool,
    #[command(flatten)]
    security: SecurityArgs,
    #[command(flatten)]
    health: HealthArgs,
}

/// Arguments of `zenav router`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  zenav router\n  zenav router --listen tcp/127.0.0.1:7460 --rest")]
pub struct RouterArgs {
    /// Endpoints to listen on
    #[arg(long, default_value = DEFAULT_ENDPOINT, value_parser = arguments::endpoint)]
    listen: Vec<String>,
    /// Other routers to link to
    #[arg(long, value_parser = arguments::endpoint)]
    connect: Vec<String>,
    #[command(flatten)]
    outside: OutsideArgs,
    #[command(flatten)]
    security: SecurityArgs,
    #[command(flatten)]
    health: HealthArgs,
}

/// The router for programs that are not zenav.
#[derive(Debug, Args)]
struct OutsideArgs {
    /// Answer `GET /KEY` with a key's value, at a loopback address
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = rest::DEFAULT_LISTEN, value_parser = arguments::address)]
    rest: Option<String>,
    /// Answer Zenoh's multicast scouting: its tools on this network find the router without its endpoint
    #[arg(long)]
    scouting: bool,
}

/// Arguments shared by `zenav edge` and `zenav cloud`.
#[derive(Debug, Args)]
struct PartArgs {
    /// Deployment file; without it, the shipped one
    #[arg(long, value_name = "FILE")]
    deployment: Option<PathBuf>,
    /// Router endpoint, instead of the deployment's, or several separated by commas, of which one must be reachable
    #[arg(long, value_parser = arguments::endpoints)]
    connect: Option<String>,
    /// Data folder, instead of the deployment's
    #[arg(long)]
    data: Option<PathBuf>,
    /// World, instead of the deployment's: its places are named goals, and a simulated robot drives in it
    #[arg(long, add = completion::worlds())]
    world: Option<String>,
    /// Run only this robot of the deployment
    #[arg(long)]
    robot: Option<String>,
    #[command(flatten)]
    health: HealthArgs,
}

/// A body that is not simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum BodyKind {
    /// On the bus: a process that publishes `body/readings` and obeys `edge/wheels`
    Bus,
}

/// Arguments of `zenav edge`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav edge\n  zenav edge --deployment site.toml --robot anna\n  zenav edge --connect tcp/127.0.0.1:7460 --pose -1 -0.5 0\n  zenav edge --body bus --model neato    with a body like edge/examples/body.py"
)]
pub struct EdgeArgs {
    #[command(flatten)]
    part: PartArgs,
    /// Robot file or shipped name, instead of the deployment's
    #[arg(long, add = completion::models())]
    model: Option<String>,
    /// The robot's own endpoint, instead of the deployment's
    #[arg(long, value_parser = arguments::endpoint)]
    listen: Option<String>,
    /// Attach to robots of the world that `zenav sim serve` serves
    #[arg(long)]
    attach: bool,
    /// Endpoint of that world, if it is not the router's
    #[arg(long, value_name = "ENDPOINT")]
    attach_to: Option<String>,
    /// Where the robot's body is, if it is not simulated here
    #[arg(long, value_enum, conflicts_with_all = ["attach", "attach_to"])]
    body: Option<BodyKind>,
    /// Simulated time relative to wall time, instead of the deployment's
    #[arg(long, value_parser = arguments::speed)]
    speed: Option<f64>,
    /// Seed of the simulated noise, instead of the deployment's
    #[arg(long, value_parser = arguments::whole::<u64>)]
    seed: Option<u64>,
    #[command(flatten)]
    begin: PoseArgs,
    #[command(flatten)]
    security: SecurityArgs,
}

/// Arguments of `zenav cloud`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav cloud\n  zenav cloud mission --holder bert --data bert    a second orchestrator, which takes over from the first\n  zenav cloud mapping --map kitchen.yaml --live"
)]
pub struct CloudArgs {
    /// Service to run
    #[arg(value_enum, default_value = "all")]
    service: CloudPart,
    #[command(flatten)]
    part: PartArgs,
    /// Name of the orchestrator, instead of the deployment's; every orchestrator needs its own
    #[arg(long, value_parser = arguments::name)]
    holder: Option<String>,
    /// Name prefix of this process's workers
    #[arg(long)]
    worker: Option<String>,
    #[command(flatten)]
    known: KnownMapArgs,
    #[command(flatten)]
    security: SecurityArgs,
}

/// Runtime for services and commands.
///
/// # Errors
/// When the system gives no threads.
pub fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    Ok(tokio::runtime::Builder::new_multi_thread().enable_all().build()?)
}

/// Why a process has ended its parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    /// It was asked to end, or they had nothing more to do.
    Done,
    /// The fleet has changed: they still admit a member that was revoked.
    Outdated,
    /// They were suspended, and let nobody in for a while.
    Suspended,
    /// They no longer know what others subscribe to.
    Deaf,
}

impl Ended {
    /// The same, unless an interrupt has come by now: it ends the process, even while its parts end for another reason.
    fn unless_interrupted(self, interrupt: &JoinHandle<()>) -> Self {
        if interrupt.is_finished() { Self::Done } else { self }
    }

    /// Ends the process, or starts it anew with the same arguments.
    pub(crate) fn outcome(self) -> Outcome {
        let why = match self {
            Self::Done => return Ok(exit_code::OK),
            Self::Outdated => "the fleet's members or the certificate have changed",
            Self::Suspended => "it was suspended, and handshakes that were given up meanwhile keep others out",
            Self::Deaf => "Zenoh dropped what another router declared, and messages for its parts would not reach them",
        };
        tracing::info!("the process starts anew: {why}");
        Err(Failure::failed(format!("cannot start anew: {}", threads::restart())))
    }
}

/// Runs parts until Ctrl-C, until one fails, or until a member of the fleet was revoked.
pub(crate) async fn until_interrupted(mut parts: Parts) -> Result<Ended, Failure> {
    let begun = parts.all_begun();
    let security = parts.security().clone();
    tasks::spawn(async move {
        begun.await;
        service_manager::ready();
    });
    let mut interrupt = tasks::spawn(interrupted());
    let result = tokio::select! {
        _ = &mut interrupt => {
            tracing::info!("stopping");
            Ok(Ended::Done)
        }
        () = security.revoked() => Ok(Ended::Outdated),
        ended = parts.first_end() => ended.map(|()| Ended::Done),
    };
    parts.end().await;
    result.map(|ended| ended.unless_interrupted(&interrupt))
}

/// Replaces a value of a deployment by that of an option, if it was given.
pub(crate) fn overrule<T: Clone>(value: &mut T, option: Option<&T>) {
    if let Some(option) = option {
        value.clone_from(option);
    }
}

impl PartArgs {
    /// Applies the arguments to a deployment.
    fn over(&self, mut deployment: Deployment) -> Result<Deployment, Failure> {
        overrule(&mut deployment.bus.connect, self.connect.as_ref());
        overrule(&mut deployment.data.dir, self.data.as_ref());
        overrule(&mut deployment.simulation.world, self.world.as_ref());
        if let Some(robot) = &self.robot {
            let known = listed(deployment.robots.keys());
            deployment.robots.retain(|id, _| id == robot);
            if deployment.robots.is_empty() {
                let missing = format!("no robot `{robot}` in the deployment; it has {known}");
                return Err(Failure::not_found(missing));
            }
        }
        Ok(deployment)
    }
}

/// `zenav up`.
///
/// # Errors
/// Bad files, a taken port, a part that failed.
pub fn up(args: &UpArgs) -> Outcome {
    let layers = Layers::load(args.file.as_deref())?;
    args.known.check_files(&layers, CloudPart::All)?;
    let mut deployment = layers.deployment.clone();
    replace_models(&layers, &mut deployment, args.model.as_deref())?;
    let world = layers.world(args.world.as_deref())?;
    if !args.listen.is_empty() {
        deployment.router.listen = args.listen.iter().map(|endpoint| with_free_port(endpoint)).collect();
        deployment.bus.connect.clone_from(&deployment.router.listen[0]);
    }
    overrule(&mut deployment.simulation.world, args.world.as_ref());
    overrule(&mut deployment.simulation.speed, args.speed.as_ref());
    overrule(&mut deployment.data.dir, args.data.as_ref());
    args.known.apply(&mut deployment);
    args.begin.apply(&mut deployment)?;
    args.page.apply(&mut deployment);
    if args.page.names_address() || layers.sets("gateway.listen") {
        gateway::check_named(&deployment)?;
    }
    let outside = &args.outside;
    let asked = [("--scouting", outside.scouting), ("--rest", outside.rest.is_some())];
    if !deployment.router.enabled
        && let Some((option, _)) = asked.into_iter().find(|(_, is_asked)| *is_asked)
    {
        return Err(Failure::usage(format!(
            "{option}: the deployment starts no router that could answer (router.enabled = false): expected it at `zenav router`"
        )));
    }
    // Checked before anything starts that would only have to stop again.
    let data = &deployment.data.dir;
    std::fs::create_dir_all(data).map_err(Failure::failed_at(data))?;
    let security = args.security.security_of(&deployment)?;
    if deployment.router.enabled {
        security.check_role("a deployment with its router in one process", &[Role::Router])?;
    }
    free_robot_endpoint(&mut deployment);
    let ended = tasks::block_on(&runtime()?, async {
        args.health.serve(&security).await?;
        let router = if deployment.router.enabled {
            let rest = args.outside.rest.as_ref().unwrap_or(&deployment.router.rest);
            let config = RouterConfig {
                listen: deployment.router.listen.clone(),
                connect: deployment.router.connect.clone(),
                scouting: args.outside.scouting || deployment.router.scouting,
                security: security.clone(),
                ..RouterConfig::default()
            };
            Some(open_router(&config, rest).await?)
        } else {
            None
        };
        let mut parts = Parts::new(security);
        if let Some(listen) = args.foxglove.clone() {
            let (bus, goals) = (parts.bus(&deployment, "foxglove"), args.goals);
            parts.spawn("foxglove".to_owned(), bus, move |bus, shutdown| async move {
                let view = LiveView::start(&bus, None, &listen, goals).await?;
                tracing::info!("Foxglove: {}", view.address());
                bus.started();
                shutdown.wait().await;
                Ok(())
            });
        }
        let started = start_all(&mut parts, &deployment, &world).await;
        let result = match started {
            Ok(greeted) => {
                let ended = until_interrupted(parts).await;
                farewell(greeted).await;
                ended
            }
            Err(failure) => {
                parts.end().await;
                Err(failure)
            }
        };
        if let Some(router) = router {
            router.close().await;
        }
        result
    })?;
    ended.outcome()
}

/// Replaces the model of every robot, if another one is named, and checks the models before anything starts.
///
/// # Errors
/// No robot file or shipped robot of this name, or one that is wrong; as [`Layers::check_models`].
fn replace_models(layers: &Layers, deployment: &mut Deployment, model: Option<&str>) -> Result<(), Failure> {
    if let Some(model) = model {
        files::robot(model)?;
        for robot in deployment.robots.values_mut() {
            model.clone_into(&mut robot.model);
        }
    }
    layers.check_models(deployment)
}

/// The endpoint with port 0 replaced by a port that is free now: all parts have to know it.
fn with_free_port(endpoint: &str) -> String {
    let free = |address: &str| std::net::TcpListener::bind(address)?.local_addr();
    match endpoint.strip_suffix(":0").zip(endpoint.split_once('/')) {
        Some((stem, (_, address))) => {
            free(address).map_or_else(|_| endpoint.to_owned(), |bound| format!("{stem}:{}", bound.port()))
        }
        None => endpoint.to_owned(),
    }
}

/// Allows two deployments on one machine: if the default robot endpoint is taken, the robot takes a free port.
fn free_robot_endpoint(deployment: &mut Deployment) {
    let Some(address) = ROBOT_ENDPOINT.strip_prefix("tcp/") else {
        return;
    };
    for (id, robot) in &mut deployment.robots {
        let is_taken = || {
            let bound = std::net::TcpListener::bind(address);
            bound.is_err_and(|error| error.kind() == std::io::ErrorKind::AddrInUse)
        };
        if robot.listen == ROBOT_ENDPOINT && is_taken() {
            tracing::info!(
                robot = id,
                "{address} is in use: the robot's own endpoint takes a free port"
            );
            robot.listen = RobotSection::default().listen;
        }
    }
}

/// Starts all parts. The task greets once they are ready, and follows what their end would lose.
async fn start_all(
    parts: &mut Parts,
    deployment: &Deployment,
    world: &World,
) -> Result<JoinHandle<Option<Farewell>>, Failure> {
    let start = Instant::now();
    parts.edges(deployment, world, None)?;
    parts.cloud(deployment, world, CloudPart::All, "worker")?;
    let page = parts.gateway(deployment, world).await?;
    let (begun, greeting) = (parts.all_begun(), Greeting::new(deployment, world, page));
    let bus = BusConfig {
        retry: false,
        ..parts.bus(deployment, "up")
    };
    let deployment = deployment.clone();
    Ok(tokio::spawn(async move {
        begun.await;
        let bus = Bus::open(bus).await.ok();
        greeting.tell(start, bus.as_ref()).await;
        Farewell::new(&deployment, bus?).ok()?
    }))
}

/// Tells what the end has lost; nothing if it came before the greeting.
async fn farewell(greeted: JoinHandle<Option<Farewell>>) {
    if !greeted.is_finished() {
        greeted.abort();
    }
    if let Ok(Some(farewell)) = greeted.await {
        farewell.tell();
    }
}

/// Opens a router that tells the schemas of messages, and its REST server if there is an address for it.
async fn open_router(config: &RouterConfig, rest: &str) -> Result<Router, Failure> {
    let router = Router::open(config).await?;
    serve_schemas(&router.bus("schema"))?;
    tracing::info!(endpoints = ?router.endpoints().await, "router up");
    if !rest.is_empty() {
        let address = rest::start(rest, router.bus("rest")).await?;
        tracing::info!("REST: http://{address}/zenav/**");
    }
    Ok(router)
}

/// `zenav router`.
///
/// # Errors
/// A taken port or a bad endpoint, an identity that is not a router's.
pub fn router(args: &RouterArgs) -> Outcome {
    let config = RouterConfig {
        listen: args.listen.clone(),
        connect: args.connect.clone(),
        scouting: args.outside.scouting,
        security: args.security.security()?,
        ..RouterConfig::default()
    };
    config.security.check_role("`zenav router`", &[Role::Router])?;
    let ended = tasks::block_on(&runtime()?, async {
        args.health.serve(&config.security).await?;
        // It may just have been restarted.
        tokio::time::sleep(SETTLING).await;
        let router = open_router(&config, args.outside.rest.as_deref().unwrap_or_default()).await?;
        service_manager::ready();
        let outdated = async {
            match config.security.identity() {
                Some(identity) => identity.outdated().await,
                None => std::future::pending().await,
            }
        };
        let mut interrupt = tasks::spawn(interrupted());
        let ended = tokio::select! {
            _ = &mut interrupt => Ended::Done,
            () = outdated => Ended::Outdated,
            () = router.was_suspended() => Ended::Suspended,
            () = router.is_deaf() => Ended::Deaf,
        };
        router.close().await;
        Ok::<_, Failure>(ended.unless_interrupted(&interrupt))
    })?;
    ended.outcome()
}

/// `zenav edge`.
///
/// # Errors
/// Bad files, a taken port, an unknown robot.
pub fn edge(args: &EdgeArgs) -> Outcome {
    let layers = Layers::load(args.part.deployment.as_deref())?;
    let mut deployment = args.part.over(layers.deployment.clone())?;
    replace_models(&layers, &mut deployment, args.model.as_deref())?;
    overrule(&mut deployment.simulation.speed, args.speed.as_ref());
    overrule(&mut deployment.simulation.seed, args.seed.as_ref());
    for section in deployment.robots.values_mut() {
        overrule(&mut section.listen, args.listen.as_ref());
        section.attach |= args.attach || args.attach_to.is_some();
        section.driver |= args.body == Some(BodyKind::Bus);
    }
    args.begin.apply(&mut deployment)?;
    let world = layers.world(args.part.world.as_deref())?;
    let security = args.security.security_of(&deployment)?;
    let ended = tasks::block_on(&runtime()?, async {
        args.part.health.serve(&security).await?;
        let mut parts = Parts::new(security);
        parts.edges(&deployment, &world, args.attach_to.as_deref())?;
        until_interrupted(parts).await
    })?;
    ended.outcome()
}

/// `zenav cloud`.
///
/// # Errors
/// Bad files, a store that another process has, an identity of another role.
pub fn cloud(args: &CloudArgs) -> Outcome {
    let layers = Layers::load(args.part.deployment.as_deref())?;
    args.known.check_files(&layers, args.service)?;
    let mut deployment = args.part.over(layers.deployment.clone())?;
    overrule(&mut deployment.mission.run.holder, args.holder.as_ref());
    args.known.apply(&mut deployment);
    let world = layers.world(args.part.world.as_deref())?;
    let worker = args
        .worker
        .clone()
        .unwrap_or_else(|| format!("worker-{}", std::process::id()));
    let security = args.security.security_of(&deployment)?;
    security.check_role("`zenav cloud`", &[Role::Service, Role::Router])?;
    let ended = tasks::block_on(&runtime()?, async {
        args.part.health.serve(&security).await?;
        let mut parts = Parts::new(security);
        parts.cloud(&deployment, &world, args.service, &worker)?;
        until_interrupted(parts).await
    })?;
    ended.outcome()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_model_is_for_every_robot_and_an_unknown_one_is_refused_with_the_names_that_there_are() {
        let layers = Layers::load(None).unwrap();
        let mut deployment = layers.deployment.clone();
        replace_models(&layers, &mut deployment, None).unwrap();
        assert_eq!(deployment.robots["tiago"].model, "tiago");
        replace_models(&layers, &mut deployment, Some("jackal+rear_lidar")).unwrap();
        assert_eq!(deployment.robots["tiago"].model, "jackal+rear_lidar");
        let refused = replace_models(&layers, &mut deployment, Some("jackel")).unwrap_err();
        assert_eq!(refused.code, exit_code::NOT_FOUND);
        assert!(refused.message.contains("jackal"), "{refused}");
    }

    #[test]
    fn a_setting_that_does_not_suit_another_model_is_told_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let (file, slow) = (folder.path().join("mine.toml"), folder.path().join("slow.toml"));
        let text = "[robots.a]\nmodel = \"tiago\"\n[robots.a.edge.collision_monitor]\nrest_after_silence = 0.5\n";
        std::fs::write(&file, text).unwrap();
        std::fs::write(&slow, "[lidar]\nrate_hz = 1.0\n").unwrap();
        let layers = Layers::load(Some(&file)).unwrap();
        let mut deployment = layers.deployment.clone();
        replace_models(&layers, &mut deployment, None).unwrap();
        let model = format!("tiago+{}", slow.display());
        let refused = replace_models(&layers, &mut deployment, Some(&model)).unwrap_err();
        let told = "mine.toml:4: `robots.a.edge.collision_monitor.rest_after_silence` is 0.5: expected at least 1.33 s";
        assert_eq!(refused.code, exit_code::USAGE);
        assert!(refused.message.contains(told), "{refused}");
    }
}
