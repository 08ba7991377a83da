//! How does mapping live on the network? Scans in; description, patches and answers out. Thin: [`Mapper`] decides.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use thiserror::Error;
use tokio::task::JoinSet;
use zenav_protocol::bus::{Bus, BusError, Clock, Publisher, Request, Shutdown};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{
    EdgeState, InfoRequest, MapAction, MapInfo, MapPatch, MapRef, MapReply, MapRequest, Refusal, Scan,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{
    ALIVE_COMPONENT, EDGE_INFO, LIDAR_SCAN, MAP, MAP_INFO, MAP_PATCH, SCAN, STATE, alive_key,
};

use zenav_mapping::config::{MapperConfig, MapperConfigError};
use zenav_mapping::map_image;
use zenav_mapping::map_yaml::MapMode;
use zenav_mapping::mapper::{Insertion, Mapper};
use zenav_mapping::store::{self, MapRecord, StoredMap};

/// One robot's mapping.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MappingConfig {
    /// The robot's id.
    pub robot: String,
    /// How scans become a map. Without a footprint the robot itself is asked for its outline.
    #[serde(default)]
    pub mapper: MapperConfig,
    /// Where the map is stored as `map.pgm`, `map.yaml`, `map.json`; without it nothing is.
    #[serde(default)]
    pub folder: Option<PathBuf>,
    /// Most patches a second; a scan after a longer pause is published at once.
    #[serde(default = "default_publish_hz")]
    pub publish_hz: f64,
}

fn default_publish_hz() -> f64 {
    10.0
}

impl MappingConfig {
    /// Mapping for a robot with everything else as usual.
    #[must_use]
    pub fn new(robot: impl Into<String>) -> Self {
        Self {
            robot: robot.into(),
            mapper: MapperConfig::default(),
            folder: None,
            publish_hz: default_publish_hz(),
        }
    }
}

/// Why mapping does not run.
#[derive(Debug, Error)]
pub enum MappingError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] MapperConfigError),
    /// The network.
    #[error(transparent)]
    Bus(#[from] BusError),
}

/// Answers that are remembered, so that a repeated request is answered with the first answer.
const REMEMBERED: usize = 64;
/// Whole maps that are encoded at the same time; further askers are told to come back.
const MAX_ENCODING: usize = 4;
/// How long the robot may take to tell its outline, each time it is asked.
const OUTLINE_DEADLINE: Duration = Duration::from_secs(30);

/// Maps for one robot until shutdown, or until the bus is closed.
///
/// A stored map is loaded and held: it is published, but not changed before `resume` or `reset`. A stored map that cannot
/// be read is reported and left alone, and a new one is begun.
///
/// # Errors
/// [`MappingError`] for a configuration that makes no sense, and when a key cannot be declared.
pub async fn run(bus: Bus, clock: Clock, config: MappingConfig, shutdown: Shutdown) -> Result<(), MappingError> {
    config.mapper.check()?;
    let robot = config.robot.clone();
    let chunks = [robot.as_str()];
    let mut scans = bus.latest(&SCAN, &chunks)?;
    let mut further_scans = bus.latest(&LIDAR_SCAN, &[&robot, "*"])?;
    let mut states = bus.latest(&STATE, &chunks)?;
    let mut requests = bus.serve(&MAP, &chunks)?;
    let mut service = Service {
        info: bus.publisher(&MAP_INFO, &chunks)?,
        patches: bus.publisher(&MAP_PATCH, &chunks)?,
        mapper: begin(&config).await,
        period: Duration::from_secs_f64(1.0 / config.publish_hz.clamp(0.1, 100.0)),
        published: Stamp::ZERO,
        waiting: false,
        answered: VecDeque::new(),
        encoding: JoinSet::new(),
        config,
    };
    let _alive = bus.declare_alive(alive_key(ALIVE_COMPONENT, &[&robot, "mapping"]))?;
    service.publish(clock.now());
    service.info.put(&service.mapper.info());
    let mut outline = Box::pin(ask_outline(&bus, &robot, service.config.mapper.footprint.is_some()));
    let mut outline_known = false;
    loop {
        let due = service.published + service.period;
        tokio::select! {
            () = shutdown.wait() => break,
            scan = scans.next() => match scan {
                Some(scan) => service.take_in(&scan.message, clock.now()),
                None => break,
            },
            scan = further_scans.next() => match scan {
                Some(scan) => service.take_in(&scan.message, clock.now()),
                None => break,
            },
            () = clock.sleep_until(due), if service.waiting => service.publish(clock.now()),
            request = requests.next() => match request {
                Some(request) => {
                    let epoch = states.borrow().map(|state: &EdgeState| state.lease.epoch);
                    service.answer(request, epoch, clock.now()).await;
                }
                None => break,
            },
            footprint = &mut outline, if !outline_known => {
                outline_known = true;
                if let Some(footprint) = footprint {
                    service.mapper.set_footprint(footprint);
                }
            }
            Some(_) = service.encoding.join_next() => {}
        }
    }
    service.publish(clock.now());
    // Answers that are being encoded are still given; the deadline of the whole exit is the caller's.
    while service.encoding.join_next().await.is_some() {}
    Ok(())
}

