//! Requests. How are clients answered? Goals are accepted, rejected, cancelled, paused: persisted first, then answered.

use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    GoalPhase, GoalReply, GoalRequest, GoalsReply, InfoReply, InfoRequest, JoinReply, JoinRequest, MoveGoalRequest,
    OnBusy, Refusal,
};
use zenav_protocol::topics::{MissionReply, MissionRequest};

use super::goal_validation;
use super::goals::goal_reply;
use super::orchestrator::Mission;

/// Longest request id, bytes.
const LONGEST_ID: usize = 128;

impl Mission {
    /// Answers one request. A new ask of the mission is an arm here.
    pub(super) fn serve(&mut self, request: MissionRequest) -> Result<MissionReply, Refusal> {
        if self.ctx.lease.stands_by() && !matches!(request, MissionRequest::Info(_)) {
            return Err(Refusal::NotLeader);
        }
        match request {
            MissionRequest::Goal(request) => self.submit(request).map(MissionReply::Goal),
            MissionRequest::Cancel(request) => {
                let id = request.request_id.clone();
                self.once(id, |mission| mission.cancel(request.id))
                    .map(MissionReply::Cancel)
            }
            MissionRequest::Pause(request) => {
                let id = request.request_id.clone();
                self.once(id, |mission| mission.pause(request.id, request.resume))
                    .map(MissionReply::Pause)
            }
            MissionRequest::MoveGoal(request) => {
                let id = request.request_id.clone();
                self.once(id, |mission| mission.move_goal(request))
                    .map(MissionReply::MoveGoal)
            }
            MissionRequest::Goals(request) => {
                let now = Some(self.ctx.now);
                let listed = self.goals.list(&request)?;
                Ok(MissionReply::Goals(GoalsReply { now, ..listed }))
            }
            MissionRequest::Join(request) => self.join(request).map(MissionReply::Join),
            MissionRequest::Info(InfoRequest {}) => Ok(MissionReply::Info(InfoReply {
                component: "mission".to_owned(),
                version: env!("CARGO_PKG_VERSION").to_owned(),
                schema: SCHEMA_VERSION,
                robot: self.ctx.config.robot.to_string(),
                store: self.store.clone(),
                leads: self.ctx.lease.claims(),
                ..InfoReply::default()
            })),
        }
    }

    /// Idempotency: a repeated request gets its first answer. Refusals are not remembered.
    fn once(
        &mut self,
        request_id: Option<String>,
        act: impl FnOnce(&mut Self) -> Result<GoalReply, Refusal>,
    ) -> Result<GoalReply, Refusal> {
        let Some(request_id) = request_id else { return act(self) };
        if request_id.is_empty() || request_id.len() > LONGEST_ID {
            return Err(Refusal::bad_request(format!(
                "`request_id`: expected 1 to {LONGEST_ID} bytes"
            )));
        }
        if let Some(first) = self.goals.answered(&request_id) {
            return Ok(first.clone());
        }
        let answer = act(self)?;
        self.goals.keep_answer(request_id, answer.clone());
        Ok(answer)
    }

    fn submit(&mut self, mut request: GoalRequest) -> Result<GoalReply, Refusal> {
        if let Some(known) = self.goals.resubmitted(&request) {
            return known;
        }
        let target = goal_validation::target(&request, &self.ctx)?;
        let tolerance = request.tolerance.unwrap_or(self.ctx.config.settings.tolerance);
        goal_validation::reachable(&target, tolerance, &mut self.ctx)?;
        let busy = self
            .goals
            .active()
            .or_else(|| self.goals.next())
            .map(|goal| goal.state.id.clone());
        if let (OnBusy::Reject, Some(other)) = (request.on_busy, &busy) {
            return Err(Refusal::rejected(format!("busy with goal {other}")));
        }
        if self.goals.is_full() {
            return Err(Refusal::rejected(format!(
                "the queue is full: {} goals",
                self.goals.queued()
            )));
        }
        let id = request
            .id
            .get_or_insert_with(|| {
                // Distinct from the ids made by other missions of the robot.
                let store = self.store.as_ref().map_or(String::new(), |store| format!("{store}-"));
                let made = (self.goals.next_sequence()..)
                    .map(|sequence| format!("goal-{store}{}-{sequence}", self.incarnation))
                    .find(|id| self.goals.get(id).is_none());
                made.unwrap_or_default()
            })
            .clone();
        let urgent = request.on_busy == OnBusy::Preempt;
        if urgent && let Some(active) = self.goals.active().map(|goal| goal.state.id.clone()) {
            self.finish(&active, GoalPhase::Canceled, Some(format!("preempted by goal {id}")));
        }
        let robot = self.ctx.config.robot.to_string();
        self.goals.accept(&robot, id.clone(), request, urgent, self.ctx.now);
        Ok(GoalReply {
            robot: None,
            id,
            state: GoalPhase::Accepted,
            reason: None,
        })
    }

