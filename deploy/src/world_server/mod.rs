//! World server (`zenav sim serve`). One simulated world shared by robots on several machines. The server simulates the world; edges
//! attach over the bus, each with its own robot, and exchange readings and commands with it as with a real body.
//!
//! The world waits for no edge: a robot whose edge is silent for 0.1 s of the world's time stops its wheels, as hardware would.

mod host;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use clap::Args;
use zenav_observability::Gauge;
use zenav_observability::metrics::{WORLD_ROBOTS, WORLD_TIME};
use zenav_protocol::bus::{AliveToken, Bus, BusConfig, Publisher, Shutdown, interrupted, service_manager};
use zenav_protocol::id::Id;
use zenav_protocol::member::Role;
use zenav_protocol::messages::{AttachReply, SimClock};
use zenav_protocol::readings::Readings;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;
use zenav_sim::Simulation;

use crate::arguments;
use crate::completion;
use crate::config::SecurityArgs;
use crate::connect::DEFAULT_ENDPOINT;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::health::HealthArgs;
use crate::launch::runtime;
use crate::output::{self, Format};
use crate::tasks;
use host::{Host, RobotReport};

/// Most wheel commands queued.
const QUEUE: usize = 1024;
/// Service name announced by a world server.
const SERVICE: &str = "world";
/// Wall time for another world server on the bus to end: a killed one is seen until its link ends.
const SUCCESSION: Duration = Duration::from_secs(3);
/// Wall time for the router's answer about live services.
const LOOK: Duration = Duration::from_secs(1);

/// Arguments of `zenav sim serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// World: a file or shipped name
    #[arg(long, value_name = "W", default_value = "kitchen", add = completion::worlds())]
    world: String,
    /// Simulated time relative to wall time
    #[arg(long, default_value_t = 1.0, value_parser = arguments::speed)]
    speed: f64,
    /// Seed of all noise and of randomly walking people
    #[arg(long, default_value_t = 1, value_parser = arguments::whole::<u64>)]
    seed: u64,
    /// Endpoints of an own router [default: tcp/127.0.0.1:7447, without --connect]
    #[arg(long, value_name = "ENDPOINT", value_parser = arguments::endpoint)]
    listen: Vec<String>,
    /// Routers to join: without --listen as a client of one, with --listen as a further router
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    /// Namespace of the deployment, if its file sets one
    #[arg(
        long,
        value_name = "NAME",
        default_value = "",
        env = "ZENAV_BUS__NAMESPACE",
        hide_env_values = true,
        hide_default_value = true
    )]
    namespace: String,
    #[command(flatten)]
    security: SecurityArgs,
    #[command(flatten)]
    health: HealthArgs,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

type Shared = Arc<Mutex<Host>>;

fn lock(host: &Shared) -> MutexGuard<'_, Host> {
    host.lock().unwrap_or_else(PoisonError::into_inner)
}

/// `zenav sim serve`.
///
/// # Errors
/// A bad world, a taken port, an identity that is not a router's, a bus with another world server.
pub fn serve(args: &ServeArgs) -> Outcome {
    let world = files::world(&args.world)?;
    let simulation = Simulation::new(&world, Vec::new(), args.seed).map_err(Failure::usage)?;
    let listen = match (&args.listen[..], &args.connect[..]) {
        ([], []) => vec![DEFAULT_ENDPOINT.to_owned()],
        (listen, _) => listen.to_owned(),
    };
    let security = args.security.security()?;
    security.check_role("`zenav sim serve`", &[Role::Router])?;
    tasks::block_on(&runtime()?, async {
        args.health.serve(&security).await?;
        // With an endpoint it is a router itself: readings reach the edges without a detour.
        let config = BusConfig {
            connect: args.connect.clone(),
            retry: listen.is_empty(),
            listen,
            name: "sim".to_owned(),
            namespace: args.namespace.clone(),
            security,
            is_narrow: false,
        };
        let bus = Bus::open(config).await?;
        // Port 0 is replaced by a free one.
        let mut endpoints = bus.endpoints().await;
        if endpoints.is_empty() {
            endpoints.clone_from(&args.connect);
        }
        let endpoint = endpoints.join(", ");
        let _alive = alone(&bus, &endpoint).await?;
        tracing::info!(world = world.name(), endpoint, "the world is served");
        let host = Arc::new(Mutex::new(Host::new(world, simulation)));
        let shutdown = Shutdown::new();
        service_manager::ready();
        let result = run(&bus, &host, args.speed, &shutdown).await;
        bus.close().await;
        result?;
        output::values(args.output, &lock(&host).report(), |rows| {
            let row = |row: &RobotReport| {
                [
                    row.robot.clone(),
                    format!("{:.2}", row.length_m),
                    format!("{:.3}", row.min_clearance_m),
                    row.collisions.to_string(),
                ]
            };
            output::table(
                &["robot", "driven m", "least clearance m", "collisions"],
                rows.iter().map(row),
            )
        })
    })
}

