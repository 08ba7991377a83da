//! Listening to keys. Prints the samples that arrive on a key, or measures their rate and size.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use serde_json::Value;
use tokio::time::Instant;
use zenav_protocol::bus::{Act, Bus, RawSample, RawSubscription};
use zenav_protocol::topics;

use super::meter::{Meter, Reading, bytes};
use super::payload;
use super::schema::json_schema;
use super::unknown_field::has_part;
use crate::arguments::{self, positive, seconds};
use crate::completion;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Most samples queued for display.
const BACKLOG: usize = 4096;

/// After so long without a message a hint is printed: with a misspelled key the wait would never end.
const SILENCE: Duration = Duration::from_secs(2);
/// Time over which rates are measured, and the period at which they are printed.
const WINDOW: Duration = Duration::from_secs(5);
const EACH: Duration = Duration::from_secs(1);

/// What to listen to, and how long.
#[derive(Debug, clap::Args)]
pub(super) struct ListenArgs {
    /// A key (`zenav/*/edge/pose`), its side and name (`edge/pose`), or the name of a topic (`pose`)
    #[arg(add = completion::topic_keys())]
    pub(super) key: String,
    /// Stop after this many messages
    #[arg(long, value_name = "N", value_parser = arguments::whole::<u64>)]
    count: Option<u64>,
    /// Stop after this time, s
    #[arg(long = "for", value_name = "SECS", value_parser = positive)]
    secs: Option<f64>,
}

/// What to print.
#[derive(Debug, clap::Args)]
pub(super) struct EchoArgs {
    #[command(flatten)]
    pub(super) listen: ListenArgs,
    /// Print only this field of each message, such as `velocity.v`; `null` where a message leaves it out
    #[arg(long, value_name = "NAME")]
    field: Option<String>,
}

impl ListenArgs {
    /// When to end; without a time, in decades.
    fn until(&self, start: Instant) -> Instant {
        start + seconds(self.secs.unwrap_or(f64::INFINITY))
    }
}

/// The meter of each key, with the newest encoding.
type Meters = BTreeMap<String, (Meter, String)>;

/// Listens for a while. Retained messages count only for keys without live messages: rates are of live messages.
pub(super) async fn listen(bus: &Bus, pattern: &str, time: Duration) -> Result<Meters, Failure> {
    bus.check(Act::Hear, pattern)?;
    let mut live = bus.raw_subscribe(pattern, BACKLOG)?;
    let mut kept = bus.raw_subscribe_kept(pattern, BACKLOG)?;
    let (mut of_live, mut of_kept) = (Meters::new(), Meters::new());
    // Discards what arrived while the other subscription was made: it is queued here at once, not at the rate of the wire.
    while let Ok(Some(_)) = tokio::time::timeout(Duration::ZERO, live.next()).await {}
    let start = Instant::now();
    let gather = async {
        loop {
            // A live sample reaches both subscriptions.
            let (sample, meters) = tokio::select! {
                Some(sample) = live.next() => (sample, &mut of_live),
                Some(sample) = kept.next() => (sample, &mut of_kept),
                else => return,
            };
            let (meter, encoding) = meters
                .entry(sample.key)
                .or_insert_with(|| (Meter::new(BACKLOG), String::new()));
            meter.add(start.elapsed(), sample.bytes.len());
            *encoding = sample.encoding;
        }
    };
    // The timeout ends this.
    let _ = tokio::time::timeout(time, gather).await;
    for (key, (mut meter, encoding)) in of_kept {
        meter.forget_times();
        of_live.entry(key).or_insert((meter, encoding));
    }
    Ok(of_live)
}

/// The next sample, or why listening ended.
async fn next(samples: &mut RawSubscription, until: Instant) -> Result<RawSample, Ending> {
    tokio::select! {
        biased;
        _ = tokio::signal::ctrl_c() => Err(Ending::Interrupted),
        () = tokio::time::sleep_until(until) => Err(Ending::OutOfTime),
        sample = samples.next() => sample.ok_or(Ending::Closed),
    }
}

