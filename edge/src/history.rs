//! Pose history. Where was the robot at an earlier stamp? Odometry of the last seconds, interpolated.

use std::collections::VecDeque;

use zenav_protocol::geometry::Pose2;
use zenav_protocol::time::Stamp;

/// Poses kept: five seconds at 50 Hz.
const CAPACITY: usize = 256;

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
        if self.poses.len() == CAPACITY {
            self.poses.pop_front();
        }
        self.poses.push_back((stamp, odom_from_base));
    }

    /// Stamp of the newest pose.
    #[must_use]
    pub fn newest(&self) -> Option<Stamp> {
        self.poses.back().map(|(stamp, _)| *stamp)
    }

    /// The pose at a stamp; the newest pose for later ones, `None` for a stamp before the oldest.
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
