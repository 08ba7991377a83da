//! Provenance. On which machine, and of which commit, was a figure measured?

use std::process::Command;

/// What a command prints, trimmed; `None` for nothing.
#[must_use]
pub fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    (!text.is_empty()).then_some(text)
}

/// The value in a file's first line of this name, after `:` or `=`.
#[must_use]
pub fn field(path: &str, name: &str) -> Option<String> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let line = text.lines().find(|line| line.starts_with(name))?;
    Some(line.split_once([':', '='])?.1.trim().trim_matches('"').to_owned())
}

/// Name of the processor.
#[must_use]
pub fn processor() -> String {
    field("/proc/cpuinfo", "model name").unwrap_or_else(|| std::env::consts::ARCH.to_owned())
}
