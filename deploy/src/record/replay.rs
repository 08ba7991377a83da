//! `zenav replay`. Publishes a run on a bus again: every sample byte for byte, at its own time.
//!
//! Each sample has a deadline on a monotonic clock, counted from the first: late ones catch up, and nothing drifts. A replay that starts
//! in the middle first publishes the last states before that, and answers map requests as mapping would have: earlier patches count.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;
use tokio::sync::mpsc;
use tokio::time::Instant;
use zenav_protocol::bus::{Act, AliveWatch, Bus, RawPublisher, Request, interrupted, matches};
use zenav_protocol::messages::{MapReply, MapRequest, Refusal};
use zenav_protocol::topics::{self, Qos};

use super::format::{Kind, RecordError, Sample};
use super::maps::Maps;
use super::reader::RecordReader;
use crate::arguments::{finite, positive, seconds};
use crate::connect::{self, LinkArgs};
use crate::failure::{Failure, Outcome};
use crate::inspect::pattern;
use crate::output::{self, Format};
use crate::tasks;

type MapRequested = Request<MapRequest, MapReply>;

/// Time spent looking for live robots before the first sample.
const LOOK: Duration = Duration::from_millis(700);
/// Time for the last samples to be sent.
const DRAIN: Duration = Duration::from_millis(200);

/// Arguments of `zenav replay`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: a run at double speed from its tenth second on, to look at in the page or in another program:\n  \
                  zenav router &\n  \
                  zenav replay run.mcap --speed 2 --from 10"
)]
pub struct ReplayArgs {
    /// Record to replay
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    link: LinkArgs,
    /// Recorded time relative to wall time
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    speed: f64,
    /// Start at this time of the record, s
    #[arg(long, value_name = "SECS", default_value_t = 0.0, value_parser = finite)]
    from: f64,
    /// Stop at this time of the record, s
    #[arg(long, value_name = "SECS", value_parser = positive)]
    to: Option<f64>,
    /// Publish only matching keys (`zenav/*/edge/**`, `edge/scan`, `pose`) [default: all]
    #[arg(long, value_name = "KEYS", num_args = 1..)]
    keys: Vec<String>,
    /// Also publish what a robot alive on this bus would obey
    #[arg(long)]
    to_live_robot: bool,
    /// Publish nothing: recompute outputs from the recorded inputs, and compare them with the recorded ones
    #[arg(
        long,
        value_name = "PARTS",
        value_enum,
        value_delimiter = ',',
        conflicts_with_all = ["from", "to", "keys", "speed", "to_live_robot"]
    )]
    recompute: Vec<super::recompute::Recomputable>,
    /// Deployment with the run's settings, for --recompute [default: the settings in the record, or the shipped ones]
    #[arg(long, value_name = "DEPLOYMENT", requires = "recompute")]
    deployment: Option<PathBuf>,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Summary of a replay.
#[derive(Debug, Default, Serialize)]
struct Replayed {
    /// Samples.
    messages: u64,
    /// Keys.
    keys: usize,
    /// Bytes of their payloads.
    payload_bytes: u64,
    /// Replayed time of the record, s.
    secs: f64,
    /// Largest delay of a sample behind its deadline, ms.
    latest_ms: f64,
    /// Whether the record was cut off.
    cut_off: bool,
    /// Damaged chunks of the record, which were left out.
    damaged_chunks: usize,
}

/// `zenav replay`.
///
/// # Errors
/// A bad record, no connection, an identity that may not write its keys, or a live robot that would obey.
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
            "{}: nothing of that in the record, which lasts {:.1} s",
            args.file.display(),
            contents.secs
        )));
    }
    let replayed = connect::on_bus(&args.link, async |bus| {
        contents.keys.iter().try_for_each(|key| bus.check(Act::Write, key))?;
        let mut guard = Guard::new(&bus, &contents.keys, args.to_live_robot)?;
        guard.look(&bus).await?;
        tokio::select! {
            replayed = publish(&bus, args, &selection, &contents) => replayed,
            refusal = guard.until_one_comes() => Err(refusal),
            () = interrupted() => Err(Failure::interrupted()),
        }
    })?;
    output::value(args.output, &replayed, |replayed| {
        format!(
            "replayed {} on {}, {:.1} s of the record; the latest left {:.1} ms late",
            output::counted(replayed.messages, "message"),
            output::counted(replayed.keys, "key"),
            replayed.secs,
            replayed.latest_ms
        )
    })
}

/// Selected samples.
struct Selection {
    patterns: Vec<String>,
    from: f64,
    to: f64,
    to_live_robot: bool,
}

impl Selection {
    fn new(args: &ReplayArgs) -> Result<Self, Failure> {
        let patterns = args.keys.iter().map(|key| pattern(key, None));
        Ok(Self {
            patterns: patterns.collect::<Result<_, _>>()?,
            from: args.from,
            to: args.to.unwrap_or(f64::INFINITY),
            to_live_robot: args.to_live_robot,
        })
    }

