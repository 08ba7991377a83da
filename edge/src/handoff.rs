//! Thread hand-off. How do the control thread and the network exchange messages? Through two bounded boxes behind short locks: neither
//! ever waits for the other.

use std::collections::{BTreeMap, VecDeque};
use std::mem::take;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::{Notify, oneshot};
use zenav_protocol::messages::Refusal;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{EdgeReply, EdgeRequest};

use crate::control_io::{Inbox, Outbox, Persisted, Publication, Ticket};

/// Messages of each topic that wait for the next tick; a further one drops the oldest.
const MOST_WAITING: usize = 32;
/// Requests that wait for their reply; further ones are refused.
const MOST_REQUESTS: usize = 256;
/// Events that wait to be published; the oldest is dropped first, which the sequence numbers show.
const MOST_EVENTS: usize = 256;

/// Where a reply goes.
type Reply = oneshot::Sender<Result<EdgeReply, Refusal>>;

/// The two boxes.
#[derive(Debug, Default)]
pub struct Handoff {
    inward: Mutex<Inward>,
    outward: Mutex<Outward>,
    published: Notify,
    replied: Notify,
}

#[derive(Debug, Default)]
struct Inward {
    inbox: Inbox,
    tickets: u64,
    not_stored: Option<String>,
    waiting: BTreeMap<Ticket, Reply>,
}

