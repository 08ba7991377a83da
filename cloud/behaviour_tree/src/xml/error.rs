//! Errors of a tree file: position, message, and what was expected.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

/// What is wrong at one place of a tree file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, thiserror::Error)]
#[error("{file}:{line}:{column}: {message}: expected {expected}")]
pub struct TreeError {
    /// Name of the file.
    pub file: String,
    /// Line, from 1.
    pub line: u32,
    /// Character of the line, from 1.
    pub column: u32,
    /// What is wrong, with the value that was found.
    pub message: String,
    /// What was expected.
    pub expected: String,
}

/// All errors, in the order of the checks; at least one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TreeErrors {
    /// The first errors; a limit keeps the list short.
    pub errors: Vec<TreeError>,
    /// How many more there are.
    pub more: usize,
}

impl std::fmt::Display for TreeErrors {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (index, error) in self.errors.iter().enumerate() {
            if index > 0 {
                writeln!(out)?;
            }
            write!(out, "{error}")?;
        }
        match self.more {
            0 => Ok(()),
            more => write!(out, "\n… and {more} more"),
        }
    }
}

impl std::error::Error for TreeErrors {}

/// Position of something; `file` is an index into the files read. Line and column are computed only for reported errors.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Place {
    pub(super) file: u16,
    /// Byte of the file.
    pub(super) offset: u32,
}

/// Longest message or expectation, characters.
const MESSAGE: usize = 300;

struct File {
    name: String,
    text: String,
    /// Byte at which each line starts.
    lines: Vec<usize>,
}

impl File {
    /// Line and column of a byte, from 1.
    fn position(&self, offset: usize) -> (u32, u32) {
        let line = self.lines.partition_point(|start| *start <= offset).max(1);
        let start = self.lines.get(line - 1).copied().unwrap_or(0);
        let column = self.text.get(start..offset).map_or(0, |before| before.chars().count());
        (line as u32, column as u32 + 1)
    }
}

/// Errors found so far.
pub(super) struct Collector {
    files: Vec<File>,
    found: TreeErrors,
    limit: usize,
    /// Warnings by their message without position; the value is the message with position. At most `limit`.
    doubts: BTreeMap<String, String>,
    /// Pairs of ports that have been reported.
    clashes: BTreeSet<(Place, Place)>,
}

impl Collector {
    pub(super) fn new(limit: usize) -> Collector {
        Collector {
            files: Vec::new(),
            found: TreeErrors {
                errors: Vec::new(),
                more: 0,
            },
            limit: limit.max(1),
            doubts: BTreeMap::new(),
            clashes: BTreeSet::new(),
        }
    }

    /// Registers a file and returns its index.
    pub(super) fn add_file(&mut self, name: &str) -> u16 {
        self.files.push(File {
            name: name.to_owned(),
            text: String::new(),
            lines: vec![0],
        });
        (self.files.len() - 1) as u16
    }

    /// Sets the text of a file, so that positions in it have lines.
    pub(super) fn add_text(&mut self, file: u16, text: &str) {
        if let Some(file) = self.files.get_mut(usize::from(file)) {
            file.text = text.to_owned();
            let breaks = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n');
            file.lines = std::iter::once(0).chain(breaks.map(|(at, _)| at + 1)).collect();
        }
    }

    pub(super) fn file_index(&self, name: &str) -> Option<u16> {
        self.files
            .iter()
            .position(|file| file.name == name)
            .map(|index| index as u16)
    }

    pub(super) fn file_name(&self, index: u16) -> &str {
        self.files.get(usize::from(index)).map_or("", |file| &file.name)
    }

    /// A position as text, for messages about another position.
    pub(super) fn describe(&self, at: Place) -> String {
        let Some(file) = self.files.get(usize::from(at.file)) else {
            return String::new();
        };
        let (line, column) = file.position(at.offset as usize);
        format!("{}:{line}:{column}", file.name)
    }

    pub(super) fn add(&mut self, at: Place, message: impl Into<String>, expected: impl Into<String>) {
        let position = match self.files.get(usize::from(at.file)) {
            Some(file) if !self.is_full() => file.position(at.offset as usize),
            _ => (0, 0),
        };
        self.add_at(at.file, position, message, expected);
    }

    /// Adds a warning; the same warning about another position is not repeated.
    pub(super) fn warn(&mut self, at: Place, message: &str) {
        let message = shortened(message, MESSAGE);
        if self.doubts.len() < self.limit && !self.doubts.contains_key(&message) {
            let told = format!("{}: {message}", self.describe(at));
            self.doubts.insert(message, told);
        }
    }

    /// The warnings, sorted.
    pub(super) fn warnings(&self) -> Vec<String> {
        self.doubts.values().cloned().collect()
    }

    /// Whether these two ports are reported for the first time: a SubTree that is used twice is unfolded twice.
    pub(super) fn is_new_clash(&mut self, one: Place, other: Place) -> bool {
        self.clashes.insert((one, other))
    }

    /// As `add`, with known line and column.
    pub(super) fn add_at(
        &mut self,
        file: u16,
        (line, column): (u32, u32),
        message: impl Into<String>,
        expected: impl Into<String>,
    ) {
        if self.is_full() {
            self.found.more += 1;
            return;
        }
        self.found.errors.push(TreeError {
            file: self
                .files
                .get(usize::from(file))
                .map(|file| file.name.clone())
                .unwrap_or_default(),
            line,
            column,
            message: shortened(&message.into(), MESSAGE),
            expected: shortened(&expected.into(), MESSAGE),
        });
    }

    /// Whether further errors are only counted: then their messages need not be composed.
    pub(super) fn is_full(&self) -> bool {
        self.found.errors.len() >= self.limit
    }

    /// Number of errors so far, reported or not.
    pub(super) fn count(&self) -> usize {
        self.found.errors.len() + self.found.more
    }

    pub(super) fn is_empty(&self) -> bool {
        self.found.errors.is_empty()
    }

    pub(super) fn into_result<T>(self, value: T) -> Result<T, TreeErrors> {
        if self.is_empty() { Ok(value) } else { Err(self.found) }
    }

    pub(super) fn into_errors(self) -> TreeErrors {
        self.found
    }
}

/// The beginning of a text.
pub(crate) fn shortened(text: &str, most: usize) -> String {
    match text.char_indices().nth(most) {
        Some((end, _)) => format!("{}…", text.get(..end).unwrap_or_default()),
        None => text.to_owned(),
    }
}
