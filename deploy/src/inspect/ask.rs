//! `zenav ask` and `zenav topic pub`. Requests and messages typed by hand as JSON, checked against the type of their key before they are
//! sent: an unknown field is reported, not ignored.

use std::io::Read as _;
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use zenav_protocol::bus::{Act, AskError, Bus, RawReply, RawSample};
use zenav_protocol::messages::Refusal;
use zenav_protocol::topics::{self, Ask, Producer, Row, TABLE, TableVisitor, Topic};

use super::payload;
use super::unknown_field::unknown_field;
use crate::arguments;
use crate::completion;
use crate::connect::{self, RobotArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::leadership;
use crate::output::{self, Format};

/// Longest pause before a query is sent again.
const AGAIN: Duration = Duration::from_millis(200);

/// One request.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav ask ask/edge/info\n  zenav ask ask/cloud/goal '{\"place\": \"sink\"}'\n  zenav ask 'ask/cloud/map?format=png' --out map.png\n  zenav schema GoalRequest        what may stand in a request\n\nExit codes: 0 answered, 2 the request does not fit its type, 3 not found, 5 no answer, 7 refused."
)]
pub struct AskArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
    /// A key (`zenav/tiago/ask/edge/info`), its end (`ask/edge/info`), or the name of an ask (`goals`); `?name=value` is passed along
    #[arg(add = completion::ask_keys())]
    key: String,
    /// The request; `-` reads it from stdin
    #[arg(default_value = "{}")]
    json: String,
    /// Write the answer's bytes to this file
    #[arg(long, value_name = "FILE")]
    out: Option<std::path::PathBuf>,
}

/// One message.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav topic pub my/lamp '{\"on\": true}'\n  zenav topic pub operator/teleop '{\"epoch\": 7, \"twist\": {\"v\": 0.0, \"w\": 0.0}, \"echo\": 0}'\n\nKeys of edge, cloud, body and sim have their own writers: a second one confuses the robot, and needs --force."
)]
pub(super) struct PubArgs {
    /// A key, its end (`operator/teleop`), or the name of a topic (`teleop`)
    #[arg(add = completion::topic_keys())]
    key: String,
    /// The message; `-` reads it from stdin
    json: String,
    /// Publish this many times a second, until Ctrl-C or --count
    #[arg(long, value_name = "HZ", value_parser = frequency)]
    hz: Option<f64>,
    /// Stop after this many messages
    #[arg(long, value_name = "N", requires = "hz", value_parser = arguments::whole::<u64>)]
    count: Option<u64>,
    /// Publish on a key that only the robot or its cloud may write
    #[arg(long)]
    force: bool,
}

/// Sends a request and prints the answer.
///
/// # Errors
/// [`exit_code::USAGE`] for JSON that does not fit the key's type, otherwise as every ask.
pub fn ask(args: &AskArgs) -> Outcome {
    let patience = args.robot.link.patience();
    let (key, parameters) = args
        .key
        .split_once('?')
        .map_or((args.key.as_str(), None), |(key, rest)| (key, Some(rest)));
    let text = input(&args.json)?;
    connect::on_bus(&args.robot.link, async |bus| {
        let key = concrete(&bus, key, &args.robot, true).await?;
        bus.check(Act::Ask, &key)?;
        if let Some(row) = topics::row_of(&key) {
            check(row, &text)?;
        } else {
            any_json(&text)?;
        }
        let selector = parameters.map_or_else(|| key.clone(), |parameters| format!("{key}?{parameters}"));
        let sample = answer(&bus, &key, &selector, &text, patience).await?;
        if let Some(out) = &args.out {
            files::write(out, &sample.bytes)?;
            output::line(&format!(
                "wrote {} ({} bytes of {})",
                out.display(),
                sample.bytes.len(),
                sample.encoding
            ));
            return Ok(exit_code::OK);
        }
        let value = payload::value(&sample);
        output::value(args.output, &value, |value| match value {
            Value::String(text) => text.clone(),
            value => output::pretty(value).unwrap_or_default(),
        })
    })
}

/// The answer to a request, by the rules of every ask: no reply is not an answer, and a standby redirects to the leader.
async fn answer(bus: &Bus, key: &str, selector: &str, text: &str, patience: Duration) -> Result<RawSample, Failure> {
    let answered = answered(bus, key, selector, text, patience);
    let is_mission = topics::row_of(key).is_some_and(|row| row.producer == Producer::Mission);
    match key.split('/').nth(1).filter(|_| is_mission) {
        Some(robot) => tokio::select! {
            answer = answered => answer,
            () = leadership::never_led(bus, robot) => Err(AskError::Refused(Refusal::NotLeader).into()),
        },
        None => answered.await,
    }
}

