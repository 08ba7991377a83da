//! Engine. What does a mission's store need of a database?
//!
//! Four tables of records with string keys, and changes that are made together. What the records mean is the store's business.

use std::fmt::Debug;

/// A table of a store.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Table {
    /// Goals by id.
    Goals,
    /// First answers by request id.
    Answers,
    /// The tree, the plan in force, the time, the incarnation.
    Singles,
    /// The store's own metadata.
    Own,
}

impl Table {
    /// Every table.
    pub(super) const ALL: [Self; 4] = [Self::Goals, Self::Answers, Self::Singles, Self::Own];

    /// The table's name on disk and on the wire.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Goals => "goals",
            Self::Answers => "answers",
            Self::Singles => "singles",
            Self::Own => "own",
        }
    }
}

/// One record that is written or, without a value, removed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Change {
    pub(super) table: Table,
    pub(super) key: String,
    pub(super) value: Option<Vec<u8>>,
}

/// Why an engine failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum EngineError {
    /// Another mission has the tables.
    Locked,
    /// Nothing can be stored now; [`Engine::reopen`] comes before anything else.
    NoRoom(String),
    /// The tables are not those that were written.
    Foreign {
        what: String,
        /// As [`Engine::remedy`].
        remedy: &'static str,
    },
    /// Anything else.
    Failed(String),
}

/// A database that keeps one mission's tables.
///
/// While it is open no other mission commits to them. The store serialises its calls, so a commit rests on what was read before it.
pub(super) trait Engine: Debug + Send {
    /// One record.
    fn get(&mut self, table: Table, key: &str) -> Result<Option<Vec<u8>>, EngineError>;

    /// All records of a table, in the order of their keys' bytes.
    fn rows(&mut self, table: Table) -> Result<Vec<(String, Vec<u8>)>, EngineError>;

    /// Makes all of these changes or none; each names another record. They outlive a loss of power once this returns. After an error the
    /// changes may or may not be stored: read again.
    fn commit(&mut self, changes: &[Change]) -> Result<(), EngineError>;

    /// Opens the tables again after a failure: what was committed is there.
    fn reopen(&mut self) -> Result<(), EngineError>;

    /// How to get rid of tables that were damaged.
    fn remedy(&self) -> &'static str;
}
