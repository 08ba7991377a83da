//! Lease arbiter. Who may command a robot, and which mission may lead?
//!
//! The robot decides, by the age of the holder's last heartbeat on its own clock. Every grant to another holder gets a higher epoch, also
//! across restarts of the edge, and every command carries the epoch. An operator outranks a mission; two missions never hold the lease at
//! once.
//!
//! To lead is to keep the robot's goals. The robot lets only a mission lead whose store holds everything that the last leader acknowledged,
//! by that leader's own report. So goals outlive their orchestrator's machine, and no two orchestrators acknowledge goals independently.
//!
//! ```
//! use std::time::Duration;
//! use zenav_protocol::lease::LeaseArbiter;
//! use zenav_protocol::messages::{LeaseAction, LeaseRequest, LeaseRole};
//! use zenav_protocol::time::Stamp;
//!
//! let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
//! let ask = |holder: &str, role| LeaseRequest::new(holder, role, LeaseAction::Acquire, "r1");
//! let granted = arbiter.request(Stamp::from_secs(0.0), &ask("mission-a", LeaseRole::Mission)).unwrap();
//! assert!(arbiter.admits(Stamp::from_secs(0.5), granted.epoch));
//! // A second mission is refused while the lease is live; an operator outranks the first.
//! assert!(arbiter.request(Stamp::from_secs(0.5), &ask("mission-b", LeaseRole::Mission)).is_err());
//! let operator = arbiter.request(Stamp::from_secs(0.5), &ask("anna", LeaseRole::Operator)).unwrap();
//! assert!(operator.epoch > granted.epoch && !arbiter.admits(Stamp::from_secs(0.6), granted.epoch));
//! ```
//!
//! Source: Gray and Cheriton, "Leases", SOSP 1989; fencing by epoch as in Burrows, "The Chubby lock service", OSDI 2006; the arbiter
//! of who has caught up as in Lin et al., "PacificA", Microsoft Research 2008.

use std::time::Duration;

use crate::messages::{Leader, LeaseAction, LeaseRequest, LeaseRole, LeaseState, Refusal};
use crate::time::Stamp;

/// Decides who holds the lease of one robot, and which mission leads.
#[derive(Clone, Debug)]
pub struct LeaseArbiter {
    ttl: Duration,
    epoch: u64,
    grant: Option<Grant>,
    leader: Option<Leader>,
    /// Time at which the leader was last heard.
    leader_heard: Option<Stamp>,
}

#[derive(Clone, Debug)]
struct Grant {
    holder: String,
    role: LeaseRole,
    store: Option<String>,
    renewed: Stamp,
    heartbeat: u64,
}

/// Result of a granted request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Granted {
    /// The epoch from now on. Store it before replying: it must survive a restart.
    pub epoch: u64,
    /// Whether the holder changed: commands of the previous one are void.
    pub holder_changed: bool,
}

impl LeaseArbiter {
    /// An arbiter after a restart: nobody holds the lease, epochs continue above `last_epoch`, and `leader` still leads.
    #[must_use]
    pub const fn new(ttl: Duration, last_epoch: u64, leader: Option<Leader>) -> Self {
        Self {
            ttl,
            epoch: last_epoch,
            grant: None,
            leader,
            leader_heard: None,
        }
    }

    /// Answers a request for the lease.
    ///
    /// # Errors
    /// [`Refusal::Held`] while somebody of the same or a higher rank holds a live lease; [`Refusal::NotCaughtUp`] for a mission that may not
    /// lead; [`Refusal::NotLeader`] for a report by a mission that does not lead under that epoch.
    pub fn request(&mut self, now: Stamp, request: &LeaseRequest) -> Result<Granted, Refusal> {
        match request.action {
            LeaseAction::Acquire => self.acquire(now, request),
            LeaseAction::Release => {
                let ours = self.is_held_by(request);
                if ours {
                    self.grant = None;
                }
                Ok(self.granted(ours))
            }
            LeaseAction::CaughtUp => match (&self.leader, &request.leads) {
                (Some(leader), Some(report))
                    if (&leader.store, leader.epoch) == (&report.store, report.epoch)
                        && report.revision > leader.revision =>
                {
                    self.leader = Some(report.clone());
                    self.leader_heard = Some(now);
                    Ok(self.granted(false))
                }
                _ => Err(Refusal::NotLeader),
            },
            LeaseAction::Forget => {
                if request.role != LeaseRole::Operator {
                    return Err(Refusal::rejected("only an operator may give up the goals of a leader"));
                }
                self.leader = None;
                Ok(self.granted(false))
            }
        }
    }

