//! Session of SLAM. The SLAM state of a robot that outlives its process.
//!
//! Two files and a folder in the robot's folder. `slam.scans`: the scan of each node, one line of JSON each, in node order; it only grows.
//! `slam.base`: the map that SLAM began in and did not make, if there is one, as `zenav_mapping::store` keeps it; it never changes.
//! `slam.session`: one line of JSON with the frame and its data, then the bytes of [`Slam::save`]; it is replaced atomically, after the
//! scans and the map that it refers to are on disk. Later scans in `slam.scans` belong to no session and are overwritten. So whatever fails,
//! the previously stored session stays whole.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, BufReader, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use thiserror::Error;
use zenav_mapping::store::{self, MapRecord, StoredMap};
use zenav_mapping::{MapFileError, MapSnapshot, write_atomically};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_slam::{SessionError, Slam, Snapshot};

use super::annotations::Carried;

/// Poses, measurements and the frame.
const SESSION: &str = "slam.session";
/// Scans of the nodes.
const SCANS: &str = "slam.scans";
/// The map that SLAM began in.
const BASE: &str = "slam.base";

/// Data of a SLAM map besides its poses and measurements.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Head {
    /// The frame of the drawn map.
    pub(super) frame: u64,
    /// The moves into the last frames, newest last.
    pub(super) moves: Vec<Pose2>,
    /// How the robot's surroundings have moved since the map was drawn.
    pub(super) new_from_drawn: Pose2,
    /// Correction of odometry by the last scan, in the drawn map.
    pub(super) map_from_odom: Pose2,
    /// The robot's boot that odometry belongs to.
    pub(super) boot_id: String,
    /// Number of scans of the session: one for each node.
    pub(super) scans: usize,
    /// Poses of the map's parts in the drawn map.
    #[serde(default)]
    pub(super) parts: Vec<Pose2>,
    /// Where places and zones lie in the frame.
    #[serde(default)]
    pub(super) annotations: Carried,
    /// Id of the map that SLAM began in and did not make; empty if it made its map itself.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub(super) base: String,
}

/// What of a session is on disk already.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct OnDisk {
    /// Number of scans that belong to it.
    pub(super) scans: usize,
    /// Their length, bytes.
    pub(super) bytes: u64,
    /// Whether the map that it began in is there, if it began in one.
    pub(super) has_base: bool,
}

/// A session to store, with what of it is not on disk yet.
#[derive(Debug)]
pub(super) struct Kept {
    pub(super) head: Head,
    pub(super) session: Snapshot,
    /// Number of the change that it leads a successor to.
    pub(super) change: u64,
    pub(super) on_disk: OnDisk,
    pub(super) scans: Vec<Arc<Scan>>,
    /// The map that SLAM began in.
    pub(super) base: Option<MapSnapshot>,
}

/// A session that is on disk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Written {
    /// The frame of its map.
    pub(super) frame: u64,
    /// Number of the change that it leads a successor to.
    pub(super) change: u64,
    pub(super) on_disk: OnDisk,
}

/// A session as read from disk.
#[derive(Debug)]
pub(super) struct Stored {
    pub(super) head: Head,
    pub(super) slam: Slam,
    pub(super) scans: Vec<Scan>,
    /// The map that SLAM began in.
    pub(super) base: Option<StoredMap>,
    pub(super) on_disk: OnDisk,
}

/// Why a session cannot be stored or resumed.
#[derive(Debug, Error)]
pub(super) enum KeepError {
    /// A file cannot be read or written.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// A file cannot be replaced.
    #[error(transparent)]
    File(#[from] MapFileError),
    /// The file's content cannot be parsed.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// The writing task failed.
    #[error(transparent)]
    Task(#[from] tokio::task::JoinError),
    /// The session cannot be encoded or decoded.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Scans are missing, or do not belong to the session.
    #[error("expected {expected} scans in `{SCANS}`, found {found}")]
    Scans {
        /// Number of nodes of the session.
        expected: usize,
        /// Number of scans found.
        found: usize,
    },
    /// The map that SLAM began in is missing, or another one.
    #[error("expected the map `{expected}` in `{BASE}`, in which the session began")]
    Base {
        /// Id of that map.
        expected: String,
    },
    /// The scans on disk are not those that were written: all must be written again.
    #[error("expected {expected} bytes of scans in `{SCANS}`, found {found}: somebody else changed the file")]
    Changed {
        /// Bytes written so far.
        expected: u64,
        /// Bytes found.
        found: u64,
    },
}

/// Stores a session in a folder. When this returns, the session is on disk; the result says what of it need not be written again.
pub(super) fn write(folder: &Path, kept: Kept) -> Result<OnDisk, KeepError> {
    fs::create_dir_all(folder)?;
    if let Some(base) = &kept.base {
        let stored = StoredMap {
            grid: base.grid(),
            record: MapRecord {
                map: base.info.map.clone(),
                touched: base.touched.clone(),
                ..MapRecord::default()
            },
        };
        store::save(&folder.join(BASE), &stored)?;
    }
    let mut lines = Vec::new();
    for scan in &kept.scans {
        serde_json::to_writer(&mut lines, scan.as_ref())?;
        lines.push(b'\n');
    }
    let path = folder.join(SCANS);
    if kept.on_disk.scans == 0 {
        write_atomically(&path, &lines)?;
    } else {
        append(&path, kept.on_disk.bytes, &lines)?;
    }
    let mut bytes = serde_json::to_vec(&kept.head)?;
    bytes.push(b'\n');
    bytes.extend_from_slice(&kept.session.into_bytes()?);
    write_atomically(&folder.join(SESSION), &bytes)?;
    Ok(OnDisk {
        scans: kept.on_disk.scans + kept.scans.len(),
        bytes: kept.on_disk.bytes + lines.len() as u64,
        has_base: !kept.head.base.is_empty(),
    })
}

/// Writes lines after the first `end` bytes of a file, overwriting anything there.
fn append(path: &Path, end: u64, lines: &[u8]) -> Result<(), KeepError> {
    let mut file = match OpenOptions::new().read(true).write(true).open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let (expected, found) = (end, 0);
            return Err(KeepError::Changed { expected, found });
        }
        opened => opened?,
    };
    let found = file.metadata()?.len();
    let mut last = [0];
    if found >= end && end > 0 {
        file.seek(io::SeekFrom::Start(end - 1))?;
        file.read_exact(&mut last)?;
    }
    if last != [b'\n'] {
        return Err(KeepError::Changed { expected: end, found });
    }
    file.write_all(lines)?;
    file.set_len(end + lines.len() as u64)?;
    file.sync_all()?;
    Ok(())
}

