//! Memory. Tables that end with the process, for tests of all that does not depend on a disk.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::engine::{Change, Engine, EngineError, Table};

/// Tables in memory. A clone is another process's view of the same ones.
#[derive(Clone, Debug, Default)]
pub(super) struct Memory(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    rows: BTreeMap<(Table, String), Vec<u8>>,
    /// Whether commits fail, as on a full disk.
    is_full: bool,
    /// Whether one has failed since the last opening.
    has_failed: bool,
}

impl Memory {
    /// A disk that is full from now on, or no longer.
    pub(super) fn set_full(&self, is_full: bool) {
        self.state().is_full = is_full;
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The state, unless the tables must be opened again first.
    fn open(&self) -> Result<MutexGuard<'_, State>, EngineError> {
        let state = self.state();
        match state.has_failed {
            true => Err(EngineError::NoRoom("a write failed before".to_owned())),
            false => Ok(state),
        }
    }
}

impl Engine for Memory {
    fn get(&mut self, table: Table, key: &str) -> Result<Option<Vec<u8>>, EngineError> {
        Ok(self.open()?.rows.get(&(table, key.to_owned())).cloned())
    }

    fn rows(&mut self, table: Table) -> Result<Vec<(String, Vec<u8>)>, EngineError> {
        let state = self.open()?;
        let rows = state.rows.iter().filter(|((of, _), _)| *of == table);
        Ok(rows.map(|((_, key), value)| (key.clone(), value.clone())).collect())
    }

    fn commit(&mut self, changes: &[Change]) -> Result<(), EngineError> {
        let mut state = self.open()?;
        if state.is_full {
            state.has_failed = true;
            return Err(EngineError::NoRoom("no space left".to_owned()));
        }
        for Change { table, key, value } in changes.iter().cloned() {
            match value {
                Some(value) => state.rows.insert((table, key), value),
                None => state.rows.remove(&(table, key)),
            };
        }
        Ok(())
    }

    fn reopen(&mut self) -> Result<(), EngineError> {
        self.state().has_failed = false;
        Ok(())
    }

    fn remedy(&self) -> &'static str {
        "forget it"
    }
}
