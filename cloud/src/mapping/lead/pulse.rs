//! Pulse. How does a leading mapping service show that it leads, and how does it notice that it was suspended?
//!
//! Its beats come from a task of their own: a scan that is drawn or a file that is written for long is no silence. After a suspension
//! (`SIGSTOP`, a paused machine) another service may lead: the service steps back before it writes anything more.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use std::time::{Duration, Instant};

use tokio::task::JoinHandle;
use tokio::time::MissedTickBehavior;
use zenav_protocol::bus::{Bus, BusError};
use zenav_protocol::messages::{MapRef, MappingLeader};
use zenav_protocol::topics::MAPPING_LEADER;

use super::super::succession::{BEAT, SUSPENDED};

/// A service that has worked on one thing for longer than this hangs: its beats stop.
const LONGEST_WORK: Duration = Duration::from_secs(10);

/// The beats of a leader, until it is dropped.
#[derive(Debug)]
pub(super) struct Pulse {
    state: Arc<Mutex<State>>,
    task: JoinHandle<()>,
}

#[derive(Debug)]
struct State {
    leader: MappingLeader,
    /// The last beat.
    beaten: Instant,
    /// When the service last began something new.
    turned: Instant,
    was_suspended: bool,
}

impl Pulse {
    /// Begins to beat for a leader.
    pub(super) fn begin(bus: &Bus, robot: &str, leader: MappingLeader) -> Result<Self, BusError> {
        let publisher = bus.publisher(&MAPPING_LEADER, &[robot])?;
        let now = Instant::now();
        let state = Arc::new(Mutex::new(State {
            leader,
            beaten: now,
            turned: now,
            was_suspended: false,
        }));
        let of_task = Arc::clone(&state);
        let task = tokio::spawn(async move {
            let mut beats = tokio::time::interval(BEAT);
            beats.set_missed_tick_behavior(MissedTickBehavior::Delay);
            loop {
                beats.tick().await;
                let beat = {
                    let mut state = lock(&of_task);
                    state.was_suspended |= state.beaten.elapsed() > SUSPENDED;
                    state.beaten = Instant::now();
                    (state.turned.elapsed() < LONGEST_WORK).then(|| state.leader.clone())
                };
                if let Some(beat) = beat {
                    publisher.put(&beat);
                }
            }
        });
        Ok(Self { state, task })
    }

    /// The map as the next beats name it.
    pub(super) fn name_map(&self, map: &MapRef, held: bool) {
        let mut state = lock(&self.state);
        if state.leader.map != *map {
            state.leader.map.clone_from(map);
        }
        state.leader.held = held;
    }

    /// The leader, as its last beat named it.
    pub(super) fn leader(&self) -> MappingLeader {
        lock(&self.state).leader.clone()
    }

    /// The service begins something new.
    pub(super) fn turned(&self) {
        let mut state = lock(&self.state);
        state.was_suspended |= state.turned.elapsed() >= LONGEST_WORK;
        state.turned = Instant::now();
    }

    /// Waits for one long piece of work which is no sign that the service hangs.
    pub(super) async fn during<T>(&self, work: impl Future<Output = T>) -> T {
        let mut work = std::pin::pin!(work);
        let mut turns = tokio::time::interval(BEAT);
        loop {
            tokio::select! {
                done = &mut work => return done,
                _ = turns.tick() => self.turned(),
            }
        }
    }

    /// Ends once the process was suspended, or hung. Never ready before: to be polled ahead of whatever else is ready.
    pub(super) async fn suspended(&self) {
        std::future::poll_fn(|_| {
            let state = lock(&self.state);
            if state.was_suspended || state.beaten.elapsed() > SUSPENDED {
                Poll::Ready(())
            } else {
                Poll::Pending
            }
        })
        .await;
    }
}

impl Drop for Pulse {
    fn drop(&mut self) {
        self.task.abort();
    }
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}
