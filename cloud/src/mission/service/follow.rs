//! What does a mission do that stands by, and when may it lead? It stores what its leader stores; when the lease has lapsed and the robot
//! has it on the list of those that have caught up, it asks to lead.

use std::time::Duration;

use tokio::time::{Instant, sleep_until, timeout_at};
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::bus::BusError;
use zenav_protocol::messages::*;
use zenav_protocol::topics;

use super::super::exchange::{Request, Response};
use super::super::records::Standing;
use super::super::store::StoreError;
use super::{MissionError, Post, Turn, blocking};

/// A leader that is not heard for so long is asked to be joined again.
const UNHEARD: Duration = Duration::from_secs(1);
/// How long an answer to that is waited for.
const PATIENCE: Duration = Duration::from_secs(1);
/// The robot says within this time that it has granted a lease.
const WORD: Duration = Duration::from_millis(250);

/// Where a standby stands in its leader's journal.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Place {
    leader: String,
    position: u64,
}

/// What to do with a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// Store it.
    Take,
    /// It is stored.
    Known,
}

/// Stands by until the end, or until this mission may ask to lead.
pub(super) async fn follow(post: &mut Post) -> Result<Turn, MissionError> {
    let mut states = post.bus.latest(&topics::STATE, &[post.config.robot.as_str()])?;
    let store = post.store.clone();
    let mut epoch = blocking(move || store.standing()).await??.epoch;
    let mut place: Option<Place> = None;
    let mut word: Option<Leader> = None;
    let mut next_join = Instant::now();
    loop {
        tokio::select! {
            () = post.shutdown.wait() => return Ok(Turn::Over),
            request = post.desk.next() => {
                let Some(request) = request else { return Err(BusError::Closed.into()) };
                let answer = match request.request() {
                    Request::Info(_) => Ok(Response::Info(Box::new(info(post)))),
                    _ => Err(Refusal::NotLeader),
                };
                request.answer(answer);
            }
            entry = post.journal.next() => {
                let Some(entry) = entry else { return Err(BusError::Closed.into()) };
                let heard = Instant::now() + WORD;
                while word.as_ref().is_none_or(|word| word.epoch < entry.body.epoch) {
                    let Ok(Some(state)) = timeout_at(heard, states.next()).await else { break };
                    word = state.message.lease.leader;
                }
                match judge(&entry.body, epoch, word.as_ref(), place.as_ref()) {
                    Err(refusal) => {
                        tracing::info!(%refusal, "what a leader hands over is not taken");
                        if matches!(refusal, Refusal::Rejected { .. }) {
                            // Something is missing: the leader is to begin again.
                            (place, next_join) = (None, Instant::now());
                        }
                        entry.refuse(&refusal);
                    }
                    Ok(verdict) => {
                        if let Err(error) = take(post, &entry.body, verdict).await {
                            let reason = error.to_string();
                            tracing::error!(reason, "what the leader hands over cannot be stored");
                            entry.refuse(&Refusal::Internal { reason });
                            place = None;
                            continue;
                        }
                        (epoch, next_join) = (entry.body.epoch, Instant::now() + UNHEARD);
                        let position = place.map_or(0, |place| place.position).max(entry.body.position);
                        let position = if entry.body.whole { entry.body.position } else { position };
                        place = Some(Place { leader: entry.body.leader.clone(), position });
                        entry.reply(&JournalReply { position });
                    }
                }
            }
            state = states.next() => {
                let Some(state) = state else { return Err(BusError::Closed.into()) };
                word.clone_from(&state.message.lease.leader);
                if may_lead(&state.message.lease, post.store.name()) {
                    tracing::info!(robot = %post.config.robot, "asks to lead");
                    return Ok(Turn::Lead);
                }
            }
            () = sleep_until(next_join) => {
                next_join = Instant::now() + UNHEARD;
                join(post, epoch, place.is_some()).await?;
            }
        }
    }
}

