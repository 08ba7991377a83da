//! Odometry filter. Learns the quality of odometry from matches, and predicts the certainty of the pose it leads to.
//!
//! The settings bound the odometry of any robot. The odometry of this robot shows while driving: a wheel larger than stated makes every
//! step shorter by the same share, and steps that matches confirm to a millimetre need not be doubted by a centimetre. Both are learned
//! from matches that constrain the direction in question; whatever is not observed stays as set.
//!
//! A Kalman filter over the scale and the pose in the surrounding map: where scans do not constrain a direction, the error of odometry
//! accumulates until they do, and they then correct it.

use nalgebra::{Matrix2, Matrix3, Matrix4, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::Pose2;

use crate::information::odometry_information;
use crate::settings::OdometrySettings;

/// Number of steps averaged over.
const MEMORY: f64 = 200.0;
/// Lower bound on the learned variance, as a share of that in the settings.
const LEAST: f64 = 0.01;
/// A correction of more than this many standard deviations, squared, is a slip or a wrong match: the scale is not learned from it.
const OUTLIER: f64 = 9.0;
/// Standard deviation of the scale at the start, and its lower bound: tyres and floors change.
const SCALE: [f64; 2] = [0.05, 0.001];
/// The scale is learned after this many matches in a row that constrain all directions: the first scans of a corridor seem to.
const TOLD: u32 = 2;
/// Bounds on the scale of the wheels.
const SCALES: [f64; 2] = [0.8, 1.25];
/// Added to a covariance before it is inverted, m² and rad².
const LEAST_VARIANCE: f64 = 1e-12;

/// Pose in the map and scale of odometry, as learned from matches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OdometryFilter {
    /// How much longer a step is than stated, as a factor.
    scale: f64,
    /// Variance relative to the settings: of the position, of the heading.
    variance: [f64; 2],
    /// Number of steps behind these, weighted by how much their matches knew.
    seen: [f64; 2],
    /// Matches in a row whose scans constrained all directions.
    told: u32,
    /// Covariance of the pose at the last match in the surrounding map, in its own frame (m, m, rad), and of the scale.
    known: [[f64; 4]; 4],
}

/// The prediction of odometry for a step from the last match: the covariance of pose and scale.
#[derive(Clone, Copy, Debug)]
pub struct ExpectedStep {
    known: Matrix4<f64>,
}

impl OdometryFilter {
    /// Before any match: the pose is known, the scale to 5 %.
    pub const UNSEEN: Self = Self {
        scale: 1.0,
        variance: [1.0; 2],
        // As if the settings had been confirmed some times.
        seen: [10.0; 2],
        told: 0,
        known: [[0.0; 4], [0.0; 4], [0.0; 4], [0.0, 0.0, 0.0, SCALE[0] * SCALE[0]]],
    };

    /// Returns the filter if all its numbers are valid.
    #[must_use]
    pub fn checked(self) -> Option<Self> {
        let positive = [self.variance, self.seen].concat();
        let is_sane = self.scale.is_finite()
            && positive.iter().all(|value| value.is_finite() && *value > 0.0)
            && self.known.as_flattened().iter().all(|value| value.is_finite());
        is_sane.then_some(self)
    }

    /// A step, corrected by the learned scale.
    #[must_use]
    pub fn corrected(&self, step: Pose2) -> Pose2 {
        Pose2::new(step.x * self.scale, step.y * self.scale, step.yaw)
    }

    /// Information of a step, in the frame of its end.
    #[must_use]
    pub fn information(&self, step: Pose2, settings: &OdometrySettings) -> Matrix3<f64> {
        let [position, heading] = self.variance.map(f64::sqrt).map(f64::recip);
        let trust = Matrix3::from_diagonal(&[position, position, heading].into());
        trust * odometry_information(step, settings) * trust
    }

