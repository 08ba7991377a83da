//! Invariants. Properties of goals and of a robot that hold whatever happens to its missions: no goal is lost, none ends twice, none is
//! driven after its end, no motion begins without a live lease. Checked on public messages only.

use std::collections::BTreeMap;
use std::time::Duration;

use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};
use zenav_protocol::bus::{Bus, BusError, Subscription};
use zenav_protocol::messages::{
    EdgeState, GoalPhase, GoalReply, GoalRequest, GoalState, GoalsReply, GoalsRequest, Mode, Plan,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use crate::deployment::ROBOT;
use crate::observer::is_rest;

/// Wall time for the last goals to end once no more faults are injected.
const PATIENCE: Duration = Duration::from_secs(180);
/// Wall time between two lists of the goals.
const LISTED_EVERY: Duration = Duration::from_secs(1);
/// Time limit until a goal is acknowledged while missions are killed repeatedly, wall time.
const ACKNOWLEDGED: Duration = Duration::from_secs(60);
/// Goals running and queued at a time.
const OUTSTANDING: usize = 3;
/// Time for which a plan may still be in transit when its goal has ended, s.
const UNDER_WAY: f64 = 0.3;
/// Time limit for a robot to brake after its goal has ended, s.
const BRAKED: f64 = 2.0;
/// Fewest goals per fault: with fewer a run proves nothing.
const GOALS_A_FAULT: f64 = 0.25;

/// The results of a run.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Missions killed.
    pub kills: usize,
    /// Missions paused for a time.
    pub pauses: usize,
    /// Wall time from a leader's death, or pause, until another mission led, s.
    pub takeovers: Vec<f64>,
    /// Goals acknowledged.
    pub goals: usize,
    /// Number of ended goals by phase.
    pub ends: BTreeMap<String, usize>,
    /// Motions that began.
    pub motions: usize,
    /// Broken invariants, each with its cause.
    pub violations: Vec<String>,
}

impl Findings {
    /// All reasons why the run fails: violations, goals that did not succeed, and too little driving.
    #[must_use]
    pub fn failures(&self) -> Vec<String> {
        let mut failures = self.violations.clone();
        let succeeded = format!("{:?}", GoalPhase::Succeeded);
        for (end, count) in self.ends.iter().filter(|(end, _)| **end != succeeded) {
            failures.push(format!("{count} goals ended {end}"));
        }
        let faults = (self.kills + self.pauses) as f64;
        if self.goals == 0 || (self.goals as f64) < GOALS_A_FAULT * faults {
            failures.push(format!("only {} goals in {faults} faults", self.goals));
        }
        if 2 * self.motions < self.goals {
            failures.push(format!("only {} motions for {} goals", self.motions, self.goals));
        }
        failures
    }
}

/// Checks the invariants on messages in their order of arrival.
#[derive(Debug, Default)]
pub struct Invariants {
    /// Phase and time of each goal's end.
    ended: BTreeMap<String, (GoalPhase, Option<Stamp>)>,
    last: Option<EdgeState>,
    /// The results so far.
    pub findings: Findings,
}

impl Invariants {
    fn broken(&mut self, how: String) {
        self.findings.violations.push(how);
    }

    /// Checks that a goal ends once.
    pub fn goal(&mut self, goal: &GoalState) {
        let end = (goal.state, goal.ended);
        match self.ended.get(&goal.id) {
            Some(known) if *known != end => {
                let how = format!("{} ended as {known:?}, then was {end:?}", goal.id);
                self.broken(how);
            }
            None if goal.state.is_end() => {
                self.ended.insert(goal.id.clone(), end);
            }
            _ => {}
        }
    }

    /// Checks that no plan is published for a goal that has ended.
    pub fn plan(&mut self, plan: &Plan) {
        if let Some((_, Some(ended))) = self.ended.get(&plan.goal_id)
            && plan.based_on.stamp.secs_since(*ended) > UNDER_WAY
        {
            self.broken(format!("a plan for {} was written after its end", plan.goal_id));
        }
    }

