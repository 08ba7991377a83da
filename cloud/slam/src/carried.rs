//! Carried. Whether the robot was carried between two scans: they follow each other closely and show different surroundings.
//!
//! New sights and changes in a building come bit by bit, and people who step in front of the robot only hide what was there.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_scan_matching::{FieldSettings, LikelihoodField, Refinable, judge};

use crate::settings::SlamSettings;

/// Two scans at most this long and this far apart, s, m and rad, see mostly the same, unless the robot was carried between them.
const CONTINUOUS: (f64, f64, f64) = (0.5, 0.3, 0.3);
/// The robot was carried if a smaller share of a scan lies at what the last one saw, ...
const SEEN_BEFORE: f64 = 0.5;
/// ... a larger share of its beams goes through that, ...
const BEYOND: f64 = 0.05;
/// ... and where it matches the last one best, a smaller share lies at what that one saw, ...
const SEEN_IF_MATCHED: f64 = 0.7;
/// ... or the match is farther from where odometry leads than wheels slip between two scans, m and rad.
const LARGEST_SLIP: (f64, f64) = (0.4, 0.3);
/// Cells and standard deviation of what the last scan saw, m: beams far away are as far apart, and people move on a little.
const LAST_SEEN: FieldSettings = FieldSettings {
    resolution: 0.05,
    sigma: 0.15,
};

/// What the last two scans saw.
#[derive(Clone, Debug, Default)]
pub(crate) struct LastSeen {
    /// Points of the newest scan, in the frame of its base.
    newest: Vec<Point2<f64>>,
    /// Points of the scan before it, in the frame of the newest scan's base by odometry; empty if the two are too far apart.
    before: Vec<Point2<f64>>,
}

impl LastSeen {
    /// Takes in the points of a scan, `secs` and a `step` of odometry (`before_from_newest`) after the last one.
    pub(crate) fn take(&mut self, secs: f64, step: Pose2, seen: &[Point2<f64>]) {
        let (longest, far, turn) = CONTINUOUS;
        self.before = std::mem::replace(&mut self.newest, seen.to_vec());
        if secs > longest || step.x.hypot(step.y) > far || step.yaw.abs() > turn {
            self.before.clear();
        }
        let back = step.inverse();
        for point in &mut self.before {
            *point = back.transform_point(*point);
        }
    }

    /// Forgets both: odometry restarts.
    pub(crate) fn forget(&mut self) {
        *self = Self::default();
    }

    /// Number of points of the scan before the newest one; 0 if the two are too far apart.
    pub(crate) fn points_before(&self) -> usize {
        self.before.len()
    }

    /// Whether the newest scan, whose points are `seen`, shows other surroundings than the one before, neither where odometry leads nor
    /// matched to it.
    pub(crate) fn is_elsewhere(&self, laser: Point2<f64>, seen: &[Point2<f64>], settings: &SlamSettings) -> bool {
        let mut before = LikelihoodField::new(&LAST_SEEN);
        before.insert(Pose2::IDENTITY, &self.before);
        let judged = |at: Pose2| judge(&before, laser, seen, at, &settings.verdict);
        let by_odometry = judged(Pose2::IDENTITY);
        if by_odometry.explained >= SEEN_BEFORE || by_odometry.through_walls <= BEYOND {
            return false;
        }
        let scan = Refinable::seen_from(laser, seen);
        let matched = scan.refine(&before, Pose2::IDENTITY, None, &settings.refine);
        let (slip, turn) = (matched.pose.position().coords.norm(), matched.pose.yaw.abs());
        slip > LARGEST_SLIP.0 || turn > LARGEST_SLIP.1 || judged(matched.pose).explained < SEEN_IF_MATCHED
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walls of a room of 5 m by 3.4 m with a niche, as seen from a pose in it.
    fn seen_from(pose: Pose2) -> Vec<Point2<f64>> {
        let corners = [
            (-2.0, -1.4),
            (3.0, -1.4),
            (3.0, 0.2),
            (3.6, 0.2),
            (3.6, 1.0),
            (3.0, 1.0),
            (3.0, 2.0),
            (-2.0, 2.0),
            (-2.0, -1.4),
        ];
        let sides = corners.windows(2).flat_map(|side| {
            let (from, to) = (Point2::new(side[0].0, side[0].1), Point2::new(side[1].0, side[1].1));
            let count = ((to - from).norm() / 0.03) as u32;
            (0..count).map(move |nth| from + (to - from) * f64::from(nth) / f64::from(count))
        });
        sides.map(|point| pose.inverse().transform_point(point)).collect()
    }

    /// Whether a robot counts as carried that its odometry holds to stand still, while it got from the origin to a pose.
    fn is_carried_to(pose: Pose2) -> bool {
        let mut last_seen = LastSeen::default();
        let there = seen_from(pose);
        last_seen.take(0.1, Pose2::IDENTITY, &seen_from(Pose2::IDENTITY));
        last_seen.take(0.1, Pose2::IDENTITY, &there);
        last_seen.is_elsewhere(Point2::origin(), &there, &SlamSettings::default())
    }

    #[test]
    fn wheels_slip_by_decimetres_and_whoever_is_farther_off_was_carried_though_the_scan_matches_there() {
        assert!(!is_carried_to(Pose2::new(0.25, -0.2, 0.1)));
        for far in [Pose2::new(0.35, 0.3, 0.0), Pose2::new(0.2, -0.2, 0.35)] {
            assert!(is_carried_to(far), "{far:?}");
        }
    }
}
