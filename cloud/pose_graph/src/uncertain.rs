//! Uncertain poses. Uncertainty of one pose relative to another along a chain of measurements.
//!
//! First order, on the tangent space at the far end: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics",
//! UAI 1986 (compounding and inversion).

use nalgebra::{Matrix3, Vector3};
use zenav_protocol::geometry::Pose2;

use crate::covariance::mahalanobis;
use crate::graph::Edge;

/// Added to information matrices before they are inverted, as a share of the largest entry, for directions that an edge does not constrain.
const LEAST_INFORMATION: f64 = 1e-9;

/// A relative pose `near_from_far` and its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uncertain {
    /// `near_from_far`, m and rad.
    pub pose: Pose2,
    /// Covariance of x, y (m²) and yaw (rad²) in the frame of the far end.
    pub covariance: Matrix3<f64>,
}

/// Maps a small motion at the far end of `pose` to one at its near end.
fn adjoint(pose: Pose2) -> Matrix3<f64> {
    let (sin, cos) = pose.yaw.sin_cos();
    Matrix3::new(cos, -sin, pose.y, sin, cos, -pose.x, 0.0, 0.0, 1.0)
}

impl Uncertain {
    /// The pose of something relative to itself.
    pub const CERTAIN: Self = Self {
        pose: Pose2::IDENTITY,
        covariance: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    /// The far end of an edge, by its measurement.
    #[must_use]
    pub fn of(edge: &Edge) -> Self {
        // Scaled, so that a determinant is neither too small nor too large for a number: no inverse would read as certainty.
        let largest = edge.information.amax().max(f64::MIN_POSITIVE);
        let scaled = edge.information / largest + Matrix3::identity() * LEAST_INFORMATION;
        Self {
            pose: edge.measurement,
            covariance: scaled.try_inverse().unwrap_or_else(Matrix3::identity) / largest,
        }
    }

    /// The near end relative to the far one.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let turn = adjoint(self.pose);
        Self {
            pose: self.pose.inverse(),
            covariance: turn * self.covariance * turn.transpose(),
        }
    }

    /// The far end of `next`, which begins at the far end of this one; their errors are independent.
    ///
    /// ```
    /// use nalgebra::Matrix3;
    /// use zenav_pose_graph::Uncertain;
    /// use zenav_protocol::geometry::Pose2;
    ///
    /// // 1 m straight on, known to 0.1 m and 0.05 rad, twice.
    /// let covariance = Matrix3::from_diagonal(&[0.01, 0.01, 0.0025].into());
    /// let step = Uncertain { pose: Pose2::new(1.0, 0.0, 0.0), covariance };
    /// let both = step.then(&step);
    /// assert_eq!(both.pose, Pose2::new(2.0, 0.0, 0.0));
    /// assert!((both.covariance[(0, 0)] - 0.02).abs() < 1e-12);
    /// assert!((both.covariance[(1, 1)] - (0.02 + 0.0025)).abs() < 1e-12, "the first turn swings the second metre");
    /// ```
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        let back = adjoint(next.pose.inverse());
        Self {
            pose: self.pose * next.pose,
            covariance: back * self.covariance * back.transpose() + next.covariance,
        }
    }

    /// Squared Mahalanobis distance from the identity: chi squared with three degrees of freedom.
    ///
    /// ```
    /// use nalgebra::Matrix3;
    /// use zenav_pose_graph::Uncertain;
    /// use zenav_protocol::geometry::Pose2;
    ///
    /// // Two measurements of one distance, 1 m and 1.3 m, each known to 0.1 m: there by one and back by the other.
    /// let measured = |x| Uncertain { pose: Pose2::new(x, 0.0, 0.0), covariance: Matrix3::identity() * 0.01 };
    /// let cycle = measured(1.0).then(&measured(1.3).inverse());
    /// assert!((cycle.chi_squared() - 0.3 * 0.3 / 0.02).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn chi_squared(&self) -> f64 {
        let Pose2 { x, y, yaw } = self.pose;
        mahalanobis(&Vector3::new(x, y, yaw), &self.covariance)
    }
}