    /// The certainty of the end of a step from the last match.
    ///
    /// ```
    /// use zenav_protocol::geometry::Pose2;
    /// use zenav_scan_matching::{OdometryFilter, OdometrySettings};
    ///
    /// let settings = OdometrySettings::default();
    /// let after = |metres| OdometryFilter::UNSEEN.expected(Pose2::new(metres, 0.0, 0.0), &settings).deviation();
    /// // 0.105 m by the settings, and 0.05 m because the wheels may be 5 % larger or smaller.
    /// assert!((after(1.0) - 0.105_f64.hypot(0.05)).abs() < 1e-6);
    /// assert!(after(2.0) > 1.8 * after(1.0));
    /// ```
    #[must_use]
    pub fn expected(&self, step: Pose2, settings: &OdometrySettings) -> ExpectedStep {
        let (sin, cos) = step.yaw.sin_cos();
        let back = Matrix2::new(cos, sin, -sin, cos);
        let mut on = Matrix4::identity();
        on.fixed_view_mut::<2, 2>(0, 0).copy_from(&back);
        on.fixed_view_mut::<2, 1>(0, 2)
            .copy_from(&(back * Vector2::new(-step.y, step.x)));
        on.fixed_view_mut::<2, 1>(0, 3)
            .copy_from(&(back * Vector2::new(step.x, step.y)));
        let mut known = on * Matrix4::from(self.known).transpose() * on.transpose();
        let noise = self
            .information(step, settings)
            .try_inverse()
            .unwrap_or_else(Matrix3::zeros);
        let mut pose = known.fixed_view_mut::<3, 3>(0, 0);
        pose += noise;
        ExpectedStep { known }
    }

    /// Continues without a match.
    pub fn go_on(&mut self, expected: &ExpectedStep) {
        self.told = 0;
        self.known = expected.known.transpose().into();
    }

    /// Learns from a match, `off` from the expected pose, in the frame of the scan; `scan`: the information of the scan alone; `tells_all`:
    /// whether it constrains all directions.
    ///
    /// ```
    /// use nalgebra::Matrix3;
    /// use zenav_protocol::geometry::Pose2;
    /// use zenav_scan_matching::{OdometryFilter, OdometrySettings};
    ///
    /// // The wheels are 5 % larger than stated; matches show it to a millimetre.
    /// let (step, settings, scan) = (Pose2::new(0.1, 0.0, 0.0), OdometrySettings::default(), Matrix3::identity() * 1e6);
    /// let mut filter = OdometryFilter::UNSEEN;
    /// for _ in 0..100 {
    ///     let off = Pose2::new(0.105 - filter.corrected(step).x, 0.0, 0.0);
    ///     filter.learn(&filter.expected(step, &settings), off, &scan, true);
    /// }
    /// assert!((filter.corrected(step).x - 0.105).abs() < 0.001);
    /// ```
    pub fn learn(&mut self, expected: &ExpectedStep, off: Pose2, scan: &Matrix3<f64>, tells_all: bool) {
        let last = *self;
        let before = expected.pose();
        let Some(gain) = before.try_inverse() else { return };
        let after = (gain + scan).try_inverse().unwrap_or(before);
        let off = Vector3::new(off.x, off.y, off.yaw);
        let mut has_slipped = false;
        for (which, axis) in [(0, 0), (1, 2)] {
            let shown = before[(axis, axis)] - after[(axis, axis)];
            let share = shown / before[(axis, axis)].max(LEAST_VARIANCE);
            if share < 0.05 {
                continue;
            }
            let ratio = (off[axis] * off[axis] / shown.max(LEAST_VARIANCE)).min(OUTLIER);
            has_slipped |= ratio >= OUTLIER;
            self.seen[which] = (self.seen[which] + share).min(MEMORY);
            let rate = share / self.seen[which];
            self.variance[which] *= 1.0 + rate * (ratio - 1.0);
            self.variance[which] = self.variance[which].clamp(LEAST, 1.0);
        }
        // The scale is corrected with the pose as far as the two are correlated.
        let mixed = expected.known.fixed_view::<1, 3>(3, 0).into_owned();
        let along = mixed * gain;
        let mut spread = expected.known[(3, 3)];
        self.told = if tells_all { self.told.saturating_add(1) } else { 0 };
        if self.told > TOLD && !has_slipped {
            self.scale = (self.scale + (along * off)[0]).clamp(SCALES[0], SCALES[1]);
            spread -= (along * (before - after) * along.transpose())[0];
        }
        let mut known = Matrix4::zeros();
        known.fixed_view_mut::<3, 3>(0, 0).copy_from(&after);
        let mixed = along * after;
        known.fixed_view_mut::<1, 3>(3, 0).copy_from(&mixed);
        known.fixed_view_mut::<3, 1>(0, 3).copy_from(&mixed.transpose());
        known[(3, 3)] = spread.max(SCALE[1] * SCALE[1]);
        self.known = known.transpose().into();
        // Odometry of 1e200 m is a finite number, too: the filter keeps its last valid state.
        *self = self.checked().unwrap_or(last);
    }

