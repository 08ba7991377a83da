//! Drive: wheels, their limits, and kinematics. Which wheel speeds give which motion of the base, and which are allowed?
//!
//! The only place for kinematics, used by the simulator, the edge and the planners. Another kind of drive (omnidirectional, Ackermann) is a
//! variant of [`DriveKind`] plus its match arms here.

use serde::{Deserialize, Serialize};

use crate::config_text::{Expected, OutOfBounds, check_all, pair};
use crate::geometry::Twist2;

/// Greatest speed of any base, m/s.
const FASTEST: f64 = 50.0;

/// How the wheels are arranged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum DriveKind {
    /// Two driven wheels on one axle through the base's origin, left and right; all other wheels are passive.
    #[default]
    Differential,
}

impl DriveKind {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Wheels and motors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// How the wheels are arranged; the default is not serialised.
    #[serde(default, skip_serializing_if = "DriveKind::is_default")]
    pub kind: DriveKind,
    /// Radius of a wheel, m.
    pub wheel_radius: f64,
    /// Distance between the wheels' contact points, m.
    pub wheel_separation: f64,
    /// Largest speed of a wheel, rad/s.
    pub max_wheel_speed: f64,
    /// Largest acceleration of a wheel in normal driving, rad/s².
    pub max_wheel_acceleration: f64,
    /// Deceleration of the base under hardest braking, m/s².
    pub hard_braking: f64,
    /// Largest lateral acceleration, m/s².
    #[serde(default = "default_lateral")]
    pub max_lateral_acceleration: f64,
    /// Largest yaw rate, rad/s; the wheels may allow less.
    #[serde(default = "unlimited")]
    pub max_yaw_rate: f64,
    /// Largest forward speed, m/s; the wheels may allow less.
    #[serde(default = "unlimited")]
    pub max_speed: f64,
    /// Largest jerk of the base along its path, m/s³; without it the acceleration of plans and commands may jump.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_jerk: Option<f64>,
    /// Time constant of the motors, s; at most 1 s: a robot comes to rest within a few of them, and its plans are valid for seconds.
    #[serde(default)]
    pub motor_lag: f64,
    /// Errors of the simulated drive that the robot does not model.
    #[serde(default)]
    pub errors: DriveErrors,
}

/// Systematic and random errors of a drive's odometry (Borenstein and Feng, "Measurement and Correction of Systematic Odometry Errors in
/// Mobile Robots", 1996), and deviations of the body's dynamics. The simulator applies them; the robot's software reads none of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct DriveErrors {
    /// Relative error of the wheel radii (left, right): positive means larger than stated.
    #[serde(deserialize_with = "pair")]
    pub wheel_radius: [f64; 2],
    /// Relative error of the wheel separation: positive means farther apart than stated.
    pub wheel_separation: f64,
    /// Standard deviation of a wheel's slip, m per square root of a metre rolled.
    pub slip: f64,
    /// Relative error of the mass: a heavier robot accelerates and brakes that much less.
    #[serde(skip_serializing_if = "is_zero")]
    pub mass: f64,
    /// Error of the motors' time constant: positive means longer than stated, s.
    #[serde(skip_serializing_if = "is_zero")]
    pub motor_lag: f64,
    /// Time from a wheel command until the motors act on it, s.
    #[serde(skip_serializing_if = "is_zero")]
    pub dead_time: f64,
}

pub(crate) fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

fn default_lateral() -> f64 {
    1.0
}

fn unlimited() -> f64 {
    1e6
}

impl Drive {
    /// Forward speed with all wheels at their limit, capped by the base's own limit, m/s.
    #[must_use]
    pub fn top_speed(&self) -> f64 {
        (self.max_wheel_speed * self.wheel_radius).min(self.max_speed)
    }

    /// Yaw rate on the spot with all wheels at their limit, capped by the base's own limit, rad/s.
    #[must_use]
    pub fn top_yaw_rate(&self) -> f64 {
        (2.0 * self.max_wheel_speed * self.wheel_radius / self.wheel_separation).min(self.max_yaw_rate)
    }

    /// Forward acceleration with all wheels at their limit, m/s².
    #[must_use]
    pub fn acceleration(&self) -> f64 {
        self.max_wheel_acceleration * self.wheel_radius
    }

    /// Deceleration of a wheel under hardest braking, rad/s².
    #[must_use]
    pub fn wheel_braking(&self) -> f64 {
        self.hard_braking / self.wheel_radius
    }

