//! Odometry. How good is it, as far as matches have shown?
//!
//! The settings say what any robot's odometry may be like. How this one's is shows as it drives: a wheel that is larger than stated makes
//! every step shorter by the same share, and steps that matches confirm to a millimetre need not be doubted by a centimetre. Both are
//! learned from matches that know the direction in question; what nothing shows stays as the settings have it.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_scan_matching::{OdometrySettings, marginal, odometry_information};

/// Steps over which is averaged.
const MEMORY: f64 = 200.0;
/// Shortest step, m, that shows a scale.
const SHORTEST: f64 = 0.03;
/// Odometry is never trusted more than this times what the settings say, in variance.
const LEAST: f64 = 0.01;
/// A residual of more than this many standard deviations, squared, is a slip or a wrong match: it shows no scale.
const OUTLIER: f64 = 9.0;

/// What was learned.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Odometry {
    /// How much longer a step is than stated, as a factor.
    scale: f64,
    /// Variance against that of the settings: of the position, of the heading.
    variance: [f64; 2],
    /// Steps, by how much their matches knew, that these rest on.
    seen: [f64; 2],
}

impl Odometry {
    pub(crate) const UNSEEN: Self = Self {
        scale: 1.0,
        variance: [1.0; 2],
        // As if the settings had been confirmed some times.
        seen: [10.0; 2],
    };

    /// This, where all of it can be.
    pub(crate) fn checked(self) -> Option<Self> {
        let positive = [self.variance, self.seen].concat();
        let is_sane = self.scale.is_finite() && positive.iter().all(|value| value.is_finite() && *value > 0.0);
        is_sane.then_some(self)
    }

    /// A step as it was in truth, as far as is known.
    pub(crate) fn corrected(&self, step: Pose2) -> Pose2 {
        Pose2::new(step.x * self.scale, step.y * self.scale, step.yaw)
    }

    /// Information of a step, frame of its end.
    pub(crate) fn information(&self, step: Pose2, settings: &OdometrySettings) -> Matrix3<f64> {
        let [position, heading] = self.variance.map(f64::sqrt).map(f64::recip);
        let trust = Matrix3::from_diagonal(&[position, position, heading].into());
        trust * odometry_information(step, settings) * trust
    }

    /// Learns from a match. `step` is odometry's, `expected` the pose that followed from it with the information `known`, `matched` the pose
    /// that step and scan gave together, `scan` the information of the scan alone.
    pub(crate) fn learn(
        &mut self,
        step: Pose2,
        expected: Pose2,
        known: &Matrix3<f64>,
        matched: Pose2,
        scan: &Matrix3<f64>,
        settings: &OdometrySettings,
    ) {
        let stated = odometry_information(step, settings);
        let off = expected.inverse() * matched;
        let scan = marginal(scan);
        for (which, off, axis) in [(0, off.x, 0), (1, wrap_angle(off.yaw), 2)] {
            let (by_scan, by_odometry) = (scan[axis], known[(axis, axis)]);
            let share = by_scan / (by_scan + by_odometry);
            if share < 0.05 {
                continue;
            }
            // What the scan alone would have said.
            let residual = off / share;
            let squared = residual * residual * stated[(axis, axis)];
            self.seen[which] = (self.seen[which] + share).min(MEMORY);
            let rate = share / self.seen[which];
            self.variance[which] += rate * (squared - self.variance[which]);
            self.variance[which] = self.variance[which].clamp(LEAST, 1.0);
            if which == 0 && step.x.abs() >= SHORTEST && squared < OUTLIER {
                self.scale += rate * residual / step.x;
            }
        }
    }
}
