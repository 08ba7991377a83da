//! Standby. Applies its leader's journal. When the lease has lapsed and the robot lists this store among those that have caught up, it
//! requests to lead.

use std::time::Duration;

use tokio::time::{Instant, sleep_until, timeout_at};
use zenav_protocol::bus::BusError;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{GoalRequest, JoinRequest, JournalEntry, JournalReply, Leader, Refusal};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::{MissionError, Service, Turn, blocking, metrics};
use zenav_mission::{JournalPosition, JournalVerdict, Leadership, StoreError, judge_entry, may_lead};

/// After this much silence of the leader, the standby joins it again.
const SILENCE: Duration = Duration::from_secs(1);
/// Longest time between two attempts to join while they fail.
const LONGEST_SILENCE: Duration = Duration::from_secs(30);
/// Deadline of a join request.
const PATIENCE: Duration = Duration::from_secs(1);
/// Time within which the robot publishes a grant.
const WORD: Duration = Duration::from_millis(250);
/// A mission that led waits this long before it requests to lead again.
const REST: Duration = Duration::from_millis(500);

/// Follows until shutdown, or until this mission may request to lead.
pub(super) async fn follow(service: &mut Service) -> Result<Turn, MissionError> {
    metrics::leads(service.config.robot.as_str(), false);
    tracing::info!(robot = %service.config.robot, store = service.store.name(), "stands by");
    service.role.met();
    let mut states = service.bus.latest(&topics::STATE, &[service.config.robot.as_str()])?;
    let store = service.store.clone();
    let mut epoch = blocking(move || store.leadership()).await??.epoch;
    let mut place = fresh_session();
    let mut word: Option<Leader> = None;
    let rested = Instant::now() + REST;
    let (mut next_join, mut silence) = (Instant::now(), SILENCE);
    loop {
        tokio::select! {
            () = service.shutdown.wait() => return Ok(Turn::Over),
            request = service.requests.next() => {
                let Some(request) = request else { return Err(BusError::Closed.into()) };
                service.answer_as_standby(request);
            }
            entry = service.journal.next() => {
                let Some(entry) = entry else { return Err(BusError::Closed.into()) };
                let heard = Instant::now() + WORD;
                while word.as_ref().is_none_or(|word| word.epoch < entry.body.epoch) {
                    let Ok(Some(state)) = timeout_at(heard, states.next()).await else { break };
                    word = state.message.lease.leader;
                }
                let taken = match judge_entry(&entry.body, word.as_ref(), &place) {
                    Ok(verdict) => match take(service, &entry.body, verdict).await {
                        Err(error @ StoreError::NoRoom { .. }) => {
                            entry.refuse(&Refusal::internal(&error));
                            return Err(error.into());
                        }
                        taken => taken.map_err(Refusal::internal),
                    },
                    Err(refusal) => Err(refusal),
                };
                match taken {
                    Ok(()) => {
                        place.position = place.position.max(entry.body.position);
                        epoch = entry.body.epoch;
                        (silence, next_join) = (SILENCE, Instant::now() + SILENCE);
                        entry.reply(&JournalReply { position: place.position });
                    }
                    Err(refusal) => {
                        tracing::warn!(robot = %service.config.robot, %refusal, "a journal entry was refused");
                        if entry.body.session == place.session {
                            // Something is missing now: replicate from the beginning, with a growing delay.
                            place = fresh_session();
                            silence = (2 * silence).min(LONGEST_SILENCE);
                            next_join = Instant::now() + silence;
                        }
                        entry.refuse(&refusal);
                    }
                }
            }
            state = states.next() => {
                let Some(state) = state else { return Err(BusError::Closed.into()) };
                word.clone_from(&state.message.lease.leader);
                if may_lead(&state.message.lease, service.store.name()) && Instant::now() > rested {
                    tracing::info!(robot = %service.config.robot, "requests to lead");
                    return Ok(Turn::Lead);
                }
            }
            () = sleep_until(next_join) => {
                next_join = Instant::now() + silence;
                // The old session may have a gap: a new one starts with everything.
                place = fresh_session();
                join(service, epoch, &place).await?;
            }
        }
    }
}

async fn take(service: &mut Service, entry: &JournalEntry, verdict: JournalVerdict) -> Result<(), StoreError> {
    let JournalVerdict::Take { instead } = verdict else {
        return Ok(());
    };
    let now = service.clock.now();
    if now != Stamp::ZERO && entry.now != Stamp::ZERO {
        service.ahead = Some(entry.now.0.wrapping_sub(now.0).cast_signed());
    }
    let (store, entry) = (service.store.clone(), entry.clone());
    let leadership = Leadership {
        epoch: entry.epoch,
        shared: true,
    };
    blocking(move || store.apply(&entry.writes, instead, Some(leadership))).await?
}

/// Asks the leader to replicate its store to this one.
async fn join(service: &Service, epoch: u64, place: &JournalPosition) -> Result<(), StoreError> {
    let store = service.store.clone();
    let goals = match epoch {
        // Goals accepted while no mission led are still open.
        0 => blocking(move || store.goals()).await??,
        _ => Vec::new(),
    };
    let request = JoinRequest {
        store: service.store.name().to_owned(),
        session: place.session.clone(),
        goals: goals
            .into_iter()
            .filter(|goal| !goal.state.state.is_end())
            .map(|goal| GoalRequest {
                id: Some(goal.state.id),
                ..goal.state.request
            })
            .collect(),
    };
    let (bus, robot) = (service.bus.clone(), service.config.robot.to_string());
    tokio::spawn(async move {
        if let Err(error) = bus.ask(&topics::JOIN, &[&robot], &request, PATIENCE).await {
            tracing::debug!(%error, "no leader to join");
        }
    });
    Ok(())
}

/// The beginning of a fresh session.
fn fresh_session() -> JournalPosition {
    JournalPosition::beginning(Id::unique().into())
}
