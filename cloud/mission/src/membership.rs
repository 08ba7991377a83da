//! Membership. Which standbys hold everything that the leader has acknowledged, as far as the robot knows?

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use zenav_protocol::messages::Leader;

use super::lease::newer;
use super::records::Leadership;

/// How long a dropped standby is not waited for: the first time, doubled on each drop up to the second; after the second without a drop it
/// starts over.
const DISTRUST: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));

/// A leader's standbys. All times are relative to the same instant of the leader's own clock.
///
/// The leader maintains the robot's list of stores that may lead next. A standby is listed once it holds everything, and from then on the
/// leader waits for it; it is taken off the list before anything it lacks is acknowledged, and before it starts replication over. So every
/// store on the robot's list holds everything that was acknowledged.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Membership {
    own: String,
    /// Epoch under which this mission leads, once the robot has confirmed it.
    term: Option<u64>,
    /// Number of the newest batch of writes.
    batch: u64,
    /// Stores that may be on the robot's list, besides the leader's own.
    members: BTreeSet<String>,
    /// Whether the robot's list is known to equal these.
    settled: bool,
    /// Whether this store's file states that others may hold newer goals.
    shared: bool,
    /// Number of the newest report to the robot.
    revision: u64,
    /// Until when a dropped standby is not waited for, and how long that period is.
    distrust: BTreeMap<String, (Duration, Duration)>,
}

impl Membership {
    /// A leader with standbys that was delayed for longer than this acknowledges nothing more until the robot confirms that it leads: others
    /// may have led since.
    pub const HELD_UP: Duration = Duration::from_secs(1);

    /// No standby yet. `incarnation` makes reports newer than those of every earlier run.
    #[must_use]
    pub fn new(own: &str, leadership: Leadership, incarnation: u64) -> Self {
        Self {
            own: own.to_owned(),
            term: None,
            batch: 0,
            members: BTreeSet::new(),
            settled: !leadership.shared,
            shared: leadership.shared,
            revision: newer(incarnation, 0),
            distrust: BTreeMap::new(),
        }
    }

    /// Takes the epoch under which the robot lets this mission lead. Returns whether it is a new one, to be recorded in the store and the
    /// standbys.
    pub fn lead(&mut self, term: Option<u64>) -> bool {
        let is_new = term.is_some() && term != self.term;
        if is_new {
            self.term = term;
            // With a new grant the robot's list is empty; if the robot only confirmed the leader, it may not be.
            self.settled &= self.members.is_empty();
        }
        is_new
    }

    /// Takes the robot's record of the leader. Returns whether somebody else reported in this leader's name, so that the report must be
    /// repeated.
    pub fn hear(&mut self, leader: &Leader) -> bool {
        let is_foreign = leader.store == self.own && self.term == Some(leader.epoch) && leader.revision > self.revision;
        if is_foreign {
            self.revision = leader.revision;
            self.settled = false;
        }
        is_foreign
    }

    /// Epoch under which this mission leads.
    #[must_use]
    pub const fn term(&self) -> Option<u64> {
        self.term
    }

    /// Whether any other store may hold everything that this leader has acknowledged.
    #[must_use]
    pub const fn is_shared(&self) -> bool {
        self.shared
    }

    /// Content of the store's file from now on: whether other stores may hold newer goals (`shared`).
    pub fn share(&mut self, shared: bool) -> Leadership {
        self.shared = shared;
        Leadership {
            epoch: self.term.unwrap_or(0),
            shared,
        }
    }

    /// Whether a leader must acknowledge nothing more, because it started something, or last ran, this long ago.
    #[must_use]
    pub fn is_held_up(&self, elapsed: Duration) -> bool {
        self.shared && elapsed > Self::HELD_UP
    }

    /// The stores that the leader waits for.
    #[must_use]
    pub const fn members(&self) -> &BTreeSet<String> {
        &self.members
    }

    /// Whether the robot's list is known to equal the members, or there is none to know.
    #[must_use]
    pub const fn is_settled(&self) -> bool {
        self.settled || !self.shared
    }

    /// Number of the newest batch of writes.
    #[must_use]
    pub const fn batch(&self) -> u64 {
        self.batch
    }

    /// Starts another batch of writes.
    pub const fn next_batch(&mut self) {
        self.batch += 1;
    }

    /// Whether replication to a standby may start: not while the robot may list it, because its store is incomplete meanwhile.
    #[must_use]
    pub fn may_begin(&self, standby: &str) -> bool {
        self.is_settled() && !self.members.contains(standby)
    }

    /// Whether a standby with this batch on disk may be listed and waited for: it holds everything, and was not dropped recently.
    #[must_use]
    pub fn is_ready(&self, standby: &str, stored: Option<u64>, now: Duration) -> bool {
        let is_trusted = self.distrust.get(standby).is_none_or(|(until, _)| now > *until);
        stored == Some(self.batch) && is_trusted && !self.members.contains(standby)
    }

    /// Waits for these standbys from now on; the robot must be told. The store's file must first state that others may hold newer goals.
    pub fn admit(&mut self, standbys: impl IntoIterator<Item = String>) {
        self.members.extend(standbys);
        self.settled = false;
    }

