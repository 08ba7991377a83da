//! Recent log. The newest log lines of this process, bounded in number and length, for requests from other machines.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::{Debug, Write as _};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

use crate::process::unix_secs;

/// Lines that are kept.
const MOST_LINES: usize = 256;
/// Longest message or field, characters; the rest is cut off.
const LONGEST: usize = 400;
/// Most fields of a line.
const MOST_FIELDS: usize = 16;

static KEPT: LazyLock<Mutex<Kept>> = LazyLock::new(Mutex::default);

#[derive(Default)]
struct Kept {
    next: u64,
    lines: VecDeque<Line>,
}

fn kept() -> MutexGuard<'static, Kept> {
    KEPT.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A line of the log.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Line {
    /// Number within this process, from one.
    pub sequence: u64,
    /// Time by the machine's wall clock, s of UNIX time.
    pub unix_secs: f64,
    /// `ERROR`, `WARN` or `INFO`.
    pub level: String,
    /// Message of the event.
    pub message: String,
    /// Fields of the event.
    pub fields: BTreeMap<String, String>,
}

/// The lines after a number, oldest first, as far as they are kept.
#[must_use]
pub fn since(sequence: u64) -> Vec<Line> {
    let kept = kept();
    kept.lines
        .iter()
        .filter(|line| line.sequence > sequence)
        .cloned()
        .collect()
}

/// Keeps log lines of level `INFO` and above.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KeepRecent;

impl<S: Subscriber> Layer<S> for KeepRecent {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let metadata = event.metadata();
        if *metadata.level() > Level::INFO {
            return;
        }
        let mut line = Line {
            unix_secs: unix_secs(),
            level: metadata.level().to_string(),
            ..Line::default()
        };
        event.record(&mut line);
        let mut kept = kept();
        kept.next += 1;
        line.sequence = kept.next;
        if kept.lines.len() == MOST_LINES {
            kept.lines.pop_front();
        }
        kept.lines.push_back(line);
    }
}

impl Line {
    fn put(&mut self, field: &Field, text: &str) {
        let text = text.chars().take(LONGEST).collect();
        if field.name() == "message" {
            self.message = text;
        } else if self.fields.len() < MOST_FIELDS {
            self.fields.insert(field.name().to_owned(), text);
        }
    }
}

impl Visit for Line {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.put(field, value);
    }

    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        let mut text = String::new();
        // Writing to memory does not fail.
        let _ = write!(text, "{value:?}");
        self.put(field, &text);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use tracing_subscriber::layer::SubscriberExt as _;

    use super::*;

    #[test]
    fn the_newest_lines_are_kept_short_and_few_and_details_are_not() {
        let subscriber = tracing_subscriber::registry().with(KeepRecent);
        tracing::subscriber::with_default(subscriber, || {
            for number in 0..2 * MOST_LINES {
                tracing::warn!(robot = "recent", number, reason = "x".repeat(5000), "plan rejected");
            }
            tracing::debug!(robot = "recent", "a detail");
        });
        let lines = since(0);
        assert!(lines.len() <= MOST_LINES);
        let last = lines.last().unwrap();
        assert_eq!((last.level.as_str(), last.message.as_str()), ("WARN", "plan rejected"));
        assert_eq!(
            (last.fields["robot"].as_str(), last.fields["reason"].len()),
            ("recent", LONGEST)
        );
        assert_eq!(last.fields["number"], (2 * MOST_LINES - 1).to_string());
        assert!(since(last.sequence).is_empty());
    }
}
