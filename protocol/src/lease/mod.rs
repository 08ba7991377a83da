//! Lease arbiter. Who may command a robot, and which mission may lead?
//!
//! The robot decides, from the age of the holder's last heartbeat on its own clock. Every grant to another holder gets a higher epoch, also
//! across restarts of the edge, and every command carries the epoch. An operator outranks a mission; two missions never hold the lease at
//! once.
//!
//! The leader is the mission that keeps the robot's goals. A mission may lead only if its store holds everything that the last leader
//! acknowledged, according to that leader's own report. So goals survive the loss of their orchestrator's machine, and no two orchestrators
//! acknowledge goals independently.
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
//! # Slow links
//!
//! A grant's first heartbeat arrives a whole round trip after it. Until then the grant's time to live is extended by the round trip
//! measured from the request, at most [`LONGEST_ROUND_TRIP`]. From the first heartbeat on, the time to live is the same on any link,
//! because heartbeats arrive at the rate at which they were sent, however late.
//!
//! No other holder can get the lease meanwhile: there is one arbiter, on the robot, and it grants nothing while a grant is live. The cost
//! is that a holder that dies right after its request keeps others out for longer. The robot does not move on its behalf meanwhile: the
//! validity of its plan ends as before, by the robot's own clock and the state that the plan was made from.
//!
//! Source: Gray and Cheriton, "Leases", SOSP 1989; fencing by epoch as in Burrows, "The Chubby lock service", OSDI 2006; the arbiter
//! of who has caught up as in Lin et al., "PacificA", Microsoft Research 2008.

use std::time::Duration;

use crate::messages::{Heartbeat, Leader, LeaseAction, LeaseRequest, LeaseRole, LeaseState, Refusal};
use crate::time::Stamp;

/// Longest round trip by which a grant is extended.
pub const LONGEST_ROUND_TRIP: Duration = Duration::from_secs(10);
/// Decay of the recent longest round trip: share of the excess kept from one heartbeat to the next; half is left after 3 s.
const FORGETS: f64 = 0.977;
/// Largest step between two reports of one leadership on which stores have caught up. A leader numbers its reports consecutively, and
/// starts 2^32 higher after each restart. A report with a larger step is invalid: accepting it would make every later report an old one.
const LONGEST_STEP: u64 = 1000 << 32;
/// Largest number of the first report of a leadership: a million restarts.
const GREATEST_FIRST: u64 = (1 << 20) << 32;

/// Decides who holds the lease of one robot, and which mission leads.
#[derive(Clone, Debug)]
pub struct LeaseArbiter {
    ttl: Duration,
    epoch: u64,
    grant: Option<Grant>,
    leader: Option<Leader>,
    /// Time at which the leader was last heard.
    leader_heard: Option<Stamp>,
    /// Recent maximum.
    round_trip: Option<Duration>,
}

#[derive(Clone, Debug)]
struct Grant {
    holder: String,
    role: LeaseRole,
    store: Option<String>,
    renewed: Stamp,
    heartbeat: u64,
    /// Extension of the time to live until the first heartbeat.
    extra: Duration,
}

/// Result of a granted request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Granted {
    /// The new epoch. Store it before replying: it must survive a restart.
    pub epoch: u64,
    /// Whether the holder changed: commands of the previous one are void.
    pub holder_changed: bool,
    /// Round trip to the requester and back, from the request's echo.
    pub round_trip: Option<Duration>,
}

impl LeaseArbiter {
    /// An arbiter after a restart: there is no holder, epochs continue above `last_epoch`, and `leader` still leads.
    #[must_use]
    pub const fn new(ttl: Duration, last_epoch: u64, leader: Option<Leader>) -> Self {
        Self {
            ttl,
            epoch: last_epoch,
            grant: None,
            leader,
            leader_heard: None,
            round_trip: None,
        }
    }

    /// Answers a request for the lease.
    ///
    /// # Errors
    /// [`Refusal::Held`] while a holder of the same or a higher rank has a live lease; [`Refusal::NotCaughtUp`] for a mission that may not
    /// lead; [`Refusal::NotLeader`] for a report by a mission that does not lead under that epoch; [`Refusal::Rejected`] for a report whose
    /// number increases by too much.
    pub fn request(&mut self, now: Stamp, request: &LeaseRequest) -> Result<Granted, Refusal> {
        let granted = self.decide(now, request)?;
        Ok(Granted {
            round_trip: measured(now, request.echo),
            ..granted
        })
    }

    fn decide(&mut self, now: Stamp, request: &LeaseRequest) -> Result<Granted, Refusal> {
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
                    let most = match leader.revision {
                        0 => GREATEST_FIRST,
                        last => last.saturating_add(LONGEST_STEP),
                    };
                    if report.revision > most {
                        return Err(Refusal::rejected(format!(
                            "report {} on who has caught up leaps from {}: expected at most {most}",
                            report.revision, leader.revision
                        )));
                    }
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
        let extra = measured(now, request.echo).unwrap_or_default();
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
        // After a lapse even the same holder gets a new epoch: commands sent before the lapse are void. The plan in progress stays in
        // force, because the holder is the same.
        self.epoch += 1;
        self.round_trip = None;
        self.grant = Some(Grant {
            holder: request.holder.clone(),
            role: request.role,
            store: request.store.clone(),
            renewed: now,
            heartbeat: 0,
            extra,
        });
        if let Some(store) = store {
            self.lead(now, store.clone());
        }
        Ok(self.granted(!ours))
    }

