//! Battery. What is its capacity, and how much charge is left?
//!
//! The power drawn by motion is computed by [`MotorModel`](crate::energy::MotorModel).

use serde::{Deserialize, Serialize};

use crate::config_text::{Expected, OutOfBounds, check_all};
use crate::time::Stamp;

/// Battery.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct BatteryModel {
    /// Energy of a full battery, J.
    pub capacity: f64,
    /// Constant power of sensors and computers, W.
    pub idle_power: f64,
    /// Share of the charge below which the robot reports a low battery, 0 to 1.
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

impl BatteryModel {
    /// Checks all values; the first one out of bounds.
    pub(crate) fn check(&self) -> Result<(), OutOfBounds> {
        const CAPACITY: Expected = Expected::Range(100.0, f64::MAX, "J, at least 100 (1 Wh is 3600 J)");
        check_all(&[
            ("capacity", self.capacity, CAPACITY),
            ("idle_power", self.idle_power, Expected::NotNegative),
            ("low", self.low, Expected::Share),
        ])
    }
}

/// Reading and message of the battery.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Battery {
    /// When it was measured.
    pub stamp: Stamp,
    /// Charge left, 0 to 1.
    pub charge: f64,
    /// Energy drawn since start, J.
    pub drawn_j: f64,
}
