//! `zenav topic`. Which keys carry which messages, how often and how large. Works on raw samples: unknown topics are shown too.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use serde::Serialize;
use zenav_protocol::bus::Bus;
use zenav_protocol::topics::{self, Qos, Row, TABLE};

use super::ask::{PubArgs, no_leading_slash, publish, whole};
use super::listen::{EchoArgs, ListenArgs, bw_line, echo, hz_line, listen, measure};
use super::meter::{Reading, bytes};
use crate::arguments::{positive, seconds};
use crate::completion;
use crate::connect::{self, RobotArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Topics.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav topic list\n  zenav topic echo edge/pose --count 1\n  zenav topic echo edge/state --field velocity.v\n  zenav topic hz edge/scan --for 5\n  zenav topic info goal\n  zenav topic list --table       all keys with their messages"
)]
pub struct TopicArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: TopicCommand,
}

#[derive(Debug, clap::Subcommand)]
enum TopicCommand {
    /// List the keys with messages now
    List {
        /// Listen for this long, s
        #[arg(long = "for", value_name = "SECS", default_value_t = 1.5, value_parser = positive)]
        secs: f64,
        /// List all known keys instead
        #[arg(long)]
        table: bool,
    },
    /// Print a topic's messages
    Echo(EchoArgs),
    /// Measure the rate of a topic's messages over the last 5 s, every second
    Hz(ListenArgs),
    /// Measure the size and bandwidth of a topic's messages over the last 5 s, every second
    Bw(ListenArgs),
    /// Publish a message, checked against the type of its key
    Pub(PubArgs),
    /// Describe a topic, and tell whether it carries messages now
    Info {
        /// A key, or the name of a topic or ask
        #[arg(add = completion::keys())]
        key: String,
    },
}

/// Lists, prints and measures topics.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for an unknown topic, [`exit_code::TIMEOUT`] if nothing arrived in time.
pub fn topic(args: &TopicArgs) -> Outcome {
    if let TopicCommand::List { table: true, .. } = args.command {
        let known: Vec<Known> = TABLE.iter().map(Known::of).collect();
        return output::values(args.output, &known, known_table);
    }
    if let TopicCommand::Pub(message) = &args.command {
        return publish(message, &args.robot, args.output);
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
                output::values(args.output, &rows, live_table)
            }
            TopicCommand::Echo(echoed) => echo(&bus, &pattern(&echoed.listen.key, robot)?, echoed, args.output).await,
            TopicCommand::Hz(listen) => {
                measure(&bus, &pattern(&listen.key, robot)?, listen, args.output, hz_line).await
            }
            TopicCommand::Bw(listen) => {
                measure(&bus, &pattern(&listen.key, robot)?, listen, args.output, bw_line).await
            }
            // Handled above: it does not listen.
            TopicCommand::Pub(_) => Ok(exit_code::OK),
            TopicCommand::Info { key } => info(&bus, key, robot, args.output).await,
        }
    })
}

/// The key expression that the text names.
pub(crate) fn pattern(text: &str, robot: Option<&str>) -> Result<String, Failure> {
    let robot = robot.unwrap_or("*");
    no_leading_slash(text)?;
    if text.starts_with("zenav/") || text.starts_with('*') || text.starts_with('@') {
        return Ok(text.to_owned());
    }
    // A key that starts with a side of a robot belongs to a robot; any other key is taken literally.
    match text.split_once('/') {
        Some(("edge" | "cloud" | "body" | "operator" | "ask" | "alive", _)) => {
            return Ok(format!("zenav/{robot}/{text}"));
        }
        Some(("sim" | "svc", _)) => return Ok(format!("zenav/{text}")),
        Some(_) => return Ok(whole(text)),
        None => {}
    }
    let row = TABLE.iter().find(|row| row.qos.is_some() && row_name(row) == text);
    let row = row.ok_or_else(|| {
        let names: BTreeSet<&str> = TABLE.iter().filter(|row| row.qos.is_some()).map(row_name).collect();
        Failure::not_found(format!(
            "no topic `{text}`: there are {} (or give a key, such as zenav/*/edge/pose)",
            output::listed(names)
        ))
    })?;
    Ok(topics::alive_key(row.pattern, &[robot]))
}

/// Short name of a row: the last literal chunk of its key.
fn row_name(row: &Row) -> &'static str {
    row.pattern
        .rsplit('/')
        .find(|chunk| !chunk.starts_with('{'))
        .unwrap_or(row.pattern)
}

/// A key with messages.
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
            message: topics::row_of(key).map(|row| row.message),
            encoding: encoding.to_owned(),
            reading,
        }
    }
}

fn live_table(rows: &[Live]) -> String {
    let row = |row: &Live| {
        [
            row.key.clone(),
            row.message.unwrap_or("?").to_owned(),
            row.reading.hz.map_or_else(|| "-".to_owned(), |hz| format!("{hz:.1}")),
            bytes(row.reading.bytes[1]),
            row.encoding.clone(),
        ]
    };
    output::table(&["KEY", "MESSAGE", "HZ", "SIZE", "ENCODING"], rows.iter().map(row))
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
    let row = |row: &Known| {
        let (key, message) = (row.key.to_owned(), row.message.to_owned());
        [
            key,
            message,
            row.producer.clone(),
            row.kind.clone(),
            bytes(row.max_bytes as f64),
        ]
    };
    output::table(&["KEY", "MESSAGE", "BY", "KIND", "AT MOST"], rows.iter().map(row))
}

async fn info(bus: &Bus, key: &str, robot: Option<&str>, format: Format) -> Outcome {
    let rows: Vec<Known> = match topics::row_of(key) {
        Some(row) => vec![Known::of(row)],
        None => TABLE
            .iter()
            .filter(|row| row.pattern == key || row_name(row) == key || row.pattern.ends_with(&format!("/{key}")))
            .map(Known::of)
            .collect(),
    };
    let mut live = BTreeMap::new();
    let is_whole = key.starts_with("zenav/") && !key.contains('{');
    let patterns = if rows.is_empty() || is_whole {
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
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_may_be_named_short() {
        assert_eq!(pattern("pose", None).unwrap(), "zenav/*/edge/pose");
        assert_eq!(pattern("edge/pose", Some("r")).unwrap(), "zenav/r/edge/pose");
        assert_eq!(pattern("r/edge/pose", None).unwrap(), "zenav/r/edge/pose");
        assert_eq!(pattern("my/lamp", None).unwrap(), "my/lamp");
        assert_eq!(pattern("goal", Some("r")).unwrap(), "zenav/r/cloud/goal/*");
        assert_eq!(pattern("clock", Some("r")).unwrap(), "zenav/sim/clock");
        assert_eq!(pattern("zenav/*/edge/scan", Some("r")).unwrap(), "zenav/*/edge/scan");
        let failure = pattern("pos", None).unwrap_err();
        assert_eq!(failure.code, exit_code::NOT_FOUND);
        assert!(failure.message.contains("pose"), "{failure}");
    }

    #[test]
    fn every_key_of_the_table_finds_its_row() {
        assert_eq!(
            topics::row_of("zenav/tiago/cloud/goal/g1").unwrap().message,
            "GoalState"
        );
        assert!(topics::row_of("zenav/tiago/other").is_none());
    }
}
