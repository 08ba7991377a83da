//! Storage. With which map does mapping begin, and how are maps stored and loaded?
//!
//! The robot's own map lies in its folder and is the one that the next start begins with; maps with names lie in `maps/NAME` below it.

use std::path::PathBuf;

use zenav_mapping::Mapper;
use zenav_mapping::store::{self, MapRecord, StoredMap};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{MapRef, MapRequest, Refusal, StoredMapInfo};

use super::{KnownMap, MappingConfig, Service};

/// Folder of the maps with names, in a robot's folder.
const MAPS: &str = "maps";

/// The map that was given, or the stored map, or a new one.
pub(super) async fn begin(config: &MappingConfig) -> Mapper {
    let robot = &config.robot;
    if let Some(KnownMap { grid, live }) = &config.known {
        let mut mapper = Mapper::with_stored(config.settings.clone(), new_map(robot), grid, Vec::new(), 0);
        if *live {
            mapper.resume();
        }
        return mapper;
    }
    if let Some(folder) = config.folder.clone() {
        match tokio::task::spawn_blocking(move || store::load(&folder)).await {
            Ok(Ok(Some(StoredMap { grid, record }))) => {
                tracing::info!(
                    robot,
                    stored = record.map.id,
                    revision = record.map.revision,
                    "stored map loaded"
                );
                // A new id: revisions of the last run that were never stored must not be mistaken for these.
                return Mapper::with_stored(
                    config.settings.clone(),
                    new_map(robot),
                    &grid,
                    record.trajectory,
                    record.scans,
                );
            }
            Ok(Ok(None)) => {}
            Ok(Err(error)) => tracing::error!(robot, %error, "the stored map cannot be read: mapping begins a new one"),
            Err(error) => tracing::error!(robot, %error, "loading the stored map failed: mapping begins a new one"),
        }
    }
    Mapper::new(config.settings.clone(), new_map_id(robot))
}

/// A map that none was before.
fn new_map(robot: &str) -> MapRef {
    MapRef {
        id: new_map_id(robot),
        revision: 0,
        frame: 0,
    }
}

/// An id that no map had before.
pub(super) fn new_map_id(robot: &str) -> String {
    format!("{robot}-{}", Id::unique())
}

impl Service {
    /// The folder of a stored map: the robot's own, or the one of this name.
    fn folder(&self, name: Option<&str>) -> Result<PathBuf, Refusal> {
        let Some(folder) = &self.config.folder else {
            return Err(Refusal::rejected(
                "no maps are stored here: mapping was given no folder",
            ));
        };
        match name.map(|name| Id::new(name).map_err(|error| Refusal::bad_request(format!("`name`: {error}")))) {
            None => Ok(folder.clone()),
            Some(name) => Ok(folder.join(MAPS).join(name?.as_str())),
        }
    }

    /// Stores the map as the robot's own, or under a name; scans wait meanwhile.
    pub(super) async fn save(&mut self, name: Option<&str>) -> Result<(), Refusal> {
        let folder = self.folder(name)?;
        let map = self.core.mapper.snapshot();
        if map.info.spec.is_empty() {
            return Err(Refusal::rejected("the map cannot be saved: it has no cells yet"));
        }
        let saved = tokio::task::spawn_blocking(move || {
            let stored = StoredMap {
                grid: map.grid(),
                record: MapRecord {
                    map: map.info.map,
                    stamp: map.info.stamp,
                    scans: map.info.scans,
                    trajectory: map.trajectory,
                },
            };
            store::save(&folder, &stored).map_err(|error| error.to_string())
        });
        match saved.await.map_err(|error| error.to_string()) {
            Ok(Ok(path)) => {
                tracing::info!(robot = self.config.robot, file = %path.display(), "map saved");
                if name.is_none() {
                    self.core.mapper.mark_stored();
                }
                Ok(())
            }
            Ok(Err(reason)) | Err(reason) => Err(Refusal::Internal { reason }),
        }
    }

    /// Replaces the map by the one of a request, or by a stored one; scans wait meanwhile.
    pub(super) async fn load(&mut self, request: &MapRequest) -> Result<(), Refusal> {
        let (grid, record) = match (&request.name, &request.map) {
            (Some(_), Some(_)) => return Err(Refusal::bad_request("expected `name` or `map`, not both")),
            (_, Some(map)) => {
                let bad = |error| Refusal::bad_request(format!("`map`: {error}"));
                let spec = map.spec.checked().map_err(bad)?;
                let grid = OccupancyGrid::from_values(spec, map.values.clone()).map_err(bad)?;
                (grid, MapRecord::default())
            }
            (name, None) => {
                let folder = self.folder(name.as_deref())?;
                let loaded = tokio::task::spawn_blocking(move || store::load(&folder));
                let stored = loaded.await.map_err(Refusal::internal)?.map_err(Refusal::internal)?;
                let StoredMap { grid, record } = stored.ok_or_else(|| Refusal::NotFound {
                    what: match name {
                        Some(name) => format!("stored map `{name}`"),
                        None => "a stored map of the robot".to_owned(),
                    },
                })?;
                (grid, record)
            }
        };
        if grid.spec().is_empty() {
            return Err(Refusal::rejected("the map cannot be loaded: it has no cells"));
        }
        let map = new_map(&self.config.robot);
        tracing::info!(
            robot = self.config.robot,
            map = map.id,
            live = request.live,
            "map loaded"
        );
        self.core.load(map, &grid, record.trajectory, record.scans);
        if request.live {
            self.core.mapper.resume();
        }
        Ok(())
    }

    /// The maps with names.
    pub(super) async fn stored_maps(&self) -> Result<Vec<StoredMapInfo>, Refusal> {
        let Ok(folder) = self.folder(None) else {
            return Ok(Vec::new());
        };
        let listed = tokio::task::spawn_blocking(move || store::list(&folder.join(MAPS)));
        let listed = listed.await.map_err(Refusal::internal)?.map_err(Refusal::internal)?;
        let info = |(name, record): (String, MapRecord)| StoredMapInfo {
            name,
            map: record.map,
            scans: record.scans,
        };
        Ok(listed.into_iter().map(info).collect())
    }
}
