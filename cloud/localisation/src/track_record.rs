//! Track record. Since where the robot was followed without a break, and how well. A scan that contradicts the map means that the robot was
//! carried away, or that the building has changed: a robot that is carried away sees other things from one scan to the next, and one that
//! drives past moved furniture does not.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;

/// Side of the cells in which a scan is compared with the one before, m.
const CELL: f64 = 0.1;
/// Cells of one side of the square that is repeated without end: 25.6 m.
const SIDE: usize = 256;
/// Fewer points tell nothing about a break.
const LEAST_POINTS: usize = 20;
/// If a smaller share of a scan was seen by the one before, the robot was carried meanwhile, or odometry began anew.
const SEEN_BEFORE: f64 = 0.5;
/// A robot that was followed well is followed through surroundings that contradict the map for as far again, and no farther than this, m.
const MOST: f64 = 3.0;

/// How far a robot was followed in agreement with the map.
#[derive(Clone, Debug, Default)]
pub(crate) struct TrackRecord {
    /// Odometry at the last scan, and the cells that it saw, in the frame of odometry.
    last: Option<(Pose2, Cells)>,
    /// Distance to that scan from the one before it, m.
    way: f64,
    /// Distance in agreement with the map less distance in contradiction to it, m.
    credit: f64,
}

impl TrackRecord {
    /// Forgets everything: the robot's place is new.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Takes in a scan, its points in the frame of the base (m), and the odometry at it.
    pub(crate) fn see(&mut self, odom_from_base: Pose2, points: &[Point2<f64>]) {
        if points.len() < LEAST_POINTS {
            return;
        }
        let seen: Vec<Point2<f64>> = points
            .iter()
            .map(|point| odom_from_base.transform_point(*point))
            .collect();
        let mut cells = Cells::default();
        seen.iter().for_each(|point| cells.add_around(*point));
        if let Some((then, before)) = self.last.replace((odom_from_base, cells)) {
            let known = seen.iter().filter(|point| before.contains(**point)).count();
            if (known as f64) < SEEN_BEFORE * seen.len() as f64 {
                self.credit = 0.0;
            }
            self.way += then.distance(&odom_from_base);
        }
    }

    /// Notes whether the scan seen last agrees with the map, contradicts it, or neither.
    pub(crate) fn note(&mut self, agrees: bool, contradicts: bool) {
        let way = std::mem::take(&mut self.way);
        if contradicts {
            self.credit = (self.credit - way).max(0.0);
        } else if agrees {
            self.credit = (self.credit + way).min(MOST);
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
    fn follow(record: &mut TrackRecord, from: u32, scans: u32, wall: f64, agrees: bool) {
        for nth in from..from + scans {
            let pose = Pose2::new(0.0, 0.1 * f64::from(nth), 0.4);
            record.see(pose, &seen(wall, pose));
            record.note(agrees, !agrees);
        }
    }

    #[test]
    fn a_robot_is_followed_through_changed_surroundings_for_as_far_as_it_was_followed_well() {
        let mut record = TrackRecord::default();
        follow(&mut record, 0, 11, 2.0, true);
        assert!(record.vouches());
        follow(&mut record, 11, 9, 2.0, false);
        assert!(record.vouches());
        follow(&mut record, 20, 2, 2.0, false);
        assert!(!record.vouches());
    }

    #[test]
    fn a_robot_that_is_carried_away_is_no_longer_vouched_for() {
        let mut record = TrackRecord::default();
        follow(&mut record, 0, 11, 2.0, true);
        // The wall is elsewhere from one scan to the next, and odometry says nothing of it.
        follow(&mut record, 11, 1, 3.0, false);
        assert!(!record.vouches());
    }

    #[test]
    fn odometry_that_is_out_of_all_bounds_is_survived() {
        let mut record = TrackRecord::default();
        record.see(Pose2::new(1e300, -1e18, 0.0), &seen(2.0, Pose2::IDENTITY));
        record.note(true, false);
        assert!(!record.vouches());
    }
}
