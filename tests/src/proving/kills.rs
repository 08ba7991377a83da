//! Is any goal lost when the orchestrator is killed, whenever that is? `kill -9` at random instants of missions, with real processes; what
//! is true of goals and of the robot is checked on what anybody can hear.

use std::collections::BTreeMap;
use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use tokio::time::{Instant, sleep};
use zenav_protocol::bus::{Bus, Subscription};
use zenav_protocol::messages::*;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use crate::deployment::{CORRIDOR, Deployment, ROBOT};
use crate::observer::is_rest;

/// Simulated seconds a second.
const SPEED: f64 = 4.0;
/// Longest life of an orchestrator, s of wall time. A drive takes about three.
const LONGEST_LIFE: f64 = 2.5;
/// Wall time for the last goals to end once nothing is killed any more.
const PATIENCE: Duration = Duration::from_secs(180);
/// Wall time in which a goal is acknowledged, with an orchestrator that is killed again and again.
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
struct Ear {
    goals: Subscription<GoalState>,
    states: Subscription<EdgeState>,
    plans: Subscription<Plan>,
    /// End and its time of each goal that has ended.
    ended: BTreeMap<String, (GoalPhase, Option<Stamp>)>,
    last: Option<EdgeState>,
    findings: Findings,
}

impl Ear {
    fn new(bus: &Bus) -> Result<Self, String> {
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
    fn listen(&mut self) {
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
}

/// Kills the orchestrator of a robot so many times, at instants drawn from the seed, while goals come in; then lets it finish.
///
/// # Errors
/// When the parts cannot be started or joined.
pub async fn run(binary: &str, kills: usize, seed: u64) -> Result<Findings, String> {
    let deployment = Deployment::new(binary, CORRIDOR, SPEED);
    let _router = deployment.start_router();
    let _edge = deployment.start_edge();
    let _others = [
        deployment.start_service("mapping"),
        deployment.start_service("planning"),
    ];
    let bus = deployment.bus().await;
    let mut ear = Ear::new(&bus)?;
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut acknowledged: Vec<String> = Vec::new();
    let mut submitting: Option<tokio::task::JoinHandle<Result<String, String>>> = None;
    let mut mission = deployment.start_service("mission");
    let mut number = 0;
    while ear.findings.kills < kills {
        let end = Instant::now() + Duration::from_secs_f64(random.random_range(0.0..LONGEST_LIFE));
        while Instant::now() < end {
            ear.listen();
            if let Some(task) = submitting.take_if(|task| task.is_finished()) {
                acknowledged.push(task.await.map_err(|error| error.to_string())??);
            }
            let outstanding = acknowledged.iter().filter(|id| !ear.ended.contains_key(*id)).count();
            if submitting.is_none() && outstanding < OUTSTANDING {
                number += 1;
                let x = random.random_range(1.0..14.0);
                let (bus, id) = (bus.clone(), format!("goal{number}"));
                submitting = Some(tokio::spawn(submit(bus, id, x)));
            }
            sleep(Duration::from_millis(20)).await;
        }
        mission.kill();
        ear.findings.kills += 1;
        mission = deployment.start_service("mission");
    }
    if let Some(task) = submitting {
        acknowledged.push(task.await.map_err(|error| error.to_string())??);
    }
    let deadline = Instant::now() + PATIENCE;
    while Instant::now() < deadline && acknowledged.iter().any(|id| !ear.ended.contains_key(id)) {
        ear.listen();
        sleep(Duration::from_millis(50)).await;
    }
    let listed: GoalsReply = bus
        .ask(&topics::GOALS, &[ROBOT], &GoalsRequest::default(), ACKNOWLEDGED)
        .await
        .map_err(|error| error.to_string())?;
    ear.listen();
    let mut findings = ear.findings;
    findings.goals = acknowledged.len();
    for id in &acknowledged {
        let entries: Vec<&GoalState> = listed.goals.iter().filter(|goal| goal.id == *id).collect();
        match entries[..] {
            [goal] if goal.state.is_end() => *findings.ends.entry(format!("{:?}", goal.state)).or_default() += 1,
            [goal] => findings.faults.push(format!("{id} has not ended: {:?}", goal.state)),
            [] => findings.faults.push(format!("{id} was acknowledged and is lost")),
            _ => findings.faults.push(format!("{id} is listed {} times", entries.len())),
        }
    }
    bus.close().await;
    Ok(findings)
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
