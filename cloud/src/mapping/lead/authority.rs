//! Command authority. Decides whether a request may change the map.
//!
//! While the robot's lease is held, only requests with its epoch may: a map must not be reset under a mission that drives by it. Without a
//! live lease any request may.

use std::time::Duration;

use zenav_protocol::messages::{LeaseRole, LeaseState, Refusal};
use zenav_protocol::time::Stamp;

/// A robot silent for longer than this (link lost) counts as gone, and its lease with it.
const SILENCE: Duration = Duration::from_secs(3);

/// The robot's last reported lease.
#[derive(Debug, Default)]
pub(super) struct Authority {
    heard: Option<(Stamp, LeaseState)>,
}

impl Authority {
    /// Takes the lease that the robot reports.
    pub(super) fn hear(&mut self, now: Stamp, lease: LeaseState) {
        self.heard = Some((now, lease));
    }

    /// Whether a request with this epoch may change the map.
    ///
    /// # Errors
    /// [`Refusal::WrongEpoch`] for another epoch than the robot's; [`Refusal::Rejected`] without one while the lease is held.
    pub(super) fn admit(&self, now: Stamp, epoch: Option<u64>) -> Result<(), Refusal> {
        let Some((_, lease)) = self.heard.as_ref().filter(|(at, _)| now.since(*at) <= SILENCE) else {
            return Ok(());
        };
        match epoch {
            Some(got) if got != lease.epoch => Err(Refusal::WrongEpoch {
                got,
                current: lease.epoch,
            }),
            None if lease.live => {
                let holder = lease.holder.as_deref().unwrap_or("somebody");
                let role = match lease.role {
                    Some(LeaseRole::Operator) => "operator",
                    Some(LeaseRole::Mission) | None => "mission",
                };
                Err(Refusal::rejected(format!(
                    "expected `epoch`: {holder} holds the lease ({role}, epoch {0}), and a request that changes the map must carry its epoch, \
                     as in {{\"action\": \"reset\", \"epoch\": {0}}}",
                    lease.epoch
                )))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn lease(epoch: u64, live: bool) -> LeaseState {
        LeaseState {
            holder: Some("mission-a".into()),
            role: Some(LeaseRole::Mission),
            epoch,
            live,
            ..LeaseState::default()
        }
    }

    fn at(secs: f64) -> Stamp {
        Stamp::from_secs(secs)
    }

    #[test]
    fn while_the_lease_is_held_only_its_epoch_changes_the_map() {
        let mut authority = Authority::default();
        authority.hear(at(1.0), lease(7, true));
        assert_eq!(authority.admit(at(1.1), Some(7)), Ok(()));
        assert_eq!(
            authority.admit(at(1.1), Some(6)),
            Err(Refusal::WrongEpoch { got: 6, current: 7 })
        );
        let refusal = authority.admit(at(1.1), None).unwrap_err().to_string();
        assert!(
            refusal.contains("expected `epoch`") && refusal.contains("mission-a") && refusal.contains("\"epoch\": 7"),
            "{refusal}"
        );
    }

    #[test]
    fn without_a_live_lease_plain_requests_change_the_map_and_deposed_holders_do_not() {
        let mut authority = Authority::default();
        assert_eq!(authority.admit(at(1.0), None), Ok(()), "nothing was heard of a robot");
        authority.hear(at(1.0), lease(7, false));
        assert_eq!(authority.admit(at(1.1), None), Ok(()));
        assert!(authority.admit(at(1.1), Some(6)).is_err());
        authority.hear(at(2.0), lease(7, true));
        assert!(authority.admit(at(5.0), None).is_err());
        assert_eq!(
            authority.admit(at(5.1), None),
            Ok(()),
            "a robot that is gone holds no lease"
        );
    }
}
