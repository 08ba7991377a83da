//! Standby. What does it do, and when may it lead? It applies its leader's journal; when the lease has lapsed and the robot lists it
//! among the stores that have caught up, it requests to lead.

use std::time::Duration;

use tokio::time::{Instant, sleep_until, timeout_at};
use zenav_protocol::bus::BusError;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    GoalRequest, JoinRequest, JournalEntry, JournalReply, Leader, LeaseRole, LeaseState, Refusal,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::{MissionError, Service, Turn, blocking};
use zenav_mission::records::Leadership;
use zenav_mission::store::StoreError;

/// A leader that is silent for longer is joined again.
const SILENCE: Duration = Duration::from_secs(1);
/// Longest time between two attempts to join while they fail.
const LONGEST_SILENCE: Duration = Duration::from_secs(30);
/// Deadline of a join request.
const PATIENCE: Duration = Duration::from_secs(1);
/// The robot publishes a grant within this time.
const WORD: Duration = Duration::from_millis(250);
/// A mission that led does not request to lead again before.
const REST: Duration = Duration::from_millis(500);

/// A standby's position in its leader's journal.
#[derive(Clone, Debug, PartialEq, Eq)]
struct JournalPosition {
    session: String,
    position: u64,
}

impl JournalPosition {
    /// The beginning of a fresh session.
    fn anew() -> Self {
        Self {
            session: Id::unique().into(),
            position: 0,
        }
    }
}

/// What to do with a journal entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// Apply it, after what is stored or instead of it.
    Take { instead: bool },
    /// It is stored already.
    Known,
}

/// Follows until shutdown, or until this mission may request to lead.
pub(super) async fn follow(service: &mut Service) -> Result<Turn, MissionError> {
    let mut states = service.bus.latest(&topics::STATE, &[service.config.robot.as_str()])?;
    let store = service.store.clone();
    let mut epoch = blocking(move || store.leadership()).await??.epoch;
    let mut place = JournalPosition::anew();
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
                let taken = match judge(&entry.body, word.as_ref(), &place) {
                    Ok(verdict) => take(service, &entry.body, verdict).await.map_err(Refusal::internal),
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
                            place = JournalPosition::anew();
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
                place = JournalPosition::anew();
                join(service, epoch, &place).await?;
            }
        }
    }
}

/// Whether an entry is the leader's, by the robot's `word`, and is the next one.
fn judge(entry: &JournalEntry, word: Option<&Leader>, place: &JournalPosition) -> Result<Verdict, Refusal> {
    if entry.session != place.session {
        return Err(Refusal::rejected("the entry belongs to another session"));
    }
    let Some(word) = word else {
        return Err(Refusal::rejected("the robot is silent: the leader is unknown"));
    };
    if (&word.store, word.epoch) != (&entry.leader, entry.epoch) {
        return Err(Refusal::rejected(format!(
            "the robot says that {} leads, in epoch {}",
            word.store, word.epoch
        )));
    }
    match entry.position {
        known if known <= place.position => Ok(Verdict::Known),
        next if next == place.position + 1 => Ok(Verdict::Take { instead: next == 1 }),
        late => Err(Refusal::rejected(format!(
            "entry {late} does not follow {}",
            place.position
        ))),
    }
}

async fn take(service: &mut Service, entry: &JournalEntry, verdict: Verdict) -> Result<(), StoreError> {
    let Verdict::Take { instead } = verdict else {
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

/// Whether the robot would grant the lease to the mission with this store.
fn may_lead(lease: &LeaseState, store: &str) -> bool {
    let operator = lease.role == Some(LeaseRole::Operator);
    match &lease.leader {
        None => !lease.live,
        Some(leader) if leader.store == store => true,
        Some(leader) => {
            let open = !lease.live || operator && !lease.leader_live;
            open && leader.caught_up.iter().any(|known| known == store)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(leader: &str, epoch: u64, session: &str, position: u64) -> JournalEntry {
        JournalEntry {
            leader: leader.into(),
            epoch,
            session: session.into(),
            position,
            now: Stamp::ZERO,
            writes: Vec::new(),
        }
    }

    fn word(store: &str, epoch: u64, caught_up: &[&str]) -> Leader {
        Leader {
            store: store.into(),
            epoch,
            caught_up: caught_up.iter().map(|&store| store.into()).collect(),
            revision: 1,
        }
    }

    #[test]
    fn only_what_follows_on_what_is_stored_is_taken_and_only_from_whom_the_robot_names() {
        let named = word("a", 7, &["a"]);
        let place = |position| JournalPosition {
            session: "s".into(),
            position,
        };
        let judged = |entry: JournalEntry| judge(&entry, Some(&named), &place(4));
        assert_eq!(judged(entry("a", 7, "s", 5)), Ok(Verdict::Take { instead: false }));
        assert_eq!(judged(entry("a", 7, "s", 4)), Ok(Verdict::Known), "sent again");
        assert_eq!(judged(entry("a", 7, "s", 1)), Ok(Verdict::Known), "sent again late");
        let strangers = [
            entry("a", 7, "s", 6),
            entry("a", 7, "before", 5),
            entry("b", 7, "s", 5),
            entry("a", 6, "s", 5),
            entry("a", u64::MAX, "s", 5),
        ];
        for stranger in strangers {
            assert!(matches!(judged(stranger), Err(Refusal::Rejected { .. })));
        }
        let silent = judge(&entry("a", 7, "s", 5), None, &place(4));
        assert!(
            matches!(silent, Err(Refusal::Rejected { .. })),
            "of a robot that is silent"
        );
        assert_eq!(
            judge(&entry("a", 7, "s", 1), Some(&named), &place(0)),
            Ok(Verdict::Take { instead: true })
        );
        assert_ne!(JournalPosition::anew(), JournalPosition::anew());
    }

    #[test]
    fn a_standby_asks_to_lead_when_the_lease_has_lapsed_and_it_has_caught_up() {
        let lease = |live: bool, leader: Option<Leader>| LeaseState {
            live,
            leader,
            ..LeaseState::default()
        };
        assert!(may_lead(&lease(false, None), "b"));
        assert!(!may_lead(&lease(true, None), "b"));
        assert!(may_lead(&lease(false, Some(word("a", 7, &["a", "b"]))), "b"));
        assert!(!may_lead(&lease(true, Some(word("a", 7, &["a", "b"]))), "b"));
        assert!(!may_lead(&lease(false, Some(word("a", 7, &["a"]))), "b"));
        assert!(may_lead(&lease(true, Some(word("b", 7, &["b"]))), "b"), "it leads");
        let mut operated = lease(true, Some(word("a", 7, &["a", "b"])));
        operated.role = Some(LeaseRole::Operator);
        assert!(may_lead(&operated, "b"), "the leader is silent");
        operated.leader_live = true;
        assert!(!may_lead(&operated, "b"));
    }
}
