//! `zenav record`. Records chosen keys into one or several files, for a time or until Ctrl-C.

use std::path::PathBuf;

use zenav_protocol::bus::interrupted;
use zenav_protocol::topics;

use super::recorder::Recording;
use super::writer::{RecordOptions, Written};
use crate::arguments::{positive, seconds, whole_in};
use crate::completion;
use crate::connect::{self, RobotArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::inspect::pattern;
use crate::output::{self, Format, listed};

/// Arguments of `zenav record`.
#[derive(Debug, clap::Args)]
#[command(
    allow_missing_positional = true,
    group(clap::ArgGroup::new("limits").multiple(true).args(["max_size", "max_duration"])),
    after_help = "Examples:\n  \
                  zenav record run.mcap                            everything of every robot, until Ctrl-C\n  \
                  zenav record --robot tiago scan pose run.mcap    two topics of one robot\n  \
                  zenav record --max-size 500MB run.mcap           run_0001.mcap, run_0002.mcap, …\n  \
                  zenav record --max-duration 600 --max-files 6 run.mcap    the last hour\n\
                  The files open in Foxglove and in any other tool for MCAP."
)]
pub struct RecordArgs {
    /// Keys (`zenav/*/edge/**`), sides and names (`edge/pose`), or names of topics (`pose`) [default: everything about the robots]
    #[arg(value_name = "KEYS", add = completion::topic_keys())]
    keys: Vec<String>,
    /// File to write; it must not exist yet
    #[arg(value_name = "OUT.mcap", value_parser = mcap)]
    out: PathBuf,
    #[command(flatten)]
    robot: RobotArgs,
    /// Record every key on the bus, including those that are not zenav's
    #[arg(long, conflicts_with = "keys")]
    all: bool,
    /// Start a new file at this size, such as 500MB or 2GB
    #[arg(long, value_name = "SIZE", value_parser = size)]
    max_size: Option<u64>,
    /// Start a new file after this time, s
    #[arg(long, value_name = "SECS", value_parser = positive)]
    max_duration: Option<f64>,
    /// Keep only this many files: delete the oldest when a new one starts
    #[arg(long, value_name = "N", requires = "limits", value_parser = whole_in(1..=1_000_000_usize))]
    max_files: Option<usize>,
    /// Stop after this time, s
    #[arg(long = "for", value_name = "SECS", value_parser = positive)]
    secs: Option<f64>,
    /// Leave out Foxglove's messages: record only the samples
    #[arg(long)]
    raw: bool,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// A file name, checked by extension: if it is forgotten, the last key would be taken for it.
fn mcap(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension() {
        Some(ending) if ending.eq_ignore_ascii_case("mcap") => Ok(path),
        _ => Err("expected a file's name that ends with .mcap".to_owned()),
    }
}

/// A size in bytes, with metric suffixes.
fn size(text: &str) -> Result<u64, String> {
    let expected = || "expected a size, such as 500MB or 2GB".to_owned();
    let text = text.trim();
    let end = text
        .find(|letter: char| !letter.is_ascii_digit() && letter != '.')
        .unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    let unit = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kb" => 1e3,
        "m" | "mb" => 1e6,
        "g" | "gb" => 1e9,
        "t" | "tb" => 1e12,
        _ => return Err(expected()),
    };
    let bytes = number.parse::<f64>().map_err(|_| expected())? * unit;
    if bytes >= 1e4 && bytes.is_finite() {
        Ok(bytes as u64)
    } else {
        Err(format!("{}, 10kB at least", expected()))
    }
}

