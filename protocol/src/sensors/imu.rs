//! Inertial unit with compass. How accurately does it measure yaw rate and heading, and what is published?

use serde::{Deserialize, Serialize};

use super::{LATENCY, TURN};
use crate::config_text::{Expected, OutOfBounds, check_all};
use crate::time::Stamp;

/// Gyro and compass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ImuModel {
    /// Readings per second.
    pub rate_hz: f64,
    /// Standard deviation of the yaw rate, rad/s.
    pub gyro_noise: f64,
    /// Constant error of the yaw rate, rad/s. The simulator applies it; the robot's software does not read it.
    pub gyro_bias: f64,
    /// Standard deviation of the compass, rad; without it, the robot has no compass.
    pub compass_noise: Option<f64>,
    /// Constant error of the compass, rad; likewise.
    pub compass_bias: f64,
    /// Smallest step of the yaw rate, rad/s.
    pub resolution: f64,
    /// Share of lost readings, 0 to 1.
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

impl ImuModel {
    /// Checks all values; the first one out of bounds.
    pub(crate) fn check(&self) -> Result<(), OutOfBounds> {
        check_all(&[
            ("rate_hz", self.rate_hz, Expected::Positive),
            ("gyro_noise", self.gyro_noise, Expected::NotNegative),
            ("compass_noise", self.compass_noise.unwrap_or(0.0), TURN),
            ("resolution", self.resolution, Expected::NotNegative),
            ("dropout", self.dropout, Expected::Share),
            ("latency", self.latency, LATENCY),
            ("gyro_bias", self.gyro_bias, Expected::Finite),
            ("compass_bias", self.compass_bias, Expected::Angle),
        ])
    }
}

/// Reading and message of an inertial unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Imu {
    /// When it was measured.
    pub stamp: Stamp,
    /// Mean rate about the vertical axis since the last reading, rad/s.
    pub yaw_rate: f64,
    /// Compass heading in the map frame, rad, if there is a compass.
    pub yaw: Option<f64>,
}
