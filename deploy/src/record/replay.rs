//! `zenav replay`. How does a run come onto a bus again? Every sample byte for byte, at its own time.
//!
//! Each sample has its deadline on a monotonic clock, counted from the first: late ones are caught up, and nothing drifts.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;
use tokio::time::Instant;
use zenav_protocol::bus::{AliveWatch, Bus, RawPublisher, interrupted};
use zenav_protocol::topics;

use super::format::{Kind, RecordError, Sample};
use super::reader::RecordReader;
use crate::connect::{self, LinkArgs, finite, positive};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::inspect::pattern;
use crate::output::{self, Format};

/// How long to look for robots that are alive before the first sample.
const LOOK: Duration = Duration::from_millis(700);
/// Time for the last samples to leave.
const DRAIN: Duration = Duration::from_millis(200);

/// Arguments of `zenav replay`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: a run at double speed from its tenth second on, to look at in the page or in another program:\n  \
                  zenav router &\n  \
                  zenav replay run.mcap --speed 2 --from 10"
)]
pub struct ReplayArgs {
    /// Record
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Connection.
    #[command(flatten)]
    link: LinkArgs,
    /// Recorded time against wall time
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    speed: f64,
    /// Begin at this time of the record, s
    #[arg(long, value_name = "SECS", default_value_t = 0.0, value_parser = finite)]
    from: f64,
    /// End at this time of the record, s
    #[arg(long, value_name = "SECS", value_parser = positive)]
    to: Option<f64>,
    /// Only keys like these (`zenav/*/edge/**`, `edge/scan`, `pose`) [default: all]
    #[arg(long, value_name = "KEYS", num_args = 1..)]
    keys: Vec<String>,
    /// Publish also what a robot would obey that is alive on this bus
    #[arg(long)]
    to_live_robot: bool,
    /// Publish nothing: compute again from the recorded inputs, and compare with what was recorded
    #[arg(long, value_name = "PARTS", value_enum, value_delimiter = ',')]
    recompute: Vec<super::recompute::Part>,
    /// Deployment whose settings the run had, for --recompute [default: what the record says, or the shipped one]
    #[arg(long, value_name = "DEPLOYMENT", requires = "recompute")]
    deployment: Option<PathBuf>,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// What was published.
#[derive(Debug, Default, Serialize)]
struct Replayed {
    /// Samples.
    messages: u64,
    /// Keys.
    keys: usize,
    /// Bytes of their payloads.
    payload_bytes: u64,
    /// Time of the record that was replayed, s.
    secs: f64,
    /// How much later than due the latest sample left, ms.
    latest_ms: f64,
    /// Whether the record was cut off.
    cut_off: bool,
}

/// `zenav replay`.
///
/// # Errors
/// A bad record, nobody to connect to, or a robot that would obey.
pub fn replay(args: &ReplayArgs) -> Outcome {
    if !args.recompute.is_empty() {
        return super::recompute::run(&args.file, &args.recompute, args.deployment.as_deref(), args.output);
    }
    if args.to.is_some_and(|to| to <= args.from) {
        return Err(Failure::usage("--to: expected a time after --from"));
    }
    let selection = Selection::new(args)?;
    let contents = Contents::of(&args.file, &selection)?;
    if contents.keys.is_empty() {
        return Err(Failure::not_found(format!(
            "{}: nothing of that in the record",
            args.file.display()
        )));
    }
    let replayed = connect::on_bus(&args.link, async |bus| {
        let mut guard = Guard::new(&bus, &contents.keys, args.to_live_robot)?;
        guard.look(&bus).await?;
        tokio::select! {
            replayed = publish(&bus, args, &selection, contents.first) => replayed,
            refusal = guard.until_one_comes() => Err(refusal),
            () = interrupted() => Err(Failure::new(exit_code::INTERRUPTED, "interrupted")),
        }
    })?;
    if replayed.cut_off {
        tracing::warn!("{}: cut off, as by a killed recorder", args.file.display());
    }
    output::value(args.output, &replayed, |replayed| {
        format!(
            "replayed {} on {}, {:.1} s of the record; the latest left {:.1} ms late",
            output::counted(replayed.messages, "message"),
            output::counted(replayed.keys, "key"),
            replayed.secs,
            replayed.latest_ms
        )
    })?;
    Ok(exit_code::OK)
}

/// Which samples are meant.
struct Selection {
    patterns: Vec<String>,
    from: f64,
    to: f64,
}

impl Selection {
    fn new(args: &ReplayArgs) -> Result<Self, Failure> {
        let patterns = args.keys.iter().map(|key| pattern(key, None));
        Ok(Self {
            patterns: patterns.collect::<Result<_, _>>()?,
            from: args.from,
            to: args.to.unwrap_or(f64::INFINITY),
        })
    }

