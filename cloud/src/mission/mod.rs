//! Mission service. Feeds a mission from the bus and carries out its effects.
//!
//! Of several missions for one robot, each with its own store, one leads and the others are standbys; the robot decides which.
//!
//! | file | answers |
//! |---|---|
//! | `lead` | how is the leading mission stepped? |
//! | `standbys`, `replication` | how is the leader's journal replicated before it acknowledges anything? |
//! | `follow` | what does a standby do, and when may it lead? |
//! | `workers` | which service answers the mission's own requests? |
//! | `worker_pool` | which of several motion workers is asked, and when is a second one asked as well? |
//! | `trace` | which scan does a plan come from? |
//! | `metrics` | how long do goals, steps, writes and plans take? |
//! | `no_room` | what does a mission do when its disk is full? |

mod follow;
mod lead;
mod metrics;
mod no_room;
mod replication;
mod standbys;
#[cfg(test)]
mod tests;
mod trace;
mod worker_pool;
mod workers;

use std::sync::Arc;

use thiserror::Error;
use zenav_observability::Condition;
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::bus::{AliveToken, Bus, BusError, Call, Clock, Server, Shutdown};
use zenav_protocol::messages::{InfoReply, JournalEntry, JournalReply, Refusal};
use zenav_protocol::topics::{self, MissionReply, MissionRequest};

pub use workers::Workers;

use zenav_mission::{MissionConfig, MissionStore, StoreError};

/// Requests of clients and other missions.
type Requests = crate::requests::Requests<MissionRequest>;
/// One of them, with the channel for its answer.
type Pending = Call<MissionRequest>;

/// Why a mission ended on its own.
#[derive(Debug, Error)]
pub enum MissionError {
    /// What the bus reports.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The store failed for good: nothing more can be acknowledged.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A step of the mission panicked.
    #[error("a step of the mission failed: {0}")]
    Step(String),
}

/// What follows after leading or following.
enum Turn {
    /// This process ends.
    Over,
    /// This mission requests to lead.
    Lead,
    /// Another mission leads.
    Follow,
}

/// Why leading ends.
enum End {
    /// Another mission leads, or may by now.
    Deposed,
    /// The service cannot continue.
    Failed(MissionError),
}

impl<E: Into<MissionError>> From<E> for End {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

/// Shared by leading and following.
struct Service {
    bus: Bus,
    clock: Clock,
    config: MissionConfig,
    store: Arc<MissionStore>,
    requests: Requests,
    /// Where the leader's journal arrives.
    journal: Server<JournalEntry, JournalReply>,
    /// Offset of the last leader's time to this clock, ns.
    ahead: Option<i64>,
    shutdown: Shutdown,
    /// Met once the role is known: goals are then accepted, here or by another mission.
    role: Condition,
}

impl Service {
    /// Answers requests while this mission is a standby: identity only, everything else is refused with `NotLeader`.
    fn answer_as_standby(&self, call: Pending) {
        let reply = match call.request {
            MissionRequest::Info(_) => Ok(MissionReply::Info(self.info(None))),
            _ => Err(Refusal::NotLeader),
        };
        call.responder.send(reply);
    }

    /// Identity of this mission while it does not lead, and why it can store nothing.
    fn info(&self, not_stored: Option<String>) -> InfoReply {
        InfoReply {
            store: Some(self.store.name().to_owned()),
            not_stored,
            ..identity(&self.bus, &self.config)
        }
    }
}

/// Identity of a mission without a store.
fn identity(bus: &Bus, config: &MissionConfig) -> InfoReply {
    InfoReply {
        component: "mission".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        schema: SCHEMA_VERSION,
        robot: config.robot.to_string(),
        process: Some(bus.process_info()),
        ..InfoReply::default()
    }
}

/// Runs one robot's mission until `shutdown`, or until it fails.
///
/// # Errors
/// [`MissionError`]; [`StoreError::Locked`] at once when another process has the store, [`StoreError::Foreign`] when its file is damaged. A
/// full disk is no error: the mission waits for room.
pub async fn run(bus: Bus, clock: Clock, config: MissionConfig, shutdown: Shutdown) -> Result<(), MissionError> {
    let opened = bus.expects(&format!("the store of {} is open", config.robot));
    let role = bus.expects(&format!("the mission of {} leads, or stands by", config.robot));
    let Some((store, announced)) = no_room::open(&bus, &config, &shutdown).await? else {
        return Ok(());
    };
    opened.met();
    let (requests, _alive) = match announced {
        Some(announced) => announced,
        None => announce(&bus, &config)?,
    };
    let mut service = Service {
        requests,
        journal: bus.serve(&topics::JOURNAL, &[config.robot.as_str(), store.name()])?,
        bus,
        clock,
        config,
        store,
        ahead: None,
        shutdown,
        role,
    };
    service.bus.started();
    let mut turn = Turn::Lead;
    loop {
        let next = match turn {
            Turn::Over => return Ok(()),
            Turn::Lead => lead::lead(&mut service).await,
            Turn::Follow => follow::follow(&mut service).await,
        };
        turn = match next {
            Err(MissionError::Store(error @ StoreError::NoRoom { .. })) => no_room::wait(&mut service, &error).await?,
            next => next?,
        };
    }
}

/// Takes the requests of a robot's clients, and shows that its mission runs.
fn announce(bus: &Bus, config: &MissionConfig) -> Result<(Requests, AliveToken), BusError> {
    let robot = config.robot.as_str();
    let token = topics::alive_key(topics::ALIVE_COMPONENT, &[robot, "mission"]);
    let alive = bus.declare_alive(token)?;
    Ok((Requests::open(bus, robot)?, alive))
}

/// Runs blocking disk work off the runtime's threads.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, StoreError> {
    let failed = |error: tokio::task::JoinError| StoreError::Io {
        path: "mission store".to_owned(),
        reason: error.to_string(),
    };
    tokio::task::spawn_blocking(work).await.map_err(failed)
}
