//! Does a twist by hand still count? Only from the operator's own epoch, echoing a fresh edge stamp, newer than all before, and until
//! that stamp is a dead-man's time old: what was recorded and is sent again moves nothing.

use std::mem::{Discriminant, discriminant};

use thiserror::Error;
use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{EventKind, Teleop};
use zenav_protocol::time::Stamp;

use crate::authority::Authority;
use crate::event_log::EventLog;

/// Least time between two events about the same cause, s.
const TOLD: f64 = 10.0;

/// Why a twist by hand does not count.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Dropped {
    /// Of an earlier holder, or made up.
    #[error("its epoch is {got}, the current one is {current}")]
    WrongEpoch {
        /// The message's.
        got: u64,
        /// The robot's.
        current: u64,
    },
    /// Nobody drives by hand now.
    #[error("no operator holds a live lease")]
    NoOperator,
    /// Infinite, or not a number.
    #[error("its twist is not finite")]
    NotFinite,
    /// Its echo is from the future.
    #[error("it echoes a stamp that this robot has not sent yet")]
    NotSentYet,
    /// Its echo is from long ago.
    #[error("it echoes a stamp {age:.2} s old, more than {dead_man} s")]
    Old {
        /// s.
        age: f64,
        /// s.
        dead_man: f64,
    },
    /// Out of order, or sent again.
    #[error("a later one came before it")]
    Overtaken,
    /// Which of two came first cannot be told.
    #[error("another one had the same echo: only a stop counts then")]
    SameEcho,
}

/// The operator's stick with a dead-man's switch.
#[derive(Clone, Debug)]
pub struct DeadMan {
    dead_man: f64,
    /// The newest message that counted.
    newest: Option<Teleop>,
    /// Whether it still acts.
    held: bool,
    told: Vec<(Discriminant<Dropped>, Stamp)>,
}

impl DeadMan {
    /// Let go; a twist counts until the stamp that it echoes is `dead_man` seconds old.
    #[must_use]
    pub fn new(dead_man: f64) -> Self {
        Self {
            dead_man,
            newest: None,
            held: false,
            told: Vec::new(),
        }
    }

    /// Takes what arrived: those of the operator who holds the lease act and renew it. Why others do not is told, for each cause once in
    /// a while.
    pub fn hear(&mut self, now: Stamp, teleops: &[Teleop], authority: &mut Authority, journal: &mut EventLog) {
        for teleop in teleops {
            let taken = authority
                .admit_teleop(now, teleop.epoch)
                .and_then(|()| self.take(now, teleop));
            match taken {
                Ok(true) => authority.operator_commands(now),
                Ok(false) => {}
                Err(dropped) if self.is_news(now, &dropped) => journal.tell(
                    now,
                    EventKind::TeleopDropped {
                        reason: dropped.to_string(),
                    },
                ),
                Err(_) => {}
            }
        }
    }

