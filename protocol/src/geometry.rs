//! Planar geometry. How are poses, velocities and angles represented? (REP-103: x forward, y left, yaw counter-clockwise in (-pi, pi].)
//!
//! Variable names state the frames, as `a_from_b`: `map_from_base = map_from_odom * odom_from_base`.

use std::f64::consts::{PI, TAU};
use std::ops::Mul;

use nalgebra::{Isometry2, Point2, Vector2};
use serde::{Deserialize, Serialize};

/// Largest absolute coordinate of maps, goals, zones, worlds and positions, m. Here a coordinate is still exact to 1e-9 cells of 0.05 m, the
/// tolerance of footprint checks; at the coordinates of national grids it would not be.
pub const MAX_COORDINATE: f64 = 100_000.0;

/// Wraps an angle (rad) into (-pi, pi].
///
/// Returns NaN for a non-finite angle.
///
/// ```
/// use std::f64::consts::PI;
/// use zenav_protocol::geometry::wrap_angle;
///
/// assert!((wrap_angle(6.5 * PI) - 0.5 * PI).abs() < 1e-9);
/// assert_eq!(wrap_angle(-PI), PI, "-pi itself is outside");
/// assert!(wrap_angle(f64::INFINITY).is_nan());
/// ```
#[must_use]
pub fn wrap_angle(angle: f64) -> f64 {
    if angle > -PI && angle <= PI {
        return angle;
    }
    let wrapped = angle.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// A rigid transform in the plane: position in metres, yaw in radians.
///
/// The only pose type of the stack: on the wire it is `{"x": …, "y": …, "yaw": …}`; for linear algebra it converts to
/// [`nalgebra::Isometry2`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Pose2 {
    /// Metres along the parent frame's x axis.
    pub x: f64,
    /// Metres along the parent frame's y axis.
    pub y: f64,
    /// Heading in radians, counter-clockwise from the parent's x axis.
    #[serde(default)]
    pub yaw: f64,
}

impl Pose2 {
    /// The identity transform.
    pub const IDENTITY: Self = Self {
        x: 0.0,
        y: 0.0,
        yaw: 0.0,
    };

    /// A pose from metres, metres and radians; the yaw is wrapped.
    ///
    /// ```
    /// use std::f64::consts::FRAC_PI_2;
    /// use zenav_protocol::geometry::Pose2;
    ///
    /// // The robot is at (2, 1) and faces along the map's y axis; its lidar is mounted 0.2 m ahead of the base's origin.
    /// let map_from_base = Pose2::new(2.0, 1.0, FRAC_PI_2);
    /// let base_from_laser = Pose2::new(0.2, 0.0, 0.0);
    /// let map_from_laser = map_from_base * base_from_laser;
    /// assert!((map_from_laser.x - 2.0).abs() < 1e-12 && (map_from_laser.y - 1.2).abs() < 1e-12);
    /// assert_eq!(map_from_laser.yaw, FRAC_PI_2);
    /// ```
    #[must_use]
    pub fn new(x: f64, y: f64, yaw: f64) -> Self {
        Self {
            x,
            y,
            yaw: wrap_angle(yaw),
        }
    }

    /// Position of the pose, without its yaw.
    #[must_use]
    pub fn position(&self) -> Point2<f64> {
        Point2::new(self.x, self.y)
    }

    /// Unit vector along the pose's x axis, in the parent frame.
    #[must_use]
    pub fn heading(&self) -> Vector2<f64> {
        Vector2::new(self.yaw.cos(), self.yaw.sin())
    }

    /// The same position, with the opposite heading.
    #[must_use]
    pub fn turned(&self) -> Self {
        Self::new(self.x, self.y, self.yaw + std::f64::consts::PI)
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.yaw.is_finite()
    }

