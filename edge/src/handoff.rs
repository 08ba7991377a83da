//! How do the control thread and the network meet? In two boxes behind short locks: neither ever waits for the other.

use std::collections::{BTreeMap, VecDeque};
use std::mem::take;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::{Notify, oneshot};
use zenav_protocol::messages::Refusal;
use zenav_protocol::time::Stamp;

use crate::control_io::{Answer, Inbox, Outbox, Persisted, Publication, Question, Ticket};

/// Messages of each kind that wait for the next tick; further ones push the oldest out.
const MOST_WAITING: usize = 32;
/// Asks that wait for the next tick; further ones are refused.
const MOST_QUESTIONS: usize = 256;
/// Events that wait to be published; the oldest are lost first, and their numbers tell.
const MOST_EVENTS: usize = 256;

/// Where an answer goes.
type Reply = oneshot::Sender<Result<Answer, Refusal>>;

/// Both boxes.
#[derive(Debug, Default)]
pub struct Handoff {
    inward: Mutex<Inward>,
    outward: Mutex<Outward>,
    published: Notify,
    answered: Notify,
}

#[derive(Debug, Default)]
struct Inward {
    inbox: Inbox,
    tickets: u64,
    waiting: BTreeMap<Ticket, Reply>,
}

#[derive(Debug, Default)]
struct Outward {
    now: Option<Stamp>,
    /// The newest of each kind, in order.
    latest: Vec<Publication>,
    events: VecDeque<Publication>,
    persist: Option<Persisted>,
    answers: Vec<(Reply, Result<Answer, Refusal>)>,
    closed: bool,
}

/// What is to be published now.
#[derive(Debug, Default)]
pub struct Bundle {
    /// The stamp of the newest tick.
    pub now: Option<Stamp>,
    /// Messages.
    pub publications: Vec<Publication>,
}

/// What is to be stored, and then answered.
#[derive(Debug, Default)]
pub struct PersistThenReply {
    /// To be stored first.
    pub persist: Option<Persisted>,
    answers: Vec<(Reply, Result<Answer, Refusal>)>,
}

impl PersistThenReply {
    /// Sends the answers; `unless` something went wrong, which then is the answer to all.
    pub fn send(self, unless: Option<&Refusal>) {
        for (reply, answer) in self.answers {
            // Whoever asked may have given up meanwhile.
            let _ = reply.send(unless.map_or(answer, |refusal| Err(refusal.clone())));
        }
    }
}

impl Handoff {
    fn inward(&self) -> MutexGuard<'_, Inward> {
        self.inward.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn outward(&self) -> MutexGuard<'_, Outward> {
        self.outward.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Network side: puts a message of a topic into the next tick's box.
    pub fn put<T>(&self, message: T, place: fn(&mut Inbox) -> &mut Vec<T>) {
        let mut inward = self.inward();
        let waiting = place(&mut inward.inbox);
        if waiting.len() >= MOST_WAITING {
            waiting.remove(0);
        }
        waiting.push(message);
    }

    /// Network side: asks, and waits for the answer.
    ///
    /// # Errors
    /// The robot's refusal, or that it is too busy, or gone.
    pub async fn ask(&self, question: Question) -> Result<Answer, Refusal> {
        let answer = {
            let mut inward = self.inward();
            if inward.waiting.len() >= MOST_QUESTIONS {
                return Err(Refusal::Busy {
                    reason: format!("{MOST_QUESTIONS} asks wait already"),
                });
            }
            inward.tickets += 1;
            let (ticket, (reply, answer)) = (Ticket(inward.tickets), oneshot::channel());
            inward.waiting.insert(ticket, reply);
            inward.inbox.questions.push((ticket, question));
            answer
        };
        answer.await.unwrap_or_else(|_| {
            Err(Refusal::Internal {
                reason: "the robot is shutting down".to_owned(),
            })
        })
    }

    /// Network side: waits for messages to publish; `None` when there will be no more.
    pub async fn bundle(&self) -> Option<Bundle> {
        loop {
            {
                let mut outward = self.outward();
                if outward.now.is_some() {
                    let mut publications: Vec<_> = outward.events.drain(..).collect();
                    publications.append(&mut outward.latest);
                    return Some(Bundle {
                        now: outward.now.take(),
                        publications,
                    });
                }
                if outward.closed {
                    return None;
                }
            }
            self.published.notified().await;
        }
    }

