//! What is a robot, for everybody who plans for it, drives it or simulates it? Its footprint, limits and sensors.
//!
//! Read from TOML; unknown keys are errors that name the line. Shipped ones are found by name.

use std::f64::consts::{PI, TAU};

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use crate::config_text::{Pair, pair};
use crate::energy::MotorModel;
pub use crate::gains::ControllerGains;
use crate::geometry::Pose2;
pub use crate::robot_check::RobotError;
use crate::wall_following::WallFollowing;

/// A robot: what its file says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotModel {
    /// Name of the model.
    pub name: String,
    /// Outline on the floor.
    pub footprint: Footprint,
    /// Wheels and motors.
    pub drive: Drive,
    /// Planar lidar.
    pub lidar: LidarModel,
    /// Wheel encoders.
    #[serde(default)]
    pub encoders: EncoderModel,
    /// Gyro and compass.
    #[serde(default)]
    pub imu: ImuModel,
    /// GPS or beacons, where there are any.
    #[serde(default)]
    pub gps: Option<GpsModel>,
    /// Battery.
    #[serde(default)]
    pub battery: BatteryModel,
    /// Motors, and what they move.
    #[serde(default)]
    pub motors: MotorModel,
    /// Gains of the trackers.
    #[serde(default)]
    pub controller: ControllerGains,
    /// Distances, speeds and gains of the wall follower.
    #[serde(default)]
    pub wall_following: WallFollowing,
}

/// Outline on the floor, in the base frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", try_from = "FootprintTable")]
pub enum Footprint {
    /// A disc around the base, m.
    Radius(f64),
    /// Corners of a convex polygon, counter-clockwise, m.
    Polygon(Vec<Point2<f64>>),
}

/// A footprint as it is written: one of its keys.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FootprintTable {
    radius: Option<f64>,
    polygon: Option<Vec<Pair>>,
}

impl TryFrom<FootprintTable> for Footprint {
    type Error = &'static str;

    fn try_from(table: FootprintTable) -> Result<Self, Self::Error> {
        match table {
            FootprintTable {
                radius: Some(radius),
                polygon: None,
            } => Ok(Self::Radius(radius)),
            FootprintTable {
                radius: None,
                polygon: Some(corners),
            } => Ok(Self::Polygon(corners.into_iter().map(Point2::from).collect())),
            FootprintTable { radius: Some(_), .. } => {
                Err("`footprint` has both `radius` and `polygon`: expected either of them")
            }
            _ => Err("`footprint`: expected either `radius` or `polygon`"),
        }
    }
}

impl Footprint {
    /// Radius of the largest disc around the base inside the outline, m.
    #[must_use]
    pub fn inscribed_radius(&self) -> f64 {
        match self {
            Self::Radius(radius) => *radius,
            Self::Polygon(corners) => {
                let edges = corners.iter().zip(corners.iter().cycle().skip(1));
                edges
                    .map(|(a, b)| {
                        let d = b - a;
                        (d.x * a.y - d.y * a.x).abs() / d.norm()
                    })
                    .fold(f64::INFINITY, f64::min)
            }
        }
    }

    /// Radius of the smallest disc around the base that holds the outline, m.
    #[must_use]
    pub fn circumscribed_radius(&self) -> f64 {
        match self {
            Self::Radius(radius) => *radius,
            Self::Polygon(corners) => corners.iter().map(|corner| corner.coords.norm()).fold(0.0, f64::max),
        }
    }

    /// Distance from the outline to a point in the base frame, m; zero inside.
    #[must_use]
    pub fn distance(&self, point: Point2<f64>) -> f64 {
        match self {
            Self::Radius(radius) => (point.coords.norm() - radius).max(0.0),
            Self::Polygon(corners) => {
                let edges = corners.iter().zip(corners.iter().cycle().skip(1));
                let mut inside = true;
                let mut nearest = f64::INFINITY;
                for (a, b) in edges {
                    let (along, to) = (b - a, point - a);
                    inside &= along.x * to.y - along.y * to.x >= 0.0;
                    let share = (to.dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
                    nearest = nearest.min((to - along * share).norm());
                }
                if inside { 0.0 } else { nearest }
            }
        }
    }
}

/// A differential drive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// m.
    pub wheel_radius: f64,
    /// Distance between the wheels' contact points, m.
    pub wheel_separation: f64,
    /// Largest speed of a wheel, rad/s.
    pub max_wheel_speed: f64,
    /// Largest acceleration of a wheel in normal driving, rad/s².
    pub max_wheel_acceleration: f64,
    /// Deceleration of the base when it brakes as hard as it can, m/s².
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
    /// Largest jerk of the base along its way, m/s³; without it plans and commands change their acceleration at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_jerk: Option<f64>,
    /// Time constant of the motors, s.
    #[serde(default)]
    pub motor_lag: f64,
    /// What the simulated robot does differently from what it believes.
    #[serde(default)]
    pub errors: DriveErrors,
}

