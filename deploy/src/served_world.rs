//! How do robots on several machines share one world? `zenav sim serve` holds it and moves its time on; edges attach over the bus, each
//! with a robot of its own, and hear and move it there as they would a real one.
//!
//! The world waits for nobody: a robot whose edge is silent for 0.1 s of its time stops its wheels, as hardware would.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use clap::Args;
use serde::Serialize;
use zenav_protocol::bus::{Bus, BusConfig, Publisher, Shutdown};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{AttachReply, AttachRequest, Refusal, SimClock, exit_code};
use zenav_protocol::readings::Readings;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;
use zenav_sim::{RobotSpec, Simulation, World};

use crate::connect::positive;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::launch::{interrupted, runtime};
use crate::output::{self, Format};

/// Wheel speeds that wait in the bus.
const QUEUE: usize = 1024;
/// Time without a command after which a robot's wheels stop, s.
const DEAD_MAN: f64 = 0.1;

/// Arguments of `zenav sim serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// World: a file or shipped name
    #[arg(long, value_name = "W", default_value = "kitchen")]
    world: String,
    /// Simulated seconds a second of wall time
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    speed: f64,
    /// Seed of all noise and of what walks at random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Endpoints of a router of its own
    #[arg(long, default_value = "tcp/127.0.0.1:7447", conflicts_with = "connect")]
    listen: Vec<String>,
    /// Join this router instead
    #[arg(long)]
    connect: Option<String>,
    /// Form of the report at the end
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// What became of a robot.
#[derive(Clone, Debug, Serialize)]
struct RobotReport {
    robot: String,
    length_m: f64,
    min_clearance_m: f64,
    collisions: u32,
}

/// The world and the robots in it.
struct Host {
    world: World,
    simulation: Simulation,
    robots: Vec<Driven>,
}

struct Driven {
    id: Id,
    readings: Publisher<Readings>,
    /// When its wheels were last commanded, the world's time.
    commanded: Stamp,
    collisions: u32,
}

type Shared = Arc<Mutex<Host>>;

fn lock(host: &Shared) -> MutexGuard<'_, Host> {
    host.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Host {
    /// Puts a robot into the world, or finds it there. Returns where it stands.
    fn attach(&mut self, bus: &Bus, request: &AttachRequest) -> Result<Pose2, Refusal> {
        let id = Id::robot(request.robot.clone()).map_err(|error| Refusal::bad_request(error.to_string()))?;
        if let Some(robot) = self.simulation.find(&id) {
            let known = self.simulation.model(robot);
            if *known != request.model {
                let reason = format!("robot `{id}` is in this world with another model");
                return Err(Refusal::bad_request(reason));
            }
            return Ok(self.simulation.truth(robot).map_from_base);
        }
        let readings = bus
            .publisher(&topics::READINGS, &[id.as_str()])
            .map_err(|error| Refusal::Internal {
                reason: error.to_string(),
            })?;
        let start = request.start.unwrap_or_else(|| self.world.start());
        let spec = RobotSpec {
            id: id.clone(),
            model: request.model.clone(),
            start,
        };
        self.simulation
            .add(&self.world, spec)
            .map_err(|error| Refusal::bad_request(error.to_string()))?;
        tracing::info!(robot = %id, x = start.x, y = start.y, "a robot came into the world");
        self.robots.push(Driven {
            id,
            readings,
            commanded: self.simulation.now(),
            collisions: 0,
        });
        Ok(start)
    }

    fn command(&mut self, robot: &str, wheels: [f64; 2]) {
        let Some(index) = self.robots.iter().position(|driven| driven.id.as_str() == robot) else {
            return;
        };
        self.robots[index].commanded = self.simulation.now();
        self.simulation.drive(index, wheels);
    }

    /// Moves the time on by one step and tells everybody.
    fn step(&mut self, clock: &Publisher<SimClock>) {
        let now = self.simulation.now();
        for (index, robot) in self.robots.iter().enumerate() {
            if now.secs_since(robot.commanded) > DEAD_MAN {
                self.simulation.drive(index, [0.0; 2]);
            }
        }
        self.simulation.step();
        clock.put(&SimClock {
            stamp: self.simulation.now(),
        });
        for (index, robot) in self.robots.iter_mut().enumerate() {
            robot.readings.put(&self.simulation.readings(index));
            let collisions = self.simulation.truth(index).collisions;
            if collisions > robot.collisions {
                robot.collisions = collisions;
                tracing::warn!(robot = %robot.id, collisions, "touched something");
            }
        }
    }

    fn report(&self) -> Vec<RobotReport> {
        let one = |(index, robot): (usize, &Driven)| {
            let truth = self.simulation.truth(index);
            RobotReport {
                robot: robot.id.to_string(),
                length_m: truth.length,
                min_clearance_m: truth.min_clearance,
                collisions: truth.collisions,
            }
        };
        self.robots.iter().enumerate().map(one).collect()
    }
}

