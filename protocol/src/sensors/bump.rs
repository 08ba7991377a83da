//! Contact sensor. Does the robot touch something, and where?

use serde::{Deserialize, Serialize};

use crate::time::Stamp;

/// Reading and message of the contact sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Bump {
    /// When it was measured.
    pub stamp: Stamp,
    /// Whether the robot touches something.
    pub pressed: bool,
    /// Direction of the contact in the base frame, rad, if known.
    pub bearing: Option<f64>,
}

impl Bump {
    /// No contact.
    #[must_use]
    pub fn none(stamp: Stamp) -> Self {
        Self {
            stamp,
            pressed: false,
            bearing: None,
        }
    }
}
