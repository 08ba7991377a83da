//! Information. Certainty of a step of odometry and of a match, and its change of frame.

use nalgebra::{Matrix3, Vector3};
use zenav_protocol::geometry::{Pose2, wrap_angle};

use crate::refine::Prior;
use crate::settings::OdometrySettings;

/// Added to an information before it is inverted, 1/m² and 1/rad², for directions that a match does not constrain.
const LEAST_INFORMATION: f64 = 1e-3;

/// Information of a step of odometry, in the frame of its end.
///
/// ```
/// use zenav_protocol::geometry::Pose2;
/// use zenav_scan_matching::{OdometrySettings, odometry_information};
///
/// let metre = odometry_information(Pose2::new(1.0, 0.0, 0.0), &OdometrySettings::default());
/// let deviation = metre.diagonal().map(|information| information.sqrt().recip());
/// assert!((deviation.x - (0.005 + 0.1)).abs() < 1e-9, "m");
/// assert!((deviation.z - (0.003 + 0.05)).abs() < 1e-9, "rad");
/// ```
#[must_use]
pub fn odometry_information(step: Pose2, settings: &OdometrySettings) -> Matrix3<f64> {
    let (way, turn) = (step.x.hypot(step.y), step.yaw.abs());
    let position = settings.least + settings.per_metre * way + settings.slip_per_radian * turn;
    let heading = settings.least_turn + settings.per_radian * turn + settings.turn_per_metre * way;
    Matrix3::from_diagonal(&Vector3::new(position.powi(-2), position.powi(-2), heading.powi(-2)))
}

/// Information of a match with an inexact map: in no direction better than the floor.
///
/// ```
/// use nalgebra::Matrix3;
/// use zenav_scan_matching::floored;
///
/// // A match that claims 0.1 mm and 0.1 mrad.
/// let known = floored(&(Matrix3::identity() * 1e8), 0.01, 0.003);
/// let deviation = known.try_inverse().unwrap().diagonal().map(f64::sqrt);
/// assert!((deviation.x - 0.01).abs() < 1e-5 && (deviation.z - 0.003).abs() < 1e-5, "{deviation}");
/// ```
#[must_use]
pub fn floored(information: &Matrix3<f64>, floor: f64, floor_turn: f64) -> Matrix3<f64> {
    let known = information + Matrix3::identity() * LEAST_INFORMATION;
    let floor = Matrix3::from_diagonal(&Vector3::new(floor, floor, floor_turn).map(|sigma| sigma * sigma));
    let covariance = known.try_inverse().unwrap_or_else(Matrix3::identity) + floor;
    let information = covariance.try_inverse().unwrap_or_else(Matrix3::zeros);
    (information + information.transpose()) * 0.5
}

/// Rotates a symmetric matrix over x, y and yaw from the axes of a frame to those in which the frame's heading is `yaw`, rad.
///
/// ```
/// use nalgebra::{Matrix3, Vector3};
/// use zenav_scan_matching::turned;
///
/// // Well known along the robot's x axis; the robot faces along the map's y axis.
/// let by_robot = Matrix3::from_diagonal(&Vector3::new(400.0, 100.0, 2500.0));
/// let by_map = turned(&by_robot, std::f64::consts::FRAC_PI_2);
/// assert!((by_map.diagonal() - Vector3::new(100.0, 400.0, 2500.0)).norm() < 1e-9);
/// ```
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
    ///
    /// ```
    /// use zenav_protocol::geometry::Pose2;
    /// use zenav_scan_matching::{OdometrySettings, Prior, odometry_information};
    ///
    /// let step = odometry_information(Pose2::new(1.0, 0.0, 0.0), &OdometrySettings::default());
    /// let prior = Prior::of_odometry(Pose2::new(5.0, 2.0, 1.0), &step);
    /// assert_eq!(prior.chi_squared(prior.pose), 0.0);
    /// // After a metre odometry has a standard deviation of 0.105 m: this pose is two of them away.
    /// assert!((prior.chi_squared(Pose2::new(5.0, 2.21, 1.0)) - 4.0).abs() < 1e-6);
    /// ```
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
