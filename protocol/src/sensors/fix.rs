//! Fix. Where in the world do GPS and compass place the robot?

use serde::{Deserialize, Serialize};

use crate::geometry::{MAX_COORDINATE, Pose2};

/// A measurement of the robot's position or heading in the world, with the odometry of the same moment, so that receivers need not pair
/// them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Fix {
    /// Odometry when it was measured.
    pub odom_from_base: Pose2,
    /// What was measured.
    pub measured: Absolute,
}

/// A measurement in the world, whose frame is the one that the robot's map is begun in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Absolute {
    /// GPS or beacons.
    Position {
        /// East, m.
        x: f64,
        /// North, m.
        y: f64,
        /// Standard deviation of each coordinate, m.
        std_dev: f64,
    },
    /// Compass.
    Heading {
        /// Heading of the base, rad.
        yaw: f64,
        /// Its standard deviation, rad.
        std_dev: f64,
    },
}

impl Fix {
    /// Whether a position is within 100 km, a heading within a turn, and the standard deviation at most 1000, m or rad.
    ///
    /// ```
    /// use zenav_protocol::geometry::Pose2;
    /// use zenav_protocol::sensors::{Absolute, Fix};
    ///
    /// let fix = |yaw| Fix { odom_from_base: Pose2::IDENTITY, measured: Absolute::Heading { yaw, std_dev: 0.02 } };
    /// assert!(fix(0.5).is_sane() && !fix(f64::NAN).is_sane() && !fix(1e9).is_sane());
    /// ```
    #[must_use]
    pub fn is_sane(&self) -> bool {
        let (is_near, std_dev) = match self.measured {
            Absolute::Position { x, y, std_dev } => ([x, y].iter().all(|value| value.abs() <= MAX_COORDINATE), std_dev),
            Absolute::Heading { yaw, std_dev } => (yaw.abs() <= std::f64::consts::TAU, std_dev),
        };
        self.odom_from_base.is_finite() && is_near && (0.0..=1e3).contains(&std_dev)
    }
}