    /// Takes a twist whose epoch is the operator's current one. Returns whether it is a new one: the same message again is harmless.
    ///
    /// # Errors
    /// [`Dropped`]. Of several messages with one echo the first counts, and a stop always: nobody can tell which was sent last.
    pub fn take(&mut self, now: Stamp, teleop: &Teleop) -> Result<bool, Dropped> {
        let age = now.secs_since(teleop.echo);
        if !teleop.twist.is_finite() {
            return Err(Dropped::NotFinite);
        }
        if age < 0.0 {
            return Err(Dropped::NotSentYet);
        }
        if age > self.dead_man {
            let dead_man = self.dead_man;
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

    /// Lets go at once.
    pub fn release(&mut self) {
        self.held = false;
    }

    /// Whether a motion has just ended because no command follows: told once.
    pub fn has_run_out(&mut self, now: Stamp) -> bool {
        let over = self.acting().filter(|teleop| !self.is_fresh(now, teleop));
        let moved = over.is_some_and(|teleop| teleop.twist != Twist2::ZERO);
        self.held &= over.is_none();
        moved
    }

    /// The twist wanted now.
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
        now.secs_since(teleop.echo) <= self.dead_man
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
    fn what_is_old_or_of_the_future_or_no_number_or_out_of_order_does_not_count() {
        let mut stick = DeadMan::new(0.3);
        let now = at(10.0);
        assert!(matches!(stick.take(now, &teleop(9.6, 0.5)), Err(Dropped::Old { .. })));
        assert_eq!(stick.take(now, &teleop(10.1, 0.5)), Err(Dropped::NotSentYet));
        assert_eq!(stick.take(now, &teleop(9.9, f64::NAN)), Err(Dropped::NotFinite));
        assert_eq!(stick.take(now, &teleop(9.9, 0.5)), Ok(true));
        assert_eq!(stick.take(now, &teleop(9.8, 0.1)), Err(Dropped::Overtaken));
        assert_eq!(stick.twist(now).v, 0.5);
    }

    #[test]
    fn a_twist_acts_until_its_echo_is_a_dead_mans_time_old_however_late_it_came() {
        let mut stick = DeadMan::new(0.3);
        assert_eq!(stick.take(at(10.2), &teleop(10.0, 0.5)), Ok(true));
        assert_eq!(stick.twist(at(10.29)).v, 0.5);
        assert!(!stick.has_run_out(at(10.29)));
        assert_eq!(stick.twist(at(10.31)), Twist2::ZERO);
        assert!(stick.has_run_out(at(10.31)));
        assert!(!stick.has_run_out(at(10.33)), "told once");
    }

    #[test]
    fn a_replay_never_moves_it_after_a_later_message() {
        let mut stick = DeadMan::new(0.3);
        let (drive, stop) = (teleop(10.0, 0.5), teleop(10.0, 0.0));
        assert_eq!(stick.take(at(10.05), &drive), Ok(true));
        assert_eq!(stick.take(at(10.06), &drive), Ok(false), "the same again is harmless");
        assert_eq!(stick.take(at(10.07), &teleop(10.0, 0.7)), Err(Dropped::SameEcho));
        assert_eq!(stick.take(at(10.08), &stop), Ok(true), "a stop always counts");
        assert_eq!(stick.take(at(10.09), &drive), Err(Dropped::SameEcho));
        assert_eq!(stick.twist(at(10.09)), Twist2::ZERO);
        assert_eq!(
            stick.take(at(10.15), &teleop(10.1, 0.4)),
            Ok(true),
            "a newer echo drives on"
        );
        stick.release();
        assert_eq!(stick.take(at(10.16), &teleop(10.1, 0.4)), Ok(false));
        assert_eq!(stick.twist(at(10.16)), Twist2::ZERO, "what was let go stays let go");
    }

    /// Stamps come every `period`, messages every 50 ms with the newest stamp heard; each way takes `way`.
    fn stutters(period: f64, way: f64) -> bool {
        let mut stick = DeadMan::new(0.3);
        let mut began = false;
        (0..2000_u32).any(|tick| {
            let now = 100.0 + f64::from(tick) * 0.005;
            let sent = now - way;
            if tick.is_multiple_of(10) {
                let echo = ((sent - way) / period).floor() * period;
                let _ = stick.take(at(now), &teleop(echo, 0.5));
            }
            let drives = stick.twist(at(now)) != Twist2::ZERO;
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
        assert!(stutters(0.02, 0.14), "slower than the dead-man's time");
    }

    #[test]
    fn why_a_message_was_dropped_is_told_once_in_a_while_for_each_cause() {
        let mut stick = DeadMan::new(0.3);
        let old = |age| Dropped::Old { age, dead_man: 0.3 };
        assert!(stick.is_news(at(1.0), &old(0.4)));
        assert!(!stick.is_news(at(1.1), &old(0.5)));
        assert!(stick.is_news(at(1.1), &Dropped::NotFinite));
        assert!(stick.is_news(at(11.1), &old(0.6)));
    }
}
