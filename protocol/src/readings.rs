//! What does a body give its pilot each tick, whether it is real or simulated?

use crate::messages::{Battery, Bump, Gps, Imu};
use crate::time::Stamp;

/// Raw readings of one control tick. What did not come since the last tick is `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct Readings {
    /// Now, on the edge's own clock.
    pub stamp: Stamp,
    /// Angles of the left and right wheel since start, rad.
    pub wheels: [f64; 2],
    /// Gyro and compass.
    pub imu: Option<Imu>,
    /// Position by GPS or beacons, map frame.
    pub gps: Option<Gps>,
    /// A finished lidar sweep.
    pub sweep: Option<Sweep>,
    /// Contact sensor.
    pub bump: Bump,
    /// Energy.
    pub battery: Battery,
}

/// Ranges of one lidar sweep; the robot's model says where the beams point.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// When it was taken: at or before the tick.
    pub stamp: Stamp,
    /// Distance a beam, m; no return is infinity.
    pub ranges: Vec<f32>,
}
