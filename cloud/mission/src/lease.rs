//! Lease client. Does this mission command the robot, and does it keep the robot's goals? It requests the lease until granted, renews it
//! with heartbeats, and relies on the robot's record, not on its own.

use zenav_protocol::lease::LONGEST_ROUND_TRIP;
use zenav_protocol::messages::{EdgeState, Heartbeat, LeaseAction, LeaseReply, LeaseRequest, LeaseRole, Refusal};
use zenav_protocol::time::Stamp;

use super::asks::Asks;
use super::io::{Answer, Ask, NoAnswer, Ticket};
use super::records::Leadership;

/// Time between two heartbeats, s.
const BEAT: f64 = 0.1;
/// Time between two requests while there is another holder, s.
const RETRY: f64 = 0.5;
/// A new mission requests the lease once it has heard the robot, or after this long, s: the robot needs the round trip.
const HEARS: f64 = 3.0;
/// A robot that has not answered within this time, s, may be off: goals are accepted nevertheless.
const OFF: f64 = 1.0;
/// A robot that has not answered a request for the lease within this time, s, is reported.
const QUIET: f64 = 3.0;
/// What is said of it, with [`QUIET`] and [`LONGEST_ROUND_TRIP`] in words.
const UNANSWERED: &str =
    "the robot has not answered for over 3 s: its link is slow or cut, and over a round trip of 10 s no lease lasts";
/// Pause (s), longer than the lease's TTL, after which all earlier knowledge is discarded.
const SLEPT: f64 = 1.0;

/// The grant of this mission.
#[derive(Clone, Debug, PartialEq)]
struct Grant {
    epoch: u64,
    boot_id: String,
    /// As measured by the robot, s.
    round_trip: f64,
}

/// Acquires and renews the lease.
///
/// To command means to hold the lease; to lead means to keep the goals, which continues while an operator commands. If another store may
/// hold newer goals, this mission leads only once the robot has confirmed it since the mission started or woke.
#[derive(Clone, Debug)]
pub struct LeaseClient {
    holder: String,
    incarnation: u64,
    grant: Option<Grant>,
    /// The request under way, and when it was sent.
    asking: Option<(Ticket, Stamp)>,
    /// Whether the robot answered the last request that ended since the lease was lost.
    is_answered: bool,
    next_ask: Stamp,
    asked: u64,
    beats: u64,
    next_beat: Stamp,
    first_step: Option<Stamp>,
    last_step: Option<Stamp>,
    /// Why the lease is not held.
    why_not: String,
    /// Another mission with a live lease, according to the robot's newest state.
    other: Option<String>,
    /// The store of this mission, if it keeps goals.
    store: Option<String>,
    /// Epoch of the newest grant to that store.
    term: u64,
    /// Whether the robot has confirmed that this mission leads, since the mission started or woke.
    confirmed: bool,
    /// Whether another store may hold all of this store's goals, and possibly newer ones.
    shared: bool,
    /// Whether another mission leads now.
    deposed: bool,
    /// Whether the robot has been asked once, with any result.
    heard_out: bool,
}

impl LeaseClient {
    /// No grant yet. `incarnation` makes requests and heartbeats newer than those of every earlier run.
    #[must_use]
    pub fn new(holder: &str, incarnation: u64, store: Option<String>, leadership: Leadership) -> Self {
        Self {
            holder: holder.to_owned(),
            term: leadership.epoch,
            confirmed: false,
            shared: leadership.shared,
            deposed: false,
            heard_out: store.is_none(),
            store,
            incarnation,
            grant: None,
            asking: None,
            is_answered: false,
            next_ask: Stamp::ZERO,
            asked: 0,
            beats: 0,
            next_beat: Stamp::ZERO,
            first_step: None,
            last_step: None,
            why_not: "the robot has not answered yet".to_owned(),
            other: None,
        }
    }

    /// The epoch that commands must carry; `None` without the lease.
    #[must_use]
    pub fn epoch(&self) -> Option<u64> {
        self.grant.as_ref().map(|grant| grant.epoch)
    }

    /// Round trip to the robot and back, s, as returned with the grant; zero without the lease.
    #[must_use]
    pub fn round_trip(&self) -> f64 {
        self.grant.as_ref().map_or(0.0, |grant| grant.round_trip)
    }