    /// Network side: waits for something to store or to answer; `None` when there will be no more.
    pub async fn clerking(&self) -> Option<PersistThenReply> {
        loop {
            {
                let mut outward = self.outward();
                if outward.persist.is_some() || !outward.answers.is_empty() {
                    return Some(PersistThenReply {
                        persist: outward.persist.take(),
                        answers: take(&mut outward.answers),
                    });
                }
                if outward.closed {
                    return None;
                }
            }
            self.answered.notified().await;
        }
    }

    /// Control side: what came since the last tick.
    pub fn take_inbox(&self) -> Inbox {
        take(&mut self.inward().inbox)
    }

    /// Control side: what a tick gave.
    pub fn put_outbox(&self, now: Stamp, outbox: Outbox) {
        let replies: Vec<_> = if outbox.answers.is_empty() {
            Vec::new()
        } else {
            let mut inward = self.inward();
            outbox
                .answers
                .into_iter()
                .filter_map(|(ticket, answer)| inward.waiting.remove(&ticket).map(|reply| (reply, answer)))
                .collect()
        };
        let clerking = outbox.persist.is_some() || !replies.is_empty();
        {
            let mut outward = self.outward();
            outward.now = Some(now);
            if outbox.persist.is_some() {
                outward.persist = outbox.persist;
            }
            outward.answers.extend(replies);
            for publication in outbox.publications {
                if matches!(publication, Publication::Event(_)) {
                    if outward.events.len() >= MOST_EVENTS {
                        outward.events.pop_front();
                    }
                    outward.events.push_back(publication);
                } else {
                    outward.latest.retain(|known| !known.is_replaced_by(&publication));
                    outward.latest.push(publication);
                }
            }
        }
        self.published.notify_one();
        if clerking {
            self.answered.notify_one();
        }
    }

    /// Control side: no more ticks. Asks that still wait are refused.
    pub fn close(&self) {
        {
            let mut inward = self.inward();
            inward.waiting.clear();
            inward.inbox = Inbox::default();
        }
        self.outward().closed = true;
        self.published.notify_one();
        self.answered.notify_one();
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::messages::{Battery, Event, EventKind, Heartbeat, InfoRequest};

    #[tokio::test]
    async fn of_each_kind_the_newest_waits_but_of_events_all() {
        let exchange = Handoff::default();
        for number in 1..=3_u64 {
            let battery = Battery {
                stamp: Stamp(number),
                charge: 1.0,
                drawn_j: 0.0,
            };
            let event = Event {
                stamp: Stamp(number),
                boot_id: "b".into(),
                sequence: number,
                kind: EventKind::Started,
            };
            let publications = vec![Publication::Battery(battery), Publication::Event(event)];
            exchange.put_outbox(
                Stamp(number),
                Outbox {
                    publications,
                    ..Outbox::default()
                },
            );
        }
        let bundle = exchange.bundle().await.unwrap();
        assert_eq!((bundle.now, bundle.publications.len()), (Some(Stamp(3)), 4));
        assert!(matches!(bundle.publications.last(), Some(Publication::Battery(battery)) if battery.stamp == Stamp(3)));
    }

    #[test]
    fn a_flood_of_messages_keeps_the_newest() {
        let exchange = Handoff::default();
        for counter in 0..1000 {
            exchange.put(
                Heartbeat {
                    holder: "m".into(),
                    epoch: 1,
                    counter,
                },
                |inbox| &mut inbox.heartbeats,
            );
        }
        let heartbeats = exchange.take_inbox().heartbeats;
        assert_eq!(
            (heartbeats.len(), heartbeats.last().map(|last| last.counter)),
            (MOST_WAITING, Some(999))
        );
    }

    #[tokio::test]
    async fn an_ask_that_nobody_answers_any_more_is_refused() {
        let exchange = std::sync::Arc::new(Handoff::default());
        let asking = tokio::spawn({
            let exchange = std::sync::Arc::clone(&exchange);
            async move { exchange.ask(Question::Info(InfoRequest {})).await }
        });
        tokio::task::yield_now().await;
        exchange.close();
        assert!(matches!(asking.await.unwrap(), Err(Refusal::Internal { .. })));
    }
}
