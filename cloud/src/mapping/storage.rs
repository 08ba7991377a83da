//! Storage. With which map does mapping begin, and how is it saved?

use zenav_mapping::Mapper;
use zenav_mapping::store::{self, MapRecord, StoredMap};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{MapRef, Refusal};

use super::{MappingConfig, Service};

/// The stored map, or a new one.
pub(super) async fn begin(config: &MappingConfig) -> Mapper {
    let robot = &config.robot;
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
                let map = MapRef {
                    id: new_map_id(robot),
                    revision: 0,
                };
                return Mapper::with_stored(config.settings.clone(), map, &grid, record.trajectory, record.scans);
            }
            Ok(Ok(None)) => {}
            Ok(Err(error)) => tracing::error!(robot, %error, "the stored map cannot be read: mapping begins a new one"),
            Err(error) => tracing::error!(robot, %error, "loading the stored map failed: mapping begins a new one"),
        }
    }
    Mapper::new(config.settings.clone(), new_map_id(robot))
}

/// An id that no map had before.
pub(super) fn new_map_id(robot: &str) -> String {
    format!("{robot}-{}", Id::unique())
}

impl Service {
    /// Saves the map; scans wait meanwhile.
    pub(super) async fn save(&mut self) -> Result<(), Refusal> {
        let Some(folder) = self.config.folder.clone() else {
            return Err(Refusal::rejected(
                "the map cannot be saved: mapping was given no folder",
            ));
        };
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
                self.core.mapper.mark_stored();
                Ok(())
            }
            Ok(Err(reason)) | Err(reason) => Err(Refusal::Internal { reason }),
        }
    }
}
