//! Atomic files. A reader never sees a partly written file.
//!
//! A file is written under a temporary name, synced to disk, then renamed.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::map_file::MapFileError;

/// Writes a file so that readers see the old or the new content, never a part of it, even after a crash of the machine.
///
/// # Errors
/// [`MapFileError::Io`].
///
/// ```
/// use zenav_mapping::write_atomically;
///
/// let folder = tempfile::tempdir().unwrap();
/// let path = folder.path().join("map.json");
/// write_atomically(&path, b"old")?;
/// write_atomically(&path, b"new")?;
/// assert_eq!(std::fs::read(&path).unwrap(), b"new");
/// assert!(write_atomically(&folder.path().join("missing/map.json"), b"").is_err(), "there is no such folder");
/// # Ok::<(), zenav_mapping::MapFileError>(())
/// ```
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), MapFileError> {
    Prepared::new(path, |file| file.write_all(bytes))?.publish()
}

/// A file that is on disk under a temporary name.
pub(super) struct Prepared {
    path: PathBuf,
    temporary: PathBuf,
}

impl Prepared {
    pub(super) fn new(
        path: &Path,
        write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
    ) -> Result<Self, MapFileError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let prepared = Self {
            path: path.to_owned(),
            temporary: path.with_file_name(format!(".{name}.{}.part", std::process::id())),
        };
        let written = || {
            let mut file = BufWriter::new(File::create(&prepared.temporary)?);
            write(&mut file)?;
            file.into_inner()?.sync_all()
        };
        written().map_err(MapFileError::io(path))?;
        Ok(prepared)
    }

    pub(super) fn publish(self) -> Result<(), MapFileError> {
        std::fs::rename(&self.temporary, &self.path).map_err(MapFileError::io(&self.path))?;
        // The rename is on disk only once its folder is; where folders cannot be opened, nothing more can be done.
        if let Some(folder) = self.path.parent().filter(|folder| !folder.as_os_str().is_empty())
            && let Ok(folder) = File::open(folder)
        {
            let _ = folder.sync_all();
        }
        Ok(())
    }
}

impl Drop for Prepared {
    fn drop(&mut self) {
        // After `publish` there is nothing to remove.
        let _ = std::fs::remove_file(&self.temporary);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_published_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write_atomically(&path, b"old").unwrap();
        drop(Prepared::new(&path, |file| file.write_all(b"half of the n")).unwrap());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        write_atomically(&path, b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
    }
}
