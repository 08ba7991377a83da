//! Store. Where are goals kept? In four tables per mission: goals, first answers, the running tree with the plan in force, the store's own.
//!
//! This file says what is in them and when it counts as kept. What it needs of a database is an [`Engine`]: redb, in a file of this machine.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use thiserror::Error;
use zenav_protocol::id::Id;
use zenav_protocol::messages::JournalWrite;

use self::checksum::Checksum;
use self::engine::{Engine, EngineError, Table};
use self::redb::RedbFile;
use self::tables::{Records, Tables, decode, encode, own_record, with_place};
use super::records::{Leadership, Record, Restored, StoredGoal};

mod checksum;
mod engine;
#[cfg(test)]
mod memory;
mod redb;
mod tables;

/// Tables that a leader replicates to its standbys.
const SHARED: [Table; 3] = [Table::Goals, Table::Answers, Table::Singles];

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
    /// Locked from the first read of a change to its commit.
    engine: Mutex<Box<dyn Engine>>,
    /// Where it is, for messages.
    place: String,
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
        let place = path.display().to_string();
        let first = [
            own_record(&place, ROBOT, &robot)?,
            own_record(&place, NAME, &String::from(Id::unique()))?,
            own_record(&place, CHECKSUM, &Checksum::default().0)?,
        ];
        let engine = RedbFile::open(path, &first).map_err(|error| with_place(&place, error))?;
        Self::over(Box::new(engine), place, robot)
    }

    /// The store in an engine's tables, which are named if they are new.
    fn over(engine: Box<dyn Engine>, place: String, robot: &str) -> Result<Self, StoreError> {
        let mut store = Self {
            engine: Mutex::new(engine),
            place,
            name: String::new(),
        };
        store.name = store.christen(robot)?;
        Ok(store)
    }

    /// Reopens the file: required after [`StoreError::NoRoom`] before anything can be read or written.
    ///
    /// # Errors
    /// As [`MissionStore::open`]; again [`StoreError::NoRoom`] if there is still none.
    pub fn reopen(&self) -> Result<(), StoreError> {
        self.tables()
            .engine
            .reopen()
            .map_err(|error| with_place(&self.place, error))
    }

    /// Test write of dummy data about as large as a goal, to find out whether the disk has room.
    ///
    /// # Errors
    /// [`StoreError::NoRoom`].
    pub fn try_to_write(&self) -> Result<(), StoreError> {
        for text in [" ".repeat(ROOM), String::new()] {
            self.tables().commit(&[own_record(&self.place, TRIED, &text)?])?;
        }
        Ok(())
    }

    fn tables(&self) -> Tables<'_> {
        Tables {
            engine: self.engine.lock().unwrap_or_else(PoisonError::into_inner),
            place: &self.place,
        }
    }

    /// The name of the store, given once and unique.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Gives new tables their name and robot, or checks those of old ones. Returns the name.
    fn christen(&self, robot: &str) -> Result<String, StoreError> {
        let mut tables = self.tables();
        let mut sum = Checksum::default();
        for table in SHARED {
            for (key, value) in tables.rows(table)? {
                sum.add(table.name(), &key, &value);
            }
        }
        let mut changes = Vec::new();
        match tables.single::<String>(Table::Own, ROBOT)? {
            Some(known) if known != robot => {
                return Err(tables.foreign(format!("the goals of robot `{known}`; expected those of `{robot}`")));
            }
            Some(_) => {}
            None => changes.push(own_record(&self.place, ROBOT, &robot)?),
        }
        let name = tables.single::<String>(Table::Own, NAME)?;
        match tables.single::<u64>(Table::Own, CHECKSUM)?.map(Checksum) {
            Some(stored) if stored != sum => {
                return Err(tables.foreign("its records do not fit its checksum: it was damaged, or changed by hand"));
            }
            Some(_) if name.is_none() => return Err(tables.foreign("its name is missing: it was damaged")),
            Some(_) => {}
            None => changes.push(own_record(&self.place, CHECKSUM, &sum.0)?),
        }
        let name = match name {
            Some(name) => name,
            None => {
                let name = String::from(Id::unique());
                changes.push(own_record(&self.place, NAME, &name)?);
                name
            }
        };
        // Also without a change: what can be written now is found out now.
        tables.commit(&changes)?;
        Ok(name)
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
            Record::Goal(goal) => (
                Table::Goals,
                goal.state.id.clone(),
                Some(encode(&self.place, "goal", goal)?),
            ),
            Record::ForgetGoal(id) => (Table::Goals, id.clone(), None),
            Record::Answer(id, reply) => (Table::Answers, id.clone(), Some(encode(&self.place, "answer", reply)?)),
            Record::ForgetAnswer(id) => (Table::Answers, id.clone(), None),
            Record::Tree(tree) => (Table::Singles, TREE.to_owned(), Some(encode(&self.place, TREE, tree)?)),
            Record::Motion(motion) => (
                Table::Singles,
                MOTION.to_owned(),
                Some(encode(&self.place, MOTION, motion)?),
            ),
            Record::Now(now) => (Table::Singles, NOW.to_owned(), Some(encode(&self.place, NOW, now)?)),
        };
        Ok(JournalWrite {
            table: table.name().to_owned(),
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
        let mut records = Records::new();
        for write in writes {
            let Some(table) = SHARED.into_iter().find(|table| table.name() == write.table) else {
                let reason = format!("the leader writes to an unknown table `{}`", write.table);
                return Err(self.failed(reason));
            };
            let value = write.value.as_ref().map(|value| value.as_bytes().to_vec());
            records.insert((table, write.key.clone()), value);
        }
        let leadership = leadership.map(|leadership| own_record(&self.place, LEADERSHIP, &leadership));
        let own = leadership.into_iter().collect::<Result<_, _>>()?;
        self.tables().change(records, instead, own)
    }

    /// The complete content for a standby's store.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn everything(&self) -> Result<Vec<JournalWrite>, StoreError> {
        let mut tables = self.tables();
        let mut writes = Vec::new();
        for table in SHARED {
            for (key, value) in tables.rows(table)? {
                writes.push(JournalWrite {
                    table: table.name().to_owned(),
                    key,
                    value: Some(String::from_utf8(value).map_err(|error| self.failed(error))?),
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
        Ok(self.tables().single(Table::Own, LEADERSHIP)?.unwrap_or_default())
    }

    /// Starts a new run: the incarnation in [`Restored`] is on disk when this returns.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn begin_life(&self) -> Result<Restored, StoreError> {
        let mut tables = self.tables();
        let lives = [
            tables.single::<u64>(Table::Own, INCARNATION)?,
            tables.single(Table::Singles, INCARNATION)?,
        ];
        let mut restored = Restored {
            store: Some(self.name.clone()),
            leadership: tables.single(Table::Own, LEADERSHIP)?.unwrap_or_default(),
            goals: self.all_goals(&mut tables)?,
            tree: tables.single(Table::Singles, TREE)?.flatten(),
            motion: tables.single(Table::Singles, MOTION)?.flatten(),
            incarnation: lives.into_iter().flatten().max().unwrap_or(0) + 1,
            now: tables.single(Table::Singles, NOW)?.unwrap_or_default(),
            ..Restored::default()
        };
        for (id, value) in tables.rows(Table::Answers)? {
            let reply = decode(&self.place, "answer", &value)?;
            restored.answers.push((id, reply));
        }
        let own = own_record(&self.place, INCARNATION, &restored.incarnation)?;
        let shared = ((Table::Singles, INCARNATION.to_owned()), own.value.clone());
        tables.change(Records::from([shared]), false, vec![own])?;
        Ok(restored)
    }

    /// The goals in the file.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn goals(&self) -> Result<Vec<StoredGoal>, StoreError> {
        self.all_goals(&mut self.tables())
    }

    fn all_goals(&self, tables: &mut Tables<'_>) -> Result<Vec<StoredGoal>, StoreError> {
        let rows = tables.rows(Table::Goals)?.into_iter();
        rows.map(|(id, value)| decode(&self.place, &format!("goal {id}"), &value))
            .collect()
    }

    fn failed(&self, error: impl std::fmt::Display) -> StoreError {
        with_place(&self.place, EngineError::Failed(error.to_string()))
    }
}

#[cfg(test)]
mod tests;