/// Reads the session of a folder; `None` if there is none.
pub(super) fn read(folder: &Path) -> Result<Option<Stored>, KeepError> {
    let bytes = match fs::read(folder.join(SESSION)) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error.into()),
    };
    let line = bytes.iter().position(|byte| *byte == b'\n').unwrap_or(bytes.len());
    let head: Head = serde_json::from_slice(&bytes[..line])?;
    let slam = Slam::load(bytes.get(line + 1..).unwrap_or_default())?;
    let base = match head.base.as_str() {
        "" => None,
        id => Some(read_base(folder, id)?),
    };
    let expected = slam.nodes().len();
    let mut scans = Vec::with_capacity(expected);
    let mut length = 0;
    let file = match File::open(folder.join(SCANS)) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Err(KeepError::Scans { expected, found: 0 });
        }
        opened => opened?,
    };
    for line in BufReader::new(file).split(b'\n').take(expected) {
        let line = line?;
        scans.push(serde_json::from_slice(&line)?);
        length += line.len() as u64 + 1;
    }
    if scans.len() != expected || head.scans != expected {
        let found = scans.len();
        return Err(KeepError::Scans { expected, found });
    }
    let on_disk = OnDisk {
        scans: expected,
        bytes: length,
        has_base: base.is_some(),
    };
    Ok(Some(Stored {
        head,
        slam,
        scans,
        base,
        on_disk,
    }))
}

/// Reads the map of this id, in which the session of a folder began.
fn read_base(folder: &Path, id: &str) -> Result<StoredMap, KeepError> {
    let stored = store::load(&folder.join(BASE))?;
    stored
        .filter(|stored| stored.record.map.id == id)
        .ok_or_else(|| KeepError::Base {
            expected: id.to_owned(),
        })
}

/// Whether there is a session in a folder.
pub(super) fn is_in(folder: &Path) -> io::Result<bool> {
    folder.join(SESSION).try_exists()
}

/// Deletes the session of a folder.
pub(super) fn remove(folder: &Path) -> io::Result<()> {
    // The session goes first: without it the scans mean nothing.
    for name in [SESSION, SCANS] {
        match fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    match fs::remove_dir_all(folder.join(BASE)) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Moves a session out of the way, to unused names: `slam.session.KIND`, or the same with a number appended. Returns the session's new
/// path; `None` if there is none.
pub(super) fn set_aside(folder: &Path, kind: &str) -> io::Result<Option<PathBuf>> {
    if !is_in(folder)? {
        return Ok(None);
    }
    let mut number = 1;
    let aside = loop {
        let suffix = if number == 1 {
            kind.to_owned()
        } else {
            format!("{kind}.{number}")
        };
        let names = [SCANS, BASE, SESSION].map(|name| folder.join(format!("{name}.{suffix}")));
        let mut taken = false;
        for name in &names {
            taken |= name.try_exists()?;
        }
        if !taken {
            break names;
        }
        number += 1;
    };
    // The session last: left without the rest it is still recognised, while the rest left alone would be overwritten.
    for (name, aside) in [SCANS, BASE, SESSION].into_iter().zip(&aside) {
        match fs::rename(folder.join(name), aside) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    let [.., session] = aside;
    Ok(Some(session))
}

impl KeepError {
    /// Whether a file could not be read, which does not mean that its content is bad.
    pub(super) fn is_transient(&self) -> bool {
        match self {
            Self::Io(_) => true,
            Self::File(MapFileError::Io { source, .. }) => source.kind() != io::ErrorKind::NotFound,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests;
