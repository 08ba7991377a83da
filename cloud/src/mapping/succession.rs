//! Succession. Which of several mapping services of a robot writes its map?
//!
//! One leads, and repeats that it does ([`MappingLeader`]); the others follow. A copy takes over once the robot was heard for a while in
//! which the leader was not: a copy that hears neither is itself cut off, and time in which it was suspended does not count. Of two leaders
//! the one of the lower term steps back, so a returning one does. No network, no clock.

use std::time::Duration;

use zenav_protocol::messages::{MappingLeader, may_follow};

/// Interval between two beats of the leader.
pub(super) const BEAT: Duration = Duration::from_millis(200);
/// A leader that is present, but was not heard for this time, is frozen or cut off.
const FROZEN: Duration = Duration::from_secs(3);
/// A leader that was suspended or without a router for this time steps back by itself: it must not write again before it knows that nobody
/// has taken over.
pub(super) const SUSPENDED: Duration = Duration::from_secs(2);
/// A leader that is not present either has ended.
const GONE: Duration = Duration::from_secs(1);
/// A service that has stepped back, and hears of nobody who has taken over, leads again: several beats would have arrived.
const NOBODY: Duration = Duration::from_millis(500);
/// Longest time between two messages of a robot that is heard all the time.
const HEARD: Duration = Duration::from_secs(1);

/// Whether a leader goes before another one: by a later term; in the same term by a larger revision of the map; then by name.
pub(super) fn goes_before(one: &MappingLeader, other: &MappingLeader) -> bool {
    let rank = |leader: &MappingLeader| (leader.term, leader.map.revision, leader.name.clone());
    may_follow(one.term, other.term) && rank(one) > rank(other)
}

/// Whether a copy that follows a leader, or none yet, takes a beat for that of its leader.
pub(super) fn is_leader(beat: &MappingLeader, known: Option<&MappingLeader>) -> bool {
    match known {
        Some(known) if known.name == beat.name => beat.term >= known.term && may_follow(beat.term, known.term),
        Some(known) => goes_before(beat, known),
        None => may_follow(beat.term, 0),
    }
}

/// Which map a copy holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Holds {
    /// None, or one that the leader no longer has.
    Nothing,
    /// The leader's.
    Followed,
    /// Its own: it led before.
    Own,
}

/// How long a copy has heard the robot, but not the leader.
#[derive(Clone, Debug, Default)]
pub(super) struct Silence {
    /// Whether the leader shows by its liveliness token.
    is_present: bool,
    /// Whether it was ever heard: one of an older version says nothing.
    was_heard: bool,
    /// First and last message of the robot since the leader was heard; the time is the copy's own.
    robot: Option<(Duration, Duration)>,
}

impl Silence {
    /// The leader was heard.
    pub(super) fn leader(&mut self) {
        self.was_heard = true;
        self.robot = None;
    }

    /// The leader's token has appeared, or disappeared.
    pub(super) fn token(&mut self, is_present: bool) {
        self.is_present = is_present;
        if is_present {
            self.robot = None;
        }
    }

