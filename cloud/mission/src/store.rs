//! Store. Where are goals kept? In one redb file per mission: goals, the running tree, the plan in force, first answers, the incarnation.
//!
//! Every batch of records is one transaction, on disk before [`Store::write`] returns. Records are JSON, so that a newer
//! program reads an older one's file. A batch can be applied to a standby's store as well; what the file says of itself (its name, its
//! leadership) never leaves it.

use std::path::{Path, PathBuf};

use redb::{Database, DatabaseError, ReadableDatabase, ReadableTable, Table, TableDefinition};
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;
use zenav_protocol::id::Id;
use zenav_protocol::messages::JournalWrite;

use super::records::{Leadership, Record, Restored, StoredGoal};

type Definition = TableDefinition<'static, &'static str, &'static [u8]>;

const GOALS: Definition = TableDefinition::new("goals");
const ANSWERS: Definition = TableDefinition::new("answers");
const SINGLES: Definition = TableDefinition::new("singles");
/// What a leader hands to its standbys.
const SHARED: [Definition; 3] = [GOALS, ANSWERS, SINGLES];
/// What the file says of itself.
const OWN: Definition = TableDefinition::new("own");

/// The name of the store.
const NAME: &str = "name";
/// Its leadership record; stored under its former name.
const LEADERSHIP: &str = "standing";

/// The tree that runs.
const TREE: &str = "tree";
/// The plan in force.
const MOTION: &str = "motion";
/// The time of the last write.
const NOW: &str = "now";
/// The number of the last life, of this store's and of its leaders'.
const INCARNATION: &str = "incarnation";

/// A mission's file.
#[derive(Debug)]
pub struct Store {
    database: Database,
    path: PathBuf,
    name: String,
}