fn hint(pattern: &str) {
    crate::output::note(format_args!(
        "zenav: nothing on {pattern} yet (`zenav topic list` shows what is published); Ctrl-C ends"
    ));
}

/// Like [`next`]; if nothing has arrived yet on the key, prints one hint.
async fn next_or_hint(
    samples: &mut RawSubscription,
    until: Instant,
    pattern: &str,
    messages: u64,
    hinted: &mut bool,
) -> Result<RawSample, Ending> {
    if messages == 0 && !std::mem::replace(hinted, true) {
        let soon = Instant::now() + SILENCE;
        if until > soon {
            match next(samples, soon).await {
                Err(Ending::OutOfTime) => hint(pattern),
                other => return other,
            }
        }
    }
    next(samples, until).await
}

/// Reason why listening ended.
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
            Self::OutOfTime => Err(Failure::timeout(format!("nothing came on {pattern} in that time"))),
            Self::Closed => Err(Failure::closed()),
        }
    }
}

#[derive(Serialize)]
struct Echoed {
    key: String,
    stamp_ns: Option<u64>,
    encoding: String,
    payload: Value,
}

/// The part of a message that a path names: fields, and indices of lists, separated by dots.
///
/// # Errors
/// The message has no such part; the fields that there are instead.
fn part(message: &Value, path: &str) -> Result<Value, String> {
    let mut at = message;
    for name in path.split('.') {
        let (found, known) = match at {
            Value::Object(fields) => (fields.get(name), output::listed(fields.keys())),
            Value::Array(values) => (
                name.parse::<usize>().ok().and_then(|index| values.get(index)),
                format!("a list of {}", values.len()),
            ),
            other => (None, format!("`{other}`")),
        };
        at = found.ok_or_else(|| format!("no field `{name}` in `{path}`: there is {known}"))?;
    }
    Ok(at.clone())
}

/// The part of a sample that a path names; `null` if the message leaves it out. Whether the type of an unknown key has such a part is not
/// known: `told` is whether that was said.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] if the type of the key's messages has no such part.
fn part_of(sample: &RawSample, path: &str, told: &mut bool) -> Result<Value, Failure> {
    let why = match part(&payload::value(sample), path) {
        Ok(part) => return Ok(part),
        Err(why) => format!("{}: {why}", sample.key),
    };
    match topics::row_of(&sample.key).and_then(|row| json_schema(row.message)) {
        Some(schema) if !has_part(&schema, path) => return Err(Failure::not_found(why)),
        Some(_) => {}
        None if std::mem::replace(told, true) => {}
        None => output::note(format_args!("zenav: {why}")),
    }
    Ok(Value::Null)
}

/// Prints messages, starting with the retained ones.
pub(super) async fn echo(bus: &Bus, pattern: &str, args: &EchoArgs, format: Format) -> Outcome {
    let EchoArgs { listen: args, field } = args;
    bus.check(Act::Hear, pattern)?;
    let mut samples = bus.raw_subscribe_kept(pattern, BACKLOG)?;
    let until = args.until(Instant::now());
    let wild = pattern.contains('*') || pattern.contains('$');
    let mut messages = 0;
    let (mut hinted, mut told) = (false, false);
    while args.count.is_none_or(|count| messages < count) {
        let sample = match next_or_hint(&mut samples, until, pattern, messages, &mut hinted).await {
            Ok(sample) => sample,
            Err(ending) => return ending.outcome(messages, pattern),
        };
        messages += 1;
        let part = match field {
            Some(path) => Some(part_of(&sample, path, &mut told)?),
            None => None,
        };
        match format {
            Format::Table => {
                let text = part.map_or_else(|| payload::text(&sample), |part| part.to_string());
                // For one key only the message, for pipes; with wildcards, each with its key.
                match wild {
                    true => output::line(&format!("{} {text}", sample.key)),
                    false => output::line(&text),
                }
            }
            Format::Json | Format::Ndjson => {
                let echoed = Echoed {
                    payload: part.unwrap_or_else(|| payload::value(&sample)),
                    stamp_ns: sample.stamp.map(|stamp| stamp.0),
                    key: sample.key,
                    encoding: sample.encoding,
                };
                output::value(format.streamed(), &echoed, |_| String::new())?;
            }
        }
    }
    Ok(exit_code::OK)
}

