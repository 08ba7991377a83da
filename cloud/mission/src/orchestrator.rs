//! What happens in a mission's step? Listen, keep the lease, serve clients, run the goal's tree, tell everybody.

use std::time::Duration;

use zenav_protocol::messages::*;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{MissionReply, MissionRequest};

use super::config::MissionConfig;
use super::context::{Context, GoalInHand};
use super::goal_validation::{self, Target};
use super::goals::GoalTable;
use super::io::{Client, Effect, Inputs};
use super::leaves::{goal_text, goals_value};
use super::records::{Record, Restored, RunningTree, StoredGoal};
use super::trees;
use zenav_behaviour_tree::{Status, Tree, Value};

/// Time between two publications of what has not changed, s.
const STATUS_PERIOD: f64 = 0.5;

/// One robot's mission: pure, so that it runs in a service and in lockstep alike.
pub struct Mission {
    pub(super) ctx: Context,
    pub(super) goals: GoalTable,
    pub(super) incarnation: u64,
    /// The name of the store, where one keeps the goals.
    pub(super) store: Option<String>,
    standbys: Vec<String>,
    /// The mission's time when something was written last, before this life.
    written: Stamp,
    /// How far the mission's time is ahead of the clock's, ns.
    ahead: Option<i64>,
    running: Option<Running>,
    /// The tree that ran before a restart, until its goal is taken up again.
    left_over: Option<RunningTree>,
    replies: Vec<(Client, Result<MissionReply, Refusal>)>,
    tree_ended: bool,
    next_status: Stamp,
    told: Option<(Option<String>, u64, Option<u64>)>,
    told_feedback: GoalFeedback,
    told_legs: u64,
}

/// The goal in hand and its tree.
struct Running {
    goal_id: String,
    name: String,
    tree: Tree<Context>,
    /// The tree's revision that is stored.
    stored: Option<u64>,
}

impl std::fmt::Debug for Mission {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let goal = self.running.as_ref().map(|running| &running.goal_id);
        f.debug_struct("Mission")
            .field("robot", &self.ctx.config.robot)
            .field("goal", &goal)
            .finish_non_exhaustive()
    }
}

impl Mission {
    /// A mission that goes on where the one before it ended.
    #[must_use]
    pub fn new(config: MissionConfig, restored: Restored) -> Self {
        let mut ctx = Context::new(config, &restored);
        if let Some(plan) = restored.motion {
            ctx.motion.restore(plan);
        }
        Self {
            ctx,
            goals: GoalTable::new(restored.goals, restored.answers),
            incarnation: restored.incarnation,
            store: restored.store,
            written: restored.now,
            ahead: restored.ahead,
            standbys: Vec::new(),
            running: None,
            left_over: restored.tree,
            replies: Vec::new(),
            tree_ended: false,
            next_status: Stamp::ZERO,
            told: None,
            told_feedback: GoalFeedback::default(),
            told_legs: 0,
        }
    }

    /// One step, some twenty times a second and whenever a client asks. Effects are to be carried out in order, the first
    /// of them, [`Effect::Persist`], to its end before all others.
    pub fn step(&mut self, now: Stamp, inputs: Inputs) -> Vec<Effect> {
        let now = self.own_time(now);
        let ctx = &mut self.ctx;
        ctx.now = now;
        if let Some(state) = &inputs.state {
            ctx.lease.observe(now, state);
        }
        ctx.motion.observe(now, inputs.state.as_ref(), &inputs.events);
        ctx.robot.hear(now, &inputs.events);
        ctx.robot.observe(now, inputs.state, inputs.pose);
        ctx.map.observe(now, inputs.map_info, &inputs.map_patches);
        for (ticket, answer) in inputs.answers {
            ctx.asks.answer(ticket, answer);
        }
        let mut effects = Vec::new();
        if let Err(why) = ctx.robot.step(now, &mut ctx.asks) {
            effects.push(Effect::Fatal(why));
        }
        ctx.map.step(now, &mut ctx.asks);
        let heartbeat = ctx.lease.step(now, &mut ctx.asks);
        if !ctx.lease.leads() {
            return self.stand_by(inputs.requests, effects);
        }
        // Goals left by an earlier life are taken up before anybody asks about them.
        self.take_up();
        for (client, request) in inputs.requests {
            let reply = self.serve(request);
            self.replies.push((client, reply));
        }
        self.keep_deadlines();
        self.take_up();
        self.tick();
        self.collect(heartbeat, effects)
    }

