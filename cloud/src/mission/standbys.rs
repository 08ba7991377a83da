//! Replication. Standbys store what the leader acknowledges, before it does.
//!
//! A joining standby is sent the leader's whole store, in pieces, then every batch of writes. Once it has caught up, the leader has the
//! robot list it, and from then on waits for it. A standby that does not answer in time is first taken off the robot's list; then the
//! leader continues without it. So every store on the robot's list holds everything that was acknowledged.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, timeout};
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{JoinRequest, JournalWrite, Leader, LeaseAction, LeaseRequest, LeaseRole, Refusal};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::replication::{Batch, Replication};
use super::{End, blocking};
use zenav_mission::{Leadership, Membership, MissionConfig, MissionStore, StoreError};

/// A standby that has not stored a batch within this time is dropped. Well below the TTL of the lease.
pub(super) const PATIENCE: Duration = Duration::from_millis(400);
/// Interval between attempts to update the robot's list while nothing waits for it.
const RETRY: Duration = Duration::from_millis(500);
/// Batches in flight to one standby.
const MAX_BATCHES: usize = 1024;
/// Standbys of one leader.
const MAX_STANDBYS: usize = 7;

/// The standbys of a leader.
pub(super) struct Standbys {
    bus: Bus,
    robot: String,
    holder: String,
    store: Arc<MissionStore>,
    membership: Membership,
    /// The mission's time.
    now: Stamp,
    replicators: BTreeMap<String, Replicator>,
    begun: Instant,
    next_try: Instant,
    /// Whether the last attempt to update the robot's list failed.
    is_list_late: bool,
}

/// The task that replicates to one standby.
struct Replicator {
    session: String,
    batches: mpsc::Sender<Arc<Batch>>,
    /// The newest batch on the standby's disk; closed when the standby does not answer.
    stored: watch::Receiver<Option<u64>>,
}

impl Replicator {
    fn is_alive(&self) -> bool {
        self.stored.has_changed().is_ok()
    }
}

impl Standbys {
    /// Starts without standbys.
    pub(super) fn new(
        bus: &Bus,
        config: &MissionConfig,
        store: Arc<MissionStore>,
        leadership: Leadership,
        incarnation: u64,
    ) -> Self {
        Self {
            bus: bus.clone(),
            robot: config.robot.to_string(),
            holder: config.holder.clone(),
            membership: Membership::new(store.name(), leadership, incarnation),
            store,
            now: Stamp::ZERO,
            replicators: BTreeMap::new(),
            begun: Instant::now(),
            next_try: Instant::now(),
            is_list_late: false,
        }
    }

    /// The leader's own store.
    pub(super) fn store(&self) -> Arc<MissionStore> {
        Arc::clone(&self.store)
    }

    /// Whether another store may hold everything that this leader has acknowledged.
    pub(super) fn are_any(&self) -> bool {
        self.membership.is_shared()
    }

    /// Whether a leader that last ran, or began something, at `since` must stay silent.
    pub(super) fn is_held_up(&self, since: Instant) -> bool {
        self.membership.is_held_up(since.elapsed())
    }

    /// The stores that certainly hold everything acknowledged.
    pub(super) fn names(&self) -> Vec<String> {
        let members = self.membership.members().iter();
        members.filter(|_| self.membership.is_settled()).cloned().collect()
    }

    /// Takes the epoch under which the robot has this mission lead.
    pub(super) async fn lead(&mut self, term: Option<u64>, now: Stamp) -> Result<(), StoreError> {
        self.now = now;
        if !self.membership.lead(term) {
            return Ok(());
        }
        self.next_try = Instant::now();
        // Standbys must learn the new epoch.
        self.send_to_all(Vec::new());
        self.record_leadership(self.membership.is_shared()).await
    }

    /// Takes the robot's report on the leader. If this leader did not send the list in it, a stranger sent it in its name, and the leader
    /// reports again.
    pub(super) fn hear(&mut self, leader: Option<&Leader>) {
        if let Some(leader) = leader
            && self.membership.hear(leader)
        {
            tracing::warn!(robot = self.robot, listed = ?leader.caught_up, "a stranger told the robot who has caught up");
            self.next_try = Instant::now();
        }
    }

    async fn record_leadership(&mut self, shared: bool) -> Result<(), StoreError> {
        let leadership = self.membership.share(shared);
        let store = self.store();
        blocking(move || store.apply(&[], false, Some(leadership))).await?
    }