/// `zenav record`.
///
/// # Errors
/// No connection, bad keys, a file that cannot be written, or a named robot of which nothing came.
pub fn record(args: &RecordArgs) -> Outcome {
    let robot = args.robot.robot.as_deref();
    let patterns = if args.all {
        // A member of a fleet is granted keys of zenav only.
        let is_member = args.robot.link.identity.identity.is_some();
        vec![if is_member { "zenav/**" } else { "**" }.to_owned()]
    } else if args.keys.is_empty() {
        let mut patterns = vec![format!("zenav/{}/**", robot.unwrap_or("*"))];
        if robot.is_some() {
            patterns.push(topics::SIM_CLOCK.key(&[]));
        }
        patterns
    } else {
        let patterns = args.keys.iter().map(|key| pattern(key, robot));
        patterns.collect::<Result<_, _>>()?
    };
    let options = RecordOptions {
        max_bytes: args.max_size,
        max_time: args.max_duration.map(seconds),
        max_files: args.max_files,
        raw_only: args.raw,
        ..RecordOptions::default()
    };
    let written = connect::on_bus(&args.robot.link, async |bus| {
        // For a while only, there is nothing to wait for.
        match (robot, args.secs) {
            (Some(_), Some(_)) => drop(connect::find(&bus, robot).await?),
            _ => connect::tell_absence(&bus, robot).await,
        }
        let mut recording = Recording::start(&bus, &patterns, &args.out, options)?;
        tracing::info!("recording {} into {}", listed(&patterns), args.out.display());
        let time = seconds(args.secs.unwrap_or(f64::INFINITY));
        tokio::select! {
            written = recording.ended() => written,
            () = interrupted() => recording.finish().await,
            () = tokio::time::sleep(time) => recording.finish().await,
        }
    })?;
    output::value(args.output, &written, table)?;
    if written.messages == 0 {
        return Err(Failure::timeout(format!(
            "nothing came on {}: the record is empty",
            listed(&patterns)
        )));
    }
    match robot.filter(|robot| args.keys.is_empty() && !has_robot(&written, robot)) {
        Some(robot) => Err(Failure::timeout(format!(
            "nothing came of robot `{robot}`: the record has none of its keys"
        ))),
        None => Ok(exit_code::OK),
    }
}

/// Whether anything of a robot was recorded; the simulated clock is of no robot.
fn has_robot(written: &Written, robot: &str) -> bool {
    let prefix = format!("zenav/{robot}/");
    written.keys.keys().any(|key| key.starts_with(&prefix))
}

fn table(written: &Written) -> String {
    let rows = written.keys.iter().map(|(key, count)| {
        let hz = *count as f64 / written.secs.max(1e-3);
        [key.clone(), count.to_string(), format!("{hz:.1}")]
    });
    let mut lines = vec![output::table(&["KEY", "MESSAGES", "HZ"], rows), String::new()];
    lines.push(format!(
        "{} on {} in {:.1} s: {:.1} MB of payload, {:.1} MB in {}; {} dropped",
        output::counted(written.messages, "message"),
        output::counted(written.keys.len(), "key"),
        written.secs,
        written.payload_bytes as f64 * 1e-6,
        written.file_bytes as f64 * 1e-6,
        output::counted(written.files.len() as u64 + written.deleted, "file"),
        written.dropped,
    ));
    if written.deleted > 0 {
        lines.push(format!("deleted {}", output::counted(written.deleted, "older file")));
    }
    lines.extend(written.files.iter().map(|file| format!("wrote {}", file.display())));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<RecordArgs, clap::Error> {
        crate::cli::parsed(&line.split(' ').collect::<Vec<_>>())
    }

    #[test]
    fn the_last_name_is_the_file_and_those_before_it_are_keys() {
        for (line, keys) in [
            ("run.mcap", &[][..]),
            ("--robot r --for 3 run.mcap", &[]),
            ("scan run.mcap", &["scan"]),
            ("--raw scan edge/pose run.mcap -o json", &["scan", "edge/pose"]),
        ] {
            let args = parse(line).unwrap();
            assert_eq!(args.keys, keys, "{line}");
            assert_eq!(args.out, PathBuf::from("run.mcap"), "{line}");
        }
        assert!(crate::cli::parsed::<RecordArgs>(&[]).is_err());
        let error = parse("scan pose").unwrap_err().to_string();
        assert!(error.contains("ends with .mcap"), "{error}");
        assert!(parse("--all scan run.mcap").is_err());
        // Only a record that is split has files to delete.
        assert!(parse("--max-files 3 run.mcap").is_err());
        assert!(parse("--max-files 0 --max-size 1MB run.mcap").is_err());
        let args = parse("--max-files 3 --max-duration 60 run.mcap").unwrap();
        assert_eq!(args.max_files, Some(3));
    }

    #[test]
    fn the_clock_alone_is_no_record_of_a_robot() {
        let of = |key: &str| Written {
            keys: [(key.to_owned(), 3)].into(),
            ..Written::default()
        };
        assert!(has_robot(&of("zenav/waffle/edge/pose"), "waffle"));
        assert!(!has_robot(&of("zenav/sim/clock"), "waffle"));
        assert!(!has_robot(&of("zenav/waffle2/edge/pose"), "waffle"));
    }

    #[test]
    fn sizes_have_the_usual_endings() {
        assert_eq!(size("500MB"), Ok(500_000_000));
        assert_eq!(size("1.5 g"), Ok(1_500_000_000));
        assert_eq!(size("20000"), Ok(20_000));
        for wrong in ["", "MB", "5", "-5MB", "5 parsecs", "1e9"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }
}
