//! Edge trace. Where does a trace begin, and where does it end? It begins with a published scan, one per second, and ends when a plan that
//! results from it moves the wheels.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use zenav_observability::trace::{self, Context, Span};
use zenav_protocol::messages::{EventKind, Plan, Scan};

/// Time between two traced scans.
const PERIOD: Duration = Duration::from_secs(1);

/// The traces of one robot.
#[derive(Debug)]
pub(crate) struct EdgeTrace {
    part: String,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    last: Option<Instant>,
    /// The newest plan that resulted from a traced scan, until the robot has judged it.
    plan: Option<(u64, Span)>,
}

impl EdgeTrace {
    pub(crate) fn new(robot: &str) -> Self {
        Self {
            part: format!("edge-{robot}"),
            state: Mutex::default(),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins a trace with a scan that is published, if one is due.
    pub(crate) fn scan(&self, scan: &Scan) -> Option<Context> {
        if !trace::is_on() {
            return None;
        }
        let mut state = self.state();
        if state.last.is_some_and(|last| last.elapsed() < PERIOD) {
            return None;
        }
        state.last = Some(Instant::now());
        let span = trace::root(&self.part, "scan published")?.with("stamp", scan.stamp.0);
        let context = span.context();
        span.end();
        Some(context)
    }

    /// A plan has arrived.
    pub(crate) fn plan(&self, plan: &Plan, from: Option<Context>) {
        let span = from.and_then(|from| trace::child(&from, &self.part, "plan to wheels"));
        if let Some(span) = span {
            self.state().plan = Some((plan.trajectory_id, span));
        }
    }

    /// Ends the trace of a plan with the robot's verdict: in the tick of this event it commands the wheels by the plan.
    pub(crate) fn event(&self, event: &EventKind) {
        let (id, verdict) = match event {
            EventKind::PlanAccepted { trajectory_id, .. } => (*trajectory_id, "accepted"),
            EventKind::PlanRejected {
                trajectory_id, reason, ..
            } => (*trajectory_id, reason.as_str()),
            _ => return,
        };
        let plan = self.state().plan.take_if(|(known, _)| *known == id);
        if let Some((_, span)) = plan {
            span.with("plan", id).with("verdict", verdict).end();
        }
    }
}
