//! Replication to one standby. Sends the leader's store and its batches of writes, in order and in pieces.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{JournalEntry, JournalWrite, Refusal};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::standbys::PATIENCE;

/// Deadline of a piece of the initial transfer, which blocks nothing else.
const PIECE: Duration = Duration::from_secs(4);
/// Size of a piece, bytes: the link carries it well within the TTL of the lease.
const PIECE_BYTES: usize = 64 * 1024;
/// Longest interval between messages to a standby.
const KEEP_ALIVE: Duration = Duration::from_millis(400);

/// Writes that belong together.
pub(super) struct Batch {
    pub(super) number: u64,
    pub(super) epoch: u64,
    pub(super) now: Stamp,
    pub(super) writes: Vec<JournalWrite>,
}

/// Replicates batches to one standby.
pub(super) struct Replication {
    pub(super) bus: Bus,
    pub(super) robot: String,
    pub(super) standby: String,
    pub(super) leader: String,
    pub(super) session: String,
    /// Number of the newest entry of the session.
    pub(super) position: u64,
}

impl Replication {
    /// Runs until the standby does not answer in time, or another replication replaces this one.
    pub(super) async fn run(
        mut self,
        whole: Batch,
        mut batches: mpsc::Receiver<Arc<Batch>>,
        stored: watch::Sender<Option<u64>>,
    ) {
        let result = self.replicate(whole, &mut batches, &stored).await;
        if let Err(error) = result {
            tracing::info!(standby = self.standby, %error, "replication to a standby ended");
        }
    }

    async fn replicate(
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
                    // Batches that have arrived meanwhile are sent along.
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
                "the standby does not hold what was sent",
            )));
        }
        Ok(())
    }
}

/// Splits writes into pieces that are sent one by one; at least one piece.
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
