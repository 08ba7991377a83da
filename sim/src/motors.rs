//! Motors. The response of wheels and motors to a command: lag and limits.
//!
//! A motor is a first-order lag towards the commanded wheel speed, bounded by the wheel's acceleration limit, or by hard braking when the
//! wheel slows down. Between two wheel speeds the base follows the arc of their mean. A drive with errors responds later, lags more, and
//! is weaker for its mass than its robot's model says.

use std::collections::VecDeque;

use zenav_protocol::robot::Drive;

/// Both motors.
#[derive(Clone, Debug)]
pub struct Motors {
    command: [f64; 2],
    speed: [f64; 2],
    /// Commands that have not taken effect yet, each with the time that is left until then, s.
    waiting: VecDeque<(f64, [f64; 2])>,
}

impl Motors {
    /// Motors at rest, without a command.
    #[must_use]
    pub fn at_rest() -> Self {
        Self {
            command: [0.0; 2],
            speed: [0.0; 2],
            waiting: VecDeque::new(),
        }
    }

    /// Sets the commanded wheel speeds (left, right; rad/s), bounded by the limits of wheels and base. NaN stops both wheels.
    pub fn command(&mut self, drive: &Drive, wheels: [f64; 2]) {
        let command = if wheels.iter().any(|speed| speed.is_nan()) {
            [0.0; 2]
        } else {
            drive.bounded(wheels)
        };
        if drive.errors.dead_time > 0.0 {
            self.waiting.push_back((drive.errors.dead_time, command));
        } else {
            self.command = command;
        }
    }

    /// Present wheel speeds (left, right; rad/s).
    #[must_use]
    pub fn speed(&self) -> [f64; 2] {
        self.speed
    }

    /// Advances the motors; returns the mean wheel speeds over the time (left, right; rad/s).
    ///
    /// ```
    /// # let drive = zenav_fixtures::robot("tiago").drive;
    /// use zenav_sim::motors::Motors;
    ///
    /// let mut motors = Motors::at_rest();
    /// motors.command(&drive, [3.0, 3.0]);
    /// let mean = motors.step(&drive, 0.1);
    /// // The wheels gain at most 8 rad/s²; over the step their mean speed is half of what they reach.
    /// assert_eq!(drive.max_wheel_acceleration, 8.0);
    /// assert!((motors.speed()[0] - 0.8).abs() < 1e-9 && (mean[0] - 0.4).abs() < 1e-9);
    /// ```
    pub fn step(&mut self, drive: &Drive, secs: f64) -> [f64; 2] {
        for (left, _) in &mut self.waiting {
            *left -= secs;
        }
        while self.waiting.front().is_some_and(|(left, _)| *left < -1e-9) {
            self.command = self.waiting.pop_front().map_or(self.command, |(_, command)| command);
        }
        let lag = drive.motor_lag + drive.errors.motor_lag;
        let share = if lag > 0.0 { 1.0 - (-secs / lag).exp() } else { 1.0 };
        let load = 1.0 + drive.errors.mass;
        let (braking, gaining) = (drive.wheel_braking() / load, drive.max_wheel_acceleration / load);
        let before = self.speed;
        for (speed, command) in self.speed.iter_mut().zip(self.command) {
            let wanted = *speed + (command - *speed) * share;
            *speed = limited(*speed, wanted, braking * secs, gaining * secs);
        }
        [0.5 * (before[0] + self.speed[0]), 0.5 * (before[1] + self.speed[1])]
    }

    /// Stops both wheels at once: the robot is blocked.
    pub fn stall(&mut self) {
        self.speed = [0.0; 2];
    }
}

