//! Mission trace. Links a plan to the scan it comes from: the newest traced map patch continues into the next motion request, and the
//! answer's trace into the plan.

use std::collections::BTreeMap;

use zenav_mission::{Answer, NoAnswer, Ticket};
use zenav_observability::trace::{self, Context, Span};
use zenav_protocol::messages::MotionReply;

/// Most motion requests traced at once.
const MAX_ASKED: usize = 16;

/// The traces in progress.
#[derive(Debug)]
pub(super) struct MissionTrace {
    part: String,
    patch: Option<Context>,
    asked: BTreeMap<Ticket, Span>,
    answered: Option<Context>,
}

impl MissionTrace {
    pub(super) fn new(robot: &str) -> Self {
        Self {
            part: format!("mission-{robot}"),
            patch: None,
            asked: BTreeMap::new(),
            answered: None,
        }
    }

    /// A map patch has arrived.
    pub(super) fn heard(&mut self, patch: Option<Context>) {
        self.patch = patch.or(self.patch);
    }

    /// A motion request is sent.
    pub(super) fn asked(&mut self, ticket: Ticket) {
        let span = self
            .patch
            .take()
            .and_then(|patch| trace::child(&patch, &self.part, "motion request"));
        if let Some(span) = span
            && self.asked.len() < MAX_ASKED
        {
            self.asked.insert(ticket, span);
        }
    }

    /// Requests have been answered.
    pub(super) fn answers(&mut self, answers: &[(Ticket, Result<Answer, NoAnswer>)]) {
        for (ticket, answer) in answers {
            let Some(mut span) = self.asked.remove(ticket) else {
                continue;
            };
            if let Ok(Answer::Motion(reply)) = answer
                && let MotionReply::Trajectory(reply) = reply.as_ref()
            {
                span = span.with("search_ms", reply.plan.search_ms);
                if let Some(smooth) = &reply.smooth {
                    let took = &smooth.statistics;
                    span = span.with("smoothing_ms", took.corridor_ms + took.geometry_ms + took.timing_ms);
                }
            }
            self.answered = Some(span.context());
            span.end();
        }
    }

    /// A new plan is published. Returns the trace to publish it under.
    pub(super) fn planned(&mut self, goal: &str, trajectory: u64) -> Option<Context> {
        let answered = self.answered.take()?;
        let span = trace::child(&answered, &self.part, "plan published")?
            .with("goal", goal)
            .with("plan", trajectory);
        let context = span.context();
        span.end();
        Some(context)
    }
}