    /// Stops waiting for a standby; the robot must be told before anything else is acknowledged.
    pub fn drop(&mut self, standby: &str, now: Duration) {
        self.members.remove(standby);
        self.settled = false;
        let again = self
            .distrust
            .get(standby)
            .filter(|(until, _)| now < *until + DISTRUST.1);
        let time = again.map_or(DISTRUST.0, |(_, time)| (2 * *time).min(DISTRUST.1));
        self.distrust.insert(standby.to_owned(), (now + time, time));
    }

    /// Whether the newest batch may be acknowledged: every standby that the robot may list has it on disk.
    ///
    /// ```
    /// use zenav_mission::{Leadership, Membership};
    ///
    /// let mut leader = Membership::new("a", Leadership::default(), 1);
    /// leader.lead(Some(7));
    /// leader.share(true);
    /// leader.admit(["b".to_owned()]);
    /// assert_eq!(leader.report().unwrap().caught_up, ["a", "b"]);
    /// leader.settle(); // the robot has taken the report
    /// leader.next_batch();
    /// assert!(!leader.may_tell(|_| Some(0)) && leader.may_tell(|_| Some(1)));
    /// ```
    #[must_use]
    pub fn may_tell(&self, stored: impl Fn(&str) -> Option<u64>) -> bool {
        self.is_settled() && self.members.iter().all(|member| stored(member) >= Some(self.batch))
    }

    /// The next report to the robot: the stores that have caught up. `None` before the robot has confirmed that this mission leads.
    pub fn report(&mut self) -> Option<Leader> {
        let epoch = self.term?;
        self.revision = self.revision.saturating_add(1);
        Some(Leader {
            store: self.own.clone(),
            epoch,
            caught_up: std::iter::once(&self.own).chain(&self.members).cloned().collect(),
            revision: self.revision,
        })
    }

    /// Records that the robot has accepted the newest report; no standby was admitted or dropped since.
    pub const fn settle(&mut self) {
        self.settled = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn secs(secs: u64) -> Duration {
        Duration::from_secs(secs)
    }

    fn leader() -> Membership {
        let mut membership = Membership::new("a", Leadership::default(), 3);
        assert!(membership.lead(Some(7)) && !membership.lead(Some(7)) && !membership.lead(None));
        membership
    }

    /// A leader with a standby on the robot's list.
    fn with_standby() -> Membership {
        let mut membership = leader();
        membership.share(true);
        membership.admit(["b".to_owned()]);
        assert!(membership.report().is_some());
        membership.settle();
        membership
    }

    #[test]
    fn nothing_is_told_before_every_listed_standby_has_it_and_the_list_is_known() {
        let mut membership = leader();
        assert!(membership.may_tell(|_| None), "alone");
        assert!(membership.is_ready("b", Some(0), secs(0)) && !membership.is_ready("b", None, secs(0)));
        membership.share(true);
        membership.admit(["b".to_owned()]);
        assert!(!membership.may_tell(|_| Some(0)), "the robot has not answered");
        let report = membership.report();
        assert_eq!(
            report.map(|report| report.caught_up),
            Some(vec!["a".into(), "b".into()])
        );
        membership.settle();
        membership.next_batch();
        assert!(membership.may_tell(|_| Some(1)) && !membership.may_tell(|_| Some(0)));
    }

    #[test]
    fn a_standby_is_handed_everything_only_while_the_robot_does_not_list_it() {
        let mut membership = with_standby();
        assert!(!membership.may_begin("b") && membership.may_begin("c"));
        membership.drop("b", secs(0));
        assert!(!membership.may_begin("b"), "the robot still lists it");
        membership.settle();
        assert!(membership.may_begin("b"));
        // After a restart another store may be on the list, from a report of an earlier run.
        let leadership = Leadership { epoch: 7, shared: true };
        let mut again = Membership::new("a", leadership, 4);
        again.lead(Some(7));
        assert!(!again.may_begin("b"));
    }

    #[test]
    fn a_dropped_standby_is_trusted_again_after_a_while_that_doubles() {
        let mut membership = with_standby();
        membership.drop("b", secs(10));
        assert!(!membership.is_ready("b", Some(0), secs(11)) && membership.is_ready("b", Some(0), secs(12)));
        membership.drop("b", secs(12));
        assert!(!membership.is_ready("b", Some(0), secs(14)) && membership.is_ready("b", Some(0), secs(15)));
    }

    #[test]
    fn only_a_leader_with_standbys_is_held_up() {
        assert!(with_standby().is_held_up(secs(2)) && !with_standby().is_held_up(secs(1)));
        assert!(!leader().is_held_up(secs(20)));
    }

    #[test]
    fn a_report_that_a_stranger_made_in_its_name_is_made_anew_with_a_newer_one() {
        let mut membership = with_standby();
        let own = membership.report().unwrap();
        membership.settle();
        assert!(!membership.hear(&own));
        let forged = Leader {
            revision: own.revision + 5,
            caught_up: vec!["a".into(), "stranger".into()],
            ..own.clone()
        };
        assert!(membership.hear(&forged) && !membership.is_settled());
        assert!(membership.report().unwrap().revision > forged.revision);
        assert!(!membership.hear(&Leader { epoch: 8, ..forged }), "of another grant");
    }

    #[test]
    fn reports_are_numbered_over_restarts() {
        let revision = |incarnation| {
            let mut membership = Membership::new("a", Leadership::default(), incarnation);
            membership.lead(Some(7));
            membership.report();
            membership.report().map(|report| report.revision)
        };
        assert!(revision(2) < revision(3));
    }
}