    /// Why the lease is not held.
    #[must_use]
    pub fn why_not(&self) -> &str {
        &self.why_not
    }

    /// Whether this mission keeps the robot's goals; if no other store can, also without the robot's confirmation.
    #[must_use]
    pub fn leads(&self) -> bool {
        self.claims() && (self.confirmed || self.heard_out)
    }

    /// Whether this mission leads, or will lead unless the robot names another leader: a new mission yields to the present leader.
    #[must_use]
    pub fn claims(&self) -> bool {
        !self.deposed && (self.confirmed || !self.shared)
    }

    /// Whether another mission certainly leads.
    #[must_use]
    pub fn is_deposed(&self) -> bool {
        self.deposed
    }

    /// Whether this mission is a standby: it does not lead, or another mission commands.
    #[must_use]
    pub fn stands_by(&self) -> bool {
        !self.leads() || self.other.is_some() && self.grant.is_none()
    }

    /// Epoch under which this mission leads; `None` before the robot has confirmed it.
    #[must_use]
    pub fn term(&self) -> Option<u64> {
        (self.confirmed && !self.deposed).then_some(self.term)
    }

    /// Sets whether other stores may hold everything that this mission acknowledges.
    pub fn share(&mut self, shared: bool) {
        self.shared = shared;
    }

    /// Observes the robot's newest state.
    pub fn observe(&mut self, now: Stamp, state: &EdgeState) {
        let led = state.lease.live && state.lease.role == Some(LeaseRole::Mission);
        let other = state
            .lease
            .holder
            .as_ref()
            .filter(|holder| led && **holder != self.holder);
        self.other = other.cloned();
        if led
            && let (Some(store), Some(leader)) = (&self.store, &state.lease.leader)
            && leader.store != *store
            && leader.epoch > self.term
        {
            self.deposed = true;
        }
        let Some(grant) = &self.grant else {
            // There is no holder: the next request need not wait.
            if !state.lease.live && self.asking.is_none() {
                self.next_ask = self.next_ask.min(now);
            }
            return;
        };
        let lease = &state.lease;
        let leads = |store: &String| lease.leader.as_ref().is_none_or(|leader| leader.store == *store);
        let ours = lease.holder.as_deref() == Some(self.holder.as_str()) && self.store.as_ref().is_none_or(leads);
        if state.boot_id != grant.boot_id {
            self.lose(now, "the robot has restarted".to_owned());
        } else if lease.epoch > grant.epoch || (lease.epoch == grant.epoch && !ours) {
            let holder = lease.holder.as_deref().unwrap_or("nobody");
            self.lose(now, format!("{holder} holds the lease now"));
        } else if lease.epoch == grant.epoch && !lease.live {
            let why = match grant.round_trip < LONGEST_ROUND_TRIP.as_secs_f64() {
                true => "the lease has lapsed",
                false => "the lease has lapsed: over a round trip of 10 s none lasts",
            };
            self.lose(now, why.to_owned());
        }
        // A state with an older epoch was sent before the grant.
    }

    /// Records that heartbeats continued until now without a step.
    pub fn was_kept_alive(&mut self, now: Stamp) {
        if let Some(last) = &mut self.last_step {
            *last = now.max(*last);
        }
    }

    fn lose(&mut self, now: Stamp, why: String) {
        self.grant = None;
        self.why_not = why;
        self.next_ask = now;
        self.is_answered = false;
    }

