//! Storage. The map that mapping starts with, and storing and loading of maps.
//!
//! The robot's own map lies in its folder, and the next start uses it; named maps lie in `maps/NAME` below it. With SLAM, the session is
//! stored beside the map as it grows, and the next start resumes it.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use tokio::task::JoinHandle;
use zenav_mapping::Mapper;
use zenav_mapping::store::{self, MapRecord, StoredMap};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{MapRef, MapRequest, Refusal, StoredMapInfo};
use zenav_protocol::time::Stamp;

use super::slam_session::{self, KeepError, Stored};
use super::{KnownMap, MappingConfig, MappingError, PoseSource, Service};

/// Folder of named maps, in a robot's folder.
const MAPS: &str = "maps";

/// Lock file of the mapping service, in a robot's folder.
const LOCK: &str = "mapping.lock";

/// Pause after a failed attempt to store the session, s.
const KEEP_AGAIN: f64 = 10.0;

/// Suffix of a session set aside for another one.
const BEFORE: &str = "before";
/// Suffix of a session that cannot be decoded.
const UNREADABLE: &str = "unreadable";

/// Locks a robot's folder against other mapping services as long as the file lives; `None` if the folder is not writable or has no locks.
///
/// # Errors
/// [`MappingError::InUse`] if another service holds the lock.
pub(super) fn lock(folder: &Path) -> Result<Option<File>, MappingError> {
    let made = std::fs::create_dir_all(folder).and_then(|()| File::create(folder.join(LOCK)));
    let Ok(file) = made else { return Ok(None) };
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Err(MappingError::InUse(folder.to_owned())),
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// The SLAM session to resume, if there is one. A session that cannot be decoded is set aside for inspection.
///
/// # Errors
/// [`MappingError::Session`] if it cannot be read from disk or set aside: a session that may be intact is never replaced.
pub(super) async fn session(config: &MappingConfig) -> Result<Option<Stored>, MappingError> {
    let goes_on = config.poses.source == PoseSource::Slam && config.known.is_none();
    let Some(folder) = config.folder.clone().filter(|_| goes_on) else {
        return Ok(None);
    };
    let robot = &config.robot;
    let failed = |problem: String| MappingError::Session {
        folder: folder.clone(),
        problem,
    };
    let reading = folder.clone();
    let read = tokio::task::spawn_blocking(move || slam_session::read(&reading)).await;
    let error = match read.unwrap_or_else(|error| Err(KeepError::Task(error))) {
        Ok(stored) => {
            if let Some(stored) = &stored {
                let (nodes, frame) = (stored.scans.len(), stored.head.frame);
                tracing::info!(robot, nodes, frame, "SLAM goes on with its session");
            }
            return Ok(stored);
        }
        Err(error) if error.is_transient() => return Err(failed(error.to_string())),
        Err(error) => error,
    };
    let reading = folder.clone();
    let aside = tokio::task::spawn_blocking(move || slam_session::set_aside(&reading, UNREADABLE));
    match aside.await.map_err(KeepError::from).and_then(|aside| Ok(aside?)) {
        Ok(aside) => {
            let aside = aside.unwrap_or_default();
            tracing::error!(
                robot,
                %error,
                aside = %aside.display(),
                "the session of SLAM cannot be read and is set aside: SLAM begins a new map"
            );
            Ok(None)
        }
        Err(problem) => Err(failed(format!("{error}, and it cannot be set aside: {problem}"))),
    }
}

/// An empty map, for a resumed session.
pub(super) fn empty(config: &MappingConfig) -> Mapper {
    Mapper::new(config.settings.clone(), new_map_id(&config.robot))
}

/// The given map, or the stored map, or a new one.
///
/// # Errors
/// [`MappingError::StoredMap`] for an unreadable map that the robot is to be localised in; otherwise a new map is started.
pub(super) async fn begin(config: &MappingConfig) -> Result<Mapper, MappingError> {
    let robot = &config.robot;
    if let Some(KnownMap { grid, live }) = &config.known {
        let mut mapper = Mapper::with_stored(config.settings.clone(), new_map(robot), grid, Vec::new(), 0);
        if *live {
            mapper.resume();
        }
        return Ok(mapper);
    }
    if let Some(folder) = config.folder.clone() {
        let reading = folder.clone();
        match tokio::task::spawn_blocking(move || store::load(&reading)).await {
            Ok(Ok(Some(StoredMap { grid, record }))) => {
                tracing::info!(
                    robot,
                    stored = record.map.id,
                    revision = record.map.revision,
                    "stored map loaded"
                );
                // A new id: revisions of the last run that were never stored must not be mistaken for these.
                return Ok(Mapper::with_stored(
                    config.settings.clone(),
                    new_map(robot),
                    &grid,
                    record.trajectory,
                    record.scans,
                ));
            }
            Ok(Ok(None)) => {}
            Ok(Err(error)) if config.poses.source == PoseSource::Localise => {
                let problem = error.to_string();
                return Err(MappingError::StoredMap { folder, problem });
            }
            Ok(Err(error)) => tracing::error!(robot, %error, "the stored map cannot be read: mapping begins a new one"),
            Err(error) => tracing::error!(robot, %error, "loading the stored map failed: mapping begins a new one"),
        }
    }
    Ok(empty(config))
}

/// A new map.
fn new_map(robot: &str) -> MapRef {
    MapRef {
        id: new_map_id(robot),
        revision: 0,
        frame: 0,
    }
}

/// A new, unique map id.
pub(super) fn new_map_id(robot: &str) -> String {
    format!("{robot}-{}", Id::unique())
}

/// Sets aside a session of an earlier run that this run did not resume.
fn make_room(robot: &str, folder: &Path) -> io::Result<()> {
    if let Some(aside) = slam_session::set_aside(folder, BEFORE)? {
        tracing::warn!(
            robot,
            aside = %aside.display(),
            "SLAM did not begin with its session, as a map was given: the session is set aside"
        );
    }
    Ok(())
}

impl Service {
    /// Stores the session of SLAM if due. A session of a new frame, or one requested by `anyway`, is on disk when this returns; otherwise
    /// it is written in the background.
    ///
    /// # Errors
    /// If a session requested by `anyway` is not on disk; other failures are retried after a while.
    pub(super) async fn keep(&mut self, now: Stamp, anyway: bool) -> Result<(), Refusal> {
        let Some(folder) = self.config.folder.clone() else {
            return Ok(());
        };
        if anyway || self.keeping.as_ref().is_some_and(JoinHandle::is_finished) {
            // A failed write is due again.
            let _ = self.was_kept(now).await;
        }
        if self.rests(now) && !anyway || !self.core.is_keep_due(anyway) {
            return Ok(());
        }
        if self.was_kept(now).await.is_err() && !anyway {
            return Ok(());
        }
        let kept = match self.core.kept() {
            Ok(Some(mut kept)) => {
                kept.head.annotations = self.annotations.carried();
                kept
            }
            Ok(None) => return Ok(()),
            Err(error) => return self.is_not_kept(now, &error.into()),
        };
        let is_new = kept.head.frame != self.kept_frame;
        let (robot, is_own) = (self.config.robot.clone(), self.owns_session);
        self.keeping = Some(tokio::task::spawn_blocking(move || {
            if !is_own {
                make_room(&robot, &folder)?;
            }
            Ok((kept.head.frame, slam_session::write(&folder, kept)?))
        }));
        if !is_new && !anyway {
            return Ok(());
        }
        let kept = self.was_kept(now).await;
        if anyway { kept } else { Ok(()) }
    }

    /// Whether storing pauses because the last attempt failed.
    fn rests(&self, now: Stamp) -> bool {
        let since = |then: Stamp| now.secs_since(then) < KEEP_AGAIN && now >= then;
        self.not_kept.is_some_and(since)
    }

    /// Waits until the session being written is on disk.
    async fn was_kept(&mut self, now: Stamp) -> Result<(), Refusal> {
        let Some(keeping) = self.keeping.take() else {
            return Ok(());
        };
        match keeping.await.unwrap_or_else(|error| Err(KeepError::Task(error))) {
            Ok((frame, on_disk)) => {
                self.kept_frame = frame;
                self.owns_session = true;
                self.not_kept = None;
                self.core.was_kept(on_disk);
                Ok(())
            }
            Err(error) => self.is_not_kept(now, &error),
        }
    }

    fn is_not_kept(&mut self, now: Stamp, error: &KeepError) -> Result<(), Refusal> {
        tracing::error!(
            robot = self.config.robot,
            %error,
            "the session of SLAM is not kept: after a restart its map is as it was before"
        );
        self.not_kept = Some(now);
        self.core.was_not_kept(matches!(error, KeepError::Changed { .. }));
        Err(Refusal::internal(format!("the session of SLAM is not kept: {error}")))
    }

    /// Deletes the session of SLAM because another map is to start. A session that this run did not resume is set aside; with other pose
    /// sources there is nothing to delete.
    pub(super) async fn forget_session(&mut self, now: Stamp) -> Result<(), Refusal> {
        let _ = self.was_kept(now).await;
        let is_slam = self.config.poses.source == PoseSource::Slam;
        let Some(folder) = self.config.folder.clone().filter(|_| is_slam) else {
            return Ok(());
        };
        let (robot, is_own) = (self.config.robot.clone(), self.owns_session);
        let removed = tokio::task::spawn_blocking(move || {
            if is_own {
                slam_session::remove(&folder)
            } else {
                make_room(&robot, &folder)
            }
        });
        let removed = removed.await.map_err(Refusal::internal)?;
        removed.map_err(|error| Refusal::internal(KeepError::from(error)))
    }

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
