//! Copies. Which of two mapping services leads, does the other one hold its map, and has it taken over?

use std::time::Duration;

use zenav_protocol::bus::{AliveWatch, Bus, BusError, Subscription};
use zenav_protocol::messages::{InfoRequest, MappingLeader};
use zenav_protocol::topics::{self, ALIVE_COMPONENT, alive_key};

use crate::deployment::ROBOT;

/// Component of the liveliness token of a copy that holds the leader's map.
const STANDBY: &str = "mapping-standby";
/// Longest wait for the answers of all parts.
const ANSWERS: Duration = Duration::from_secs(2);

/// Observes the mapping services of the robot.
pub struct Copies {
    beats: Subscription<MappingLeader>,
    standbys: AliveWatch,
    /// Last term of a leader.
    term: u64,
    is_followed: bool,
}

impl Copies {
    /// Watches from now on.
    ///
    /// # Errors
    /// When the bus is closed.
    pub fn new(client: &Bus) -> Result<Self, BusError> {
        Ok(Self {
            beats: client.subscribe(&topics::MAPPING_LEADER, &[ROBOT], 256)?,
            standbys: client.watch_alive(alive_key(ALIVE_COMPONENT, &[ROBOT, STANDBY]))?,
            term: 0,
            is_followed: false,
        })
    }

    /// Processes what has arrived.
    pub fn listen(&mut self) {
        while let Some(beat) = self.beats.try_next() {
            self.term = self.term.max(beat.message.term);
        }
        while let Some((_, is_present)) = self.standbys.try_next() {
            self.is_followed = is_present;
        }
    }

    /// The last term of a leader: a takeover begins the next one.
    #[must_use]
    pub fn term(&self) -> u64 {
        self.term
    }

    /// Whether a copy holds the leader's map.
    #[must_use]
    pub fn is_followed(&self) -> bool {
        self.is_followed
    }
}

/// The process of the mapping service that leads.
///
/// # Errors
/// When none answers that it does.
pub async fn leading(client: &Bus) -> Result<u32, String> {
    let request = InfoRequest::default();
    let answers = client.ask_all(&topics::PART_INFO, &["*"], &request, ANSWERS).await;
    let answers = answers.map_err(|error| error.to_string())?;
    let infos = answers.into_iter().filter_map(|answer| answer.result.ok());
    infos
        .filter(|info| info.component == "mapping" && info.leads)
        .find_map(|info| info.process)
        .map(|process| process.pid)
        .ok_or_else(|| "no mapping service leads".to_owned())
}