    /// Whether a mission that has caught up may replace a silent leader while an operator holds the lease.
    fn may_follow(&self, now: Stamp, role: LeaseRole, store: &String) -> bool {
        let listed = |leader: &Leader| leader.store != *store && leader.caught_up.contains(store);
        role == LeaseRole::Operator && !self.leader_is_live(now) && self.leader.as_ref().is_some_and(listed)
    }

    /// Whether the leader was heard recently. A leader without the lease requests it twice within the time to live.
    fn leader_is_live(&self, now: Stamp) -> bool {
        let patience = 2 * self.ttl + self.round_trip.unwrap_or_default();
        self.leader_heard.is_some_and(|heard| now.since(heard) <= patience)
    }

    /// Makes this store's mission the leader. No standby has caught up with it yet; its own reports will list them.
    fn lead(&mut self, now: Stamp, store: String) {
        self.leader_heard = Some(now);
        // A report names its epoch, so the numbering restarts with a new epoch.
        let before = self.leader.as_ref().filter(|leader| leader.epoch == self.epoch);
        self.leader = Some(Leader {
            epoch: self.epoch,
            caught_up: vec![store.clone()],
            revision: before.map_or(0, |leader| leader.revision),
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
            round_trip: None,
        }
    }

    /// Renews the lease by a heartbeat; `false` for a heartbeat of another holder or epoch, a replayed one, or one after the lapse.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use zenav_protocol::lease::LeaseArbiter;
    /// # use zenav_protocol::messages::{Heartbeat, LeaseAction, LeaseRequest, LeaseRole, Refusal};
    /// # use zenav_protocol::time::Stamp;
    /// let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    /// let request = LeaseRequest::new("mission-a", LeaseRole::Mission, LeaseAction::Acquire, "r1");
    /// let epoch = arbiter.request(Stamp::ZERO, &request)?.epoch;
    /// let heartbeat = Heartbeat { holder: "mission-a".into(), epoch, counter: 1, echo: None };
    /// assert!(arbiter.renew(Stamp::from_secs(0.9), &heartbeat));
    /// assert!(!arbiter.renew(Stamp::from_secs(1.0), &heartbeat), "a repeated heartbeat renews nothing");
    /// assert!(arbiter.is_live(Stamp::from_secs(1.9)) && !arbiter.is_live(Stamp::from_secs(2.0)));
    /// # Ok::<(), Refusal>(())
    /// ```
    pub fn renew(&mut self, now: Stamp, heartbeat: &Heartbeat) -> bool {
        let live = self.is_live(now);
        match &mut self.grant {
            Some(grant)
                if live
                    && heartbeat.epoch == self.epoch
                    && grant.holder == heartbeat.holder
                    && heartbeat.counter > grant.heartbeat =>
            {
                grant.heartbeat = heartbeat.counter;
                grant.renewed = now;
                grant.extra = Duration::ZERO;
                if let Some(new) = measured(now, heartbeat.echo) {
                    let excess = self.round_trip.unwrap_or_default().saturating_sub(new);
                    self.round_trip = Some(new + excess.mul_f64(FORGETS));
                }
                if grant.store.is_some() {
                    self.leader_heard = Some(now);
                }
                true
            }
            _ => false,
        }
    }

    /// Renews the lease by a command of the holder that the caller has admitted.
    pub fn heard(&mut self, now: Stamp) {
        if self.is_live(now)
            && let Some(grant) = &mut self.grant
        {
            grant.renewed = now;
        }
    }

    /// Whether a command with this epoch may act now.
    #[must_use]
    pub fn admits(&self, now: Stamp, epoch: u64) -> bool {
        epoch == self.epoch && self.is_live(now)
    }

    /// Whether the lease has a holder and was renewed within its time to live.
    #[must_use]
    pub fn is_live(&self, now: Stamp) -> bool {
        self.grant
            .as_ref()
            .is_some_and(|grant| now.since(grant.renewed) <= self.ttl + grant.extra)
    }

    /// Recent maximum of the round trip to the holder and back; `None` before its first heartbeat with an echo.
    #[must_use]
    pub const fn round_trip(&self) -> Option<Duration> {
        self.round_trip
    }

    /// Role of the present or last holder.
    #[must_use]
    pub fn role(&self) -> Option<LeaseRole> {
        self.grant.as_ref().map(|grant| grant.role)
    }

    /// Time since the last renewal; `None` without a holder.
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

/// The round trip that results from an echo of the robot's time, capped at [`LONGEST_ROUND_TRIP`].
#[must_use]
pub fn measured(now: Stamp, echo: Option<Stamp>) -> Option<Duration> {
    Some(now.since(echo?).min(LONGEST_ROUND_TRIP))
}

#[cfg(test)]
mod tests;
