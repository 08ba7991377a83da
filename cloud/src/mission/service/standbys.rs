//! How do other stores come to hold what the leader acknowledges, before it does?
//!
//! A mission that joins is handed all that the leader's store holds, then every batch of writes. Once it has caught up the leader has the
//! robot note it, and waits for it from then on. One that does not answer in time is taken off the robot's list first; then the leader goes on
//! without it. So whoever the robot lets lead holds everything that was acknowledged.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, timeout};
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::*;
use zenav_protocol::topics;

use super::super::config::MissionConfig;
use super::super::records::Standing;
use super::super::store::{Store, StoreError};
use super::{End, blocking};

/// A standby that has not stored a batch by then is left behind. Well below the life of a lease, which is not renewed meanwhile.
const PATIENCE: Duration = Duration::from_millis(400);
/// Time for all that a store holds to reach another.
const WHOLE: Duration = Duration::from_secs(10);
/// A standby hears from its leader at least this often.
const KEEP_ALIVE: Duration = Duration::from_millis(400);
/// Time between two tries to have the robot note who has caught up, while nothing waits for it.
const RETRY: Duration = Duration::from_millis(500);
/// How long a batch waits for a robot that does not answer, before this mission begins anew.
const SETTLED: Duration = Duration::from_secs(5);
/// Batches on their way to one standby.
const MAX_BATCHES: usize = 1024;
/// Standbys of one leader.
const MAX_STANDBYS: usize = 7;

/// The standbys of a leader.
pub(super) struct Standbys {
    bus: Bus,
    robot: String,
    holder: String,
    store: Arc<Store>,
    incarnation: u64,
    /// Epoch of the leader's grant, once the robot has said that it leads.
    term: Option<u64>,
    position: u64,
    feeders: BTreeMap<String, Feeder>,
    /// The stores that the robot may have noted, besides the leader's own.
    members: BTreeSet<String>,
    /// Whether the robot is known to have noted exactly these.
    settled: bool,
    /// What this store's file says of whether others may hold newer goals.
    shared: bool,
    asked: u64,
    next_try: Instant,
}

/// What carries batches to one standby.
struct Feeder {
    batches: mpsc::Sender<Arc<JournalEntry>>,
    /// The newest batch that is on its disk; closed when it does not answer.
    stored: watch::Receiver<Option<u64>>,
}

impl Feeder {
    fn is_alive(&self) -> bool {
        self.stored.has_changed().is_ok()
    }
}

impl Standbys {
    /// None yet.
    pub(super) fn new(
        bus: &Bus,
        config: &MissionConfig,
        store: Arc<Store>,
        standing: Standing,
        incarnation: u64,
    ) -> Self {
        Self {
            bus: bus.clone(),
            robot: config.robot.to_string(),
            holder: config.holder.clone(),
            store,
            incarnation,
            term: None,
            position: 0,
            feeders: BTreeMap::new(),
            members: BTreeSet::new(),
            settled: !standing.shared,
            shared: standing.shared,
            asked: 0,
            next_try: Instant::now(),
        }
    }

    /// The leader's own store.
    pub(super) fn store(&self) -> Arc<Store> {
        Arc::clone(&self.store)
    }

    /// Whether any other store may hold all that this leader has acknowledged.
    pub(super) fn are_any(&self) -> bool {
        self.shared
    }

    /// The stores that do for sure.
    pub(super) fn names(&self) -> Vec<String> {
        let members = self.members.iter().filter(|_| self.settled);
        members.cloned().collect()
    }

    /// Takes the robot's word on the epoch under which this mission leads.
    pub(super) async fn lead(&mut self, term: Option<u64>) -> Result<(), StoreError> {
        let Some(epoch) = term.filter(|epoch| self.term != Some(*epoch)) else {
            return Ok(());
        };
        self.term = Some(epoch);
        // With a new grant the robot's list is empty; after one that was only confirmed it may not be.
        self.settled &= self.members.is_empty();
        self.next_try = Instant::now();
        self.stand(self.shared).await
    }

    async fn stand(&mut self, shared: bool) -> Result<(), StoreError> {
        self.shared = shared;
        let standing = Standing {
            epoch: self.term.unwrap_or(0),
            shared,
        };
        let store = self.store();
        blocking(move || store.apply(&[], false, Some(standing))).await?
    }

    /// Begins to hand over to a mission that joins, unless it is at it.
    pub(super) async fn join(&mut self, request: &JoinRequest) -> Result<(), StoreError> {
        let Some(epoch) = self.term else { return Ok(()) };
        let known = self.feeders.get(&request.store).filter(|feeder| feeder.is_alive());
        let fed = known.is_some_and(|feeder| request.follows || feeder.stored.borrow().is_none());
        let full = self.feeders.len() >= MAX_STANDBYS && !self.feeders.contains_key(&request.store);
        if fed || full || request.store == self.store.name() {
            return Ok(());
        }
        let store = self.store();
        let whole = JournalEntry {
            leader: self.store.name().to_owned(),
            epoch,
            position: self.position,
            whole: true,
            writes: blocking(move || store.everything()).await??,
        };
        let (batches, receiver) = mpsc::channel(MAX_BATCHES);
        let (sender, stored) = watch::channel(None);
        let name = [self.robot.clone(), request.store.clone()];
        tokio::spawn(feed(self.bus.clone(), name, Arc::new(whole), receiver, sender));
        tracing::info!(robot = self.robot, standby = request.store, "a standby joins");
        self.feeders.insert(request.store.clone(), Feeder { batches, stored });
        Ok(())
    }

