//! Which keys carry what, how often and how much? Raw samples: a topic that this program does not know is shown too.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use tokio::time::Instant;
use zenav_protocol::bus::{Bus, RawSample, RawSubscription};
use zenav_protocol::messages::exit_code;
use zenav_protocol::topics::{self, Qos, Row, TABLE};

use super::meter::{Meter, Reading, bytes};
use super::payload;
use crate::connect::{self, RobotArgs, positive};
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Samples that may wait to be shown.
const BACKLOG: usize = 4096;

/// Topics.
#[derive(Debug, clap::Args)]
pub struct TopicArgs {
    /// Which robot.
    #[command(flatten)]
    robot: RobotArgs,
    /// Form of what is printed
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: TopicCommand,
}

#[derive(Debug, clap::Subcommand)]
enum TopicCommand {
    /// List the keys that carry something now
    List {
        /// Listen for this long, s
        #[arg(long = "for", value_name = "SECS", default_value_t = 1.5, value_parser = positive)]
        secs: f64,
        /// List the table of all keys instead
        #[arg(long)]
        table: bool,
    },
    /// Print a topic's messages
    Echo(ListenArgs),
    /// Measure how often a topic's messages come
    Hz(ListenArgs),
    /// Measure how many bytes a topic's messages take
    Bw(ListenArgs),
    /// Say what a topic is, and whether it carries something now
    Info {
        /// A key, or the name of a topic or ask
        key: String,
    },
}

#[derive(Debug, clap::Args)]
struct ListenArgs {
    /// A key (`zenav/*/edge/pose`), a side and name (`edge/pose`), or the name of a topic (`pose`)
    key: String,
    /// End after this many messages
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// End after this time, s
    #[arg(long = "for", value_name = "SECS", value_parser = positive)]
    secs: Option<f64>,
}

/// Lists, prints and measures topics.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for a name that no topic has, [`exit_code::TIMEOUT`] when nothing came in the time given.
pub fn topic(args: &TopicArgs) -> Outcome {
    if let TopicCommand::List { table: true, .. } = args.command {
        output::values(
            args.output,
            &TABLE.iter().map(Known::of).collect::<Vec<_>>(),
            known_table,
        )?;
        return Ok(exit_code::OK);
    }
    let robot = args.robot.robot.as_deref();
    connect::on_bus(&args.robot.link, async |bus| {
        if robot.is_some() {
            connect::find(&bus, robot).await?;
        }
        match &args.command {
            TopicCommand::List { secs, .. } => {
                let meters = listen(&bus, &format!("zenav/{}/**", robot.unwrap_or("*")), seconds(*secs)).await?;
                let rows: Vec<Live> = meters
                    .iter()
                    .map(|(key, (meter, encoding))| Live::new(key, meter.read(), encoding))
                    .collect();
                output::values(args.output, &rows, live_table)?;
                Ok(exit_code::OK)
            }
            TopicCommand::Echo(listen) => echo(&bus, &pattern(&listen.key, robot)?, listen, args.output).await,
            TopicCommand::Hz(listen) => {
                measure(&bus, &pattern(&listen.key, robot)?, listen, args.output, hz_line).await
            }
            TopicCommand::Bw(listen) => {
                measure(&bus, &pattern(&listen.key, robot)?, listen, args.output, bw_line).await
            }
            TopicCommand::Info { key } => info(&bus, key, robot, args.output).await,
        }
    })
}

fn seconds(secs: f64) -> Duration {
    Duration::try_from_secs_f64(secs).unwrap_or(Duration::MAX)
}

/// The key expression that is meant.
fn pattern(text: &str, robot: Option<&str>) -> Result<String, Failure> {
    let robot = robot.unwrap_or("*");
    if text.starts_with("zenav/") || text.starts_with('*') || text.starts_with('@') {
        return Ok(text.to_owned());
    }
    if text.contains('/') {
        return Ok(format!("zenav/{robot}/{text}"));
    }
    let row = TABLE.iter().find(|row| row.qos.is_some() && row_name(row) == text);
    let row = row.ok_or_else(|| {
        let names: Vec<&str> = TABLE.iter().filter(|row| row.qos.is_some()).map(row_name).collect();
        Failure::not_found(format!(
            "no topic `{text}`: there are {} (or give a key, such as zenav/*/edge/pose)",
            names.join(", ")
        ))
    })?;
    Ok(topics::alive_key(row.pattern, &[robot]))
}