/// Systematic and random errors of a drive's odometry (Borenstein and Feng, "Measurement and Correction of Systematic Odometry Errors in
/// Mobile Robots", 1996). The simulator drives by them; the robot knows of the slip only.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DriveErrors {
    /// How much larger the wheels (left, right) are than stated, as a share.
    #[serde(deserialize_with = "pair")]
    pub wheel_radius: [f64; 2],
    /// How much farther apart the wheels touch the floor than stated, as a share.
    pub wheel_separation: f64,
    /// Standard deviation of what a wheel slips, m for each square root of a metre rolled.
    pub slip: f64,
}

fn default_lateral() -> f64 {
    1.0
}

fn unlimited() -> f64 {
    1e6
}

impl Drive {
    /// Forward speed with both wheels at their limit, or the base's own limit, m/s.
    #[must_use]
    pub fn top_speed(&self) -> f64 {
        (self.max_wheel_speed * self.wheel_radius).min(self.max_speed)
    }

    /// Yaw rate on the spot with both wheels at their limit, or the base's own limit, rad/s.
    #[must_use]
    pub fn top_yaw_rate(&self) -> f64 {
        (2.0 * self.max_wheel_speed * self.wheel_radius / self.wheel_separation).min(self.max_yaw_rate)
    }

    /// Forward acceleration with both wheels at their limit, m/s².
    #[must_use]
    pub fn acceleration(&self) -> f64 {
        self.max_wheel_acceleration * self.wheel_radius
    }

    /// Wheel speeds (left, right; rad/s) of a twist.
    #[must_use]
    pub fn wheels(&self, twist: crate::geometry::Twist2) -> [f64; 2] {
        let half = 0.5 * self.wheel_separation * twist.w;
        [
            (twist.v - half) / self.wheel_radius,
            (twist.v + half) / self.wheel_radius,
        ]
    }

    /// Twist of wheel speeds (left, right; rad/s).
    #[must_use]
    pub fn twist(&self, wheels: [f64; 2]) -> crate::geometry::Twist2 {
        let [left, right] = wheels;
        crate::geometry::Twist2::new(
            0.5 * (left + right) * self.wheel_radius,
            (right - left) * self.wheel_radius / self.wheel_separation,
        )
    }
}

/// A planar lidar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LidarModel {
    /// Where it sits on the base.
    #[serde(default)]
    pub mount: Pose2,
    /// Sweeps a second.
    pub rate_hz: f64,
    /// m.
    pub range_min: f64,
    /// m.
    pub range_max: f64,
    /// Readings a sweep.
    pub beams: usize,
    /// Angle from the first beam to the last, rad; 2 pi is a full circle without a doubled beam.
    pub field_of_view: f64,
    /// Standard deviation of a range, m.
    #[serde(default)]
    pub noise: f64,
    /// Constant error of a range, m.
    #[serde(default)]
    pub bias: f64,
    /// Share of beams that are lost.
    #[serde(default)]
    pub dropout: f64,
    /// Smallest step of a range, m.
    #[serde(default = "millimetre")]
    pub resolution: f64,
    /// Time from a sweep to its delivery, s.
    #[serde(default)]
    pub latency: f64,
}

fn millimetre() -> f64 {
    0.001
}

impl LidarModel {
    /// Direction of the first beam, rad.
    #[must_use]
    pub fn angle_min(&self) -> f64 {
        if self.is_full_circle() {
            -PI
        } else {
            -0.5 * self.field_of_view
        }
    }

    /// Angle between beams, rad.
    #[must_use]
    pub fn angle_increment(&self) -> f64 {
        if self.is_full_circle() {
            TAU / self.beams.max(1) as f64
        } else {
            self.field_of_view / (self.beams.max(2) - 1) as f64
        }
    }

    fn is_full_circle(&self) -> bool {
        self.field_of_view > TAU - 1e-3
    }
}

/// Wheel encoders.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EncoderModel {
    /// Standard deviation of a wheel's measured turn, as a share of the turn.
    pub noise: f64,
    /// Smallest step, rad.
    pub resolution: f64,
    /// Readings a second; without it one every control step.
    pub rate_hz: Option<f64>,
    /// Share of readings that are lost: the angles of the one before stand.
    pub dropout: f64,
    /// Time from a reading to its delivery, s.
    pub latency: f64,
}