async fn answered(bus: &Bus, key: &str, selector: &str, text: &str, patience: Duration) -> Result<RawSample, Failure> {
    let until = tokio::time::Instant::now() + patience;
    loop {
        let within = until.saturating_duration_since(tokio::time::Instant::now());
        let replies = bus.raw_query(selector, Some(text.as_bytes().to_vec()), within).await?;
        let mut refusal = None;
        let mut answer = None;
        for reply in replies {
            match reply {
                RawReply::Ok(sample) => answer = answer.or(Some(sample)),
                RawReply::Err { bytes, .. } => {
                    refusal = refusal.or_else(|| serde_json::from_slice::<Refusal>(&bytes).ok())
                }
            }
        }
        match (answer, refusal) {
            (Some(sample), _) => return Ok(sample),
            (None, Some(refusal)) if !matches!(refusal, Refusal::NotLeader | Refusal::Busy { .. }) => {
                return Err(AskError::Refused(refusal).into());
            }
            (None, refusal) if tokio::time::Instant::now() + AGAIN >= until => {
                let timeout = AskError::Timeout { key: key.to_owned() };
                return Err(refusal.map_or(timeout, AskError::Refused).into());
            }
            _ => tokio::time::sleep(AGAIN).await,
        }
    }
}

/// Publishes a message.
pub(super) fn publish(args: &PubArgs, robot: &RobotArgs, format: Format) -> Outcome {
    let text = input(&args.json)?;
    connect::on_bus(&robot.link, async |bus| {
        let key = concrete(&bus, &args.key, robot, false).await?;
        bus.check(Act::Write, &key)?;
        match topics::row_of(&key) {
            Some(row) => {
                if row.producer != Producer::Operator && !args.force {
                    let by = format!("{:?}", row.producer).to_lowercase();
                    return Err(Failure::rejected(format!(
                        "{key} is written by {by} alone: a second writer confuses the robot (--force publishes all the same)"
                    )));
                }
                check(row, &text)?;
                if let (Some(hz), Some(rate)) = (args.hz, row.rate)
                    && hz > f64::from(rate)
                {
                    crate::output::note(format_args!(
                        "zenav: {key} is for at most {rate} messages a second: receivers drop those far beyond it"
                    ));
                }
            }
            None if is_reserved(&key) && !args.force => {
                return Err(Failure::rejected(format!(
                    "{key}: keys of edge, cloud, body and sim have their own writers (--force publishes all the same)"
                )));
            }
            None => {
                any_json(&text)?;
                crate::output::note(format_args!(
                    "zenav: {key} is not a key of zenav, and the message is not checked (`zenav topic list --table` shows the keys)"
                ));
            }
        }
        let mut pace = args
            .hz
            .map(|hz| tokio::time::interval(Duration::from_secs_f64(1.0 / hz)));
        let mut sent = 0;
        while args.count.is_none_or(|count| sent < count) {
            if let Some(pace) = &mut pace {
                tokio::select! {
                    _ = pace.tick() => {}
                    _ = tokio::signal::ctrl_c() => return Ok(exit_code::INTERRUPTED),
                }
            }
            bus.raw_put(&key, text.clone().into_bytes(), "application/json")?;
            sent += 1;
            if pace.is_none() {
                break;
            }
        }
        match format {
            Format::Table => {
                crate::output::note(format_args!("published {sent} on {key}"));
                Ok(exit_code::OK)
            }
            format => output::value(format, &json!({ "key": key, "published": sent }), |_| String::new()),
        }
    })
}

/// Whether only the robot or its cloud may write this key.
fn is_reserved(key: &str) -> bool {
    let chunks: Vec<&str> = key.split('/').collect();
    match chunks.as_slice() {
        ["zenav", "sim" | "svc", ..] => true,
        ["zenav", _, side, ..] => matches!(*side, "edge" | "cloud" | "body" | "ask" | "alive"),
        _ => false,
    }
}

/// A publication rate, Hz.
fn frequency(text: &str) -> Result<f64, String> {
    let hz = text.parse().ok().filter(|hz| (0.001..=10_000.0).contains(hz));
    hz.ok_or_else(|| "expected a number from 0.001 to 10000".to_owned())
}

/// The text from the command line, or from stdin.
fn input(text: &str) -> Result<String, Failure> {
    if text != "-" {
        return Ok(text.to_owned());
    }
    let mut read = String::new();
    std::io::stdin().take(64 << 20).read_to_string(&mut read)?;
    Ok(read)
}

