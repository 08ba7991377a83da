//! Contact sensor. Is something touched, and where?

use serde::{Deserialize, Serialize};

use crate::time::Stamp;

/// Reading and message of the contact sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Bump {
    /// When it was measured.
    pub stamp: Stamp,
    /// Whether something is touched.
    pub pressed: bool,
    /// Direction of the contact in the base frame, rad, where it is known.
    pub bearing: Option<f64>,
}

impl Bump {
    /// Nothing is touched.
    #[must_use]
    pub fn none(stamp: Stamp) -> Self {
        Self {
            stamp,
            pressed: false,
            bearing: None,
        }
    }
}
