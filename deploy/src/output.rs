//! Output. How is data printed? On stdout, as a table for people or as JSON for programs.

use std::fmt::Display;
use std::io::{IsTerminal as _, Write as _};
use std::sync::Mutex;
use std::time::Duration;

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle, WeakProgressBar};
use serde::Serialize;

use crate::exit_code;
use crate::failure::Failure;

/// Form of printed data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people.
    #[default]
    Table,
    /// One document.
    Json,
    /// One object a line.
    Ndjson,
}

impl Format {
    /// The form of what comes one after another without an end: no document holds it, so JSON is an object a line.
    #[must_use]
    pub fn streamed(self) -> Self {
        match self {
            Self::Table => Self::Table,
            Self::Json | Self::Ndjson => Self::Ndjson,
        }
    }
}

/// Writes a line to stdout; a closed pipe is no error (`zenav topic echo | head`), and ends the process. So does whatever else stops the
/// output, as an error: a full disk must not look like a result.
pub fn line(text: &str) {
    let mut out = std::io::stdout().lock();
    if let Err(error) = writeln!(out, "{text}").and_then(|()| out.flush()) {
        std::process::exit(if error.kind() == std::io::ErrorKind::BrokenPipe {
            exit_code::OK.into()
        } else {
            let _ = writeln!(std::io::stderr(), "zenav: cannot write to stdout: {error}");
            exit_code::FAILED.into()
        });
    }
}

/// Writes a line to stderr: what a person at a terminal reads beside the output. Where nobody reads it, it is lost, and the command goes on.
pub fn note(text: impl Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// A count of things that add an `s` when they are several: `1 plan`, `2 plans`.
#[must_use]
pub fn counted<N: Display + PartialEq + From<u8>>(count: N, thing: &str) -> String {
    let plural = if count == N::from(1_u8) { "" } else { "s" };
    format!("{count} {thing}{plural}")
}

/// `, perhaps `X``: the known name that may have been meant, of those that differ in at most so many letters.
#[must_use]
pub fn perhaps<'n>(meant: &str, known: impl IntoIterator<Item = &'n str>, slips: usize) -> String {
    let told = known.into_iter().map(|name| (strsim::osa_distance(meant, name), name));
    match told.min() {
        Some((distance, name)) if distance <= slips => format!(", perhaps `{name}`"),
        _ => String::new(),
    }
}

/// Prints one value: pretty as JSON, in one line as NDJSON, or by `table`.
///
/// # Errors
/// When the value cannot be written as JSON.
pub fn value<T: Serialize>(format: Format, value: &T, table: impl FnOnce(&T) -> String) -> Result<(), Failure> {
    let text = match format {
        Format::Table => table(value),
        Format::Json => serde_json::to_string_pretty(value).map_err(Failure::failed)?,
        Format::Ndjson => serde_json::to_string(value).map_err(Failure::failed)?,
    };
    line(text.trim_end_matches('\n'));
    Ok(())
}

/// Prints many values: a JSON array, one object a line, or one table.
///
/// # Errors
/// When a value cannot be written as JSON.
pub fn values<T: Serialize>(format: Format, values: &[T], table: impl FnOnce(&[T]) -> String) -> Result<(), Failure> {
    match format {
        Format::Ndjson => {
            for one in values {
                value(Format::Ndjson, one, |_| String::new())?;
            }
            Ok(())
        }
        other => value(other, &values, |values| table(values)),
    }
}

/// A progress bar of the form that a template gives it; hidden where stderr is no terminal.
#[must_use]
pub fn progress(bar: ProgressBar, template: &str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

/// A living line on stderr with the time and a message, and room for a picture above it as its prefix; `None` where stderr is no terminal.
#[must_use]
pub fn spinner() -> Option<ProgressBar> {
    std::io::stderr()
        .is_terminal()
        .then(|| living(ProgressDrawTarget::stderr()))
}

/// As [`spinner`], on stdout: for what is nothing but a display.
#[must_use]
pub fn display() -> Option<ProgressBar> {
    std::io::stdout()
        .is_terminal()
        .then(|| living(ProgressDrawTarget::stdout()))
}

fn living(target: ProgressDrawTarget) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, target);
    if let Ok(style) = ProgressStyle::with_template("{prefix}{spinner} {elapsed} {wide_msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(100));
    if let Ok(mut living) = LIVING.lock() {
        *living = Some(bar.downgrade());
    }
    bar
}

/// The display that stands on the terminal now.
static LIVING: Mutex<Option<WeakProgressBar>> = Mutex::new(None);

/// Stderr for log lines: a living display makes room for each, and leaves nothing of itself behind.
#[derive(Clone, Copy, Debug)]
pub struct LogWriter;

impl std::io::Write for LogWriter {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let living = LIVING.lock().ok().and_then(|living| living.as_ref()?.upgrade());
        let write = || std::io::stderr().lock().write(bytes);
        match living {
            Some(bar) => bar.suspend(write),
            None => write(),
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        std::io::stderr().lock().flush()
    }
}

/// Aligns rows of cells under a header.
#[must_use]
pub fn table(header: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        rows.iter()
            .filter_map(|row| row.get(column))
            .map(|cell| cell.chars().count())
            .chain([header[column].chars().count()])
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let print = |cells: &mut dyn Iterator<Item = &str>| {
        let padded: Vec<String> = cells
            .zip(&widths)
            .map(|(cell, width)| format!("{cell:<width$}"))
            .collect();
        padded.join("  ").trim_end().to_owned()
    };
    let mut lines = vec![print(&mut header.iter().copied())];
    lines.extend(rows.iter().map(|row| print(&mut row.iter().map(String::as_str))));
    lines.join("\n")
}
