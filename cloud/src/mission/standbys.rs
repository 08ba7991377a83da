//! How do other stores come to hold what the leader acknowledges, before it does?
//!
//! A mission that joins is handed all that the leader's store holds, piece by piece, then every batch of writes. Once it has caught up the
//! leader has the robot note it, and waits for it from then on. One that does not answer in time is taken off the robot's list first; then the
//! leader goes on without it. So whoever the robot lets lead holds everything that was acknowledged.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, timeout};
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::*;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::lead::HELD_UP;
use super::{End, blocking};
use zenav_mission::config::MissionConfig;
use zenav_mission::lease::newer;
use zenav_mission::records::Leadership;
use zenav_mission::store::{Store, StoreError};

/// A standby that has not stored a batch by then is left behind. Well below the life of a lease, which is not renewed meanwhile.
const PATIENCE: Duration = Duration::from_millis(400);
/// Time for a piece of all that a store holds to reach another, on which nobody waits.
const PIECE: Duration = Duration::from_secs(4);
/// Size of a piece, bytes: a link carries it well within the life of a lease.
const PIECE_BYTES: usize = 64 * 1024;
/// A standby hears from its leader at least this often.
const KEEP_ALIVE: Duration = Duration::from_millis(400);
/// Time between two tries to have the robot note who has caught up, while nothing waits for it.
const RETRY: Duration = Duration::from_millis(500);
/// One that was left behind is not waited for again for this long, then twice as long, and so on up to the second; once it has done well for
/// the second, all is forgiven.
const DISTRUST: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
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
    /// Epoch under which this mission leads, once the robot has said so.
    term: Option<u64>,
    /// The mission's time.
    now: Stamp,
    /// Number of the newest batch of writes.
    batch: u64,
    feeders: BTreeMap<String, Feeder>,
    /// The stores that the robot may have noted, besides the leader's own.
    members: BTreeSet<String>,
    /// Whether the robot is known to have noted exactly these.
    settled: bool,
    /// What this store's file says of whether others may hold newer goals.
    shared: bool,
    asked: u64,
    next_try: Instant,
    /// Until when one that was left behind is not waited for, and for how long that was.
    distrust: BTreeMap<String, (Instant, Duration)>,
}

/// What carries batches to one standby.
struct Feeder {
    session: String,
    batches: mpsc::Sender<Arc<Batch>>,
    /// The newest batch that is on its disk; closed when it does not answer.
    stored: watch::Receiver<Option<u64>>,
}

/// Writes that belong together.
struct Batch {
    number: u64,
    epoch: u64,
    now: Stamp,
    writes: Vec<JournalWrite>,
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
        standing: Leadership,
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
            feeders: BTreeMap::new(),
            members: BTreeSet::new(),
            settled: !standing.shared,
            shared: standing.shared,
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

