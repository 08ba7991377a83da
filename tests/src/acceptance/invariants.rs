//! What is true of goals and of a robot, whatever becomes of its orchestrators? Checked on what anybody can hear: no goal lost, none ended twice,
//! none driven after its end, no motion begun without a live lease.

use std::collections::BTreeMap;
use std::time::Duration;

use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};
use zenav_protocol::bus::{Bus, Subscription};
use zenav_protocol::messages::*;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use crate::deployment::ROBOT;
use crate::observer::is_rest;

/// Wall time for the last goals to end once nothing happens to anybody any more.
const PATIENCE: Duration = Duration::from_secs(180);
/// Wall time in which a goal is acknowledged, with orchestrators that are killed again and again.
const ACKNOWLEDGED: Duration = Duration::from_secs(60);
/// Goals in hand and waiting at a time.
const OUTSTANDING: usize = 3;
/// A plan that was written when its goal ended may still be on its way, s.
const ON_ITS_WAY: f64 = 0.3;

/// What was found.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Orchestrators killed.
    pub kills: usize,
    /// Orchestrators held for a time and let go on.
    pub pauses: usize,
    /// Wall time from a leader's death, or pause, until another mission led, s.
    pub takeovers: Vec<f64>,
    /// Goals acknowledged.
    pub goals: usize,
    /// How many ended how.
    pub ends: BTreeMap<String, usize>,
    /// Motions that began.
    pub motions: usize,
    /// What should not have been.
    pub faults: Vec<String>,
}

/// Everything that is heard of the robot and its goals.
#[derive(Debug)]
pub struct Invariants {
    goals: Subscription<GoalState>,
    states: Subscription<EdgeState>,
    plans: Subscription<Plan>,
    /// End and its time of each goal that has ended.
    ended: BTreeMap<String, (GoalPhase, Option<Stamp>)>,
    last: Option<EdgeState>,
    /// What was found so far.
    pub findings: Findings,
}

impl Invariants {
    /// Listens from now on.
    ///
    /// # Errors
    /// When the bus is closed.
    pub fn new(bus: &Bus) -> Result<Self, String> {
        let robot = &[ROBOT];
        let all = |error: zenav_protocol::bus::BusError| error.to_string();
        Ok(Self {
            goals: bus.subscribe(&topics::GOAL_STATE, &[ROBOT, "*"], 65536).map_err(all)?,
            states: bus.subscribe(&topics::STATE, robot, 65536).map_err(all)?,
            plans: bus.subscribe(&topics::PLAN, robot, 65536).map_err(all)?,
            ended: BTreeMap::new(),
            last: None,
            findings: Findings::default(),
        })
    }

    /// Takes in what was heard since.
    pub fn listen(&mut self) {
        while let Some(goal) = self.goals.try_next() {
            self.goal(&goal.message);
        }
        while let Some(plan) = self.plans.try_next() {
            self.plan(&plan.message);
        }
        while let Some(state) = self.states.try_next() {
            self.state(state.message);
        }
    }

    fn goal(&mut self, goal: &GoalState) {
        let end = (goal.state, goal.ended);
        match self.ended.get(&goal.id) {
            Some(known) if *known != end => {
                let fault = format!("{} ended as {known:?}, then was {end:?}", goal.id);
                self.findings.faults.push(fault);
            }
            None if goal.state.is_end() => {
                self.ended.insert(goal.id.clone(), end);
            }
            _ => {}
        }
    }

    fn plan(&mut self, plan: &Plan) {
        if let Some((_, Some(ended))) = self.ended.get(&plan.goal_id)
            && plan.based_on.stamp.secs_since(*ended) > ON_ITS_WAY
        {
            let fault = format!("a plan for {} was written after its end", plan.goal_id);
            self.findings.faults.push(fault);
        }
    }