    /// Takes over the goals that a joining mission accepted before the robot had a leader: they were acknowledged, so they are not
    /// validated again.
    fn join(&mut self, request: JoinRequest) -> Result<JoinReply, Refusal> {
        let leader = self.store.clone().filter(|_| self.ctx.lease.term().is_some());
        let leader = leader.ok_or(Refusal::NotLeader)?;
        let robot = self.ctx.config.robot.to_string();
        let proper = |name: &String| Id::new(name.clone()).map_err(|error| Refusal::bad_request(error.to_string()));
        proper(&request.store)?;
        for id in request.goals.iter().filter_map(|goal| goal.id.as_ref()) {
            proper(id)?;
        }
        for goal in request.goals {
            // They were acknowledged: even a full queue takes all of them.
            if let Some(id) = goal.id.clone().filter(|id| self.goals.get(id).is_none()) {
                self.goals.accept(&robot, id, goal, false, self.ctx.now);
            }
        }
        Ok(JoinReply { leader })
    }

    fn cancel(&mut self, id: Option<String>) -> Result<GoalReply, Refusal> {
        let id = self.named(id)?;
        self.finish(&id, GoalPhase::Canceled, None);
        self.state_of(&id)
    }

    fn pause(&mut self, id: Option<String>, resume: bool) -> Result<GoalReply, Refusal> {
        let id = self.named(id)?;
        let phase = self.state_of(&id)?.state;
        let now = self.ctx.now;
        match (phase, resume) {
            (GoalPhase::Active, false) if self.ask_tree_to_pause(&id, false) => {
                self.goals.change(&id, |goal| goal.state.state = GoalPhase::Paused);
            }
            (GoalPhase::Active, false) => {
                self.ctx.hold();
                self.ctx.hold_up_last();
                self.goals.change(&id, |goal| {
                    goal.state.state = GoalPhase::Paused;
                    goal.paused_since = Some(now);
                });
            }
            (GoalPhase::Paused, true) if !self.is_held(&id) => {
                if self.running.is_none() {
                    return Err(Refusal::Busy {
                        reason: format!("the tree of goal {id} is not there yet"),
                    });
                }
                if !self.ask_tree_to_pause(&id, true) {
                    return Err(Refusal::rejected(format!(
                        "goal {id}: its tree does not take the request to go on; `goal cancel` ends it"
                    )));
                }
                self.goals.change(&id, |goal| goal.state.state = GoalPhase::Active);
            }
            (GoalPhase::Paused, true) => self.goals.change(&id, |goal| {
                goal.state.state = GoalPhase::Active;
                goal.paused_secs += goal
                    .paused_since
                    .take()
                    .map_or(0.0, |since| now.since(since).as_secs_f64());
            }),
            (GoalPhase::Paused, false) | (GoalPhase::Active, true) => {}
            (phase, resume) => {
                let expected = match resume {
                    true => "only a paused goal can be resumed",
                    false => "only an active goal can be paused",
                };
                return Err(Refusal::rejected(format!("goal {id} is {phase:?}: {expected}")));
            }
        }
        self.state_of(&id)
    }

    /// Whether a paused goal's tree is not ticked; otherwise a node of the tree pauses it.
    fn is_held(&self, id: &str) -> bool {
        self.goals.get(id).is_some_and(|goal| goal.paused_since.is_some())
    }

    fn move_goal(&mut self, request: MoveGoalRequest) -> Result<GoalReply, Refusal> {
        let id = self.named(Some(request.id))?;
        let before = request.before.map(|before| self.named(Some(before))).transpose()?;
        self.goals.move_before(&id, before.as_deref())?;
        self.state_of(&id)
    }

    /// The goal with this id, or the active one.
    fn named(&self, id: Option<String>) -> Result<String, Refusal> {
        let short = |id: &str| id.chars().take(80).collect::<String>();
        match id {
            Some(id) if self.goals.get(&id).is_some() => Ok(id),
            Some(id) => Err(Refusal::NotFound {
                what: format!("goal {}", short(&id)),
            }),
            None => match self.goals.active() {
                Some(goal) => Ok(goal.state.id.clone()),
                None => Err(Refusal::NotFound {
                    what: "an active goal".to_owned(),
                }),
            },
        }
    }

    fn state_of(&self, id: &str) -> Result<GoalReply, Refusal> {
        self.goals
            .get(id)
            .map(|goal| goal_reply(&goal.state))
            .ok_or_else(|| Refusal::NotFound {
                what: format!("goal {id}"),
            })
    }
}
