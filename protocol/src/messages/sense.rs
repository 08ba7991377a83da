//! What does a robot sense?

use std::f64::consts::TAU;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use crate::geometry::{Pose2, Twist2};
use crate::time::Stamp;

/// One sweep of a planar lidar, with the robot's pose at the sweep's own stamp: nobody pairs a latest pose with a latest scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// When the sweep was taken.
    pub stamp: Stamp,
    /// Direction of the first beam in the laser frame, rad.
    pub angle_min: f64,
    /// Angle from one beam to the next, rad, counter-clockwise.
    pub angle_increment: f64,
    /// Shorter readings are not valid, m.
    pub range_min: f64,
    /// A beam that met nothing up to here has no return, m.
    pub range_max: f64,
    /// Distance a beam, m; no return is infinity in memory and `null` on the wire.
    #[serde(with = "no_return_as_null")]
    pub ranges: Vec<f32>,
    /// Where the lidar sits on the robot.
    pub base_from_laser: Pose2,
    /// Correction of odometry at the stamp.
    pub map_from_odom: Pose2,
    /// Odometry at the stamp.
    pub odom_from_base: Pose2,
}

impl Scan {
    /// The laser's pose in the map at the stamp.
    #[must_use]
    pub fn map_from_laser(&self) -> Pose2 {
        self.map_from_odom * self.odom_from_base * self.base_from_laser
    }

    /// Direction of a beam in the laser frame, rad.
    #[must_use]
    pub fn angle(&self, beam: usize) -> f64 {
        self.angle_min + beam as f64 * self.angle_increment
    }

    /// Whether a reading is a real return.
    #[must_use]
    pub fn is_return(&self, range: f32) -> bool {
        let range = f64::from(range);
        range >= self.range_min && range <= self.range_max
    }

    /// End points of all real returns, in the laser frame, m.
    pub fn returns(&self) -> impl Iterator<Item = Point2<f64>> + '_ {
        self.ranges
            .iter()
            .enumerate()
            .filter(|(_, range)| self.is_return(**range))
            .map(|(beam, range)| {
                let (sin, cos) = self.angle(beam).sin_cos();
                Point2::new(f64::from(*range) * cos, f64::from(*range) * sin)
            })
    }

    /// Whether the description makes sense: finite numbers, at most a full circle and 100,000 beams.
    #[must_use]
    pub fn is_sane(&self) -> bool {
        let spread = self.angle_increment * self.ranges.len().saturating_sub(1) as f64;
        self.angle_min.is_finite()
            && self.angle_increment > 0.0
            && spread <= TAU + 1e-6
            && self.range_min >= 0.0
            && self.range_max > self.range_min
            && self.range_max.is_finite()
            && self.ranges.len() <= 100_000
            && self.map_from_laser().is_finite()
    }
}

/// JSON has no infinity: a beam without a return is `null`.
pub(crate) mod no_return_as_null {
    use serde::ser::SerializeSeq;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(ranges: &[f32], serializer: S) -> Result<S::Ok, S::Error> {
        let mut seq = serializer.serialize_seq(Some(ranges.len()))?;
        for range in ranges {
            seq.serialize_element(&range.is_finite().then_some(*range))?;
        }
        seq.end()
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f32>, D::Error> {
        let ranges: Vec<Option<f32>> = Vec::deserialize(deserializer)?;
        Ok(ranges.into_iter().map(|range| range.unwrap_or(f32::INFINITY)).collect())
    }
}

/// Dead reckoning: continuous, drifting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// When it was measured.
    pub stamp: Stamp,
    /// Pose in the odometry frame.
    pub odom_from_base: Pose2,
    /// Velocity in the base frame.
    pub velocity: Twist2,
    /// Wheel angles since start, left and right, rad.
    pub wheels: [f64; 2],
}

/// Inertial unit with compass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// When it was measured.
    pub stamp: Stamp,
    /// Rate about the vertical axis, rad/s.
    pub yaw_rate: f64,
    /// Compass heading in the map frame, rad, where there is a compass.
    pub yaw: Option<f64>,
}

/// Position by satellites or beacons, already in the map frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gps {
    /// When it was measured.
    pub stamp: Stamp,
    /// East or map x, m.
    pub x: f64,
    /// North or map y, m.
    pub y: f64,
    /// Standard deviation of each coordinate, m.
    pub std_dev: f64,
}

/// Contact sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bump {
    /// When it was measured.
    pub stamp: Stamp,
    /// Whether something is touched.
    pub pressed: bool,
    /// Direction of the contact in the base frame, rad, where it is known.
    pub bearing: Option<f64>,
}

/// Energy left.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Battery {
    /// When it was measured.
    pub stamp: Stamp,
    /// Charge left, 0 to 1.
    pub charge: f64,
    /// Energy drawn since start, J.
    pub drawn_j: f64,
}

/// The robot's own estimate of where it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseEstimate {
    /// When it holds.
    pub stamp: Stamp,
    /// Pose in the map.
    pub map_from_base: Pose2,
    /// Row-major covariance of (x, y, yaw), m², m rad, rad².
    pub covariance: [f64; 9],
    /// Velocity in the base frame.
    pub velocity: Twist2,
}

/// A pose measurement made off board, for the estimator to gate and fuse.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correction {
    /// Stamp of the scan that it was computed from (the edge's clock).
    pub stamp: Stamp,
    /// Boot that the stamp belongs to.
    pub boot_id: String,
    /// Measured pose in the map.
    pub map_from_base: Pose2,
    /// Row-major covariance of (x, y, yaw).
    pub covariance: [f64; 9],
}

/// Simulated time, where there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SimClock {
    /// Now, ns since the simulation began.
    pub stamp: Stamp,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beam_without_a_return_is_null_on_the_wire() {
        let scan = Scan {
            stamp: Stamp(7),
            angle_min: -1.0,
            angle_increment: 0.5,
            range_min: 0.02,
            range_max: 5.6,
            ranges: vec![1.5, f32::INFINITY, 0.25],
            base_from_laser: Pose2::new(0.2, 0.0, 0.0),
            map_from_odom: Pose2::IDENTITY,
            odom_from_base: Pose2::new(1.0, 2.0, 0.5),
        };
        let text = serde_json::to_string(&scan).unwrap();
        assert!(text.contains("\"ranges\":[1.5,null,0.25]"), "{text}");
        assert_eq!(serde_json::from_str::<Scan>(&text).unwrap(), scan);
        assert_eq!(scan.returns().count(), 2);
        assert!(scan.is_sane());
    }
}
