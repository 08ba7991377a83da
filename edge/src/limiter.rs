//! Limiter. Which wheel speeds may follow the last ones? Speed limits at constant curvature, then acceleration limits, then the jerk limit
//! of a robot that has one.
//!
//! The jerk limit shapes how a motion begins and changes, never how it ends: a command to rest brakes at once, and the collision monitor
//! acts after it.

use zenav_protocol::geometry::Twist2;
use zenav_protocol::robot::Drive;

/// How hard the robot may brake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Braking {
    /// With the wheels' normal acceleration.
    Normal,
    /// As hard as the robot can.
    Hard,
}

/// Turns wanted twists into wheel speeds that the motors can follow.
#[derive(Clone, Debug)]
pub struct Limiter {
    drive: Drive,
    last: [f64; 2],
    /// Last acceleration of the wheels, rad/s²; zero after the collision monitor or the body has braked.
    gained: [f64; 2],
}

impl Limiter {
    /// Starts at rest.
    #[must_use]
    pub fn new(drive: &Drive) -> Self {
        Self {
            drive: drive.clone(),
            last: [0.0; 2],
            gained: [0.0; 2],
        }
    }

    /// The wheel speeds (left, right; rad/s) to set after `dt` seconds on the way to a twist; a twist that is not
    /// finite counts as rest.
    ///
    /// ```
    /// # let drive = zenav_fixtures::robot("tiago").drive;
    /// use zenav_edge::limiter::{Braking, Limiter};
    /// use zenav_protocol::geometry::Twist2;
    ///
    /// let mut limiter = Limiter::new(&drive);
    /// let [left, _] = limiter.limit(Twist2::new(0.5, 0.0), 0.02, Braking::Normal);
    /// assert!((left - drive.max_wheel_acceleration * 0.02).abs() < 1e-9);
    /// limiter.set([4.0, 4.0], 0.02);
    /// let [left, _] = limiter.limit(Twist2::ZERO, 0.02, Braking::Hard);
    /// assert!((4.0 - left - drive.wheel_braking() * 0.02).abs() < 1e-9);
    /// ```
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
            normal.max(self.drive.wheel_braking())
        } else {
            normal
        };
        let change = [wheels[0] - self.last[0], wheels[1] - self.last[1]];
        let largest = change[0].abs().max(change[1].abs());
        let share = if largest > rate * dt { rate * dt / largest } else { 1.0 };
        let limited = [self.last[0] + share * change[0], self.last[1] + share * change[1]];
        match self.drive.max_jerk {
            Some(jerk) if wheels != [0.0; 2] && braking == Braking::Normal && dt > 0.0 => {
                self.eased(limited, wheels, dt, jerk / self.drive.wheel_radius)
            }
            _ => limited,
        }
    }

    /// Towards `limited` with an acceleration that changes by at most `jerk` (rad/s³) and is zero when `target` is reached.
    fn eased(&self, limited: [f64; 2], target: [f64; 2], dt: f64, jerk: f64) -> [f64; 2] {
        let rate = self.drive.max_wheel_acceleration;
        let wheel = |side: usize| {
            let left = target[side] - self.last[side];
            // The greatest acceleration `a` that can still fall to zero over a²/2j of speed, in whole ticks.
            let greatest = (2.0 * jerk * left.abs() + 0.25 * (jerk * dt).powi(2)).sqrt() - 0.5 * jerk * dt;
            let wanted = ((limited[side] - self.last[side]) / dt).clamp(-greatest, greatest);
            let gained = self.gained[side];
            let gains = wanted.clamp(gained - jerk * dt, gained + jerk * dt).clamp(-rate, rate);
            (self.last[side] + gains * dt).clamp(-self.drive.max_wheel_speed, self.drive.max_wheel_speed)
        };
        [wheel(0), wheel(1)]
    }

    /// Records the wheel speeds that were actually commanded, `dt` seconds after the last ones.
    pub fn set(&mut self, wheels: [f64; 2], dt: f64) {
        let gained = [(wheels[0] - self.last[0]) / dt, (wheels[1] - self.last[1]) / dt];
        let most = self.drive.max_wheel_acceleration * (1.0 + 1e-9);
        let own = gained.iter().all(|gained| gained.abs() <= most);
        self.gained = if own { gained } else { [0.0; 2] };
        self.last = wheels;
    }

    /// The last command, as a twist.
    #[must_use]
    pub fn twist(&self) -> Twist2 {
        self.drive.twist(self.last)
    }
}