    fn acquire(&mut self, now: Stamp, request: &LeaseRequest) -> Result<Granted, Refusal> {
        let (ours, live) = (self.is_held_by(request), self.is_live(now));
        let store = request.store.as_ref().filter(|_| request.role == LeaseRole::Mission);
        if store.is_some() && store == self.leader.as_ref().map(|leader| &leader.store) {
            self.leader_heard = Some(now);
        }
        if let Some(grant) = &mut self.grant {
            // A mission with a store asks again only after a restart: its earlier grant is void.
            if ours && live && request.store.is_none() {
                grant.renewed = now;
                return Ok(self.granted(false));
            }
            let outranks = request.role == LeaseRole::Operator && grant.role == LeaseRole::Mission;
            if live && !ours && !outranks {
                let (holder, role) = (grant.holder.clone(), grant.role);
                if let Some(store) = store.filter(|store| self.may_follow(now, role, store)) {
                    self.lead(now, store.clone());
                }
                return Err(Refusal::Held {
                    holder,
                    role,
                    epoch: self.epoch,
                    leader: self.leader.clone(),
                });
            }
        }
        if let (Some(store), Some(leader)) = (store, &self.leader)
            && leader.store != *store
            && !leader.caught_up.contains(store)
        {
            return Err(Refusal::NotCaughtUp {
                caught_up: leader.caught_up.clone(),
            });
        }
        // After a lapse even the same holder gets a new epoch: commands sent before the lapse are void. The plan being finished stays,
        // for the holder is the same.
        self.epoch += 1;
        self.grant = Some(Grant {
            holder: request.holder.clone(),
            role: request.role,
            store: request.store.clone(),
            renewed: now,
            heartbeat: 0,
        });
        if let Some(store) = store {
            self.lead(now, store.clone());
        }
        Ok(self.granted(!ours))
    }

    /// Whether a mission that has caught up takes over from a silent leader while an operator holds the lease.
    fn may_follow(&self, now: Stamp, role: LeaseRole, store: &String) -> bool {
        let listed = |leader: &Leader| leader.store != *store && leader.caught_up.contains(store);
        role == LeaseRole::Operator && !self.leader_is_live(now) && self.leader.as_ref().is_some_and(listed)
    }

    /// Whether the leader was heard lately. A leader without the lease asks for it twice within the time to live.
    fn leader_is_live(&self, now: Stamp) -> bool {
        self.leader_heard.is_some_and(|heard| now.since(heard) <= 2 * self.ttl)
    }

    /// Makes this store's mission the leader. No standby has caught up with it yet; its own reports will name them.
    fn lead(&mut self, now: Stamp, store: String) {
        self.leader_heard = Some(now);
        self.leader = Some(Leader {
            epoch: self.epoch,
            caught_up: vec![store.clone()],
            revision: self.leader.as_ref().map_or(0, |leader| leader.revision),
            store,
        });
    }

    fn is_held_by(&self, request: &LeaseRequest) -> bool {
        self.grant.as_ref().is_some_and(|grant| {
            grant.holder == request.holder && grant.role == request.role && grant.store == request.store
        })
    }

    const fn granted(&self, holder_changed: bool) -> Granted {
        Granted {
            epoch: self.epoch,
            holder_changed,
        }
    }

    /// Renews the lease by a heartbeat; `false` for one of another holder or epoch, a replayed one, or one after the lapse.
    pub fn renew(&mut self, now: Stamp, holder: &str, epoch: u64, counter: u64) -> bool {
        let live = self.is_live(now);
        match &mut self.grant {
            Some(grant) if live && epoch == self.epoch && grant.holder == holder && counter > grant.heartbeat => {
                grant.heartbeat = counter;
                grant.renewed = now;
                if grant.store.is_some() {
                    self.leader_heard = Some(now);
                }
                true
            }
            _ => false,
        }
    }

    /// Renews the lease by a command of the holder, which the caller has admitted.
    pub fn heard(&mut self, now: Stamp) {
        if self.is_live(now)
            && let Some(grant) = &mut self.grant
        {
            grant.renewed = now;
        }
    }

    /// Whether a command of this epoch may act now.
    #[must_use]
    pub fn admits(&self, now: Stamp, epoch: u64) -> bool {
        epoch == self.epoch && self.is_live(now)
    }

    /// Whether somebody holds a lease that was renewed within its time to live.
    #[must_use]
    pub fn is_live(&self, now: Stamp) -> bool {
        self.grant
            .as_ref()
            .is_some_and(|grant| now.since(grant.renewed) <= self.ttl)
    }

