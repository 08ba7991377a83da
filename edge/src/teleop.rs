//! Teleop input with a dead-man switch. Does a teleop twist act? Only under the operator's epoch, echoing a fresh edge stamp, newer than
//! all before, and only until that stamp is older than the dead-man timeout: a replayed recording never moves the robot.

use std::mem::{Discriminant, discriminant};

use thiserror::Error;
use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{EventKind, Teleop};
use zenav_protocol::time::Stamp;

use crate::authority::Authority;
use crate::event_log::EventLog;

/// Least time between two events about the same cause, s.
const TOLD: f64 = 10.0;

/// Why a teleop message is dropped.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Dropped {
    /// It is of another epoch than the current one.
    #[error("epoch {got} is not the current epoch {current}")]
    WrongEpoch {
        /// Epoch of the message.
        got: u64,
        /// Epoch of the current lease.
        current: u64,
    },
    /// No operator holds the lease.
    #[error("no operator holds a live lease")]
    NoOperator,
    /// The twist is infinite or not a number.
    #[error("the twist is not finite")]
    NotFinite,
    /// The echoed stamp is in the future.
    #[error("the echoed stamp is in the future")]
    NotSentYet,
    /// The echoed stamp is too old.
    #[error("the echoed stamp is {age:.2} s old, older than the dead-man timeout of {dead_man} s")]
    Old {
        /// Age of the echoed stamp, s.
        age: f64,
        /// The timeout, s.
        dead_man: f64,
    },
    /// A newer message has acted already.
    #[error("a newer message has arrived before it")]
    Overtaken,
    /// Another message echoes the same stamp: their order is unknown.
    #[error("another message echoes the same stamp: only a stop is taken then")]
    SameEcho,
}

/// The newest teleop message, while the dead-man switch is held.
#[derive(Clone, Debug)]
pub struct DeadMan {
    timeout: f64,
    /// The newest message taken.
    newest: Option<Teleop>,
    /// Whether it may still act.
    held: bool,
    told: Vec<(Discriminant<Dropped>, Stamp)>,
}

impl DeadMan {
    /// Released; a twist acts until the stamp that it echoes is `dead_man` seconds old.
    #[must_use]
    pub fn new(dead_man: f64) -> Self {
        Self {
            timeout: dead_man,
            newest: None,
            held: false,
            told: Vec::new(),
        }
    }

    /// Takes the messages that arrived: those of the operator who holds the lease act and renew it. Others are dropped and the cause is
    /// recorded, rate-limited for each cause.
    pub fn receive(&mut self, now: Stamp, teleops: &[Teleop], authority: &mut Authority, events: &mut EventLog) {
        for teleop in teleops {
            let taken = authority
                .admit_teleop(now, teleop.epoch)
                .and_then(|()| self.take(now, teleop));
            match taken {
                Ok(true) => authority.renew_as_operator(now),
                Ok(false) => {}
                Err(dropped) if self.is_news(now, &dropped) => events.record(
                    now,
                    EventKind::TeleopDropped {
                        reason: dropped.to_string(),
                    },
                ),
                Err(_) => {}
            }
        }
    }

    /// Takes a message of the operator's current epoch. Returns whether it is new: the same message again has no effect.
    ///
    /// ```
    /// use zenav_edge::teleop::{DeadMan, Dropped};
    /// use zenav_protocol::{geometry::Twist2, messages::Teleop, time::Stamp};
    ///
    /// let mut dead_man = DeadMan::new(0.3);
    /// let teleop = Teleop { epoch: 1, twist: Twist2::new(0.2, 0.0), echo: Stamp::from_secs(10.0) };
    /// assert_eq!(dead_man.take(Stamp::from_secs(10.1), &teleop), Ok(true));
    /// assert_eq!(dead_man.twist(Stamp::from_secs(10.2)), teleop.twist);
    /// assert_eq!(dead_man.twist(Stamp::from_secs(10.4)), Twist2::ZERO, "the operator has let go, or the link is slow");
    /// assert!(matches!(dead_man.take(Stamp::from_secs(10.4), &teleop), Err(Dropped::Old { .. })));
    /// ```
    ///
    /// # Errors
    /// [`Dropped`]. Of several messages with one echo the first is taken, because their order is unknown; a stop is always taken.
    pub fn take(&mut self, now: Stamp, teleop: &Teleop) -> Result<bool, Dropped> {
        let age = now.secs_since(teleop.echo);
        if !teleop.twist.is_finite() {
            return Err(Dropped::NotFinite);
        }
        if age < 0.0 {
            return Err(Dropped::NotSentYet);
        }
        if age > self.timeout {
            let dead_man = self.timeout;
            return Err(Dropped::Old { age, dead_man });
        }
        if let Some(newest) = self.newest.as_ref().filter(|newest| newest.epoch == teleop.epoch) {
            if teleop.echo < newest.echo {
                return Err(Dropped::Overtaken);
            }
            if teleop == newest {
                return Ok(false);
            }
            if teleop.echo == newest.echo && teleop.twist != Twist2::ZERO {
                return Err(Dropped::SameEcho);
            }
        }
        self.newest = Some(teleop.clone());
        self.held = true;
        Ok(true)
    }

    fn is_news(&mut self, now: Stamp, dropped: &Dropped) -> bool {
        let cause = discriminant(dropped);
        match self.told.iter_mut().find(|(known, _)| *known == cause) {
            Some((_, told)) if now.secs_since(*told) < TOLD => return false,
            Some((_, told)) => *told = now,
            None => self.told.push((cause, now)),
        }
        true
    }

