//! Limits. The largest speed of a differential drive at a curvature: wheel speed, wheel acceleration, lateral acceleration, yaw rate.
//!
//! With curvature `k` and wheel separation `b` the wheels run at `v (1 ± k b/2)`: a limit of the wheels is a limit of `v`.

use zenav_protocol::geometry::Twist2;
use zenav_protocol::robot::{Drive, RobotModel};

use super::profile::{Profile, ProfileLimits};

/// Share of every limit that a plan may use; the rest is for control.
pub const PLAN_SHARE: f64 = 0.95;

/// Fastest turn on the spot in a plan, rad/s: faster turns blur a scan and gain little.
const TOP_SPIN: f64 = 1.5;

/// Limits that a plan may use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Speed of a wheel on the floor, m/s.
    pub wheel_speed: f64,
    /// Acceleration of a wheel on the floor, m/s².
    pub wheel_acceleration: f64,
    /// Half the distance between the wheels, m.
    pub half_separation: f64,
    /// Speed of the base, m/s.
    pub speed: f64,
    /// Lateral acceleration, m/s².
    pub lateral_acceleration: f64,
    /// Yaw rate, rad/s.
    pub yaw_rate: f64,
    /// Jerk of the base along its path, and of a wheel on the floor in a turn on the spot, m/s³; `None`: unlimited.
    pub jerk: Option<f64>,
}

impl Limits {
    /// `PLAN_SHARE` of a robot's limits.
    ///
    /// ```
    /// use zenav_protocol::robot::{RobotModel, shipped};
    /// use zenav_smoothing::Limits;
    ///
    /// let model = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
    /// assert_eq!(Limits::of(&model).speed, 0.95 * model.drive.top_speed());
    /// ```
    #[must_use]
    pub fn of(model: &RobotModel) -> Self {
        Self::with_share(&model.drive, PLAN_SHARE)
    }

    /// A share (0 to 1) of a drive's limits.
    #[must_use]
    pub fn with_share(drive: &Drive, share: f64) -> Self {
        Self {
            wheel_speed: share * drive.max_wheel_speed * drive.wheel_radius,
            wheel_acceleration: share * drive.acceleration(),
            half_separation: 0.5 * drive.wheel_separation,
            speed: share * drive.top_speed(),
            lateral_acceleration: share * drive.max_lateral_acceleration,
            yaw_rate: share * drive.top_yaw_rate(),
            jerk: drive.max_jerk.map(|jerk| share * jerk),
        }
    }

    /// The same limits without the jerk limit.
    #[must_use]
    pub fn without_jerk(&self) -> Self {
        Self { jerk: None, ..*self }
    }

    /// Largest squared speed at a curvature (1/m), m²/s².
    ///
    /// ```
    /// use zenav_smoothing::Limits;
    ///
    /// let limits = Limits {
    ///     wheel_speed: 0.6,
    ///     wheel_acceleration: 0.75,
    ///     half_separation: 0.2,
    ///     speed: 0.55,
    ///     lateral_acceleration: 0.5,
    ///     yaw_rate: 2.5,
    ///     jerk: None,
    /// };
    /// let speed = |radius: f64| limits.speed_squared(1.0 / radius).sqrt();
    /// // On a circle of 1 m radius the outer wheel runs at 1.2 times the speed of the base, on one of 0.25 m at 1.8 times.
    /// assert!((speed(1.0) - 0.6 / 1.2).abs() < 1e-9 && (speed(0.25) - 0.6 / 1.8).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn speed_squared(&self, curvature: f64) -> f64 {
        let k = curvature.abs();
        if k == 0.0 {
            let base = self.speed.min(self.wheel_speed);
            return base * base;
        }
        let wheels = self.wheel_speed / (1.0 + k * self.half_separation);
        let base = self.speed.min(wheels);
        (base * base)
            .min(self.lateral_acceleration / k)
            .min((self.yaw_rate / k).powi(2))
    }

    /// Limits of a turn on the spot, in rad.
    #[must_use]
    pub fn spin(&self) -> ProfileLimits {
        ProfileLimits {
            speed: self.yaw_rate.min(self.wheel_speed / self.half_separation).min(TOP_SPIN),
            acceleration: self.wheel_acceleration / self.half_separation,
            jerk: self.jerk.map(|jerk| jerk / self.half_separation),
        }
    }

    /// Braking profile of the faster wheel, m; both wheels slow down in proportion, so that the arc is kept.
    #[must_use]
    pub fn braking(&self, twist: Twist2) -> Profile {
        let limits = ProfileLimits {
            speed: f64::INFINITY,
            acceleration: self.wheel_acceleration,
            jerk: self.jerk,
        };
        Profile::to_rest(self.surface_speed(twist), &limits)
    }

    /// Speed of the faster wheel on the floor, m/s.
    #[must_use]
    pub fn surface_speed(&self, twist: Twist2) -> f64 {
        twist.v.abs() + twist.w.abs() * self.half_separation
    }

    /// Time to come to rest, s.
    ///
    /// ```
    /// use zenav_protocol::geometry::Twist2;
    /// # use zenav_smoothing::Limits;
    /// # let limits = Limits { wheel_speed: 0.6, wheel_acceleration: 0.75, half_separation: 0.2, speed: 0.55, lateral_acceleration: 0.5,
    /// #     yaw_rate: 2.5, jerk: None };
    /// // A wheel brakes with 0.75 m/s²; in a turn the outer wheel, 0.2 m from the middle, is the faster one.
    /// assert!((limits.braking_time(Twist2::new(0.45, 0.0)) - 0.6).abs() < 1e-9);
    /// assert!((limits.braking_time(Twist2::new(0.45, 0.75)) - 0.8).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn braking_time(&self, twist: Twist2) -> f64 {
        self.braking(twist).duration()
    }
}