/// Asks the robot for its outline until it tells.
async fn ask_outline(bus: &Bus, robot: &str, known: bool) -> Option<zenav_protocol::robot::Footprint> {
    if known {
        return None;
    }
    loop {
        match bus
            .ask(&EDGE_INFO, &[robot], &InfoRequest::default(), OUTLINE_DEADLINE)
            .await
        {
            Ok(info) => return info.model.map(|model| model.footprint),
            Err(zenav_protocol::bus::AskError::Timeout { .. }) => {}
            Err(error) => {
                tracing::warn!(robot, %error, "the robot does not tell its outline: what it stands on is not cleared");
                return None;
            }
        }
    }
}

/// The stored map, or a new one.
async fn begin(config: &MappingConfig) -> Mapper {
    if let Some(folder) = config.folder.clone() {
        let loaded = tokio::task::spawn_blocking(move || store::load(&folder)).await;
        match loaded {
            Ok(Ok(Some(StoredMap { grid, record }))) => {
                tracing::info!(
                    robot = config.robot,
                    stored = record.map.id,
                    revision = record.map.revision,
                    "stored map loaded"
                );
                // A new name: revisions of an earlier life that were never stored must not be taken for these.
                let map = MapRef {
                    id: new_map_id(&config.robot),
                    revision: 0,
                };
                return Mapper::with_stored(config.mapper.clone(), map, &grid, record.trajectory, record.scans);
            }
            Ok(Ok(None)) => {}
            Ok(Err(error)) => {
                tracing::error!(robot = config.robot, %error, "the stored map cannot be read; a new one is begun")
            }
            Err(error) => {
                tracing::error!(robot = config.robot, %error, "loading the stored map failed; a new one is begun")
            }
        }
    }
    Mapper::new(config.mapper.clone(), new_map_id(&config.robot))
}

/// A name that no map of this robot had before.
fn new_map_id(robot: &str) -> String {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    format!("{robot}-{}", since_epoch.as_millis())
}

struct Service {
    config: MappingConfig,
    mapper: Mapper,
    info: Publisher<MapInfo>,
    patches: Publisher<MapPatch>,
    period: Duration,
    published: Stamp,
    /// Whether something waits to be published.
    waiting: bool,
    answered: VecDeque<(String, Result<MapReply, Refusal>)>,
    encoding: JoinSet<()>,
}

