//! Output. Prints data on stdout, as a table for people or as JSON for programs.

use std::fmt::Display;
use std::io::{IsTerminal as _, Write as _};
use std::sync::Mutex;
use std::time::Duration;

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle, WeakProgressBar};
use serde::Serialize;

use crate::exit_code;
use crate::failure::{Failure, Outcome};

/// Format of printed data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Human-readable.
    #[default]
    Table,
    /// One JSON document.
    Json,
    /// One JSON object per line.
    Ndjson,
}

impl Format {
    /// The format for an endless stream: a stream fits into no document, so JSON becomes one object per line.
    #[must_use]
    pub fn streamed(self) -> Self {
        match self {
            Self::Table => Self::Table,
            Self::Json | Self::Ndjson => Self::Ndjson,
        }
    }
}

/// Writes a line to stdout. A closed pipe (`zenav topic echo | head`) ends the process without an error. Any other write error ends it
/// with one: a full disk must not look like a result.
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

/// Writes a line to stderr for a person at a terminal. If it cannot be written, it is lost, and the command continues.
pub fn note(text: impl Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// A count and its noun, with a plural `s` if needed: `1 plan`, `2 plans`.
#[must_use]
pub fn counted<N: Display + PartialEq + From<u8>>(count: N, thing: &str) -> String {
    let plural = if count == N::from(1_u8) { "" } else { "s" };
    format!("{count} {thing}{plural}")
}

/// A piece of a text about a value; nothing if there is none.
pub fn piece<T>(value: Option<T>, text: impl FnOnce(T) -> String) -> String {
    value.map_or_else(String::new, text)
}

/// Names in a row: `a, b, c`.
#[must_use]
pub fn listed<N: Display>(names: impl IntoIterator<Item = N>) -> String {
    let names: Vec<String> = names.into_iter().map(|name| name.to_string()).collect();
    names.join(", ")
}

/// Text escaped for XML and HTML, for contents and attributes; control characters but line breaks become spaces.
#[must_use]
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            letter if letter.is_control() && letter != '\n' => escaped.push(' '),
            letter => escaped.push(letter),
        }
    }
    escaped
}

/// The known name most similar to the meant one, within so many edits.
#[must_use]
pub fn nearest<'n>(meant: &str, known: impl IntoIterator<Item = &'n str>, slips: usize) -> Option<&'n str> {
    let told = known.into_iter().map(|name| (strsim::osa_distance(meant, name), name));
    let (_, name) = told.min().filter(|(distance, _)| *distance <= slips)?;
    Some(name)
}

/// `, perhaps `X``: the known name most similar to the meant one, within three edits.
#[must_use]
pub fn perhaps<'n>(meant: &str, known: impl IntoIterator<Item = &'n str>) -> String {
    piece(nearest(meant, known, 3), |name| format!(", perhaps `{name}`"))
}

/// Prints one value: pretty-printed JSON, one line of NDJSON, or by `table`.
///
/// # Errors
/// The value cannot be written as JSON.
pub fn value<T: Serialize>(format: Format, value: &T, table: impl FnOnce(&T) -> String) -> Outcome {
    let text = match format {
        Format::Table => table(value),
        Format::Json => pretty(value)?,
        Format::Ndjson => compact(value)?,
    };
    line(text.trim_end_matches('\n'));
    Ok(exit_code::OK)
}

/// Prints several values: a JSON array, one object per line, or one table.
///
/// # Errors
/// A value cannot be written as JSON.
pub fn values<T: Serialize>(format: Format, values: &[T], table: impl FnOnce(&[T]) -> String) -> Outcome {
    if format == Format::Table {
        line(table(values).trim_end_matches('\n'));
        return Ok(exit_code::OK);
    }
    let texts: Vec<String> = values.iter().map(compact).collect::<Result<_, _>>()?;
    match format {
        Format::Ndjson => texts.iter().for_each(|text| line(text)),
        _ => line(&indented(&format!("[{}]", texts.join(",")))),
    }
    Ok(exit_code::OK)
}

/// A value as JSON in one line.
fn compact<T: Serialize>(value: &T) -> Result<String, Failure> {
    serde_json::to_string(value).map_err(Failure::failed)
}

/// A value as JSON in indented lines.
///
/// # Errors
/// The value cannot be written as JSON.
pub(crate) fn pretty<T: Serialize>(value: &T) -> Result<String, Failure> {
    compact(value).map(|text| indented(&text))
}

/// JSON without spaces in the form of [`serde_json::to_string_pretty`], which would compile a second serializer for every type.
fn indented(compact: &str) -> String {
    let mut text = String::with_capacity(2 * compact.len());
    let (mut depth, mut is_quoted, mut is_escaped) = (0_usize, false, false);
    let new_line = |text: &mut String, depth: usize| {
        text.push('\n');
        text.push_str(&"  ".repeat(depth));
    };
    let mut letters = compact.chars().peekable();
    while let Some(letter) = letters.next() {
        if is_quoted {
            text.push(letter);
            is_quoted = letter != '"' || is_escaped;
            is_escaped = letter == '\\' && !is_escaped;
            continue;
        }
        match letter {
            '[' | '{' => {
                text.push(letter);
                if let Some(end) = letters.next_if(|next| matches!(next, ']' | '}')) {
                    text.push(end);
                } else {
                    depth += 1;
                    new_line(&mut text, depth);
                }
            }
            ']' | '}' => {
                depth = depth.saturating_sub(1);
                new_line(&mut text, depth);
                text.push(letter);
            }
            ',' => {
                text.push(letter);
                new_line(&mut text, depth);
            }
            ':' => text.push_str(": "),
            _ => {
                text.push(letter);
                is_quoted = letter == '"';
            }
        }
    }
    text
}

/// A value rounded to hundredths; a rounded zero has no sign.
#[must_use]
pub fn hundredths(value: f64) -> f64 {
    (100.0 * value).round() / 100.0 + 0.0
}

/// A progress bar from a template; hidden if stderr is not a terminal.
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

/// A live line on stderr with time and message, and a prefix that can hold a picture above it; `None` if stderr is not a terminal.
#[must_use]
pub fn spinner() -> Option<ProgressBar> {
    std::io::stderr()
        .is_terminal()
        .then(|| living(ProgressDrawTarget::stderr()))
}

/// Like [`spinner`], on stdout: for commands that only display.
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

/// The display currently on the terminal.
static LIVING: Mutex<Option<WeakProgressBar>> = Mutex::new(None);

/// Stderr for log lines: a live display makes room for each, without leaving fragments.
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
pub fn table<R: AsRef<[String]>>(header: &[&str], rows: impl IntoIterator<Item = R>) -> String {
    let rows: Vec<R> = rows.into_iter().collect();
    let cells: Vec<&[String]> = rows.iter().map(|row| row.as_ref()).collect();
    aligned(header, &cells)
}

/// As [`table`], compiled once for all kinds of rows.
fn aligned(header: &[&str], rows: &[&[String]]) -> String {
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn json_is_indented_as_serde_json_does_it() {
        for value in [
            json!(null),
            json!("a, {b}: [c]"),
            json!([]),
            json!({}),
            json!([[], {}, [1, -2.5e-7, [true, null]]]),
            json!({ "a": { "b": [{ "c": {} }] }, "d\"e\\": "\\\" : , [ {\n é ] }\\" }),
        ] {
            assert_eq!(pretty(&value).unwrap(), serde_json::to_string_pretty(&value).unwrap());
        }
    }
}
