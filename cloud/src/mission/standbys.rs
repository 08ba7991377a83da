//! Replication. How do standbys hold what the leader acknowledges, before it does?
//!
//! A standby that joins is sent the leader's whole store, in pieces, then every batch of writes. Once it has caught up, the leader has the
//! robot list it, and waits for it from then on. A standby that does not answer in time is first taken off the robot's list; then the leader
//! continues without it. So every store on the robot's list holds everything that was acknowledged.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, timeout};
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{JoinRequest, JournalWrite, Leader, LeaseAction, LeaseRequest, LeaseRole, Refusal};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::lead::HELD_UP;
use super::replication::{Batch, Replication};
use super::{End, blocking};
use zenav_mission::config::MissionConfig;
use zenav_mission::lease::newer;
use zenav_mission::records::Leadership;
use zenav_mission::store::{Store, StoreError};

/// A standby that has not stored a batch by then is dropped. Well below the TTL of the lease.
pub(super) const PATIENCE: Duration = Duration::from_millis(400);
/// Time between two attempts to update the robot's list, while nothing waits for it.
const RETRY: Duration = Duration::from_millis(500);
/// A dropped standby is not waited for again for the first time, doubled each time it is dropped up to the second; after the second without
/// a drop it starts over.
const DISTRUST: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
/// Batches in flight to one standby.
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
    /// Epoch under which this mission leads, once the robot has said so.
    term: Option<u64>,
    /// The mission's time.
    now: Stamp,
    /// Number of the newest batch of writes.
    batch: u64,
    replicators: BTreeMap<String, Replicator>,
    /// The stores that may be on the robot's list, besides the leader's own.
    members: BTreeSet<String>,
    /// Whether the robot's list is known to be exactly these.
    settled: bool,
    /// What this store's file says of whether others may hold newer goals.
    shared: bool,
    asked: u64,
    next_try: Instant,
    /// Until when one that was left behind is not waited for, and for how long that was.
    distrust: BTreeMap<String, (Instant, Duration)>,
}

/// The task that replicates to one standby.
struct Replicator {
    session: String,
    batches: mpsc::Sender<Arc<Batch>>,
    /// The newest batch that is on its disk; closed when it does not answer.
    stored: watch::Receiver<Option<u64>>,
}