    fn has_key(&self, key: &str) -> bool {
        self.patterns.is_empty() || self.patterns.iter().any(|pattern| fits(pattern, key))
    }

    /// Whether a sample is meant that came so long after the first, s.
    fn has(&self, sample: &Sample, secs: f64) -> bool {
        sample.kind != Kind::Reply && secs >= self.from && secs <= self.to && self.has_key(&sample.key)
    }
}

/// Whether a key matches a key expression: `*` is one chunk, `**` any number, `$*` any letters of a chunk.
pub(super) fn fits(pattern: &str, key: &str) -> bool {
    fn chunks(pattern: &[&str], key: &[&str]) -> bool {
        match (pattern, key) {
            ([], []) => true,
            (["**", rest @ ..], key) => (0..=key.len()).any(|skipped| chunks(rest, &key[skipped..])),
            ([first, rest @ ..], [chunk, others @ ..]) => letters(first, chunk) && chunks(rest, others),
            _ => false,
        }
    }
    fn letters(pattern: &str, chunk: &str) -> bool {
        if pattern == "*" {
            return true;
        }
        let Some((head, tail)) = pattern.split_once("$*") else {
            return pattern == chunk;
        };
        let Some(rest) = chunk.strip_prefix(head) else {
            return false;
        };
        (0..=rest.len()).any(|skipped| rest.get(skipped..).is_some_and(|rest| letters(tail, rest)))
    }
    let (pattern, key): (Vec<&str>, Vec<&str>) = (pattern.split('/').collect(), key.split('/').collect());
    chunks(&pattern, &key)
}

/// What will be published: known before the first sample is.
struct Contents {
    first: u64,
    keys: BTreeSet<String>,
}

impl Contents {
    fn of(path: &Path, selection: &Selection) -> Result<Self, RecordError> {
        let mut reader = RecordReader::open(path)?;
        let (mut first, mut keys) = (None, BTreeSet::new());
        while let Some(sample) = reader.next_sample()? {
            let first = *first.get_or_insert(sample.logged);
            if selection.has(&sample, since(first, sample.logged)) && !keys.contains(&sample.key) {
                keys.insert(sample.key);
            }
        }
        Ok(Self {
            first: first.unwrap_or_default(),
            keys,
        })
    }
}

/// Time since the first sample, s.
fn since(first: u64, logged: u64) -> f64 {
    logged.saturating_sub(first) as f64 * 1e-9
}

/// Keys of a robot that is there now which must not be published on: it would obey them, or others would take them for its own.
fn of_live_robots<'k>(keys: &'k BTreeSet<String>, alive: &BTreeSet<String>) -> Vec<&'k str> {
    let of_one = |key: &&String| {
        let mut chunks = key.split('/');
        chunks.next() == Some("zenav") && chunks.next().is_some_and(|robot| alive.contains(robot))
    };
    keys.iter().filter(of_one).map(String::as_str).collect()
}

/// Sees to it that no live robot obeys the past.
struct Guard {
    keys: BTreeSet<String>,
    allowed: bool,
    watch: AliveWatch,
    alive: BTreeSet<String>,
}

impl Guard {
    fn new(bus: &Bus, keys: &BTreeSet<String>, allowed: bool) -> Result<Self, Failure> {
        Ok(Self {
            keys: keys.clone(),
            allowed,
            watch: bus.watch_alive(topics::alive_key(topics::ALIVE_COMPONENT, &["*", "edge"]))?,
            alive: BTreeSet::new(),
        })
    }

    /// Who is there now? By its token, or by its state, as on a robot's own endpoint; a simulation by its time.
    async fn look(&mut self, bus: &Bus) -> Result<(), Failure> {
        let mut states = bus.latest(&topics::STATE, &["*"])?;
        let mut clock = bus.latest(&topics::SIM_CLOCK, &[])?;
        tokio::time::sleep(LOOK).await;
        while let Some((key, up)) = self.watch.try_next() {
            self.note(&key, up);
        }
        while let Some(state) = states.take_received() {
            self.alive.extend(state.chunks.into_iter().next());
        }
        self.check()?;
        if clock.take().is_some() && self.keys.contains(&topics::SIM_CLOCK.key(&[])) && !self.allowed {
            return Err(Failure::new(
                exit_code::REJECTED,
                format!(
                    "a simulation gives the time on this bus, and the record has another one ({}): leave it out by --keys, use another router, or say --to-live-robot",
                    topics::SIM_CLOCK.key(&[])
                ),
            ));
        }
        Ok(())
    }

    fn note(&mut self, key: &str, up: bool) {
        if let Some([robot, _]) = topics::alive_chunks(topics::ALIVE_COMPONENT, key).as_deref() {
            if up {
                self.alive.insert((*robot).to_owned());
            } else {
                self.alive.remove(*robot);
            }
        }
    }