    fn state(&mut self, state: EdgeState) {
        let rested = self.last.as_ref().is_none_or(|last| is_rest(last.velocity));
        if rested && !is_rest(state.velocity) {
            self.findings.motions += 1;
            let before = self.last.as_ref().is_some_and(|last| last.lease.live);
            if !(state.lease.live || before) {
                let fault = format!("a motion began without a live lease at {} s", state.stamp.as_secs());
                self.findings.faults.push(fault);
            }
        }
        if let (Mode::Follow, Some(plan)) = (state.mode, &state.plan)
            && let Some((_, Some(ended))) = self.ended.get(&plan.goal_id)
            && state.stamp.secs_since(*ended) > 2.0
            && !is_rest(state.velocity)
        {
            let fault = format!("the robot drives for {} after its end", plan.goal_id);
            self.findings.faults.push(fault);
        }
        self.last = Some(state);
    }

    /// Whether a goal has ended.
    #[must_use]
    pub fn has_ended(&self, id: &str) -> bool {
        self.ended.contains_key(id)
    }

    /// Waits for the ends of goals that were acknowledged, has the leader list them, and says what was found.
    ///
    /// # Errors
    /// When nobody lists the goals.
    pub async fn finish(mut self, bus: &Bus, acknowledged: &[String]) -> Result<Findings, String> {
        let deadline = Instant::now() + PATIENCE;
        while Instant::now() < deadline && acknowledged.iter().any(|id| !self.has_ended(id)) {
            self.listen();
            sleep(Duration::from_millis(50)).await;
        }
        let all = GoalsRequest {
            limit: Some(acknowledged.len()),
            ..GoalsRequest::default()
        };
        let listed: GoalsReply = bus
            .ask(&topics::GOALS, &[ROBOT], &all, ACKNOWLEDGED)
            .await
            .map_err(|error| error.to_string())?;
        self.listen();
        let mut findings = self.findings;
        findings.goals = acknowledged.len();
        for id in acknowledged {
            let entries: Vec<&GoalState> = listed.goals.iter().filter(|goal| goal.id == *id).collect();
            match entries[..] {
                [goal] if goal.state.is_end() => *findings.ends.entry(format!("{:?}", goal.state)).or_default() += 1,
                [goal] => findings.faults.push(format!("{id} has not ended: {:?}", goal.state)),
                [] => findings.faults.push(format!("{id} was acknowledged and is lost")),
                _ => findings.faults.push(format!("{id} is listed {} times", entries.len())),
            }
        }
        Ok(findings)
    }
}

/// Keeps a few goals outstanding, each submitted until it is acknowledged, always by the same id.
#[derive(Debug, Default)]
pub struct Client {
    /// Acknowledged, in order.
    pub acknowledged: Vec<String>,
    submitting: Option<JoinHandle<Result<String, String>>>,
    number: usize,
}

impl Client {
    /// Submits a goal somewhere in the corridor if few are outstanding.
    ///
    /// # Errors
    /// When one is not taken in time.
    pub async fn keep_going(&mut self, bus: &Bus, witness: &Invariants, random: &mut Pcg64Mcg) -> Result<(), String> {
        if let Some(task) = self.submitting.take_if(|task| task.is_finished()) {
            self.acknowledged.push(task.await.map_err(|error| error.to_string())??);
        }
        let outstanding = self.acknowledged.iter().filter(|id| !witness.has_ended(id)).count();
        if self.submitting.is_none() && outstanding < OUTSTANDING {
            self.number += 1;
            let x = random.random_range(1.0..14.0);
            let (bus, id) = (bus.clone(), format!("goal{}", self.number));
            self.submitting = Some(tokio::spawn(submit(bus, id, x)));
        }
        Ok(())
    }

    /// Waits for the last acknowledgement.
    ///
    /// # Errors
    /// When it does not come in time.
    pub async fn rest(&mut self) -> Result<(), String> {
        if let Some(task) = self.submitting.take() {
            self.acknowledged.push(task.await.map_err(|error| error.to_string())??);
        }
        Ok(())
    }
}

/// Submits a goal until it is acknowledged, always by the same id.
async fn submit(bus: Bus, id: String, x: f64) -> Result<String, String> {
    let request = GoalRequest {
        id: Some(id.clone()),
        x: Some(x),
        y: Some(0.0),
        ..GoalRequest::default()
    };
    let reply: Result<GoalReply, _> = bus.ask(&topics::GOAL, &[ROBOT], &request, ACKNOWLEDGED).await;
    match reply {
        Ok(_) => Ok(id),
        Err(error) => Err(format!("{id} was not taken: {error}")),
    }
}
