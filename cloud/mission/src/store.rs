//! Store. Where are goals kept? In one redb file per mission: goals, the running tree, the plan in force, first answers, the incarnation.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::{PoisonError, RwLock};

use redb::{
    Database, DatabaseError, ReadTransaction, ReadableDatabase, ReadableTable, Table, TableDefinition, WriteTransaction,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;
use zenav_protocol::id::Id;
use zenav_protocol::messages::JournalWrite;

use self::checksum::Checksum;
use super::records::{Leadership, Record, Restored, StoredGoal};

mod checksum;

type Definition = TableDefinition<'static, &'static str, &'static [u8]>;

const GOALS: Definition = TableDefinition::new("goals");
const ANSWERS: Definition = TableDefinition::new("answers");
const SINGLES: Definition = TableDefinition::new("singles");
/// Tables that a leader replicates to its standbys.
const SHARED: [Definition; 3] = [GOALS, ANSWERS, SINGLES];
/// The file's own metadata.
const OWN: Definition = TableDefinition::new("own");

/// The name of the store.
const NAME: &str = "name";
/// The robot whose goals these are.
const ROBOT: &str = "robot";
/// Content of a test write.
const TRIED: &str = "tried";
/// Size of a test write, bytes.
const ROOM: usize = 64 * 1024;
/// The checksum of all records.
const CHECKSUM: &str = "checksum";
/// The leadership record, stored under its former name.
const LEADERSHIP: &str = "standing";

/// The running tree.
const TREE: &str = "tree";
/// The plan in force.
const MOTION: &str = "motion";
/// The time of the last write.
const NOW: &str = "now";
/// Number of the last run, of this store and of its leaders.
const INCARNATION: &str = "incarnation";

/// A mission's file.
///
/// Every batch of records is one transaction, on disk before [`write`](Self::write) returns. Records are JSON, so that a newer program can
/// read an older file. A batch can also be applied to a standby's store; the file's own metadata (name, leadership) never leaves it.
///
/// A file is accepted only if it is intact: it names its robot, and the checksum of its records matches. An empty file is not a new store,
/// because a new one is put into place only when it has its name.
#[derive(Debug)]
pub struct MissionStore {
    /// `None` while it could not be reopened.
    database: RwLock<Option<Database>>,
    path: PathBuf,
    name: String,
}

/// Why the store failed.
#[derive(Debug, Error)]
pub enum StoreError {
    /// Another process uses the file.
    #[error("{path}: in use by another mission; expected one process per file")]
    Locked {
        /// The file.
        path: String,
    },
    /// The disk is full or read-only: nothing can be stored until that is resolved and [`MissionStore::reopen`] was called.
    #[error("{path}: {reason}")]
    NoRoom {
        /// The file.
        path: String,
        /// What the disk reports.
        reason: String,
    },
    /// The file is damaged, changed by another program, or another robot's.
    #[error("{path}: {reason}")]
    Foreign {
        /// The file.
        path: String,
        /// What does not match, and what to do.
        reason: String,
    },
    /// The file cannot be created, read or written.
    #[error("{path}: {reason}")]
    Io {
        /// The file.
        path: String,
        /// The error.
        reason: String,
    },
    /// A record that this program cannot read or write.
    #[error("{path}: record {record}: {reason}")]
    Record {
        /// The file.
        path: String,
        /// Key of the record.
        record: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl MissionStore {
    /// Opens or creates the file with the goals of a robot.
    ///
    /// # Errors
    /// [`StoreError::Locked`] while another process uses it; [`StoreError::Foreign`] for a file that is damaged or another robot's;
    /// [`StoreError::NoRoom`]; [`StoreError::Io`]; [`StoreError::Record`].
    ///
    /// ```
    /// use zenav_mission::{MissionStore, StoreError};
    ///
    /// let folder = tempfile::tempdir().unwrap();
    /// let path = folder.path().join("mission.redb");
    /// let store = MissionStore::open(&path, "tiago")?;
    /// assert!(matches!(MissionStore::open(&path, "tiago"), Err(StoreError::Locked { .. })));
    /// drop(store);
    /// assert!(matches!(MissionStore::open(&path, "jackal"), Err(StoreError::Foreign { .. })), "another robot's goals");
    /// # Ok::<(), StoreError>(())
    /// ```
    pub fn open(path: &Path, robot: &str) -> Result<Self, StoreError> {
        let mut store = Self {
            database: RwLock::new(None),
            path: path.to_owned(),
            name: String::new(),
        };
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|error| store.io(error))?;
        }
        match std::fs::metadata(path) {
            Ok(file) if file.len() == 0 => {
                return Err(store.foreign("an empty file: the goals that were in it are lost"));
            }
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::NotFound => store.make(robot)?,
            Err(error) => return Err(store.io(error)),
        }
        store.reopen()?;
        store.name = store.christen(robot)?;
        Ok(store)
    }

    /// Creates a new file beside its final path, and moves it there once it has a name: so a file at the path is never a half-made one.
    fn make(&self, robot: &str) -> Result<(), StoreError> {
        let beside = self.path.with_extension(format!("new-{}", Id::unique()));
        let made = || {
            let database = Database::create(&beside).map_err(|error| self.io(error))?;
            *self.database.write().unwrap_or_else(PoisonError::into_inner) = Some(database);
            self.christen(robot)?;
            self.database.write().unwrap_or_else(PoisonError::into_inner).take();
            // Another process may have been faster: then its file is used.
            match std::fs::hard_link(&beside, &self.path) {
                // Not every file system has links.
                Err(error) if error.kind() != ErrorKind::AlreadyExists => {
                    std::fs::rename(&beside, &self.path).map_err(|error| self.io(error))
                }
                _ => Ok(()),
            }
        };
        let result = made();
        // The file has its final name now, or is not needed.
        let _ = std::fs::remove_file(&beside);
        result
    }

    /// Reopens the file: required after [`StoreError::NoRoom`] before anything can be read or written.
    ///
    /// # Errors
    /// As [`MissionStore::open`]; again [`StoreError::NoRoom`] if there is still none.
    pub fn reopen(&self) -> Result<(), StoreError> {
        let mut database = self.database.write().unwrap_or_else(PoisonError::into_inner);
        database.take();
        let opened = Database::open(&self.path).map_err(|error| match error {
            DatabaseError::DatabaseAlreadyOpen => StoreError::Locked {
                path: self.path.display().to_string(),
            },
            other => self.io(other),
        })?;
        *database = Some(opened);
        Ok(())
    }

    /// Test write of dummy data about as large as a goal, to find out whether the disk has room.
    ///
    /// # Errors
    /// [`StoreError::NoRoom`].
    pub fn try_to_write(&self) -> Result<(), StoreError> {
        for text in [" ".repeat(ROOM), String::new()] {
            let write = self.begin_write()?;
            {
                let mut own = write.open_table(OWN).map_err(|error| self.io(error))?;
                self.insert(&mut own, TRIED, &text)?;
            }
            write.commit().map_err(|error| self.io(error))?;
        }
        Ok(())
    }

    fn begin_write(&self) -> Result<WriteTransaction, StoreError> {
        match self.database.read().unwrap_or_else(PoisonError::into_inner).as_ref() {
            Some(database) => database.begin_write().map_err(|error| self.io(error)),
            None => Err(self.no_room("it could not be opened again")),
        }
    }

    fn begin_read(&self) -> Result<ReadTransaction, StoreError> {
        match self.database.read().unwrap_or_else(PoisonError::into_inner).as_ref() {
            Some(database) => database.begin_read().map_err(|error| self.io(error)),
            None => Err(self.no_room("it could not be opened again")),
        }
    }

    /// The name of the store, given once and unique.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Gives a new file its name and robot, or checks those of an old one. Returns the name.
    fn christen(&self, robot: &str) -> Result<String, StoreError> {
        let write = self.begin_write()?;
        let name = {
            let mut own = write.open_table(OWN).map_err(|error| self.io(error))?;
            let mut sum = Checksum::default();
            for definition in SHARED {
                let table = write.open_table(definition).map_err(|error| self.io(error))?;
                self.sum(&mut sum, redb::TableHandle::name(&definition), &table)?;
            }
            match self.single::<String>(&own, ROBOT)? {
                Some(known) if known != robot => {
                    return Err(self.foreign(&format!("the goals of robot `{known}`; expected those of `{robot}`")));
                }
                Some(_) => {}
                None => self.insert(&mut own, ROBOT, &robot)?,
            }
            let name = self.single::<String>(&own, NAME)?;
            match self.single::<u64>(&own, CHECKSUM)?.map(Checksum) {
                Some(stored) if stored != sum => {
                    return Err(self.foreign("its records do not fit its checksum: it was damaged, or changed by hand"));
                }
                Some(_) if name.is_none() => return Err(self.foreign("its name is missing: it was damaged")),
                Some(_) => {}
                None => self.insert(&mut own, CHECKSUM, &sum.0)?,
            }
            match name {
                Some(name) => name,
                None => {
                    let name = String::from(Id::unique());
                    self.insert(&mut own, NAME, &name)?;
                    name
                }
            }
        };
        write.commit().map_err(|error| self.io(error))?;
        Ok(name)
    }

    fn sum(
        &self,
        sum: &mut Checksum,
        name: &str,
        table: &impl ReadableTable<&'static str, &'static [u8]>,
    ) -> Result<(), StoreError> {
        for row in table.iter().map_err(|error| self.io(error))? {
            let (key, value) = row.map_err(|error| self.io(error))?;
            sum.add(name, key.value(), value.value());
        }
        Ok(())
    }

    /// Stores a step's records: all of them or, on an error, none. Returns the writes for a standby's store.
    ///
    /// # Errors
    /// [`StoreError`]; then nothing that depends on these records may be acknowledged.
    ///
    /// ```
    /// use zenav_mission::{GoalTable, MissionStore};
    /// use zenav_protocol::messages::GoalRequest;
    /// use zenav_protocol::time::Stamp;
    ///
    /// let folder = tempfile::tempdir().unwrap();
    /// let path = folder.path().join("mission.redb");
    /// let mut goals = GoalTable::default();
    /// goals.accept("tiago", "a".into(), GoalRequest::default(), false, Stamp::from_secs(1.0));
    /// MissionStore::open(&path, "tiago")?.write(&goals.take_records())?;
    ///
    /// let restored = MissionStore::open(&path, "tiago")?.begin_life()?;
    /// assert_eq!(restored.goals[0].state.id, "a");
    /// # Ok::<(), zenav_mission::StoreError>(())
    /// ```
    pub fn write(&self, records: &[Record]) -> Result<Vec<JournalWrite>, StoreError> {
        let writes: Vec<JournalWrite> = records
            .iter()
            .map(|record| self.journal(record))
            .collect::<Result<_, _>>()?;
        self.apply(&writes, false, None)?;
        Ok(writes)
    }

    fn journal(&self, record: &Record) -> Result<JournalWrite, StoreError> {
        let (table, key, value) = match record {
            Record::Goal(goal) => (GOALS, goal.state.id.clone(), Some(self.encode("goal", goal)?)),
            Record::ForgetGoal(id) => (GOALS, id.clone(), None),
            Record::Answer(id, reply) => (ANSWERS, id.clone(), Some(self.encode("answer", reply)?)),
            Record::ForgetAnswer(id) => (ANSWERS, id.clone(), None),
            Record::Tree(tree) => (SINGLES, TREE.to_owned(), Some(self.encode(TREE, tree)?)),
            Record::Motion(motion) => (SINGLES, MOTION.to_owned(), Some(self.encode(MOTION, motion)?)),
            Record::Now(now) => (SINGLES, NOW.to_owned(), Some(self.encode(NOW, now)?)),
        };
        Ok(JournalWrite {
            table: redb::TableHandle::name(&table).to_owned(),
            key,
            value,
        })
    }

    /// Applies the writes of a leader's store, to the stored content or `instead` of it, together with this store's new leadership record.
    ///
    /// # Errors
    /// [`StoreError`], also for an unknown table; then nothing is written.
    ///
    /// ```
    /// use zenav_mission::{GoalTable, Leadership, MissionStore};
    /// use zenav_protocol::messages::GoalRequest;
    /// use zenav_protocol::time::Stamp;
    ///
    /// let folder = tempfile::tempdir().unwrap();
    /// let [leader, standby] = ["leader", "standby"].map(|name| MissionStore::open(&folder.path().join(name), "tiago").unwrap());
    /// let mut goals = GoalTable::default();
    /// goals.accept("tiago", "a".into(), GoalRequest::default(), false, Stamp::from_secs(1.0));
    /// let writes = leader.write(&goals.take_records())?;
    /// standby.apply(&writes, false, Some(Leadership { epoch: 7, shared: true }))?;
    /// assert_eq!(standby.everything()?, leader.everything()?);
    /// assert_eq!((standby.leadership()?.epoch, leader.leadership()?.epoch), (7, 0));
    /// # Ok::<(), zenav_mission::StoreError>(())
    /// ```
    pub fn apply(
        &self,
        writes: &[JournalWrite],
        instead: bool,
        leadership: Option<Leadership>,
    ) -> Result<(), StoreError> {
        let known = |name: &str| SHARED.iter().any(|table| redb::TableHandle::name(table) == name);
        if let Some(stray) = writes.iter().find(|write| !known(&write.table)) {
            let reason = format!("the leader writes to an unknown table `{}`", stray.table);
            return Err(self.failed(reason));
        }
        let write = self.begin_write()?;
        {
            let mut own = write.open_table(OWN).map_err(|error| self.io(error))?;
            let mut sum = match instead {
                true => Checksum::default(),
                false => Checksum(self.single(&own, CHECKSUM)?.unwrap_or_default()),
            };
            for definition in SHARED {
                if instead {
                    write.delete_table(definition).map_err(|error| self.io(error))?;
                }
                let mut table = write.open_table(definition).map_err(|error| self.io(error))?;
                let name = redb::TableHandle::name(&definition);
                for write in writes.iter().filter(|write| write.table == name) {
                    let value = write.value.as_ref().map(String::as_bytes);
                    self.put(&mut table, &mut sum, name, &write.key, value)?;
                }
            }
            self.insert(&mut own, CHECKSUM, &sum.0)?;
            if let Some(leadership) = leadership {
                self.insert(&mut own, LEADERSHIP, &leadership)?;
            }
        }
        write.commit().map_err(|error| self.io(error))
    }

    /// Writes or removes a record of a shared table, and updates the checksum.
    fn put(
        &self,
        table: &mut Table<'_, &'static str, &'static [u8]>,
        sum: &mut Checksum,
        name: &str,
        key: &str,
        value: Option<&[u8]>,
    ) -> Result<(), StoreError> {
        let before = match value {
            Some(value) => table.insert(key, value),
            None => table.remove(key),
        };
        if let Some(before) = before.map_err(|error| self.io(error))? {
            sum.remove(name, key, before.value());
        }
        if let Some(value) = value {
            sum.add(name, key, value);
        }
        Ok(())
    }

    /// The complete content for a standby's store.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn everything(&self) -> Result<Vec<JournalWrite>, StoreError> {
        let read = self.begin_read()?;
        let mut writes = Vec::new();
        for definition in SHARED {
            let table = read.open_table(definition).map_err(|error| self.io(error))?;
            let name = redb::TableHandle::name(&definition);
            for row in table.iter().map_err(|error| self.io(error))? {
                let (key, bytes) = row.map_err(|error| self.io(error))?;
                let value = String::from_utf8(bytes.value().to_vec()).map_err(|error| self.failed(error))?;
                writes.push(JournalWrite {
                    table: name.to_owned(),
                    key: key.value().to_owned(),
                    value: Some(value),
                });
            }
        }
        Ok(writes)
    }

    /// Relation of this store to others.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn leadership(&self) -> Result<Leadership, StoreError> {
        let read = self.begin_read()?;
        let own = read.open_table(OWN).map_err(|error| self.io(error))?;
        Ok(self.single(&own, LEADERSHIP)?.unwrap_or_default())
    }

    /// Starts a new run: the incarnation in [`Restored`] is on disk when this returns.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn begin_life(&self) -> Result<Restored, StoreError> {
        let write = self.begin_write()?;
        let restored = {
            let answers = write.open_table(ANSWERS).map_err(|error| self.io(error))?;
            let mut singles = write.open_table(SINGLES).map_err(|error| self.io(error))?;
            let mut own = write.open_table(OWN).map_err(|error| self.io(error))?;
            let lives = [
                self.single::<u64>(&own, INCARNATION)?,
                self.single(&singles, INCARNATION)?,
            ];
            let mut restored = Restored {
                store: Some(self.name.clone()),
                leadership: self.single(&own, LEADERSHIP)?.unwrap_or_default(),
                goals: self.all_goals(&write.open_table(GOALS).map_err(|error| self.io(error))?)?,
                tree: self.single(&singles, TREE)?.flatten(),
                motion: self.single(&singles, MOTION)?.flatten(),
                incarnation: lives.into_iter().flatten().max().unwrap_or(0) + 1,
                now: self.single(&singles, NOW)?.unwrap_or_default(),
                ..Restored::default()
            };
            for row in answers.iter().map_err(|error| self.io(error))? {
                let (id, bytes) = row.map_err(|error| self.io(error))?;
                restored
                    .answers
                    .push((id.value().to_owned(), self.decode("answer", bytes.value())?));
            }
            let mut sum = Checksum(self.single(&own, CHECKSUM)?.unwrap_or_default());
            let text = self.encode(INCARNATION, &restored.incarnation)?;
            let name = redb::TableHandle::name(&SINGLES);
            self.put(&mut singles, &mut sum, name, INCARNATION, Some(text.as_bytes()))?;
            self.insert(&mut own, INCARNATION, &restored.incarnation)?;
            self.insert(&mut own, CHECKSUM, &sum.0)?;
            restored
        };
        write.commit().map_err(|error| self.io(error))?;
        Ok(restored)
    }

    /// The goals in the file.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn goals(&self) -> Result<Vec<StoredGoal>, StoreError> {
        let read = self.begin_read()?;
        self.all_goals(&read.open_table(GOALS).map_err(|error| self.io(error))?)
    }

    fn all_goals(
        &self,
        table: &impl ReadableTable<&'static str, &'static [u8]>,
    ) -> Result<Vec<StoredGoal>, StoreError> {
        let mut goals = Vec::new();
        for row in table.iter().map_err(|error| self.io(error))? {
            let (id, bytes) = row.map_err(|error| self.io(error))?;
            goals.push(self.decode(&format!("goal {}", id.value()), bytes.value())?);
        }
        Ok(goals)
    }

    fn single<T: DeserializeOwned>(
        &self,
        singles: &impl ReadableTable<&'static str, &'static [u8]>,
        name: &str,
    ) -> Result<Option<T>, StoreError> {
        let Some(bytes) = singles.get(name).map_err(|error| self.io(error))? else {
            return Ok(None);
        };
        self.decode(name, bytes.value()).map(Some)
    }

    fn insert<T: Serialize>(
        &self,
        table: &mut Table<'_, &'static str, &'static [u8]>,
        name: &str,
        value: &T,
    ) -> Result<(), StoreError> {
        let text = self.encode(name, value)?;
        table
            .insert(name, text.as_bytes())
            .map(drop)
            .map_err(|error| self.io(error))
    }

    fn encode<T: Serialize>(&self, record: &str, value: &T) -> Result<String, StoreError> {
        serde_json::to_string(value).map_err(|error| self.record(record, &error))
    }

    fn decode<T: DeserializeOwned>(&self, record: &str, bytes: &[u8]) -> Result<T, StoreError> {
        serde_json::from_slice(bytes).map_err(|error| self.record(record, &error))
    }

    fn record(&self, record: &str, error: &serde_json::Error) -> StoreError {
        StoreError::Record {
            path: self.path.display().to_string(),
            record: record.to_owned(),
            reason: error.to_string(),
        }
    }

    fn io(&self, error: impl Into<redb::Error>) -> StoreError {
        match error.into() {
            redb::Error::Io(error) if has_no_room(&error) => self.no_room(error),
            redb::Error::PreviousIo => self.no_room("a write failed before"),
            error => self.failed(error),
        }
    }

    fn no_room(&self, reason: impl std::fmt::Display) -> StoreError {
        StoreError::NoRoom {
            path: self.path.display().to_string(),
            reason: reason.to_string(),
        }
    }

    fn foreign(&self, what: &str) -> StoreError {
        StoreError::Foreign {
            path: self.path.display().to_string(),
            reason: format!(
                "{what}; move the file away to begin without goals (where other missions serve the robot, or it refuses this one then, \
                 `zenav lease forget` gives the old goals up)"
            ),
        }
    }

    fn failed(&self, error: impl std::fmt::Display) -> StoreError {
        StoreError::Io {
            path: self.path.display().to_string(),
            reason: error.to_string(),
        }
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

#[cfg(test)]
mod tests;