    fn check(&self) -> Result<(), Failure> {
        let refused = of_live_robots(&self.keys, &self.alive);
        if self.allowed || refused.is_empty() {
            return Ok(());
        }
        let robots: BTreeSet<&str> = refused.iter().filter_map(|key| key.split('/').nth(1)).collect();
        let robots: Vec<&str> = robots.into_iter().collect();
        let (count, example) = (refused.len(), refused.first().unwrap_or(&""));
        Err(Failure::new(
            exit_code::REJECTED,
            format!(
                "{} is alive on this bus: it would obey the record, and others would take the record for it ({count} keys, such as {example}). \
                 Use another router, choose other --keys, or say --to-live-robot",
                robots.join(", ")
            ),
        ))
    }

    /// Waits until a robot comes to life that would obey.
    async fn until_one_comes(&mut self) -> Failure {
        while let Some((key, up)) = self.watch.next().await {
            self.note(&key, up);
            if let Err(refusal) = self.check() {
                return refusal;
            }
        }
        Failure::new(exit_code::CANNOT_CONNECT, "the bus was closed")
    }
}

async fn publish(bus: &Bus, args: &ReplayArgs, selection: &Selection, first: u64) -> Result<Replayed, Failure> {
    let mut reader = RecordReader::open(&args.file)?;
    let mut publishers: BTreeMap<(String, String), RawPublisher> = BTreeMap::new();
    let mut keys = BTreeSet::new();
    let mut replayed = Replayed::default();
    let begin = Instant::now();
    let mut latest = Duration::ZERO;
    while let Some(sample) = reader.next_sample()? {
        let secs = since(first, sample.logged);
        if secs > selection.to {
            break;
        }
        if !selection.has(&sample, secs) {
            continue;
        }
        let due = begin + due(secs - selection.from, args.speed);
        tokio::time::sleep_until(due).await;
        latest = latest.max(due.elapsed());
        replayed.messages += 1;
        replayed.payload_bytes += sample.bytes.len() as u64;
        replayed.secs = secs - selection.from;
        keys.insert(sample.key.clone());
        let place = (sample.key, sample.encoding);
        let publisher = match publishers.entry(place) {
            std::collections::btree_map::Entry::Occupied(known) => known.into_mut(),
            std::collections::btree_map::Entry::Vacant(new) => {
                let (key, encoding) = new.key();
                let publisher = bus.raw_publisher(key, encoding)?;
                new.insert(publisher)
            }
        };
        match sample.kind {
            Kind::Delete => publisher.delete()?,
            _ => publisher.put(sample.bytes, sample.attachment)?,
        }
    }
    tokio::time::sleep(DRAIN).await;
    replayed.keys = keys.len();
    replayed.latest_ms = 1e3 * latest.as_secs_f64();
    replayed.cut_off = reader.is_cut_off();
    Ok(replayed)
}

/// When a sample is due after the begin.
fn due(secs: f64, speed: f64) -> Duration {
    Duration::try_from_secs_f64((secs / speed).max(0.0)).unwrap_or(Duration::from_secs(1 << 30))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(names: &[&str]) -> BTreeSet<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn nothing_is_published_for_a_robot_that_is_alive() {
        let keys = set(&[
            "zenav/a/cloud/plan",
            "zenav/a/edge/pose",
            "zenav/b/cloud/plan",
            "other/a",
        ]);
        assert_eq!(
            of_live_robots(&keys, &set(&["a"])),
            ["zenav/a/cloud/plan", "zenav/a/edge/pose"]
        );
        assert!(of_live_robots(&keys, &set(&["c"])).is_empty());
    }

    #[test]
    fn keys_match_as_zenoh_has_it() {
        for (pattern, key, expected) in [
            ("zenav/*/edge/**", "zenav/a/edge/scan/rear", true),
            ("zenav/*/edge/**", "zenav/a/edge", true),
            ("zenav/*/edge/pose", "zenav/a/cloud/pose", false),
            ("**", "a/b", true),
            ("**/pose", "zenav/a/edge/pose", true),
            ("zenav/rob$*/edge/pose", "zenav/robot1/edge/pose", true),
            ("zenav/rob$*/edge/pose", "zenav/bob/edge/pose", false),
            ("zenav/a/edge/pose", "zenav/a/edge/pose", true),
        ] {
            assert_eq!(fits(pattern, key), expected, "{pattern} {key}");
        }
    }

    #[test]
    fn deadlines_are_of_the_record_and_not_of_the_sample_before() {
        assert_eq!(due(10.0, 2.0), Duration::from_secs(5));
        assert_eq!(due(-1.0, 2.0), Duration::ZERO);
        assert_eq!(due(1e300, 1e-3), Duration::from_secs(1 << 30));
    }
}
