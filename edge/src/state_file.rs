//! State file. What survives a restart of the edge? The last epoch, the stop latch and which store leads, in one small file that is
//! replaced atomically: write beside it, fsync, rename, fsync the folder. A lock file beside it keeps a second edge out.
//!
//! On a full or read-only disk the file is opened all the same: a robot that cannot store anything can still be watched and stopped.

use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use thiserror::Error;
use zenav_protocol::id::Id;

use crate::control_io::Persisted;

/// The state file of one robot, locked while it is open.
#[derive(Clone, Debug)]
pub struct StateFile {
    path: PathBuf,
    lock_path: PathBuf,
    /// Locked while the state is in use; `None` while the disk has no room for it.
    lock: Arc<Mutex<Option<File>>>,
}

/// Why the state could not be read or written. A robot whose epochs and stop latch are unknown must not start.
#[derive(Debug, Error)]
pub enum StateError {
    /// The folder or the file cannot be used.
    #[error("{path}: {source}")]
    Io {
        /// The path that failed.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// Another edge uses the robot's state.
    #[error("{path}: in use by another edge; expected one process a robot")]
    Locked {
        /// The locked file.
        path: PathBuf,
    },
    /// The file does not hold edge state.
    #[error("{path} holds no edge state ({source}); remove it only if nobody can still hold an old lease")]
    Malformed {
        /// Path of the file.
        path: PathBuf,
        /// Where it goes wrong.
        source: serde_json::Error,
    },
}

impl StateError {
    /// Whether the disk is full or read-only, which may change.
    #[must_use]
    pub fn may_pass(&self) -> bool {
        matches!(self, Self::Io { source, .. } if has_no_room(source))
    }
}

fn has_no_room(error: &io::Error) -> bool {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    matches!(
        error.kind(),
        StorageFull | ReadOnlyFilesystem | QuotaExceeded | FileTooLarge
    )
}

impl StateFile {
    /// The file of a robot in a folder, which is created if it is missing and the disk has room.
    ///
    /// ```
    /// # let folder = tempfile::tempdir()?;
    /// use zenav_edge::{Persisted, state_file::{StateError, StateFile}};
    /// use zenav_protocol::id::Id;
    ///
    /// let tiago = Id::robot("tiago")?;
    /// let file = StateFile::open(folder.path(), &tiago)?;
    /// assert_eq!(file.load()?, Persisted::default());
    /// file.save(&Persisted { epoch: 7, ..Persisted::default() })?;
    /// assert_eq!(file.load()?.epoch, 7);
    /// assert!(matches!(StateFile::open(folder.path(), &tiago), Err(StateError::Locked { .. })), "one edge for each robot");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`StateError::Io`] when the folder cannot be made; [`StateError::Locked`] while another edge has it.
    pub fn open(folder: &Path, robot: &Id) -> Result<Self, StateError> {
        let file = Self {
            path: folder.join(format!("edge-{robot}.json")),
            lock_path: folder.join(format!("edge-{robot}.lock")),
            lock: Arc::default(),
        };
        match file.claim() {
            Err(error) if !error.may_pass() => Err(error),
            _ => Ok(file),
        }
    }

    /// Locks the state for this edge, unless it is locked already.
    fn claim(&self) -> Result<(), StateError> {
        let mut held = self.lock.lock().unwrap_or_else(PoisonError::into_inner);
        if held.is_some() {
            return Ok(());
        }
        let path = self.lock_path.clone();
        let made = match path.parent() {
            Some(folder) => fs::create_dir_all(folder),
            None => Ok(()),
        };
        // An existing lock file can be locked on a read-only disk too.
        let opened = made
            .and_then(|()| File::create(&path))
            .or_else(|error| File::open(&path).map_err(|_| error));
        let file = opened.map_err(|source| StateError::Io {
            path: path.clone(),
            source,
        })?;
        match file.try_lock() {
            Ok(()) => *held = Some(file),
            Err(TryLockError::WouldBlock) => return Err(StateError::Locked { path }),
            Err(TryLockError::Error(source)) => return Err(StateError::Io { path, source }),
        }
        Ok(())
    }

    /// The persisted state; the default when there is no file yet.
    ///
    /// # Errors
    /// [`StateError`].
    pub fn load(&self) -> Result<Persisted, StateError> {
        match fs::read(&self.path) {
            Ok(bytes) => serde_json::from_slice(&bytes).map_err(|source| StateError::Malformed {
                path: self.path.clone(),
                source,
            }),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Persisted::default()),
            Err(source) => Err(StateError::Io {
                path: self.path.clone(),
                source,
            }),
        }
    }

    /// Stores the state durably: after a return without an error no power cut loses it.
    ///
    /// # Errors
    /// [`StateError::Io`], and [`StateError::Locked`] if another edge came first; the state stored before is unchanged.
    pub fn save(&self, state: &Persisted) -> Result<(), StateError> {
        let io = |source| StateError::Io {
            path: self.path.clone(),
            source,
        };
        self.claim()?;
        let bytes = serde_json::to_vec(state).map_err(|source| StateError::Malformed {
            path: self.path.clone(),
            source,
        })?;
        let beside = self.path.with_extension("json.new");
        let mut file = File::create(&beside).map_err(io)?;
        file.write_all(&bytes).and_then(|()| file.sync_all()).map_err(io)?;
        fs::rename(&beside, &self.path).map_err(io)?;
        let folder = self
            .path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(io)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::messages::Leader;

    #[test]
    fn what_was_saved_is_loaded_and_a_broken_file_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = StateFile::open(&folder.path().join("new"), &Id::robot("tiago").unwrap()).unwrap();
        assert_eq!(file.load().unwrap(), Persisted::default());
        let state = Persisted {
            epoch: 42,
            stopped: true,
            leader: Some(Leader {
                store: "a".into(),
                epoch: 42,
                caught_up: vec!["a".into(), "b".into()],
                revision: 3,
            }),
        };
        file.save(&state).unwrap();
        assert_eq!(file.load().unwrap(), state);
        fs::write(&file.path, b"{\"epoch\": 4").unwrap();
        assert!(file.load().unwrap_err().to_string().contains("edge-tiago.json"));
    }

    #[test]
    fn a_second_edge_is_kept_out_as_long_as_the_first_runs() {
        let folder = tempfile::tempdir().unwrap();
        let [tiago, neato] = ["tiago", "neato"].map(|name| Id::robot(name).unwrap());
        let first = StateFile::open(folder.path(), &tiago).unwrap();
        let second = StateFile::open(folder.path(), &tiago);
        assert!(matches!(second, Err(StateError::Locked { .. })));
        StateFile::open(folder.path(), &neato).unwrap();
        drop(first);
        StateFile::open(folder.path(), &tiago).unwrap();
    }
}