    /// Role of the present or last holder.
    #[must_use]
    pub fn role(&self) -> Option<LeaseRole> {
        self.grant.as_ref().map(|grant| grant.role)
    }

    /// Time since the last renewal; `None` when nobody holds the lease.
    #[must_use]
    pub fn age(&self, now: Stamp) -> Option<Duration> {
        self.grant.as_ref().map(|grant| now.since(grant.renewed))
    }

    /// The current epoch.
    #[must_use]
    pub const fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Time to live of a lease without a heartbeat.
    #[must_use]
    pub const fn ttl(&self) -> Duration {
        self.ttl
    }

    /// The mission that keeps the robot's goals, if any ever did.
    #[must_use]
    pub const fn leader(&self) -> Option<&Leader> {
        self.leader.as_ref()
    }

    /// The lease as the robot's state shows it.
    #[must_use]
    pub fn state(&self, now: Stamp) -> LeaseState {
        LeaseState {
            holder: self.grant.as_ref().map(|grant| grant.holder.clone()),
            role: self.role(),
            epoch: self.epoch,
            live: self.is_live(now),
            leader: self.leader.clone(),
            leader_live: self.leader_is_live(now),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(holder: &str, role: LeaseRole, action: LeaseAction) -> LeaseRequest {
        LeaseRequest::new(holder, role, action, "r")
    }

    fn at(secs: f64) -> Stamp {
        Stamp::from_secs(secs)
    }

    const MISSION: LeaseRole = LeaseRole::Mission;
    const TAKE: LeaseAction = LeaseAction::Acquire;

    #[test]
    fn two_missions_never_hold_the_lease_at_once() {
        let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 41, None);
        assert_eq!(
            arbiter.request(at(0.0), &request("a", MISSION, TAKE)),
            Ok(Granted {
                epoch: 42,
                holder_changed: true
            })
        );
        assert!(matches!(
            arbiter.request(at(0.9), &request("b", MISSION, TAKE)),
            Err(Refusal::Held { .. })
        ));
        assert_eq!(
            arbiter.request(at(1.5), &request("b", MISSION, TAKE)),
            Ok(Granted {
                epoch: 43,
                holder_changed: true
            })
        );
        assert!(
            !arbiter.renew(at(1.6), "a", 42, 9),
            "the old holder's heartbeat renews nothing"
        );
        assert!(!arbiter.admits(at(1.6), 42) && arbiter.admits(at(1.6), 43));
    }

    #[test]
    fn a_lapsed_holder_must_ask_anew_and_gets_a_new_epoch() {
        let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
        arbiter.request(at(0.0), &request("a", MISSION, TAKE)).unwrap();
        assert!(arbiter.renew(at(0.5), "a", 1, 1));
        assert!(
            !arbiter.renew(at(0.6), "a", 1, 1),
            "a replayed heartbeat renews nothing"
        );
        assert!(
            !arbiter.renew(at(3.0), "a", 1, 2),
            "a heartbeat after the lapse renews nothing"
        );
        assert_eq!(
            arbiter.request(at(3.0), &request("a", MISSION, TAKE)),
            Ok(Granted {
                epoch: 2,
                holder_changed: false
            })
        );
    }

    #[test]
    fn a_command_renews_as_a_heartbeat_does_and_heartbeats_count_on() {
        let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
        arbiter
            .request(at(0.0), &request("a", LeaseRole::Operator, TAKE))
            .unwrap();
        arbiter.heard(at(0.8));
        assert!(arbiter.is_live(at(1.7)));
        assert!(arbiter.renew(at(1.7), "a", 1, 1));
        arbiter.heard(at(3.0));
        assert!(!arbiter.is_live(at(3.0)), "a command after the lapse renews nothing");
    }

    fn keeper(store: &str, action: LeaseAction) -> LeaseRequest {
        LeaseRequest {
            store: Some(store.into()),
            ..request(store, MISSION, action)
        }
    }

    fn caught_up(store: &str, epoch: u64, revision: u64, stores: &[&str]) -> LeaseRequest {
        LeaseRequest {
            leads: Some(Leader {
                store: store.into(),
                epoch,
                caught_up: stores.iter().map(|&store| store.into()).collect(),
                revision,
            }),
            ..keeper(store, LeaseAction::CaughtUp)
        }
    }

    #[test]
    fn only_a_mission_that_has_caught_up_leads_next() {
        let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
        arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
        let alone = Err(Refusal::NotCaughtUp {
            caught_up: vec!["a".into()],
        });
        assert_eq!(arbiter.request(at(2.0), &keeper("b", TAKE)), alone);
        arbiter.request(at(2.0), &caught_up("a", 1, 1, &["a", "b"])).unwrap();
        assert_eq!(arbiter.request(at(2.0), &keeper("b", TAKE)).unwrap().epoch, 2);
        // From now on the new leader is alone: the old one has missed what it writes.
        assert!(matches!(
            arbiter.request(at(4.0), &keeper("a", TAKE)),
            Err(Refusal::NotCaughtUp { .. })
        ));
        assert_eq!(
            arbiter.request(at(4.0), &caught_up("a", 1, 2, &["a"])),
            Err(Refusal::NotLeader),
            "a deposed leader's word counts no more"
        );
        // Not even over a restart of the robot.
        let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 2, arbiter.leader().cloned());
        assert!(arbiter.request(at(0.0), &keeper("a", TAKE)).is_err());
        arbiter
            .request(at(0.0), &request("me", LeaseRole::Operator, LeaseAction::Forget))
            .unwrap();
        assert!(arbiter.request(at(0.0), &keeper("a", TAKE)).is_ok());
    }

