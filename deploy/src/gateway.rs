//! `zenav gateway`. A web page and an API to see and command robots, beside the parts of a deployment.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use zenav_cloud::gateway::{Gateway, GatewayConfig, GatewayError};
use zenav_gateway::DEFAULT_LISTEN;
use zenav_observability::logging::{self, Format};
use zenav_protocol::member::Role;
use zenav_sim::World;

use crate::arguments;
use crate::components::{Parts, places};
use crate::config::{Deployment, Layers, SecurityArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::health::HealthArgs;
use crate::inspect::serve_schemas;
use crate::launch::{overrule, runtime, until_interrupted};
use crate::tasks;

/// Longest wait for a first robot before the address is printed.
const FIRST_ROBOT: Duration = Duration::from_secs(5);
/// Roles in which the page is of use: an operator's commands; a viewer's and a service's show at least what goes on.
const PAGE: [Role; 4] = [Role::Operator, Role::Viewer, Role::Service, Role::Router];
/// A free loopback port.
pub(crate) const FREE_PORT: &str = "127.0.0.1:0";

/// Arguments of `zenav gateway`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav gateway --connect tcp/127.0.0.1:7460 --listen 127.0.0.1:7481\n  zenav gateway --listen 0.0.0.0:7480 --token-file token.txt    for other machines\n\nWithout a token the page is served on loopback only. With one, open http://HOST:7480/#token=TOKEN; behind a proxy that speaks HTTPS the token is not readable on the way."
)]
pub struct GatewayArgs {
    /// Address of the page and the API; port 0 takes a free one [default: the deployment's, 127.0.0.1:7480]
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = arguments::address)]
    listen: Option<String>,
    /// Router endpoint, instead of the deployment's
    #[arg(long, value_name = "ENDPOINT")]
    connect: Option<String>,
    /// File whose first line is the token that requests must carry; required if other machines can reach the address
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Deployment file; without it, the shipped one
    #[arg(long, value_name = "FILE")]
    deployment: Option<PathBuf>,
    /// World whose places are named goals, instead of the deployment's
    #[arg(long)]
    world: Option<String>,
    #[command(flatten)]
    security: SecurityArgs,
    #[command(flatten)]
    health: HealthArgs,
}

/// The mission-control page beside `zenav up` and `zenav demo`.
#[derive(Debug, Default, Args)]
pub struct PageArgs {
    /// Address of the mission-control page; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = arguments::address)]
    gateway: Option<String>,
    /// Do not serve the mission-control page
    #[arg(long, conflicts_with = "gateway")]
    no_gateway: bool,
}

impl PageArgs {
    /// Applies the arguments to a deployment.
    pub(crate) fn apply(&self, deployment: &mut Deployment) {
        let gateway = &mut deployment.gateway;
        gateway.run.enabled = self.gateway.is_some() || gateway.run.enabled && !self.no_gateway;
        overrule(&mut gateway.settings.listen, self.gateway.as_ref());
    }

    /// Whether an address was given.
    pub(crate) fn names_address(&self) -> bool {
        self.gateway.is_some()
    }
}

/// Refuses a page address that the user gave and that is taken; only the default one falls back to a free port.
///
/// # Errors
/// The address.
pub(crate) fn check_named(deployment: &Deployment) -> Result<(), Failure> {
    let gateway = &deployment.gateway;
    let taken = std::net::TcpListener::bind(&gateway.settings.listen)
        .err()
        .filter(|error| gateway.run.enabled && error.kind() == std::io::ErrorKind::AddrInUse);
    match taken {
        Some(error) => Err(Failure::failed(format!(
            "gateway: cannot listen on {}: {error}",
            gateway.settings.listen
        ))),
        None => Ok(()),
    }
}

/// Prints the address of the page: the last line before the mission's own output.
pub(crate) fn tell(address: &str) {
    match logging::format() {
        Format::Text => crate::output::note(format_args!("mission control: {address}")),
        Format::Json => tracing::info!(address, "mission control"),
    }
}