fn any_json(text: &str) -> Result<(), Failure> {
    serde_json::from_str::<serde::de::IgnoredAny>(text)
        .map(drop)
        .map_err(|error| Failure::usage(format!("not JSON: {error}")))
}

/// The full key that the text names, with the robot's id filled in.
async fn concrete(bus: &Bus, text: &str, robot: &RobotArgs, asks: bool) -> Result<String, Failure> {
    let pattern = meant(text, asks)?;
    let Some((before, after)) = pattern.split_once("{robot}") else {
        return match pattern.contains('{') {
            true => Err(Failure::usage(format!("{pattern}: give the whole key"))),
            false => Ok(pattern),
        };
    };
    if after.contains('{') {
        return Err(Failure::usage(format!("{pattern}: give the whole key")));
    }
    let robot = connect::find(bus, robot.robot.as_deref()).await?;
    Ok(format!("{before}{robot}{after}"))
}

/// The key that the text names; it may still contain `{robot}`.
fn meant(text: &str, asks: bool) -> Result<String, Failure> {
    if text.contains(['*', '$', '{']) {
        return Err(Failure::usage(format!("{text}: expected one key, without wildcards")));
    }
    no_leading_slash(text)?;
    if text.starts_with("zenav/") {
        return Ok(text.to_owned());
    }
    let rows = || TABLE.iter().filter(|row| row.qos.is_none() == asks);
    let found = rows().find(|row| {
        let end = row.pattern.strip_prefix("zenav/{robot}/").unwrap_or(row.pattern);
        end == text || topics::alive_chunks(end, text).is_some() || row.pattern.rsplit('/').next() == Some(text)
    });
    if let Some(row) = found {
        let end = row.pattern.strip_prefix("zenav/{robot}/").unwrap_or(row.pattern);
        // Chunks that fill a placeholder (`cloud/goal/g1`) are kept as typed.
        return Ok(match topics::alive_chunks(end, text) {
            Some(_) if row.pattern != end => format!("zenav/{{robot}}/{text}"),
            _ => row.pattern.to_owned(),
        });
    }
    if text.contains('/') {
        return Ok(whole(text));
    }
    let names: Vec<&str> = rows()
        .filter_map(|row| row.pattern.rsplit('/').next())
        .filter(|name| !name.starts_with('{'))
        .collect();
    let kind = if asks { "ask" } else { "topic" };
    Err(Failure::not_found(format!(
        "no {kind} `{text}`: there are {} (or give a key, such as {})",
        names.join(", "),
        if asks {
            "zenav/tiago/ask/edge/info"
        } else {
            "zenav/tiago/operator/teleop"
        }
    )))
}

/// Refuses a key with a leading slash, as names of ROS have it.
///
/// # Errors
/// Exit code 2, with the key as it is meant.
pub(super) fn no_leading_slash(text: &str) -> Result<(), Failure> {
    match text.strip_prefix('/') {
        None => Ok(()),
        Some(rest) => Err(Failure::usage(format!(
            "{text}: keys have no leading slash: expected `{rest}`"
        ))),
    }
}

/// A key that is in the table but for its first chunk (`tiago/edge/pose`) is meant whole; any other is taken as typed.
pub(super) fn whole(text: &str) -> String {
    let whole = format!("zenav/{text}");
    if topics::row_of(&whole).is_some() {
        whole
    } else {
        text.to_owned()
    }
}

/// Checks a text against the message type, or the request type, of a row.
fn check(row: &Row, text: &str) -> Result<(), Failure> {
    if text.len() > row.max_bytes {
        return Err(Failure::usage(format!(
            "{} bytes: {} takes at most {}",
            text.len(),
            row.pattern,
            row.max_bytes
        )));
    }
    let mut checker = Checker {
        pattern: row.pattern,
        text,
        found: None,
    };
    topics::visit_table(&mut checker);
    checker.found.unwrap_or(Ok(()))
}

/// Parses a text as the type of one row.
struct Checker<'a> {
    pattern: &'static str,
    text: &'a str,
    found: Option<Result<(), Failure>>,
}

impl Checker<'_> {
    /// Decodes with the bus's own parser: another one would be compiled for every type.
    fn read<T: DeserializeOwned>(&mut self, pattern: &str, name: &str) {
        if pattern == self.pattern {
            let read = serde_json::from_slice::<T>(self.text.as_bytes());
            self.found = Some(fits(read.map(drop), self.text, name));
        }
    }
}

