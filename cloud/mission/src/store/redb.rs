//! redb. The tables of a store in one file of this machine.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use redb::{
    Database, DatabaseError, ReadOnlyTable, ReadableDatabase as _, ReadableTable as _, TableDefinition, TableError,
};
use zenav_protocol::id::Id;

use super::engine::{Change, Engine, EngineError, Table};

const REMEDY: &str = "move the file away";

/// A mission's file. Another process cannot open it meanwhile.
#[derive(Debug)]
pub(super) struct RedbFile {
    /// `None` while it could not be reopened.
    database: Option<Database>,
    path: PathBuf,
}

impl RedbFile {
    /// Opens the file, or creates it with these records: a new file is put into place only when it has them, so an empty file is not a new
    /// one.
    pub(super) fn open(path: &Path, first: &[Change]) -> Result<Self, EngineError> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(io)?;
        }
        match std::fs::metadata(path) {
            Ok(file) if file.len() == 0 => {
                let what = "an empty file: the goals that were in it are lost".to_owned();
                return Err(EngineError::Foreign { what, remedy: REMEDY });
            }
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::NotFound => make(path, first)?,
            Err(error) => return Err(io(error)),
        }
        let mut file = Self {
            database: None,
            path: path.to_owned(),
        };
        file.reopen()?;
        Ok(file)
    }

    fn database(&self) -> Result<&Database, EngineError> {
        let closed = || EngineError::NoRoom("it could not be opened again".to_owned());
        self.database.as_ref().ok_or_else(closed)
    }

    /// A table as it is now; `None` in a file that does not have it yet.
    fn table(&self, table: Table) -> Result<Option<ReadOnlyTable<&'static str, &'static [u8]>>, EngineError> {
        match self.database()?.begin_read().map_err(io)?.open_table(definition(table)) {
            Err(TableError::TableDoesNotExist(_)) => Ok(None),
            opened => opened.map(Some).map_err(io),
        }
    }
}

/// Creates a new file beside its final path, and moves it there once it has its first records.
fn make(path: &Path, first: &[Change]) -> Result<(), EngineError> {
    let beside = path.with_extension(format!("new-{}", Id::unique()));
    let made = || {
        write(&Database::create(&beside).map_err(io)?, first)?;
        // Another process may have been faster: then its file is used.
        match std::fs::hard_link(&beside, path) {
            // Not every file system has links.
            Err(error) if error.kind() != ErrorKind::AlreadyExists => std::fs::rename(&beside, path).map_err(io),
            _ => Ok(()),
        }
    };
    let result = made();
    // The file has its final name now, or is not needed.
    let _ = std::fs::remove_file(&beside);
    result
}

impl Engine for RedbFile {
    fn get(&mut self, table: Table, key: &str) -> Result<Option<Vec<u8>>, EngineError> {
        let Some(table) = self.table(table)? else {
            return Ok(None);
        };
        let value = table.get(key).map_err(io)?;
        Ok(value.map(|value| value.value().to_vec()))
    }

    fn rows(&mut self, table: Table) -> Result<Vec<(String, Vec<u8>)>, EngineError> {
        let mut rows = Vec::new();
        if let Some(table) = self.table(table)? {
            for row in table.iter().map_err(io)? {
                let (key, value) = row.map_err(io)?;
                rows.push((key.value().to_owned(), value.value().to_vec()));
            }
        }
        Ok(rows)
    }

    fn commit(&mut self, changes: &[Change]) -> Result<(), EngineError> {
        write(self.database()?, changes)
    }

    fn reopen(&mut self) -> Result<(), EngineError> {
        self.database = None;
        let opened = Database::open(&self.path).map_err(|error| match error {
            DatabaseError::DatabaseAlreadyOpen => EngineError::Locked,
            other => io(other),
        })?;
        self.database = Some(opened);
        Ok(())
    }

    fn remedy(&self) -> &'static str {
        REMEDY
    }
}

/// Makes changes in one transaction, which is on disk when this returns. Tables that are missing are created.
fn write(database: &Database, changes: &[Change]) -> Result<(), EngineError> {
    let write = database.begin_write().map_err(io)?;
    for name in Table::ALL {
        let mut table = write.open_table(definition(name)).map_err(io)?;
        for Change { key, value, .. } in changes.iter().filter(|change| change.table == name) {
            match value {
                Some(value) => table.insert(key.as_str(), value.as_slice()),
                None => table.remove(key.as_str()),
            }
            .map_err(io)?;
        }
    }
    write.commit().map_err(io)
}

pub(super) const fn definition(table: Table) -> TableDefinition<'static, &'static str, &'static [u8]> {
    TableDefinition::new(table.name())
}

fn io(error: impl Into<redb::Error>) -> EngineError {
    match error.into() {
        redb::Error::Io(error) if has_no_room(&error) => EngineError::NoRoom(error.to_string()),
        redb::Error::PreviousIo => EngineError::NoRoom("a write failed before".to_owned()),
        error => EngineError::Failed(error.to_string()),
    }
}

/// Whether a disk is full or read-only.
fn has_no_room(error: &std::io::Error) -> bool {
    use ErrorKind::{FileTooLarge, QuotaExceeded, ReadOnlyFilesystem, StorageFull, WriteZero};
    matches!(
        error.kind(),
        StorageFull | ReadOnlyFilesystem | QuotaExceeded | FileTooLarge | WriteZero
    )
}
