//! Shown. Publishes a worker's search tree, and each request with its answer.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Serialize;
use zenav_protocol::bus::{Bus, Clock, Publisher};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    MapRef, MotionRecord, MotionReply, MotionRequest, PlanOutcome, PlanReply, Refusal, SearchTree, TrajectoryReply,
};
use zenav_protocol::topics::{MOTION, TREE, Topic};
use zenav_space::Zones;

use super::worker::MotionWorker;

/// Most robots whose motions are published at once; beyond that the first by name is dropped.
const MAX_SHOWN: usize = 64;
/// Most published edges of a tree: the first ones, which reach farthest.
const MAX_EDGES: usize = 20_000;

/// A completed request.
pub(super) struct Work {
    pub(super) map: Option<MapRef>,
    pub(super) zones: Arc<Zones>,
    pub(super) request: MotionRequest,
    pub(super) answer: Result<MotionReply, Refusal>,
    pub(super) cut_short: bool,
}

/// Publishes completed requests to whoever subscribes.
pub(super) struct Shown {
    clock: Clock,
    worker: Id,
    /// Number of requests since the start.
    number: u64,
    trees: Watched<SearchTree>,
    records: Watched<MotionRecord>,
}

impl Shown {
    pub(super) fn new(bus: &Bus, clock: Clock, worker: Id) -> Self {
        Self {
            clock,
            worker,
            number: 0,
            trees: Watched::new(bus, TREE),
            records: Watched::new(bus, MOTION),
        }
    }

    /// Counts a request. A request whose work failed is counted but not published, since the worker's state is lost with it; the gap in the
    /// numbers shows it.
    pub(super) fn begin(&mut self) {
        self.number += 1;
    }

    /// Publishes the request counted last.
    pub(super) fn show(&mut self, worker: &MotionWorker, work: Work) {
        let robot = work.request.map().0.to_owned();
        let stamp = self.clock.now();
        if let Some(path) = searched(&work.answer)
            && let Some(publisher) = self.trees.publisher(&robot)
        {
            publisher.put(&SearchTree {
                stamp,
                edges: worker.tree(MAX_EDGES),
                path,
            });
        }
        if let Some(publisher) = self.records.publisher(&robot) {
            publisher.put(&MotionRecord {
                stamp,
                worker: self.worker.to_string(),
                number: self.number,
                map: work.map,
                zones: work.zones.to_messages(),
                request: work.request,
                answer: work.answer,
                cut_short: work.cut_short,
            });
        }
    }
}

/// The path found by a search, empty if there is none; `None` for a request without a search.
fn searched(answer: &Result<MotionReply, Refusal>) -> Option<Vec<nalgebra::Point2<f64>>> {
    let Ok(
        MotionReply::Plan(PlanReply { outcome, .. })
        | MotionReply::Trajectory(TrajectoryReply {
            plan: PlanReply { outcome, .. },
            ..
        }),
    ) = answer
    else {
        return None;
    };
    Some(match outcome {
        PlanOutcome::Found { path, .. } => path.clone(),
        _ => Vec::new(),
    })
}

/// A per-robot topic with few subscribers.
struct Watched<T> {
    bus: Bus,
    topic: Topic<T>,
    publishers: BTreeMap<String, Publisher<T>>,
}

impl<T: Serialize> Watched<T> {
    fn new(bus: &Bus, topic: Topic<T>) -> Self {
        Self {
            bus: bus.clone(),
            topic,
            publishers: BTreeMap::new(),
        }
    }

    /// The robot's publisher, if there may be subscribers. A new publisher cannot know yet.
    fn publisher(&mut self, robot: &str) -> Option<&Publisher<T>> {
        if !self.publishers.contains_key(robot) {
            if self.publishers.len() >= MAX_SHOWN {
                self.publishers.pop_first();
            }
            match self.bus.publisher(&self.topic, &[robot]) {
                Ok(publisher) => return Some(self.publishers.entry(robot.to_owned()).or_insert(publisher)),
                Err(error) => {
                    tracing::warn!(robot, topic = self.topic.pattern, %error, "the robot's motions cannot be shown");
                    return None;
                }
            }
        }
        self.publishers.get(robot).filter(|publisher| publisher.may_be_heard())
    }
}
