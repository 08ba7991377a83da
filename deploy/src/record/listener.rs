//! Listener. What comes on a bus, as the samples of a record, with what somebody who joins late has missed?
//!
//! Arrival times are those of one clock that never steps back. Beside the samples it asks each robot for its model, and mapping for a map
//! whose beginning was missed; the answers are samples too.

use std::collections::BTreeSet;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use tokio::task::{JoinError, JoinSet};
use zenav_protocol::bus::{Bus, Tap, Tapped};
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{InfoRequest, MapRequest};
use zenav_protocol::topics;

use super::format::{Kind, Sample};
use crate::failure::Failure;

/// Most bytes that wait to be taken: some seconds of a robot at full rate, or one large map.
const BACKLOG: usize = 64 << 20;
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

/// Listens to a bus.
#[derive(Debug)]
pub struct Listener {
    bus: Bus,
    tap: Tap,
    timeline: Timeline,
    questions: JoinSet<Result<Sample, String>>,
    /// Robots whose model was asked for.
    known: BTreeSet<String>,
    /// Robots of whose map a part was missing a second ago.
    lacking: Vec<String>,
    asked_for_maps: Option<Instant>,
}

impl Listener {
    /// Listens on keys that match one of the patterns.
    ///
    /// # Errors
    /// Bad patterns.
    pub fn new(bus: &Bus, patterns: &[String]) -> Result<Self, Failure> {
        Ok(Self {
            timeline: Timeline::now(),
            tap: bus.tap(patterns, BACKLOG)?,
            bus: bus.clone(),
            questions: JoinSet::new(),
            known: BTreeSet::new(),
            lacking: Vec::new(),
            asked_for_maps: None,
        })
    }

    /// When it began, ns since the UNIX epoch.
    #[must_use]
    pub fn began(&self) -> u64 {
        self.timeline.unix
    }

    /// Waits for the next sample; `None` after the bus was closed. Cancel-safe.
    pub async fn next(&mut self) -> Option<Sample> {
        loop {
            tokio::select! {
                tapped = self.tap.next() => return tapped.map(|tapped| self.sample(tapped)),
                Some(reply) = self.questions.join_next() => {
                    if let Some(sample) = self.hear(reply) {
                        return Some(sample);
                    }
                }
            }
        }
    }

    /// The next sample, if one waits.
    pub fn try_next(&mut self) -> Option<Sample> {
        self.tap.try_next().map(|tapped| self.sample(tapped))
    }

    /// Now, on the clock of the samples, ns since the UNIX epoch.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.timeline.at(Instant::now())
    }

    /// Number of samples dropped because nobody took them in time.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.tap.dropped()
    }

    fn sample(&mut self, tapped: Tapped) -> Sample {
        self.meet(&tapped.sample.key);
        let kind = if tapped.sample.deleted { Kind::Delete } else { Kind::Put };
        Sample {
            key: tapped.sample.key,
            encoding: tapped.sample.encoding,
            kind,
            bytes: tapped.sample.bytes,
            attachment: tapped.attachment,
            logged: self.timeline.at(tapped.arrived),
            published: tapped.sample.stamp.map(|stamp| stamp.0),
        }
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

    /// To be called each second with the robots of whose map a part is missing: asks for what was missing a second ago too. A patch that is
    /// only late comes within the second.
    pub fn ask_for_maps(&mut self, lacking: Vec<String>) {
        let before = std::mem::replace(&mut self.lacking, lacking);
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

    /// An answer is a sample; a robot that gave none is asked again when it is next heard of.
    fn hear(&mut self, answer: Result<Result<Sample, String>, JoinError>) -> Option<Sample> {
        match answer {
            Ok(Ok(reply)) => Some(reply),
            Ok(Err(robot)) => {
                self.known.remove(&robot);
                None
            }
            Err(_) => None,
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
