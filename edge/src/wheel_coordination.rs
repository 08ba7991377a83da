//! Wheel coordination. How do both wheels brake together? Where one wheel is at its braking limit, the other brakes in proportion: the
//! robot stays on its curve.
//!
//! The collision monitor predicts the curve that is driven. With independent motors, each braking as hard as it can, the inner wheel of a
//! curve would stop before the outer one, and the robot would swing into the obstacle that it brakes for.

use zenav_protocol::robot::Drive;

/// A model of the motors from the robot file: a first-order lag, and limits of acceleration and deceleration.
#[derive(Clone, Debug)]
pub struct WheelCoordination {
    lag: f64,
    /// Limits of the motors, rad/s².
    acceleration: f64,
    deceleration: f64,
    /// Predicted speed (left, right; rad/s). Not measured: a failing encoder must not keep a robot moving.
    speed: [f64; 2],
}

impl WheelCoordination {
    /// Starts at rest.
    #[must_use]
    pub fn new(drive: &Drive) -> Self {
        Self {
            lag: drive.motor_lag,
            acceleration: drive.max_wheel_acceleration,
            deceleration: drive.wheel_braking().max(drive.max_wheel_acceleration),
            speed: [0.0; 2],
        }
    }

    /// Predicted speeds of the wheels (left, right; rad/s).
    #[must_use]
    pub fn speed(&self) -> [f64; 2] {
        self.speed
    }

    /// Something else may have stopped the wheels: the next command starts from rest.
    pub fn reset(&mut self) {
        self.speed = [0.0; 2];
    }

    /// The commands (left, right; rad/s) for the next `dt` seconds that reach a target as fast as possible with both wheels in proportion.
    ///
    /// ```
    /// # let drive = zenav_fixtures::robot("tiago").drive;
    /// use zenav_edge::wheel_coordination::WheelCoordination;
    ///
    /// let mut wheels = WheelCoordination::new(&drive);
    /// for _ in 0..100 {
    ///     wheels.command([2.0, 4.0], 0.02);
    /// }
    /// // Both wheels brake in proportion: the robot stays on its curve.
    /// let [left, right] = wheels.command([0.0, 0.0], 0.02);
    /// assert!(right > 2.0 && (right / left - 2.0).abs() < 1e-3);
    /// ```
    pub fn command(&mut self, target: [f64; 2], dt: f64) -> [f64; 2] {
        let answer = if self.lag > 0.0 {
            1.0 - (-dt / self.lag).exp()
        } else {
            1.0
        };
        let change = [target[0] - self.speed[0], target[1] - self.speed[1]];
        let largest = answer * change[0].abs().max(change[1].abs());
        // A larger commanded change does not make a motor faster.
        let most = self.deceleration * dt;
        let share = if largest > most { most / largest } else { 1.0 };
        let command = [self.speed[0] + share * change[0], self.speed[1] + share * change[1]];
        for (speed, command) in self.speed.iter_mut().zip(command) {
            let wanted = *speed + answer * (command - *speed);
            let most = dt
                * if wanted.abs() < speed.abs() {
                    self.deceleration
                } else {
                    self.acceleration
                };
            *speed += (wanted - *speed).clamp(-most, most);
        }
        command
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use nalgebra::Point2;
    use proptest::prelude::*;
    use zenav_protocol::geometry::{Pose2, Twist2};
    use zenav_sim::motors::Motors as Real;

    const TICK: f64 = 0.02;

    fn jackal() -> Drive {
        zenav_fixtures::robot("jackal").drive
    }

    /// Where a robot that brakes on its curve comes to rest, and the distance that its faster wheel rolled, m.
    fn rest(twist: Twist2, mut command: impl FnMut([f64; 2]) -> [f64; 2]) -> (Pose2, f64) {
        let drive = jackal();
        let mut real = Real::at_rest();
        let (mut pose, mut way) = (Pose2::IDENTITY, 0.0);
        for tick in 0..300 {
            let wanted = if tick < 200 { twist } else { Twist2::ZERO };
            real.command(&drive, command(drive.wheels(wanted)));
            let driven = drive.twist(real.step(&drive, TICK));
            if tick >= 200 {
                pose = pose.advance(driven, TICK);
                way += drive.surface_speed(driven) * TICK;
            }
        }
        (pose, way)
    }

    /// How far a robot's corners are off at rest from where its curve would have brought them, m.
    fn off_the_curve(twist: Twist2, rests: Pose2) -> f64 {
        let corner = |pose: &Pose2| pose.transform_point(Point2::new(0.25, 0.2));
        let off = |step: u32| {
            let on = Pose2::IDENTITY.advance(twist, 5e-4 * f64::from(step));
            (on.position() - rests.position())
                .norm()
                .max((corner(&on) - corner(&rests)).norm())
        };
        (0..2000).map(off).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn a_braking_robot_stays_on_its_curve_and_stops_as_soon() {
        let drive = jackal();
        for (v, w) in [(1.5, 2.4), (1.0, -3.0), (-1.2, 1.5), (2.0, 0.0)] {
            let twist = Twist2::new(v, w);
            let mut wheels = WheelCoordination::new(&drive);
            let (led, way) = rest(twist, |target| wheels.command(target, TICK));
            let (told, shortest) = rest(twist, |target| target);
            let off = off_the_curve(twist, led);
            assert!(off < 1e-3, "{twist:?}: {off}");
            assert!(way < shortest + 1e-6, "{way} {shortest}");
            if (v, w) == (1.5, 2.4) {
                assert!(off_the_curve(twist, told) > 0.02, "{}", off_the_curve(twist, told));
            }
        }
    }

    #[test]
    fn wheels_stopped_by_something_else_start_from_rest() {
        let mut wheels = WheelCoordination::new(&jackal());
        for _ in 0..50 {
            wheels.command([10.0, 10.0], TICK);
        }
        assert!(wheels.command([0.0; 2], TICK)[0] > 5.0);
        wheels.reset();
        assert_eq!(wheels.command([0.0; 2], TICK), [0.0; 2]);
    }

    proptest! {
        #[test]
        fn commands_reach_the_target(targets in prop::collection::vec((-30.0..30.0_f64, -30.0..30.0_f64), 1..20)) {
            let mut wheels = WheelCoordination::new(&jackal());
            for (left, right) in targets {
                let commands: Vec<_> = (0..200).map(|_| wheels.command([left, right], TICK)).collect();
                prop_assert_eq!(commands[199], [left, right]);
            }
        }
    }
}