    /// Requests the lease if it is not held; returns a heartbeat if one is due. `echo` is the robot's time, as far as known.
    ///
    /// ```
    /// use zenav_mission::{Answer, Ask, Asks, LeaseClient, Leadership};
    /// use zenav_protocol::messages::LeaseReply;
    /// use zenav_protocol::time::Stamp;
    ///
    /// let (mut client, mut asks) = (LeaseClient::new("mission-1", 1, None, Leadership::default()), Asks::new(1));
    /// let robot_time = Some(Stamp::from_secs(5.0));
    /// assert!(client.step(Stamp::from_secs(1.0), robot_time, &mut asks).is_none(), "no heartbeat without the lease");
    /// let (ticket, asked) = asks.take_new().remove(0);
    /// assert!(matches!(asked, Ask::Lease(_)));
    /// let lease = LeaseReply { epoch: 3, ttl_secs: 1.0, boot_id: "boot".into(), round_trip_secs: Some(0.02) };
    /// asks.answer(ticket, Ok(Answer::Lease(lease)));
    /// assert_eq!(client.step(Stamp::from_secs(1.1), robot_time, &mut asks).unwrap().epoch, 3);
    /// ```
    pub fn step(&mut self, now: Stamp, echo: Option<Stamp>, asks: &mut Asks) -> Option<Heartbeat> {
        if let Some(last) = self.last_step.replace(now)
            && now.secs_since(last) > SLEPT
        {
            // Another mission may have taken over: the robot must confirm the leader, and an earlier answer does not count.
            self.confirmed &= !self.shared;
            if let Some((ticket, _)) = self.asking.take() {
                asks.forget(ticket);
                self.next_ask = now;
            }
            if self.grant.is_some() {
                self.lose(now, "this mission was suspended".to_owned());
            }
        }
        if let Some(answer) = self.asking.and_then(|(ticket, _)| asks.take(ticket)) {
            self.asking = None;
            self.take(now, answer);
        }
        let since = now.secs_since(*self.first_step.get_or_insert(now));
        self.heard_out |= since > OFF;
        let may_ask = echo.is_some() || since > HEARS;
        if self.grant.is_none() && self.asking.is_none() && may_ask && now >= self.next_ask {
            self.asked += 1;
            let request_id = format!("{}-{}", self.incarnation, self.asked);
            let request = LeaseRequest {
                store: self.store.clone(),
                echo,
                ..LeaseRequest::new(&self.holder, LeaseRole::Mission, LeaseAction::Acquire, request_id)
            };
            self.asking = Some((asks.ask(Ask::Lease(request)), now));
        }
        // What it answered over a slow link holds until the next request ends.
        let is_quiet = !self.is_answered && self.asking.is_some_and(|(_, since)| now.secs_since(since) > QUIET);
        if is_quiet && self.why_not != UNANSWERED {
            UNANSWERED.clone_into(&mut self.why_not);
        }
        let epoch = self.epoch()?;
        // At even times, whatever else triggers a step; a missed one is not made up for.
        let late = now.secs_since(self.next_beat);
        if late < -1e-6 {
            return None;
        }
        let from = if late < BEAT { self.next_beat } else { now };
        self.next_beat = from.plus_secs(BEAT);
        self.beats += 1;
        Some(Heartbeat {
            holder: self.holder.clone(),
            epoch,
            counter: newer(self.incarnation, self.beats),
            echo,
        })
    }

    fn take(&mut self, now: Stamp, answer: Result<Answer, NoAnswer>) {
        self.next_ask = now.plus_secs(RETRY);
        self.heard_out = true;
        self.is_answered = !matches!(answer, Err(NoAnswer::Silent(_)));
        match answer {
            Ok(Answer::Lease(LeaseReply {
                epoch,
                boot_id,
                round_trip_secs,
                ..
            })) => {
                self.grant = Some(Grant {
                    epoch,
                    boot_id,
                    round_trip: round_trip_secs.filter(|secs| secs.is_finite()).unwrap_or_default(),
                });
                (self.term, self.confirmed, self.deposed) = (epoch, true, false);
                self.next_beat = Stamp::ZERO;
                self.why_not.clear();
            }
            Ok(_) => self.why_not = "the robot's reply was not a lease".to_owned(),
            Err(NoAnswer::Refused(Refusal::Held { holder, leader, .. })) => {
                self.why_not = format!("{holder} holds the lease");
                if let (Some(store), Some(leader)) = (&self.store, leader) {
                    self.deposed = *store != leader.store;
                    if !self.deposed {
                        (self.term, self.confirmed) = (leader.epoch, true);
                    }
                }
            }
            Err(NoAnswer::Refused(refusal)) => {
                self.deposed |= matches!(refusal, Refusal::NotCaughtUp { .. });
                self.why_not = refusal.to_string();
            }
            // A request that the bus refused at once, or an answer that is none; one that ran out was told as it grew old.
            Err(NoAnswer::Silent(why)) => {
                if self.why_not != UNANSWERED {
                    self.why_not = why;
                }
            }
        }
    }
}

