//! Rivals. Does a leader step back, because another service leads or may lead by now?

use std::time::Instant;

use zenav_protocol::bus::{AliveWatch, Bus, BusError, Subscription};
use zenav_protocol::messages::MappingLeader;
use zenav_protocol::topics::{ALIVE_COMPONENT, MAPPING_LEADER, alive_key};

use super::super::follow::{MOST_BEATS, STANDBY};
use super::super::succession::{SUSPENDED, goes_before};

/// What is heard of the other services of the robot.
pub(super) struct Rivals {
    beats: Subscription<MappingLeader>,
    copies: AliveWatch,
}

/// A sign of another service.
pub(super) enum Sign {
    /// A leader's beat, also this service's own.
    Beat(MappingLeader),
    /// Whether a copy that holds this leader's map shows.
    Copy(bool),
}

impl Rivals {
    /// Listens to the other services of a robot.
    ///
    /// # Errors
    /// If the bus is closed, or a key cannot be declared.
    pub(super) fn listen(bus: &Bus, robot: &str) -> Result<Self, BusError> {
        Ok(Self {
            beats: bus.subscribe(&MAPPING_LEADER, &[robot], MOST_BEATS)?,
            copies: bus.watch_alive(alive_key(ALIVE_COMPONENT, &[robot, STANDBY]))?,
        })
    }

    /// The next sign; `None` once the bus is closed. Loses none if it is dropped.
    pub(super) async fn next(&mut self) -> Option<Sign> {
        tokio::select! {
            biased;
            beat = self.beats.next() => Some(Sign::Beat(beat?.message)),
            copy = self.copies.next() => {
                let (_, is_present) = copy?;
                Some(Sign::Copy(is_present))
            }
        }
    }
}

/// Whether there are other services of the robot, which may have taken over while this one was not heard.
#[derive(Clone, Copy, Debug)]
pub(super) struct Company {
    /// Whether others have shown.
    has_copies: bool,
    /// Since when none does, while a router is linked.
    alone_since: Option<Instant>,
    /// When a router was linked last.
    linked: Instant,
}

impl Company {
    /// `is_takeover`: another service led before.
    pub(super) fn new(is_takeover: bool, now: Instant) -> Self {
        Self {
            has_copies: is_takeover,
            alone_since: Some(now),
            linked: now,
        }
    }

    /// Whether another service may take over.
    pub(super) fn has_copies(self) -> bool {
        self.has_copies
    }

    /// Takes a sign; returns whether it is of a service that leads before this one.
    pub(super) fn takes(&mut self, sign: &Sign, own: &MappingLeader, now: Instant) -> bool {
        match sign {
            Sign::Beat(rival) => {
                if rival.name != own.name && !self.has_copies {
                    (self.has_copies, self.alone_since) = (true, Some(now));
                }
                goes_before(rival, own)
            }
            Sign::Copy(is_present) => {
                self.has_copies |= is_present;
                self.alone_since = (!is_present).then_some(now);
                false
            }
        }
    }

    /// Looks from time to time whether a router is linked; returns whether this service is cut off for so long that another one may lead.
    pub(super) fn is_cut_off(&mut self, is_linked: bool, now: Instant) -> bool {
        let since = |then: Instant| now.saturating_duration_since(then);
        if is_linked {
            self.linked = now;
            // A copy that is gone takes over nothing. Tokens come back only a while after a router does.
            self.has_copies &= self.alone_since.is_none_or(|then| since(then) <= SUSPENDED);
            return false;
        }
        self.alone_since = self.alone_since.map(|_| now);
        self.has_copies && since(self.linked) > SUSPENDED
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn leader(name: &str, term: u64) -> MappingLeader {
        MappingLeader {
            name: name.to_owned(),
            term,
            ..MappingLeader::default()
        }
    }

    /// Looks five times a second, from one time to another, s; returns when the service is cut off, s.
    fn cut_off(company: &mut Company, start: Instant, is_linked: bool, from: f64, to: f64) -> Option<f64> {
        let steps = ((to - from) * 5.0).round() as u32;
        let mut times = (0..=steps).map(|step| from + 0.2 * f64::from(step));
        times.find(|time| company.is_cut_off(is_linked, start + Duration::from_secs_f64(*time)))
    }

    #[test]
    fn a_leader_without_a_router_for_two_seconds_is_cut_off_if_it_has_a_copy_and_else_goes_on() {
        let start = Instant::now();
        let own = leader("a", 1);
        let mut alone = Company::new(false, start);
        assert_eq!(cut_off(&mut alone, start, false, 0.0, 60.0), None);
        let mut watched = Company::new(false, start);
        assert!(!watched.takes(&Sign::Copy(true), &own, start));
        assert_eq!(cut_off(&mut watched, start, true, 0.0, 30.0), None);
        let found = cut_off(&mut watched, start, false, 30.2, 60.0);
        assert!(found.is_some_and(|found| (32.0..32.5).contains(&found)), "{found:?}");
    }

    #[test]
    fn a_copy_that_has_left_counts_for_two_seconds_of_a_link_and_without_one_for_longer() {
        let start = Instant::now();
        let own = leader("a", 1);
        let mut company = Company::new(false, start);
        company.takes(&Sign::Copy(true), &own, start);
        company.takes(&Sign::Copy(false), &own, start);
        cut_off(&mut company, start, true, 0.0, 1.8);
        assert!(company.has_copies());
        cut_off(&mut company, start, true, 2.2, 2.4);
        assert!(!company.has_copies());

        // The token is lost with the link.
        let mut company = Company::new(false, start);
        company.takes(&Sign::Copy(true), &own, start);
        company.takes(&Sign::Copy(false), &own, start);
        assert!(cut_off(&mut company, start, false, 0.2, 10.0).is_some());
    }

    #[test]
    fn a_beat_of_another_leader_is_a_sign_of_a_copy_and_deposes_a_leader_of_a_lower_term() {
        let start = Instant::now();
        let own = leader("a", 2);
        let mut company = Company::new(false, start);
        assert!(!company.takes(&Sign::Beat(own.clone()), &own, start) && !company.has_copies());
        assert!(!company.takes(&Sign::Beat(leader("b", 1)), &own, start) && company.has_copies());
        assert!(company.takes(&Sign::Beat(leader("b", 3)), &own, start));
    }
}
