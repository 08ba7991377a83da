//! Which behaviour runs, and how did the ones before end? A repeated id starts nothing again.

use std::collections::VecDeque;

use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{BehaviourReport, BehaviourState, EventKind};
use zenav_protocol::time::Stamp;

use crate::event_log::EventLog;
use crate::maneuvers::{Maneuver, Step};

/// Executions remembered.
const MEMORY: usize = 64;

/// The running behaviour and the record of ended ones.
#[derive(Clone, Debug, Default)]
pub struct Maneuvers {
    running: Option<Maneuver>,
    /// The newest is last; the running one is in it.
    reports: VecDeque<BehaviourReport>,
}

impl Maneuvers {
    /// The id of the one that runs.
    #[must_use]
    pub fn running(&self) -> Option<&str> {
        self.running.as_ref().map(Maneuver::id)
    }

    /// How an execution goes or went, if there was such.
    #[must_use]
    pub fn report(&self, id: &str) -> Option<&BehaviourReport> {
        self.reports.iter().rev().find(|report| report.id == id)
    }

    /// The one that runs or ran last.
    #[must_use]
    pub fn last(&self) -> Option<&BehaviourReport> {
        self.reports.back()
    }

    /// Starts one; the caller has seen to it that none runs and the id is new.
    pub fn start(&mut self, behaviour: Maneuver) -> BehaviourReport {
        let report = behaviour.report(BehaviourState::Running, None);
        self.record(report.clone());
        self.running = Some(behaviour);
        report
    }

    /// Records one that ended before it began.
    pub fn refuse(&mut self, now: Stamp, report: BehaviourReport, journal: &mut EventLog) -> BehaviourReport {
        self.record(report.clone());
        journal.tell(now, EventKind::BehaviourDone { report: report.clone() });
        report
    }

    /// Ends the running one.
    pub fn cancel(&mut self, now: Stamp, reason: &str, journal: &mut EventLog) {
        if let Some(behaviour) = self.running.take() {
            self.end(now, behaviour.report(BehaviourState::Canceled, Some(reason)), journal);
        }
    }

    /// One tick of the running one: the wanted twist.
    pub fn step(
        &mut self,
        now: Stamp,
        dt: f64,
        odom_from_base: Pose2,
        velocity: Twist2,
        stopped: bool,
        journal: &mut EventLog,
    ) -> Twist2 {
        let Some(behaviour) = &mut self.running else {
            return Twist2::ZERO;
        };
        match behaviour.step(now, dt, odom_from_base, velocity, stopped) {
            Step::Go(twist) => twist,
            Step::Done(report) => {
                self.running = None;
                self.end(now, report, journal);
                Twist2::ZERO
            }
        }
    }

    fn end(&mut self, now: Stamp, report: BehaviourReport, journal: &mut EventLog) {
        if let Some(known) = self.reports.iter_mut().rev().find(|known| known.id == report.id) {
            *known = report.clone();
        }
        journal.tell(now, EventKind::BehaviourDone { report });
    }

    fn record(&mut self, report: BehaviourReport) {
        if self.reports.len() == MEMORY {
            self.reports.pop_front();
        }
        self.reports.push_back(report);
    }
}
