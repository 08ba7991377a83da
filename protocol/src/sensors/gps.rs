//! GPS or beacons. How accurately do they measure the position, and what is published?

use serde::{Deserialize, Serialize};

use super::LATENCY;
use crate::config_text::{Expected, OutOfBounds, check_all, pair};
use crate::time::Stamp;

/// GPS or beacons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct GpsModel {
    /// Readings per second.
    pub rate_hz: f64,
    /// Standard deviation of each coordinate, m.
    pub noise: f64,
    /// Constant error (x, y), m.
    #[serde(default, deserialize_with = "pair")]
    pub bias: [f64; 2],
    /// Smallest step of a coordinate, m.
    #[serde(default)]
    pub resolution: f64,
    /// Share of lost readings, 0 to 1.
    #[serde(default)]
    pub dropout: f64,
    /// Time from a reading to its delivery, s.
    #[serde(default)]
    pub latency: f64,
}

impl GpsModel {
    /// Variance of each coordinate by its rounding to [`Self::resolution`], m².
    #[must_use]
    pub fn rounding(&self) -> f64 {
        self.resolution.powi(2) / 12.0
    }

    /// Checks all values; the first one out of bounds.
    pub(crate) fn check(&self) -> Result<(), OutOfBounds> {
        let [bias_x, bias_y] = self.bias;
        check_all(&[
            ("rate_hz", self.rate_hz, Expected::Positive),
            ("noise", self.noise, Expected::NotNegative),
            ("resolution", self.resolution, Expected::NotNegative),
            ("dropout", self.dropout, Expected::Share),
            ("latency", self.latency, LATENCY),
            ("bias", bias_x, Expected::Finite),
            ("bias", bias_y, Expected::Finite),
        ])
    }
}

/// Reading and message: a position from satellites or beacons, already in the map frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Gps {
    /// When it was measured.
    pub stamp: Stamp,
    /// East or map x, m.
    pub x: f64,
    /// North or map y, m.
    pub y: f64,
    /// Standard deviation of each coordinate as the receiver itself reports it, m. In the simulator it is the model's `noise`; noise that a
    /// fault adds is not in it.
    pub std_dev: f64,
}
