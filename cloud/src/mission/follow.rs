//! What does a mission do that stands by, and when may it lead? It stores what its leader stores; when the lease has lapsed and the robot
//! has it on the list of those that have caught up, it asks to lead.

use std::time::Duration;

use tokio::time::{Instant, sleep_until, timeout_at};
use zenav_protocol::bus::BusError;
use zenav_protocol::id::Id;
use zenav_protocol::messages::*;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::{MissionError, Post, Turn, blocking};
use zenav_mission::records::Leadership;
use zenav_mission::store::StoreError;

/// A leader that is not heard for so long is asked to be joined again.
const UNHEARD: Duration = Duration::from_secs(1);
/// Longest time between two such asks while they lead to nothing.
const LONGEST_UNHEARD: Duration = Duration::from_secs(30);
/// How long an answer to that is waited for.
const PATIENCE: Duration = Duration::from_secs(1);
/// The robot says within this time that it has granted a lease.
const WORD: Duration = Duration::from_millis(250);
/// A mission that led does not ask to lead again before.
const REST: Duration = Duration::from_millis(500);

/// Where a standby stands in its leader's journal.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Place {
    session: String,
    position: u64,
}

impl Place {
    /// Nothing yet, of a session that nobody has had before.
    fn anew() -> Self {
        Self {
            session: Id::unique().into(),
            position: 0,
        }
    }
}

/// What to do with an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// Store it, after what is stored or instead of it.
    Take { instead: bool },
    /// It is stored.
    Known,
}

/// Stands by until the end, or until this mission may ask to lead.
pub(super) async fn follow(post: &mut Post) -> Result<Turn, MissionError> {
    let mut states = post.bus.latest(&topics::STATE, &[post.config.robot.as_str()])?;
    let store = post.store.clone();
    let mut epoch = blocking(move || store.standing()).await??.epoch;
    let mut place = Place::anew();
    let mut word: Option<Leader> = None;
    let rested = Instant::now() + REST;
    let (mut next_join, mut unheard) = (Instant::now(), UNHEARD);
    loop {
        tokio::select! {
            () = post.shutdown.wait() => return Ok(Turn::Over),
            request = post.requests.next() => {
                let Some(request) = request else { return Err(BusError::Closed.into()) };
                post.answer_as_standby(request);
            }
            entry = post.journal.next() => {
                let Some(entry) = entry else { return Err(BusError::Closed.into()) };
                let heard = Instant::now() + WORD;
                while word.as_ref().is_none_or(|word| word.epoch < entry.body.epoch) {
                    let Ok(Some(state)) = timeout_at(heard, states.next()).await else { break };
                    word = state.message.lease.leader;
                }
                let taken = match judge(&entry.body, word.as_ref(), &place) {
                    Ok(verdict) => take(post, &entry.body, verdict).await.map_err(|error| Refusal::Internal {
                        reason: error.to_string(),
                    }),
                    Err(refusal) => Err(refusal),
                };
                match taken {
                    Ok(()) => {
                        place.position = place.position.max(entry.body.position);
                        epoch = entry.body.epoch;
                        (unheard, next_join) = (UNHEARD, Instant::now() + UNHEARD);
                        entry.reply(&JournalReply { position: place.position });
                    }
                    Err(refusal) => {
                        tracing::warn!(robot = %post.config.robot, %refusal, "what is handed over is not stored");
                        if entry.body.session == place.session {
                            // Something is missing now: all is to be handed over again, but not at once for ever.
                            place = Place::anew();
                            unheard = (2 * unheard).min(LONGEST_UNHEARD);
                            next_join = Instant::now() + unheard;
                        }
                        entry.refuse(&refusal);
                    }
                }
            }
            state = states.next() => {
                let Some(state) = state else { return Err(BusError::Closed.into()) };
                word.clone_from(&state.message.lease.leader);
                if may_lead(&state.message.lease, post.store.name()) && Instant::now() > rested {
                    tracing::info!(robot = %post.config.robot, "asks to lead");
                    return Ok(Turn::Lead);
                }
            }
            () = sleep_until(next_join) => {
                next_join = Instant::now() + unheard;
                // What was handed over before may have a gap after it: a new session begins with everything.
                place = Place::anew();
                join(post, epoch, &place).await?;
            }
        }
    }
}

/// Whether an entry is the leader's, by the robot's `word`, and follows on what is stored.
fn judge(entry: &JournalEntry, word: Option<&Leader>, place: &Place) -> Result<Verdict, Refusal> {
    if entry.session != place.session {
        return Err(Refusal::rejected("it is for another time of following"));
    }
    let Some(word) = word else {
        return Err(Refusal::rejected("the robot is not heard: nobody knows who leads"));
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
            "entry {late} does not follow on {}",
            place.position
        ))),
    }
}

async fn take(post: &mut Post, entry: &JournalEntry, verdict: Verdict) -> Result<(), StoreError> {
    let Verdict::Take { instead } = verdict else {
        return Ok(());
    };
    let now = post.clock.now();
    if now != Stamp::ZERO && entry.now != Stamp::ZERO {
        post.ahead = Some(entry.now.0.wrapping_sub(now.0).cast_signed());
    }
    let (store, entry) = (post.store.clone(), entry.clone());
    let standing = Leadership {
        epoch: entry.epoch,
        shared: true,
    };
    blocking(move || store.apply(&entry.writes, instead, Some(standing))).await?
}

/// Asks whoever leads to be handed what it stores.
async fn join(post: &Post, epoch: u64, place: &Place) -> Result<(), StoreError> {
    let store = post.store.clone();
    let goals = match epoch {
        // What was accepted while nobody led is still to be done.
        0 => blocking(move || store.goals()).await??,
        _ => Vec::new(),
    };
    let request = JoinRequest {
        store: post.store.name().to_owned(),
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
    let (bus, robot) = (post.bus.clone(), post.config.robot.to_string());
    tokio::spawn(async move {
        if let Err(error) = bus.ask(&topics::JOIN, &[&robot], &request, PATIENCE).await {
            tracing::debug!(%error, "nobody to join");
        }
    });
    Ok(())
}

/// Whether the robot would let the mission with this store lead.
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
        let place = |position| Place {
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
        assert_ne!(Place::anew(), Place::anew());
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
