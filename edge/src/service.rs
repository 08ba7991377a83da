//! Edge service. How is the pilot connected to the bus? Typed topics and requests in, topics and replies out, the control loop between.

use std::collections::BTreeMap;
use std::future::Future;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::de::DeserializeOwned;
use thiserror::Error;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tokio::time::timeout;
use zenav_observability::Condition;
use zenav_protocol::bus::{Bus, BusError, Call, PartServer, Publisher, Shutdown};
use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::messages::{
    Battery, Bump, EdgeState, Event, Imu, Intent, Marker, Obstacles, Odometry, PoseEstimate, Refusal, Scan, SimClock,
    Yield,
};
use zenav_protocol::readings::KindReading;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::settings::Settings as _;
use zenav_protocol::topics::{self, EdgeReply, EdgeRequest, Topic};

use crate::body::Body;
use crate::body_clock::BodyClock;
use crate::config::EdgeConfig;
use crate::control;
use crate::control_io::{Inbox, Persisted, Publication};
use crate::handoff::{Bundle, Handoff, PersistThenReply};
use crate::metrics::{ControlMetrics, RobotMetrics};
use crate::pilot::Pilot;
use crate::state_file::{StateError, StateFile};
use crate::trace::EdgeTrace;
use crate::trackers::{Law, UnknownTracker};

/// Most messages of a topic that wait in the bus.
const QUEUE: usize = 32;
/// Longest control period, wall time, s.
const LONGEST_PERIOD: f64 = 60.0;
/// A robot without readings for this long is not ready.
const SILENCE: Duration = Duration::from_secs(3);
/// Time between two attempts to store what could not be stored.
const SAVE_AGAIN: Duration = Duration::from_millis(500);
/// Time for the last messages and replies at shutdown.
const DRAIN: Duration = Duration::from_secs(2);

/// How an edge is run.
#[derive(Clone, Debug)]
pub struct ServiceConfig {
    /// The robot.
    pub edge: EdgeConfig,
    /// Folder of the persisted epoch and stop latch.
    pub state_dir: PathBuf,
    /// Rate of simulated time against wall time; 1 for a real body.
    pub speed: f64,
    /// Whether this edge publishes its body's time as the simulated clock: one edge of a simulated world does.
    pub gives_the_time: bool,
}

