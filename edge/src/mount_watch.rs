//! Mount watch. Does a lidar look where its file says, or is it mounted with another yaw?
//!
//! While the robot drives straight on, what stands seems to move straight back. If the lidar looks to the left by an angle, it seems to move
//! aside as well, by the sine of that angle. For two scans a short straight way apart, the distances of the later one's returns from the
//! surfaces of the earlier one are explained by that angle together with errors of the odometry in heading and in distance, by least
//! squares. (A hand-eye calibration of one parameter; all extrinsics at once: Censi et al., "Simultaneous calibration of odometry and sensor
//! parameters for mobile robots", IEEE Transactions on Robotics 29, 2013.) The median over some such pairs counts.

use std::collections::{BTreeMap, VecDeque};

use nalgebra::{Matrix3, Point2, Vector2, Vector3};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::LidarModel;

/// Two scans are compared this far apart, m, unless the robot turned meanwhile by more than the second number, rad.
const APART: f64 = 0.4;
const STRAIGHT: f64 = 0.05;
/// Fewest and most of the newest pairs that count.
const FEWEST: usize = 6;
const MOST: usize = 12;
/// A mount is off by more than this, rad, until it is off by less than the second number.
const OFF: f64 = 0.035;
const RIGHT: f64 = 0.025;
/// A return farther than this from the earlier surface is something else, m.
const GATE: f64 = 0.15;
/// Length of the piece of a surface on which its direction is measured, and its deviation from a straight line, m; most beams to each side.
const PIECE: f64 = 0.25;
const BENT: f64 = 0.02;
const BESIDE: i64 = 20;
/// Fewest returns of a pair.
const RETURNS: usize = 30;
/// Standard deviations of a return, m; of the odometry over the way, rad and m; and largest one of a useful angle, rad. Returns on one
/// surface share their errors: all together count as so many.
const RETURN_STD: f64 = 0.02;
const ODOMETRY_STD: [f64; 2] = [0.01, 0.02];
const USEFUL: f64 = 0.03;
const INDEPENDENT: f64 = 20.0;

/// Watches the mounts of all lidars of a robot.
#[derive(Clone, Debug, Default)]
pub(crate) struct MountWatch {
    lidars: BTreeMap<String, Watched>,
}

/// One lidar.
#[derive(Clone, Debug, Default)]
struct Watched {
    earlier: Option<PosedScan>,
    /// Its yaw beyond the file's, by the newest pairs, rad.
    angles: VecDeque<f64>,
    is_off: bool,
}

/// A scan, and the pose of the base that it was taken at.
#[derive(Clone, Debug)]
struct PosedScan {
    odom_from_base: Pose2,
    /// The returns of its beams, laser frame.
    points: Vec<Option<Point2<f64>>>,
}

impl MountWatch {
    /// Takes the ranges (m) of a lidar's scan, with the runs of beams that hit something moving, and the robot's odometry then.
    pub(crate) fn insert(
        &mut self,
        name: &str,
        lidar: &LidarModel,
        ranges: &[f32],
        moving: &[[u32; 2]],
        odom_from_base: Pose2,
    ) {
        if !self.lidars.contains_key(name) {
            self.lidars.insert(name.to_owned(), Watched::default());
        }
        let Some(watched) = self.lidars.get_mut(name) else {
            return;
        };
        let went = watched
            .earlier
            .as_ref()
            .map(|scan| scan.odom_from_base.inverse() * odom_from_base);
        let is_straight = went.is_some_and(|went| went.yaw.abs() <= STRAIGHT && went.y.abs() <= STRAIGHT * APART);
        if is_straight && went.is_some_and(|went| went.x.abs() < APART) {
            return;
        }
        let point = |(beam, range): (usize, &f32)| {
            let range = f64::from(*range);
            let moves = moving
                .iter()
                .any(|[first, end]| (*first..*end).contains(&(beam as u32)));
            let (sin, cos) = (lidar.angle_min() + beam as f64 * lidar.angle_increment()).sin_cos();
            (range >= lidar.range_min && range <= lidar.range_max && !moves)
                .then(|| Point2::new(range * cos, range * sin))
        };
        let scan = PosedScan {
            odom_from_base,
            points: ranges.iter().enumerate().map(point).collect(),
        };
        let angle = watched.earlier.as_ref().filter(|_| is_straight);
        if let Some(angle) = angle.and_then(|earlier| angle_between(lidar, earlier, &scan)) {
            if watched.angles.len() == MOST {
                watched.angles.pop_front();
            }
            watched.angles.push_back(angle);
            watched.is_off = watched.off().is_some();
        }
        watched.earlier = Some(scan);
    }

    /// A lidar that looks elsewhere than its file says: its name, and how far to the left, rad.
    pub(crate) fn off(&self) -> Option<(&str, f64)> {
        self.lidars
            .iter()
            .find_map(|(name, watched)| Some((name.as_str(), watched.off()?)))
    }
}

impl Watched {
    /// Its yaw beyond the file's, rad, if it is off by much more than the pairs differ.
    fn off(&self) -> Option<f64> {
        if self.angles.len() < FEWEST {
            return None;
        }
        let angle = median(self.angles.iter().copied());
        let spread = median(self.angles.iter().map(|other| (other - angle).abs()));
        let least = if self.is_off { RIGHT } else { OFF };
        (angle.abs() > least + spread).then_some(angle)
    }
}

