//! Following. What does a copy of a robot's mapping service keep while another one leads, and when does it take over?
//!
//! A copy answers no ask of mapping: clients repeat their requests until the leader, or whoever takes over, answers.
//!
//! | file | subject |
//! |---|---|
//! | `followed` | what a copy knows of the leader, and of its map |
//! | `book` | the leader's places and zones, and their file |
//! | `last_word` | how long nothing was heard of the leader |

mod book;
mod followed;
mod last_word;
#[cfg(test)]
mod tests;

use std::time::{Duration, Instant};

use tokio::task::JoinSet;
use tokio::time::MissedTickBehavior;
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{LocaliseRequest, MapReply, MapRequest};
use zenav_protocol::topics::{
    ALIVE_COMPONENT, ANNOTATIONS, LOCALISE, MAP, MAP_INFO, MAP_PATCH, MAPPING_LEADER, STATE, alive_key,
};

use super::service::{MappingService, Turn};
use super::succession::{Holds, Silence};
use super::{MappingError, storage};

use book::FollowedBook;
pub(super) use followed::Followed;
use last_word::LastWord;

/// Component of the leader's liveliness token.
pub(super) const LEADER: &str = "mapping";
/// Component of the liveliness token of a copy that holds the leader's map.
pub(super) const STANDBY: &str = "mapping-standby";

/// Most queued patches; when more arrive at once, the whole map is requested.
const MOST_PATCHES: usize = 128;
/// Most queued beats.
pub(super) const MOST_BEATS: usize = 64;
/// Interval between two looks whether patches are missing.
const LOOK: Duration = Duration::from_millis(500);
/// Deadline of a request to the leader.
const PATIENCE: Duration = Duration::from_secs(5);

