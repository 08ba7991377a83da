//! Recorder. How does what comes on a bus get into a file, without ever holding up the bus or filling the memory?
//!
//! Zenoh's threads put samples into a queue that is bounded by bytes; a thread of its own writes them. What does not fit is dropped and
//! counted. Beside the samples it asks each robot for its model, and mapping for a map whose beginning it has missed.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use tokio::runtime::Handle;
use tokio::task::{JoinHandle, JoinSet};
use zenav_protocol::bus::{Bus, Shutdown, Tap, Tapped};
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{InfoRequest, MapRequest};
use zenav_protocol::topics;

use super::format::{Kind, RecordError, Sample};
use super::writer::{RecordOptions, RecordWriter, Written};
use crate::failure::Failure;

/// Most bytes that wait to be written: some seconds of a robot at full rate, or one large map.
const BACKLOG: usize = 64 << 20;
/// How often what was written is made to outlive this process.
const FLUSH: Duration = Duration::from_secs(1);
/// Time limit of each question to a robot or to mapping.
const PATIENCE: Duration = Duration::from_secs(5);

/// UNIX time that never steps back: that of the start, and a monotonic clock since.
#[derive(Clone, Copy, Debug)]
struct Timeline {
    began: Instant,
    unix: u64,
}

impl Timeline {
    fn now() -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self {
            began: Instant::now(),
            unix: nanos(unix),
        }
    }

    /// ns since the UNIX epoch.
    fn at(&self, instant: Instant) -> u64 {
        self.unix + nanos(instant.saturating_duration_since(self.began))
    }
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// A recording that goes on.
#[derive(Debug)]
pub struct Recording {
    shutdown: Shutdown,
    task: JoinHandle<Result<Written, Failure>>,
}

impl Recording {
    /// Records what comes on keys that match one of the patterns.
    ///
    /// # Errors
    /// Bad patterns, or a file that cannot be made.
    pub fn start(bus: &Bus, patterns: &[String], path: &Path, options: RecordOptions) -> Result<Self, Failure> {
        let timeline = Timeline::now();
        let tap = bus.tap(patterns, BACKLOG)?;
        let writer = RecordWriter::create(path, options, timeline.unix)?;
        let shutdown = Shutdown::new();
        let recorder = Recorder {
            bus: bus.clone(),
            tap,
            writer,
            timeline,
            questions: JoinSet::new(),
            known: BTreeSet::new(),
            lacking: Vec::new(),
            asked_for_maps: None,
        };
        let (handle, ended) = (Handle::current(), shutdown.clone());
        // A slow disk may hold up this thread, and nothing else.
        let task = tokio::task::spawn_blocking(move || handle.block_on(recorder.run(&ended)));
        Ok(Self { shutdown, task })
    }

    /// Waits until it ends by itself, as it does when the disk is full or the bus was closed; cancel-safe.
    ///
    /// # Errors
    /// The file could not be written.
    pub async fn ended(&mut self) -> Result<Written, Failure> {
        (&mut self.task).await.map_err(Failure::failed)?
    }

    /// Ends it: what has come until now is written.
    ///
    /// # Errors
    /// The file could not be written.
    pub async fn finish(mut self) -> Result<Written, Failure> {
        self.shutdown.trigger();
        self.ended().await
    }
}

struct Recorder {
    bus: Bus,
    tap: Tap,
    writer: RecordWriter,
    timeline: Timeline,
    questions: JoinSet<Result<Sample, String>>,
    /// Robots whose model was asked for.
    known: BTreeSet<String>,
    /// Robots of whose map a part was missing a second ago.
    lacking: Vec<String>,
    asked_for_maps: Option<Instant>,
}