impl Parts {
    /// Starts the gateway of a deployment, if it runs one; returns the page's address. If the default port is taken, a free one is used.
    ///
    /// # Errors
    /// An address that is taken or that needs a token, a token file that cannot be read.
    pub(crate) async fn gateway(&mut self, deployment: &Deployment, world: &World) -> Result<Option<String>, Failure> {
        let Some(gateway) = bind(deployment, world).await? else {
            return Ok(None);
        };
        let address = gateway.address().to_owned();
        self.run_gateway(deployment, gateway);
        Ok(Some(address))
    }

    /// Like [`Self::gateway`]; prints the address once a robot is found.
    ///
    /// # Errors
    /// As [`Self::gateway`].
    pub(crate) async fn told_gateway(&mut self, deployment: &Deployment, world: &World) -> Result<(), Failure> {
        let Some(gateway) = bind(deployment, world).await? else {
            return Ok(());
        };
        let (address, first_robot) = (gateway.address().to_owned(), gateway.first_robot());
        tasks::spawn(async move {
            let _ = tokio::time::timeout(FIRST_ROBOT, first_robot).await;
            tell(&address);
        });
        self.run_gateway(deployment, gateway);
        Ok(())
    }

    fn run_gateway(&mut self, deployment: &Deployment, gateway: Gateway) {
        let bus = self.bus(deployment, "gateway");
        self.spawn("gateway".to_owned(), bus, move |bus, shutdown| async move {
            serve_schemas(&bus)?;
            gateway.run(bus, shutdown).await.map_err(Failure::failed)
        });
    }
}

async fn bind(deployment: &Deployment, world: &World) -> Result<Option<Gateway>, Failure> {
    if !deployment.gateway.run.enabled {
        return Ok(None);
    }
    let mut config = GatewayConfig {
        settings: deployment.gateway.settings.clone(),
        places: places(world),
    };
    let bound = match Gateway::bind(config.clone()).await {
        Err(GatewayError::Listen { error, .. })
            if error.kind() == std::io::ErrorKind::AddrInUse && config.settings.listen == DEFAULT_LISTEN =>
        {
            tracing::info!("{DEFAULT_LISTEN} is in use: the page takes a free port");
            FREE_PORT.clone_into(&mut config.settings.listen);
            Gateway::bind(config).await
        }
        bound => bound,
    };
    bound.map(Some).map_err(failure)
}

fn failure(error: GatewayError) -> Failure {
    let code = match &error {
        GatewayError::Settings(_) | GatewayError::Access(_) => exit_code::USAGE,
        GatewayError::Listen { .. } | GatewayError::Bus(_) | GatewayError::Serve(_) => exit_code::FAILED,
    };
    Failure::new(code, error)
}

/// `zenav gateway`.
///
/// # Errors
/// A taken address, one that needs a token, bad files.
pub fn gateway(args: &GatewayArgs) -> Outcome {
    let layers = Layers::load(args.deployment.as_deref())?;
    let mut deployment = layers.deployment.clone();
    deployment.gateway.run.enabled = true;
    overrule(&mut deployment.bus.connect, args.connect.as_ref());
    overrule(&mut deployment.gateway.settings.listen, args.listen.as_ref());
    if args.listen.is_some() || layers.sets("gateway.listen") {
        check_named(&deployment)?;
    }
    if let Some(file) = &args.token_file {
        if !file.exists() {
            return Err(Failure::not_found(format!(
                "--token-file {}: there is no such file",
                file.display()
            )));
        }
        deployment.gateway.settings.token_file = Some(file.clone());
    }
    let world = layers.world(args.world.as_deref())?;
    let security = args.security.security_of(&deployment)?;
    security.check_role("`zenav gateway`", &PAGE)?;
    let ended = tasks::block_on(&runtime()?, async {
        args.health.serve(&security).await?;
        let mut parts = Parts::new(security);
        parts.told_gateway(&deployment, &world).await?;
        until_interrupted(parts).await
    })?;
    ended.outcome()
}