/// Whether a batch is the leader's, by the robot's `word`, and follows on what is stored.
fn judge(entry: &JournalEntry, epoch: u64, word: Option<&Leader>, place: Option<&Place>) -> Result<Verdict, Refusal> {
    if !word.is_some_and(|word| word.store == entry.leader && word.epoch == entry.epoch) {
        return Err(Refusal::NotLeader);
    }
    if entry.epoch < epoch {
        return Err(Refusal::WrongEpoch {
            got: entry.epoch,
            current: epoch,
        });
    }
    let here = place.filter(|place| place.leader == entry.leader);
    match here {
        _ if entry.whole => Ok(Verdict::Take),
        Some(place) if entry.position <= place.position => Ok(Verdict::Known),
        Some(place) if entry.position == place.position + 1 => Ok(Verdict::Take),
        _ => Err(Refusal::rejected(format!(
            "batch {} does not follow on what is stored here",
            entry.position
        ))),
    }
}

async fn take(post: &Post, entry: &JournalEntry, verdict: Verdict) -> Result<(), StoreError> {
    if verdict == Verdict::Known {
        return Ok(());
    }
    let (store, entry) = (post.store.clone(), entry.clone());
    let standing = Standing {
        epoch: entry.epoch,
        shared: true,
    };
    blocking(move || store.apply(&entry.writes, entry.whole, Some(standing))).await?
}

/// Asks whoever leads to be handed what it stores.
async fn join(post: &Post, epoch: u64, follows: bool) -> Result<(), StoreError> {
    let store = post.store.clone();
    let goals = match epoch {
        // What was accepted while nobody led is still to be done.
        0 => blocking(move || store.goals()).await??,
        _ => Vec::new(),
    };
    let request = JoinRequest {
        store: post.store.name().to_owned(),
        follows,
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
    match &lease.leader {
        None => !lease.live,
        Some(leader) if leader.store == store => true,
        Some(leader) => !lease.live && leader.caught_up.iter().any(|known| known == store),
    }
}

fn info(post: &Post) -> InfoReply {
    InfoReply {
        component: "mission".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        schema: SCHEMA_VERSION,
        robot: post.config.robot.to_string(),
        boot: None,
        model: None,
        pacing: None,
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn entry(leader: &str, epoch: u64, position: u64, whole: bool) -> JournalEntry {
        JournalEntry {
            leader: leader.into(),
            epoch,
            position,
            whole,
            writes: Vec::new(),
        }
    }

    fn word(store: &str, epoch: u64, caught_up: &[&str]) -> Leader {
        Leader {
            store: store.into(),
            epoch,
            caught_up: caught_up.iter().map(|&store| store.into()).collect(),
        }
    }

    #[test]
    fn only_what_follows_on_what_is_stored_is_taken_and_only_from_whom_the_robot_names() {
        let (named, place) = (
            word("a", 7, &["a"]),
            Place {
                leader: "a".into(),
                position: 4,
            },
        );
        let judged = |entry: JournalEntry| judge(&entry, 7, Some(&named), Some(&place));
        assert_eq!(judged(entry("a", 7, 5, false)), Ok(Verdict::Take));
        assert_eq!(judged(entry("a", 7, 4, false)), Ok(Verdict::Known), "sent again");
        assert!(
            matches!(judged(entry("a", 7, 6, false)), Err(Refusal::Rejected { .. })),
            "something is missing"
        );
        assert_eq!(judged(entry("a", 7, 9, true)), Ok(Verdict::Take), "all there is");
        for stranger in [
            entry("b", 7, 5, true),
            entry("a", 6, 5, true),
            entry("a", u64::MAX, 5, true),
        ] {
            assert_eq!(judged(stranger), Err(Refusal::NotLeader));
        }
        assert_eq!(
            judge(&entry("a", 7, 5, true), 7, None, None),
            Err(Refusal::NotLeader),
            "of a robot that is silent"
        );
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
    }
}
