//! Mission. Its disk, and its state while it leads and while it follows.

use std::collections::BTreeMap;

use zenav_mission::{Asks, JournalPosition, JournalVerdict, Leadership, LeaseClient, Membership, judge_entry};
use zenav_protocol::messages::{JournalEntry, JournalWrite};
use zenav_protocol::time::Stamp;

use super::state::Message;
use super::{List, Rule, System, store};
use crate::text::Text;

/// Writes of a batch: a goal, and the mission that ended it; zero for an open goal.
pub type Writes = Vec<(u8, u8)>;

/// A mission's store.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Disk {
    /// Goals, with the mission that ended each; zero for an open goal.
    pub goals: BTreeMap<u8, u8>,
    pub epoch: u64,
    pub shared: bool,
    pub incarnation: u8,
}

impl Disk {
    pub fn record(&mut self, leadership: Leadership) {
        (self.epoch, self.shared) = (leadership.epoch, leadership.shared);
    }
}

/// A mission: a process and its disk.
#[derive(Clone, Debug, PartialEq, Hash)]
pub struct Mission {
    pub disk: Disk,
    pub life: Life,
}

/// State of the process.
#[derive(Clone, Debug, PartialEq, Hash)]
pub enum Life {
    Down,
    Following(Following),
    Leading(Box<Leading>),
}

/// A standby.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Following {
    /// Session of its join, if its position in it is known.
    pub session: Option<u8>,
    pub position: u64,
    /// The robot's record, as last received.
    pub word: Option<List>,
}

/// A mission that leads or asks to.
#[derive(Clone, Debug, PartialEq, Hash)]
pub struct Leading {
    pub client: Text<LeaseClient>,
    pub asks: Text<Asks>,
    pub membership: Membership,
    pub replica: Option<Replica>,
    /// Number of replications begun, over all lives.
    pub feeds: u8,
    /// A write whose effects have not been told, with the tick at which its step began.
    pub write: Option<(u8, Tell)>,
    /// The report that the robot has not answered yet.
    pub reporting: Option<u64>,
    /// Tick of the last step.
    pub stepped: u8,
    /// Tick of the last heartbeat that renewed the lease.
    pub renewed: Option<u8>,
}

/// The message that is told once a write is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Tell {
    /// A goal is accepted.
    Accepted(u8),
    /// A goal was ended by this mission in this life.
    Ended(u8, u8),
}

/// The leader's view of its standby's store.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Replica {
    pub session: u8,
    /// Number of the replication; an answer belongs to the replication that asked.
    pub feed: u8,
    /// Position of the unanswered entry, or of the last one.
    position: u64,
    is_waiting: bool,
    /// Number of the batch that the last entry completes.
    batch: u64,
    /// The rest of the leader's store.
    pieces: Vec<Writes>,
    /// Batches after that.
    batches: Writes,
    newest: u64,
    /// The newest batch that is on the standby's disk.
    pub stored: Option<u64>,
}

impl Replica {
    /// A replication of the whole store, always in two pieces.
    pub fn new(session: u8, feed: u8, goals: &BTreeMap<u8, u8>, batch: u64) -> Self {
        let all: Writes = goals.iter().map(|(goal, end)| (*goal, *end)).collect();
        Self {
            session,
            feed,
            position: 0,
            is_waiting: false,
            batch,
            pieces: vec![Vec::new(), all],
            batches: Vec::new(),
            newest: batch,
            stored: None,
        }
    }

    pub const fn is_waiting(&self) -> bool {
        self.is_waiting
    }

    /// Queues a batch.
    pub fn push(&mut self, batch: u64, writes: &[(u8, u8)]) {
        self.batches.extend(writes);
        self.newest = batch;
    }

    /// The next entry, unless one is unanswered.
    pub fn next(&mut self, from: u8, epoch: u64) -> Option<Message> {
        if self.is_waiting {
            return None;
        }
        let writes = if self.pieces.is_empty() {
            if self.batch == self.newest {
                return None;
            }
            self.batch = self.newest;
            std::mem::take(&mut self.batches)
        } else {
            self.pieces.remove(0)
        };
        self.position += 1;
        self.is_waiting = true;
        Some(Message::Entry {
            from,
            epoch,
            session: self.session,
            feed: self.feed,
            position: self.position,
            writes,
        })
    }

    /// The standby has everything up to a position on its disk.
    pub fn stored(&mut self, position: u64) {
        if self.is_waiting && position == self.position {
            self.is_waiting = false;
            if self.pieces.is_empty() {
                self.stored = Some(self.batch);
            }
        }
    }
}

fn record((goal, end): &(u8, u8)) -> JournalWrite {
    JournalWrite {
        table: "goals".to_owned(),
        key: goal.to_string(),
        value: Some(end.to_string()),
    }
}

impl Leading {
    /// Begins a new life that asks for the lease.
    pub fn begin(own: u8, disk: &mut Disk, now: u8) -> Self {
        disk.incarnation += 1;
        let leadership = Leadership {
            epoch: disk.epoch,
            shared: disk.shared,
        };
        let incarnation = disk.incarnation.into();
        Self {
            client: Text(LeaseClient::new(&store(own), incarnation, Some(store(own)), leadership)),
            asks: Text(Asks::new(incarnation)),
            membership: Membership::new(&store(own), leadership, incarnation),
            replica: None,
            feeds: 16 * disk.incarnation,
            write: None,
            reporting: None,
            stepped: now,
            renewed: None,
        }
    }

    /// Whether neither a write nor a report is pending.
    pub const fn is_idle(&self) -> bool {
        self.write.is_none() && self.reporting.is_none()
    }

    /// Begins a write: stores it on its own disk and sends it to the standby.
    pub fn write(&mut self, disk: &mut Disk, goal: u8, end: u8, tell: Tell) {
        disk.goals.insert(goal, end);
        self.membership.next_batch();
        let batch = self.membership.batch();
        if let Some(replica) = self.replica.as_mut().filter(|_| self.membership.term().is_some()) {
            replica.push(batch, &[(goal, end)]);
        }
        self.write = Some((self.stepped, tell));
    }
}

impl Following {
    /// Processes a journal entry; answers with the newest position on disk, or refuses.
    pub fn take(&mut self, disk: &mut Disk, message: &Message, system: &System) -> Option<Option<u64>> {
        let Message::Entry {
            from,
            epoch,
            session,
            position,
            writes,
            ..
        } = message
        else {
            return None;
        };
        let place = JournalPosition {
            session: self.session.map_or_else(String::new, |session| session.to_string()),
            position: self.position,
        };
        let entry = JournalEntry {
            leader: store(*from),
            epoch: *epoch,
            session: if system.has(Rule::Session) {
                session.to_string()
            } else {
                place.session.clone()
            },
            position: *position,
            now: Stamp::ZERO,
            writes: if !system.has(Rule::StoredOnce) && *position <= self.position {
                Vec::new()
            } else {
                writes.iter().map(record).collect()
            },
        };
        let word = self.word.as_ref().map(List::leader);
        match judge_entry(&entry, word.as_ref(), &place) {
            Ok(JournalVerdict::Known) => Some(Some(self.position)),
            Ok(JournalVerdict::Take { instead }) => {
                if instead {
                    disk.goals.clear();
                }
                disk.goals.extend(writes.iter().copied());
                disk.record(Leadership {
                    epoch: *epoch,
                    shared: disk.shared || system.has(Rule::StandbyShared),
                });
                self.position = entry.position;
                Some(Some(self.position))
            }
            Err(_) => {
                if self.session == Some(*session) {
                    (self.session, self.position) = (None, 0);
                }
                Some(None)
            }
        }
    }
}