    /// Takes the robot's word on the epoch under which this mission leads.
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
        self.feed_all(Vec::new());
        self.stand(self.shared).await
    }

    async fn stand(&mut self, shared: bool) -> Result<(), StoreError> {
        self.shared = shared;
        let standing = Leadership {
            epoch: self.term.unwrap_or(0),
            shared,
        };
        let store = self.store();
        blocking(move || store.apply(&[], false, Some(standing))).await?
    }

    /// Begins to hand over to a mission that joins, unless it is at it.
    pub(super) async fn join(&mut self, request: &JoinRequest) -> Result<(), End> {
        let Some(epoch) = self.term else { return Ok(()) };
        let known = self.feeders.get(&request.store).filter(|feeder| feeder.is_alive());
        let full = self.feeders.len() >= MAX_STANDBYS && !self.feeders.contains_key(&request.store);
        if full || request.store == self.store.name() || known.is_some_and(|feeder| feeder.session == request.session) {
            return Ok(());
        }
        // It begins anew: while it is handed everything it holds nothing whole.
        if self.members.contains(&request.store) {
            self.leave_behind(std::slice::from_ref(&request.store));
            self.settle().await?;
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
        let feed = Feed {
            bus: self.bus.clone(),
            robot: self.robot.clone(),
            standby: request.store.clone(),
            leader: self.store.name().to_owned(),
            session: request.session.clone(),
            position: 0,
        };
        tracing::info!(robot = self.robot, standby = request.store, "a standby joins");
        tokio::spawn(feed.run(whole, receiver, sender));
        let feeder = Feeder {
            session: request.session.clone(),
            batches,
            stored,
        };
        self.feeders.insert(request.store.clone(), feeder);
        Ok(())
    }

    fn feed_all(&mut self, writes: Vec<JournalWrite>) {
        let Some(epoch) = self.term else { return };
        let batch = Arc::new(Batch {
            number: self.batch,
            epoch,
            now: self.now,
            writes,
        });
        // One that is too far behind ends.
        self.feeders
            .retain(|_, feeder| feeder.batches.try_send(Arc::clone(&batch)).is_ok());
    }

    /// Returns once all that have caught up have stored what was written, or are off the robot's list.
    pub(super) async fn hand_over(&mut self, writes: Vec<JournalWrite>) -> Result<(), End> {
        let begun = Instant::now();
        self.batch += 1;
        self.feed_all(writes);
        let mut late = Vec::new();
        for member in &self.members {
            let stored = match self.feeders.get(member) {
                Some(feeder) => {
                    let mut stored = feeder.stored.clone();
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
        self.leave_behind(&late);
        while !self.settled && self.shared {
            self.settle().await?;
            if begun.elapsed() > HELD_UP {
                return Err(End::Deposed);
            }
        }
        Ok(())
    }

    fn leave_behind(&mut self, late: &[String]) {
        for name in late {
            tracing::warn!(robot = self.robot, standby = name, "a standby is left behind");
            self.feeders.remove(name);
            self.members.remove(name);
            self.settled = false;
            let now = Instant::now();
            let again = self.distrust.get(name).filter(|(until, _)| now < *until + DISTRUST.1);
            let time = again.map_or(DISTRUST.0, |(_, time)| (2 * *time).min(DISTRUST.1));
            self.distrust.insert(name.clone(), (now + time, time));
        }
    }

    /// Has the robot note who has caught up, and who has not any more.
    pub(super) async fn tend(&mut self) -> Result<(), End> {
        let dead = |name: &&String| self.feeders.get(*name).is_none_or(|feeder| !feeder.is_alive());
        let gone: Vec<String> = self.members.iter().filter(dead).cloned().collect();
        self.leave_behind(&gone);
        self.feeders.retain(|_, feeder| feeder.is_alive());
        let trusted = |name: &String| self.distrust.get(name).is_none_or(|(until, _)| Instant::now() > *until);
        let caught_up = |feeder: &Feeder| *feeder.stored.borrow() == Some(self.batch);
        let new: Vec<String> = self
            .feeders
            .iter()
            .filter(|(name, feeder)| !self.members.contains(*name) && caught_up(feeder) && trusted(name))
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
                tracing::info!(robot = self.robot, standbys = ?self.members, "the robot knows who has caught up");
                if self.members.is_empty() {
                    self.stand(false).await?;
                }
                Ok(())
            }
            Err(AskError::Refused(Refusal::NotLeader)) => Err(End::Deposed),
            Err(error) => {
                tracing::warn!(robot = self.robot, %error, "the robot has not noted who has caught up");
                Ok(())
            }
        }
    }
}

/// Hands batches to one standby.
struct Feed {
    bus: Bus,
    robot: String,
    standby: String,
    leader: String,
    session: String,
    /// Number of the newest entry in the session.
    position: u64,
}

impl Feed {
    /// Until the standby does not answer in time, or another one takes this one's place.
    async fn run(mut self, whole: Batch, mut batches: mpsc::Receiver<Arc<Batch>>, stored: watch::Sender<Option<u64>>) {
        let result = self.hand_over(whole, &mut batches, &stored).await;
        if let Err(error) = result {
            tracing::info!(standby = self.standby, %error, "no more is handed to a standby");
        }
    }

    async fn hand_over(
        &mut self,
        whole: Batch,
        batches: &mut mpsc::Receiver<Arc<Batch>>,
        stored: &watch::Sender<Option<u64>>,
    ) -> Result<(), AskError> {
        let (mut number, mut epoch, mut now) = (whole.number, whole.epoch, whole.now);
        for piece in pieces(whole.writes) {
            self.position += 1;
            self.put(epoch, now, piece, PIECE).await?;
        }
        stored.send_replace(Some(number));
        loop {
            let mut writes = Vec::new();
            tokio::select! {
                batch = batches.recv() => {
                    let mut next = batch;
                    if next.is_none() {
                        return Ok(());
                    }
                    // Whatever has come meanwhile goes with it.
                    while let Some(batch) = next {
                        (number, epoch, now) = (batch.number, batch.epoch, batch.now);
                        writes.extend(batch.writes.iter().cloned());
                        next = batches.try_recv().ok();
                    }
                }
                () = tokio::time::sleep(KEEP_ALIVE) => {}
            }
            self.position += u64::from(!writes.is_empty());
            self.put(epoch, now, writes, PATIENCE).await?;
            stored.send_replace(Some(number));
        }
    }

    async fn put(&self, epoch: u64, now: Stamp, writes: Vec<JournalWrite>, patience: Duration) -> Result<(), AskError> {
        let entry = JournalEntry {
            leader: self.leader.clone(),
            epoch,
            session: self.session.clone(),
            position: self.position,
            now,
            writes,
        };
        let chunks = [self.robot.as_str(), &self.standby];
        let reply = self.bus.ask(&topics::JOURNAL, &chunks, &entry, patience).await?;
        if reply.position != entry.position {
            return Err(AskError::Refused(Refusal::rejected(
                "it does not hold what it was handed",
            )));
        }
        Ok(())
    }
}

/// Writes in pieces that are carried one by one; at least one.
fn pieces(writes: Vec<JournalWrite>) -> Vec<Vec<JournalWrite>> {
    let (mut pieces, mut bytes) = (vec![Vec::new()], 0);
    for write in writes {
        let size = write.key.len() + write.value.as_ref().map_or(0, String::len);
        if bytes > 0 && bytes + size > PIECE_BYTES {
            pieces.push(Vec::new());
            bytes = 0;
        }
        bytes += size;
        if let Some(piece) = pieces.last_mut() {
            piece.push(write);
        }
    }
    pieces
}