/// Follows the leader until shutdown, or until this copy is to lead.
pub(super) async fn follow(part: &MappingService, mut followed: Followed) -> Result<Turn, MappingError> {
    let (bus, robot) = (&part.bus, part.config.robot.as_str());
    let chunks = [robot];
    part.leads(false);
    let mut beats = bus.subscribe(&MAPPING_LEADER, &chunks, MOST_BEATS)?;
    let mut patches = bus.subscribe(&MAP_PATCH, &chunks, MOST_PATCHES)?;
    let mut infos = bus.latest(&MAP_INFO, &chunks)?;
    let mut annotations = bus.latest(&ANNOTATIONS, &chunks)?;
    let mut states = bus.latest(&STATE, &chunks)?;
    let mut tokens = bus.watch_alive(alive_key(ALIVE_COMPONENT, &[robot, LEADER]))?;
    // What a service that leads could not read is refused at once, and not only at a takeover.
    let mut book = FollowedBook::open(part, &followed).await?;
    part.role.met();
    bus.started();
    tracing::info!(robot, "stands by");
    let mut silence = Silence::default();
    if followed.leader.is_some() {
        silence.leader();
    }
    let begun = Instant::now();
    let mut word = LastWord::new(begun);
    let mut look = tokio::time::interval(LOOK);
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut alive = None;
    let mut was_behind = false;
    // The last term in this service's own folder.
    let mut noted = 0;
    let mut asked = JoinSet::new();
    let mut called: JoinSet<Vacancy> = JoinSet::new();
    let mut is_told = false;
    loop {
        tokio::select! {
            // All that was heard of the leader before the robot, whose messages decide.
            biased;
            () = part.shutdown.wait() => return Ok(Turn::Over),
            beat = beats.next() => match beat {
                Some(beat) => {
                    let term = beat.message.term;
                    if followed.hears(beat.message) {
                        silence.leader();
                        word.heard(Instant::now(), followed.is_behind());
                        if term > noted {
                            noted = storage::note_term(robot, part.config.folder.as_deref(), term);
                        }
                    }
                }
                None => return Ok(Turn::Over),
            },
            token = tokens.next() => match token {
                Some((_, is_present)) => silence.token(is_present),
                None => return Ok(Turn::Over),
            },
            patch = patches.next() => match patch {
                Some(patch) => followed.take(patch.message),
                None => return Ok(Turn::Over),
            },
            info = infos.next() => match info {
                Some(info) => followed.info = Some(info.message),
                None => return Ok(Turn::Over),
            },
            told = annotations.next() => match told {
                // Whose they are is not known before a leader is heard, which is then asked.
                Some(told) => if followed.leader.is_some() {
                    book.take(robot, &told.message).await;
                    followed.annotations = Some(book.now().clone());
                },
                None => return Ok(Turn::Over),
            },
            Some(told) = book.asked.join_next() => if let Ok(Some((leader, told))) = told {
                book.take_answer(robot, leader, &told).await;
                followed.annotations = Some(book.now().clone());
            },
            Some(reply) = asked.join_next() => if let Ok(Some(reply)) = reply {
                followed.replace(&reply);
            },
            Some(seat) = called.join_next() => if followed.leader.is_none() {
                match seat {
                    // A token that nobody stands for, or copies of this service's own map that wait for a robot that is away.
                    Ok(Vacancy::Open) => return Ok(Turn::Lead(Box::new(followed))),
                    Ok(Vacancy::Kept) if !std::mem::replace(&mut is_told, true) => tracing::warn!(
                        robot,
                        "no mapping service leads, and a copy holds a newer map than this service's folder: that one takes over once it hears \
                         the robot"
                    ),
                    _ => {}
                }
            },
            _ = look.tick() => {
                // A patch that the leader has named may be in transit: the whole map is requested only if it does not arrive.
                let is_behind = followed.is_behind();
                if is_behind && was_behind && asked.is_empty() {
                    asked.spawn(whole_map(bus.clone(), robot.to_owned()));
                }
                was_behind = is_behind;
                let now = Instant::now();
                part.metrics.follows(word.age(now));
                if followed.leader.is_some() && word.is_newly_overdue(now) {
                    tracing::warn!(
                        robot,
                        "neither the mapping service that led nor the robot is heard: this copy takes over once it hears the robot"
                    );
                }
                if let Some(leader) = &followed.leader {
                    book.ask(bus, robot, leader);
                } else if called.is_empty() {
                    let is_newest = storage::is_of_last_leader(robot, part.config.folder.as_deref());
                    called.spawn(vacancy(bus.clone(), robot.to_owned(), is_newest));
                }
                let is_of_another = followed.holds(&part.name) == Holds::Followed;
                if alive.is_none() && !is_behind && is_of_another && book.is_of(followed.leader.as_ref()) {
                    alive = Some(bus.declare_alive(alive_key(ALIVE_COMPONENT, &[robot, STANDBY]))?);
                    tracing::info!(robot, "holds the leader's map");
                }
            }
            state = states.next() => match state {
                Some(state) => {
                    followed.state = Some(state.message);
                    if silence.robot(begun.elapsed(), followed.holds(&part.name)) {
                        return Ok(Turn::Lead(Box::new(followed)));
                    }
                }
                None => return Ok(Turn::Over),
            },
        }
    }
}

/// Whether a service that has heard no beat may lead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Vacancy {
    /// A mapping service answers: one of an older version leads without a beat.
    Taken,
    /// Nobody answers, but a copy shows that may hold a newer map: it waits for the robot.
    Kept,
    /// Nobody leads, and nobody has a newer map.
    Open,
}

/// Looks for others; `is_newest`: whether this service's folder is that of the last leader known there.
async fn vacancy(bus: Bus, robot: String, is_newest: bool) -> Vacancy {
    let request = LocaliseRequest::default();
    let asked = bus.ask(&LOCALISE, &[&robot], &request, PATIENCE).await;
    if !matches!(asked, Err(AskError::Timeout { .. })) {
        return Vacancy::Taken;
    }
    if is_newest {
        return Vacancy::Open;
    }
    let copies = bus
        .list_alive(alive_key(ALIVE_COMPONENT, &[&robot, STANDBY]), PATIENCE)
        .await;
    match copies {
        Ok(copies) if copies.is_empty() => Vacancy::Open,
        _ => Vacancy::Kept,
    }
}

/// The robot's map, from whoever leads.
async fn whole_map(bus: Bus, robot: String) -> Option<MapReply> {
    bus.ask(&MAP, &[&robot], &MapRequest::default(), PATIENCE).await.ok()
}