impl Replicator {
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
        leadership: Leadership,
        incarnation: u64,
    ) -> Self {
        Self {
            bus: bus.clone(),
            robot: config.robot.to_string(),
            holder: config.holder.clone(),
            store,
            incarnation,
            term: None,
            now: Stamp::ZERO,
            batch: 0,
            replicators: BTreeMap::new(),
            members: BTreeSet::new(),
            settled: !leadership.shared,
            shared: leadership.shared,
            asked: 0,
            next_try: Instant::now(),
            distrust: BTreeMap::new(),
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

    /// Takes the epoch under which the robot lets this mission lead.
    pub(super) async fn lead(&mut self, term: Option<u64>, now: Stamp) -> Result<(), StoreError> {
        self.now = now;
        let Some(epoch) = term.filter(|epoch| self.term != Some(*epoch)) else {
            return Ok(());
        };
        self.term = Some(epoch);
        // With a new grant the robot's list is empty; where it only said who leads it may not be.
        self.settled &= self.members.is_empty();
        self.next_try = Instant::now();
        // Those who follow are to know the new epoch.
        self.send_to_all(Vec::new());
        self.record_leadership(self.shared).await
    }

    async fn record_leadership(&mut self, shared: bool) -> Result<(), StoreError> {
        self.shared = shared;
        let leadership = Leadership {
            epoch: self.term.unwrap_or(0),
            shared,
        };
        let store = self.store();
        blocking(move || store.apply(&[], false, Some(leadership))).await?
    }

    /// Starts replicating to a standby that joins, unless it already does.
    pub(super) async fn join(&mut self, request: &JoinRequest) -> Result<(), End> {
        let Some(epoch) = self.term else { return Ok(()) };
        let known = self
            .replicators
            .get(&request.store)
            .filter(|replicator| replicator.is_alive());
        let full = self.replicators.len() >= MAX_STANDBYS && !self.replicators.contains_key(&request.store);
        if full
            || request.store == self.store.name()
            || known.is_some_and(|replicator| replicator.session == request.session)
        {
            return Ok(());
        }
        // It begins anew: while it is handed everything it holds nothing whole.
        if self.members.contains(&request.store) {
            self.drop_standbys(std::slice::from_ref(&request.store));
            self.update_list().await?;
            if !self.settled {
                return Ok(());
            }
        }
        let store = self.store();
        let whole = Batch {
            number: self.batch,
            epoch,
            now: self.now,
            writes: blocking(move || store.everything()).await??,
        };
        let (batches, receiver) = mpsc::channel(MAX_BATCHES);
        let (sender, stored) = watch::channel(None);
        let feed = Replication {
            bus: self.bus.clone(),
            robot: self.robot.clone(),
            standby: request.store.clone(),
            leader: self.store.name().to_owned(),
            session: request.session.clone(),
            position: 0,
        };
        tracing::info!(robot = self.robot, standby = request.store, "a standby joins");
        tokio::spawn(feed.run(whole, receiver, sender));
        let replicator = Replicator {
            session: request.session.clone(),
            batches,
            stored,
        };
        self.replicators.insert(request.store.clone(), replicator);
        Ok(())
    }

    fn send_to_all(&mut self, writes: Vec<JournalWrite>) {
        let Some(epoch) = self.term else { return };
        let batch = Arc::new(Batch {
            number: self.batch,
            epoch,
            now: self.now,
            writes,
        });
        // One that is too far behind ends.
        self.replicators
            .retain(|_, replicator| replicator.batches.try_send(Arc::clone(&batch)).is_ok());
    }

    /// Returns once every listed standby has stored the batch, or is off the robot's list.
    pub(super) async fn replicate(&mut self, writes: Vec<JournalWrite>) -> Result<(), End> {
        let begun = Instant::now();
        self.batch += 1;
        self.send_to_all(writes);
        let mut late = Vec::new();
        for member in &self.members {
            let stored = match self.replicators.get(member) {
                Some(replicator) => {
                    let mut stored = replicator.stored.clone();
                    let there = stored.wait_for(|stored| *stored >= Some(self.batch));
                    let left = PATIENCE.saturating_sub(begun.elapsed());
                    matches!(timeout(left, there).await, Ok(Ok(_)))
                }
                None => false,
            };
            if !stored {
                late.push(member.clone());
            }
        }
        self.drop_standbys(&late);
        while !self.settled && self.shared {
            self.update_list().await?;
            if begun.elapsed() > HELD_UP {
                return Err(End::Deposed);
            }
        }
        Ok(())
    }

    fn drop_standbys(&mut self, late: &[String]) {
        for name in late {
            tracing::warn!(robot = self.robot, standby = name, "a standby is dropped");
            self.replicators.remove(name);
            self.members.remove(name);
            self.settled = false;
            let now = Instant::now();
            let again = self.distrust.get(name).filter(|(until, _)| now < *until + DISTRUST.1);
            let time = again.map_or(DISTRUST.0, |(_, time)| (2 * *time).min(DISTRUST.1));
            self.distrust.insert(name.clone(), (now + time, time));
        }
    }

    /// Updates the robot's list: who has caught up, and who has been lost.
    pub(super) async fn maintain(&mut self) -> Result<(), End> {
        let dead = |name: &&String| {
            self.replicators
                .get(*name)
                .is_none_or(|replicator| !replicator.is_alive())
        };
        let gone: Vec<String> = self.members.iter().filter(dead).cloned().collect();
        self.drop_standbys(&gone);
        self.replicators.retain(|_, replicator| replicator.is_alive());
        let trusted = |name: &String| self.distrust.get(name).is_none_or(|(until, _)| Instant::now() > *until);
        let caught_up = |replicator: &Replicator| *replicator.stored.borrow() == Some(self.batch);
        let new: Vec<String> = self
            .replicators
            .iter()
            .filter(|(name, replicator)| !self.members.contains(*name) && caught_up(replicator) && trusted(name))
            .map(|(name, _)| name.clone())
            .collect();
        if !new.is_empty() {
            if !self.shared {
                // On disk before the robot may let another lead.
                self.record_leadership(true).await?;
            }
            self.members.extend(new);
            self.settled = false;
            self.next_try = Instant::now();
        }
        if !self.settled && self.shared && Instant::now() >= self.next_try {
            self.update_list().await?;
        }
        Ok(())
    }

    /// Sends the robot's list once.
    async fn update_list(&mut self) -> Result<(), End> {
        self.next_try = Instant::now() + RETRY;
        let Some(epoch) = self.term else {
            tokio::time::sleep(PATIENCE / 4).await;
            return Ok(());
        };
        self.asked += 1;
        let own = self.store.name().to_owned();
        let revision = newer(self.incarnation, self.asked);
        let request = LeaseRequest {
            store: Some(own.clone()),
            leads: Some(Leader {
                store: own.clone(),
                epoch,
                caught_up: std::iter::once(own).chain(self.members.iter().cloned()).collect(),
                revision,
            }),
            ..LeaseRequest::new(
                &self.holder,
                LeaseRole::Mission,
                LeaseAction::CaughtUp,
                format!("caught-up-{revision}"),
            )
        };
        match self.bus.ask(&topics::LEASE, &[&self.robot], &request, PATIENCE).await {
            Ok(_) => {
                self.settled = true;
                tracing::info!(robot = self.robot, standbys = ?self.members, "the robot lists the standbys");
                if self.members.is_empty() {
                    self.record_leadership(false).await?;
                }
                Ok(())
            }
            Err(AskError::Refused(Refusal::NotLeader)) => Err(End::Deposed),
            Err(error) => {
                tracing::warn!(robot = self.robot, %error, "the robot's list of standbys is not updated");
                Ok(())
            }
        }
    }
}
