//! Mission core. What happens in a step? Observe, keep the lease, answer clients, tick the active goal's tree, persist and publish.

use std::time::Duration;

use zenav_protocol::messages::{Blockage, GoalFeedback, GoalPhase, GoalRequest, GoalState, Refusal};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{MissionReply, MissionRequest};

use super::config::MissionConfig;
use super::context::{ActiveGoal, Context};
use super::goal_validation::Target;
use super::goals::GoalTable;
use super::io::{Client, Effect, Inputs};
use super::leaves::{goal_text, goals_value};
use super::publishing::Published;
use super::records::{Restored, RunningTree, StoredGoal};
use super::trees;
use zenav_behaviour_tree::{Status, Tree, Value};

/// One robot's mission. It is pure, so it runs both in a service and in lockstep.
pub struct Mission {
    pub(super) ctx: Context,
    pub(super) goals: GoalTable,
    pub(super) incarnation: u64,
    /// Name of the store that keeps the goals, if any.
    pub(super) store: Option<String>,
    pub(super) standbys: Vec<String>,
    /// The mission's time at the last write of an earlier run.
    written: Stamp,
    /// Offset of the mission's time from the clock, ns.
    ahead: Option<i64>,
    pub(super) running: Option<Running>,
    /// The tree that ran before a restart, until its goal is active again.
    restored_tree: Option<RunningTree>,
    pub(super) replies: Vec<(Client, Result<MissionReply, Refusal>)>,
    pub(super) tree_ended: bool,
    pub(super) published: Published,
}

