//! Which wheel speeds may follow the last ones? Speed limits that keep the curvature, then acceleration limits.

use zenav_protocol::geometry::Twist2;
use zenav_protocol::robot::Drive;

/// How fast the speed may fall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Braking {
    /// Within the wheels' normal acceleration.
    Normal,
    /// As hard as the robot can.
    Hard,
}

/// Turns wanted twists into wheel speeds that the motors can follow.
#[derive(Clone, Debug)]
pub struct Limiter {
    drive: Drive,
    last: [f64; 2],
}

impl Limiter {
    /// At rest.
    #[must_use]
    pub fn new(drive: &Drive) -> Self {
        Self {
            drive: drive.clone(),
            last: [0.0; 2],
        }
    }

    /// The wheel speeds (left, right; rad/s) to set after `dt` seconds on the way to a twist; a twist that is not
    /// finite counts as rest.
    #[must_use]
    pub fn limit(&self, target: Twist2, dt: f64, braking: Braking) -> [f64; 2] {
        let target = if target.is_finite() {
            within_speed(&self.drive, target)
        } else {
            Twist2::ZERO
        };
        let wheels = self.drive.wheels(target);
        let normal = self.drive.max_wheel_acceleration;
        let rate = if braking == Braking::Hard {
            normal.max(self.drive.hard_braking / self.drive.wheel_radius)
        } else {
            normal
        };
        let change = [wheels[0] - self.last[0], wheels[1] - self.last[1]];
        let largest = change[0].abs().max(change[1].abs());
        let share = if largest > rate * dt { rate * dt / largest } else { 1.0 };
        [self.last[0] + share * change[0], self.last[1] + share * change[1]]
    }

    /// Records what was really set.
    pub fn set(&mut self, wheels: [f64; 2]) {
        self.last = wheels;
    }

    /// What was set last, as a twist.
    #[must_use]
    pub fn twist(&self) -> Twist2 {
        self.drive.twist(self.last)
    }
}

/// Scales a twist down until wheels, speed and yaw rate keep their limits; the curvature stays.
#[must_use]
pub fn within_speed(drive: &Drive, twist: Twist2) -> Twist2 {
    let wheels = drive.wheels(twist);
    let shares = [
        drive.max_wheel_speed / wheels[0].abs().max(wheels[1].abs()),
        drive.top_speed() / twist.v.abs(),
        drive.top_yaw_rate() / twist.w.abs(),
    ];
    // Division by zero gives infinity: no limit there.
    let share = shares.into_iter().fold(1.0, f64::min);
    Twist2::new(share * twist.v, share * twist.w)
}

/// Speed of the faster wheel's contact point, m/s: what braking distances and times are reckoned with.
#[must_use]
pub fn wheel_surface_speed(drive: &Drive, twist: Twist2) -> f64 {
    twist.v.abs() + 0.5 * drive.wheel_separation * twist.w.abs()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use zenav_protocol::robot::{RobotModel, shipped};

    fn tiago() -> Drive {
        RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap().drive
    }

    proptest! {
        #[test]
        fn no_command_breaks_a_limit(targets in prop::collection::vec((prop::num::f64::ANY, prop::num::f64::ANY), 1..50)) {
            let drive = tiago();
            let mut limiter = Limiter::new(&drive);
            let mut last = [0.0; 2];
            for (v, w) in targets {
                let wheels = limiter.limit(Twist2::new(v, w), 0.02, Braking::Normal);
                for (now, before) in wheels.iter().zip(last) {
                    prop_assert!(now.abs() <= drive.max_wheel_speed + 1e-9);
                    prop_assert!((now - before).abs() <= drive.max_wheel_acceleration * 0.02 + 1e-9);
                }
                limiter.set(wheels);
                last = wheels;
            }
        }
    }

    #[test]
    fn too_fast_a_turn_is_slowed_along_its_own_arc() {
        let limited = within_speed(&tiago(), Twist2::new(1.0, 2.0));
        assert!((limited.v / limited.w - 0.5).abs() < 1e-12);
        assert!(
            tiago()
                .wheels(limited)
                .iter()
                .all(|wheel| wheel.abs() <= tiago().max_wheel_speed + 1e-9)
        );
    }
}