/// Announces the world server, unless there is another one: robots would get two bodies.
async fn alone(bus: &Bus, endpoint: &str) -> Result<AliveToken, Failure> {
    let key = |name: &str| topics::alive_key(topics::ALIVE_WORKER, &[SERVICE, name]);
    let until = Instant::now() + SUCCESSION;
    while !bus.list_alive(key("*"), LOOK).await?.is_empty() {
        if Instant::now() > until {
            return Err(Failure::failed(format!(
                "a world is served at {endpoint} already: end that one, or use another router"
            )));
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    Ok(bus.declare_alive(key(&bus.zid()))?)
}

/// Serves the world until Ctrl-C.
async fn run(bus: &Bus, host: &Shared, speed: f64, shutdown: &Shutdown) -> Result<(), Failure> {
    let mut attaching = bus.serve(&topics::ATTACH, &[])?;
    let mut wheels = bus.subscribe(&topics::WHEELS, &["*"], QUEUE)?;
    let clock = bus.publisher(&topics::SIM_CLOCK, &[])?;
    bus.serve_info("sim", "", BTreeMap::new())?;
    let mut telling = Telling {
        bus: bus.clone(),
        clock,
        readings: BTreeMap::new(),
        time: WORLD_TIME.with_label_values::<&str>(&[]),
        robots: WORLD_ROBOTS.with_label_values::<&str>(&[]),
    };
    bus.started();
    let tick = lock(host).robots().0.tick();
    let begin = Instant::now();
    let stepping = std::thread::Builder::new().name("zenav-world".to_owned()).spawn({
        let (host, shutdown) = (Arc::clone(host), shutdown.clone());
        move || {
            keep_time(tick.div_f64(speed), &shutdown, || {
                let mut host = lock(&host);
                host.step(begin.elapsed());
                telling.tell(&host);
            });
        }
    })?;
    loop {
        tokio::select! {
            () = interrupted() => break,
            request = attaching.next() => {
                let Some(request) = request else { break };
                let attached = {
                    let mut host = lock(host);
                    host.attach(begin.elapsed(), &request.body).map(|start| AttachReply {
                        world: host.world().name().to_owned(),
                        start,
                        tick_secs: tick.as_secs_f64(),
                        speed,
                    })
                };
                match attached {
                    Ok(reply) => request.reply(&reply),
                    Err(refusal) => request.refuse(&refusal),
                }
            }
            received = wheels.next() => {
                let Some(received) = received else { break };
                if let Some(robot) = received.chunks.first() {
                    lock(host).command(begin.elapsed(), robot, &received.message);
                }
            }
        }
    }
    shutdown.trigger();
    if stepping.join().is_err() {
        return Err(Failure::failed("the world broke off"));
    }
    Ok(())
}

/// Publishers of the data sent after each step.
struct Telling {
    bus: Bus,
    clock: Publisher<SimClock>,
    readings: BTreeMap<Id, Publisher<Readings>>,
    time: Gauge,
    robots: Gauge,
}

impl Telling {
    fn tell(&mut self, host: &Host) {
        let (simulation, ids) = host.robots();
        self.time.set(simulation.now().secs_since(Stamp::ZERO));
        self.robots.set(simulation.robots() as f64);
        self.clock.put(&SimClock {
            stamp: simulation.now(),
        });
        for (robot, id) in ids.enumerate() {
            if !self.readings.contains_key(id) {
                // A closed bus publishes nothing.
                let Ok(publisher) = self.bus.publisher(&topics::READINGS, &[id.as_str()]) else {
                    return;
                };
                self.readings.insert(id.clone(), publisher);
            }
            if let Some(publisher) = self.readings.get(id) {
                publisher.put(&simulation.readings(robot));
            }
        }
        if self.readings.len() > simulation.robots() {
            self.readings.retain(|id, _| simulation.find(id).is_some());
        }
    }
}

/// Steps at absolute deadlines; missed deadlines are skipped, so an overloaded world runs slower.
fn keep_time(period: Duration, shutdown: &Shutdown, mut step: impl FnMut()) {
    let mut deadline = Instant::now();
    while !shutdown.is_set() {
        deadline += period;
        match deadline.checked_duration_since(Instant::now()) {
            Some(left) => std::thread::sleep(left),
            None => deadline = Instant::now(),
        }
        step();
    }
}
