//! Persisting and publishing. What does a step store, and what does it publish?

use std::collections::BTreeMap;

use zenav_behaviour_tree::{NodeReport, Status};
use zenav_protocol::messages::{GoalFeedback, Heartbeat, MissionStatus, NodeStatus};
use zenav_protocol::time::Stamp;

use super::io::Effect;
use super::orchestrator::Mission;
use super::records::{Record, RunningTree};

/// Last published values.
#[derive(Default)]
pub(super) struct Published {
    /// Goal, revision of its tree, epoch.
    pub(super) status: Option<(Option<String>, u64, Option<u64>)>,
    pub(super) next_status: Stamp,
    pub(super) feedback: GoalFeedback,
    pub(super) legs: u64,
}

impl Mission {
    /// The effects of a step: first the records to persist, then all others.
    pub(super) fn collect(&mut self, heartbeat: Option<Heartbeat>) -> Vec<Effect> {
        self.publish_feedback();
        let mut records = self.goals.take_records();
        if let Some(motion) = self.ctx.motion.take_changed() {
            records.push(Record::Motion(motion));
        }
        match &mut self.running {
            Some(running) if running.stored != Some(running.tree.revision()) => {
                running.stored = Some(running.tree.revision());
                let snapshot = running.tree.snapshot();
                records.push(Record::Tree(Some(Box::new(RunningTree {
                    goal_id: running.goal_id.clone(),
                    snapshot,
                }))));
            }
            Some(_) => {}
            None if self.tree_ended => records.push(Record::Tree(None)),
            None => {}
        }
        self.tree_ended = false;
        let mut effects = Vec::new();
        if !records.is_empty() {
            records.push(Record::Now(self.ctx.now));
            effects.push(Effect::Persist(records));
        }
        effects.extend(heartbeat.map(Effect::Heartbeat));
        effects.extend(self.ctx.plans.drain(..).map(|plan| Effect::Plan(Box::new(plan))));
        effects.extend(
            self.ctx
                .asks
                .take_new()
                .into_iter()
                .map(|(ticket, ask)| Effect::Ask(ticket, ask)),
        );
        effects.extend(
            self.goals
                .take_changed()
                .into_iter()
                .map(|goal| Effect::Goal(Box::new(goal))),
        );
        effects.extend(self.status().map(|status| Effect::Status(Box::new(status))));
        effects.extend(
            self.replies
                .drain(..)
                .map(|(client, reply)| Effect::Reply(client, reply)),
        );
        effects
    }

    /// Copies the leaves' feedback into the goal: drives are persisted, the rest is only published.
    fn publish_feedback(&mut self) {
        let Some(running) = &self.running else { return };
        let ctx = &self.ctx;
        if ctx.goal.leg_changes != self.published.legs {
            self.published.legs = ctx.goal.leg_changes;
            let (feedback, legs) = (ctx.goal.feedback.clone(), ctx.goal.legs.clone());
            self.goals.change(&running.goal_id, |goal| {
                goal.state.feedback = feedback;
                goal.state.legs = legs;
            });
        }
        let told = &self.published.feedback;
        let news = &ctx.goal.feedback;
        let changed = (&told.step, told.plans, told.replans, told.recoveries)
            != (&news.step, news.plans, news.replans, news.recoveries);
        if changed || ctx.now >= self.published.next_status && told != news {
            self.published.feedback = news.clone();
            self.goals.feed_back(&running.goal_id, news);
        }
    }

    /// The mission's status, if it has changed or is due.
    fn status(&mut self) -> Option<MissionStatus> {
        let running = self.running.as_ref();
        let news = (
            running.map(|running| running.goal_id.clone()),
            running.map_or(0, |running| running.tree.revision()),
            self.ctx.lease.epoch(),
        );
        if self.published.status.as_ref() == Some(&news) && self.ctx.now < self.published.next_status {
            return None;
        }
        self.published.status = Some(news);
        self.published.next_status = self.ctx.now.plus_secs(self.ctx.config.settings.status_period);
        let nodes = running.map(|running| running.tree.report()).unwrap_or_default();
        let ports = |uid| {
            let values = running.into_iter().flat_map(|running| running.tree.port_values(uid));
            values.map(|(port, words)| (port.to_owned(), words)).collect()
        };
        let node = |node: NodeReport| NodeStatus {
            uid: u32::from(node.uid),
            parent: node.parent.map(u32::from),
            name: node.name,
            id: node.id,
            status: node.status.as_str().to_owned(),
            feedback: node.feedback,
            last: if node.last == Status::Idle {
                String::new()
            } else {
                node.last.as_str().to_owned()
            },
            ports: if node.starts > 0 {
                ports(node.uid)
            } else {
                BTreeMap::new()
            },
        };
        Some(MissionStatus {
            stamp: self.ctx.now,
            holder: self.ctx.config.holder.clone(),
            leads: self.ctx.lease.epoch().is_some(),
            epoch: self.ctx.lease.epoch().unwrap_or(0),
            goal_id: running.map(|running| running.goal_id.clone()),
            tree: running.map(|running| running.name.clone()),
            nodes: nodes.into_iter().map(node).collect(),
            feedback: self.ctx.goal.feedback.clone(),
            queued: self.goals.queued() as u64,
            standbys: self.standbys.clone(),
        })
    }
}
