//! Who may command a robot? Decided on the robot, by the age of the holder's last heartbeat on the robot's own clock.
//!
//! Every grant to another holder gets a higher epoch, also across restarts of the edge; every command carries it.
//! An operator outranks a mission; two missions never hold a lease at once.
//!
//! Source: Gray and Cheriton, "Leases", SOSP 1989; fencing by epoch as in Burrows, "The Chubby lock service", OSDI 2006.

use std::time::Duration;

use crate::messages::{LeaseAction, LeaseRequest, LeaseRole, LeaseState, Refusal};
use crate::time::Stamp;

/// The current grant of one robot.
#[derive(Clone, Debug)]
pub struct LeaseBook {
    ttl: Duration,
    epoch: u64,
    grant: Option<Grant>,
}

#[derive(Clone, Debug)]
struct Grant {
    holder: String,
    role: LeaseRole,
    renewed: Stamp,
    heartbeat: u64,
}

/// What a granted request changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Granted {
    /// The epoch from now on; store it before telling anybody.
    pub epoch: u64,
    /// Whether another holder than before may command now: whatever the old one had sent is void.
    pub holder_changed: bool,
}

impl LeaseBook {
    /// No grant; epochs go on above `last_epoch`, the greatest that was ever granted.
    #[must_use]
    pub const fn new(ttl: Duration, last_epoch: u64) -> Self {
        Self {
            ttl,
            epoch: last_epoch,
            grant: None,
        }
    }

    /// Answers a request for the lease.
    ///
    /// # Errors
    /// [`Refusal::Held`] while somebody of the same or a higher rank holds a live lease.
    pub fn request(&mut self, now: Stamp, request: &LeaseRequest) -> Result<Granted, Refusal> {
        let ours = self
            .grant
            .as_ref()
            .is_some_and(|grant| grant.holder == request.holder && grant.role == request.role);
        match request.action {
            LeaseAction::Release => {
                if ours {
                    self.grant = None;
                }
                Ok(Granted {
                    epoch: self.epoch,
                    holder_changed: ours,
                })
            }
            LeaseAction::Acquire => {
                let live = self.is_live(now);
                if let Some(grant) = &mut self.grant {
                    if ours && live {
                        grant.renewed = now;
                        return Ok(Granted {
                            epoch: self.epoch,
                            holder_changed: false,
                        });
                    }
                    let outranks = request.role == LeaseRole::Operator && grant.role == LeaseRole::Mission;
                    if live && !outranks {
                        return Err(Refusal::Held {
                            holder: grant.holder.clone(),
                            role: grant.role,
                            epoch: self.epoch,
                        });
                    }
                }
                // A lapsed lease gets a new epoch even for its old holder: what was sent before the lapse is void. The
                // plan being finished stays: the holder is the same.
                self.epoch += 1;
                self.grant = Some(Grant {
                    holder: request.holder.clone(),
                    role: request.role,
                    renewed: now,
                    heartbeat: 0,
                });
                Ok(Granted {
                    epoch: self.epoch,
                    holder_changed: !ours,
                })
            }
        }
    }

    /// Renews by a heartbeat; returns whether it counted. One of another epoch or holder, or an old one, does not.
    pub fn renew(&mut self, now: Stamp, holder: &str, epoch: u64, counter: u64) -> bool {
        let live = self.is_live(now);
        match &mut self.grant {
            Some(grant) if live && epoch == self.epoch && grant.holder == holder && counter > grant.heartbeat => {
                grant.heartbeat = counter;
                grant.renewed = now;
                true
            }
            _ => false,
        }
    }

    /// Whether a command of an epoch may act now.
    #[must_use]
    pub fn admits(&self, now: Stamp, epoch: u64) -> bool {
        epoch == self.epoch && self.is_live(now)
    }

    /// Whether somebody holds a lease that has been renewed within its time to live.
    #[must_use]
    pub fn is_live(&self, now: Stamp) -> bool {
        self.grant
            .as_ref()
            .is_some_and(|grant| now.since(grant.renewed) <= self.ttl)
    }

