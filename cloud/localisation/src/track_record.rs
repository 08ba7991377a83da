//! Track record. How far the robot was followed in agreement with the map and without a break. A scan that contradicts the map means that
//! the robot was carried away, or that the building has changed. Where the building has changed, scans continue one another: each sees mostly
//! what the one before saw, from where odometry has led.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;

/// Side of the cells in which a scan is compared with the one before, m.
const CELL: f64 = 0.1;
/// Cells of one side of the square that is repeated without end: 25.6 m.
const SIDE: usize = 256;
/// Fewer points tell nothing about a break.
const LEAST_POINTS: usize = 20;
/// If a smaller share of such a scan was seen by the one before, the robot was carried meanwhile, or odometry began anew.
const SEEN_BEFORE: f64 = 0.5;
/// A scan that does not agree with the map is compared with the last one that did or, once odometry has moved this far, m and rad, with a later
/// one. So a robot at rest that is carried slowly is compared with where it was.
const APART: (f64, f64) = (0.1, 0.1);
/// A robot is followed through surroundings that contradict the map for as far as it was followed in agreement before, at most this, m.
const MOST: f64 = 3.0;
/// Longest distance between two scans that counts, m: what was passed between them is not known.
const LONGEST_STEP: f64 = 0.5;

/// How a scan fits the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fit {
    /// It agrees, and determines the pose.
    Agrees,
    /// It says too little.
    SaysLittle,
    /// It does not agree.
    Contradicts,
}

/// How far a robot was followed in agreement with the map.
#[derive(Clone, Debug, Default)]
pub(crate) struct TrackRecord {
    /// Odometry at the scan that later ones are compared with, and the cells that it saw, in the frame of odometry.
    anchor: Option<(Pose2, Cells)>,
    /// Odometry at the last scan.
    last: Option<Pose2>,
    /// Distance in agreement with the map less distance in contradiction to it, m.
    credit: f64,
}

impl TrackRecord {
    /// Forgets everything: the robot's place is new.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Takes in a scan, its points in the frame of the base (m), the odometry at it, and how it fits the map.
    pub(crate) fn take(&mut self, odom_from_base: Pose2, points: &[Point2<f64>], fit: Fit) {
        let step = self.last.map_or(0.0, |last| last.distance(&odom_from_base));
        self.last = Some(odom_from_base);
        if points.len() < LEAST_POINTS {
            return;
        }
        let seen: Vec<Point2<f64>> = points
            .iter()
            .map(|point| odom_from_base.transform_point(*point))
            .collect();
        let way = step.min(LONGEST_STEP);
        match fit {
            Fit::Agrees => self.credit = (self.credit + way).min(MOST),
            Fit::SaysLittle => {}
            Fit::Contradicts => self.credit = (self.credit - way).max(0.0),
        }
        let mut is_anchor = true;
        if fit != Fit::Agrees
            && let Some((then, before)) = &self.anchor
        {
            let known = seen.iter().filter(|point| before.contains(**point)).count();
            if (known as f64) < SEEN_BEFORE * seen.len() as f64 {
                self.credit = 0.0;
            }
            let since = then.inverse() * odom_from_base;
            is_anchor = since.x.hypot(since.y) >= APART.0 || since.yaw.abs() >= APART.1;
        }
        if is_anchor {
            let mut cells = Cells::default();
            seen.iter().for_each(|point| cells.add_around(*point));
            self.anchor = Some((odom_from_base, cells));
        }
    }

    /// Whether the robot is where it is followed, though scans contradict the map.
    pub(crate) fn vouches(&self) -> bool {
        self.credit > 0.0
    }
}

/// A set of cells, with those around each. The plane is a square that is repeated: points in equal cells of two of them are confused.
#[derive(Clone, Debug)]
struct Cells(Vec<u64>);

impl Default for Cells {
    fn default() -> Self {
        Self(vec![0; SIDE * SIDE / 64])
    }
}

impl Cells {
    fn add_around(&mut self, point: Point2<f64>) {
        let (x, y) = cell(point);
        for y in [y + SIDE - 1, y, y + 1] {
            for x in [x + SIDE - 1, x, x + 1] {
                let bit = y % SIDE * SIDE + x % SIDE;
                self.0[bit / 64] |= 1 << (bit % 64);
            }
        }
    }

    fn contains(&self, point: Point2<f64>) -> bool {
        let (x, y) = cell(point);
        let bit = y * SIDE + x;
        self.0[bit / 64] >> (bit % 64) & 1 == 1
    }
}

/// Column and row of a point's cell.
fn cell(point: Point2<f64>) -> (usize, usize) {
    // Odometry may say anything: what is out of all bounds is in some cell.
    let index = |along: f64| (along / CELL).floor().rem_euclid(SIDE as f64) as usize % SIDE;
    (index(point.x), index(point.y))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall of 2 m in the room, from the robot's pose in it.
    fn seen(x: f64, room_from_base: Pose2) -> Vec<Point2<f64>> {
        let base_from_room = room_from_base.inverse();
        let wall = (0..40).map(|nth| Point2::new(x, 0.05 * f64::from(nth)));
        wall.map(|point| base_from_room.transform_point(point)).collect()
    }

    /// Drives on along y, 0.1 m a scan.
    fn follow(record: &mut TrackRecord, from: u32, scans: u32, fit: Fit) {
        for nth in from..from + scans {
            let pose = Pose2::new(0.0, 0.1 * f64::from(nth), 0.4);
            record.take(pose, &seen(2.0, pose), fit);
        }
    }

    #[test]
    fn a_robot_is_followed_through_changed_surroundings_for_as_far_as_it_was_followed_well() {
        let mut record = TrackRecord::default();
        follow(&mut record, 0, 11, Fit::Agrees);
        follow(&mut record, 11, 5, Fit::SaysLittle);
        assert!(record.vouches());
        follow(&mut record, 16, 9, Fit::Contradicts);
        assert!(record.vouches());
        follow(&mut record, 25, 2, Fit::Contradicts);
        assert!(!record.vouches());
    }

    #[test]
    fn a_robot_that_is_carried_away_at_once_or_slowly_is_no_longer_vouched_for() {
        // By how much the wall comes nearer from one scan to the next; odometry stands.
        for step in [1.0, 0.04] {
            let mut record = TrackRecord::default();
            follow(&mut record, 0, 11, Fit::Agrees);
            let pose = Pose2::new(0.0, 1.0, 0.4);
            let carried = (1..=10).find(|nth| {
                record.take(pose, &seen(2.0 - step * f64::from(*nth), pose), Fit::Contradicts);
                !record.vouches()
            });
            assert!(
                carried.is_some_and(|nth| step * f64::from(nth) <= 1.0),
                "{step}: {carried:?}"
            );
        }
    }

    #[test]
    fn a_leap_of_odometry_earns_little() {
        for far in [Pose2::new(1e300, -1e18, 0.0), Pose2::new(50.0, 0.0, 0.0)] {
            let mut record = TrackRecord::default();
            follow(&mut record, 0, 2, Fit::Contradicts);
            record.take(far, &seen(2.0, Pose2::IDENTITY), Fit::Agrees);
            follow(&mut record, 0, 7, Fit::Contradicts);
            assert!(!record.vouches(), "{far:?}");
        }
    }
}