    /// Releases the switch at once.
    pub fn release(&mut self) {
        self.held = false;
    }

    /// Whether a motion has just timed out: true once.
    pub fn just_expired(&mut self, now: Stamp) -> bool {
        let over = self.acting().filter(|teleop| !self.is_fresh(now, teleop));
        let moved = over.is_some_and(|teleop| teleop.twist != Twist2::ZERO);
        self.held &= over.is_none();
        moved
    }

    /// The wanted twist now.
    #[must_use]
    pub fn twist(&self, now: Stamp) -> Twist2 {
        self.acting()
            .filter(|teleop| self.is_fresh(now, teleop))
            .map_or(Twist2::ZERO, |teleop| teleop.twist)
    }

    fn acting(&self) -> Option<&Teleop> {
        self.newest.as_ref().filter(|_| self.held)
    }

    fn is_fresh(&self, now: Stamp, teleop: &Teleop) -> bool {
        now.secs_since(teleop.echo) <= self.timeout
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(secs: f64) -> Stamp {
        Stamp::from_secs(secs)
    }

    fn teleop(echo: f64, v: f64) -> Teleop {
        Teleop {
            epoch: 1,
            twist: Twist2::new(v, 0.0),
            echo: at(echo),
        }
    }

    #[test]
    fn a_message_that_is_old_or_of_the_future_or_not_finite_or_out_of_order_is_dropped() {
        let mut switch = DeadMan::new(0.3);
        let now = at(10.0);
        assert!(matches!(switch.take(now, &teleop(9.6, 0.5)), Err(Dropped::Old { .. })));
        assert_eq!(switch.take(now, &teleop(10.1, 0.5)), Err(Dropped::NotSentYet));
        assert_eq!(switch.take(now, &teleop(9.9, f64::NAN)), Err(Dropped::NotFinite));
        assert_eq!(switch.take(now, &teleop(9.9, 0.5)), Ok(true));
        assert_eq!(switch.take(now, &teleop(9.8, 0.1)), Err(Dropped::Overtaken));
        assert_eq!(switch.twist(now).v, 0.5);
    }

    #[test]
    fn a_twist_acts_until_its_echo_is_older_than_the_timeout_however_late_it_came() {
        let mut switch = DeadMan::new(0.3);
        assert_eq!(switch.take(at(10.2), &teleop(10.0, 0.5)), Ok(true));
        assert_eq!(switch.twist(at(10.29)).v, 0.5);
        assert!(!switch.just_expired(at(10.29)));
        assert_eq!(switch.twist(at(10.31)), Twist2::ZERO);
        assert!(switch.just_expired(at(10.31)));
        assert!(!switch.just_expired(at(10.33)), "reported once");
    }

    #[test]
    fn a_replay_never_moves_it_after_a_later_message() {
        let mut switch = DeadMan::new(0.3);
        let (drive, stop) = (teleop(10.0, 0.5), teleop(10.0, 0.0));
        assert_eq!(switch.take(at(10.05), &drive), Ok(true));
        assert_eq!(
            switch.take(at(10.06), &drive),
            Ok(false),
            "the same message again has no effect"
        );
        assert_eq!(switch.take(at(10.07), &teleop(10.0, 0.7)), Err(Dropped::SameEcho));
        assert_eq!(switch.take(at(10.08), &stop), Ok(true), "a stop always counts");
        assert_eq!(switch.take(at(10.09), &drive), Err(Dropped::SameEcho));
        assert_eq!(switch.twist(at(10.09)), Twist2::ZERO);
        assert_eq!(
            switch.take(at(10.15), &teleop(10.1, 0.4)),
            Ok(true),
            "a newer echo drives on"
        );
        switch.release();
        assert_eq!(switch.take(at(10.16), &teleop(10.1, 0.4)), Ok(false));
        assert_eq!(switch.twist(at(10.16)), Twist2::ZERO, "released stays released");
    }

    /// Stamps come every `period`, messages every 50 ms with the newest stamp received; each way takes `way`. Whether the motion stutters.
    fn stutters(period: f64, way: f64) -> bool {
        let mut switch = DeadMan::new(0.3);
        let mut began = false;
        (0..2000_u32).any(|tick| {
            let now = 100.0 + f64::from(tick) * 0.005;
            let sent = now - way;
            if tick.is_multiple_of(10) {
                let echo = ((sent - way) / period).floor() * period;
                let _ = switch.take(at(now), &teleop(echo, 0.5));
            }
            let drives = switch.twist(at(now)) != Twist2::ZERO;
            began |= drives;
            began && !drives
        })
    }

    #[test]
    fn a_healthy_operator_never_stutters() {
        assert!(!stutters(0.1, 0.06), "who echoes the state, over 120 ms there and back");
        assert!(
            !stutters(0.02, 0.1),
            "who echoes every tick, over 200 ms there and back"
        );
        assert!(stutters(0.02, 0.14), "slower than the dead-man timeout");
    }

    #[test]
    fn a_drop_is_reported_once_in_a_while_for_each_cause() {
        let mut switch = DeadMan::new(0.3);
        let old = |age| Dropped::Old { age, dead_man: 0.3 };
        assert!(switch.is_news(at(1.0), &old(0.4)));
        assert!(!switch.is_news(at(1.1), &old(0.5)));
        assert!(switch.is_news(at(1.1), &Dropped::NotFinite));
        assert!(switch.is_news(at(11.1), &old(0.6)));
    }
}
