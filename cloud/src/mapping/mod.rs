//! Mapping service. Scans in; map description, patches and answers out.
//!
//! Thin: [`MappingCore`] decides what the map is.
//!
//! | file | subject |
//! |---|---|
//! | `annotations` | places and zones of the map |
//! | `core` | poses from which scans are drawn, and corrections for the robot |
//! | `slam_search` | search of SLAM's whole map for the robot |
//! | `slam_poses`, `localised_poses` | poses by SLAM, by localisation in a known map |
//! | `slam_session` | the SLAM state that outlives the process |
//! | `graph` | when SLAM's pose graph is published |
//! | `authority` | may this request change the map? |
//! | `requests` | answers; each change is carried out once |
//! | `encodings` | the map as JSON, CBOR, PNG, PGM or YAML |
//! | `storage` | the map at the start, storing and loading |
//! | `metrics` | ages, durations and sizes |

mod annotations;
mod authority;
mod core;
mod encodings;
mod graph;
mod localised_poses;
mod metrics;
mod requests;
mod slam_poses;
mod slam_search;
mod slam_session;
mod storage;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::Value;
use thiserror::Error;
use tokio::task::{JoinHandle, JoinSet};
use zenav_mapping::{Insertion, MappingSettings};
use zenav_observability::trace::{self, Context};
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::bus::{AskError, Bus, BusError, Clock, Publisher, Shutdown};
use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{
    Annotations, Correction, EdgeState, GoalPoint, InfoReply, InfoRequest, Localisation, MapFrame, MapInfo, MapPatch,
    MapReply, PoseGraph, Scan,
};
use zenav_protocol::robot::Footprint;
use zenav_protocol::settings::Settings;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{
    ALIVE_COMPONENT, ANNOTATE, ANNOTATIONS, CORRECTION, EDGE_INFO, GRAPH, LIDAR_SCAN, LOCALISATION, LOCALISE, MAP,
    MAP_FRAME, MAP_INFO, MAP_PATCH, SCAN, STATE, alive_key,
};

use zenav_space::Zones;

use annotations::AnnotationBook;
use authority::Authority;
pub use core::{Mapped, MappingCore, PoseSettings, PoseSource};
use graph::GraphPace;
use metrics::MappingMetrics;
use requests::FirstAnswers;
use slam_session::{KeepError, OnDisk};

/// Configuration of one robot's mapping.
#[derive(Clone, Debug, PartialEq)]
pub struct MappingConfig {
    /// Id of the robot.
    pub robot: String,
    /// How scans become a map.
    pub settings: MappingSettings,
    /// Source of the poses from which scans are drawn.
    pub poses: PoseSettings,
    /// Folder in which the map is stored as `map.pgm`, `map.yaml` and `map.json`; without it, nothing is stored.
    pub folder: Option<PathBuf>,
    /// Map to start with, instead of the stored one.
    pub known: Option<KnownMap>,
    /// Named goals that every map of the robot has, map frame.
    pub places: BTreeMap<String, GoalPoint>,
    /// Zones that every map of the robot has.
    pub zones: Arc<Zones>,
}

/// A map that mapping starts with.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownMap {
    /// Occupancy of every cell.
    pub grid: Arc<OccupancyGrid>,
    /// Whether scans are inserted into it; otherwise the map is held.
    pub live: bool,
}

impl MappingConfig {
    /// Mapping for a robot with default settings and no folder.
    #[must_use]
    pub fn new(robot: impl Into<String>) -> Self {
        Self {
            robot: robot.into(),
            settings: MappingSettings::default(),
            poses: PoseSettings::default(),
            folder: None,
            known: None,
            places: BTreeMap::new(),
            zones: Arc::default(),
        }
    }
}