    /// The role of whoever holds or last held the lease.
    #[must_use]
    pub fn role(&self) -> Option<LeaseRole> {
        self.grant.as_ref().map(|grant| grant.role)
    }

    /// Time since the last renewal; `None` when nobody has the lease.
    #[must_use]
    pub fn age(&self, now: Stamp) -> Option<Duration> {
        self.grant.as_ref().map(|grant| now.since(grant.renewed))
    }

    /// The current epoch.
    #[must_use]
    pub const fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Time to live of a grant without a heartbeat.
    #[must_use]
    pub const fn ttl(&self) -> Duration {
        self.ttl
    }

    /// The lease as the edge's state shows it.
    #[must_use]
    pub fn state(&self, now: Stamp) -> LeaseState {
        LeaseState {
            holder: self.grant.as_ref().map(|grant| grant.holder.clone()),
            role: self.role(),
            epoch: self.epoch,
            live: self.is_live(now),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(holder: &str, role: LeaseRole, action: LeaseAction) -> LeaseRequest {
        LeaseRequest {
            holder: holder.into(),
            role,
            action,
            request_id: "r".into(),
        }
    }

    fn at(secs: f64) -> Stamp {
        Stamp::from_secs(secs)
    }

    const MISSION: LeaseRole = LeaseRole::Mission;
    const TAKE: LeaseAction = LeaseAction::Acquire;

    #[test]
    fn two_missions_never_hold_the_lease_at_once() {
        let mut book = LeaseBook::new(Duration::from_secs(1), 41);
        assert_eq!(
            book.request(at(0.0), &request("a", MISSION, TAKE)),
            Ok(Granted {
                epoch: 42,
                holder_changed: true
            })
        );
        assert!(matches!(
            book.request(at(0.9), &request("b", MISSION, TAKE)),
            Err(Refusal::Held { .. })
        ));
        assert_eq!(
            book.request(at(1.5), &request("b", MISSION, TAKE)),
            Ok(Granted {
                epoch: 43,
                holder_changed: true
            })
        );
        assert!(
            !book.renew(at(1.6), "a", 42, 9),
            "the old holder's heartbeat renews nothing"
        );
        assert!(!book.admits(at(1.6), 42) && book.admits(at(1.6), 43));
    }

    #[test]
    fn a_lapsed_holder_must_ask_anew_and_gets_a_new_epoch() {
        let mut book = LeaseBook::new(Duration::from_secs(1), 0);
        book.request(at(0.0), &request("a", MISSION, TAKE)).unwrap();
        assert!(book.renew(at(0.5), "a", 1, 1));
        assert!(!book.renew(at(0.6), "a", 1, 1), "a replayed heartbeat renews nothing");
        assert!(
            !book.renew(at(3.0), "a", 1, 2),
            "a heartbeat after the lapse renews nothing"
        );
        assert_eq!(
            book.request(at(3.0), &request("a", MISSION, TAKE)),
            Ok(Granted {
                epoch: 2,
                holder_changed: false
            })
        );
    }

    #[test]
    fn an_operator_outranks_a_mission_but_not_the_other_way_round() {
        let mut book = LeaseBook::new(Duration::from_secs(1), 0);
        book.request(at(0.0), &request("a", MISSION, TAKE)).unwrap();
        book.request(at(0.1), &request("me", LeaseRole::Operator, TAKE))
            .unwrap();
        assert!(matches!(
            book.request(at(0.2), &request("a", MISSION, TAKE)),
            Err(Refusal::Held { .. })
        ));
        book.request(at(0.3), &request("me", LeaseRole::Operator, LeaseAction::Release))
            .unwrap();
        assert_eq!(
            book.request(at(0.4), &request("a", MISSION, TAKE)),
            Ok(Granted {
                epoch: 3,
                holder_changed: true
            })
        );
    }
}
