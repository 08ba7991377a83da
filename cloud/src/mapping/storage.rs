//! Storage. What does a mapping service find in its robot's folder, and who else uses that folder?
//!
//! The folder has a lock, the last terms of leadership, the robot's own map, and with SLAM its session. What a leader stores there is in
//! `lead/session.rs` and `lead/stored_maps.rs`.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read as _, Seek as _, Write as _};
use std::path::Path;

use zenav_mapping::store::{self, StoredMap};
use zenav_mapping::{Mapper, write_atomically};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{MapRef, MappingLeader};

use super::follow::Followed;
use super::slam_session::{self, KeepError, Stored};
use super::{KnownMap, MappingConfig, MappingError, PoseSource};

/// Lock file of the mapping service, in a robot's folder.
const LOCK: &str = "mapping.lock";

/// File with the last term of leadership that is known, in a robot's folder.
const TERM: &str = "mapping.term";

/// File with the last term in which a service led with the map that is stored in a robot's folder.
const LED: &str = "mapping.led";

/// Suffix of a session that cannot be decoded.
const UNREADABLE: &str = "unreadable";

/// Longest name that is read from the lock file, bytes.
const MAX_NAME: u64 = 256;

/// The lock of a robot's folder against other mapping services, as long as it lives; none if the folder is not writable or has no locks.
#[derive(Debug, Default)]
pub(super) struct Tenancy {
    _file: Option<File>,
    /// Name of the service that locked the folder before.
    before: String,
}

impl Tenancy {
    /// Whether the folder was that of a leader: what is stored in it is of its map.
    pub(super) fn was_of(&self, leader: &MappingLeader) -> bool {
        !leader.name.is_empty() && self.before == leader.name
    }
}

/// Locks a robot's folder; `None` if it is not writable, or has no locks.
///
/// # Errors
/// [`MappingError::InUse`] if another service holds the lock.
pub(super) fn guard(folder: &Path) -> Result<Option<File>, MappingError> {
    let open = || {
        let file = folder.join(LOCK);
        OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(file)
    };
    let Ok(file) = std::fs::create_dir_all(folder).and_then(|()| open()) else {
        return Ok(None);
    };
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Err(MappingError::InUse(folder.to_owned())),
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// Locks a robot's folder, and leaves this service's name in the lock file.
///
/// # Errors
/// [`MappingError::InUse`] if another service holds the lock.
pub(super) fn lock(folder: &Path, name: &str) -> Result<Tenancy, MappingError> {
    let Some(mut file) = guard(folder)? else {
        return Ok(Tenancy::default());
    };
    let mut before = String::new();
    // A name that cannot be read or written is that of no leader.
    let _ = (&file).take(MAX_NAME).read_to_string(&mut before);
    let _ = file
        .set_len(0)
        .and_then(|()| file.rewind())
        .and_then(|()| file.write_all(name.as_bytes()));
    Ok(Tenancy {
        _file: Some(file),
        before,
    })
}

/// Notes a term in a robot's folder, unless a later one is noted there. Returns the later of both.
///
/// A service begins behind all terms that it knows of, also after a restart: its own leadership must not look like an old one.
pub(super) fn note_term(robot: &str, folder: Option<&Path>, term: u64) -> u64 {
    let Some(folder) = folder else { return term };
    let noted = noted(robot, folder, TERM);
    if term > noted {
        write(robot, folder, TERM, term);
    }
    term.max(noted)
}

/// Notes the term in which a service leads with the map or the session that is stored in a robot's folder: as it begins with that, or
/// once it has stored its own whole map.
pub(super) fn note_leadership(robot: &str, folder: Option<&Path>, term: u64) {
    note_term(robot, folder, term);
    if let Some(folder) = folder
        && noted(robot, folder, LED) != term
    {
        write(robot, folder, LED, term);
    }
}

/// Whether a robot's folder is that of the last leader that is known there: what is stored in it may be the newest map.
pub(super) fn is_of_last_leader(robot: &str, folder: Option<&Path>) -> bool {
    folder.is_some_and(|folder| {
        let led = noted(robot, folder, LED);
        led > 0 && led >= noted(robot, folder, TERM)
    })
}

/// Whether what is stored in a robot's folder is the whole map of the service that led in this term.
pub(super) fn has_map_of_term(robot: &str, folder: Option<&Path>, term: u64) -> bool {
    folder.is_some_and(|folder| noted(robot, folder, LED) == term)
}

/// The term in a file of a robot's folder; 0 if there is none.
fn noted(robot: &str, folder: &Path, file: &str) -> u64 {
    let file = folder.join(file);
    match std::fs::read_to_string(&file) {
        Ok(text) => text.trim().parse().unwrap_or_else(|error| {
            tracing::error!(robot, file = %file.display(), %error, "the last term of leadership cannot be read");
            0
        }),
        Err(_) => 0,
    }
}

fn write(robot: &str, folder: &Path, file: &str, term: u64) {
    let file = folder.join(file);
    let written = std::fs::create_dir_all(folder).map_err(|error| error.to_string());
    let written =
        written.and_then(|()| write_atomically(&file, term.to_string().as_bytes()).map_err(|error| error.to_string()));
    if let Err(error) = written {
        tracing::error!(robot, file = %file.display(), %error, "the term of leadership is not stored");
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

/// The map of the leader that a copy has followed, under a new id.
pub(super) fn inherit(config: &MappingConfig, leader: &MappingLeader, followed: &Followed) -> Mapper {
    let map = MapRef {
        frame: followed.replica.map().frame,
        ..new_map(&config.robot)
    };
    let info = followed
        .info
        .as_ref()
        .filter(|info| info.map.id == followed.replica.map().id);
    let mut mapper = Mapper::inheriting(config.settings.clone(), map, followed.replica.grid(), info);
    if leader.held {
        mapper.hold();
    }
    mapper
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
                let mut mapper = Mapper::with_stored(
                    config.settings.clone(),
                    new_map(robot),
                    &grid,
                    record.trajectory,
                    record.scans,
                );
                mapper.restore_touched(&record.touched);
                return Ok(mapper);
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

/// Reference to an empty map with a new id, at revision 0.
pub(super) fn new_map(robot: &str) -> MapRef {
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