impl Default for EncoderModel {
    fn default() -> Self {
        Self {
            noise: 0.005,
            resolution: 0.001,
            rate_hz: None,
            dropout: 0.0,
            latency: 0.0,
        }
    }
}

/// Gyro and compass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuModel {
    /// Readings a second.
    pub rate_hz: f64,
    /// Standard deviation of the yaw rate, rad/s.
    pub gyro_noise: f64,
    /// Constant error of the yaw rate, rad/s.
    pub gyro_bias: f64,
    /// Standard deviation of the compass, rad; without it there is no compass.
    pub compass_noise: Option<f64>,
    /// Constant error of the compass, rad.
    pub compass_bias: f64,
    /// Smallest step of the yaw rate, rad/s.
    pub resolution: f64,
    /// Share of readings that are lost.
    pub dropout: f64,
    /// Time from a reading to its delivery, s.
    pub latency: f64,
}

impl Default for ImuModel {
    fn default() -> Self {
        Self {
            rate_hz: 50.0,
            gyro_noise: 0.002,
            gyro_bias: 0.0,
            compass_noise: None,
            compass_bias: 0.0,
            resolution: 0.0,
            dropout: 0.0,
            latency: 0.0,
        }
    }
}

/// GPS or beacons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GpsModel {
    /// Readings a second.
    pub rate_hz: f64,
    /// Standard deviation of each coordinate, m.
    pub noise: f64,
    /// Constant error (x, y), m.
    #[serde(default, deserialize_with = "pair")]
    pub bias: [f64; 2],
    /// Smallest step of a coordinate, m.
    #[serde(default)]
    pub resolution: f64,
    /// Share of readings that are lost.
    #[serde(default)]
    pub dropout: f64,
    /// Time from a reading to its delivery, s.
    #[serde(default)]
    pub latency: f64,
}

/// Battery; what motion draws of it is in [`MotorModel`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BatteryModel {
    /// When full, J.
    pub capacity: f64,
    /// Drawn by sensors and computers whatever happens, W.
    pub idle_power: f64,
    /// Share of the charge below which the robot says that its battery is low.
    pub low: f64,
}

impl Default for BatteryModel {
    fn default() -> Self {
        Self {
            capacity: 500_000.0,
            idle_power: 20.0,
            low: 0.2,
        }
    }
}

/// Names and texts of the shipped robots.
pub const SHIPPED: &[(&str, &str)] = &[
    ("tiago", include_str!("../robots/tiago.toml")),
    ("neato", include_str!("../robots/neato.toml")),
    ("turtlebot3_waffle", include_str!("../robots/turtlebot3_waffle.toml")),
    ("jackal", include_str!("../robots/jackal.toml")),
];

/// The text of a shipped robot.
#[must_use]
pub fn shipped(name: &str) -> Option<&'static str> {
    SHIPPED.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

impl RobotModel {
    /// Reads a robot file's text; `name` is for errors.
    ///
    /// # Errors
    /// [`RobotError`] for text that is not TOML, unknown or missing keys, and values that no robot has: file, line and key.
    pub fn from_toml(text: &str, name: &str) -> Result<Self, RobotError> {
        let model: Self = toml::from_str(text).map_err(|source| RobotError::Toml {
            name: name.to_owned(),
            source: Box::new(source),
        })?;
        model.check().map_err(|wrong| wrong.of(name, Some(text)))?;
        Ok(model)
    }

    /// Checks values, wherever they came from; `name` is for errors.
    ///
    /// # Errors
    /// [`RobotError::Value`].
    pub fn checked(self, name: &str) -> Result<Self, RobotError> {
        self.check().map_err(|wrong| wrong.of(name, None))?;
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_robot_can_be_read() {
        for (name, text) in SHIPPED {
            let model = RobotModel::from_toml(text, name).unwrap();
            assert_eq!(model.name, *name);
        }
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line() {
        let text = format!("speed = 3\n{}", shipped("tiago").unwrap());
        let error = RobotModel::from_toml(&text, "my.toml").unwrap_err().to_string();
        assert!(
            error.contains("my.toml") && error.contains("line 1") && error.contains("speed"),
            "{error}"
        );
    }

    #[test]
    fn a_rectangle_knows_its_distances() {
        let jackal = RobotModel::from_toml(shipped("jackal").unwrap(), "jackal")
            .unwrap()
            .footprint;
        assert!((jackal.inscribed_radius() - 0.165).abs() < 1e-12);
        assert!((jackal.circumscribed_radius() - 0.21_f64.hypot(0.165)).abs() < 1e-12);
        assert!((jackal.distance(Point2::new(0.31, 0.0)) - 0.1).abs() < 1e-12);
        assert_eq!(jackal.distance(Point2::new(0.1, 0.1)), 0.0);
    }
}