    #[test]
    fn a_leader_s_word_of_an_earlier_life_counts_no_more() {
        let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
        arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
        let again = arbiter.request(at(0.1), &keeper("a", TAKE)).unwrap();
        assert_eq!((again.epoch, again.holder_changed), (2, false));
        assert_eq!(
            arbiter.request(at(0.2), &caught_up("a", 1, 1, &["a", "b"])),
            Err(Refusal::NotLeader)
        );
        assert!(matches!(
            arbiter.request(at(2.0), &keeper("b", TAKE)),
            Err(Refusal::NotCaughtUp { .. })
        ));
    }

    #[test]
    fn who_keeps_no_goals_and_an_operator_change_nothing_in_who_leads() {
        let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
        arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
        arbiter
            .request(at(0.1), &request("me", LeaseRole::Operator, TAKE))
            .unwrap();
        arbiter.request(at(2.0), &request("simple", MISSION, TAKE)).unwrap();
        assert_eq!(arbiter.leader().map(|leader| leader.store.as_str()), Some("a"));
        let refused = arbiter.request(at(2.1), &keeper("b", TAKE));
        assert!(matches!(refused, Err(Refusal::Held { leader: Some(leader), .. }) if leader.store == "a"));
    }

    #[test]
    fn a_leader_s_word_that_comes_late_counts_no_more() {
        let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
        arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
        arbiter.request(at(0.1), &caught_up("a", 1, 2, &["a"])).unwrap();
        assert_eq!(
            arbiter.request(at(0.2), &caught_up("a", 1, 1, &["a", "b"])),
            Err(Refusal::NotLeader)
        );
        assert_eq!(arbiter.leader().unwrap().caught_up, ["a"]);
    }

    #[test]
    fn while_an_operator_commands_a_silent_leader_is_followed_by_one_that_has_caught_up() {
        let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
        arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
        arbiter.request(at(0.0), &caught_up("a", 1, 1, &["a", "b"])).unwrap();
        arbiter
            .request(at(0.5), &request("me", LeaseRole::Operator, TAKE))
            .unwrap();
        let leader = |answer: Result<Granted, Refusal>| match answer {
            Err(Refusal::Held { leader, .. }) => leader.unwrap().store,
            other => panic!("{other:?}"),
        };
        for tick in 1..=8_u32 {
            let now = at(0.5 + 0.5 * f64::from(tick));
            assert!(arbiter.renew(now, "me", 2, u64::from(tick)));
            let told = leader(arbiter.request(now, &keeper("b", TAKE)));
            assert_eq!(told, if tick < 4 { "a" } else { "b" }, "{tick}");
            assert!(arbiter.admits(now, 2), "the operator goes on");
        }
        assert_eq!(
            leader(arbiter.request(at(4.6), &keeper("a", TAKE))),
            "b",
            "the old leader hears of it"
        );
    }

    #[test]
    fn an_operator_outranks_a_mission_but_not_the_other_way_round() {
        let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
        arbiter.request(at(0.0), &request("a", MISSION, TAKE)).unwrap();
        arbiter
            .request(at(0.1), &request("me", LeaseRole::Operator, TAKE))
            .unwrap();
        assert!(matches!(
            arbiter.request(at(0.2), &request("a", MISSION, TAKE)),
            Err(Refusal::Held { .. })
        ));
        arbiter
            .request(at(0.3), &request("me", LeaseRole::Operator, LeaseAction::Release))
            .unwrap();
        assert_eq!(
            arbiter.request(at(0.4), &request("a", MISSION, TAKE)),
            Ok(Granted {
                epoch: 3,
                holder_changed: true
            })
        );
    }
}
