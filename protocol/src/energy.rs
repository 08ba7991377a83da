//! Energy model. How much power does a robot draw to move?
//!
//! One model, used for the simulated battery and for the smoother's forecast. A wheel pushes with the force `F` that accelerates its half
//! of the mass and of the inertia and overcomes friction. Its direct-current motor draws the mechanical power `F v` and the copper loss
//! `(F r / k)²`, with the wheel radius `r` and the motor constant `k`. Braking recovers no energy. Sensors and computers draw a constant
//! power on top.
//!
//! Source: Mei, Lu, Hu and Lee, "Energy-Efficient Motion Planning for Mobile Robots", ICRA 2004, and "A Case Study of Mobile Robot's Energy
//! Consumption and Conservation Techniques", ICAR 2005 (power at rest plus power of motion); Kim and Kim, "Minimum-Energy Translational
//! Trajectory Generation for Differential-Driven Wheeled Mobile Robots", JIRS 2007 (motors with losses in their windings).

use serde::{Deserialize, Serialize};

use crate::config_text::{Expected, OutOfBounds, check_all};
use crate::robot::RobotModel;

/// Acceleration of gravity, m/s².
const GRAVITY: f64 = 9.81;

/// Motors and load of a robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct MotorModel {
    /// Mass of the robot with its load, kg.
    pub mass: f64,
    /// Moment of inertia about the vertical axis through the middle of the axle, kg m².
    pub inertia: f64,
    /// Coefficient of rolling resistance (tyres, casters, gears): force over weight.
    pub rolling_resistance: f64,
    /// Viscous friction of the whole robot (gears, bearings, eddy currents), N s/m.
    pub viscous_friction: f64,
    /// Motor constant at the wheel: torque constant times gear ratio over the square root of the winding's resistance, N m/√W.
    pub motor_constant: f64,
}

impl Default for MotorModel {
    fn default() -> Self {
        Self {
            mass: 20.0,
            inertia: 0.5,
            rolling_resistance: 0.03,
            viscous_friction: 10.0,
            motor_constant: 0.5,
        }
    }
}

impl MotorModel {
    /// Checks all values; the first one out of bounds.
    pub(crate) fn check(&self) -> Result<(), OutOfBounds> {
        check_all(&[
            ("mass", self.mass, Expected::Positive),
            ("motor_constant", self.motor_constant, Expected::Positive),
            ("inertia", self.inertia, Expected::NotNegative),
            ("rolling_resistance", self.rolling_resistance, Expected::NotNegative),
            ("viscous_friction", self.viscous_friction, Expected::NotNegative),
        ])
    }
}

impl RobotModel {
    /// Electrical power (W) at wheel `speeds` (left, right, rad/s) and `accelerations` (rad/s²).
    ///
    /// ```
    /// use zenav_protocol::geometry::Twist2;
    /// use zenav_protocol::robot::{RobotModel, shipped};
    ///
    /// let tiago = RobotModel::from_toml(shipped("tiago").unwrap_or_default(), "tiago")?;
    /// assert_eq!(tiago.power([0.0; 2], [0.0; 2]), tiago.battery.idle_power);
    /// let cruising = tiago.power(tiago.drive.wheels(Twist2::new(0.5, 0.0)), [0.0; 2]);
    /// assert!((cruising - 59.6).abs() < 0.1, "{cruising} W at a steady 0.5 m/s");
    /// # Ok::<(), zenav_protocol::robot::RobotError>(())
    /// ```
    #[must_use]
    pub fn power(&self, speeds: [f64; 2], accelerations: [f64; 2]) -> f64 {
        let motors = &self.motors;
        let radius = self.drive.wheel_radius;
        let gained = self.drive.twist(accelerations);
        // The sum of the wheel forces pushes the base, their difference turns it.
        let push = 0.5 * motors.mass * gained.v;
        let turn = motors.inertia * gained.w / self.drive.wheel_separation;
        let rolling = 0.5 * motors.rolling_resistance * motors.mass * GRAVITY;
        let side = |speed: f64, turn: f64| {
            let v = speed * radius;
            let direction = if v == 0.0 { 0.0 } else { v.signum() };
            let force = push + turn + rolling * direction + 0.5 * motors.viscous_friction * v;
            let heat = (force * radius / motors.motor_constant).powi(2);
            (force * v + heat).max(0.0)
        };
        self.battery.idle_power + side(speeds[0], -turn) + side(speeds[1], turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Twist2;
    use crate::robot::shipped;
    use proptest::prelude::*;

    fn tiago() -> RobotModel {
        RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap()
    }

    fn power(robot: &RobotModel, v: f64, a: f64) -> f64 {
        let wheels = |v| robot.drive.wheels(Twist2::new(v, 0.0));
        robot.power(wheels(v), wheels(a))
    }

    #[test]
    fn at_rest_it_draws_what_its_electronics_need() {
        assert_eq!(power(&tiago(), 0.0, 0.0), tiago().battery.idle_power);
    }

    #[test]
    fn a_drive_without_losses_costs_friction_and_the_energy_of_motion() {
        let mut robot = tiago();
        (
            robot.motors.motor_constant,
            robot.motors.viscous_friction,
            robot.battery.idle_power,
        ) = (1e6, 0.0, 0.0);
        let (a, steps, dt) = (0.5, 1000, 1e-3);
        let drawn: f64 = (0..steps)
            .map(|i| power(&robot, a * (f64::from(i) + 0.5) * dt, a) * dt)
            .sum();
        let (motors, v) = (&robot.motors, a * f64::from(steps) * dt);
        let way = 0.5 * v;
        let expected = 0.5 * motors.mass * v * v + motors.rolling_resistance * motors.mass * GRAVITY * way;
        assert!((drawn - expected).abs() < 1e-3 * expected, "{drawn} against {expected}");
        // Braking harder than friction recovers no energy.
        assert_eq!(power(&robot, 0.5, -2.0), 0.0);
    }

    #[test]
    fn heat_grows_with_the_square_of_the_force() {
        let mut robot = tiago();
        robot.motors.rolling_resistance = 0.0;
        let at_start = |a| power(&robot, 0.0, a) - robot.battery.idle_power;
        assert!((at_start(0.6) - 4.0 * at_start(0.3)).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn it_never_draws_less_than_at_rest_and_the_same_both_ways(v in -1.0..1.0_f64, w in -3.0..3.0_f64, a in -2.0..2.0_f64, alpha in -5.0..5.0_f64) {
            let robot = tiago();
            let drawn = |sign: f64| robot.power(robot.drive.wheels(Twist2::new(sign * v, sign * w)), robot.drive.wheels(Twist2::new(sign * a, sign * alpha)));
            prop_assert!(drawn(1.0) >= robot.battery.idle_power);
            prop_assert!((drawn(1.0) - drawn(-1.0)).abs() < 1e-9 * drawn(1.0));
        }
    }
}
