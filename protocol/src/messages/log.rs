//! Logs. What were the last log lines of a process?

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Asks a component for the newest lines of its process's log.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LogRequest {
    /// Only lines after this number; without it, all that are kept.
    #[serde(default)]
    pub since: u64,
}

/// The newest lines of a process's log.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LogReply {
    /// Name of the machine.
    pub host: String,
    /// Process id on that machine.
    pub pid: u32,
    /// Random number drawn at start: distinguishes processes with the same id on one machine name, as in containers.
    #[serde(default)]
    pub instance: u32,
    /// Name of the session that answers.
    pub part: String,
    /// Lines at `INFO` and above, oldest first; a few hundred are kept.
    pub lines: Vec<LogLine>,
}

/// A line of a log.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LogLine {
    /// Number within the process, from one.
    pub sequence: u64,
    /// Time by the machine's wall clock, s of UNIX time.
    pub unix_secs: f64,
    /// `ERROR`, `WARN` or `INFO`.
    pub level: String,
    /// What happened.
    pub message: String,
    /// Structured fields: `robot`, `part`, `goal`, `plan`, `reason`, …
    #[serde(default)]
    pub fields: BTreeMap<String, String>,
}
