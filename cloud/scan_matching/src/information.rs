//! Information. Certainty of a step of odometry and of a match, and its change of frame.

use nalgebra::{Matrix3, Vector3};
use zenav_protocol::geometry::{Pose2, wrap_angle};

use crate::refine::Prior;
use crate::settings::OdometrySettings;

/// Added to an information before it is inverted, 1/m² and 1/rad², for directions that a match does not constrain.
const LEAST_INFORMATION: f64 = 1e-3;

/// Information of a step of odometry, in the frame of its end.
#[must_use]
pub fn odometry_information(step: Pose2, settings: &OdometrySettings) -> Matrix3<f64> {
    let (way, turn) = (step.x.hypot(step.y), step.yaw.abs());
    let position = settings.least + settings.per_metre * way + settings.slip_per_radian * turn;
    let heading = settings.least_turn + settings.per_radian * turn + settings.turn_per_metre * way;
    Matrix3::from_diagonal(&Vector3::new(position.powi(-2), position.powi(-2), heading.powi(-2)))
}

/// Information of a match with an inexact map: in no direction better than the floor.
#[must_use]
pub fn floored(information: &Matrix3<f64>, floor: f64, floor_turn: f64) -> Matrix3<f64> {
    let known = information + Matrix3::identity() * LEAST_INFORMATION;
    let floor = Matrix3::from_diagonal(&Vector3::new(floor, floor, floor_turn).map(|sigma| sigma * sigma));
    let covariance = known.try_inverse().unwrap_or_else(Matrix3::identity) + floor;
    let information = covariance.try_inverse().unwrap_or_else(Matrix3::zeros);
    (information + information.transpose()) * 0.5
}

/// Rotates a symmetric matrix over x, y and yaw from the axes of a frame to those in which the frame's heading is `yaw`, rad.
#[must_use]
pub fn turned(matrix: &Matrix3<f64>, yaw: f64) -> Matrix3<f64> {
    let (sin, cos) = yaw.sin_cos();
    let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    turn * matrix * turn.transpose()
}

impl Prior {
    /// The prior by odometry: `field_from_scan` as expected, and the information of the step in the frame of its end.
    #[must_use]
    pub fn of_odometry(field_from_scan: Pose2, information: &Matrix3<f64>) -> Self {
        Self {
            pose: field_from_scan,
            information: turned(information, field_from_scan.yaw),
        }
    }

    /// Chi squared of a pose under the prior, three degrees of freedom.
    #[must_use]
    pub fn chi_squared(&self, field_from_scan: Pose2) -> f64 {
        let (expected, pose) = (self.pose, field_from_scan);
        let off = Vector3::new(
            pose.x - expected.x,
            pose.y - expected.y,
            wrap_angle(pose.yaw - expected.yaw),
        );
        off.dot(&(self.information * off))
    }
}