    /// The mission's time goes on over restarts and over machines, whatever their clocks say: stored stamps are of it.
    fn own_time(&mut self, now: Stamp) -> Stamp {
        let written = self.written;
        // A clock that follows the robot's stands at zero until it has heard it.
        if now == Stamp::ZERO && self.ahead.is_none() {
            return written;
        }
        let ahead = *self.ahead.get_or_insert_with(|| written.since(now).as_nanos() as i64);
        Stamp(now.0.saturating_add_signed(ahead))
    }

    /// What is left to do for a mission that does not lead: it asks to, and says so.
    fn stand_by(&mut self, requests: Vec<(Client, MissionRequest)>, mut effects: Vec<Effect>) -> Vec<Effect> {
        for (client, request) in requests {
            let reply = self.serve(request);
            effects.push(Effect::Reply(client, reply));
        }
        let asks = self.ctx.asks.take_new();
        effects.extend(asks.into_iter().map(|(ticket, ask)| Effect::Ask(ticket, ask)));
        if self.ctx.lease.is_deposed() {
            effects.push(Effect::StandBy);
        }
        effects
    }

    /// The epoch under which this mission leads; `None` while the robot has not said so.
    #[must_use]
    pub fn term(&self) -> Option<u64> {
        self.ctx.lease.term()
    }

    /// The mission's own time.
    #[must_use]
    pub fn now(&self) -> Stamp {
        self.ctx.now
    }

    /// Why it does not command, in words.
    #[must_use]
    pub fn why_not(&self) -> &str {
        self.ctx.lease.why_not()
    }

    /// Which other stores hold all that this mission acknowledges, and whether some more may.
    pub fn share(&mut self, standbys: Vec<String>, shared: bool) {
        self.ctx.lease.share(shared);
        if standbys != self.standbys {
            self.standbys = standbys;
            self.told = None;
        }
    }

    /// The end of this process, not of its goals: the robot comes to rest soon, and the next life goes on.
    pub fn leave(&mut self) -> Vec<Effect> {
        self.ctx.hold();
        self.collect(None, Vec::new())
    }

    /// The lease's epoch, while this mission commands.
    #[must_use]
    pub fn epoch(&self) -> Option<u64> {
        self.ctx.lease.epoch()
    }

    /// A goal by its name.
    #[must_use]
    pub fn goal(&self, id: &str) -> Option<&GoalState> {
        self.goals.get(id).map(|goal| &goal.state)
    }

    /// Gives the goal in hand, or the next one, a tree.
    fn take_up(&mut self) {
        while self.running.is_none() {
            let Some(goal) = self.goals.active().or_else(|| self.goals.next()).cloned() else {
                return;
            };
            match self.attach(&goal) {
                Ok(running) => {
                    let now = self.ctx.now;
                    self.goals.change(&goal.state.id, |goal| {
                        if goal.state.state == GoalPhase::Accepted {
                            goal.state.state = GoalPhase::Active;
                        }
                        goal.state.started.get_or_insert(now);
                    });
                    self.running = Some(running);
                }
                Err(why) => {
                    self.goals
                        .end(&goal.state.id, GoalPhase::Rejected, Some(why), self.ctx.now);
                }
            }
        }
    }