#[derive(Debug, Default)]
struct Outward {
    now: Option<Stamp>,
    /// The newest of each kind, in order.
    latest: Vec<Publication>,
    events: VecDeque<Publication>,
    persist: Option<Persisted>,
    replies: Vec<(Reply, Result<EdgeReply, Refusal>)>,
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

/// State to persist, and the replies that wait for it.
#[derive(Debug, Default)]
pub struct PersistThenReply {
    /// Persisted first.
    pub persist: Option<Persisted>,
    replies: Vec<(Reply, Result<EdgeReply, Refusal>)>,
}

impl PersistThenReply {
    /// Sends the replies. After a failure (`unless`), a reply that grants the lease or names the leader is replaced by that refusal: an
    /// epoch must not be granted twice, nor a leader be forgotten. A stop has taken effect all the same, and its reply says so.
    pub fn send(self, unless: Option<&Refusal>) {
        for (reply, answer) in self.replies {
            let answer = match (answer, unless) {
                (Ok(EdgeReply::Lease(_)) | Err(Refusal::Held { leader: Some(_), .. }), Some(refusal)) => {
                    Err(refusal.clone())
                }
                (answer, _) => answer,
            };
            // The caller may have given up meanwhile.
            let _ = reply.send(answer);
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

    /// Network side: hands a request to the robot and waits for the reply.
    ///
    /// # Errors
    /// The robot's refusal, or that it is too busy or shutting down.
    pub async fn ask(&self, request: EdgeRequest) -> Result<EdgeReply, Refusal> {
        let answer = {
            let mut inward = self.inward();
            if inward.waiting.len() >= MOST_REQUESTS {
                return Err(Refusal::Busy {
                    reason: format!("{MOST_REQUESTS} requests wait already"),
                });
            }
            inward.tickets += 1;
            let (ticket, (reply, answer)) = (Ticket(inward.tickets), oneshot::channel());
            inward.waiting.insert(ticket, reply);
            inward.inbox.requests.push((ticket, request));
            answer
        };
        answer.await.unwrap_or_else(|_| {
            Err(Refusal::Internal {
                reason: "the robot is shutting down".to_owned(),
            })
        })
    }

    /// Network side: waits for messages to publish; `None` once the control thread has ended.
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

    /// Network side: waits for state to persist or replies to send; `None` once the control thread has ended.
    pub async fn next_reply(&self) -> Option<PersistThenReply> {
        loop {
            {
                let mut outward = self.outward();
                if outward.persist.is_some() || !outward.replies.is_empty() {
                    return Some(PersistThenReply {
                        persist: outward.persist.take(),
                        replies: take(&mut outward.replies),
                    });
                }
                if outward.closed {
                    return None;
                }
            }
            self.replied.notified().await;
        }
    }

    /// Network side: notes why the newest state is not stored, or that it is.
    pub fn set_not_stored(&self, why: Option<String>) {
        self.inward().not_stored = why;
    }

    /// Control side: takes what arrived since the last tick.
    pub fn take_inbox(&self) -> Inbox {
        let mut inward = self.inward();
        Inbox {
            not_stored: inward.not_stored.clone(),
            ..take(&mut inward.inbox)
        }
    }

    /// Control side: hands over the output of a tick.
    pub fn put_outbox(&self, now: Stamp, outbox: Outbox) {
        let replies: Vec<_> = if outbox.replies.is_empty() {
            Vec::new()
        } else {
            let mut inward = self.inward();
            outbox
                .replies
                .into_iter()
                .filter_map(|(ticket, answer)| inward.waiting.remove(&ticket).map(|reply| (reply, answer)))
                .collect()
        };
        let has_reply = outbox.persist.is_some() || !replies.is_empty();
        {
            let mut outward = self.outward();
            outward.now = Some(now);
            if outbox.persist.is_some() {
                outward.persist = outbox.persist;
            }
            outward.replies.extend(replies);
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
        if has_reply {
            self.replied.notify_one();
        }
    }

    /// Control side: there are no more ticks. Requests that still wait are refused.
    pub fn close(&self) {
        {
            let mut inward = self.inward();
            inward.waiting.clear();
            inward.inbox = Inbox::default();
        }
        self.outward().closed = true;
        self.published.notify_one();
        self.replied.notify_one();
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::messages::{Battery, Event, EventKind, Heartbeat, InfoRequest, Leader, LeaseRole};

    #[tokio::test]
    async fn the_newest_message_of_each_kind_and_every_event_waits() {
        let handoff = Handoff::default();
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
            handoff.put_outbox(
                Stamp(number),
                Outbox {
                    publications,
                    ..Outbox::default()
                },
            );
        }
        let bundle = handoff.bundle().await.unwrap();
        assert_eq!((bundle.now, bundle.publications.len()), (Some(Stamp(3)), 4));
        assert!(matches!(bundle.publications.last(), Some(Publication::Battery(battery)) if battery.stamp == Stamp(3)));
    }

    #[test]
    fn a_flood_of_messages_keeps_the_newest() {
        let handoff = Handoff::default();
        for counter in 0..1000 {
            handoff.put(
                Heartbeat {
                    holder: "m".into(),
                    epoch: 1,
                    counter,
                    echo: None,
                },
                |inbox| &mut inbox.heartbeats,
            );
        }
        let heartbeats = handoff.take_inbox().heartbeats;
        assert_eq!(
            (heartbeats.len(), heartbeats.last().map(|last| last.counter)),
            (MOST_WAITING, Some(999))
        );
    }

    #[tokio::test]
    async fn who_would_lead_is_not_told_so_where_it_cannot_be_stored() {
        let held = |leader: Option<&str>| Refusal::Held {
            holder: "anna".into(),
            role: LeaseRole::Operator,
            epoch: 3,
            leader: leader.map(|store| Leader {
                store: store.to_owned(),
                epoch: 3,
                caught_up: Vec::new(),
                revision: 0,
            }),
        };
        for (refusal, is_told) in [(held(None), true), (held(Some("b")), false)] {
            let (reply, answer) = oneshot::channel();
            let waiting = PersistThenReply {
                persist: None,
                replies: vec![(reply, Err(refusal.clone()))],
            };
            let unstored = Refusal::internal("not stored");
            waiting.send(Some(&unstored));
            let expected = if is_told { refusal } else { unstored };
            assert_eq!(answer.await.unwrap().unwrap_err(), expected);
        }
    }

    #[tokio::test]
    async fn a_request_that_waits_at_shutdown_is_refused() {
        let handoff = std::sync::Arc::new(Handoff::default());
        let asking = tokio::spawn({
            let handoff = std::sync::Arc::clone(&handoff);
            async move { handoff.ask(EdgeRequest::Info(InfoRequest {})).await }
        });
        tokio::task::yield_now().await;
        handoff.close();
        assert!(matches!(asking.await.unwrap(), Err(Refusal::Internal { .. })));
    }
}