    /// `b_from_a` of this `a_from_b`.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::geometry::Pose2;
    ///
    /// // A table at (3, 1) in the map, as seen by a robot at (1, 1) that faces along the map's y axis.
    /// let map_from_base = Pose2::new(1.0, 1.0, std::f64::consts::FRAC_PI_2);
    /// let table = map_from_base.inverse().transform_point(Point2::new(3.0, 1.0));
    /// assert!(table.x.abs() < 1e-12 && (table.y + 2.0).abs() < 1e-12, "2 m to the right: y points left");
    /// ```
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (sin, cos) = self.yaw.sin_cos();
        Self::new(-(cos * self.x + sin * self.y), sin * self.x - cos * self.y, -self.yaw)
    }

    /// Transforms a point from the pose's own frame into its parent frame.
    #[must_use]
    pub fn transform_point(&self, point: Point2<f64>) -> Point2<f64> {
        let (sin, cos) = self.yaw.sin_cos();
        Point2::new(
            self.x + cos * point.x - sin * point.y,
            self.y + sin * point.x + cos * point.y,
        )
    }

    /// Straight-line distance between two positions in the same frame, m.
    #[must_use]
    pub fn distance(&self, other: &Self) -> f64 {
        (self.x - other.x).hypot(self.y - other.y)
    }

    /// Linear interpolation between two poses of one frame, with the heading taking the shorter way round: `share` 0 is this pose, 1 is
    /// `to`.
    ///
    /// ```
    /// use zenav_protocol::geometry::Pose2;
    ///
    /// let (from, to) = (Pose2::new(0.0, 0.0, 3.1), Pose2::new(1.0, 2.0, -3.1));
    /// let middle = from.interpolate(&to, 0.5);
    /// assert_eq!((middle.x, middle.y), (0.5, 1.0));
    /// assert!(middle.yaw.abs() > 3.14);
    /// ```
    #[must_use]
    pub fn interpolate(&self, to: &Self, share: f64) -> Self {
        Self::new(
            self.x + share * (to.x - self.x),
            self.y + share * (to.y - self.y),
            self.yaw + share * wrap_angle(to.yaw - self.yaw),
        )
    }

    /// The pose after driving `twist` for `secs` along an arc (exact for constant velocities).
    ///
    /// ```
    /// use std::f64::consts::PI;
    /// use zenav_protocol::geometry::{Pose2, Twist2};
    ///
    /// // 0.5 m/s at 0.5 rad/s is a circle of 1 m radius; pi seconds are a quarter of it, to the left.
    /// let end = Pose2::IDENTITY.advance(Twist2::new(0.5, 0.5), PI);
    /// assert!((end.x - 1.0).abs() < 1e-9 && (end.y - 1.0).abs() < 1e-9 && (end.yaw - 0.5 * PI).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn advance(&self, twist: Twist2, secs: f64) -> Self {
        let turn = twist.w * secs;
        let (forward, left) = if turn.abs() < 1e-9 {
            (twist.v * secs, 0.5 * twist.v * secs * turn)
        } else {
            let radius = twist.v / twist.w;
            (radius * turn.sin(), radius * (1.0 - turn.cos()))
        };
        *self
            * Self {
                x: forward,
                y: left,
                yaw: turn,
            }
    }
}

impl Mul for Pose2 {
    type Output = Self;

    /// Chains transforms: `a_from_b * b_from_c = a_from_c`.
    #[expect(
        clippy::suspicious_arithmetic_impl,
        reason = "yaws add up where transforms are multiplied"
    )]
    fn mul(self, b_from_c: Self) -> Self {
        let position = self.transform_point(b_from_c.position());
        Self::new(position.x, position.y, self.yaw + b_from_c.yaw)
    }
}

impl From<Pose2> for Isometry2<f64> {
    fn from(pose: Pose2) -> Self {
        Isometry2::new(Vector2::new(pose.x, pose.y), pose.yaw)
    }
}

impl From<Isometry2<f64>> for Pose2 {
    fn from(isometry: Isometry2<f64>) -> Self {
        Pose2::new(
            isometry.translation.x,
            isometry.translation.y,
            isometry.rotation.angle(),
        )
    }
}

/// Velocity of a differential-drive base in its own frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Twist2 {
    /// Forward speed of the base, m/s.
    pub v: f64,
    /// Yaw rate, rad/s, counter-clockwise positive.
    pub w: f64,
}

impl Twist2 {
    /// The twist of a base at rest.
    pub const ZERO: Self = Self { v: 0.0, w: 0.0 };

    /// A twist from m/s and rad/s.
    #[must_use]
    pub const fn new(v: f64, w: f64) -> Self {
        Self { v, w }
    }

    /// Whether both numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.v.is_finite() && self.w.is_finite()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-50.0..50.0, -50.0..50.0, -7.0..7.0).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
    }

    proptest! {
        #[test]
        fn chaining_agrees_with_nalgebra(a in pose(), b in pose()) {
            let ours = a * b;
            let theirs = Pose2::from(Isometry2::from(a) * Isometry2::from(b));
            prop_assert!(ours.distance(&theirs) < 1e-9);
            prop_assert!(wrap_angle(ours.yaw - theirs.yaw).abs() < 1e-9);
        }

        #[test]
        fn a_pose_times_its_inverse_changes_nothing(a in pose()) {
            let identity = a * a.inverse();
            prop_assert!(identity.distance(&Pose2::IDENTITY) < 1e-9 && wrap_angle(identity.yaw).abs() < 1e-9);
        }

        #[test]
        fn driving_an_arc_equals_many_small_steps(a in pose(), v in -1.0..1.0, w in -2.0..2.0) {
            let twist = Twist2::new(v, w);
            let mut stepped = a;
            for _ in 0..1000 {
                stepped = stepped.advance(twist, 0.001);
            }
            let once = a.advance(twist, 1.0);
            prop_assert!(once.distance(&stepped) < 1e-6);
        }

        #[test]
        fn wrapped_angles_lie_in_the_half_open_circle(angle in -1e6..1e6) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped > -PI && wrapped <= PI);
            prop_assert!(((angle - wrapped) / TAU - ((angle - wrapped) / TAU).round()).abs() < 1e-6);
        }
    }
}
