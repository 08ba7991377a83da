//! Dead-man's switch of a browser. Does the person still hold the key?
//!
//! A browser repeats its command while the key is held. A command acts for [`HOLD_SECS`] after its arrival; the robot has its own
//! dead-man's switch, based on the echo of its newest stamp.

use zenav_protocol::geometry::Twist2;

/// How long a command acts, s.
pub const HOLD_SECS: f64 = 0.3;

/// A command, and the time until which it acts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    twist: Twist2,
    until: f64,
}

impl Hold {
    /// A command that arrived at `now`, in seconds of the gateway's own clock; one that is not finite becomes a stop.
    ///
    /// ```
    /// use zenav_gateway::Hold;
    /// use zenav_protocol::geometry::Twist2;
    ///
    /// let nonsense = Hold::new(Twist2::new(f64::NAN, 0.5), 10.0);
    /// assert_eq!(nonsense.twist(10.0), Twist2::ZERO);
    /// ```
    #[must_use]
    pub fn new(twist: Twist2, now: f64) -> Self {
        let twist = if twist.is_finite() { twist } else { Twist2::ZERO };
        Self {
            twist,
            until: now + HOLD_SECS,
        }
    }

    /// The command at `now`: rest, unless it was repeated in time.
    ///
    /// ```
    /// use zenav_gateway::{HOLD_SECS, Hold};
    /// use zenav_protocol::geometry::Twist2;
    ///
    /// let ahead = Twist2::new(0.4, 0.0);
    /// let hold = Hold::new(ahead, 10.0);
    /// assert_eq!((hold.twist(10.0 + HOLD_SECS), hold.twist(10.4)), (ahead, Twist2::ZERO), "the key was released");
    /// ```
    #[must_use]
    pub fn twist(&self, now: f64) -> Twist2 {
        if now <= self.until { self.twist } else { Twist2::ZERO }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_that_is_not_held_any_more_is_rest() {
        let hold = Hold::new(Twist2::new(0.5, 0.1), 10.0);
        assert_eq!(hold.twist(10.2).v, 0.5);
        assert_eq!(hold.twist(10.31), Twist2::ZERO);
        assert_eq!(Hold::new(Twist2::new(f64::NAN, 0.0), 10.0).twist(10.0), Twist2::ZERO);
    }
}