    fn has_key(&self, key: &str) -> bool {
        // A body obeys these but has no liveliness token; observers do not need them.
        let drives = || topics::row_of(key).is_some_and(|row| row.pattern == topics::WHEELS.pattern);
        if !self.to_live_robot && drives() {
            return false;
        }
        self.patterns.is_empty() || self.patterns.iter().any(|pattern| matches(pattern, key))
    }

    /// Whether a sample so long after the first is selected, s.
    fn has(&self, sample: &Sample, secs: f64) -> bool {
        sample.kind != Kind::Reply && secs >= self.from && secs <= self.to && self.has_key(&sample.key)
    }

    /// Whether a sample before the start is a state that holds until the next one.
    fn has_state(&self, sample: &Sample) -> bool {
        let is_state = || topics::row_of(&sample.key).is_some_and(|row| row.qos == Some(Qos::State));
        sample.kind == Kind::Put && self.has_key(&sample.key) && is_state()
    }
}

/// Contents of the replay, known before the first sample is published.
struct Contents {
    first: u64,
    /// Time from the first sample to the last, s.
    secs: f64,
    keys: BTreeSet<String>,
}

impl Contents {
    fn of(path: &Path, selection: &Selection) -> Result<Self, RecordError> {
        let mut reader = RecordReader::open(path)?;
        let (mut first, mut last, mut keys, mut held) = (None, 0.0_f64, BTreeSet::new(), BTreeSet::new());
        while let Some(sample) = reader.next_sample()? {
            let secs = since(*first.get_or_insert(sample.logged), sample.logged);
            last = last.max(secs);
            if selection.has(&sample, secs) {
                keys.insert(sample.key);
            } else if secs < selection.from && selection.has_state(&sample) {
                held.insert(sample.key);
            }
        }
        // States that hold at the start are published with the first sample.
        if !keys.is_empty() {
            keys.append(&mut held);
        }
        Ok(Self {
            first: first.unwrap_or_default(),
            secs: last,
            keys,
        })
    }

    /// Robots whose keys are published.
    fn robots(&self) -> BTreeSet<&str> {
        let known = self.keys.iter().filter(|key| topics::row_of(key).is_some());
        let second = known.filter_map(|key| key.split('/').nth(1));
        second.filter(|name| !["sim", "svc"].contains(name)).collect()
    }
}

/// Time since the first sample, s.
fn since(first: u64, logged: u64) -> f64 {
    logged.saturating_sub(first) as f64 * 1e-9
}

/// Keys of a live robot, which must not be published: it would obey them, or others would take them for its own.
fn of_live_robots<'k>(keys: &'k BTreeSet<String>, alive: &BTreeSet<String>) -> Vec<&'k str> {
    let of_one = |key: &&String| {
        let mut chunks = key.split('/');
        chunks.next() == Some("zenav") && chunks.next().is_some_and(|robot| alive.contains(robot))
    };
    keys.iter().filter(of_one).map(String::as_str).collect()
}

/// Makes sure that no live robot obeys the record.
struct Guard {
    keys: BTreeSet<String>,
    allowed: bool,
    watch: AliveWatch,
    /// Robots and their live components.
    alive: BTreeSet<(String, String)>,
}

impl Guard {
    fn new(bus: &Bus, keys: &BTreeSet<String>, allowed: bool) -> Result<Self, Failure> {
        Ok(Self {
            keys: keys.clone(),
            allowed,
            watch: bus.watch_alive(topics::alive_key(topics::ALIVE_COMPONENT, &["*", "*"]))?,
            alive: BTreeSet::new(),
        })
    }

    /// Looks for live robots: by liveliness token, or by state, as on a robot's own endpoint. A running simulation is found by its clock.
    async fn look(&mut self, bus: &Bus) -> Result<(), Failure> {
        let mut states = bus.latest(&topics::STATE, &["*"])?;
        let mut clock = bus.latest(&topics::SIM_CLOCK, &[])?;
        tokio::time::sleep(LOOK).await;
        while let Some((key, up)) = self.watch.try_next() {
            self.note(&key, up);
        }
        while let Some(state) = states.take_received() {
            let robot = state.chunks.into_iter().next();
            self.alive.extend(robot.map(|robot| (robot, "state".to_owned())));
        }
        self.check()?;
        if clock.take().is_some() && self.keys.contains(&topics::SIM_CLOCK.key(&[])) && !self.allowed {
            return Err(Failure::rejected(format!(
                "a simulation gives the time on this bus, and the record has another one ({}): leave it out by --keys, use another router, or say --to-live-robot",
                topics::SIM_CLOCK.key(&[])
            )));
        }
        Ok(())
    }

    fn note(&mut self, key: &str, up: bool) {
        if let Some([robot, component]) = topics::alive_chunks(topics::ALIVE_COMPONENT, key).as_deref() {
            let of = ((*robot).to_owned(), (*component).to_owned());
            if up {
                self.alive.insert(of);
            } else {
                self.alive.remove(&of);
            }
        }
    }

