//! Keyboard teleoperation. Maps keys to motion and its duration: a terminal reports key presses and repeats, never releases.
//!
//! A first press lasts until the keyboard starts to repeat, a repeated press only until the next repeat is due: releasing a key stops the
//! robot within a fifth of a second. Pure: time is passed in.

use std::time::Duration;

use zenav_protocol::geometry::Twist2;

/// Longer than the delay before common keyboards repeat a key.
const FIRST_PRESS: Duration = Duration::from_millis(550);
/// Longer than the interval between repeats.
const REPEATED: Duration = Duration::from_millis(200);
/// Speed steps from the slowest to the top speed.
const STEPS: u32 = 10;

/// Command of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Command {
    /// Space: take control and stop.
    Take,
    /// Enter: give control back.
    Give,
    /// Move: forward and left components, each -1, 0 or 1.
    Move { forward: i8, left: i8 },
    /// Faster from now on.
    Faster,
    /// Slower from now on.
    Slower,
    /// R: release a stop.
    Resume,
    /// Ctrl-C: stop the robot and quit.
    Quit,
    /// Escape: give control back if it is held here, and quit without a stop.
    Leave,
}

/// Command of a key; `None` for keys without a function.
pub(super) fn command_of(key: char, control: bool) -> Option<Command> {
    let motion = |forward, left| Some(Command::Move { forward, left });
    match (key.to_ascii_lowercase(), control) {
        ('c' | 'd' | '\\', true) => Some(Command::Quit),
        (_, true) => None,
        (' ', _) => Some(Command::Take),
        ('\n' | '\r', _) => Some(Command::Give),
        ('w', _) => motion(1, 0),
        ('s', _) => motion(-1, 0),
        ('a', _) => motion(0, 1),
        ('d', _) => motion(0, -1),
        ('q', _) => motion(1, 1),
        ('e', _) => motion(1, -1),
        ('r', _) => Some(Command::Resume),
        ('+' | '=', _) => Some(Command::Faster),
        ('-', _) => Some(Command::Slower),
        _ => None,
    }
}

/// The motion that the keys command.
#[derive(Clone, Debug)]
pub(super) struct Keyboard {
    /// Top forward speed, m/s, and yaw rate, rad/s.
    top: Twist2,
    /// Share of the top speed, in steps.
    step: u32,
    motion: (i8, i8),
    until: Duration,
}

impl Keyboard {
    /// At rest; starts at half of the top speed.
    pub(super) fn new(top: Twist2) -> Self {
        Self {
            top,
            step: STEPS / 2,
            motion: (0, 0),
            until: Duration::ZERO,
        }
    }

    /// A motion key at `now` (time since the start).
    pub(super) fn press(&mut self, now: Duration, forward: i8, left: i8) {
        let repeated = self.motion == (forward, left) && now < self.until;
        self.motion = (forward, left);
        self.until = now + if repeated { REPEATED } else { FIRST_PRESS };
    }

    /// Stops at once.
    pub(super) fn rest(&mut self) {
        self.until = Duration::ZERO;
    }

    /// One step faster or slower.
    pub(super) fn scale(&mut self, faster: bool) {
        self.step = if faster {
            (self.step + 1).min(STEPS)
        } else {
            (self.step - 1).max(1)
        };
    }

    /// The commanded twist at `now`.
    pub(super) fn twist(&self, now: Duration) -> Twist2 {
        if now >= self.until {
            return Twist2::ZERO;
        }
        let share = f64::from(self.step) / f64::from(STEPS);
        Twist2::new(
            self.top.v * share * f64::from(self.motion.0),
            self.top.w * share * f64::from(self.motion.1),
        )
    }

    /// The top twist at the present step.
    pub(super) fn limit(&self) -> Twist2 {
        let share = f64::from(self.step) / f64::from(STEPS);
        Twist2::new(self.top.v * share, self.top.w * share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(millis: u64) -> Duration {
        Duration::from_millis(millis)
    }

    #[test]
    fn a_key_held_drives_on_and_a_key_let_go_stops_within_a_fifth_of_a_second() {
        let mut keyboard = Keyboard::new(Twist2::new(1.0, 2.0));
        keyboard.press(ms(1000), 1, 0);
        assert_eq!(
            keyboard.twist(ms(1500)),
            Twist2::new(0.5, 0.0),
            "until the keyboard repeats"
        );
        for at in (1500..3000).step_by(33) {
            keyboard.press(ms(at), 1, 0);
        }
        assert_eq!(keyboard.twist(ms(3000)).v, 0.5);
        assert_eq!(keyboard.twist(ms(3200)), Twist2::ZERO);
    }

    #[test]
    fn another_key_takes_over_at_once() {
        let mut keyboard = Keyboard::new(Twist2::new(1.0, 2.0));
        keyboard.press(ms(0), 1, 0);
        keyboard.press(ms(100), 0, -1);
        assert_eq!(keyboard.twist(ms(101)), Twist2::new(0.0, -1.0));
        keyboard.rest();
        assert_eq!(keyboard.twist(ms(101)), Twist2::ZERO);
    }

    #[test]
    fn speed_stays_between_a_tenth_and_the_greatest() {
        let mut keyboard = Keyboard::new(Twist2::new(1.0, 2.0));
        for _ in 0..20 {
            keyboard.scale(true);
        }
        assert_eq!(keyboard.limit(), Twist2::new(1.0, 2.0));
        for _ in 0..20 {
            keyboard.scale(false);
        }
        assert!((keyboard.limit().v - 0.1).abs() < 1e-12);
    }

    #[test]
    fn the_keys_are_as_promised() {
        assert_eq!(command_of(' ', false), Some(Command::Take));
        assert_eq!(command_of('\r', false), Some(Command::Give));
        assert_eq!(command_of('W', false), Some(Command::Move { forward: 1, left: 0 }));
        assert_eq!(command_of('c', true), Some(Command::Quit));
        assert_eq!(command_of('c', false), None);
        assert_eq!(command_of('w', true), None);
    }
}