/// Why an edge did not start or ended early.
#[derive(Debug, Error)]
pub enum EdgeError {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The persisted state cannot be used.
    #[error(transparent)]
    State(#[from] StateError),
    /// The control thread could not be started.
    #[error("no control thread: {0}")]
    Thread(std::io::Error),
    /// A setting is out of its bounds, or does not suit the robot.
    #[error("settings: {0}")]
    Settings(#[from] OutOfBounds),
    /// The robot file names an unknown tracker.
    #[error(transparent)]
    Tracker(#[from] UnknownTracker),
    /// The speed is not a positive number, or a control period would last for minutes.
    #[error("speed {0}: expected a positive number, and control periods of at most a minute")]
    Speed(f64),
    /// The control thread panicked; the wheels were stopped.
    #[error("the control thread panicked")]
    Panicked,
}

/// Runs an edge until shutdown: the robot is stopped first, then the last messages go out. Needs no router: clients that
/// reach the bus's own endpoint are served.
///
/// ```no_run
/// # use zenav_edge::{EdgeConfig, ServiceConfig, SimBody, run};
/// # use zenav_protocol::{bus::{Bus, BusConfig, Shutdown}, geometry::Pose2, id::Id, robot::RobotModel};
/// # use zenav_sim::Simulation;
/// # async fn edge(model: RobotModel, simulation: Simulation) -> Result<(), Box<dyn std::error::Error>> {
/// let config = ServiceConfig {
///     edge: EdgeConfig::new(Id::robot("tiago")?, model, Pose2::IDENTITY),
///     state_dir: "state".into(),
///     speed: 1.0,
///     gives_the_time: true,
/// };
/// let (body, _referee) = SimBody::all(simulation).remove(0);
/// let bus = Bus::open(BusConfig::service("tiago", "tcp/127.0.0.1:7447")).await?;
/// run(bus, config, Box::new(body), Shutdown::new()).await?;
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// [`EdgeError`].
pub async fn run(bus: Bus, config: ServiceConfig, body: Box<dyn Body>, shutdown: Shutdown) -> Result<(), EdgeError> {
    let period = config.edge.tick / config.speed;
    if !(config.speed.is_finite() && config.speed > 0.0 && (0.0..=LONGEST_PERIOD).contains(&period)) {
        return Err(EdgeError::Speed(config.speed));
    }
    config.edge.settings.check()?;
    config.edge.settings.check_for(&config.edge.model, config.edge.tick)?;
    Law::named(&config.edge.model.controller.tracker)?;
    let robot = config.edge.robot.to_string();
    let readings = bus.expects("its readings have come, and a pose is known");
    let metrics = Arc::new(RobotMetrics::new(&robot));
    let file = StateFile::open(&config.state_dir, &config.edge.robot)?;
    let stored = file.load()?;
    // Fail now if the folder cannot be used. On a full disk the robot can be stopped and watched, but it grants no lease before there is
    // room.
    let unsaved = match file.save(&stored) {
        Ok(()) => None,
        Err(error) if error.may_pass() => Some(stored.clone()),
        Err(error) => return Err(error.into()),
    };

    let handoff = Arc::new(Handoff::default());
    let mut intake = JoinSet::new();
    let trace = Arc::new(EdgeTrace::new(&robot));
    hear_plans(&mut intake, &bus, &handoff, &robot, Arc::clone(&trace))?;
    hear(&mut intake, &bus, &handoff, &topics::HEARTBEAT, &robot, |inbox| {
        &mut inbox.heartbeats
    })?;
    hear(&mut intake, &bus, &handoff, &topics::TELEOP, &robot, |inbox| {
        &mut inbox.teleops
    })?;
    hear(&mut intake, &bus, &handoff, &topics::CORRECTION, &robot, |inbox| {
        &mut inbox.corrections
    })?;
    hear(&mut intake, &bus, &handoff, &topics::LOCALISATION, &robot, |inbox| {
        &mut inbox.localisations
    })?;
    hear_intents(&mut intake, &bus, &handoff)?;
    for server in bus.serve_part(&[&robot])? {
        intake.spawn(serve(bus.clone(), server, Arc::clone(&handoff)));
    }

    bus.serve_log_at(&topics::EDGE_LOG, &robot)?;

    let mut output = JoinSet::new();
    let publishers = Publishers::new(&bus, &robot, &config.edge.model, config.gives_the_time, trace)?;
    output.spawn(publish(
        publishers,
        Arc::clone(&handoff),
        Arc::clone(&metrics),
        readings,
    ));
    output.spawn(persist_then_reply(file, Arc::clone(&handoff), unsaved, metrics));
    let alive = bus.declare_alive(topics::alive_key(topics::ALIVE_COMPONENT, &[&robot, "edge"]))?;

    let halt = Arc::new(AtomicBool::new(false));
    let pace = (config.edge.tick, config.speed);
    let body = (body, BodyClock::new(config.edge.settings.body.longest_step));
    let pilot = Pilot::new(config.edge, new_boot_id(), stored);
    let ended = spawn_control(body, pilot, Arc::clone(&handoff), pace, Arc::clone(&halt), &robot)?;
    bus.started();
    tracing::info!(robot, "edge is up");

    let result = supervise(ended, &halt, &shutdown).await;
    tracing::info!(robot, "robot stopped, edge ends");
    drop(alive);
    intake.shutdown().await;
    handoff.close();
    let _ = timeout(DRAIN, async { while output.join_next().await.is_some() {} }).await;
    result
}

/// Waits for shutdown, stops the robot and waits until it is at rest; ends early if the control thread panics.
async fn supervise(mut ended: oneshot::Receiver<()>, halt: &AtomicBool, shutdown: &Shutdown) -> Result<(), EdgeError> {
    tokio::select! {
        early = &mut ended => return early.map_err(|_| EdgeError::Panicked),
        () = shutdown.wait() => halt.store(true, Ordering::Relaxed),
    }
    ended.await.map_err(|_| EdgeError::Panicked)
}

fn spawn_control(
    body: (Box<dyn Body>, BodyClock),
    pilot: Pilot,
    handoff: Arc<Handoff>,
    pace: (f64, f64),
    halt: Arc<AtomicBool>,
    robot: &str,
) -> Result<oneshot::Receiver<()>, EdgeError> {
    let (done, ended) = oneshot::channel();
    let metrics = ControlMetrics::new(robot);
    let control = move || {
        control::run(body, pilot, &handoff, pace, &halt, &metrics);
        let _ = done.send(());
    };
    std::thread::Builder::new()
        .name("zenav-control".to_owned())
        .spawn(control)
        .map_err(EdgeError::Thread)?;
    Ok(ended)
}

/// A unique id of this boot.
fn new_boot_id() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    format!("{:x}-{:x}", since.as_nanos(), std::process::id())
}

/// Carries a topic into the pilot's inbox.
fn hear<T: DeserializeOwned + Send + 'static>(
    tasks: &mut JoinSet<()>,
    bus: &Bus,
    handoff: &Arc<Handoff>,
    topic: &'static Topic<T>,
    robot: &str,
    place: fn(&mut Inbox) -> &mut Vec<T>,
) -> Result<(), BusError> {
    let mut subscription = bus.subscribe(topic, &[robot], QUEUE)?;
    let handoff = Arc::clone(handoff);
    tasks.spawn(async move {
        while let Some(received) = subscription.next().await {
            handoff.put(received.message, place);
        }
    });
    Ok(())
}

/// As [`hear`], for the courses of other robots: each may announce only its own, on its own key.
fn hear_intents(tasks: &mut JoinSet<()>, bus: &Bus, handoff: &Arc<Handoff>) -> Result<(), BusError> {
    let mut subscription = bus.subscribe(&topics::INTENT, &["*"], QUEUE)?;
    let handoff = Arc::clone(handoff);
    tasks.spawn(async move {
        while let Some(received) = subscription.next().await {
            if received.chunks.first() == Some(&received.message.robot) {
                handoff.put(received.message, |inbox| &mut inbox.intents);
            }
        }
    });
    Ok(())
}

/// As [`hear`], for plans, which may carry the trace of a scan.
fn hear_plans(
    tasks: &mut JoinSet<()>,
    bus: &Bus,
    handoff: &Arc<Handoff>,
    robot: &str,
    trace: Arc<EdgeTrace>,
) -> Result<(), BusError> {
    let mut subscription = bus.subscribe(&topics::PLAN, &[robot], QUEUE)?;
    let handoff = Arc::clone(handoff);
    tasks.spawn(async move {
        while let Some(received) = subscription.next().await {
            trace.plan(&received.message, received.trace);
            handoff.put(received.message, |inbox| &mut inbox.plans);
        }
    });
    Ok(())
}

/// Passes one kind of request to the pilot and its replies back, one at a time.
async fn serve(bus: Bus, mut server: PartServer<EdgeRequest>, handoff: Arc<Handoff>) {
    while let Some(Call { request, responder }) = server.next().await {
        let mut reply = handoff.ask(request).await;
        if let Ok(EdgeReply::Info(info)) = &mut reply {
            info.process = Some(bus.process_info());
        }
        responder.send(reply);
    }
}

/// One publisher per topic.
struct Publishers {
    /// By name of the further lidar, without one for the main lidar.
    scans: BTreeMap<Option<String>, Publisher<Scan>>,
    odometry: Publisher<Odometry>,
    imu: Publisher<Imu>,
    kinds: KindPublishers,
    bump: Publisher<Bump>,
    battery: Publisher<Battery>,
    pose: Publisher<PoseEstimate>,
    state: Publisher<EdgeState>,
    event: Publisher<Event>,
    obstacles: Publisher<Obstacles>,
    intent: Publisher<Intent>,
    yields: Publisher<Yield>,
    marker: Publisher<Marker>,
    clock: Option<Publisher<SimClock>>,
    trace: Arc<EdgeTrace>,
}

macro_rules! kind_publishers {
    ([] $($(#[doc = $doc:literal])* $(#[serde $serde:tt])* $kind:ident: $Model:ident => $Reading:ident, $TOPIC:ident = $key:literal;)*) => {
        /// One publisher a row of the table of sensors.
        struct KindPublishers {
            $($kind: Publisher<zenav_protocol::sensors::$Reading>,)*
        }

        impl KindPublishers {
            fn new(bus: &Bus, robot: &[&str]) -> Result<Self, BusError> {
                Ok(Self { $($kind: bus.publisher(&topics::$TOPIC, robot)?,)* })
            }

            fn put(&self, reading: &KindReading) {
                match reading {
                    $(KindReading::$Reading(message) => self.$kind.put(message),)*
                }
            }
        }
    };
}

zenav_protocol::sensor_kinds!(kind_publishers []);

impl Publishers {
    fn new(
        bus: &Bus,
        robot: &str,
        model: &RobotModel,
        gives_the_time: bool,
        trace: Arc<EdgeTrace>,
    ) -> Result<Self, BusError> {
        let scans = model.all_lidars().map(|(lidar, _)| {
            if model.is_main_lidar(lidar) {
                return Ok((None, bus.publisher(&topics::SCAN, &[robot])?));
            }
            let publisher = bus.publisher(&topics::LIDAR_SCAN, &[robot, lidar])?;
            Ok((Some(lidar.to_owned()), publisher))
        });
        let robot = &[robot];
        Ok(Self {
            trace,
            scans: scans.collect::<Result<_, BusError>>()?,
            odometry: bus.publisher(&topics::ODOMETRY, robot)?,
            imu: bus.publisher(&topics::IMU, robot)?,
            kinds: KindPublishers::new(bus, robot)?,
            bump: bus.publisher(&topics::BUMP, robot)?,
            battery: bus.publisher(&topics::BATTERY, robot)?,
            pose: bus.publisher(&topics::POSE, robot)?,
            state: bus.publisher(&topics::STATE, robot)?,
            event: bus.publisher(&topics::EVENT, robot)?,
            obstacles: bus.publisher(&topics::OBSTACLES, robot)?,
            intent: bus.publisher(&topics::INTENT, robot)?,
            yields: bus.publisher(&topics::YIELD, robot)?,
            marker: bus.publisher(&topics::MARKER, robot)?,
            clock: gives_the_time
                .then(|| bus.publisher(&topics::SIM_CLOCK, &[]))
                .transpose()?,
        })
    }

    fn put(&self, bundle: &Bundle) {
        if let (Some(clock), Some(stamp)) = (&self.clock, bundle.now) {
            clock.put(&SimClock { stamp });
        }
        for publication in &bundle.publications {
            match publication {
                Publication::Scan(lidar, message) => {
                    if let Some(publisher) = self.scans.get(lidar) {
                        publisher.put_in(self.trace.scan(message), message);
                    }
                }
                Publication::Odometry(message) => self.odometry.put(message),
                Publication::Imu(message) => self.imu.put(message),
                Publication::Sensor(reading) => self.kinds.put(reading),
                Publication::Bump(message) => self.bump.put(message),
                Publication::Battery(message) => self.battery.put(message),
                Publication::Pose(message) => self.pose.put(message),
                Publication::State(message) => self.state.put(message),
                Publication::Event(message) => {
                    self.trace.event(&message.kind);
                    self.event.put(message);
                }
                Publication::Obstacles(message) => self.obstacles.put(message),
                Publication::Intent(message) => self.intent.put(message),
                Publication::Yield(message) => self.yields.put(message),
                Publication::Marker(message) => self.marker.put(message),
            }
        }
    }
}

async fn publish(publishers: Publishers, handoff: Arc<Handoff>, metrics: Arc<RobotMetrics>, readings: Condition) {
    loop {
        let bundle = match timeout(SILENCE, handoff.bundle()).await {
            Ok(Some(bundle)) => bundle,
            Ok(None) => return,
            Err(_) => {
                readings.unmet();
                continue;
            }
        };
        for publication in &bundle.publications {
            match publication {
                Publication::State(state) => {
                    metrics.state(state);
                    // While the body is silent every state names that fault.
                    match &state.faults.body {
                        Some(_) => readings.unmet(),
                        None => readings.met(),
                    }
                }
                Publication::Event(event) => metrics.event(&event.kind),
                _ => {}
            }
        }
        publishers.put(&bundle);
    }
}

/// Persists, then replies: an epoch is announced only once no power cut can undo it. State that cannot be stored (`unsaved`) is tried again
/// until it can; the robot reports the fault meanwhile.
async fn persist_then_reply(
    file: StateFile,
    handoff: Arc<Handoff>,
    mut unsaved: Option<Persisted>,
    metrics: Arc<RobotMetrics>,
) {
    let mut said: Option<String> = None;
    loop {
        let next = handoff.next_reply();
        let next = match &unsaved {
            None => next.await,
            Some(_) => match tokio::time::timeout(SAVE_AGAIN, next).await {
                Ok(next) => next,
                Err(_) => Some(PersistThenReply::default()),
            },
        };
        let Some(reply) = next else { return };
        unsaved = reply.persist.clone().or(unsaved);
        let failure = match &unsaved {
            None => None,
            Some(state) => save(file.clone(), state.clone()).await.err(),
        };
        if failure.is_some() {
            metrics.unsaved.inc();
        }
        if failure != said {
            match &failure {
                Some(reason) => tracing::error!(reason, "the newest epoch and stop are not stored; trying again"),
                None => tracing::info!("the newest epoch and stop are stored"),
            }
            handoff.set_not_stored(failure.clone());
            said.clone_from(&failure);
        }
        if failure.is_none() {
            unsaved = None;
        }
        let refusal =
            failure.map(|reason| Refusal::internal(format!("no lease, for its epoch cannot be stored: {reason}")));
        reply.send(refusal.as_ref());
    }
}

fn save(file: StateFile, state: Persisted) -> impl Future<Output = Result<(), String>> {
    let saved = tokio::task::spawn_blocking(move || file.save(&state).map_err(|error| error.to_string()));
    async { saved.await.unwrap_or_else(|error| Err(error.to_string())) }
}