/// Why mapping does not run.
#[derive(Debug, Error)]
pub enum MappingError {
    /// A setting is out of bounds.
    #[error("mapping: {0}")]
    Settings(#[from] OutOfBounds),
    /// There is no stored map to localise in.
    #[error("mapping: `poses = \"localise\"` needs a stored map, and {0} has none: store one, or take `slam`")]
    NoMap(String),
    /// The stored map to localise in cannot be read.
    #[error("mapping: the map stored in {}: {problem}; mend it, move it away, or store another one", folder.display())]
    StoredMap {
        /// Its folder.
        folder: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// The session of SLAM exists, but cannot be read or set aside.
    #[error("mapping: the session of SLAM in {}: {problem}; mend it or move it away: it is not dropped silently", folder.display())]
    Session {
        /// Its folder.
        folder: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// The stored places and zones cannot be read.
    #[error("{}: {problem}; mend the file or remove it: the places and zones in it are not dropped silently", file.display())]
    Annotations {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// Another mapping service uses the folder.
    #[error("{}: in use by another mapping service; expected one for each robot and folder", .0.display())]
    InUse(PathBuf),
    /// The bus was closed, or a key could not be declared.
    #[error(transparent)]
    Bus(#[from] BusError),
}

/// Time limit of each request for the robot's footprint.
const FOOTPRINT_DEADLINE: Duration = Duration::from_secs(30);
/// Time from a foreign message on a key of this service to its own again.
const RESTATE_AFTER: Duration = Duration::from_secs(1);
/// Interval of later repetitions.
const RESTATE_EVERY: Duration = Duration::from_secs(10);
/// Pause before a robot with another schema is asked again: it may have been replaced.
const FOREIGN: Duration = Duration::from_secs(5);

/// Maps for one robot until shutdown, or until the bus is closed.
///
/// A stored map is loaded and held: it is published, but not changed before a `resume` or `reset`. An unreadable stored map is reported and
/// left alone, and a new one is started. SLAM resumes its stored session, if there is one.
///
/// # Errors
/// [`MappingError`] for settings out of bounds, annotations or a session of SLAM that cannot be read, a folder that is in use, and when a key
/// cannot be declared.
pub async fn run(bus: Bus, clock: Clock, config: MappingConfig, shutdown: Shutdown) -> Result<(), MappingError> {
    config.settings.check()?;
    let robot = config.robot.clone();
    let chunks = [robot.as_str()];
    let loaded = bus.expects("its map is loaded, or begun");
    let mut scans = bus.latest(&SCAN, &chunks)?;
    let mut further_scans = bus.latest(&LIDAR_SCAN, &[robot.as_str(), "*"])?;
    let mut states = bus.latest(&STATE, &chunks)?;
    let mut requests = bus.serve(&MAP, &chunks)?;
    let mut places = bus.serve(&LOCALISE, &chunks)?;
    let _alone = config.folder.as_deref().map(storage::lock).transpose()?.flatten();
    let stored = storage::session(&config).await?;
    let owns_session = stored.is_some();
    let mapper = match &stored {
        Some(_) => storage::empty(&config),
        None => storage::begin(&config).await?,
    };
    if config.poses.source == PoseSource::Localise && !mapper.is_stored() {
        let folder = config.folder.as_ref();
        return Err(MappingError::NoMap(folder.map_or_else(
            || "a robot without a folder".to_owned(),
            |folder| folder.display().to_string(),
        )));
    }
    let mut annotations = AnnotationBook::open(config.places.clone(), &config.zones, config.folder.as_deref())?;
    let mut core = MappingCore::new(mapper, &config.poses);
    let mut frame = MapFrame::default();
    if let Some(stored) = stored {
        annotations.go_on(&stored.head.annotations, stored.head.frame);
        frame = MapFrame {
            map: core.mapper.map().clone(),
            parts: stored.head.parts.clone(),
            ..frame
        };
        frame.map.frame = stored.head.frame;
        // Draws the whole map, so off the async threads.
        let drawn = tokio::task::spawn_blocking(move || core.going_on(stored)).await;
        core = drawn.map_err(|error| MappingError::Session {
            folder: config.folder.clone().unwrap_or_default(),
            problem: error.to_string(),
        })?;
    }
    loaded.met();
    let mut annotates = bus.serve(&ANNOTATE, &chunks)?;
    // What others are told in the name of this service.
    let mut told_frames = bus.latest(&MAP_FRAME, &chunks)?;
    let mut told_annotations = bus.latest(&ANNOTATIONS, &chunks)?;
    let mut told_health = bus.latest(&LOCALISATION, &chunks)?;
    let mut service = Service {
        info: bus.publisher(&MAP_INFO, &chunks)?,
        patches: bus.publisher(&MAP_PATCH, &chunks)?,
        frames: bus.publisher(&MAP_FRAME, &chunks)?,
        frame,
        corrections: bus.publisher(&CORRECTION, &chunks)?,
        localisation: bus.publisher(&LOCALISATION, &chunks)?,
        graphs: bus.publisher(&GRAPH, &chunks)?,
        graph_pace: GraphPace::default(),
        core,
        keeping: None,
        owns_session,
        kept_frame: 0,
        not_kept: None,
        boot_id: String::new(),
        is_foreign: false,
        annotations,
        annotations_topic: bus.publisher(&ANNOTATIONS, &chunks)?,
        annotated: FirstAnswers::default(),
        restate_at: None,
        period: Duration::from_secs_f64(1.0 / config.settings.publish_hz),
        published: Stamp::ZERO,
        pending: false,
        authority: Authority::default(),
        answered: FirstAnswers::default(),
        encoding: JoinSet::new(),
        metrics: MappingMetrics::new(&robot),
        trace: None,
        config,
    };
    let _alive = bus.declare_alive(alive_key(ALIVE_COMPONENT, &[&robot, "mapping"]))?;
    let frame = service.core.untold_frame(Stamp::ZERO);
    if let Some(frame) = &frame {
        service.carry_over(frame);
    }
    let _ = service.keep(clock.now(), false).await;
    if let Some(frame) = frame {
        service.frames.put(&frame);
        service.frame = frame;
    }
    service.publish(clock.now());
    service.tell_info();
    service.annotations_topic.put(service.annotations.now());
    bus.serve_info("mapping", &robot, service.settings())?;
    bus.started();
    let mut body = Box::pin(ask_body(&bus, &robot, Duration::ZERO));
    let mut body_known = false;
    loop {
        let due = service.published + service.period;
        tokio::select! {
            // The robot's state before requests: the newest lease decides who may change the map.
            biased;
            () = shutdown.wait() => break,
            state = states.next() => match state {
                Some(state) => service.hear(clock.now(), state.message).await,
                None => break,
            },
            request = requests.next() => match request {
                Some(request) => service.answer(request, clock.now()).await,
                None => break,
            },
            request = places.next() => match request {
                Some(request) => service.answer_place(request, clock.now()),
                None => break,
            },
            request = annotates.next() => match request {
                Some(request) => service.annotate(request, clock.now()).await,
                None => break,
            },
            scan = scans.next(), if !service.is_foreign => match scan {
                Some(scan) => service.insert(&scan.message, scan.trace, clock.now()).await,
                None => break,
            },
            scan = further_scans.next(), if !service.is_foreign => match scan {
                Some(scan) => service.insert_further(&scan.message, scan.trace, clock.now()),
                None => break,
            },
            told = told_frames.next() => match told {
                Some(told) => service.doubt(told.message != service.frame),
                None => break,
            },
            told = told_annotations.next() => match told {
                Some(told) => service.doubt(told.message != *service.annotations.now()),
                None => break,
            },
            told = told_health.next() => match told {
                Some(told) => service.doubt(service.core.contradicts(&told.message)),
                None => break,
            },
            () = tokio::time::sleep_until(service.restate_at.unwrap_or_else(Instant::now).into()), if service.restate_at.is_some() => {
                service.restate();
            }
            () = clock.sleep_until(due), if service.pending => service.publish(clock.now()),
            answer = &mut body, if !body_known => {
                body_known = !matches!(answer, Body::Foreign);
                service.is_foreign = !body_known;
                match answer {
                    Body::Known(footprint) => service.core.mapper.set_footprint(footprint),
                    Body::Foreign => body.set(ask_body(&bus, &robot, FOREIGN)),
                    Body::Unknown => {}
                }
            }
            Some(_) = service.encoding.join_next() => {}
        }
    }
    service.publish(clock.now());
    let _ = service.keep(clock.now(), true).await;
    // Replies still being encoded are sent; the caller sets the deadline for the whole exit.
    while service.encoding.join_next().await.is_some() {}
    Ok(())
}

/// The robot's answer about its body.
enum Body {
    /// Its outline.
    Known(Footprint),
    /// Another message schema.
    Foreign,
    /// No answer on its outline.
    Unknown,
}

/// Asks for the robot's body, after a delay, until it answers.
async fn ask_body(bus: &Bus, robot: &str, after: Duration) -> Body {
    tokio::time::sleep(after).await;
    loop {
        match bus
            .ask(&EDGE_INFO, &[robot], &InfoRequest::default(), FOOTPRINT_DEADLINE)
            .await
        {
            Ok(info) if info.schema != SCHEMA_VERSION => {
                let InfoReply { version, schema, .. } = info;
                tracing::error!(
                    robot,
                    "its scans are not drawn: its edge ({version}) speaks schema {schema}, this mapping ({}) schema {SCHEMA_VERSION}: \
                     expected the same",
                    env!("CARGO_PKG_VERSION")
                );
                return Body::Foreign;
            }
            Ok(info) => return info.model.map_or(Body::Unknown, |model| Body::Known(model.footprint)),
            Err(AskError::Timeout { .. }) => {}
            Err(error) => {
                tracing::warn!(robot, %error, "the robot's footprint is not known: the cells under it are not cleared");
                return Body::Unknown;
            }
        }
    }
}

struct Service {
    config: MappingConfig,
    core: MappingCore,
    /// The SLAM session being written.
    keeping: Option<JoinHandle<Result<(u64, OnDisk), KeepError>>>,
    /// Whether the session on disk belongs to this map, and not to an earlier run that was not resumed.
    owns_session: bool,
    /// Frame of the session on disk.
    kept_frame: u64,
    /// When writing the session last failed.
    not_kept: Option<Stamp>,
    /// The robot's present boot.
    boot_id: String,
    /// Whether the robot speaks another schema: its scans may mean something else.
    is_foreign: bool,
    info: Publisher<MapInfo>,
    patches: Publisher<MapPatch>,
    frames: Publisher<MapFrame>,
    /// As last published.
    frame: MapFrame,
    corrections: Publisher<Correction>,
    localisation: Publisher<Localisation>,
    graphs: Publisher<PoseGraph>,
    graph_pace: GraphPace,
    /// Least time between two patches.
    period: Duration,
    /// Time of the last patch.
    published: Stamp,
    /// Whether there are changes to be published.
    pending: bool,
    authority: Authority,
    answered: FirstAnswers<MapReply>,
    annotations: AnnotationBook,
    annotations_topic: Publisher<Annotations>,
    annotated: FirstAnswers<Arc<Annotations>>,
    /// When frame, places, zones and localisation are published again, since somebody else published other ones.
    restate_at: Option<Instant>,
    /// Whole maps being encoded.
    encoding: JoinSet<()>,
    metrics: MappingMetrics,
    /// The newest traced scan that is in no patch yet.
    trace: Option<Context>,
}

impl Service {
    async fn hear(&mut self, now: Stamp, state: EdgeState) {
        self.boot_id = state.boot_id;
        self.core.hear_frame(state.frame);
        if let Some(frame) = self.core.untold_frame(now) {
            self.carry_over(&frame);
            let _ = self.keep(now, false).await;
            self.tell_frame(frame, now);
        }
        self.pending |= self.core.mapper.has_changes();
        self.authority.hear(now, state.lease);
    }

    async fn insert(&mut self, scan: &Scan, trace: Option<Context>, now: Stamp) {
        let boot_id = self.boot_id.clone();
        let mapped = self.draw(scan, trace, now, |core| {
            let mapped = core.insert(scan, &boot_id);
            (mapped.insertion, mapped)
        });
        if let Some(frame) = &mapped.frame {
            self.carry_over(frame);
        }
        // A successor of this process must know every frame that was ever published.
        let _ = self.keep(now, false).await;
        if let Some(frame) = mapped.frame {
            self.tell_frame(frame, now);
        }
        if let Some(correction) = &mapped.correction {
            self.corrections.put(correction);
        }
        if let Some(localisation) = &mapped.localisation {
            self.localisation.put(localisation);
        }
        self.drawn(mapped.insertion, now);
        self.tell_graph(now);
    }

    /// Hears what stands on a key of this service; `is_other`: it is not what this service published last. The service then repeats it, no
    /// more often than once a second: two services of one robot do not flood the bus.
    fn doubt(&mut self, is_other: bool) {
        let soon = Instant::now() + RESTATE_AFTER;
        if is_other && self.restate_at.is_none_or(|at| at > soon) {
            if self.restate_at.is_none() {
                tracing::warn!(
                    robot = self.config.robot,
                    "somebody else publishes on the keys of this robot's mapping"
                );
            }
            self.restate_at = Some(soon);
        }
    }

    /// Publishes what others may have been told otherwise, now and from time to time: a subscriber who comes later may be told both.
    fn restate(&mut self) {
        self.restate_at = Some(Instant::now() + RESTATE_EVERY);
        self.frames.put(&self.frame);
        self.annotations_topic.put(self.annotations.now());
        if let Some(localisation) = self.core.by_the_robot(&self.boot_id) {
            self.localisation.put(&localisation);
        }
    }

    /// Moves places and zones into a new frame that is not published yet.
    fn carry_over(&mut self, frame: &MapFrame) {
        if self.frame.map.frame != frame.map.frame {
            self.annotations.carry_over(&self.frame, frame);
        }
    }

    /// Publishes the poses of the map's parts. A new frame is published together with everything in it: places, zones, and the map.
    fn tell_frame(&mut self, frame: MapFrame, now: Stamp) {
        let before = std::mem::replace(&mut self.frame, frame);
        self.frames.put(&self.frame);
        if before.map.frame != self.frame.map.frame {
            self.annotations_topic.put(self.annotations.now());
            self.publish(now);
        }
    }

    fn insert_further(&mut self, scan: &Scan, trace: Option<Context>, now: Stamp) {
        let boot_id = self.boot_id.clone();
        let insertion = self.draw(scan, trace, now, |core| {
            let insertion = core.insert_further(scan, &boot_id);
            (insertion, insertion)
        });
        self.drawn(insertion, now);
    }

    /// Draws a scan, with metrics and trace.
    fn draw<R>(
        &mut self,
        scan: &Scan,
        trace: Option<Context>,
        now: Stamp,
        insert: impl FnOnce(&mut MappingCore) -> (Insertion, R),
    ) -> R {
        self.metrics.took(scan.stamp, now);
        let began = Instant::now();
        let span = trace.and_then(|trace| trace::child(&trace, &self.part(), "scan inserted"));
        let (insertion, done) = insert(&mut self.core);
        self.metrics.drew(began, insertion);
        // A process that writes no spans passes the trace on unchanged.
        self.trace = span.as_ref().map(trace::Span::context).or(trace).or(self.trace);
        if let Some(span) = span {
            span.end();
        }
        done
    }

    fn drawn(&mut self, insertion: Insertion, now: Stamp) {
        match insertion {
            Insertion::Inserted => {
                self.pending = true;
                // After a restart of the simulation its clock is before the last patch.
                if now.since(self.published) >= self.period || now < self.published {
                    self.publish(now);
                }
            }
            Insertion::Held => {}
            outcome => tracing::debug!(robot = self.config.robot, ?outcome, "scan left out"),
        }
    }

    fn publish(&mut self, now: Stamp) {
        self.published = now;
        let began = Instant::now();
        let patch = self.core.mapper.take_patch();
        // A map of many tiles is published in several patches, one each period.
        self.pending = patch.is_some() && self.core.mapper.has_changes();
        if let Some(patch) = patch {
            let trace = self.trace.take();
            let span = trace.and_then(|trace| trace::child(&trace, &self.part(), "map published"));
            self.patches
                .put_in(span.as_ref().map(trace::Span::context).or(trace), &patch);
            if let Some(span) = span {
                span.with("revision", patch.map.revision).end();
            }
            self.tell_info();
            self.metrics.published(began);
        }
    }

    /// The settings needed to draw the same map from the same scans again.
    fn settings(&self) -> BTreeMap<String, Value> {
        [
            ("mapping", serde_json::to_value(&self.config.settings)),
            ("poses", serde_json::to_value(self.config.poses)),
        ]
        .into_iter()
        .filter_map(|(section, settings)| Some((section.to_owned(), settings.ok()?)))
        .collect()
    }

    /// This part's name in traces.
    fn part(&self) -> String {
        format!("mapping-{}", self.config.robot)
    }

    /// Publishes the description of the map.
    fn tell_info(&self) {
        let info = self.core.mapper.info();
        self.metrics.map(&info);
        self.info.put(&info);
    }
}