/// The active goal and its tree.
pub(super) struct Running {
    pub(super) goal_id: String,
    pub(super) name: String,
    pub(super) tree: Tree<Context>,
    /// Revision of the tree in the store.
    pub(super) stored: Option<u64>,
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
    /// A mission that continues where the stored one ended.
    ///
    /// ```
    /// use zenav_mission::{Client, Effect, Inputs, Mission, MissionConfig, Record, Restored};
    /// use zenav_protocol::id::Id;
    /// use zenav_protocol::messages::GoalRequest;
    /// use zenav_protocol::time::Stamp;
    /// use zenav_protocol::topics::MissionRequest;
    ///
    /// let config = MissionConfig::new(Id::robot("tiago")?, "mission-1", "unused.redb".into());
    /// let tree = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Sleep msec="60000"/></BehaviorTree></root>"#;
    /// let goal = MissionRequest::Goal(GoalRequest { tree: Some(tree.into()), ..GoalRequest::default() });
    /// let mut first = Mission::new(config.clone(), Restored::fresh());
    /// let inputs = Inputs { requests: vec![(Client(1), goal)], ..Inputs::default() };
    /// let effects = first.step(Stamp::from_secs(1.0), inputs);
    ///
    /// // What was stored is all that the next run needs.
    /// let Effect::Persist(records) = &effects[0] else { panic!("it is stored first") };
    /// let goals = records.iter().filter_map(|record| match record {
    ///     Record::Goal(goal) => Some((**goal).clone()),
    ///     _ => None,
    /// });
    /// let second = Mission::new(config, Restored { incarnation: 2, goals: goals.collect(), ..Restored::default() });
    /// assert_eq!(second.open_goals().count(), 1);
    /// # Ok::<(), zenav_protocol::id::InvalidId>(())
    /// ```
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
            restored_tree: restored.tree,
            replies: Vec::new(),
            tree_ended: false,
            published: Published::default(),
        }
    }

    /// One step, about twenty times a second and whenever a client asks. The caller carries out the effects in order; the first,
    /// [`Effect::Persist`], must complete before any other begins.
    ///
    /// ```
    /// use zenav_mission::{Client, Effect, Inputs, Mission, MissionConfig, Restored};
    /// use zenav_protocol::messages::{GoalPhase, GoalRequest};
    /// use zenav_protocol::time::Stamp;
    /// use zenav_protocol::topics::MissionRequest;
    /// # use zenav_protocol::id::Id;
    ///
    /// # let config = MissionConfig::new(Id::robot("tiago")?, "mission-1", "unused.redb".into());
    /// let mut mission = Mission::new(config, Restored::fresh());
    /// let tree = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Sleep msec="500"/></BehaviorTree></root>"#;
    /// let goal = GoalRequest { id: Some("rest".into()), tree: Some(tree.into()), ..GoalRequest::default() };
    /// let inputs = Inputs { requests: vec![(Client(7), MissionRequest::Goal(goal))], ..Inputs::default() };
    /// let effects = mission.step(Stamp::from_secs(1.0), inputs);
    /// assert!(matches!(effects[0], Effect::Persist(_)), "the goal is stored before it is acknowledged");
    /// assert!(effects.iter().any(|effect| matches!(effect, Effect::Reply(Client(7), Ok(_)))));
    /// assert_eq!(mission.goal("rest").unwrap().state, GoalPhase::Active);
    /// mission.step(Stamp::from_secs(1.6), Inputs::default());
    /// assert_eq!(mission.goal("rest").unwrap().state, GoalPhase::Succeeded);
    /// # Ok::<(), zenav_protocol::id::InvalidId>(())
    /// ```
    pub fn step(&mut self, now: Stamp, inputs: Inputs) -> Vec<Effect> {
        let now = self.own_time(now);
        let ctx = &mut self.ctx;
        ctx.observe(now, inputs.annotations);
        if let Some(state) = &inputs.state {
            ctx.lease.observe(now, state);
        }
        ctx.motion.observe(now, inputs.state.as_ref(), &inputs.events);
        ctx.robot.hear(now, &inputs.events);
        ctx.robot.observe(now, inputs.state, inputs.pose);
        if let Some(yields) = inputs.yields {
            ctx.robot.observe_yield(now, yields);
        }
        if let Some(said) = inputs.localisation {
            ctx.robot.observe_localisation(now, said);
        }
        if let Some(frame) = inputs.map_frame {
            ctx.frames.observe(frame);
        }
        if let Some(alive) = inputs.mapper_alive {
            ctx.map.observe_mapper(now, alive);
        }
        ctx.map.observe_leader(inputs.mapping_leader, inputs.is_mapping_silent);
        ctx.map.observe(now, inputs.map_info, &inputs.map_patches);
        for (ticket, answer) in inputs.answers {
            ctx.asks.answer(ticket, answer);
        }
        ctx.robot.step(now, &mut ctx.asks);
        ctx.map.step(now, &mut ctx.asks);
        let moved_from = ctx.settle();
        let heartbeat = ctx.lease.step(now, ctx.robot.time(now), &mut ctx.asks);
        if !ctx.lease.leads() {
            return self.stand_by(inputs.requests);
        }
        self.keep_spots(moved_from);
        // Goals of an earlier run become active again before any client asks about them.
        self.activate_next();
        for (client, request) in inputs.requests {
            let reply = self.serve(request);
            self.replies.push((client, reply));
        }
        self.keep_deadlines();
        self.activate_next();
        self.tick();
        self.collect(heartbeat)
    }

    /// Whether the next step with these inputs certainly is brief, well below a millisecond: no goal is open, and nothing has come that takes
    /// long to check, such as a map or a client's request.
    #[must_use]
    pub fn is_brief(&self, inputs: &Inputs) -> bool {
        self.goals.open().next().is_none()
            && inputs.requests.is_empty()
            && inputs.answers.is_empty()
            && inputs.map_patches.is_empty()
            && inputs.map_frame.is_none()
            && inputs.annotations.is_none()
    }

    /// Reports that the last step took until now while heartbeats continued: this mission was busy, not suspended.
    pub fn was_kept_alive(&mut self, now: Stamp) {
        let now = self.own_time(now);
        self.ctx.lease.was_kept_alive(now);
    }

    /// The mission's time is monotonic over restarts and machines, regardless of their clocks; stored stamps use it.
    fn own_time(&mut self, now: Stamp) -> Stamp {
        let written = self.written;
        // A clock that follows the robot's is zero until the robot is heard.
        if now == Stamp::ZERO && self.ahead.is_none() {
            return written;
        }
        let ahead = *self.ahead.get_or_insert_with(|| written.since(now).as_nanos() as i64);
        Stamp(now.0.saturating_add_signed(ahead))
    }

    /// The step of a standby: it requests the lease, and answers clients with `NotLeader`.
    fn stand_by(&mut self, requests: Vec<(Client, MissionRequest)>) -> Vec<Effect> {
        let mut effects = Vec::new();
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

    /// The epoch under which this mission leads; `None` while the robot has not confirmed it.
    #[must_use]
    pub fn term(&self) -> Option<u64> {
        self.ctx.lease.term()
    }

    /// The mission's own time.
    #[must_use]
    pub fn now(&self) -> Stamp {
        self.ctx.now
    }

    /// Why this mission does not hold the lease.
    #[must_use]
    pub fn why_not(&self) -> &str {
        self.ctx.lease.why_not()
    }

    /// Sets which standbys hold everything that this mission acknowledges, and whether other stores may hold it too.
    pub fn share(&mut self, standbys: Vec<String>, shared: bool) {
        self.ctx.lease.share(shared);
        if standbys != self.standbys {
            self.standbys = standbys;
            self.published.status = None;
        }
    }

    /// Shutdown: the robot comes to rest; the next run continues its goals.
    pub fn leave(&mut self) -> Vec<Effect> {
        self.ctx.hold();
        self.collect(None)
    }

    /// The lease's epoch, while this mission commands.
    ///
    /// ```
    /// use zenav_mission::{Answer, Ask, Effect, Inputs, Mission, MissionConfig, Restored};
    /// use zenav_protocol::messages::LeaseReply;
    /// use zenav_protocol::time::Stamp;
    /// # use zenav_protocol::id::Id;
    ///
    /// # let config = MissionConfig::new(Id::robot("tiago")?, "mission-1", "unused.redb".into());
    /// let mut mission = Mission::new(config, Restored::fresh());
    /// mission.step(Stamp::from_secs(1.0), Inputs::default());
    /// assert_eq!((mission.epoch(), mission.why_not()), (None, "the robot has not answered yet"));
    /// // A robot that has not been heard for three seconds is asked all the same.
    /// let effects = mission.step(Stamp::from_secs(4.5), Inputs::default());
    /// let asked = effects.iter().find_map(|effect| match effect {
    ///     Effect::Ask(ticket, Ask::Lease(_)) => Some(*ticket),
    ///     _ => None,
    /// });
    /// let lease = LeaseReply { epoch: 3, ttl_secs: 1.0, boot_id: "boot".into(), round_trip_secs: None };
    /// let answers = vec![(asked.unwrap(), Ok(Answer::Lease(lease)))];
    /// mission.step(Stamp::from_secs(4.6), Inputs { answers, ..Inputs::default() });
    /// assert_eq!(mission.epoch(), Some(3));
    /// # Ok::<(), zenav_protocol::id::InvalidId>(())
    /// ```
    #[must_use]
    pub fn epoch(&self) -> Option<u64> {
        self.ctx.lease.epoch()
    }

    /// A goal by its id.
    #[must_use]
    pub fn goal(&self, id: &str) -> Option<&GoalState> {
        self.goals.get(id).map(|goal| &goal.state)
    }

    /// The phases of all goals that have not ended.
    pub fn open_goals(&self) -> impl Iterator<Item = GoalPhase> {
        self.goals.open().map(|goal| goal.state.state)
    }

    /// Builds the tree of the active goal, or of the next in the queue.
    fn activate_next(&mut self) {
        while self.running.is_none() {
            let Some(goal) = self.goals.active().or_else(|| self.goals.next()).cloned() else {
                return;
            };
            // A goal of an earlier run may name a place added at run time: the place was known once, so it will be announced.
            let place = goal.state.request.place.as_ref();
            if place.is_some_and(|place| !self.ctx.config.places.contains_key(place))
                && goal.state.resolved.is_empty()
                && !self.ctx.knows_places()
            {
                return;
            }
            match self.attach(&goal) {
                Ok(running) => {
                    let now = self.ctx.now;
                    self.goals.change(&goal.state.id, |goal| {
                        if goal.state.state == GoalPhase::Accepted {
                            goal.state.state = GoalPhase::Active;
                        }
                        goal.state.started.get_or_insert(now);
                    });
                    self.ctx.nested_nodes = 0;
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
        let target = self.target(goal).map_err(|refusal| refusal.to_string())?;
        let name = match (&request.tree, &target) {
            (Some(tree), _) => tree,
            (None, Target::Waypoints(_)) => trees::NAVIGATE_THROUGH,
            (None, _) => trees::NAVIGATE,
        };
        let mut tree = trees::build(name).map_err(|error| error.to_string())?;
        let restored_tree = self.restored_tree.take().filter(|left| left.goal_id == *id);
        let resumed = restored_tree.is_some_and(|left| match tree.restore(left.snapshot) {
            Ok(()) => true,
            Err(error) => {
                tracing::warn!(goal = id, %error, "its tree starts from the beginning");
                false
            }
        });
        let mut legs = goal.state.legs.clone();
        if !resumed {
            self.ctx.motion.clear();
            fill_blackboard(&mut tree, &target, request)?;
            tree.forget_pauses();
            for leg in legs.iter_mut().filter(|leg| leg.ended.is_none()) {
                (leg.state, leg.ended) = (GoalPhase::Aborted, Some(self.ctx.now));
            }
        }
        self.ctx.goal = ActiveGoal {
            id: id.clone(),
            tolerance: request.tolerance.unwrap_or(self.ctx.config.settings.tolerance),
            profile: request.profile.unwrap_or(self.ctx.config.settings.profile),
            feedback: goal.state.feedback.clone(),
            legs,
            started: goal.state.started.unwrap_or(self.ctx.now),
            deadline: request.deadline_secs.map(|secs| goal.state.accepted.plus_secs(secs)),
            ..ActiveGoal::default()
        };
        self.published.legs = 0;
        // The last feedback of the previous goal is not feedback of this one.
        self.published.feedback = goal.state.feedback.clone();
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
            let mut reason = format!("missed its deadline of {secs} s");
            let blockage = self.ctx.goal.feedback.blockage.filter(|_| self.ctx.goal.id == id);
            if let Some(Blockage { x, y, since }) = blockage {
                let stood = now.since(since).as_secs();
                reason += &format!(": something that may leave has stood at ({x:.2}, {y:.2}) for {stood} s");
            }
            self.finish(&id, GoalPhase::Aborted, Some(reason));
        }
    }

    /// Ticks the active goal's tree, unless the goal is paused.
    fn tick(&mut self) {
        let Some(running) = &mut self.running else { return };
        let Some(goal) = self.goals.get(&running.goal_id) else {
            return;
        };
        // A tree with a node for pausing decides what continues meanwhile.
        let held = goal.state.state == GoalPhase::Paused && (goal.paused_since.is_some() || !running.tree.can_pause());
        if held || !matches!(goal.state.state, GoalPhase::Active | GoalPhase::Paused) {
            return;
        }
        let time = time_of_tree(self.ctx.now, goal);
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

    /// Asks the active goal's tree to pause or resume; `false` if it has no node for that, or the node does not take the request.
    pub(super) fn ask_tree_to_pause(&mut self, id: &str, resume: bool) -> bool {
        let running = self.running.as_mut().filter(|running| running.goal_id == id);
        let Some(running) = running.filter(|running| running.tree.can_pause()) else {
            return false;
        };
        running.tree.ask_to_pause(resume)
    }

    /// Distance from the robot to the goal's place, m; `None` for a goal without a single place.
    fn final_error(&self, id: &str) -> Option<f64> {
        let Ok(Target::Pose(goal)) = self.target(self.goals.get(id)?) else {
            return None;
        };
        let pose = self.ctx.robot.pose()?;
        Some(pose.distance(&goal.pose()))
    }

    /// Ends a goal: its tree is halted, the robot comes to rest, and the end is persisted and published.
    pub(super) fn finish(&mut self, id: &str, phase: GoalPhase, reason: Option<String>) {
        if let Some(mut running) = self.running.take_if(|running| running.goal_id == id) {
            let time = self
                .goals
                .get(id)
                .map_or(Duration::ZERO, |goal| time_of_tree(self.ctx.now, goal));
            if let Err(error) = running.tree.halt(time, &mut self.ctx) {
                tracing::warn!(goal = id, %error, "its tree was halted with an error");
            }
            // A leaf may have left a plan in force, or a maneuver running.
            self.ctx.hold();
            self.ctx.call_off_last();
            self.ctx.motion.clear();
            let (feedback, legs) = (self.ctx.goal.feedback.clone(), std::mem::take(&mut self.ctx.goal.legs));
            let final_error = self.final_error(id);
            self.goals.change(id, |goal| {
                goal.state.feedback = GoalFeedback {
                    final_error,
                    ..feedback
                };
                goal.state.legs = legs;
            });
            self.ctx.goal = ActiveGoal::default();
            self.tree_ended = true;
        }
        if self.goals.end(id, phase, reason.clone(), self.ctx.now) {
            tracing::debug!(goal = id, ?phase, reason, "goal ended");
        }
    }
}

/// Writes the goal to its tree's blackboard.
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
                // As Nav2 initialises them for its trees: 0 is pending.
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

/// Time of a tree: stands still while its goal is paused.
fn time_of_tree(now: Stamp, goal: &StoredGoal) -> Duration {
    // A store holds whatever another mission wrote.
    let paused = Duration::try_from_secs_f64(goal.paused_secs.max(0.0)).unwrap_or(Duration::MAX);
    Duration::from_nanos(now.0).saturating_sub(paused)
}