/// Scales a twist down until wheels, speed and yaw rate keep their limits; the curvature stays.
///
/// ```
/// # let drive = zenav_fixtures::robot("tiago").drive;
/// use zenav_edge::limiter::within_speed;
/// use zenav_protocol::geometry::Twist2;
///
/// let allowed = within_speed(&drive, Twist2::new(1.0, 2.0));
/// assert!((allowed.v / allowed.w - 0.5).abs() < 1e-9, "the same curve");
/// let fastest = drive.wheels(allowed).into_iter().fold(0.0, f64::max);
/// assert!((fastest - drive.max_wheel_speed).abs() < 1e-9);
/// ```
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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tiago() -> Drive {
        zenav_fixtures::robot("tiago").drive
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
                limiter.set(wheels, 0.02);
                last = wheels;
            }
        }
    }

    fn gentle(jerk: f64) -> Drive {
        Drive {
            max_jerk: Some(jerk),
            ..tiago()
        }
    }

    proptest! {
        #[test]
        fn with_a_limited_jerk_a_wheel_reaches_its_speed_without_a_jump_and_without_overshoot(jerk in 0.5..20.0_f64, v in 0.02..0.55_f64, dt in 0.005..0.05_f64) {
            let drive = gentle(jerk);
            let mut limiter = Limiter::new(&drive);
            let (mut last, mut gained) = (0.0, 0.0);
            for _ in 0..(20.0 / dt) as usize {
                let wheels = limiter.limit(Twist2::new(v, 0.0), dt, Braking::Normal);
                limiter.set(wheels, dt);
                let now = (wheels[0] - last) / dt;
                prop_assert!((now - gained).abs() <= jerk / drive.wheel_radius * dt + 1e-6);
                prop_assert!(now.abs() <= drive.max_wheel_acceleration + 1e-6);
                prop_assert!(wheels[0] * drive.wheel_radius <= v + jerk * dt * dt);
                (last, gained) = (wheels[0], now);
            }
            prop_assert!((last * drive.wheel_radius - v).abs() < 1e-3, "{} of {v}", last * drive.wheel_radius);
        }

        #[test]
        fn a_command_to_rest_brakes_as_hard_with_a_limited_jerk_as_without(jerk in 0.1..20.0_f64, v in 0.0..0.6_f64, ticks in 1..100_u32) {
            let (mut gentle, mut plain) = (Limiter::new(&gentle(jerk)), Limiter::new(&tiago()));
            for _ in 0..ticks {
                let wheels = gentle.limit(Twist2::new(v, 0.3), 0.02, Braking::Normal);
                gentle.set(wheels, 0.02);
            }
            plain.set(gentle.last, 0.02);
            for braking in [Braking::Normal, Braking::Hard] {
                prop_assert_eq!(gentle.limit(Twist2::ZERO, 0.02, braking), plain.limit(Twist2::ZERO, 0.02, braking));
            }
        }
    }

    #[test]
    fn after_the_collision_monitor_has_braked_it_starts_again_without_a_jump() {
        let drive = gentle(2.0);
        let mut limiter = Limiter::new(&drive);
        for _ in 0..100 {
            let wheels = limiter.limit(Twist2::new(0.5, 0.0), 0.02, Braking::Normal);
            limiter.set(wheels, 0.02);
        }
        limiter.set([0.0; 2], 0.02);
        let [left, _] = limiter.limit(Twist2::new(0.5, 0.0), 0.02, Braking::Normal);
        assert!(
            left > 0.0 && left <= 2.0 / drive.wheel_radius * 0.02 * 0.02 + 1e-9,
            "{left}"
        );
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