    /// Wheel speeds (left, right; rad/s) of a twist.
    ///
    /// ```
    /// use zenav_protocol::{geometry::Twist2, robot::{RobotModel, shipped}};
    ///
    /// let drive = RobotModel::from_toml(shipped("tiago").unwrap_or_default(), "tiago")?.drive;
    /// let [left, right] = drive.wheels(Twist2::new(0.0985, 0.0));
    /// assert!((left - 1.0).abs() < 1e-12 && left == right);
    /// # Ok::<(), zenav_protocol::robot::RobotError>(())
    /// ```
    #[must_use]
    pub fn wheels(&self, twist: Twist2) -> [f64; 2] {
        match self.kind {
            DriveKind::Differential => {
                let half = 0.5 * self.wheel_separation * twist.w;
                [
                    (twist.v - half) / self.wheel_radius,
                    (twist.v + half) / self.wheel_radius,
                ]
            }
        }
    }

    /// Twist of wheel speeds (left, right; rad/s).
    ///
    /// ```
    /// # use zenav_protocol::robot::{RobotModel, shipped};
    /// # let drive = RobotModel::from_toml(shipped("tiago").unwrap_or_default(), "tiago")?.drive;
    /// // The left wheel turns backwards, the right one forwards, at 1 rad/s each.
    /// let twist = drive.twist([-1.0, 1.0]);
    /// assert_eq!(twist.v, 0.0);
    /// assert!((twist.w - 2.0 * drive.wheel_radius / drive.wheel_separation).abs() < 1e-12, "to the left");
    /// # Ok::<(), zenav_protocol::robot::RobotError>(())
    /// ```
    #[must_use]
    pub fn twist(&self, wheels: [f64; 2]) -> Twist2 {
        match self.kind {
            DriveKind::Differential => {
                let [left, right] = wheels;
                Twist2::new(
                    0.5 * (left + right) * self.wheel_radius,
                    (right - left) * self.wheel_radius / self.wheel_separation,
                )
            }
        }
    }

    /// The twist that wheel speeds (left, right; rad/s) really cause, with the drive's [`DriveErrors`] but without slip.
    #[must_use]
    pub fn true_twist(&self, wheels: [f64; 2]) -> Twist2 {
        let [left, right] = self.errors.wheel_radius;
        let twist = self.twist([wheels[0] * (1.0 + left), wheels[1] * (1.0 + right)]);
        Twist2::new(twist.v, twist.w / (1.0 + self.errors.wheel_separation))
    }

    /// Speed of the faster wheel's contact point, m/s.
    #[must_use]
    pub fn surface_speed(&self, twist: Twist2) -> f64 {
        match self.kind {
            DriveKind::Differential => twist.v.abs() + 0.5 * self.wheel_separation * twist.w.abs(),
        }
    }

    /// Wheel speeds (left, right; rad/s) within the limits of wheels and base: each wheel is clamped, then both are scaled alike, which
    /// keeps the curvature.
    ///
    /// ```
    /// # use zenav_protocol::robot::{RobotModel, shipped};
    /// # let mut drive = RobotModel::from_toml(shipped("tiago").unwrap_or_default(), "tiago")?.drive;
    /// drive.max_speed = 0.3;
    /// let [left, right] = drive.bounded([4.0, 6.0]);
    /// assert!((drive.twist([left, right]).v - 0.3).abs() < 1e-12);
    /// assert!((right / left - 1.5).abs() < 1e-12, "the same curve, driven more slowly");
    /// # Ok::<(), zenav_protocol::robot::RobotError>(())
    /// ```
    #[must_use]
    pub fn bounded(&self, wheels: [f64; 2]) -> [f64; 2] {
        let bounded = wheels.map(|speed| speed.clamp(-self.max_wheel_speed, self.max_wheel_speed));
        let twist = self.twist(bounded);
        let excess = (twist.v.abs() / self.max_speed)
            .max(twist.w.abs() / self.max_yaw_rate)
            .max(1.0);
        bounded.map(|speed| speed / excess)
    }

