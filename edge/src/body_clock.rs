//! Body clock. Which readings carry the body's true time?
//!
//! The robot's clock is the stamp of its readings, so a single message stamped far in the future would make every later one old. A step
//! longer than a bound is a leap: it is accepted only when several messages in a row continue from there, as they do after a pause of the
//! link. A message in between that continues from the old time shows that the leap was false.

use thiserror::Error;
use zenav_protocol::time::Stamp;

/// Number of messages in a row that confirm a leap, or a first stamp.
const CONFIRMS: u32 = 3;

/// Follows the stamps of a body.
#[derive(Clone, Debug)]
pub struct BodyClock {
    /// Longest step accepted at once, s.
    longest_step: f64,
    shown: Option<Stamp>,
    /// A possible leap: its newest stamp, and how many messages support it.
    leap: Option<(Stamp, u32)>,
}

/// Why readings are not used.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum NotNow {
    /// They are not newer than the last readings used.
    #[error("readings of {got:.3} s after those of {shown:.3} s: if its time began anew, restart the edge")]
    Old {
        /// Their stamp, s.
        got: f64,
        /// The newest that was used, s.
        shown: f64,
    },
    /// They leap ahead, and nothing has confirmed it yet.
    #[error(
        "readings of {got:.3} s, {ahead:.3} s after the last ones: a leap of more than {longest} s is not believed"
    )]
    Leap {
        /// Their stamp, s.
        got: f64,
        /// How far they leap, s.
        ahead: f64,
        /// The longest step, s.
        longest: f64,
    },
    /// They are the last ones again, and have been for too long.
    #[error("only the readings of {0:.3} s again and again: the body has no new ones")]
    Repeated(f64),
    /// They are the first, and nothing has confirmed them yet.
    #[error("the first readings, of {0:.3} s, are not confirmed yet")]
    First(f64),
}

impl BodyClock {
    /// A clock that has shown nothing yet, for steps of at most `longest_step` s.
    #[must_use]
    pub fn new(longest_step: f64) -> Self {
        Self {
            longest_step,
            shown: None,
            leap: None,
        }
    }

    /// Judges the stamp of readings; if accepted, the clock shows it from then on.
    ///
    /// ```
    /// use zenav_edge::body_clock::{BodyClock, NotNow};
    /// use zenav_protocol::time::Stamp;
    ///
    /// let mut clock = BodyClock::new(1.0);
    /// let mut judge = |secs| clock.judge(Stamp::from_secs(secs));
    /// let first: Vec<bool> = [0.02, 0.04, 0.06, 0.08].map(|secs| judge(secs).is_ok()).to_vec();
    /// assert_eq!(first, [false, false, true, true], "two more confirm the first");
    /// assert!(matches!(judge(60.0), Err(NotNow::Leap { .. })));
    /// assert_eq!(judge(0.1), Ok(()), "the leap was false");
    /// ```
    ///
    /// # Errors
    /// [`NotNow`]: the readings must not be used.
    pub fn judge(&mut self, stamp: Stamp) -> Result<(), NotNow> {
        let follows = |before: Stamp| stamp > before && stamp.secs_since(before) <= self.longest_step;
        if self.shown.is_some_and(follows) {
            (self.shown, self.leap) = (Some(stamp), None);
            return Ok(());
        }
        if let Some(shown) = self.shown.filter(|shown| stamp <= *shown) {
            self.leap = None;
            let (got, shown) = (stamp.as_secs(), shown.as_secs());
            return Err(NotNow::Old { got, shown });
        }
        let count = match self.leap {
            Some((before, count)) if stamp == before => count,
            Some((before, count)) if follows(before) => count + 1,
            _ => 1,
        };
        if count >= CONFIRMS {
            (self.shown, self.leap) = (Some(stamp), None);
            return Ok(());
        }
        self.leap = Some((stamp, count));
        Err(match self.shown {
            None => NotNow::First(stamp.as_secs()),
            Some(shown) => NotNow::Leap {
                got: stamp.as_secs(),
                ahead: stamp.secs_since(shown),
                longest: self.longest_step,
            },
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn at(secs: f64) -> Stamp {
        Stamp::from_secs(secs)
    }

    /// A clock that shows one second.
    fn running() -> BodyClock {
        let mut clock = BodyClock::new(1.0);
        for tick in 1..=50 {
            let _ = clock.judge(at(0.02 * f64::from(tick)));
        }
        assert_eq!(clock.shown, Some(at(1.0)));
        clock
    }

    #[test]
    fn one_stamp_of_the_far_future_changes_nothing() {
        for forged in [Stamp(u64::MAX), at(1e6), at(2.5)] {
            let mut clock = running();
            assert!(matches!(clock.judge(forged), Err(NotNow::Leap { .. })));
            assert_eq!(clock.judge(at(1.02)), Ok(()));
            assert!(clock.judge(forged).is_err() && clock.judge(forged).is_err());
            assert_eq!(clock.judge(at(1.04)), Ok(()), "the same stamp again confirms nothing");
        }
    }

    #[test]
    fn a_repeated_stamp_neither_confirms_a_leap_nor_denies_it() {
        let mut clock = running();
        for secs in [60.0, 60.0, 60.02, 60.02] {
            assert!(clock.judge(at(secs)).is_err());
        }
        assert_eq!(clock.judge(at(60.04)), Ok(()));
    }

    #[test]
    fn a_pause_of_the_link_is_a_leap_that_is_soon_believed() {
        let mut clock = running();
        assert!(clock.judge(at(60.0)).is_err() && clock.judge(at(60.02)).is_err());
        assert_eq!(clock.judge(at(60.04)), Ok(()));
        assert_eq!(clock.judge(at(60.06)), Ok(()));
    }

    #[test]
    fn a_forged_first_stamp_does_not_make_the_time() {
        let mut clock = BodyClock::new(1.0);
        assert_eq!(
            clock.judge(Stamp(u64::MAX)),
            Err(NotNow::First(Stamp(u64::MAX).as_secs()))
        );
        let judged: Vec<bool> = (1..=5)
            .map(|tick| clock.judge(at(0.02 * f64::from(tick))).is_ok())
            .collect();
        assert_eq!(judged, [false, false, true, true, true]);
    }

    #[test]
    fn old_and_repeated_stamps_are_refused() {
        let mut clock = running();
        for old in [0.5, 1.0] {
            assert!(matches!(clock.judge(at(old)), Err(NotNow::Old { .. })));
        }
        assert_eq!(clock.judge(at(1.02)), Ok(()));
    }
}
