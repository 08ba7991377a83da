//! Requests. What has been asked of others, and what did they answer?

use std::collections::BTreeMap;

use zenav_protocol::messages::MotionRequest;

use super::io::{Answer, Ask, NoAnswer, Ticket};
use super::lease::newer;

/// Most pending requests; beyond that the oldest is dropped.
const MAX_ASKS: usize = 256;

/// Pending requests and their answers.
#[derive(Clone, Debug)]
pub struct Asks {
    incarnation: u64,
    count: u64,
    new: Vec<(Ticket, Ask)>,
    waiting: BTreeMap<Ticket, Option<Result<Answer, NoAnswer>>>,
}

impl Asks {
    /// No request is pending.
    #[must_use]
    pub fn new(incarnation: u64) -> Self {
        Self {
            incarnation,
            count: 0,
            new: Vec::new(),
            waiting: BTreeMap::new(),
        }
    }

    /// Sends a request.
    pub fn ask(&mut self, ask: Ask) -> Ticket {
        self.count += 1;
        let ticket = Ticket(newer(self.incarnation, self.count));
        self.waiting.insert(ticket, None);
        if self.waiting.len() > MAX_ASKS {
            self.waiting.pop_first();
        }
        self.new.push((ticket, ask));
        ticket
    }

    /// Sends a request to a motion worker.
    pub(crate) fn ask_motion(&mut self, request: MotionRequest) -> Ticket {
        self.ask(Ask::Motion(Box::new(request)))
    }

    /// Takes an answer; one to an unknown ticket is dropped.
    pub fn answer(&mut self, ticket: Ticket, answer: Result<Answer, NoAnswer>) {
        if let Some(slot) = self.waiting.get_mut(&ticket) {
            *slot = Some(answer);
        }
    }

    /// Takes the answer; `None` while it is pending. A dropped ticket counts as unanswered.
    pub fn take(&mut self, ticket: Ticket) -> Option<Result<Answer, NoAnswer>> {
        match self.waiting.get_mut(&ticket) {
            None => Some(Err(NoAnswer::Silent(
                "the request was dropped: too many are pending".to_owned(),
            ))),
            Some(slot) => {
                let answer = slot.take()?;
                self.waiting.remove(&ticket);
                Some(answer)
            }
        }
    }

    /// Drops a request, if there is one.
    pub fn forget(&mut self, ticket: impl Into<Option<Ticket>>) {
        if let Some(ticket) = ticket.into() {
            self.waiting.remove(&ticket);
        }
    }

    /// Takes the requests to send.
    pub fn take_new(&mut self) -> Vec<(Ticket, Ask)> {
        std::mem::take(&mut self.new)
    }
}