    /// Restarts with a pose that is known by a match alone.
    pub fn begin_anew(&mut self, scan: &Matrix3<f64>) {
        self.told = 0;
        let pose = (scan + Matrix3::identity())
            .try_inverse()
            .unwrap_or_else(Matrix3::identity);
        let mut known = Matrix4::zeros();
        known.fixed_view_mut::<3, 3>(0, 0).copy_from(&pose);
        known[(3, 3)] = self.known[3][3];
        self.known = known.transpose().into();
    }
}

impl ExpectedStep {
    fn pose(&self) -> Matrix3<f64> {
        self.known.fixed_view::<3, 3>(0, 0) + Matrix3::identity() * LEAST_VARIANCE
    }

    /// Standard deviation of the position in its least certain direction, m.
    #[must_use]
    pub fn deviation(&self) -> f64 {
        let [[xx, xy], [_, yy]] = self.known.fixed_view::<2, 2>(0, 0).into_owned().into();
        (0.5 * (xx + yy) + (0.5 * (xx - yy)).hypot(xy)).sqrt()
    }

    /// Information of the pose, in its frame.
    #[must_use]
    pub fn information(&self) -> Matrix3<f64> {
        self.pose().try_inverse().unwrap_or_else(Matrix3::zeros)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Drives straight on in steps of 10 cm with wheels 5 % larger than stated; some scans constrain everything to a centimetre, the others
    /// nothing.
    fn driven(steps: u32, tells: impl Fn(u32) -> bool) -> OdometryFilter {
        let settings = OdometrySettings::default();
        let scan = Matrix3::from_diagonal(&Vector3::new(1e4, 1e4, 1e6));
        let (mut odometry, mut off) = (OdometryFilter::UNSEEN, 0.0);
        for step in 0..steps {
            off += 0.105 - odometry.corrected(Pose2::new(0.1, 0.0, 0.0)).x;
            let expected = odometry.expected(Pose2::new(0.1, 0.0, 0.0), &settings);
            if tells(step) {
                let gain = (expected.information() + scan).try_inverse().unwrap_or_default() * scan;
                odometry.learn(&expected, Pose2::new(gain[(0, 0)] * off, 0.0, 0.0), &scan, true);
                off *= 1.0 - gain[(0, 0)];
            } else {
                odometry.go_on(&expected);
            }
        }
        odometry
    }

    #[test]
    fn larger_wheels_show_in_what_scans_tell() {
        let odometry = driven(200, |_| true);
        assert!((odometry.scale - 1.05).abs() < 0.005, "{}", odometry.scale);
    }

    #[test]
    fn they_show_where_scans_tell_now_and_then() {
        // Two of every three metres without information.
        let odometry = driven(300, |step| step % 30 < 10);
        assert!((odometry.scale - 1.05).abs() < 0.01, "{}", odometry.scale);
    }

    #[test]
    fn without_scans_the_error_adds_up() {
        let spread = |steps| driven(steps, |_| false).known[0][0].sqrt();
        assert!(spread(100) > 5.0 * spread(10), "{} {}", spread(100), spread(10));
        // Wheels may be 5 % larger or smaller.
        assert!(spread(100) > 0.5, "{}", spread(100));
    }
}