    /// Checks that no motion begins without a live lease, and that the robot does not drive for a goal that has ended.
    pub fn state(&mut self, state: EdgeState) {
        let rested = self.last.as_ref().is_none_or(|last| is_rest(last.velocity));
        if rested && !is_rest(state.velocity) {
            self.findings.motions += 1;
            let before = self.last.as_ref().is_some_and(|last| last.lease.live);
            if !(state.lease.live || before) {
                self.broken(format!(
                    "a motion began without a live lease at {} s",
                    state.stamp.as_secs()
                ));
            }
        }
        if let (Mode::Follow, Some(plan)) = (state.mode, &state.plan)
            && let Some((_, Some(ended))) = self.ended.get(&plan.goal_id)
            && state.stamp.secs_since(*ended) > BRAKED
            && !is_rest(state.velocity)
        {
            self.broken(format!("the robot drives for {} after its end", plan.goal_id));
        }
        self.last = Some(state);
    }

    /// Checks that every acknowledged goal is listed once, and has ended.
    pub fn listed(&mut self, acknowledged: &[String], goals: &[GoalState]) {
        self.findings.goals = acknowledged.len();
        for id in acknowledged {
            let entries: Vec<&GoalState> = goals.iter().filter(|goal| goal.id == *id).collect();
            match entries[..] {
                [goal] if goal.state.is_end() => {
                    *self.findings.ends.entry(format!("{:?}", goal.state)).or_default() += 1;
                }
                [goal] => self.broken(format!("{id} has not ended: {:?}", goal.state)),
                [] => self.broken(format!("{id} was acknowledged and is lost")),
                _ => self.broken(format!("{id} is listed {} times", entries.len())),
            }
        }
    }

    /// Whether a goal has ended.
    #[must_use]
    pub fn has_ended(&self, id: &str) -> bool {
        self.ended.contains_key(id)
    }
}

/// Feeds the invariants from the bus.
#[derive(Debug)]
pub struct Monitor {
    goals: Subscription<GoalState>,
    states: Subscription<EdgeState>,
    plans: Subscription<Plan>,
    /// The checks, with their results.
    pub invariants: Invariants,
}

impl Monitor {
    /// Listens from now on.
    ///
    /// # Errors
    /// When the bus is closed.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        let robot = &[ROBOT];
        Ok(Self {
            goals: bus.subscribe(&topics::GOAL_STATE, &[ROBOT, "*"], 65536)?,
            states: bus.subscribe(&topics::STATE, robot, 65536)?,
            plans: bus.subscribe(&topics::PLAN, robot, 65536)?,
            invariants: Invariants::default(),
        })
    }

    /// Processes the messages that have arrived.
    pub fn listen(&mut self) {
        while let Some(goal) = self.goals.try_next() {
            self.invariants.goal(&goal.message);
        }
        while let Some(plan) = self.plans.try_next() {
            self.invariants.plan(&plan.message);
        }
        while let Some(state) = self.states.try_next() {
            self.invariants.state(state.message);
        }
    }

    /// Waits until all acknowledged goals in the leader's list have ended, and returns the results.
    ///
    /// # Errors
    /// When no mission lists the goals.
    pub async fn finish(mut self, bus: &Bus, acknowledged: &[String]) -> Result<Findings, String> {
        let deadline = Instant::now() + PATIENCE;
        let all = GoalsRequest {
            limit: Some(acknowledged.len()),
            ..GoalsRequest::default()
        };
        let listed = loop {
            let listed: GoalsReply = bus
                .ask(&topics::GOALS, &[ROBOT], &all, ACKNOWLEDGED)
                .await
                .map_err(|error| error.to_string())?;
            self.listen();
            let open = listed.goals.iter().filter(|goal| !goal.state.is_end());
            if open.count() == 0 || Instant::now() > deadline {
                break listed;
            }
            let next = Instant::now() + LISTED_EVERY;
            while Instant::now() < next {
                self.listen();
                sleep(Duration::from_millis(50)).await;
            }
        };
        self.invariants.listed(acknowledged, &listed.goals);
        Ok(self.invariants.findings)
    }
}