    /// Checks all values; the first one out of bounds.
    pub(crate) fn check(&self) -> Result<(), OutOfBounds> {
        const ERROR: Expected = Expected::Range(-0.5, 0.5, "a share, -0.5 to 0.5");
        const LOAD: Expected = Expected::Range(-0.9, 10.0, "a share, -0.9 to 10");
        const LATE: Expected = Expected::Range(0.0, 2.0, "0 to 2 s");
        const LAG: Expected = Expected::Range(0.0, 1.0, "0 to 1 s");
        const WHEEL: Expected = Expected::Range(f64::MIN_POSITIVE, 5.0, "a positive number of metres, at most 5");
        const METRES: Expected = Expected::Range(f64::MIN_POSITIVE, 10.0, "a positive number of metres, at most 10");
        let [left, right] = self.errors.wheel_radius;
        check_all(&[
            ("wheel_radius", self.wheel_radius, WHEEL),
            ("wheel_separation", self.wheel_separation, METRES),
            ("max_wheel_speed", self.max_wheel_speed, Expected::Positive),
            (
                "max_wheel_acceleration",
                self.max_wheel_acceleration,
                Expected::Positive,
            ),
            ("hard_braking", self.hard_braking, Expected::Positive),
            (
                "max_lateral_acceleration",
                self.max_lateral_acceleration,
                Expected::Positive,
            ),
            ("max_yaw_rate", self.max_yaw_rate, Expected::Positive),
            ("max_speed", self.max_speed, Expected::Positive),
            ("max_jerk", self.max_jerk.unwrap_or(1.0), Expected::Positive),
            ("motor_lag", self.motor_lag, LAG),
            ("errors.slip", self.errors.slip, Expected::NotNegative),
            ("errors.mass", self.errors.mass, LOAD),
            ("errors.motor_lag", self.errors.motor_lag, LATE),
            ("errors.dead_time", self.errors.dead_time, LATE),
            ("errors.wheel_radius", left, ERROR),
            ("errors.wheel_radius", right, ERROR),
            ("errors.wheel_separation", self.errors.wheel_separation, ERROR),
        ])?;
        let most = FASTEST / self.wheel_radius;
        if self.max_wheel_speed > most {
            return Err(OutOfBounds::unlike(
                "max_wheel_speed",
                self.max_wheel_speed,
                format_args!(
                    "rad/s, at most {}: {FASTEST} m/s with this `wheel_radius`",
                    most.floor()
                ),
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{RobotModel, shipped};
    use proptest::prelude::*;

    fn drive(name: &str) -> Drive {
        RobotModel::from_toml(shipped(name).unwrap(), name).unwrap().drive
    }

    #[test]
    fn a_drive_is_differential_unless_its_file_says_otherwise() {
        assert_eq!(drive("tiago").kind, DriveKind::Differential);
        let text = shipped("tiago").unwrap();
        let named = text.replace("[drive]", "[drive]\nkind = \"differential\"");
        assert_eq!(RobotModel::from_toml(&named, "named").unwrap().drive, drive("tiago"));
        let other = text.replace("[drive]", "[drive]\nkind = \"legs\"");
        let error = RobotModel::from_toml(&other, "other").unwrap_err().to_string();
        assert!(error.contains("legs") && error.contains("differential"), "{error}");
    }

    proptest! {
        #[test]
        fn a_twist_is_that_of_its_wheels(v in -2.0..2.0, w in -4.0..4.0) {
            let drive = drive("jackal");
            let wheels = drive.wheels(Twist2::new(v, w));
            let again = drive.twist(wheels);
            prop_assert!((again.v - v).abs() < 1e-12 && (again.w - w).abs() < 1e-12);
            let fastest = wheels[0].abs().max(wheels[1].abs()) * drive.wheel_radius;
            prop_assert!((drive.surface_speed(Twist2::new(v, w)) - fastest).abs() < 1e-12);
        }

        #[test]
        fn bounded_wheels_stay_within_all_limits_and_keep_their_curvature(left in -60.0..60.0, right in -60.0..60.0) {
            let drive = drive("jackal");
            let bounded = drive.bounded([left, right]);
            let twist = drive.twist(bounded);
            prop_assert!(bounded.iter().all(|speed| speed.abs() <= drive.max_wheel_speed));
            prop_assert!(twist.v.abs() <= drive.max_speed + 1e-9 && twist.w.abs() <= drive.max_yaw_rate + 1e-9);
            let within = [left, right].map(|speed: f64| speed.clamp(-drive.max_wheel_speed, drive.max_wheel_speed));
            prop_assert!((bounded[0] * within[1] - bounded[1] * within[0]).abs() < 1e-9);
        }
    }
}
