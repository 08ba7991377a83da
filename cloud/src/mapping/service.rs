//! Service. Joins the bus, and leads or follows until shutdown.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use zenav_observability::Condition;
use zenav_protocol::bus::{Bus, Clock, Shutdown};
use zenav_protocol::id::Id;
use zenav_protocol::settings::Settings as _;
use zenav_protocol::topics::{ALIVE_COMPONENT, MAPPING_LEADER, alive_chunks, alive_key};

use super::follow::{Followed, LEADER, MOST_BEATS, STANDBY, follow};
use super::lead::lead;
use super::metrics::CopyMetrics;
use super::{MappingConfig, MappingError, succession};

/// Longest wait for the tokens of other services at the start.
const ROLL_CALL: Duration = Duration::from_secs(1);
/// Number of roll calls: the token of a service that has just ended may still be seen.
const ROLL_CALLS: usize = 6;
/// Time in which a leader is heard, if there is one.
const WORD: Duration = succession::BEAT.saturating_mul(2);

/// What follows after leading or following.
pub(super) enum Turn {
    /// This process ends.
    Over,
    /// This service leads.
    Lead(Box<Followed>),
    /// Another service leads.
    Follow(Box<Followed>),
}

/// Shared by leading and following.
pub(super) struct MappingService {
    pub(super) bus: Bus,
    pub(super) clock: Clock,
    pub(super) config: MappingConfig,
    pub(super) shutdown: Shutdown,
    /// Name of this service, unique to its process.
    pub(super) name: String,
    /// Met once the map is loaded, begun or followed.
    pub(super) role: Condition,
    pub(super) metrics: CopyMetrics,
    leads: Arc<AtomicBool>,
}

impl MappingService {
    /// Sets what others are told about this service.
    pub(super) fn leads(&self, leads: bool) {
        self.leads.store(leads, Ordering::Relaxed);
        self.metrics.leads(leads);
    }

    /// Whether this service leads at the start: unless another one does, or may know the map better.
    async fn begin(&self) -> Result<Turn, MappingError> {
        let chunks = [self.config.robot.as_str()];
        let mut beats = self.bus.subscribe(&MAPPING_LEADER, &chunks, MOST_BEATS)?;
        let components = alive_key(ALIVE_COMPONENT, &[&self.config.robot, "*"]);
        let is_mapping = |key: &String| {
            let chunks = alive_chunks(ALIVE_COMPONENT, key);
            matches!(chunks.as_deref(), Some([_, LEADER | STANDBY]))
        };
        for _ in 0..ROLL_CALLS {
            let alive = self.bus.list_alive(components.clone(), ROLL_CALL).await?;
            if !alive.iter().any(is_mapping) {
                return Ok(Turn::Lead(Box::default()));
            }
            if let Ok(Some(_)) = tokio::time::timeout(WORD, beats.next()).await {
                break;
            }
        }
        Ok(Turn::Follow(Box::default()))
    }
}

/// Maps for one robot until shutdown, or until the bus is closed.
///
/// A stored map is loaded and held: it is published, but not changed before a `resume` or `reset`. An unreadable stored map is reported and
/// left alone, and a new one is started. SLAM resumes its stored session, if there is one.
///
/// While another service of the robot leads, this one follows its map, and takes over if the leader is gone or silent.
///
/// # Errors
/// [`MappingError`] for settings out of bounds, annotations or a session of SLAM that cannot be read, a folder that is in use, and when a key
/// cannot be declared.
pub async fn run(bus: Bus, clock: Clock, config: MappingConfig, shutdown: Shutdown) -> Result<(), MappingError> {
    config.settings.check()?;
    let leads = Arc::new(AtomicBool::new(false));
    let part = MappingService {
        role: bus.expects("its map is loaded, begun or followed"),
        name: Id::unique().to_string(),
        metrics: CopyMetrics::new(&config.robot),
        leads: Arc::clone(&leads),
        bus,
        clock,
        config,
        shutdown,
    };
    let mut turn = part.begin().await?;
    part.bus
        .serve_info_of_copy("mapping", &part.config.robot, part.config.told(), move || {
            leads.load(Ordering::Relaxed)
        })?;
    loop {
        turn = match turn {
            Turn::Over => return Ok(()),
            Turn::Lead(followed) => lead(&part, *followed).await?,
            Turn::Follow(followed) => follow(&part, *followed).await?,
        };
    }
}