    fn check(&self) -> Result<(), Failure> {
        let alive = self.alive.iter().map(|(robot, _)| robot.clone()).collect();
        let refused = of_live_robots(&self.keys, &alive);
        if self.allowed || refused.is_empty() {
            return Ok(());
        }
        let robots: BTreeSet<&str> = refused.iter().filter_map(|key| key.split('/').nth(1)).collect();
        let (count, example) = (refused.len(), refused.first().unwrap_or(&""));
        Err(Failure::rejected(format!(
            "{} is alive on this bus, itself or its cloud: it would obey the record, and others would take the record for it ({count} keys, such as {example}). \
                 Use another router, choose other --keys, or say --to-live-robot",
            output::listed(robots)
        )))
    }

    /// Waits until a robot appears that would obey.
    async fn until_one_comes(&mut self) -> Failure {
        while let Some((key, up)) = self.watch.next().await {
            self.note(&key, up);
            if let Err(refusal) = self.check() {
                return refusal;
            }
        }
        Failure::closed()
    }
}

/// Publishers, one for each key and encoding of the record.
struct Publishers<'b> {
    bus: &'b Bus,
    known: BTreeMap<(String, String), RawPublisher>,
}

impl Publishers<'_> {
    fn publish(&mut self, sample: Sample) -> Result<(), Failure> {
        let publisher = match self.known.entry((sample.key, sample.encoding)) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => {
                let (key, encoding) = new.key();
                let publisher = self.bus.raw_publisher(key, encoding)?;
                new.insert(publisher)
            }
        };
        match sample.kind {
            Kind::Delete => publisher.delete()?,
            _ => publisher.put(sample.bytes, sample.attachment)?,
        }
        Ok(())
    }
}

async fn publish(
    bus: &Bus,
    args: &ReplayArgs,
    selection: &Selection,
    contents: &Contents,
) -> Result<Replayed, Failure> {
    let mut reader = RecordReader::open(&args.file)?;
    let mut publishers = Publishers {
        bus,
        known: BTreeMap::new(),
    };
    let mut keys = BTreeSet::new();
    let mut replayed = Replayed::default();
    // What holds at the start: the maps, and the last of each state, in order of arrival.
    let mut maps = Maps::default();
    let mut states: BTreeMap<String, (usize, Sample)> = BTreeMap::new();
    // A live mapping service answers for its own map.
    let mut asked = match selection.to_live_robot {
        true => None,
        false => Some(map_requests(bus, &contents.robots())?),
    };
    let mut begin: Option<Instant> = None;
    let mut latest = Duration::ZERO;
    let mut count = 0;
    while let Some(sample) = reader.next_sample()? {
        count += 1;
        let secs = since(contents.first, sample.logged);
        if secs > selection.to {
            break;
        }
        maps.see(&sample);
        if secs < selection.from {
            if selection.has_state(&sample) {
                states.insert(sample.key.clone(), (count, sample));
            } else if sample.kind == Kind::Delete {
                states.remove(&sample.key);
            }
            continue;
        }
        if !selection.has(&sample, secs) {
            continue;
        }
        let begin = *begin.get_or_insert_with(Instant::now);
        let mut held: Vec<(usize, Sample)> = std::mem::take(&mut states).into_values().collect();
        held.sort_by_key(|(place, _)| *place);
        for (_, state) in held {
            publishers.publish(state)?;
        }
        let due = begin + seconds((secs - selection.from) / args.speed);
        loop {
            tokio::select! {
                biased;
                () = tokio::time::sleep_until(due) => break,
                request = next(&mut asked) => answer(request, &maps),
            }
        }
        latest = latest.max(due.elapsed());
        replayed.messages += 1;
        replayed.payload_bytes += sample.bytes.len() as u64;
        replayed.secs = secs - selection.from;
        keys.insert(sample.key.clone());
        publishers.publish(sample)?;
    }
    tokio::time::sleep(DRAIN).await;
    replayed.keys = keys.len();
    replayed.latest_ms = 1e3 * latest.as_secs_f64();
    replayed.cut_off = reader.is_cut_off();
    replayed.damaged_chunks = reader.damaged_chunks();
    reader.warn_of_losses();
    Ok(replayed)
}

/// Requests for the maps of these robots.
fn map_requests(bus: &Bus, robots: &BTreeSet<&str>) -> Result<mpsc::Receiver<MapRequested>, Failure> {
    let (sender, requests) = mpsc::channel(1);
    for robot in robots {
        let mut server = bus.serve(&topics::MAP, &[robot])?;
        let sender = sender.clone();
        tasks::spawn(async move {
            while let Some(request) = server.next().await {
                if sender.send(request).await.is_err() {
                    return;
                }
            }
        });
    }
    Ok(requests)
}

/// The next request for a map; never, if a live mapping service answers.
async fn next(asked: &mut Option<mpsc::Receiver<MapRequested>>) -> MapRequested {
    if let Some(asked) = asked
        && let Some(request) = asked.recv().await
    {
        return request;
    }
    std::future::pending().await
}

/// Answers as mapping would have at this time of the record.
fn answer(request: MapRequested, maps: &Maps) {
    let robot = request.chunks.first().map_or("", String::as_str);
    match maps.reply(robot) {
        Some(map) => request.reply(&map),
        None => {
            let what = format!("no map of {robot} at this time of the record");
            request.refuse(&Refusal::NotFound { what });
        }
    }
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
}
