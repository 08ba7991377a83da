//! Mission metrics. Durations of goals, steps, writes and plans, and counts of queued, driven and ended goals.

use std::collections::{BTreeMap, VecDeque};

use tokio::time::Instant;
use zenav_mission::{Client, Mission, Record};
use zenav_observability::metrics::{
    GOAL_ACCEPTANCE, GOALS, GOALS_ENDED, MISSION_LEADS, PLAN_ACCEPTANCE, STORE_WRITE, TREE_TICK, WORKERS,
};
use zenav_observability::{Gauge, Histogram};
use zenav_protocol::messages::{Event, EventKind, GoalPhase, Plan};

/// New plans awaiting acceptance; the oldest are dropped.
const MAX_PLANS: usize = 32;

/// Phases of goals that have not ended.
const OPEN: [GoalPhase; 3] = [GoalPhase::Accepted, GoalPhase::Active, GoalPhase::Paused];

/// Records whether a mission leads or stands by. A standby counts neither goals nor workers.
pub(super) fn leads(robot: &str, leads: bool) {
    MISSION_LEADS
        .with_label_values(&[robot])
        .set(f64::from(u8::from(leads)));
    if !leads {
        // Removing a label that was never set fails, which does not matter.
        let _ = WORKERS.remove_label_values(&[robot]);
        for phase in OPEN {
            let _ = GOALS.remove_label_values(&[robot, phase.name()]);
        }
    }
}

/// Counts of a leading mission.
pub(super) struct MissionMetrics {
    robot: String,
    acceptance: Histogram,
    pub(super) tick: Histogram,
    pub(super) write: Histogram,
    plan_acceptance: Histogram,
    workers: Gauge,
    open: [Gauge; 3],
    /// When goals were requested.
    asked: BTreeMap<Client, Instant>,
    /// Published trajectories, and when.
    plans: VecDeque<(u64, Instant)>,
    /// The goal state logged last.
    said: Option<(String, GoalPhase)>,
}

impl MissionMetrics {
    pub(super) fn new(robot: &str) -> Self {
        for state in ["succeeded", "aborted", "canceled", "rejected"] {
            // All end states show from the start.
            let _ = GOALS_ENDED.with_label_values(&[robot, state]);
        }
        Self {
            acceptance: GOAL_ACCEPTANCE.with_label_values(&[robot]),
            tick: TREE_TICK.with_label_values(&[robot]),
            write: STORE_WRITE.with_label_values(&[robot]),
            plan_acceptance: PLAN_ACCEPTANCE.with_label_values(&[robot]),
            workers: WORKERS.with_label_values(&[robot]),
            open: OPEN.map(|phase| GOALS.with_label_values(&[robot, phase.name()])),
            asked: BTreeMap::new(),
            plans: VecDeque::new(),
            said: None,
            robot: robot.to_owned(),
        }
    }

    /// A goal was requested.
    pub(super) fn asked(&mut self, client: Client) {
        self.asked.insert(client, Instant::now());
    }

    /// A client was answered.
    pub(super) fn answered(&mut self, client: Client, is_accepted: bool) {
        if let Some(asked) = self.asked.remove(&client)
            && is_accepted
        {
            self.acceptance.observe(asked.elapsed().as_secs_f64());
        }
    }

    /// Records were stored: logs each change of a goal, counts each end.
    pub(super) fn stored(&mut self, records: &[Record]) {
        for record in records {
            let Record::Goal(goal) = record else { continue };
            let (goal, state) = (&goal.state, goal.state.state.name());
            // Progress is stored, too, but not logged.
            let said = (goal.id.clone(), goal.state);
            if self.said.as_ref() == Some(&said) {
                continue;
            }
            self.said = Some(said);
            tracing::info!(robot = self.robot, goal = goal.id, state, reason = goal.reason, "goal");
            if goal.state.is_end() {
                GOALS_ENDED.with_label_values(&[&self.robot, state]).inc();
            }
        }
    }

    /// Sets the numbers of goals and workers.
    pub(super) fn observe(&self, mission: &Mission, workers: usize) {
        for (phase, gauge) in OPEN.iter().zip(&self.open) {
            gauge.set(mission.open_goals().filter(|open| open == phase).count() as f64);
        }
        self.workers.set(workers as f64);
    }

    /// A plan was published. Returns whether its trajectory is new: a renewal continues a known one.
    pub(super) fn published(&mut self, plan: &Plan) -> bool {
        if self.plans.iter().any(|(known, _)| *known == plan.trajectory_id) {
            return false;
        }
        tracing::debug!(
            robot = self.robot,
            goal = plan.goal_id,
            plan = plan.trajectory_id,
            "plan published"
        );
        if self.plans.len() == MAX_PLANS {
            self.plans.pop_front();
        }
        self.plans.push_back((plan.trajectory_id, Instant::now()));
        true
    }

    /// Takes the robot's events: which plans were accepted.
    pub(super) fn heard(&mut self, events: &[Event]) {
        for event in events {
            if let EventKind::PlanAccepted { trajectory_id, .. } = &event.kind {
                // An event may be reported twice.
                let known = self.plans.iter().position(|(known, _)| known == trajectory_id);
                if let Some((_, published)) = known.and_then(|at| self.plans.remove(at)) {
                    self.plan_acceptance.observe(published.elapsed().as_secs_f64());
                }
            }
        }
    }
}
