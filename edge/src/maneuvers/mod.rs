//! Maneuvers (Nav2's behaviors). What can the robot do on request, without a plan? Spin, drive straight (back up), wait, drive to a
//! free place. This file keeps the one that runs and the reports of ended ones: a repeated id starts nothing again.
//!
//! | file | answers |
//! |---|---|
//! | `maneuver` | how does one maneuver begin, continue and end? |
//! | [`mod@free_place`] | which free place is reached soonest, and how? |

pub mod free_place;
mod maneuver;

pub use maneuver::{Maneuver, Step};

use std::collections::VecDeque;

use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{BehaviourReport, BehaviourState, EventKind};
use zenav_protocol::time::Stamp;

use crate::event_log::EventLog;

/// Most executions remembered.
const MEMORY: usize = 64;

/// The running maneuver, and the reports of ended ones.
#[derive(Clone, Debug, Default)]
pub struct Maneuvers {
    running: Option<Maneuver>,
    /// Oldest first; includes the running one.
    reports: VecDeque<BehaviourReport>,
}

impl Maneuvers {
    /// Id of the running maneuver.
    #[must_use]
    pub fn running(&self) -> Option<&str> {
        self.running.as_ref().map(Maneuver::id)
    }

    /// The report of an execution, if there was one of this id.
    #[must_use]
    pub fn report(&self, id: &str) -> Option<&BehaviourReport> {
        self.reports.iter().rev().find(|report| report.id == id)
    }

    /// The report of the newest execution.
    #[must_use]
    pub fn last(&self) -> Option<&BehaviourReport> {
        self.reports.back()
    }

    /// Starts a maneuver; the caller has checked that none runs and the id is new.
    pub fn start(&mut self, maneuver: Maneuver) -> BehaviourReport {
        let report = maneuver.report(BehaviourState::Running, None);
        self.record(report.clone());
        self.running = Some(maneuver);
        report
    }

    /// Records a maneuver that failed before it began.
    pub fn refuse(&mut self, now: Stamp, report: BehaviourReport, events: &mut EventLog) -> BehaviourReport {
        self.record(report.clone());
        events.record(now, EventKind::BehaviourDone { report: report.clone() });
        report
    }

    /// Cancels the running maneuver.
    pub fn cancel(&mut self, now: Stamp, reason: &str, events: &mut EventLog) {
        if let Some(maneuver) = self.running.take() {
            self.end(now, maneuver.report(BehaviourState::Canceled, Some(reason)), events);
        }
    }

    /// One tick of the running maneuver: the wanted twist.
    pub fn step(
        &mut self,
        now: Stamp,
        dt: f64,
        odom_from_base: Pose2,
        velocity: Twist2,
        stopped: bool,
        events: &mut EventLog,
    ) -> Twist2 {
        let Some(maneuver) = &mut self.running else {
            return Twist2::ZERO;
        };
        match maneuver.step(now, dt, odom_from_base, velocity, stopped) {
            Step::Go(twist) => twist,
            Step::Done(report) => {
                self.running = None;
                self.end(now, report, events);
                Twist2::ZERO
            }
        }
    }

    fn end(&mut self, now: Stamp, report: BehaviourReport, events: &mut EventLog) {
        if let Some(known) = self.reports.iter_mut().rev().find(|known| known.id == report.id) {
            *known = report.clone();
        }
        events.record(now, EventKind::BehaviourDone { report });
    }

    fn record(&mut self, report: BehaviourReport) {
        if self.reports.len() == MEMORY {
            self.reports.pop_front();
        }
        self.reports.push_back(report);
    }
}
