//! Logging. One line per event on stderr, as text for people or as JSON for collectors; fields have the same names (`robot`, `part`,
//! `goal`, `plan`) in both.

use std::io::IsTerminal as _;
use std::str::FromStr;
use std::sync::OnceLock;

use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer as _, fmt, registry};

use crate::declarations::{self, NoteDropped};
use crate::recent::KeepRecent;

/// Form of a log line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// For people; coloured on a terminal, unless `NO_COLOR` is set.
    #[default]
    Text,
    /// One JSON object: `timestamp`, `level`, `message`, `target`, and the event's fields.
    Json,
}

impl FromStr for Format {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "text" => Ok(Self::Text),
            "json" => Ok(Self::Json),
            _ => Err(format!("`{name}`: expected text or json")),
        }
    }
}

/// Whether output on stderr may be coloured: on a terminal, without `NO_COLOR`.
#[must_use]
pub fn colors() -> bool {
    std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// The format given to [`init`].
static FORMAT: OnceLock<Format> = OnceLock::new();

/// The form of this process's log lines. With JSON, stderr must carry no other text for people.
#[must_use]
pub fn format() -> Format {
    FORMAT.get().copied().unwrap_or_default()
}

/// Starts logging, filtered by `RUST_LOG`, or by `filter` if that is unset. From now on dropped declarations are noted ([`declarations`]),
/// whatever is logged. A second call (tests in one process) has no effect.
pub fn init<W>(format: Format, filter: &str, writer: W)
where
    W: for<'a> MakeWriter<'a> + Send + Sync + 'static,
{
    let format = *FORMAT.get_or_init(|| format);
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(filter));
    let all = registry().with(NoteDropped.with_filter(declarations::filter()));
    // A closed stderr must not be reported on stderr: that would end the process.
    let lines = fmt::layer().with_writer(writer).log_internal_errors(false);
    let _ = match format {
        Format::Text => {
            let lines = lines.with_ansi(colors()).with_target(false);
            all.with(KeepRecent.and_then(lines).with_filter(filter)).try_init()
        }
        Format::Json => {
            let lines = lines.json().flatten_event(true);
            let lines = lines.with_current_span(false).with_span_list(false);
            all.with(KeepRecent.and_then(lines).with_filter(filter)).try_init()
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_two_formats_and_others_are_refused_with_their_names() {
        assert_eq!("json".parse(), Ok(Format::Json));
        assert_eq!("text".parse(), Ok(Format::default()));
        assert_eq!("xml".parse::<Format>(), Err("`xml`: expected text or json".to_owned()));
    }
}