/// A counter that grows over restarts: the incarnation in the upper 32 bits, the count below.
#[must_use]
pub(crate) fn newer(incarnation: u64, count: u64) -> u64 {
    (incarnation << 32) | (count & 0xffff_ffff)
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_protocol::messages::Leader;

    /// The robot was heard.
    const HEARD: Option<Stamp> = Some(Stamp::ZERO);

    fn granted(now: f64) -> (LeaseClient, Asks) {
        let (mut client, mut asks) = (
            LeaseClient::new("me", 3, Some("mine".into()), Leadership::default()),
            Asks::new(3),
        );
        assert_eq!(client.step(Stamp::from_secs(now), HEARD, &mut asks), None);
        let (ticket, ask) = asks.take_new().pop().unwrap();
        assert!(matches!(ask, Ask::Lease(LeaseRequest { ref holder, .. }) if holder == "me"));
        asks.answer(
            ticket,
            Ok(Answer::Lease(LeaseReply {
                epoch: 7,
                ttl_secs: 1.0,
                boot_id: "b".into(),
                round_trip_secs: None,
            })),
        );
        (client, asks)
    }

    #[test]
    fn the_first_number_of_a_run_is_higher_than_every_number_of_the_run_before() {
        assert!(newer(2, 0) > newer(1, 4_000_000_000));
    }

    #[test]
    fn heartbeats_come_ten_times_a_second_and_grow_over_restarts() {
        let (mut client, mut asks) = granted(1.0);
        let beats: Vec<_> = (0..21)
            .filter_map(|i| client.step(Stamp::from_secs(1.05 + 0.05 * f64::from(i)), HEARD, &mut asks))
            .collect();
        assert_eq!(beats.len(), 11);
        assert!(beats.windows(2).all(|pair| pair[0].counter < pair[1].counter));
        assert!(beats[0].counter > newer(2, 1_000_000) && beats[0].epoch == 7);
    }

    #[test]
    fn a_robot_that_does_not_answer_is_reported_within_seconds_and_until_it_does() {
        let (mut client, mut asks) = granted(1.0);
        let said = |client: &LeaseClient| client.why_not().contains("over a round trip of 10 s no lease lasts");
        assert!(!said(&client));
        for tenth in 0..50 {
            client.step(Stamp::from_secs(1.05 + 0.1 * f64::from(tenth)), HEARD, &mut asks);
            assert_eq!((client.epoch(), client.why_not()), (Some(7), ""), "it answered in time");
        }
        let restarted = EdgeState {
            boot_id: "another".into(),
            ..EdgeState::default()
        };
        client.observe(Stamp::from_secs(6.0), &restarted);
        for tenth in 0..60 {
            let now = 6.0 + 0.1 * f64::from(tenth);
            client.step(Stamp::from_secs(now), HEARD, &mut asks);
            assert_eq!(said(&client), now > 6.05 + QUIET, "{now}: {}", client.why_not());
        }
    }

    #[test]
    fn what_a_robot_answers_over_a_slow_link_is_not_called_silence() {
        let (mut client, mut asks) = (LeaseClient::new("me", 3, None, Leadership::default()), Asks::new(3));
        let held = Refusal::Held {
            holder: "anna".into(),
            role: LeaseRole::Operator,
            epoch: 8,
            leader: None,
        };
        let mut due: Vec<(f64, Ticket)> = Vec::new();
        for tenth in 0..200 {
            let now = 1.0 + 0.1 * f64::from(tenth);
            due.retain(|(at, ticket)| {
                let is_due = *at <= now;
                if is_due {
                    asks.answer(*ticket, Err(NoAnswer::Refused(held.clone())));
                }
                !is_due
            });
            client.step(Stamp::from_secs(now), HEARD, &mut asks);
            due.extend(asks.take_new().into_iter().map(|(ticket, _)| (now + 5.0, ticket)));
            if now > 6.2 {
                assert_eq!(client.why_not(), "anna holds the lease", "{now}");
            }
        }
        let (mut client, mut asks) = (LeaseClient::new("me", 3, None, Leadership::default()), Asks::new(3));
        client.step(Stamp::from_secs(1.0), HEARD, &mut asks);
        let (ticket, _) = asks.take_new().pop().unwrap();
        asks.answer(ticket, Err(NoAnswer::Silent("nobody may ask".into())));
        client.step(Stamp::from_secs(1.1), HEARD, &mut asks);
        assert_eq!(client.why_not(), "nobody may ask");
    }

    #[test]
    fn a_lease_that_lapses_over_a_link_that_is_too_slow_says_so() {
        let lapsed = |round_trip_secs: f64| {
            let (mut client, mut asks) = (LeaseClient::new("me", 3, None, Leadership::default()), Asks::new(3));
            client.step(Stamp::from_secs(1.0), HEARD, &mut asks);
            let (ticket, _) = asks.take_new().pop().unwrap();
            let lease = LeaseReply {
                epoch: 7,
                ttl_secs: 1.0,
                boot_id: String::new(),
                round_trip_secs: Some(round_trip_secs),
            };
            asks.answer(ticket, Ok(Answer::Lease(lease)));
            client.step(Stamp::from_secs(1.1), HEARD, &mut asks);
            let mut state = EdgeState::default();
            (state.lease.epoch, state.lease.holder) = (7, Some("me".into()));
            client.observe(Stamp::from_secs(1.2), &state);
            assert_eq!(client.epoch(), None);
            client.why_not().to_owned()
        };
        assert!(lapsed(10.0).contains("over a round trip of 10 s"), "{}", lapsed(10.0));
        assert_eq!(lapsed(9.0), "the lease has lapsed");
    }

    #[test]
    fn a_mission_that_has_slept_does_not_command_before_it_has_asked_again() {
        let (mut client, mut asks) = granted(1.0);
        assert!(client.step(Stamp::from_secs(1.05), HEARD, &mut asks).is_some());
        assert_eq!(client.step(Stamp::from_secs(21.0), HEARD, &mut asks), None);
        assert_eq!(client.epoch(), None);
        assert_eq!(asks.take_new().len(), 1);
    }

    #[test]
    fn a_mission_that_was_busy_while_heartbeats_went_out_keeps_its_lease() {
        let (mut client, mut asks) = granted(1.0);
        assert!(client.step(Stamp::from_secs(1.05), HEARD, &mut asks).is_some());
        client.was_kept_alive(Stamp::from_secs(9.0));
        assert!(client.step(Stamp::from_secs(9.05), HEARD, &mut asks).is_some());
        assert_eq!((client.epoch(), asks.take_new().len()), (Some(7), 0));
    }

    #[test]
    fn a_leader_that_has_slept_while_others_could_take_over_leads_again_on_the_robot_s_word_alone() {
        for shared in [false, true] {
            let (mut client, mut asks) = granted(1.0);
            client.step(Stamp::from_secs(1.05), HEARD, &mut asks);
            assert_eq!((client.leads(), client.term()), (true, Some(7)));
            client.share(shared);
            client.step(Stamp::from_secs(21.0), HEARD, &mut asks);
            assert_eq!(client.leads(), !shared);
            let (ticket, _) = asks.take_new().pop().unwrap();
            let held = |leader: &str| Refusal::Held {
                holder: "operator".into(),
                role: LeaseRole::Operator,
                epoch: 9,
                leader: Some(Leader {
                    store: leader.into(),
                    epoch: 7,
                    caught_up: vec![leader.into()],
                    revision: 0,
                }),
            };
            asks.answer(ticket, Err(NoAnswer::Refused(held("mine"))));
            client.step(Stamp::from_secs(21.05), HEARD, &mut asks);
            assert!(client.leads(), "it leads while an operator commands");
            client.step(Stamp::from_secs(21.6), HEARD, &mut asks);
            let (ticket, _) = asks.take_new().pop().unwrap();
            asks.answer(ticket, Err(NoAnswer::Refused(held("another"))));
            client.step(Stamp::from_secs(21.65), HEARD, &mut asks);
            assert!(client.is_deposed() && !client.leads());
        }
    }

    #[test]
    fn a_mission_whose_goals_another_store_may_have_newer_leads_only_once_it_was_granted() {
        let leadership = Leadership { epoch: 5, shared: true };
        let mut client = LeaseClient::new("me", 3, Some("mine".into()), leadership);
        let mut asks = Asks::new(3);
        client.step(Stamp::from_secs(1.0), HEARD, &mut asks);
        assert!(!client.leads() && !client.is_deposed());
        let (ticket, _) = asks.take_new().pop().unwrap();
        let refusal = Refusal::NotCaughtUp {
            caught_up: vec!["other".into()],
        };
        asks.answer(ticket, Err(NoAnswer::Refused(refusal)));
        client.step(Stamp::from_secs(1.05), HEARD, &mut asks);
        assert!(client.is_deposed());
    }
}