/// The upper median of some numbers.
fn median(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = numbers.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// The lidar's yaw beyond its file's, rad, by two scans a straight way apart; `None` if too little is seen beside the way.
fn angle_between(lidar: &LidarModel, earlier: &PosedScan, later: &PosedScan) -> Option<f64> {
    let before = earlier.odom_from_base * lidar.mount;
    let earlier_from_later = before.inverse() * (later.odom_from_base * lidar.mount);
    let base = (before.inverse() * later.odom_from_base).position();
    let way = earlier_from_later.position().coords;
    let (aside, ahead) = (Vector2::new(-way.y, way.x), way.try_normalize(1e-3)?);
    let (mut squares, mut products, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0);
    for point in later.points.iter().flatten() {
        let place = earlier_from_later.transform_point(*point);
        let Some((normal, distance)) = surface_at(lidar, &earlier.points, place) else {
            continue;
        };
        let lever = place - base;
        let row = Vector3::new(
            normal.dot(&aside),
            normal.dot(&Vector2::new(-lever.y, lever.x)),
            normal.dot(&ahead),
        );
        squares += row * row.transpose();
        products += row * distance;
        count += 1;
    }
    if count < RETURNS {
        return None;
    }
    let weight = INDEPENDENT / (f64::from(count as u32) * RETURN_STD * RETURN_STD);
    let [turn, slip] = ODOMETRY_STD.map(|std| 1.0 / (std * std));
    let inverse = (squares * weight + Matrix3::from_diagonal(&Vector3::new(1e-6, turn, slip))).try_inverse()?;
    let angle = (inverse * products * weight).x;
    (inverse.m11.sqrt() <= USEFUL).then_some(angle)
}

/// The normal of the surface that a scan shows at a place, and how far the place is from it along the normal, m; laser frame.
fn surface_at(lidar: &LidarModel, points: &[Option<Point2<f64>>], place: Point2<f64>) -> Option<(Vector2<f64>, f64)> {
    let beam = ((place.y.atan2(place.x) - lidar.angle_min()) / lidar.angle_increment()).round() as i64;
    let spacing = place.coords.norm() * lidar.angle_increment();
    let beside = ((0.5 * PIECE / spacing.max(1e-6)).ceil() as i64).clamp(2, BESIDE);
    let at = |number: i64| *points.get(usize::try_from(number).ok()?)?;
    let [first, middle, last] = [at(beam - beside)?, at(beam)?, at(beam + beside)?];
    let along = (last - first).try_normalize(1e-3)?;
    let normal = Vector2::new(-along.y, along.x);
    let distance = normal.dot(&(place - middle));
    let is_straight = normal.dot(&(middle - first)).abs() <= BENT && (last - first).norm() <= 4.0 * PIECE;
    (is_straight && distance.abs() <= GATE).then_some((normal, distance))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// How far a robot's lidar seems to be off, rad, after a drive of 6 m through a hall with pillars. Its lidar is turned by `turned` rad
    /// against its file, and its odometry turns by `drift` rad with every metre.
    fn seen(robot: &str, turned: f64, drift: f64) -> Option<f64> {
        let model = zenav_fixtures::robot(robot);
        let lidar = model.first_lidar().unwrap();
        let mut crooked = lidar.clone();
        crooked.mount.yaw += turned;
        let pillars = [(Point2::new(-1.0, 0.9), 0.2), (Point2::new(1.5, -1.0), 0.3)];
        let mut watch = MountWatch::default();
        let mut odom_from_base = Pose2::new(-3.0, 0.1, 0.0);
        for step in 0..60 {
            let there = Pose2::new(-3.0 + 0.1 * f64::from(step), 0.1, 0.0);
            let sweep = zenav_fixtures::sweep_in_room(&crooked, 0.1 * f64::from(step), there, (4.5, 1.8), &pillars);
            watch.insert("lidar", lidar, &sweep.ranges, &[], odom_from_base);
            odom_from_base = odom_from_base * Pose2::new(0.1, 0.0, 0.1 * drift);
        }
        watch.off().map(|(_, angle)| angle)
    }

    #[test]
    fn a_lidar_that_is_mounted_crooked_is_noticed_and_a_straight_one_is_not() {
        for robot in ["tiago", "jackal", "turtlebot3_waffle", "neato"] {
            for drift in [0.0, 0.01, -0.01] {
                assert_eq!(seen(robot, 0.0, drift), None, "{robot}, {drift}");
                for turned in [0.09, -0.14] {
                    let angle = seen(robot, turned, drift).unwrap_or_else(|| panic!("{robot}, {turned}, {drift}"));
                    assert!((angle - turned).abs() < 0.02, "{robot}, {turned}, {drift}: {angle}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_concluded_from_turns_or_without_surfaces_beside_the_way() {
        let model = zenav_fixtures::robot("tiago");
        let lidar = model.first_lidar().unwrap();
        let mut crooked = lidar.clone();
        crooked.mount.yaw += 0.14;
        let mut watch = MountWatch::default();
        let mut at = Pose2::IDENTITY;
        for step in 0..100 {
            let sweep = zenav_fixtures::sweep_in_room(&crooked, 0.1 * f64::from(step), at, (2.0, 2.0), &[]);
            watch.insert("lidar", lidar, &sweep.ranges, &[], at);
            at = at * Pose2::new(0.05, 0.0, 0.1);
        }
        assert_eq!(watch.off(), None);
        for step in 0..100 {
            let nothing = vec![f32::INFINITY; lidar.beams];
            watch.insert(
                "lidar",
                lidar,
                &nothing,
                &[],
                Pose2::new(0.1 * f64::from(step), 0.0, 0.0),
            );
        }
        assert_eq!(watch.off(), None);
    }
}