/// A key and its meter's reading.
#[derive(Serialize)]
pub(super) struct Measured {
    key: String,
    #[serde(flatten)]
    reading: Reading,
    /// Time since its newest message, s.
    silence_s: f64,
}

/// Measures live messages only, over the last seconds: retained ones arrive all at once. Prints a line per key each second, in silence too.
pub(super) async fn measure(
    bus: &Bus,
    pattern: &str,
    args: &ListenArgs,
    format: Format,
    line: fn(&Measured) -> String,
) -> Outcome {
    bus.check(Act::Hear, pattern)?;
    let mut samples = bus.raw_subscribe(pattern, BACKLOG)?;
    let start = Instant::now();
    let until = args.until(start);
    let mut meters = BTreeMap::<String, Meter>::new();
    let (mut messages, mut hinted) = (0, false);
    let lines = |rows: &[Measured]| rows.iter().map(line).collect::<Vec<_>>().join("\n");
    let mut pace = tokio::time::interval(EACH);
    pace.reset();
    let outcome = loop {
        if args.count.is_some_and(|count| messages >= count) {
            break Ok(exit_code::OK);
        }
        tokio::select! {
            sample = next(&mut samples, until) => match sample {
                Ok(sample) => {
                    messages += 1;
                    let meter = meters.entry(sample.key).or_insert_with(|| Meter::new(BACKLOG));
                    meter.add(start.elapsed(), sample.bytes.len());
                }
                Err(ending) => break ending.outcome(messages, pattern),
            },
            _ = pace.tick() => {
                if messages == 0 && start.elapsed() >= SILENCE && !std::mem::replace(&mut hinted, true) {
                    hint(pattern);
                }
                if messages > 0 && format != Format::Json {
                    output::values(format, &rows(&mut meters, start.elapsed()), lines)?;
                }
            }
        }
    };
    if messages > 0 {
        output::values(format, &rows(&mut meters, start.elapsed()), lines)?;
    }
    if samples.dropped() > 0 {
        tracing::warn!(
            dropped = samples.dropped(),
            "this program was too slow for all messages"
        );
    }
    outcome
}

/// The readings at `now` (time since the start).
fn rows(meters: &mut BTreeMap<String, Meter>, now: Duration) -> Vec<Measured> {
    let read = |(key, meter): (&String, &mut Meter)| {
        meter.forget_before(now.saturating_sub(WINDOW));
        Measured {
            key: key.clone(),
            reading: meter.read(),
            silence_s: meter.silence(now).unwrap_or_default().as_secs_f64(),
        }
    };
    meters.iter_mut().map(read).collect()
}

impl Measured {
    /// Number of messages, and the silence since the last one.
    fn count(&self) -> String {
        let messages = output::counted(self.reading.messages, "message");
        if self.silence_s < EACH.as_secs_f64() {
            messages
        } else {
            format!("{messages}, the last {:.1} s ago", self.silence_s)
        }
    }
}

/// Rate, human-readable.
pub(super) fn hz_line(row: &Measured) -> String {
    let Reading {
        hz,
        min_s,
        max_s,
        std_s,
        ..
    } = &row.reading;
    match (hz, min_s, max_s, std_s) {
        (Some(hz), Some(min), Some(max), Some(std)) => {
            format!(
                "{}  {hz:.2} Hz  interval {:.1} to {:.1} ms, deviation {:.1} ms  ({})",
                row.key,
                1e3 * min,
                1e3 * max,
                1e3 * std,
                row.count()
            )
        }
        _ => format!("{}  no rate  ({})", row.key, row.count()),
    }
}

