//! Where is it kept? One redb file a mission: goals, the running tree, the plan in force, first answers, the incarnation.
//!
//! Every batch of records is one transaction, on disk before [`Store::write`] returns. Records are JSON, so that a newer
//! program reads an older one's file.

use std::path::{Path, PathBuf};

use redb::{Database, DatabaseError, ReadableDatabase, ReadableTable, TableDefinition};
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

use super::records::{Record, Restored};

const GOALS: TableDefinition<&str, &[u8]> = TableDefinition::new("goals");
const ANSWERS: TableDefinition<&str, &[u8]> = TableDefinition::new("answers");
const SINGLES: TableDefinition<&str, &[u8]> = TableDefinition::new("singles");

/// The tree that runs.
const TREE: &str = "tree";
/// The plan in force.
const MOTION: &str = "motion";
/// The number of the last life.
const INCARNATION: &str = "incarnation";

/// A mission's file.
#[derive(Debug)]
pub struct Store {
    database: Database,
    path: PathBuf,
}

/// Why the store failed.
#[derive(Debug, Error)]
pub enum StoreError {
    /// Another process has the file.
    #[error("{path}: in use by another mission; expected one process a file")]
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
    /// Opens or makes the file, and begins a new life: the incarnation in [`Restored`] is on disk when this returns.
    ///
    /// # Errors
    /// [`StoreError::Locked`] while another process has it; [`StoreError::Io`]; [`StoreError::Record`].
    pub fn open(path: &Path) -> Result<(Self, Restored), StoreError> {
        let name = path.display().to_string();
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|error| StoreError::Io {
                path: name.clone(),
                reason: error.to_string(),
            })?;
        }
        let database = Database::create(path).map_err(|error| match error {
            DatabaseError::DatabaseAlreadyOpen => StoreError::Locked { path: name.clone() },
            other => StoreError::Io {
                path: name.clone(),
                reason: other.to_string(),
            },
        })?;
        let store = Self {
            database,
            path: path.to_owned(),
        };
        let restored = store.begin_life()?;
        Ok((store, restored))
    }

    /// Stores a step's records: all of them or, after an error, none.
    ///
    /// # Errors
    /// [`StoreError`]; nothing that depends on these records may be told to anybody then.
    pub fn write(&self, records: &[Record]) -> Result<(), StoreError> {
        let write = self.database.begin_write().map_err(|error| self.io(error))?;
        {
            let mut goals = write.open_table(GOALS).map_err(|error| self.io(error))?;
            let mut answers = write.open_table(ANSWERS).map_err(|error| self.io(error))?;
            let mut singles = write.open_table(SINGLES).map_err(|error| self.io(error))?;
            for record in records {
                match record {
                    Record::Goal(goal) => {
                        let bytes = self.encode("goal", goal)?;
                        goals
                            .insert(goal.state.id.as_str(), bytes.as_slice())
                            .map_err(|error| self.io(error))?;
                    }
                    Record::ForgetGoal(id) => {
                        goals.remove(id.as_str()).map_err(|error| self.io(error))?;
                    }
                    Record::Answer(id, reply) => {
                        let bytes = self.encode("answer", reply)?;
                        answers
                            .insert(id.as_str(), bytes.as_slice())
                            .map_err(|error| self.io(error))?;
                    }
                    Record::ForgetAnswer(id) => {
                        answers.remove(id.as_str()).map_err(|error| self.io(error))?;
                    }
                    Record::Tree(tree) => {
                        let bytes = self.encode(TREE, tree)?;
                        singles.insert(TREE, bytes.as_slice()).map_err(|error| self.io(error))?;
                    }
                    Record::Motion(motion) => {
                        let bytes = self.encode(MOTION, motion)?;
                        singles
                            .insert(MOTION, bytes.as_slice())
                            .map_err(|error| self.io(error))?;
                    }
                }
            }
        }
        write.commit().map_err(|error| self.io(error))
    }

    fn begin_life(&self) -> Result<Restored, StoreError> {
        let write = self.database.begin_write().map_err(|error| self.io(error))?;
        let restored = {
            let goals = write.open_table(GOALS).map_err(|error| self.io(error))?;
            let answers = write.open_table(ANSWERS).map_err(|error| self.io(error))?;
            let mut singles = write.open_table(SINGLES).map_err(|error| self.io(error))?;
            let mut restored = Restored::default();
            for row in goals.iter().map_err(|error| self.io(error))? {
                let (id, bytes) = row.map_err(|error| self.io(error))?;
                restored
                    .goals
                    .push(self.decode(&format!("goal {}", id.value()), bytes.value())?);
            }
            for row in answers.iter().map_err(|error| self.io(error))? {
                let (id, bytes) = row.map_err(|error| self.io(error))?;
                restored
                    .answers
                    .push((id.value().to_owned(), self.decode("answer", bytes.value())?));
            }
            restored.tree = self.single(&singles, TREE)?.flatten();
            restored.motion = self.single(&singles, MOTION)?.flatten();
            restored.incarnation = self.single::<u64>(&singles, INCARNATION)?.unwrap_or(0) + 1;
            let bytes = self.encode(INCARNATION, &restored.incarnation)?;
            singles
                .insert(INCARNATION, bytes.as_slice())
                .map_err(|error| self.io(error))?;
            restored
        };
        write.commit().map_err(|error| self.io(error))?;
        Ok(restored)
    }

    /// The goals as they stand in the file, for whoever looks without running a mission.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn goals(&self) -> Result<Vec<super::records::StoredGoal>, StoreError> {
        let read = self.database.begin_read().map_err(|error| self.io(error))?;
        let table = read.open_table(GOALS).map_err(|error| self.io(error))?;
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

    fn encode<T: Serialize>(&self, record: &str, value: &T) -> Result<Vec<u8>, StoreError> {
        serde_json::to_vec(value).map_err(|error| self.record(record, &error))
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
        let (store, first) = Store::open(&path).unwrap();
        assert_eq!(first.incarnation, 1);
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
        drop(store);
        let (_store, second) = Store::open(&path).unwrap();
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
    fn a_file_in_use_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mission.redb");
        let (_store, _) = Store::open(&path).unwrap();
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