/// Keeps a few goals outstanding, and submits each under one id until it is acknowledged.
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
    /// When one is not acknowledged in time.
    pub async fn keep_going(
        &mut self,
        bus: &Bus,
        invariants: &Invariants,
        random: &mut Pcg64Mcg,
    ) -> Result<(), String> {
        if let Some(task) = self.submitting.take_if(|task| task.is_finished()) {
            self.acknowledged.push(task.await.map_err(|error| error.to_string())??);
        }
        let outstanding = self.acknowledged.iter().filter(|id| !invariants.has_ended(id));
        if self.submitting.is_none() && outstanding.count() < OUTSTANDING {
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

/// Submits a goal under one id until it is acknowledged.
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
        Err(error) => Err(format!("{id} was not acknowledged: {error}")),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use serde_json::json;
    use zenav_protocol::messages::PlanStatistics;

    use super::*;

    fn goal(id: &str, phase: &str, ended: Option<f64>) -> GoalState {
        let ended = ended.map(Stamp::from_secs);
        serde_json::from_value(json!({
            "id": id, "robot": ROBOT, "state": phase, "accepted": Stamp(1), "ended": ended, "request": {"x": 1.0, "y": 0.0}
        }))
        .unwrap()
    }

    fn plan(goal: &str, secs: f64) -> Plan {
        serde_json::from_value(json!({
            "goal_id": goal, "epoch": 1, "revision": {"incarnation": 1, "counter": 1}, "trajectory_id": 1,
            "map": {"id": "m", "revision": 1}, "frame": "map", "based_on": {"stamp": Stamp::from_secs(secs), "boot_id": "boot"},
            "valid_for": 5.0, "waypoints": [], "trajectory": [], "statistics": PlanStatistics::default()
        }))
        .unwrap()
    }

    /// A valid run of one goal: it ends once, and no plan is published for it afterwards.
    fn good() -> Invariants {
        let mut invariants = Invariants::default();
        invariants.goal(&goal("a", "Accepted", None));
        invariants.plan(&plan("a", 9.0));
        invariants.goal(&goal("a", "Succeeded", Some(10.0)));
        // A plan in transit, and a late joiner's copy of the end.
        invariants.plan(&plan("a", 10.1));
        invariants.goal(&goal("a", "Succeeded", Some(10.0)));
        invariants.findings.motions = 1;
        invariants
    }

    #[test]
    fn a_run_in_which_every_goal_succeeds_passes() {
        let mut invariants = good();
        invariants.listed(&["a".into()], &[goal("a", "Succeeded", Some(10.0))]);
        assert_eq!(invariants.findings.failures(), Vec::<String>::new());
    }

    #[test]
    fn each_broken_invariant_is_told() {
        type Breaks = fn(&mut Invariants);
        let broken: [(Breaks, &str); 6] = [
            (|is| is.goal(&goal("a", "Succeeded", Some(20.0))), "then was"),
            (|is| is.goal(&goal("a", "Accepted", None)), "then was"),
            (|is| is.plan(&plan("a", 11.0)), "after its end"),
            (|is| is.listed(&["b".into()], &[]), "is lost"),
            (
                |is| is.listed(&["b".into()], &[goal("b", "Accepted", None)]),
                "has not ended",
            ),
            (
                |is| {
                    let twice = [goal("a", "Succeeded", Some(10.0)), goal("a", "Succeeded", Some(10.0))];
                    is.listed(&["a".into()], &twice);
                },
                "listed 2 times",
            ),
        ];
        for (breaks, told) in broken {
            let mut invariants = good();
            breaks(&mut invariants);
            let violations = &invariants.findings.violations;
            assert!(
                violations.len() == 1 && violations[0].contains(told),
                "{told}: {violations:?}"
            );
        }
    }

    #[test]
    fn a_run_without_goals_or_with_aborted_ones_or_without_motion_does_not_pass() {
        assert!(!Findings::default().failures().is_empty(), "nothing was driven");
        let mut aborted = good();
        aborted.goal(&goal("b", "Aborted", Some(12.0)));
        let ends = [goal("a", "Succeeded", Some(10.0)), goal("b", "Aborted", Some(12.0))];
        aborted.listed(&["a".into(), "b".into()], &ends);
        assert_eq!(aborted.findings.failures(), ["1 goals ended Aborted"]);
        let mut few = good();
        few.listed(&["a".into()], &ends);
        few.findings.kills = 100;
        assert_eq!(few.findings.failures(), ["only 1 goals in 100 faults"]);
        few.findings.kills = 1;
        few.findings.motions = 0;
        assert_eq!(few.findings.failures(), ["only 0 motions for 1 goals"]);
    }
}
