//! `zenav logs`. Shows the latest log lines of a deployment's parts, on whatever host they run.
//!
//! Each process keeps its newest lines and answers with them. Nothing is published: a burst of log lines costs the bus nothing, and a
//! robot's link carries log lines only on request.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use clap::ValueEnum;
use serde::Serialize;
use zenav_protocol::bus::Bus;
use zenav_protocol::messages::{LogLine, LogReply, LogRequest};
use zenav_protocol::topics;

use super::parts::check_admitted;
use crate::completion;
use crate::connect::{self, LinkArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Longest wait for answers; parts that have not answered by then are skipped.
const ANSWER_WITHIN: Duration = Duration::from_millis(1500);
/// Polling period while following.
const PERIOD: Duration = Duration::from_secs(1);

/// Arguments of `zenav logs`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Each process keeps its last 256 lines; the whole log is where its service manager puts stderr.\n\nExamples:\n  zenav logs --level warn\n  zenav logs --robot tiago --follow"
)]
pub struct LogsArgs {
    #[command(flatten)]
    link: LinkArgs,
    /// Only lines about this robot
    #[arg(long, add = completion::robots())]
    robot: Option<String>,
    /// Lowest level to show
    #[arg(long, value_enum, default_value_t)]
    level: Level,
    /// Keep showing new lines until Ctrl-C
    #[arg(short, long)]
    follow: bool,
    /// Output format; a table prints one line of text each
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Level of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
enum Level {
    /// Normal operation
    #[default]
    Info,
    /// Needs attention
    Warn,
    /// Failure
    Error,
}

impl Level {
    fn of(name: &str) -> Self {
        match name {
            "ERROR" => Self::Error,
            "WARN" => Self::Warn,
            _ => Self::Info,
        }
    }
}

/// A log line and its origin.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Said {
    host: String,
    pid: u32,
    #[serde(flatten)]
    line: LogLine,
}

/// Shows the newest lines of all processes, in order of time.
///
/// # Errors
/// [`exit_code::CANNOT_CONNECT`] without a router, [`exit_code::TIMEOUT`] for an identity that it does not admit.
pub fn logs(args: &LogsArgs) -> Outcome {
    connect::on_bus(&args.link, async |bus| {
        if args.robot.is_some() && !args.follow {
            connect::find(&bus, args.robot.as_deref()).await?;
        }
        let mut seen = BTreeMap::new();
        let format = if args.follow {
            args.output.streamed()
        } else {
            args.output
        };
        loop {
            let replies = ask(&bus).await?;
            if !args.follow {
                check_admitted(&args.link, !replies.is_empty())?;
            }
            let lines = newest(replies, &mut seen);
            let shown: Vec<Said> = lines.into_iter().filter(|said| fits(args, &said.line)).collect();
            if !(shown.is_empty() && (args.follow || args.output == Format::Table)) {
                output::values(format, &shown, text)?;
            }
            if !args.follow {
                return Ok(exit_code::OK);
            }
            tokio::select! {
                () = zenav_protocol::bus::interrupted() => return Ok(exit_code::INTERRUPTED),
                () = tokio::time::sleep(PERIOD) => {}
            }
        }
    })
}

/// Asks every part. All parts of one process give the same answer.
async fn ask(bus: &Bus) -> Result<Vec<LogReply>, Failure> {
    let request = LogRequest::default();
    let (edges, parts) = tokio::join!(
        bus.ask_all(&topics::EDGE_LOG, &["*"], &request, ANSWER_WITHIN),
        bus.ask_all(&topics::PART_LOG, &["*"], &request, ANSWER_WITHIN)
    );
    let answers = edges?.into_iter().chain(parts?);
    Ok(answers.filter_map(|answer| answer.result.ok()).collect())
}

