//! Wheel encoders. How accurately do they measure the wheel angles?
//!
//! Their reading is the angle of each wheel since start ([`Readings::wheels`](crate::readings::Readings::wheels)); it is published as
//! part of [`Odometry`](crate::messages::Odometry).

use serde::{Deserialize, Serialize};

use super::{LATENCY, TURN};
use crate::config_text::{Expected, OutOfBounds, check_all};

/// Wheel encoders.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct EncoderModel {
    /// Standard deviation of a wheel's measured rotation, as a share of the rotation.
    pub noise: f64,
    /// Smallest step, rad.
    pub resolution: f64,
    /// Readings per second; without it, one per control tick.
    pub rate_hz: Option<f64>,
    /// Share of lost readings, 0 to 1: the previous angles stay.
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

impl EncoderModel {
    /// Checks all values; the first one out of bounds.
    pub(crate) fn check(&self) -> Result<(), OutOfBounds> {
        check_all(&[
            ("rate_hz", self.rate_hz.unwrap_or(1.0), Expected::Positive),
            ("noise", self.noise, Expected::NotNegative),
            ("resolution", self.resolution, TURN),
            ("dropout", self.dropout, Expected::Share),
            ("latency", self.latency, LATENCY),
        ])
    }
}
