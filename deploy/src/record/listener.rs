//! Listener. Turns bus traffic into samples of a record, including what a late joiner has missed.
//!
//! Arrival times come from one clock that never steps back. The listener also asks each robot for its model, mapping and motion workers
//! for their settings, and mapping for a map whose beginning was missed; the answers become samples too.

use std::collections::{BTreeSet, VecDeque};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use tokio::task::{JoinError, JoinSet};
use zenav_protocol::bus::{Act, Answer, Bus, Tap, Tapped, matches};
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{InfoReply, InfoRequest, MapRequest};
use zenav_protocol::topics;

use super::format::{Kind, Sample};
use crate::failure::Failure;
use crate::tasks::boxed;

/// Most bytes queued: some seconds of a robot at full rate, or one large map.
const BACKLOG: usize = 64 << 20;
/// Longest wait for each answer of a robot or of mapping.
const PATIENCE: Duration = Duration::from_secs(5);

/// UNIX time that never steps back: the wall time at the start, advanced by a monotonic clock.
#[derive(Clone, Copy, Debug)]
struct Timeline {
    began: Instant,
    unix: u64,
}

impl Timeline {
    fn begin() -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self {
            began: Instant::now(),
            unix: nanos(unix),
        }
    }

    /// Current time, ns since the UNIX epoch.
    fn now(&self) -> u64 {
        self.at(Instant::now())
    }

    /// Time of an instant, ns since the UNIX epoch.
    fn at(&self, instant: Instant) -> u64 {
        self.unix + nanos(instant.saturating_duration_since(self.began))
    }
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Robot, side and name of a topic: a message on it proves that the part that writes it is running.
type Topic = [String; 3];

/// Listens to a bus.
#[derive(Debug)]
pub struct Listener {
    bus: Bus,
    tap: Tap,
    timeline: Timeline,
    questions: JoinSet<Result<Vec<Sample>, Topic>>,
    /// Answers not yet taken.
    answers: VecDeque<Sample>,
    /// Topics whose writers were already asked.
    known: BTreeSet<Topic>,
    /// Robots whose map was incomplete a second ago.
    lacking: Vec<String>,
    asked_for_maps: Option<Instant>,
    /// Key expressions that it listens on.
    patterns: Vec<String>,
}

impl Listener {
    /// Listens on keys that match one of the patterns.
    ///
    /// # Errors
    /// Bad patterns, or keys that this process's identity may not hear.
    pub fn new(bus: &Bus, patterns: &[String]) -> Result<Self, Failure> {
        patterns.iter().try_for_each(|pattern| bus.check(Act::Hear, pattern))?;
        Ok(Self {
            timeline: Timeline::begin(),
            tap: bus.tap(patterns, BACKLOG)?,
            bus: bus.clone(),
            questions: JoinSet::new(),
            answers: VecDeque::new(),
            known: BTreeSet::new(),
            lacking: Vec::new(),
            asked_for_maps: None,
            patterns: patterns.to_vec(),
        })
    }

    /// Start, ns since the UNIX epoch.
    #[must_use]
    pub fn began(&self) -> u64 {
        self.timeline.unix
    }

    /// Waits for the next sample; `None` after the bus was closed. Cancel-safe.
    pub async fn next(&mut self) -> Option<Sample> {
        loop {
            if let Some(answer) = self.answers.pop_front() {
                return Some(answer);
            }
            tokio::select! {
                tapped = self.tap.next() => return tapped.map(|tapped| self.sample(tapped)),
                Some(answers) = self.questions.join_next() => self.hear(answers),
            }
        }
    }

    /// The next sample, if one is queued.
    pub fn try_next(&mut self) -> Option<Sample> {
        let answer = self.answers.pop_front();
        answer.or_else(|| self.tap.try_next().map(|tapped| self.sample(tapped)))
    }

