//! Does a twist by hand still count? Only from the operator's own epoch, echoing a fresh edge stamp, and not for long.

use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::Teleop;
use zenav_protocol::time::Stamp;

/// The operator's stick with a dead-man's switch.
#[derive(Clone, Debug)]
pub struct Stick {
    dead_man: f64,
    held: Option<(Stamp, Twist2)>,
    newest_echo: Stamp,
}

impl Stick {
    /// Let go; a twist counts for `dead_man` seconds.
    #[must_use]
    pub fn new(dead_man: f64) -> Self {
        Self {
            dead_man,
            held: None,
            newest_echo: Stamp::ZERO,
        }
    }

    /// Takes a twist whose epoch is the operator's current one. Returns whether it counts: one that is not finite,
    /// echoes a stamp from the future or older than the dead-man's time, or came out of order, does not.
    pub fn take(&mut self, now: Stamp, teleop: &Teleop) -> bool {
        let age = now.secs_since(teleop.echo);
        let counts =
            teleop.twist.is_finite() && (0.0..=self.dead_man).contains(&age) && teleop.echo >= self.newest_echo;
        if counts {
            self.newest_echo = teleop.echo;
            self.held = Some((now, teleop.twist));
        }
        counts
    }

    /// Lets go at once.
    pub fn release(&mut self) {
        self.held = None;
    }

    /// Whether a motion has just ended because no command follows: told once.
    pub fn has_run_out(&mut self, now: Stamp) -> bool {
        let over = self.held.filter(|(taken, _)| now.secs_since(*taken) > self.dead_man);
        if over.is_some() {
            self.held = None;
        }
        over.is_some_and(|(_, twist)| twist != Twist2::ZERO)
    }

    /// The twist wanted now.
    #[must_use]
    pub fn twist(&self, now: Stamp) -> Twist2 {
        self.held
            .filter(|(taken, _)| now.secs_since(*taken) <= self.dead_man)
            .map_or(Twist2::ZERO, |(_, twist)| twist)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn teleop(echo: f64, v: f64) -> Teleop {
        Teleop {
            epoch: 1,
            twist: Twist2::new(v, 0.0),
            echo: Stamp::from_secs(echo),
        }
    }

    #[test]
    fn an_old_echo_is_dropped_and_a_silent_operator_stops_the_robot() {
        let mut stick = Stick::new(0.3);
        let now = Stamp::from_secs(10.0);
        assert!(!stick.take(now, &teleop(9.6, 0.5)));
        assert!(!stick.take(now, &teleop(10.1, 0.5)), "an echo of the future");
        assert!(!stick.take(now, &teleop(9.9, f64::NAN)));
        assert!(stick.take(now, &teleop(9.9, 0.5)));
        assert!(!stick.take(now, &teleop(9.8, 0.1)), "out of order");
        assert_eq!(stick.twist(Stamp::from_secs(10.29)).v, 0.5);
        assert!(!stick.has_run_out(Stamp::from_secs(10.29)));
        assert_eq!(stick.twist(Stamp::from_secs(10.31)), Twist2::ZERO);
        assert!(stick.has_run_out(Stamp::from_secs(10.31)));
        assert!(!stick.has_run_out(Stamp::from_secs(10.33)), "told once");
    }
}
