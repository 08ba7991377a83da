//! Planning worker. How are plan requests answered over the network? [`PlanWorker`] answers them, [`host`] carries them, and the trees of a
//! search are published where somebody listens.

pub mod worker;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use zenav_protocol::bus::{Bus, BusError, Clock, Publisher, Shutdown};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{MapRef, PlanOutcome, PlanReply, PlanRequest, Refusal, SearchTree};
use zenav_protocol::topics::{Ask, PLAN_SERVICE, TREE};

use self::worker::PlanWorker;
use crate::worker_host::{Work, host};
use zenav_planning::PlanningSettings;
use zenav_protocol::map_replica::MapReplica;
use zenav_protocol::padding::Extent;
use zenav_space::Zones;

/// Robots whose searches are shown at once; beyond it the first by name goes.
const MAX_SHOWN: usize = 64;
/// Most edges of a tree that are shown: the first ones, which reach out farthest.
const MAX_EDGES: usize = 20_000;

impl Work for PlanWorker {
    type Question = PlanRequest;
    type Answer = PlanReply;
    const ASK: Ask<PlanRequest, PlanReply> = PLAN_SERVICE;
    const SERVICE: &'static str = "plan";

    fn map_of(question: &PlanRequest) -> (&str, &MapRef) {
        (&question.robot, &question.map)
    }

    fn outlook(question: &PlanRequest) -> Option<Extent> {
        let places = vec![question.start.position(), question.goal.position()];
        question
            .unknown_is_free
            .then(|| Extent::of(&question.model.footprint, places))
    }

    fn budget(question: &PlanRequest) -> Duration {
        Duration::from_millis(question.budget_ms)
    }

    fn answer(
        &mut self,
        map: Option<&MapReplica>,
        question: &PlanRequest,
        clock: &mut dyn FnMut() -> f64,
        cancel: &AtomicBool,
    ) -> Result<PlanReply, Refusal> {
        let began = clock();
        let mut reply = Self::answer(self, map, question, Some(cancel))?;
        reply.search_ms = (clock() - began) * 1e3;
        Ok(reply)
    }
}

/// Answers plan requests, on maps with these zones, under a worker's name until shutdown, or until the bus is closed.
///
/// # Errors
/// [`BusError`] when a key cannot be declared.
pub async fn run(
    bus: Bus,
    clock: Clock,
    worker: Id,
    zones: Arc<Zones>,
    settings: PlanningSettings,
    shutdown: Shutdown,
) -> Result<(), BusError> {
    let mut show = Show {
        bus: bus.clone(),
        clock,
        publishers: BTreeMap::new(),
    };
    let begun = || PlanWorker::new(Arc::clone(&zones), settings.clone());
    host(bus, worker, shutdown, begun, |core: &PlanWorker, question, answer| {
        show.tell(core, question, answer);
    })
    .await
}

/// Where searches can be looked at.
struct Show {
    bus: Bus,
    clock: Clock,
    publishers: BTreeMap<String, Publisher<SearchTree>>,
}

impl Show {
    fn tell(&mut self, core: &PlanWorker, question: &PlanRequest, answer: &PlanReply) {
        if !self.is_watched(&question.robot) {
            return;
        }
        let path = match &answer.outcome {
            PlanOutcome::Found { path, .. } => path.clone(),
            _ => Vec::new(),
        };
        let tree = SearchTree {
            stamp: self.clock.now(),
            edges: core.tree(MAX_EDGES),
            path,
        };
        if let Some(publisher) = self.publishers.get(&question.robot) {
            publisher.put(&tree);
        }
    }

    /// Whether somebody may look at this robot's searches. A publisher that is new cannot know yet.
    fn is_watched(&mut self, robot: &str) -> bool {
        if let Some(publisher) = self.publishers.get(robot) {
            return publisher.may_be_heard();
        }
        if self.publishers.len() >= MAX_SHOWN {
            self.publishers.pop_first();
        }
        match self.bus.publisher(&TREE, &[robot]) {
            Ok(publisher) => {
                self.publishers.insert(robot.to_owned(), publisher);
                true
            }
            Err(error) => {
                tracing::warn!(robot, %error, "its searches cannot be shown");
                false
            }
        }
    }
}