/// `wanted`, limited to a loss of `down` and a gain of `up` from `speed`; through zero it first brakes, then accelerates.
fn limited(speed: f64, wanted: f64, down: f64, up: f64) -> f64 {
    if speed == 0.0 {
        return wanted.clamp(-up, up);
    }
    // Mirrored, so that the speed is positive.
    let (sign, speed, wanted) = (speed.signum(), speed.abs(), wanted * speed.signum());
    let next = if wanted >= speed {
        wanted.min(speed + up)
    } else if wanted >= 0.0 || speed >= down {
        wanted.max(0.0_f64.max(speed - down))
    } else {
        // The share of the time that is left after braking to zero.
        wanted.max(-up * (1.0 - speed / down))
    };
    sign * next
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use proptest::prelude::*;
    use zenav_protocol::geometry::Twist2;

    fn tiago() -> Drive {
        zenav_fixtures::robot("tiago").drive
    }

    #[test]
    fn a_hard_stop_from_full_speed_takes_the_hard_braking_distance_and_the_lag() {
        let drive = tiago();
        let mut motors = Motors::at_rest();
        motors.command(&drive, [drive.max_wheel_speed; 2]);
        for _ in 0..1000 {
            motors.step(&drive, 0.005);
        }
        let top = drive.twist(motors.speed()).v;
        assert!((top - drive.top_speed()).abs() < 1e-6);
        motors.command(&drive, [0.0; 2]);
        let distance: f64 = (0..1000)
            .map(|_| drive.twist(motors.step(&drive, 0.005)).v * 0.005)
            .sum();
        let hard = top * top / (2.0 * drive.hard_braking);
        assert!(distance > hard && distance < hard + top * drive.motor_lag, "{distance}");
    }

    #[test]
    fn a_motor_has_come_two_thirds_of_the_way_after_its_lag() {
        let mut drive = tiago();
        (drive.motor_lag, drive.max_wheel_acceleration) = (0.2, 1e3);
        let mut motors = Motors::at_rest();
        motors.command(&drive, [4.0, -4.0]);
        for _ in 0..40 {
            motors.step(&drive, 0.005);
        }
        let expected = 4.0 * (1.0 - (-1.0_f64).exp());
        let [left, right] = motors.speed();
        assert!(
            (left - expected).abs() < 1e-9 && (right + expected).abs() < 1e-9,
            "{left} {right}"
        );
    }

    #[test]
    fn a_base_that_may_not_go_as_fast_as_its_wheels_keeps_the_curvature() {
        let drive = zenav_fixtures::robot("jackal").drive;
        let mut motors = Motors::at_rest();
        motors.command(&drive, drive.wheels(Twist2::new(1.0, 5.0)));
        for _ in 0..1000 {
            motors.step(&drive, 0.005);
        }
        let twist = drive.twist(motors.speed());
        assert!((twist.v - 0.8).abs() < 1e-6 && (twist.w - 4.0).abs() < 1e-6);
    }

    #[test]
    fn a_drive_with_errors_begins_late_and_gains_speed_slowly() {
        let mut drive = tiago();
        (drive.errors.dead_time, drive.errors.mass) = (0.1, 1.0);
        let mut motors = Motors::at_rest();
        motors.command(&drive, [6.0; 2]);
        let speeds: Vec<f64> = (0..40)
            .map(|_| {
                motors.step(&drive, 0.005);
                motors.speed()[0]
            })
            .collect();
        assert!(speeds[..20].iter().all(|speed| *speed == 0.0), "{speeds:?}");
        // Twice the mass, half the acceleration.
        assert!((speeds[39] - 20.0 * 0.005 * 0.5 * drive.max_wheel_acceleration).abs() < 1e-9);
    }

    #[test]
    fn a_command_that_is_no_number_stops() {
        let drive = tiago();
        let mut motors = Motors::at_rest();
        motors.command(&drive, [3.0, f64::NAN]);
        assert_eq!(motors.step(&drive, 0.02), [0.0, 0.0]);
        motors.command(&drive, [f64::INFINITY, f64::NEG_INFINITY]);
        assert!(motors.step(&drive, 0.02).iter().all(|speed| speed.is_finite()));
    }

    proptest! {
        #[test]
        fn wheels_never_change_faster_than_their_limits(commands in prop::collection::vec((-20.0..20.0, -20.0..20.0), 1..60)) {
            let drive = tiago();
            let mut motors = Motors::at_rest();
            for (left, right) in commands {
                motors.command(&drive, [left, right]);
                let before = motors.speed();
                motors.step(&drive, 0.005);
                for (before, after) in before.into_iter().zip(motors.speed()) {
                    let change = (after - before).abs();
                    let slower = after.abs() < before.abs() || after * before < 0.0;
                    let limit = if slower { drive.wheel_braking() } else { drive.max_wheel_acceleration };
                    prop_assert!(change <= limit * 0.005 + 1e-12);
                    prop_assert!(after.abs() <= drive.max_wheel_speed);
                }
            }
        }
    }
}
