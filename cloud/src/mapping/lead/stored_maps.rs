//! Stored maps. The leader's requests `save`, `load` and `list`: the robot's own map lies in its folder, and the next start uses it; named maps
//! lie in `maps/NAME` below it.

use std::path::PathBuf;

use zenav_mapping::store::{self, MapRecord, StoredMap};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{MapRequest, Refusal, StoredMapInfo};
use zenav_protocol::time::Stamp;

use super::super::storage::new_map;
use super::Leadership;

/// Folder of named maps, in a robot's folder.
const MAPS: &str = "maps";

impl Leadership {
    /// Folder of a stored map: the robot's own, or the named one.
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
    pub(super) async fn save(&mut self, name: Option<&str>, now: Stamp) -> Result<(), Refusal> {
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
                    touched: map.touched,
                },
            };
            store::save(&folder, &stored).map_err(|error| error.to_string())
        });
        match saved.await.map_err(|error| error.to_string()) {
            Ok(Ok(path)) => {
                tracing::info!(robot = self.config.robot, file = %path.display(), "map saved");
                if name.is_none() {
                    self.leave_map(now).await?;
                    self.core.mark_stored();
                }
                Ok(())
            }
            Ok(Err(reason)) | Err(reason) => Err(Refusal::Internal { reason }),
        }
    }

    /// Replaces the map by the one in the request, or by a stored one; scans wait meanwhile.
    pub(super) async fn load(&mut self, request: &MapRequest, now: Stamp) -> Result<(), Refusal> {
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
        self.forget_session(now).await?;
        let map = new_map(&self.config.robot);
        tracing::info!(
            robot = self.config.robot,
            map = map.id,
            live = request.live,
            "map loaded"
        );
        self.core.load(map, &grid, record.trajectory, record.scans);
        self.core.mapper.restore_touched(&record.touched);
        self.core.locate_first();
        if request.live {
            self.core.mapper.resume();
        }
        Ok(())
    }

    /// The named maps.
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