    fn attach(&mut self, goal: &StoredGoal) -> Result<Running, String> {
        let id = &goal.state.id;
        let request = &goal.state.request;
        let target = goal_validation::target(request, &self.ctx).map_err(|refusal| refusal.to_string())?;
        let name = match (&request.tree, &target) {
            (Some(tree), _) => tree,
            (None, Target::Waypoints(_)) => trees::NAVIGATE_THROUGH,
            (None, _) => trees::NAVIGATE,
        };
        let mut tree = trees::build(name).map_err(|error| error.to_string())?;
        let left_over = self.left_over.take().filter(|left| left.goal_id == *id);
        let resumed = left_over.is_some_and(|left| match tree.restore(left.snapshot) {
            Ok(()) => true,
            Err(error) => {
                tracing::warn!(goal = id, %error, "its tree begins anew");
                false
            }
        });
        let mut legs = goal.state.legs.clone();
        if !resumed {
            self.ctx.motion.clear();
            fill_blackboard(&mut tree, &target, request)?;
            for leg in legs.iter_mut().filter(|leg| leg.ended.is_none()) {
                (leg.state, leg.ended) = (GoalPhase::Aborted, Some(self.ctx.now));
            }
        }
        self.ctx.goal = GoalInHand {
            id: id.clone(),
            tolerance: request.tolerance.unwrap_or(self.ctx.config.tolerance),
            profile: request.profile.unwrap_or(self.ctx.config.profile),
            feedback: goal.state.feedback.clone(),
            legs,
            leg_changes: 0,
            failure: None,
        };
        self.told_legs = 0;
        let name = trees::shipped(name).map_or_else(|| tree.id().to_owned(), |_| name.to_owned());
        Ok(Running {
            goal_id: id.clone(),
            name,
            tree,
            stored: None,
        })
    }

    fn keep_deadlines(&mut self) {
        let now = self.ctx.now;
        let late = |goal: &&StoredGoal| {
            goal.state
                .request
                .deadline_secs
                .is_some_and(|secs| now.since(goal.state.accepted).as_secs_f64() > secs)
        };
        let late: Vec<(String, f64)> = self
            .goals
            .open()
            .filter(late)
            .map(|goal| (goal.state.id.clone(), goal.state.request.deadline_secs.unwrap_or(0.0)))
            .collect();
        for (id, secs) in late {
            self.finish(
                &id,
                GoalPhase::Aborted,
                Some(format!("not reached within its deadline of {secs} s")),
            );
        }
    }

    /// Ticks the tree of the goal in hand, unless it is held by a pause.
    fn tick(&mut self) {
        let Some(running) = &mut self.running else { return };
        let Some(goal) = self.goals.get(&running.goal_id) else {
            return;
        };
        // A tree that can be held from outside decides itself what goes on meanwhile.
        let held = goal.state.state == GoalPhase::Paused && !running.tree.can_pause();
        if held || !matches!(goal.state.state, GoalPhase::Active | GoalPhase::Paused) {
            return;
        }
        // Time stands still for a tree while its goal is held.
        let time =
            Duration::from_nanos(self.ctx.now.0).saturating_sub(Duration::from_secs_f64(goal.paused_secs.max(0.0)));
        let (phase, reason) = match running.tree.tick(time, &mut self.ctx) {
            Ok(Status::Success) => (GoalPhase::Succeeded, None),
            Ok(Status::Failure) => {
                let why = self
                    .ctx
                    .goal
                    .failure
                    .clone()
                    .unwrap_or_else(|| "its tree failed".to_owned());
                (GoalPhase::Aborted, Some(why))
            }
            Ok(Status::Skipped) => (GoalPhase::Aborted, Some("its tree skipped every node".to_owned())),
            Ok(Status::Running | Status::Idle) => return,
            Err(error) => (GoalPhase::Aborted, Some(error.to_string())),
        };
        let id = running.goal_id.clone();
        self.finish(&id, phase, reason);
    }

    /// Asks the tree of the goal in hand to pause or go on; `false` if it has no node for that.
    pub(super) fn ask_tree_to_pause(&mut self, id: &str, resume: bool) -> bool {
        let running = self.running.as_mut().filter(|running| running.goal_id == id);
        let Some(running) = running.filter(|running| running.tree.can_pause()) else {
            return false;
        };
        running.tree.ask_to_pause(resume);
        true
    }