/// A row's own name: the last chunk of its key that is not filled in.
fn row_name(row: &Row) -> &'static str {
    row.pattern
        .rsplit('/')
        .find(|chunk| !chunk.starts_with('{'))
        .unwrap_or(row.pattern)
}

/// The row of the table that a concrete key belongs to.
fn row_of(key: &str) -> Option<&'static Row> {
    TABLE
        .iter()
        .find(|row| topics::alive_chunks(row.pattern, key).is_some())
}

/// Listens for a while, from what is kept for late joiners on.
async fn listen(bus: &Bus, pattern: &str, time: Duration) -> Result<BTreeMap<String, (Meter, String)>, Failure> {
    let mut samples = bus.raw_subscribe_kept(pattern, BACKLOG)?;
    let mut meters = BTreeMap::new();
    let start = Instant::now();
    let gather = async {
        while let Some(sample) = samples.next().await {
            let (meter, encoding) = meters
                .entry(sample.key)
                .or_insert_with(|| (Meter::new(BACKLOG), String::new()));
            meter.add(start.elapsed(), sample.bytes.len());
            *encoding = sample.encoding;
        }
    };
    // The end of the time is how this ends.
    let _ = tokio::time::timeout(time, gather).await;
    Ok(meters)
}

/// The next sample, or how the listening ended.
async fn next(samples: &mut RawSubscription, until: Option<Instant>) -> Result<RawSample, Ending> {
    let out_of_time = async {
        match until {
            Some(instant) => tokio::time::sleep_until(instant).await,
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        biased;
        _ = tokio::signal::ctrl_c() => Err(Ending::Interrupted),
        () = out_of_time => Err(Ending::OutOfTime),
        sample = samples.next() => sample.ok_or(Ending::Closed),
    }
}

/// Why listening ended.
enum Ending {
    Interrupted,
    OutOfTime,
    Closed,
}

impl Ending {
    fn outcome(&self, messages: u64, pattern: &str) -> Outcome {
        match self {
            Self::Interrupted => Ok(exit_code::INTERRUPTED),
            Self::OutOfTime if messages > 0 => Ok(exit_code::OK),
            Self::OutOfTime => Err(Failure::new(
                exit_code::TIMEOUT,
                format!("nothing came on {pattern} in that time"),
            )),
            Self::Closed => Err(Failure::new(exit_code::CANNOT_CONNECT, "the bus was closed")),
        }
    }
}

#[derive(Serialize)]
struct Echoed {
    key: String,
    stamp_ns: Option<u64>,
    encoding: String,
    payload: serde_json::Value,
}

async fn echo(bus: &Bus, pattern: &str, args: &ListenArgs, format: Format) -> Outcome {
    let mut samples = bus.raw_subscribe_kept(pattern, BACKLOG)?;
    let until = args
        .secs
        .map(|secs| Instant::now() + seconds(secs).min(Duration::from_secs(1 << 30)));
    let wild = pattern.contains('*') || pattern.contains('$');
    let mut messages = 0;
    while args.count.is_none_or(|count| messages < count) {
        let sample = match next(&mut samples, until).await {
            Ok(sample) => sample,
            Err(ending) => return ending.outcome(messages, pattern),
        };
        messages += 1;
        match format {
            // One key's messages alone, for pipes; of many keys each with its own.
            Format::Table if !wild => output::line(&payload::text(&sample)),
            Format::Table => output::line(&format!("{} {}", sample.key, payload::text(&sample))),
            Format::Json | Format::Ndjson => {
                let echoed = Echoed {
                    payload: payload::value(&sample),
                    stamp_ns: sample.stamp.map(|stamp| stamp.0),
                    key: sample.key,
                    encoding: sample.encoding,
                };
                output::value(format, &echoed, |_| String::new())?;
            }
        }
    }
    Ok(exit_code::OK)
}

/// A key and what its meter read.
#[derive(Serialize)]
struct Measured {
    key: String,
    #[serde(flatten)]
    reading: Reading,
}

/// Measures live messages only: what is kept for late joiners comes all at once.
async fn measure(
    bus: &Bus,
    pattern: &str,
    args: &ListenArgs,
    format: Format,
    line: fn(&Measured) -> String,
) -> Outcome {
    let mut samples = bus.raw_subscribe(pattern, BACKLOG)?;
    let start = Instant::now();
    let until = args
        .secs
        .map(|secs| start + seconds(secs).min(Duration::from_secs(1 << 30)));
    let mut meters = BTreeMap::<String, Meter>::new();
    let mut messages = 0;
    let mut told = start;
    let rows = |meters: &BTreeMap<String, Meter>| {
        meters
            .iter()
            .map(|(key, meter)| Measured {
                key: key.clone(),
                reading: meter.read(),
            })
            .collect::<Vec<_>>()
    };
    let lines = |rows: &[Measured]| rows.iter().map(line).collect::<Vec<_>>().join("\n");
    let outcome = loop {
        if args.count.is_some_and(|count| messages >= count) {
            break Ok(exit_code::OK);
        }
        let sample = match next(&mut samples, until).await {
            Ok(sample) => sample,
            Err(ending) => break ending.outcome(messages, pattern),
        };
        messages += 1;
        meters
            .entry(sample.key)
            .or_insert_with(|| Meter::new(1000))
            .add(start.elapsed(), sample.bytes.len());
        if told.elapsed() >= Duration::from_secs(1) && format != Format::Json {
            told = Instant::now();
            output::values(format, &rows(&meters), lines)?;
        }
    };
    if !meters.is_empty() {
        output::values(format, &rows(&meters), lines)?;
    }
    if samples.dropped() > 0 {
        tracing::warn!(
            dropped = samples.dropped(),
            "this program was too slow for all messages"
        );
    }
    outcome
}

fn hz_line(row: &Measured) -> String {
    let Reading {
        hz,
        min_s,
        max_s,
        std_s,
        messages,
        ..
    } = &row.reading;
    match (hz, min_s, max_s, std_s) {
        (Some(hz), Some(min), Some(max), Some(std)) => {
            format!(
                "{}  {hz:.2} Hz  interval {:.1} to {:.1} ms, deviation {:.1} ms  ({messages} messages)",
                row.key,
                1e3 * min,
                1e3 * max,
                1e3 * std
            )
        }
        _ => format!("{}  {messages} message", row.key),
    }
}

fn bw_line(row: &Measured) -> String {
    let [least, mean, greatest] = row.reading.bytes.map(bytes);
    let rate = row
        .reading
        .bytes_per_s
        .map_or_else(|| "one message".to_owned(), |rate| format!("{}/s", bytes(rate)));
    format!(
        "{}  {rate}  message {least} to {greatest}, mean {mean}  ({} messages)",
        row.key, row.reading.messages
    )
}

/// A key that carries something.
#[derive(Serialize)]
struct Live {
    key: String,
    message: Option<&'static str>,
    encoding: String,
    #[serde(flatten)]
    reading: Reading,
}

impl Live {
    fn new(key: &str, reading: Reading, encoding: &str) -> Self {
        Self {
            key: key.to_owned(),
            message: row_of(key).map(|row| row.message),
            encoding: encoding.to_owned(),
            reading,
        }
    }
}

fn live_table(rows: &[Live]) -> String {
    let rows: Vec<Vec<String>> = rows
        .iter()
        .map(|row| {
            let rate = row.reading.hz.map_or_else(|| "-".to_owned(), |hz| format!("{hz:.1}"));
            vec![
                row.key.clone(),
                row.message.unwrap_or("?").to_owned(),
                rate,
                bytes(row.reading.bytes[1]),
                row.encoding.clone(),
            ]
        })
        .collect();
    output::table(&["KEY", "MESSAGE", "HZ", "SIZE", "ENCODING"], &rows)
}

/// A row of the key table.
#[derive(Serialize)]
struct Known {
    key: &'static str,
    message: &'static str,
    producer: String,
    kind: String,
    max_bytes: usize,
}

impl Known {
    fn of(row: &Row) -> Self {
        let kind = match row.qos {
            Some(Qos::Latest) => "topic, latest only".to_owned(),
            Some(Qos::RealTime) => "topic, real-time".to_owned(),
            Some(Qos::Events { cache }) => format!("topic, {cache} kept"),
            Some(Qos::State) => "topic, last value kept".to_owned(),
            None => "ask".to_owned(),
        };
        Self {
            key: row.pattern,
            message: row.message,
            producer: format!("{:?}", row.producer).to_lowercase(),
            kind,
            max_bytes: row.max_bytes,
        }
    }
}

fn known_table(rows: &[Known]) -> String {
    let rows: Vec<Vec<String>> = rows
        .iter()
        .map(|row| {
            vec![
                row.key.to_owned(),
                row.message.to_owned(),
                row.producer.clone(),
                row.kind.clone(),
                bytes(row.max_bytes as f64),
            ]
        })
        .collect();
    output::table(&["KEY", "MESSAGE", "BY", "KIND", "AT MOST"], &rows)
}

async fn info(bus: &Bus, key: &str, robot: Option<&str>, format: Format) -> Outcome {
    let rows: Vec<Known> = match row_of(key) {
        Some(row) => vec![Known::of(row)],
        None => TABLE
            .iter()
            .filter(|row| row.pattern == key || row_name(row) == key || row.pattern.ends_with(&format!("/{key}")))
            .map(Known::of)
            .collect(),
    };
    let mut live = BTreeMap::new();
    let patterns = if rows.is_empty() {
        vec![pattern(key, robot)?]
    } else {
        rows.iter()
            .map(|row| topics::alive_key(row.key, &[robot.unwrap_or("*")]))
            .collect()
    };
    for pattern in patterns {
        live.append(&mut listen(bus, &pattern, Duration::from_millis(1200)).await?);
    }
    let live: Vec<Live> = live
        .iter()
        .map(|(key, (meter, encoding))| Live::new(key, meter.read(), encoding))
        .collect();
    if rows.is_empty() && live.is_empty() {
        return Err(Failure::not_found(format!(
            "`{key}` stands in no table and carries nothing now"
        )));
    }
    output::value(format, &serde_json::json!({ "table": rows, "live": live }), |_| {
        let carries = if live.is_empty() {
            "carries nothing now".to_owned()
        } else {
            live_table(&live)
        };
        format!("{}\n\n{carries}", known_table(&rows))
    })?;
    Ok(exit_code::OK)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_topic_may_be_named_short() {
        assert_eq!(pattern("pose", None).unwrap(), "zenav/*/edge/pose");
        assert_eq!(pattern("edge/pose", Some("r")).unwrap(), "zenav/r/edge/pose");
        assert_eq!(pattern("goal", Some("r")).unwrap(), "zenav/r/cloud/goal/*");
        assert_eq!(pattern("clock", Some("r")).unwrap(), "zenav/sim/clock");
        assert_eq!(pattern("zenav/*/edge/scan", Some("r")).unwrap(), "zenav/*/edge/scan");
        let failure = pattern("pos", None).unwrap_err();
        assert_eq!(failure.code, exit_code::NOT_FOUND);
        assert!(failure.message.contains("pose"), "{failure}");
    }

    #[test]
    fn every_key_of_the_table_finds_its_row() {
        assert_eq!(row_of("zenav/tiago/cloud/goal/g1").unwrap().message, "GoalState");
        assert!(row_of("zenav/tiago/other").is_none());
    }
}