    /// Starts replicating to a standby that joins, unless it already does.
    pub(super) async fn join(&mut self, request: &JoinRequest) -> Result<(), End> {
        let Some(epoch) = self.membership.term() else {
            return Ok(());
        };
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
        // The standby starts over: until the transfer is complete it holds nothing whole.
        if self.membership.members().contains(&request.store) {
            self.drop_standbys(std::slice::from_ref(&request.store));
        }
        if !self.membership.is_settled() {
            self.update_list().await?;
        }
        if !self.membership.may_begin(&request.store) {
            return Ok(());
        }
        let store = self.store();
        let whole = Batch {
            number: self.membership.batch(),
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
        let Some(epoch) = self.membership.term() else { return };
        let batch = Arc::new(Batch {
            number: self.membership.batch(),
            epoch,
            now: self.now,
            writes,
        });
        // A standby too far behind is dropped.
        self.replicators
            .retain(|_, replicator| replicator.batches.try_send(Arc::clone(&batch)).is_ok());
    }

    /// Returns once every listed standby has stored the batch or is off the robot's list.
    pub(super) async fn replicate(&mut self, writes: Vec<JournalWrite>) -> Result<(), End> {
        let begun = Instant::now();
        self.membership.next_batch();
        self.send_to_all(writes);
        let mut late = Vec::new();
        for member in self.membership.members() {
            let stored = match self.replicators.get(member) {
                Some(replicator) => {
                    let mut stored = replicator.stored.clone();
                    let there = stored.wait_for(|stored| *stored >= Some(self.membership.batch()));
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
        while !self.may_tell() {
            self.update_list().await?;
            if self.is_held_up(begun) {
                return Err(End::Deposed);
            }
        }
        Ok(())
    }

    fn may_tell(&self) -> bool {
        let stored = |name: &str| *self.replicators.get(name)?.stored.borrow();
        self.membership.may_tell(stored)
    }

    fn drop_standbys(&mut self, late: &[String]) {
        for name in late {
            tracing::warn!(robot = self.robot, standby = name, "a standby is dropped");
            self.replicators.remove(name);
            self.membership.drop(name, self.begun.elapsed());
        }
    }

    /// Updates the robot's list: adds standbys that have caught up, removes lost ones.
    pub(super) async fn maintain(&mut self) -> Result<(), End> {
        let is_alive = |name: &String| self.replicators.get(name).is_some_and(Replicator::is_alive);
        let members = self.membership.members().iter();
        let gone: Vec<String> = members.filter(|name| !is_alive(name)).cloned().collect();
        self.drop_standbys(&gone);
        self.replicators.retain(|_, replicator| replicator.is_alive());
        let now = self.begun.elapsed();
        let is_ready = |(name, replicator): &(&String, &Replicator)| {
            self.membership.is_ready(name, *replicator.stored.borrow(), now)
        };
        let ready = self.replicators.iter().filter(is_ready);
        let new: Vec<String> = ready.map(|(name, _)| name.clone()).collect();
        if !new.is_empty() {
            if !self.membership.is_shared() {
                // On disk before the robot may let another mission lead.
                self.record_leadership(true).await?;
            }
            self.membership.admit(new);
            self.next_try = Instant::now();
        }
        if !self.membership.is_settled() && Instant::now() >= self.next_try {
            self.update_list().await?;
        }
        Ok(())
    }

    /// Sends the robot's list once.
    async fn update_list(&mut self) -> Result<(), End> {
        self.next_try = Instant::now() + RETRY;
        let Some(report) = self.membership.report() else {
            tokio::time::sleep(PATIENCE / 4).await;
            return Ok(());
        };
        let request_id = format!("caught-up-{}", report.revision);
        let request = LeaseRequest {
            store: Some(report.store.clone()),
            leads: Some(report),
            ..LeaseRequest::new(&self.holder, LeaseRole::Mission, LeaseAction::CaughtUp, request_id)
        };
        match self.bus.ask(&topics::LEASE, &[&self.robot], &request, PATIENCE).await {
            Ok(_) => {
                self.is_list_late = false;
                self.membership.settle();
                let standbys = self.membership.members();
                tracing::info!(robot = self.robot, ?standbys, "the robot lists the standbys");
                if standbys.is_empty() {
                    self.record_leadership(false).await?;
                }
                Ok(())
            }
            Err(AskError::Refused(Refusal::NotLeader)) => Err(End::Deposed),
            Err(error) => {
                // A robot that was cut off is asked for as long as that lasts.
                if !std::mem::replace(&mut self.is_list_late, true) {
                    tracing::warn!(robot = self.robot, %error, "the robot's list of standbys is not updated");
                }
                Ok(())
            }
        }
    }
}