/// Size and bandwidth, human-readable.
pub(super) fn bw_line(row: &Measured) -> String {
    let [least, mean, greatest] = row.reading.bytes.map(bytes);
    match row.reading.bytes_per_s {
        Some(rate) => format!(
            "{}  {}/s  message {least} to {greatest}, mean {mean}  ({})",
            row.key,
            bytes(rate),
            row.count()
        ),
        None => format!("{}  no rate  ({})", row.key, row.count()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_of_a_message_is_named_by_its_path_and_one_that_is_missing_is_answered_with_those_that_there_are() {
        let message = serde_json::json!({ "velocity": { "v": 0.25, "w": 0.0 }, "plan": null, "beams": [1, 2] });
        let named = |path: &str| part(&message, path).map(|part| part.to_string());
        assert_eq!(named("velocity.v").as_deref(), Ok("0.25"));
        assert_eq!(named("beams.1").as_deref(), Ok("2"));
        assert_eq!(named("plan").as_deref(), Ok("null"));
        let unknown = |path: &str| named(path).unwrap_err();
        assert_eq!(unknown("velocity.x"), "no field `x` in `velocity.x`: there is v, w");
        assert_eq!(unknown("beams.2"), "no field `2` in `beams.2`: there is a list of 2");
        assert_eq!(unknown("plan.id"), "no field `id` in `plan.id`: there is `null`");
    }

    #[test]
    fn a_part_that_a_message_leaves_out_is_null_and_one_that_its_type_does_not_have_is_refused() {
        let sample = |key: &str| RawSample {
            key: key.to_owned(),
            bytes: br#"{"stamp":1,"plan":null}"#.to_vec(),
            encoding: "application/json".to_owned(),
            stamp: None,
            deleted: false,
        };
        let mut told = false;
        let state = sample("zenav/r/edge/state");
        for (path, expected) in [
            ("stamp", Value::from(1)),
            ("faults.body", Value::Null),
            ("plan.time_left", Value::Null),
        ] {
            assert_eq!(part_of(&state, path, &mut told).unwrap(), expected, "{path}");
        }
        let refused = part_of(&state, "faults.wheel", &mut told).unwrap_err();
        assert_eq!(refused.code, exit_code::NOT_FOUND);
        let why = "zenav/r/edge/state: no field `faults` in `faults.wheel`: there is ";
        assert!(refused.message.starts_with(why), "{refused}");
        assert!(!told);
        // Of a key that is in no table.
        let other = sample("my/lamp");
        for _ in 0..2 {
            assert_eq!(part_of(&other, "on", &mut told).unwrap(), Value::Null);
            assert!(told);
        }
    }

    #[test]
    fn a_rate_is_of_the_last_seconds_and_silence_is_told() {
        let mut meters = BTreeMap::from([("edge/pose".to_owned(), Meter::new(BACKLOG))]);
        let meter = meters.get_mut("edge/pose").unwrap();
        // A minute at 50 Hz, then 10 Hz.
        for message in 0..3000 {
            meter.add(Duration::from_millis(20 * message), 100);
        }
        for message in 0..60 {
            meter.add(Duration::from_millis(60_000 + 100 * message), 100);
        }
        let at = |meters: &mut _, millis: u64| hz_line(&rows(meters, Duration::from_millis(millis))[0]);
        assert_eq!(
            at(&mut meters, 65_900),
            "edge/pose  10.00 Hz  interval 100.0 to 100.0 ms, deviation 0.0 ms  (3060 messages)"
        );
        let paused = at(&mut meters, 68_900);
        assert!(
            paused.contains("10.00 Hz") && paused.ends_with("(3060 messages, the last 3.0 s ago)"),
            "{paused}"
        );
        assert_eq!(
            at(&mut meters, 72_900),
            "edge/pose  no rate  (3060 messages, the last 7.0 s ago)"
        );
        let row = &rows(&mut meters, Duration::from_secs(73))[0];
        assert_eq!(bw_line(row), "edge/pose  no rate  (3060 messages, the last 7.1 s ago)");
    }
}