    /// Returns once all that have caught up have stored what was written, or are off the robot's list.
    pub(super) async fn hand_over(&mut self, writes: Vec<JournalWrite>) -> Result<(), End> {
        self.position += 1;
        if let Some(epoch) = self.term {
            let batch = Arc::new(JournalEntry {
                leader: self.store.name().to_owned(),
                epoch,
                position: self.position,
                whole: false,
                writes,
            });
            // One that is too far behind ends.
            self.feeders
                .retain(|_, feeder| feeder.batches.try_send(Arc::clone(&batch)).is_ok());
        }
        let deadline = Instant::now() + PATIENCE;
        let mut late = Vec::new();
        for member in &self.members {
            let stored = match self.feeders.get(member) {
                Some(feeder) => {
                    let mut stored = feeder.stored.clone();
                    let there = stored.wait_for(|stored| *stored >= Some(self.position));
                    let left = deadline.saturating_duration_since(Instant::now());
                    matches!(timeout(left, there).await, Ok(Ok(_)))
                }
                None => false,
            };
            if !stored {
                late.push(member.clone());
            }
        }
        self.leave_behind(&late);
        let end = Instant::now() + SETTLED;
        while !self.settled && self.shared {
            self.settle().await?;
            if Instant::now() > end {
                return Err(End::Deposed);
            }
        }
        Ok(())
    }

    fn leave_behind(&mut self, late: &[String]) {
        for name in late {
            tracing::warn!(
                robot = self.robot,
                standby = name,
                "a standby does not answer: it is left behind"
            );
            self.feeders.remove(name);
            self.members.remove(name);
            self.settled = false;
        }
    }

    /// Has the robot note who has caught up, and who has not any more.
    pub(super) async fn tend(&mut self) -> Result<(), End> {
        let dead = |name: &&String| self.feeders.get(*name).is_none_or(|feeder| !feeder.is_alive());
        let gone: Vec<String> = self.members.iter().filter(dead).cloned().collect();
        self.leave_behind(&gone);
        self.feeders.retain(|_, feeder| feeder.is_alive());
        let caught_up = |feeder: &Feeder| *feeder.stored.borrow() == Some(self.position);
        let new: Vec<String> = self
            .feeders
            .iter()
            .filter(|(name, feeder)| !self.members.contains(*name) && caught_up(feeder))
            .map(|(name, _)| name.clone())
            .collect();
        if !new.is_empty() {
            if !self.shared {
                // On disk before the robot may let another lead.
                self.stand(true).await?;
            }
            self.members.extend(new);
            self.settled = false;
            self.next_try = Instant::now();
        }
        if !self.settled && self.shared && Instant::now() >= self.next_try {
            self.settle().await?;
        }
        Ok(())
    }

    /// Asks the robot once to note who has caught up.
    async fn settle(&mut self) -> Result<(), End> {
        self.next_try = Instant::now() + RETRY;
        let Some(epoch) = self.term else {
            tokio::time::sleep(PATIENCE / 4).await;
            return Ok(());
        };
        self.asked += 1;
        let own = self.store.name().to_owned();
        let request = LeaseRequest {
            store: Some(own.clone()),
            leads: Some(Leader {
                store: own.clone(),
                epoch,
                caught_up: std::iter::once(own).chain(self.members.iter().cloned()).collect(),
            }),
            ..LeaseRequest::new(
                &self.holder,
                LeaseRole::Mission,
                LeaseAction::CaughtUp,
                format!("{}-{epoch}-c{}", self.incarnation, self.asked),
            )
        };
        match self.bus.ask(&topics::LEASE, &[&self.robot], &request, PATIENCE).await {
            Ok(_) => {
                self.settled = true;
                tracing::info!(robot = self.robot, standbys = ?self.members, "the robot knows who has caught up");
                if self.members.is_empty() {
                    self.stand(false).await?;
                }
                Ok(())
            }
            Err(AskError::Refused(_)) => Err(End::Deposed),
            Err(_) => Ok(()),
        }
    }
}

/// Hands batches to one standby until it does not answer in time, or another one takes this one's place.
async fn feed(
    bus: Bus,
    name: [String; 2],
    whole: Arc<JournalEntry>,
    mut batches: mpsc::Receiver<Arc<JournalEntry>>,
    stored: watch::Sender<Option<u64>>,
) {
    let chunks = name.each_ref().map(String::as_str);
    let mut batch = whole;
    loop {
        let patience = if batch.whole { WHOLE } else { PATIENCE };
        let reply = bus.ask(&topics::JOURNAL, &chunks, &*batch, patience).await;
        if !reply.is_ok_and(|reply| reply.position >= batch.position) {
            return;
        }
        stored.send_replace(Some(batch.position));
        batch = tokio::select! {
            next = batches.recv() => match next {
                Some(next) => next,
                None => return,
            },
            () = tokio::time::sleep(KEEP_ALIVE) => Arc::new(JournalEntry {
                whole: false,
                writes: Vec::new(),
                ..(*batch).clone()
            }),
        };
    }
}
