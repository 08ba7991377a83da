//! Tables. A store's records as JSON, with the checksum that goes with every change of them.

use std::collections::BTreeMap;
use std::sync::MutexGuard;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::checksum::Checksum;
use super::engine::{Change, Engine, EngineError, Table};
use super::{CHECKSUM, SHARED, StoreError};

/// New values of records, or `None` for those that are removed.
pub(super) type Records = BTreeMap<(Table, String), Option<Vec<u8>>>;

/// The tables of a store, locked: nothing changes between what is read and what is then written.
pub(super) struct Tables<'a> {
    pub(super) engine: MutexGuard<'a, Box<dyn Engine>>,
    /// Where they are, for messages.
    pub(super) place: &'a str,
}

impl Tables<'_> {
    /// All records of a table, in the order of their keys.
    pub(super) fn rows(&mut self, table: Table) -> Result<Vec<(String, Vec<u8>)>, StoreError> {
        self.engine.rows(table).map_err(|error| with_place(self.place, error))
    }

    /// One record.
    pub(super) fn single<T: DeserializeOwned>(&mut self, table: Table, key: &str) -> Result<Option<T>, StoreError> {
        let found = self
            .engine
            .get(table, key)
            .map_err(|error| with_place(self.place, error))?;
        found.map(|bytes| decode(self.place, key, &bytes)).transpose()
    }

    /// Writes records of the shared tables, `instead` of all that are there or besides them, together with some of the store's own.
    pub(super) fn change(&mut self, mut records: Records, instead: bool, own: Vec<Change>) -> Result<(), StoreError> {
        let mut sum = Checksum::default();
        if instead {
            for table in SHARED {
                for (key, _) in self.rows(table)? {
                    records.entry((table, key)).or_default();
                }
            }
        } else {
            sum = Checksum(self.single(Table::Own, CHECKSUM)?.unwrap_or_default());
            for (table, key) in records.keys() {
                let before = self
                    .engine
                    .get(*table, key)
                    .map_err(|error| with_place(self.place, error))?;
                if let Some(before) = before {
                    sum.remove(table.name(), key, &before);
                }
            }
        }
        let mut changes = own;
        for ((table, key), value) in records {
            if let Some(value) = &value {
                sum.add(table.name(), &key, value);
            }
            changes.push(Change { table, key, value });
        }
        changes.push(own_record(self.place, CHECKSUM, &sum.0)?);
        self.commit(&changes)
    }

    /// What does not match in the tables, with what to do.
    pub(super) fn foreign(&self, what: impl Into<String>) -> StoreError {
        let (what, remedy) = (what.into(), self.engine.remedy());
        with_place(self.place, EngineError::Foreign { what, remedy })
    }

    /// Makes these changes, all of them or none. They are on disk when this returns.
    pub(super) fn commit(&mut self, changes: &[Change]) -> Result<(), StoreError> {
        self.engine
            .commit(changes)
            .map_err(|error| with_place(self.place, error))
    }
}

/// A record of the store's own table.
pub(super) fn own_record<T: Serialize>(place: &str, key: &str, value: &T) -> Result<Change, StoreError> {
    Ok(Change {
        table: Table::Own,
        key: key.to_owned(),
        value: Some(encode(place, key, value)?.into_bytes()),
    })
}

pub(super) fn encode<T: Serialize>(place: &str, record: &str, value: &T) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| broken(place, record, &error))
}

pub(super) fn decode<T: DeserializeOwned>(place: &str, record: &str, bytes: &[u8]) -> Result<T, StoreError> {
    serde_json::from_slice(bytes).map_err(|error| broken(place, record, &error))
}

fn broken(place: &str, record: &str, error: &serde_json::Error) -> StoreError {
    StoreError::Record {
        path: place.to_owned(),
        record: record.to_owned(),
        reason: error.to_string(),
    }
}

/// What an engine reports, with the place.
pub(super) fn with_place(place: &str, error: EngineError) -> StoreError {
    let path = place.to_owned();
    match error {
        EngineError::Locked => StoreError::Locked { path },
        EngineError::NoRoom(reason) => StoreError::NoRoom { path, reason },
        EngineError::Failed(reason) => StoreError::Io { path, reason },
        EngineError::Foreign { what, remedy } => StoreError::Foreign {
            path,
            reason: format!(
                "{what}; {remedy} to begin without goals (where other missions serve the robot, or it refuses this one then, \
                 `zenav lease forget` gives the old goals up)"
            ),
        },
    }
}
