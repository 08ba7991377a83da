//! Standby. Which journal entries does it accept, and when may it lead? The robot decides: who leads, in which epoch, and which stores have
//! caught up.

use zenav_protocol::messages::{JournalEntry, Leader, LeaseRole, LeaseState, Refusal};

/// A standby's position in its leader's journal.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct JournalPosition {
    /// Session of the join that the entries belong to.
    pub session: String,
    /// Number of the newest entry on disk; zero at the beginning.
    pub position: u64,
}

impl JournalPosition {
    /// The beginning of a session.
    #[must_use]
    pub const fn beginning(session: String) -> Self {
        Self { session, position: 0 }
    }
}

/// What to do with a journal entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JournalVerdict {
    /// Apply it.
    Take {
        /// Replaces the stored content instead of extending it.
        instead: bool,
    },
    /// It has no writes: the leader is alive.
    Known,
}

/// Checks a journal entry: it must come from the leader, as named by the robot's `word`, and be the next one. No entry is sent twice, so
/// writes under a number that is already stored belong to another replication, started by a duplicated join: they are refused, because the
/// content stored under that number is not what the leader assumes.
///
/// # Errors
/// [`Refusal::Rejected`] with the reason.
///
/// ```
/// use zenav_mission::{JournalPosition, JournalVerdict, judge_entry};
/// use zenav_protocol::messages::{JournalEntry, Leader};
/// use zenav_protocol::time::Stamp;
///
/// let word = Leader { store: "a".into(), epoch: 7, caught_up: vec!["a".into()], revision: 1 };
/// let place = JournalPosition { session: "s".into(), position: 4 };
/// let entry = JournalEntry {
///     leader: "a".into(),
///     epoch: 7,
///     session: "s".into(),
///     position: 5,
///     now: Stamp::from_secs(9.0),
///     writes: Vec::new(),
/// };
/// assert_eq!(judge_entry(&entry, Some(&word), &place)?, JournalVerdict::Take { instead: false });
/// assert!(judge_entry(&entry, None, &place).is_err(), "the robot names no leader");
/// assert!(judge_entry(&JournalEntry { position: 6, ..entry }, Some(&word), &place).is_err(), "entry 5 is missing");
/// # Ok::<(), zenav_protocol::messages::Refusal>(())
/// ```
pub fn judge_entry(
    entry: &JournalEntry,
    word: Option<&Leader>,
    place: &JournalPosition,
) -> Result<JournalVerdict, Refusal> {
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
        next if next == place.position + 1 => Ok(JournalVerdict::Take { instead: next == 1 }),
        known if known <= place.position && entry.writes.is_empty() => Ok(JournalVerdict::Known),
        known if known <= place.position => Err(Refusal::rejected(format!("entry {known} is stored already"))),
        late => Err(Refusal::rejected(format!(
            "entry {late} does not follow {}",
            place.position
        ))),
    }
}

/// Whether the robot would grant the lease to the mission with this store.
///
/// ```
/// use zenav_mission::may_lead;
/// use zenav_protocol::messages::{Leader, LeaseState};
///
/// let leader = Leader { store: "a".into(), epoch: 7, caught_up: vec!["a".into(), "b".into()], revision: 1 };
/// let mut lease = LeaseState { live: true, leader: Some(leader), ..LeaseState::default() };
/// assert!(!may_lead(&lease, "b"), "the leader is alive");
/// lease.live = false;
/// assert!(may_lead(&lease, "b") && !may_lead(&lease, "c"), "c lacks goals");
/// ```
#[must_use]
pub fn may_lead(lease: &LeaseState, store: &str) -> bool {
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
    use zenav_protocol::messages::JournalWrite;
    use zenav_protocol::time::Stamp;

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
        let judged = |entry: JournalEntry| judge_entry(&entry, Some(&named), &place(4));
        let with_writes = |position| JournalEntry {
            writes: vec![JournalWrite {
                table: "goals".into(),
                key: "g".into(),
                value: None,
            }],
            ..entry("a", 7, "s", position)
        };
        assert_eq!(judged(with_writes(5)), Ok(JournalVerdict::Take { instead: false }));
        assert_eq!(judged(entry("a", 7, "s", 4)), Ok(JournalVerdict::Known), "alive");
        assert_eq!(
            judged(entry("a", 7, "s", 1)),
            Ok(JournalVerdict::Known),
            "alive, and late"
        );
        let strangers = [
            with_writes(4),
            with_writes(1),
            entry("a", 7, "s", 6),
            entry("a", 7, "before", 5),
            entry("b", 7, "s", 5),
            entry("a", 6, "s", 5),
            entry("a", u64::MAX, "s", 5),
        ];
        for stranger in strangers {
            assert!(matches!(judged(stranger), Err(Refusal::Rejected { .. })));
        }
        let silent = judge_entry(&entry("a", 7, "s", 5), None, &place(4));
        assert!(
            matches!(silent, Err(Refusal::Rejected { .. })),
            "of a robot that is silent"
        );
        assert_eq!(
            judge_entry(&entry("a", 7, "s", 1), Some(&named), &place(0)),
            Ok(JournalVerdict::Take { instead: true })
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
        let mut operated = lease(true, Some(word("a", 7, &["a", "b"])));
        operated.role = Some(LeaseRole::Operator);
        assert!(may_lead(&operated, "b"), "the leader is silent");
        operated.leader_live = true;
        assert!(!may_lead(&operated, "b"));
    }
}