/// Why the store failed.
#[derive(Debug, Error)]
pub enum StoreError {
    /// Another process has the file.
    #[error("{path}: in use by another mission; expected one process per file")]
    Locked {
        /// The file.
        path: String,
    },
    /// The file cannot be made, read or written.
    #[error("{path}: {reason}")]
    Io {
        /// The file.
        path: String,
        /// What went wrong.
        reason: String,
    },
    /// A record that this program cannot read or write.
    #[error("{path}: record {record}: {reason}")]
    Record {
        /// The file.
        path: String,
        /// Which.
        record: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl Store {
    /// Opens or makes the file.
    ///
    /// # Errors
    /// [`StoreError::Locked`] while another process has it; [`StoreError::Io`]; [`StoreError::Record`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let shown = path.display().to_string();
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|error| StoreError::Io {
                path: shown.clone(),
                reason: error.to_string(),
            })?;
        }
        let database = Database::create(path).map_err(|error| match error {
            DatabaseError::DatabaseAlreadyOpen => StoreError::Locked { path: shown.clone() },
            other => StoreError::Io {
                path: shown,
                reason: other.to_string(),
            },
        })?;
        let mut store = Self {
            database,
            path: path.to_owned(),
            name: String::new(),
        };
        store.name = store.christen()?;
        Ok(store)
    }

    /// The name of the store, given once and different from every other store's.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    fn christen(&self) -> Result<String, StoreError> {
        let write = self.database.begin_write().map_err(|error| self.io(error))?;
        let name = {
            let mut own = write.open_table(OWN).map_err(|error| self.io(error))?;
            for table in SHARED {
                write.open_table(table).map_err(|error| self.io(error))?;
            }
            match self.single(&own, NAME)? {
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

    /// Stores a step's records: all of them or, after an error, none. Returns what a standby's store is to write.
    ///
    /// # Errors
    /// [`StoreError`]; nothing that depends on these records may be told to anybody then.
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

    /// Writes what a leader's store has written, after what is there or `instead` of it; with how this store stands from then on.
    ///
    /// # Errors
    /// [`StoreError`], also for a table that there is not; then nothing is written.
    pub fn apply(
        &self,
        writes: &[JournalWrite],
        instead: bool,
        leadership: Option<Leadership>,
    ) -> Result<(), StoreError> {
        let write = self.database.begin_write().map_err(|error| self.io(error))?;
        for definition in SHARED {
            if instead {
                write.delete_table(definition).map_err(|error| self.io(error))?;
            }
            let mut table = write.open_table(definition).map_err(|error| self.io(error))?;
            let name = redb::TableHandle::name(&definition);
            for write in writes.iter().filter(|write| write.table == name) {
                match &write.value {
                    Some(value) => table.insert(write.key.as_str(), value.as_bytes()),
                    None => table.remove(write.key.as_str()),
                }
                .map_err(|error| self.io(error))?;
            }
        }
        let known = |name: &str| SHARED.iter().any(|table| redb::TableHandle::name(table) == name);
        if let Some(stray) = writes.iter().find(|write| !known(&write.table)) {
            return Err(self.io(format!("the leader writes to an unknown table `{}`", stray.table)));
        }
        if let Some(leadership) = leadership {
            let mut own = write.open_table(OWN).map_err(|error| self.io(error))?;
            self.insert(&mut own, LEADERSHIP, &leadership)?;
        }
        write.commit().map_err(|error| self.io(error))
    }

    /// Everything that a standby's store is to hold.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn everything(&self) -> Result<Vec<JournalWrite>, StoreError> {
        let read = self.database.begin_read().map_err(|error| self.io(error))?;
        let mut writes = Vec::new();
        for definition in SHARED {
            let table = read.open_table(definition).map_err(|error| self.io(error))?;
            let name = redb::TableHandle::name(&definition);
            for row in table.iter().map_err(|error| self.io(error))? {
                let (key, bytes) = row.map_err(|error| self.io(error))?;
                let value = String::from_utf8(bytes.value().to_vec()).map_err(|error| self.io(error))?;
                writes.push(JournalWrite {
                    table: name.to_owned(),
                    key: key.value().to_owned(),
                    value: Some(value),
                });
            }
        }
        Ok(writes)
    }

    /// How this store relates to others.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn leadership(&self) -> Result<Leadership, StoreError> {
        let read = self.database.begin_read().map_err(|error| self.io(error))?;
        let own = read.open_table(OWN).map_err(|error| self.io(error))?;
        Ok(self.single(&own, LEADERSHIP)?.unwrap_or_default())
    }

    /// Begins a new life: the incarnation in [`Restored`] is on disk when this returns.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn begin_life(&self) -> Result<Restored, StoreError> {
        let write = self.database.begin_write().map_err(|error| self.io(error))?;
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
            self.insert(&mut singles, INCARNATION, &restored.incarnation)?;
            self.insert(&mut own, INCARNATION, &restored.incarnation)?;
            restored
        };
        write.commit().map_err(|error| self.io(error))?;
        Ok(restored)
    }

    /// The goals as they stand in the file.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn goals(&self) -> Result<Vec<StoredGoal>, StoreError> {
        let read = self.database.begin_read().map_err(|error| self.io(error))?;
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

    fn io(&self, error: impl std::fmt::Display) -> StoreError {
        StoreError::Io {
            path: self.path.display().to_string(),
            reason: error.to_string(),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::messages::{GoalFeedback, GoalPhase, GoalReply, GoalRequest, GoalState};
    use zenav_protocol::time::Stamp;

    fn goal(id: &str, sequence: u64) -> Record {
        let state = GoalState {
            id: id.into(),
            robot: "r".into(),
            state: GoalPhase::Accepted,
            reason: None,
            accepted: Stamp(1),
            started: None,
            ended: None,
            feedback: GoalFeedback::default(),
            legs: Vec::new(),
            request: GoalRequest {
                x: Some(0.1),
                y: Some(0.2),
                ..GoalRequest::default()
            },
        };
        Record::Goal(Box::new(super::super::records::StoredGoal {
            sequence,
            urgent: false,
            paused_secs: 0.0,
            paused_since: None,
            state,
        }))
    }

    #[test]
    fn what_was_written_is_there_in_the_next_life() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/mission.redb");
        let store = Store::open(&path).unwrap();
        assert_eq!(store.begin_life().unwrap().incarnation, 1);
        let reply = GoalReply {
            robot: None,
            id: "a".into(),
            state: GoalPhase::Canceled,
            reason: None,
        };
        store
            .write(&[
                goal("a", 1),
                goal("b", 2),
                Record::Answer("r1".into(), reply.clone()),
                Record::Tree(None),
            ])
            .unwrap();
        store.write(&[Record::ForgetGoal("a".into())]).unwrap();
        let name = store.name().to_owned();
        drop(store);
        let again = Store::open(&path).unwrap();
        assert_eq!(again.name(), name);
        let second = again.begin_life().unwrap();
        assert_eq!(second.incarnation, 2);
        assert_eq!(
            second
                .goals
                .iter()
                .map(|goal| goal.state.id.as_str())
                .collect::<Vec<_>>(),
            ["b"]
        );
        assert_eq!(second.answers, [("r1".to_owned(), reply)]);
        assert_eq!((second.tree, second.motion), (None, None));
    }

    #[test]
    fn a_standby_s_store_holds_what_the_leader_s_holds_but_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let open = |name: &str| Store::open(&folder.path().join(name)).unwrap();
        let (leader, standby) = (open("leader"), open("standby"));
        standby.write(&[goal("stale", 1)]).unwrap();
        leader.begin_life().unwrap();
        leader.write(&[goal("a", 1), goal("b", 2)]).unwrap();
        let leadership = Leadership { epoch: 7, shared: true };
        standby
            .apply(&leader.everything().unwrap(), true, Some(leadership))
            .unwrap();
        let writes = leader.write(&[Record::ForgetGoal("a".into()), goal("c", 3)]).unwrap();
        standby.apply(&writes, false, None).unwrap();
        assert_eq!(standby.everything().unwrap(), leader.everything().unwrap());
        assert_eq!(
            (standby.leadership().unwrap(), leader.leadership().unwrap()),
            (leadership, Leadership::default())
        );
        assert_ne!(standby.name(), leader.name());
        assert_eq!(
            standby.begin_life().unwrap().incarnation,
            2,
            "its lives are newer than the leader's"
        );
        let stray = JournalWrite {
            table: "own".into(),
            key: "name".into(),
            value: Some("x".into()),
        };
        assert!(standby.apply(&[stray], true, None).is_err());
        assert_eq!(standby.goals().unwrap().len(), 2, "nothing of a bad batch is written");
    }

    #[test]
    fn a_file_in_use_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mission.redb");
        let _store = Store::open(&path).unwrap();
        assert!(matches!(Store::open(&path), Err(StoreError::Locked { .. })));
    }

    #[test]
    fn a_file_that_is_no_store_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mission.redb");
        std::fs::write(&path, vec![7_u8; 10_000]).unwrap();
        assert!(matches!(Store::open(&path), Err(StoreError::Io { .. })));
    }
}
