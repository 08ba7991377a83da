//! What is wrong with a tree file: where, what, and what was expected.

/// One thing that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}:{line}:{column}: {message}: expected {expected}")]
pub struct TreeError {
    /// Name of the file.
    pub file: String,
    /// Line, from 1.
    pub line: u32,
    /// Character of the line, from 1.
    pub column: u32,
    /// What is wrong.
    pub message: String,
    /// What should stand there.
    pub expected: String,
}

/// Everything that is wrong, in the order of the checks; at least one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TreeErrors {
    /// The first ones.
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

/// Where something stands; `file` is an index into the files read.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) file: u16,
    pub(super) line: u32,
    pub(super) column: u32,
}

/// Errors so far.
pub(super) struct Collector {
    files: Vec<String>,
    found: TreeErrors,
    limit: usize,
}

impl Collector {
    pub(super) fn new(limit: usize) -> Collector {
        let found = TreeErrors { errors: Vec::new(), more: 0 };
        Collector { files: Vec::new(), found, limit: limit.max(1) }
    }

    /// Makes a file known and gives its index.
    pub(super) fn add_file(&mut self, name: &str) -> u16 {
        self.files.push(name.to_owned());
        (self.files.len() - 1) as u16
    }

    pub(super) fn file_index(&self, name: &str) -> Option<u16> {
        self.files.iter().position(|file| file == name).map(|index| index as u16)
    }

    /// A place in words, for messages about another place.
    pub(super) fn describe(&self, at: Place) -> String {
        let file = self.files.get(usize::from(at.file)).map_or("", String::as_str);
        format!("{file}:{}:{}", at.line, at.column)
    }

    pub(super) fn add(&mut self, at: Place, message: impl Into<String>, expected: impl Into<String>) {
        if self.found.errors.len() >= self.limit {
            self.found.more += 1;
            return;
        }
        self.found.errors.push(TreeError {
            file: self.files.get(usize::from(at.file)).cloned().unwrap_or_default(),
            line: at.line,
            column: at.column,
            message: message.into(),
            expected: expected.into(),
        });
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
