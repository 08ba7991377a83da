//! Shown. What do others see of a worker's work? The search's tree, and each request with its answer.

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

/// Robots whose motions are shown at once; beyond it the first by name goes.
const MAX_SHOWN: usize = 64;
/// Most edges of a tree that are shown: the first ones, which reach out farthest.
const MAX_EDGES: usize = 20_000;

/// A request that was worked on.
pub(super) struct Work {
    pub(super) map: Option<MapRef>,
    pub(super) zones: Arc<Zones>,
    pub(super) request: MotionRequest,
    pub(super) answer: Result<MotionReply, Refusal>,
    pub(super) cut_short: bool,
}

/// Publishes what was worked on, to whoever looks.
pub(super) struct Shown {
    clock: Clock,
    worker: Id,
    /// Requests that were worked on since the start.
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

    /// Counts a request. One whose work failed is counted and not shown: what the worker kept is lost with it, and the missing number tells.
    pub(super) fn begin(&mut self) {
        self.number += 1;
    }

    /// Shows the request that was counted last.
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

/// The path that was searched for, empty where there is none; `None` where no path was asked for.
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

/// A topic of every robot that few look at.
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

    /// The robot's publisher, where somebody may look. One that is new cannot know yet.
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
