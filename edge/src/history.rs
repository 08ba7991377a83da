//! Pose history. Where was the robot at an earlier stamp? Odometry of the last seconds, interpolated.

use std::collections::VecDeque;

use zenav_protocol::geometry::Pose2;
use zenav_protocol::time::Stamp;

/// Poses are kept for longer than any sensor of a robot file takes to deliver, s, whatever their rate; and at most so many of them.
const KEPT: f64 = 11.0;
const MOST: usize = 4096;

/// Odometry poses in the order of their stamps.
#[derive(Clone, Debug, Default)]
pub struct PoseHistory {
    poses: VecDeque<(Stamp, Pose2)>,
}

impl PoseHistory {
    /// Adds the newest pose; one that is not newer than the last is left out.
    pub fn push(&mut self, stamp: Stamp, odom_from_base: Pose2) {
        if self.poses.back().is_some_and(|(last, _)| *last >= stamp) {
            return;
        }
        self.poses.push_back((stamp, odom_from_base));
        // The last pose before that time stays: the next ones are interpolated from it.
        let is_old = |(known, _): &(Stamp, Pose2)| stamp.secs_since(*known) >= KEPT;
        while self.poses.len() > MOST || self.poses.get(1).is_some_and(is_old) {
            self.poses.pop_front();
        }
    }

    /// Stamp of the newest pose.
    #[must_use]
    pub fn newest(&self) -> Option<Stamp> {
        self.poses.back().map(|(stamp, _)| *stamp)
    }

    /// The pose at a stamp; the newest pose for later ones, `None` for a stamp before the oldest.
    ///
    /// ```
    /// use zenav_edge::history::PoseHistory;
    /// use zenav_protocol::{geometry::Pose2, time::Stamp};
    ///
    /// let mut history = PoseHistory::default();
    /// for (secs, x) in [(1.0, 0.0), (1.02, 0.01)] {
    ///     history.push(Stamp::from_secs(secs), Pose2::new(x, 0.0, 0.0));
    /// }
    /// let x_at = |secs| history.at(Stamp::from_secs(secs)).map(|pose| pose.x);
    /// assert!((x_at(1.01).unwrap() - 0.005).abs() < 1e-9);
    /// assert_eq!((x_at(0.9), x_at(2.0)), (None, Some(0.01)));
    /// ```
    #[must_use]
    pub fn at(&self, stamp: Stamp) -> Option<Pose2> {
        let after = self.poses.partition_point(|(known, _)| *known < stamp);
        let Some((later_stamp, later)) = self.poses.get(after) else {
            return self.poses.back().map(|(_, pose)| *pose);
        };
        if *later_stamp == stamp {
            return Some(*later);
        }
        let (earlier_stamp, earlier) = self.poses.get(after.checked_sub(1)?)?;
        let share = stamp.secs_since(*earlier_stamp) / later_stamp.secs_since(*earlier_stamp);
        Some(earlier.interpolate(later, share))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_body_that_reports_often_is_remembered_for_as_long_as_another() {
        for rate in [20.0, 50.0, 250.0] {
            let mut history = PoseHistory::default();
            for nth in 0..(20.0 * rate) as u32 {
                let secs = f64::from(nth) / rate;
                history.push(Stamp::from_secs(secs), Pose2::new(secs, 0.0, 0.0));
            }
            let last = history.newest().unwrap();
            let x = history.at(last.plus_secs(-10.5)).map(|pose| pose.x);
            assert!(
                x.is_some_and(|x| (x - last.as_secs() + 10.5).abs() < 1e-6),
                "{rate} Hz: {x:?}"
            );
            assert_eq!(history.at(last.plus_secs(-12.0)), None, "{rate} Hz");
        }
        let mut history = PoseHistory::default();
        (0..100_000).for_each(|nth| history.push(Stamp(nth), Pose2::IDENTITY));
        assert_eq!(history.poses.len(), MOST);
    }

    #[test]
    fn a_pose_between_two_ticks_is_interpolated_across_the_turn_of_the_circle() {
        let mut history = PoseHistory::default();
        history.push(Stamp::from_secs(1.0), Pose2::new(0.0, 0.0, 3.1));
        history.push(Stamp::from_secs(1.1), Pose2::new(0.1, 0.0, -3.1));
        let middle = history.at(Stamp::from_secs(1.05)).unwrap();
        assert!((middle.x - 0.05).abs() < 1e-9 && middle.yaw.abs() > 3.13, "{middle:?}");
        assert_eq!(
            history.at(Stamp::from_secs(0.9)),
            None,
            "before the oldest nothing is known"
        );
        assert_eq!(history.at(Stamp::from_secs(9.0)).unwrap().x, 0.1);
    }
}
