//! How is a mission fed from the bus, and how are its effects carried out? The one folder of the mission that knows both.
//!
//! Of several missions for one robot, each with a store of its own, one leads and the others follow; who does is the robot's word.
//!
//! | file | answers |
//! |---|---|
//! | `lead` | how is the mission stepped that keeps the robot's goals? |
//! | `standbys` | how do other stores come to hold what the leader acknowledges, before it does? |
//! | `follow` | what does a mission do that stands by, and when may it lead? |
//! | `requests` | where do requests come in? |
//! | `workers` | whom are its questions asked? |

mod follow;
mod lead;
mod requests;
mod standbys;
#[cfg(test)]
mod tests;
mod workers;

use std::sync::Arc;

use thiserror::Error;
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::bus::{Bus, BusError, Clock, Server, Shutdown};
use zenav_protocol::messages::{InfoReply, JournalEntry, JournalReply, Refusal};
use zenav_protocol::topics::{self, MissionReply, MissionRequest};

use requests::{Requests, Waiting};
use zenav_mission::config::MissionConfig;
use zenav_mission::store::{Store, StoreError};

/// Why a mission ended by itself.
#[derive(Debug, Error)]
pub enum MissionError {
    /// The bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The store: nothing more may be promised to anybody.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// This mission and the robot do not speak the same language.
    #[error("{0}")]
    Mismatch(String),
}

/// What comes after a time of leading or following.
enum Turn {
    /// This process ends.
    Over,
    /// This mission asks to lead.
    Lead,
    /// Another mission leads.
    Follow,
}

/// Why a time of leading ends.
enum End {
    /// Another mission leads, or may by now.
    Deposed,
    /// Nothing goes on.
    Failed(MissionError),
}

impl<E: Into<MissionError>> From<E> for End {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

/// What a mission has while it leads, and while it follows.
struct Post {
    bus: Bus,
    clock: Clock,
    config: MissionConfig,
    store: Arc<Store>,
    requests: Requests,
    /// Where a leader hands over what it writes.
    journal: Server<JournalEntry, JournalReply>,
    /// How far the time of the leader that was followed last is ahead of this clock, ns.
    ahead: Option<i64>,
    shutdown: Shutdown,
}

impl Post {
    /// Answers requests while this mission is a standby: identity only, everything else is refused with `NotLeader`.
    fn answer_as_standby(&self, call: Waiting) {
        let reply = match call.request {
            MissionRequest::Info(_) => Ok(MissionReply::Info(InfoReply {
                component: "mission".to_owned(),
                version: env!("CARGO_PKG_VERSION").to_owned(),
                schema: SCHEMA_VERSION,
                robot: self.config.robot.to_string(),
                store: Some(self.store.name().to_owned()),
                ..InfoReply::default()
            })),
            _ => Err(Refusal::NotLeader),
        };
        call.responder.send(reply);
    }
}

/// Runs one robot's mission until `shutdown`, or until it can go on no longer.
///
/// # Errors
/// [`MissionError`]; [`StoreError::Locked`] at once when another process has the store.
pub async fn run(bus: Bus, clock: Clock, config: MissionConfig, shutdown: Shutdown) -> Result<(), MissionError> {
    let path = config.store.clone();
    let store = Arc::new(blocking(move || Store::open(&path)).await??);
    let robot = config.robot.as_str();
    let _alive = bus.declare_alive(topics::alive_key(topics::ALIVE_COMPONENT, &[robot, "mission"]))?;
    let mut post = Post {
        requests: Requests::open(&bus, robot)?,
        journal: bus.serve(&topics::JOURNAL, &[robot, store.name()])?,
        bus,
        clock,
        config,
        store,
        ahead: None,
        shutdown,
    };
    let mut turn = Turn::Lead;
    loop {
        turn = match turn {
            Turn::Over => return Ok(()),
            Turn::Lead => lead::lead(&mut post).await?,
            Turn::Follow => follow::follow(&mut post).await?,
        };
    }
}

/// Runs what may wait for a disk away from the others.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, StoreError> {
    let failed = |error: tokio::task::JoinError| StoreError::Io {
        path: "mission store".to_owned(),
        reason: error.to_string(),
    };
    tokio::task::spawn_blocking(work).await.map_err(failed)
}