impl Service {
    fn take_in(&mut self, scan: &Scan, now: Stamp) {
        match self.mapper.insert(scan) {
            Insertion::Inserted => {
                self.waiting = true;
                // A simulation may have begun anew: its clock is then before the last time.
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
        let patch = self.mapper.take_patch();
        // A map that came in many tiles goes out in several patches, each at its own time.
        self.waiting = patch.is_some() && self.mapper.has_changes();
        if let Some(patch) = patch {
            self.patches.put(&patch);
            self.info.put(&self.mapper.info());
        }
    }

    async fn answer(&mut self, request: Request<MapRequest, MapReply>, epoch: Option<u64>, now: Stamp) {
        let asked = request.body.clone();
        if asked.action == MapAction::Get {
            self.hand_out(request);
            return;
        }
        let known = asked
            .request_id
            .as_ref()
            .and_then(|id| self.answered.iter().find(|(known, _)| known == id));
        let result = match known {
            Some((_, result)) => result.clone(),
            None => {
                let result = match (asked.epoch, epoch) {
                    (Some(got), Some(current)) if got != current => Err(Refusal::WrongEpoch { got, current }),
                    _ => self.act(asked.action, now).await,
                };
                if let Some(id) = asked.request_id {
                    self.answered.truncate(REMEMBERED - 1);
                    self.answered.push_front((id, result.clone()));
                }
                result
            }
        };
        match result {
            Ok(reply) => request.reply(&reply),
            Err(refusal) => request.refuse(&refusal),
        }
    }

    async fn act(&mut self, action: MapAction, now: Stamp) -> Result<MapReply, Refusal> {
        match action {
            MapAction::Get => {}
            MapAction::Save => self.save().await?,
            MapAction::Reset => self.mapper.reset(new_map_id(&self.config.robot)),
            MapAction::Resume => self.mapper.resume(),
            MapAction::Hold => self.mapper.hold(),
            MapAction::Forget => self.mapper.forget(),
        }
        self.publish(now);
        let info = self.mapper.info();
        self.info.put(&info);
        Ok(MapReply {
            info,
            values: Vec::new(),
            trajectory: Vec::new(),
        })
    }

    async fn save(&mut self) -> Result<(), Refusal> {
        let Some(folder) = self.config.folder.clone() else {
            return Err(Refusal::rejected(
                "this mapping service was given no folder to store maps in",
            ));
        };
        let info = self.mapper.info();
        if info.spec.is_empty() {
            return Err(Refusal::rejected("there is no map yet: no scan was inserted"));
        }
        let record = MapRecord {
            map: info.map,
            stamp: info.stamp,
            scans: info.scans,
            trajectory: self.mapper.trajectory().to_vec(),
        };
        let stored = StoredMap {
            grid: self.mapper.grid(),
            record,
        };
        let saved = tokio::task::spawn_blocking(move || store::save(&folder, &stored)).await;
        match saved {
            Ok(Ok(path)) => {
                tracing::info!(robot = self.config.robot, file = %path.display(), "map stored");
                self.mapper.mark_stored();
                Ok(())
            }
            Ok(Err(error)) => Err(Refusal::Internal {
                reason: error.to_string(),
            }),
            Err(error) => Err(Refusal::Internal {
                reason: error.to_string(),
            }),
        }
    }

    /// Answers with the whole map, encoded beside the service's own work.
    fn hand_out(&mut self, request: Request<MapRequest, MapReply>) {
        if self.encoding.len() >= MAX_ENCODING {
            request.refuse(&Refusal::Busy {
                reason: format!("{MAX_ENCODING} maps are being encoded"),
            });
            return;
        }
        let format = request.parameters.get("format").map(String::as_str).unwrap_or("json");
        match format {
            "json" | "cbor" => {
                let reply = self.mapper.reply();
                self.encoding.spawn_blocking(move || request.reply(&reply));
            }
            "png" | "pgm" | "yaml" => {
                let (format, grid) = (format.to_owned(), self.mapper.grid());
                self.encoding.spawn_blocking(move || match picture(&grid, &format) {
                    Ok((bytes, mime)) => request.reply_bytes(bytes, mime),
                    Err(refusal) => request.refuse(&refusal),
                });
            }
            other => {
                let reason = format!(
                    "format `{}`: expected json, cbor, png, pgm or yaml",
                    other.chars().take(40).collect::<String>()
                );
                request.refuse(&Refusal::bad_request(reason));
            }
        }
    }
}

/// The map in a form that map tools read, and that form's media type.
fn picture(grid: &OccupancyGrid, format: &str) -> Result<(Vec<u8>, &'static str), Refusal> {
    match format {
        "pgm" => Ok((map_image::to_pgm(grid), "image/x-portable-graymap")),
        "yaml" => Ok((
            map_image::to_yaml(grid, MapMode::Trinary, "map.pgm")
                .to_text(&[])
                .into_bytes(),
            "application/yaml",
        )),
        _ => map_image::to_png(grid)
            .map(|bytes| (bytes, "image/png"))
            .map_err(|error| Refusal::Internal {
                reason: error.to_string(),
            }),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use zenav_protocol::bus::{BusConfig, Router, RouterConfig};
    use zenav_protocol::geometry::Pose2;

    use super::*;
    use zenav_protocol::map_replica::{MapReplica, PatchResult};

    const DEADLINE: Duration = Duration::from_secs(10);

    fn scan(stamp: u64) -> Scan {
        Scan {
            stamp: Stamp(stamp),
            angle_min: -1.0,
            angle_increment: 0.02,
            range_min: 0.02,
            range_max: 5.0,
            ranges: vec![2.0; 100],
            base_from_laser: Pose2::IDENTITY,
            map_from_odom: Pose2::IDENTITY,
            odom_from_base: Pose2::new(0.1, 0.0, 0.0),
        }
    }

    fn request(action: MapAction, id: &str, epoch: Option<u64>) -> MapRequest {
        MapRequest {
            action,
            request_id: Some(id.to_owned()),
            epoch,
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_scan_becomes_a_patch_and_a_saved_map_is_there_after_a_restart() {
        let router = Router::open(&RouterConfig {
            listen: vec!["tcp/127.0.0.1:0".into()],
            ..RouterConfig::default()
        })
        .await
        .unwrap();
        let endpoint = router.endpoints().await.remove(0);
        let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
        let folder = tempfile::tempdir().unwrap();
        let config = MappingConfig {
            folder: Some(folder.path().to_owned()),
            ..MappingConfig::new("tiago")
        };
        let (client, chunks) = (open("client").await.unwrap(), ["tiago"]);
        let mut patches = client.subscribe(&MAP_PATCH, &chunks, 16).unwrap();
        let scans = client.publisher(&SCAN, &chunks).unwrap();

        let shutdown = Shutdown::new();
        let service = tokio::spawn(run(
            open("mapping").await.unwrap(),
            Clock::wall(),
            config.clone(),
            shutdown.clone(),
        ));
        let empty = client
            .ask(&MAP, &chunks, &MapRequest::default(), DEADLINE)
            .await
            .unwrap();
        assert!(!empty.info.stored && empty.values.is_empty());
        let refused = client
            .ask(&MAP, &chunks, &request(MapAction::Save, "too early", None), DEADLINE)
            .await;
        assert!(refused.is_err());

        // The scan's way to the service may not be declared yet: a robot sends again and again.
        let mut mirror = MapReplica::new();
        let mut stamp = 0;
        while !mirror.has_map() {
            stamp += 1;
            scans.put(&scan(stamp));
            if let Ok(Some(patch)) = tokio::time::timeout(Duration::from_millis(100), patches.next()).await {
                assert_eq!(mirror.apply(&patch.message), PatchResult::Applied);
            }
        }
        let saved = client
            .ask(&MAP, &chunks, &request(MapAction::Save, "save", None), DEADLINE)
            .await
            .unwrap();
        assert!(saved.info.stored && saved.values.is_empty());
        let again = client
            .ask(&MAP, &chunks, &request(MapAction::Save, "save", None), DEADLINE)
            .await
            .unwrap();
        assert_eq!(again, saved);
        shutdown.trigger();
        service.await.unwrap().unwrap();

        let shutdown = Shutdown::new();
        let service = tokio::spawn(run(
            open("mapping").await.unwrap(),
            Clock::wall(),
            config,
            shutdown.clone(),
        ));
        let loaded = client
            .ask(&MAP, &chunks, &MapRequest::default(), DEADLINE)
            .await
            .unwrap();
        assert!(loaded.info.stored && loaded.info.free > 0 && loaded.trajectory.len() == 1);
        assert_eq!(
            (loaded.info.free, loaded.info.occupied),
            (saved.info.free, saved.info.occupied)
        );
        let reset = client
            .ask(&MAP, &chunks, &request(MapAction::Reset, "reset", None), DEADLINE)
            .await
            .unwrap();
        assert!(!reset.info.stored && reset.info.map.id != loaded.info.map.id);
        shutdown.trigger();
        service.await.unwrap().unwrap();
        router.close().await;
    }
}
