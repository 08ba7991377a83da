//! Session of SLAM. What of SLAM beside a robot outlives its process?
//!
//! Two files in the robot's folder. `slam.scans`: the scan of each node, a line of JSON each, in the order of the nodes; it only grows. `slam.session`:
//! a line of JSON with the frame and what belongs to it, then the bytes of [`Slam::save`]; it is replaced at once or not at all, after the
//! scans that it counts on are on disk. What follows them in `slam.scans` belongs to nothing, and goes.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, BufReader, Seek, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};
use thiserror::Error;
use zenav_mapping::atomic::write_atomically;
use zenav_mapping::map_file::MapFileError;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_slam::{SessionError, Slam};

/// Poses, measurements and the frame.
const SESSION: &str = "slam.session";
/// Scans of the nodes.
const SCANS: &str = "slam.scans";
/// Longest line of `slam.scans`, bytes: a scan as it comes over the network.
const LONGEST: usize = 1 << 20;

/// What belongs to a map by SLAM beside its poses and measurements.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Head {
    /// The frame of the map as it was drawn.
    pub(super) frame: u64,
    /// The moves into the last frames, the one into this frame last.
    pub(super) moves: Vec<Pose2>,
    /// How the robot's surroundings have moved since the map was drawn.
    pub(super) new_from_drawn: Pose2,
    /// The correction of odometry by the last scan, in the drawn map.
    pub(super) map_from_odom: Pose2,
    /// The robot's boot that odometry belongs to.
    pub(super) boot_id: String,
    /// How many scans belong to it: one for each node.
    pub(super) scans: usize,
}

/// What is to be kept: a session, and of its scans those from a node on; the ones before are on disk already.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    pub(super) head: Head,
    pub(super) session: Vec<u8>,
    pub(super) first: usize,
    pub(super) scans: Vec<Scan>,
}

/// A session as it was read.
#[derive(Debug)]
pub(super) struct Stored {
    pub(super) head: Head,
    pub(super) slam: Slam,
    pub(super) scans: Vec<Scan>,
}

/// Why a session cannot be kept, or gone on with.
#[derive(Debug, Error)]
pub(super) enum KeepError {
    /// A file cannot be read or written.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// A file cannot be replaced.
    #[error(transparent)]
    File(#[from] MapFileError),
    /// What is written there cannot be understood.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// The map is none.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Scans are missing, or do not belong to the session.
    #[error("expected {expected} scans in `{SCANS}`, found {found}")]
    Scans {
        /// As many as the session has nodes.
        expected: usize,
        /// What there is.
        found: usize,
    },
}

/// Keeps a session in a folder; it is on disk when this returns.
pub(super) fn write(folder: &Path, kept: &Kept) -> Result<(), KeepError> {
    fs::create_dir_all(folder)?;
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(folder.join(SCANS))?;
    let end = end_of(&file, kept.first)?;
    file.set_len(end)?;
    let mut lines = Vec::new();
    for scan in &kept.scans {
        serde_json::to_writer(&mut lines, scan)?;
        lines.push(b'\n');
    }
    (&file).seek(io::SeekFrom::Start(end))?;
    (&file).write_all(&lines)?;
    file.sync_all()?;
    let mut bytes = serde_json::to_vec(&kept.head)?;
    bytes.push(b'\n');
    bytes.extend_from_slice(&kept.session);
    write_atomically(&folder.join(SESSION), &bytes)?;
    Ok(())
}

/// The session of a folder; `None` where there is none.
pub(super) fn read(folder: &Path) -> Result<Option<Stored>, KeepError> {
    let bytes = match fs::read(folder.join(SESSION)) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error.into()),
    };
    let line = bytes.iter().position(|byte| *byte == b'\n').unwrap_or(bytes.len());
    let head: Head = serde_json::from_slice(&bytes[..line])?;
    let slam = Slam::load(bytes.get(line + 1..).unwrap_or_default())?;
    let expected = slam.nodes().len();
    let mut scans = Vec::with_capacity(expected);
    for line in BufReader::new(File::open(folder.join(SCANS))?).split(b'\n').take(expected) {
        scans.push(serde_json::from_slice(&line?)?);
    }
    if scans.len() != expected || head.scans != expected {
        let found = scans.len();
        return Err(KeepError::Scans { expected, found });
    }
    Ok(Some(Stored { head, slam, scans }))
}

/// Forgets the session of a folder.
pub(super) fn remove(folder: &Path) -> io::Result<()> {
    // Without the session the scans are nothing: it goes first.
    for name in [SESSION, SCANS] {
        match fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    Ok(())
}

/// Takes a session that cannot be read out of the way.
pub(super) fn set_aside(folder: &Path) -> io::Result<()> {
    for name in [SESSION, SCANS] {
        match fs::rename(folder.join(name), folder.join(format!("{name}.unreadable"))) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    Ok(())
}

/// Where in a file so many lines end, bytes.
fn end_of(file: &File, lines: usize) -> Result<u64, KeepError> {
    let mut reader = BufReader::new(file);
    let (mut end, mut found) = (0, 0);
    let mut line = Vec::new();
    while found < lines {
        line.clear();
        let count = io::Read::take(&mut reader, LONGEST as u64).read_until(b'\n', &mut line)?;
        if line.last() != Some(&b'\n') {
            return Err(KeepError::Scans { expected: lines, found });
        }
        end += count as u64;
        found += 1;
    }
    Ok(end)
}