impl Recorder {
    async fn run(mut self, shutdown: &Shutdown) -> Result<Written, Failure> {
        let mut flushing = tokio::time::interval(FLUSH);
        flushing.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        let mut told = 0;
        loop {
            tokio::select! {
                tapped = self.tap.next() => match tapped {
                    Some(tapped) => self.write(tapped)?,
                    None => break,
                },
                Some(reply) = self.questions.join_next() => self.hear(reply)?,
                _ = flushing.tick() => {
                    self.writer.flush()?;
                    self.ask_for_maps();
                    let dropped = self.tap.dropped();
                    if dropped > told {
                        tracing::warn!(dropped, "too slow for all samples: some are not recorded");
                        told = dropped;
                    }
                }
                () = shutdown.wait() => break,
            }
        }
        while let Some(tapped) = self.tap.try_next() {
            self.write(tapped)?;
        }
        Ok(self.writer.finish(self.tap.dropped())?)
    }

    fn write(&mut self, tapped: Tapped) -> Result<(), RecordError> {
        self.meet(&tapped.sample.key);
        let kind = if tapped.sample.deleted { Kind::Delete } else { Kind::Put };
        self.writer.write(&Sample {
            key: tapped.sample.key,
            encoding: tapped.sample.encoding,
            kind,
            bytes: tapped.sample.bytes,
            attachment: tapped.attachment,
            logged: self.timeline.at(tapped.arrived),
            published: tapped.sample.stamp.map(|stamp| stamp.0),
        })
    }

    /// Asks a robot that was not heard of before for its model.
    fn meet(&mut self, key: &str) {
        let mut chunks = key.split('/');
        let (Some("zenav"), Some(robot), Some("edge")) = (chunks.next(), chunks.next(), chunks.next()) else {
            return;
        };
        if self.known.contains(robot) || Id::robot(robot).is_err() {
            return;
        }
        self.known.insert(robot.to_owned());
        let (bus, robot, timeline) = (self.bus.clone(), robot.to_owned(), self.timeline);
        self.questions.spawn(async move {
            let request = InfoRequest::default();
            let info = bus.ask(&topics::EDGE_INFO, &[&robot], &request, PATIENCE).await;
            let info = info.map_err(|_| robot.clone())?;
            let bytes = codec::encode(&info, Encoding::Json).map_err(|_| robot.clone())?;
            Ok(reply(topics::EDGE_INFO.key(&[&robot]), Encoding::Json, bytes, timeline))
        });
    }

    /// Asks for the maps whose beginning was missed. A patch that is only late comes within the second.
    fn ask_for_maps(&mut self) {
        let before = std::mem::replace(&mut self.lacking, self.writer.incomplete_maps());
        if self.asked_for_maps.is_some_and(|asked| asked.elapsed() < PATIENCE) {
            return;
        }
        for robot in self.lacking.iter().filter(|robot| before.contains(robot)).cloned() {
            self.asked_for_maps = Some(Instant::now());
            let (bus, timeline) = (self.bus.clone(), self.timeline);
            self.questions.spawn(async move {
                let request = MapRequest::default();
                let map = bus.ask(&topics::MAP, &[&robot], &request, PATIENCE).await;
                let map = map.map_err(|_| String::new())?;
                let bytes = codec::encode(&map, Encoding::Cbor).map_err(|_| String::new())?;
                Ok(reply(topics::MAP.key(&[&robot]), Encoding::Cbor, bytes, timeline))
            });
        }
    }

    /// An answer is written; a robot that gave none is asked again when it is next heard of.
    fn hear(&mut self, answer: Result<Result<Sample, String>, tokio::task::JoinError>) -> Result<(), RecordError> {
        match answer {
            Ok(Ok(reply)) => self.writer.write(&reply),
            Ok(Err(robot)) => {
                self.known.remove(&robot);
                Ok(())
            }
            Err(_) => Ok(()),
        }
    }
}

fn reply(key: String, encoding: Encoding, bytes: Vec<u8>, timeline: Timeline) -> Sample {
    Sample {
        key,
        encoding: encoding.mime().to_owned(),
        kind: Kind::Reply,
        bytes,
        attachment: None,
        logged: timeline.at(Instant::now()),
        published: None,
    }
}