/// The lines not seen before, each once, in order of time; remembers the last one of each process.
fn newest(replies: Vec<LogReply>, seen: &mut BTreeMap<(String, u32, u32), u64>) -> Vec<Said> {
    let mut processes = BTreeSet::new();
    let mut lines = Vec::new();
    for LogReply {
        host,
        pid,
        instance,
        lines: said,
        ..
    } in replies
    {
        if !processes.insert((host.clone(), pid, instance)) {
            continue;
        }
        let last = seen.entry((host.clone(), pid, instance)).or_default();
        for line in said
            .into_iter()
            .filter(|line| line.sequence > *last)
            .collect::<Vec<_>>()
        {
            *last = line.sequence.max(*last);
            lines.push(Said {
                host: host.clone(),
                pid,
                line,
            });
        }
    }
    lines.sort_by(|a, b| a.line.unix_secs.total_cmp(&b.line.unix_secs));
    lines
}

fn fits(args: &LogsArgs, line: &LogLine) -> bool {
    let about = |robot: &String| {
        let is_of = |name: &str| line.fields.get(name);
        is_of("robot") == Some(robot) || is_of("part").is_some_and(|part| part.ends_with(&format!("-{robot}")))
    };
    Level::of(&line.level) >= args.level && args.robot.as_ref().is_none_or(about)
}

fn text(lines: &[Said]) -> String {
    let one = |said: &Said| {
        let line = &said.line;
        let fields: Vec<String> = line
            .fields
            .iter()
            .map(|(name, value)| format!("{name}={value}"))
            .collect();
        let text = format!(
            "{} {:<5} {}[{}] {} {}",
            clock(line.unix_secs),
            line.level,
            said.host,
            said.pid,
            line.message,
            fields.join(" ")
        );
        // Text of another process must not move this terminal's cursor.
        text.trim_end()
            .chars()
            .map(|letter| if letter.is_control() { '\u{fffd}' } else { letter })
            .collect::<String>()
    };
    lines.iter().map(one).collect::<Vec<_>>().join("\n")
}

/// Time of day, UTC.
fn clock(unix_secs: f64) -> String {
    let millis = (unix_secs.max(0.0) * 1e3) as u64;
    let secs = millis / 1000;
    format!(
        "{:02}:{:02}:{:02}.{:03}",
        secs / 3600 % 24,
        secs / 60 % 60,
        secs % 60,
        millis % 1000
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reply(part: &str, sequences: &[u64]) -> LogReply {
        let line = |sequence: &u64| LogLine {
            sequence: *sequence,
            unix_secs: *sequence as f64,
            message: "ready\x1b[2J".to_owned(),
            ..LogLine::default()
        };
        LogReply {
            host: "site-1".to_owned(),
            pid: 7,
            instance: 0,
            part: part.to_owned(),
            lines: sequences.iter().map(line).collect(),
        }
    }

    #[test]
    fn lines_of_a_process_show_once_whatever_parts_answer_and_however_often() {
        let mut seen = BTreeMap::new();
        let numbers = |lines: Vec<Said>| lines.iter().map(|said| said.line.sequence).collect::<Vec<_>>();
        let first = newest(vec![reply("edge-a", &[1, 2]), reply("mapping-a", &[1, 2])], &mut seen);
        assert_eq!(numbers(first), [1, 2]);
        assert_eq!(numbers(newest(vec![reply("mapping-a", &[1, 2, 3])], &mut seen)), [3]);
        let mut of_another_container = reply("edge-b", &[1]);
        of_another_container.instance = 1;
        assert_eq!(numbers(newest(vec![of_another_container], &mut seen)), [1]);
    }

    #[test]
    fn a_line_of_another_process_is_text_and_nothing_else() {
        let lines = newest(vec![reply("edge-a", &[3_661])], &mut BTreeMap::new());
        let text = text(&lines);
        assert!(
            text.starts_with("01:01:01.000") && text.contains("site-1[7] ready"),
            "{text}"
        );
        assert!(!text.contains('\x1b'), "{text}");
    }
}