    /// Ends a goal: its tree is halted, the robot comes to rest, the end is stored and told.
    pub(super) fn finish(&mut self, id: &str, phase: GoalPhase, reason: Option<String>) {
        if let Some(mut running) = self.running.take_if(|running| running.goal_id == id) {
            if let Err(error) = running.tree.halt(Duration::from_nanos(self.ctx.now.0), &mut self.ctx) {
                tracing::warn!(goal = id, %error, "its tree was halted with an error");
            }
            // Whatever a leaf may have left in force.
            self.ctx.hold();
            self.ctx.motion.clear();
            let (feedback, legs) = (self.ctx.goal.feedback.clone(), std::mem::take(&mut self.ctx.goal.legs));
            self.goals.change(id, |goal| {
                goal.state.feedback = feedback;
                goal.state.legs = legs;
            });
            self.ctx.goal = GoalInHand::default();
            self.tree_ended = true;
        }
        if self.goals.end(id, phase, reason.clone(), self.ctx.now) {
            tracing::info!(goal = id, ?phase, reason, "goal ended");
        }
    }

    fn collect(&mut self, heartbeat: Option<Heartbeat>, mut others: Vec<Effect>) -> Vec<Effect> {
        self.tell_feedback();
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
        effects.append(&mut others);
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

    /// Copies what the leaves have said into the goal: drives are stored, the rest only told.
    fn tell_feedback(&mut self) {
        let Some(running) = &self.running else { return };
        let ctx = &self.ctx;
        if ctx.goal.leg_changes != self.told_legs {
            self.told_legs = ctx.goal.leg_changes;
            let (feedback, legs) = (ctx.goal.feedback.clone(), ctx.goal.legs.clone());
            self.goals.change(&running.goal_id, |goal| {
                goal.state.feedback = feedback;
                goal.state.legs = legs;
            });
        }
        let told = &self.told_feedback;
        let news = &ctx.goal.feedback;
        let changed = (&told.step, told.plans, told.replans, told.recoveries)
            != (&news.step, news.plans, news.replans, news.recoveries);
        if changed || ctx.now >= self.next_status && told != news {
            self.told_feedback = news.clone();
            self.goals.feed_back(&running.goal_id, news);
        }
    }

    /// What the mission does, when it has changed or is due.
    fn status(&mut self) -> Option<MissionStatus> {
        let running = self.running.as_ref();
        let news = (
            running.map(|running| running.goal_id.clone()),
            running.map_or(0, |running| running.tree.revision()),
            self.ctx.lease.epoch(),
        );
        if self.told.as_ref() == Some(&news) && self.ctx.now < self.next_status {
            return None;
        }
        self.told = Some(news);
        self.next_status = self.ctx.now.plus_secs(STATUS_PERIOD);
        let nodes = running.map(|running| running.tree.report()).unwrap_or_default();
        let node = |node: zenav_behaviour_tree::NodeReport| NodeStatus {
            uid: u32::from(node.uid),
            parent: node.parent.map(u32::from),
            name: node.name,
            id: node.id,
            status: node.status.as_str().to_owned(),
            feedback: node.feedback,
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

/// The entries that a goal's tree begins with.
fn fill_blackboard(tree: &mut Tree<Context>, target: &Target, request: &GoalRequest) -> Result<(), String> {
    let board = tree.blackboard_mut();
    let mut set = |key: &str, value: Value| {
        board
            .set(key, value)
            .map_err(|error| format!("blackboard entry `{key}`: {error}"))
    };
    match target {
        Target::Pose(goal) => set("goal", Value::text(goal_text(goal)))?,
        Target::Waypoints(goals) => {
            set("goals", goals_value(goals)?)?;
            if request.tree.is_some() {
                // As Nav2 gives them to its trees: 0 is pending.
                let statuses: Vec<serde_json::Value> = (0..goals.len())
                    .map(|index| serde_json::json!({"waypoint_status": 0, "waypoint_index": index}))
                    .collect();
                set(
                    "waypoint_statuses",
                    Value::data(&statuses).map_err(|error| error.to_string())?,
                )?;
            }
        }
        Target::Tree => {}
    }
    for (key, value) in &request.blackboard {
        if let Some(value) = Value::from_json(value) {
            set(key, value)?;
        }
    }
    Ok(())
}