/// `zenav sim serve`.
///
/// # Errors
/// A bad world, a taken port.
pub fn serve(args: &ServeArgs) -> Outcome {
    let world = files::world(&args.world)?;
    let simulation =
        Simulation::new(&world, Vec::new(), args.seed).map_err(|error| Failure::usage(error.to_string()))?;
    if args.connect.is_none() {
        crate::receivers::ensure_enough();
    }
    runtime()?.block_on(async {
        let bus = match &args.connect {
            Some(endpoint) => Bus::open(BusConfig::service("sim", endpoint)).await?,
            // A router itself: readings reach the edges' links without a detour.
            None => {
                let config = BusConfig {
                    connect: Vec::new(),
                    listen: args.listen.clone(),
                    name: "sim".to_owned(),
                    retry: false,
                };
                Bus::open(config).await?
            }
        };
        // Port 0 is a free one.
        let endpoint = match &args.connect {
            Some(endpoint) => endpoint.clone(),
            None => bus.endpoints().await.join(", "),
        };
        tracing::info!(world = world.name(), endpoint, "the world is served");
        let host = Arc::new(Mutex::new(Host {
            world,
            simulation,
            robots: Vec::new(),
        }));
        let shutdown = Shutdown::new();
        let result = run(&bus, &host, args.speed, &shutdown).await;
        bus.close().await;
        result?;
        output::values(args.output, &lock(&host).report(), |rows| {
            let row = |row: &RobotReport| {
                vec![
                    row.robot.clone(),
                    format!("{:.2}", row.length_m),
                    format!("{:.3}", row.min_clearance_m),
                    row.collisions.to_string(),
                ]
            };
            output::table(
                &["robot", "driven m", "least clearance m", "collisions"],
                &rows.iter().map(row).collect::<Vec<_>>(),
            )
        })?;
        Ok(exit_code::OK)
    })
}

/// Serves the world until Ctrl-C.
async fn run(bus: &Bus, host: &Shared, speed: f64, shutdown: &Shutdown) -> Result<(), Failure> {
    let mut attaching = bus.serve(&topics::ATTACH, &[])?;
    let mut wheels = bus.subscribe(&topics::WHEELS, &["*"], QUEUE)?;
    let clock = bus.publisher(&topics::SIM_CLOCK, &[])?;
    let tick = lock(host).simulation.tick();
    let stepping = std::thread::Builder::new().name("zenav-world".to_owned()).spawn({
        let (host, shutdown) = (Arc::clone(host), shutdown.clone());
        move || keep_time(&host, tick.div_f64(speed), &clock, &shutdown)
    })?;
    loop {
        tokio::select! {
            () = interrupted() => break,
            request = attaching.next() => {
                let Some(request) = request else { break };
                let attached = {
                    let mut host = lock(host);
                    host.attach(bus, &request.body).map(|start| AttachReply {
                        world: host.world.name().to_owned(),
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
                    lock(host).command(robot, received.message.wheels);
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

/// Steps at absolute deadlines; what cannot be kept up with is left out, and the world goes slower.
fn keep_time(host: &Shared, period: Duration, clock: &Publisher<SimClock>, shutdown: &Shutdown) {
    let mut deadline = Instant::now();
    while !shutdown.is_set() {
        deadline += period;
        match deadline.checked_duration_since(Instant::now()) {
            Some(left) => std::thread::sleep(left),
            None => deadline = Instant::now(),
        }
        lock(host).step(clock);
    }
}