    /// The robot was heard. Returns whether the copy takes over: of several, the one that knows the map best goes first.
    pub(super) fn robot(&mut self, now: Duration, holds: Holds) -> bool {
        let known = self.robot.filter(|(_, last)| now.saturating_sub(*last) <= HEARD);
        let since = known.map_or(now, |(first, _)| first);
        self.robot = Some((since, now));
        let limit = match (self.is_present, self.was_heard, holds) {
            (true, false, _) => return false,
            (true, true, _) | (false, _, Holds::Nothing) => FROZEN,
            (false, _, Holds::Followed) => GONE,
            (false, _, Holds::Own) => NOBODY,
        };
        now.saturating_sub(since) >= limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leader(term: u64, name: &str) -> MappingLeader {
        MappingLeader {
            name: name.to_owned(),
            term,
            ..MappingLeader::default()
        }
    }

    /// Lets a copy hear the robot ten times a second from one time to another; returns when it takes over, s.
    fn takes_over(silence: &mut Silence, from: f64, to: f64, holds: Holds) -> Option<f64> {
        let steps = ((to - from) * 10.0).round() as u64;
        let mut times = (0..=steps).map(|step| from + step as f64 / 10.0);
        times.find(|time| silence.robot(Duration::from_secs_f64(*time), holds))
    }

    fn followed() -> Silence {
        let mut silence = Silence::default();
        silence.token(true);
        silence.leader();
        silence
    }

    #[test]
    fn of_two_leaders_exactly_one_steps_back_and_a_leap_deposes_nobody() {
        let leaders = [leader(1, "a"), leader(1, "b"), leader(2, "a"), leader(7, "c")];
        for (mine, other) in leaders
            .iter()
            .flat_map(|mine| leaders.iter().map(move |other| (mine, other)))
        {
            let sides = [goes_before(other, mine), goes_before(mine, other)];
            assert_eq!(
                sides.iter().filter(|steps_back| **steps_back).count(),
                usize::from(mine != other)
            );
        }
        assert!(!goes_before(&leader(u64::MAX, "b"), &leader(3, "a")));
        // One that has begun while it was cut off does not cost the map of the other.
        let mut with_map = leader(1, "a");
        with_map.map.revision = 9;
        assert!(goes_before(&with_map, &leader(1, "b")) && goes_before(&leader(2, "b"), &with_map));
        let mut begun = leader(1, "b");
        begun.map.revision = 2;
        assert!(goes_before(&with_map, &begun) && !goes_before(&begun, &with_map));
    }

    #[test]
    fn a_copy_follows_the_later_leader_and_does_not_go_back_to_the_one_before() {
        let known = leader(4, "b");
        let takes = |beat: &MappingLeader| is_leader(beat, Some(&known));
        assert!(takes(&known) && takes(&leader(5, "a")) && takes(&leader(4, "c")));
        assert!(!takes(&leader(3, "z")) && !takes(&leader(4, "a")) && !takes(&leader(u64::MAX, "z")));
        assert!(is_leader(&leader(1, "a"), None) && !is_leader(&leader(u64::MAX, "a"), None));
        let mut drawn = known.clone();
        drawn.map.revision = 9;
        assert!(is_leader(&known, Some(&drawn)), "its map was reset");
    }

    #[test]
    fn a_leader_that_has_ended_is_succeeded_after_one_second_and_a_frozen_one_after_three() {
        let mut silence = followed();
        silence.token(false);
        assert_eq!(takes_over(&mut silence, 10.0, 20.0, Holds::Followed), Some(11.0));
        assert_eq!(takes_over(&mut followed(), 10.0, 20.0, Holds::Followed), Some(13.0));
        let mut own = followed();
        own.token(false);
        assert_eq!(takes_over(&mut own, 10.0, 20.0, Holds::Own), Some(10.5));
        let mut without_map = followed();
        without_map.token(false);
        assert_eq!(takes_over(&mut without_map, 10.0, 20.0, Holds::Nothing), Some(13.0));
        const { assert!(SUSPENDED.as_millis() < FROZEN.as_millis()) };
    }

    #[test]
    fn a_leader_that_is_heard_is_not_succeeded() {
        let mut silence = followed();
        for second in 0..30 {
            silence.leader();
            let from = f64::from(second);
            assert_eq!(takes_over(&mut silence, from, from + 0.9, Holds::Followed), None);
        }
        // One that is present and never says anything is of an older version.
        let mut older = Silence::default();
        older.token(true);
        assert_eq!(takes_over(&mut older, 0.0, 60.0, Holds::Followed), None);
    }

    #[test]
    fn a_copy_that_is_cut_off_or_suspended_itself_does_not_take_over() {
        let mut silence = followed();
        silence.token(false);
        assert_eq!(
            takes_over(&mut silence, 10.0, 10.5, Holds::Followed),
            None,
            "then it hears nobody"
        );
        // A minute later it hears the robot again, and a moment later the leader.
        assert_eq!(takes_over(&mut silence, 70.0, 70.8, Holds::Followed), None);
        silence.leader();
        assert_eq!(takes_over(&mut silence, 70.9, 71.7, Holds::Followed), None);
    }
}