impl TableVisitor for Checker<'_> {
    fn topic<T: topics::Message>(&mut self, topic: Topic<T>, message: &'static str) {
        self.read::<T>(topic.pattern, message);
    }

    fn ask<Q: topics::Message, R: topics::Message>(&mut self, ask: Ask<Q, R>, request: &'static str, _: &'static str) {
        self.read::<Q>(ask.pattern, request);
    }
}

/// Checks that a text was read as the type of this name, and that it has no unknown fields.
fn fits(read: serde_json::Result<()>, text: &str, name: &str) -> Result<(), Failure> {
    let hint = format!("`zenav schema {name}` shows what may stand there");
    let value: Value = read
        .and_then(|()| serde_json::from_str(text))
        .map_err(|error| Failure::usage(format!("not a {name}: {error}; {hint}")))?;
    match super::schema::json_schema(name).and_then(|schema| unknown_field(&schema, &value)) {
        None => Ok(()),
        Some(field) => {
            let last = field.rsplit('.').next().unwrap_or(&field);
            let known = super::schema::fields(name);
            let perhaps = output::perhaps(last, known.iter().map(String::as_str));
            Err(Failure::usage(format!(
                "{name} has no field `{field}`{perhaps}; {hint}"
            )))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_may_be_named_by_its_end() {
        for (text, asks, key) in [
            ("ask/edge/info", true, "zenav/{robot}/ask/edge/info"),
            ("goals", true, "zenav/{robot}/ask/cloud/goals"),
            ("zenav/tiago/ask/edge/info", true, "zenav/tiago/ask/edge/info"),
            ("teleop", false, "zenav/{robot}/operator/teleop"),
            ("cloud/goal/g1", false, "zenav/{robot}/cloud/goal/g1"),
            ("my/lamp", false, "my/lamp"),
            ("tiago/edge/pose", false, "zenav/tiago/edge/pose"),
            ("tiago/ask/edge/info", true, "zenav/tiago/ask/edge/info"),
        ] {
            assert_eq!(meant(text, asks).unwrap(), key, "{text}");
        }
        assert_eq!(meant("zenav/*/edge/pose", false).unwrap_err().code, exit_code::USAGE);
        let failure = meant("/edge/scan", false).unwrap_err();
        assert!(
            failure.message.contains("no leading slash: expected `edge/scan`"),
            "{failure}"
        );
        let failure = meant("telop", false).unwrap_err();
        assert!(
            failure.code == exit_code::NOT_FOUND && failure.message.contains("teleop"),
            "{failure}"
        );
    }

    #[test]
    fn what_does_not_fit_is_told_before_it_is_sent() {
        let row = topics::row_of("zenav/r/ask/cloud/goal").unwrap();
        assert!(check(row, r#"{"x": 1, "y": 2}"#).is_ok());
        for (text, what) in [
            (
                r#"{"x": 1, "y": 2, "tolerence": 0.5}"#,
                "no field `tolerence`, perhaps `tolerance`",
            ),
            (
                r#"{"waypoints": [{"x": 1, "y": 2, "tolerence": 3}]}"#,
                "no field `waypoints.0.tolerence`, perhaps `tolerance`",
            ),
            (r#"{"x": "one"}"#, "not a GoalRequest: invalid type"),
            ("{", "not a GoalRequest: EOF"),
            ("{} {}", "trailing"),
        ] {
            let failure = check(row, text).unwrap_err();
            assert_eq!(failure.code, exit_code::USAGE);
            assert!(failure.message.contains(what), "{text}: {failure}");
        }
    }

    #[test]
    fn whatever_decodes_without_a_misspelt_field_is_sent() {
        for (key, text) in [
            ("zenav/r/ask/cloud/annotate", r#"{"action": {"clear_zones": null}}"#),
            (
                "zenav/r/ask/cloud/annotate",
                r#"[{"remove_place": {"name": "sink"}}, null, null]"#,
            ),
            (
                "zenav/r/ask/edge/behaviour",
                r#"{"id": "b1", "action": {"cancel": null}}"#,
            ),
        ] {
            let checked = check(topics::row_of(key).unwrap(), text);
            assert!(checked.is_ok(), "{text}: {checked:?}");
        }
    }

    #[test]
    fn keys_with_a_writer_of_their_own_are_reserved() {
        assert!(is_reserved("zenav/r/edge/mine") && is_reserved("zenav/sim/clock"));
        assert!(!is_reserved("zenav/r/operator/teleop") && !is_reserved("my/lamp"));
    }
}