    /// Current time on the clock of the samples, ns since the UNIX epoch.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.timeline.now()
    }

    /// Number of samples dropped because they were not taken in time.
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

    /// On the first message of a part, asks a robot for its model, or mapping and motion workers for their settings.
    fn meet(&mut self, key: &str) {
        let mut chunks = key.split('/');
        let (Some("zenav"), Some(robot), Some(side), Some(name)) =
            (chunks.next(), chunks.next(), chunks.next(), chunks.next())
        else {
            return;
        };
        let topic = match (side, name) {
            // Any of its topics will do.
            ("edge", _) => [robot, side, ""],
            ("cloud", "map") => [robot, side, name],
            // Workers serve all robots.
            ("cloud", "motion") => ["*", side, name],
            _ => return,
        };
        let topic = topic.map(str::to_owned);
        if Id::robot(robot).is_err() || !self.known.insert(topic.clone()) {
            return;
        }
        let (bus, timeline, is_robot) = (self.bus.clone(), self.timeline, side == "edge");
        let part_asked = match name {
            "map" => format!("mapping-{robot}"),
            _ => "*".to_owned(),
        };
        self.questions.spawn(boxed(async move {
            let request = InfoRequest::default();
            let told = if is_robot {
                let key = topics::EDGE_INFO.key(&[&topic[0]]);
                let info = bus.ask(&topics::EDGE_INFO, &[&topic[0]], &request, PATIENCE).await;
                info.map(|info| vec![(key, info)])
            } else {
                let parts = bus
                    .ask_all(&topics::PART_INFO, &[&part_asked], &request, PATIENCE)
                    .await;
                parts.map(|parts| parts.into_iter().filter_map(part).collect())
            };
            let replies = told.unwrap_or_default().into_iter().filter_map(|(key, info)| {
                let bytes = codec::encode(&info, Encoding::Json).ok()?;
                Some(Sample::new(key, Kind::Reply, Encoding::Json, bytes, timeline.now()))
            });
            let replies: Vec<Sample> = replies.collect();
            if replies.is_empty() { Err(topic) } else { Ok(replies) }
        }));
    }

    /// Call every second with the robots whose maps are incomplete: asks for those that were incomplete a second ago too. A patch that is
    /// only late arrives within the second; a lost one would leave the map incomplete for good.
    pub fn ask_for_maps(&mut self, mut lacking: Vec<String>) {
        lacking.retain(|robot| {
            let patches = topics::MAP_PATCH.key(&[robot]);
            self.patterns.iter().any(|pattern| matches(pattern, &patches))
        });
        let before = std::mem::replace(&mut self.lacking, lacking);
        if self.asked_for_maps.is_some_and(|asked| asked.elapsed() < PATIENCE) {
            return;
        }
        for robot in self.lacking.iter().filter(|robot| before.contains(robot)).cloned() {
            self.asked_for_maps = Some(Instant::now());
            let (bus, timeline) = (self.bus.clone(), self.timeline);
            self.questions.spawn(boxed(async move {
                let request = MapRequest::default();
                let map = bus.ask(&topics::MAP, &[&robot], &request, PATIENCE).await;
                let map = map.ok().and_then(|map| codec::encode(&map, Encoding::Cbor).ok());
                let key = topics::MAP.key(&[&robot]);
                let reply = |bytes| Sample::new(key, Kind::Reply, Encoding::Cbor, bytes, timeline.now());
                let replies = map.map(reply);
                Ok(replies.into_iter().collect())
            }));
        }
    }

    /// Turns an answer into samples; a part that gave none is asked again on its next message.
    fn hear(&mut self, answers: Result<Result<Vec<Sample>, Topic>, JoinError>) {
        match answers {
            Ok(Ok(replies)) => self.answers.extend(replies),
            Ok(Err(topic)) => {
                self.known.remove(&topic);
            }
            Err(_) => {}
        }
    }
}

/// A part's reply, and the key it came on.
fn part(answer: Answer<InfoReply>) -> Option<(String, InfoReply)> {
    let chunks: Vec<&str> = answer.chunks.iter().map(String::as_str).collect();
    Some((topics::PART_INFO.key(&chunks), answer.result.ok()?))
}
