//! Points. The points of a scan in the frame of the robot's base.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;

use crate::settings::ScanSettings;

/// Neighbouring returns farther apart than this lie on two surfaces, m.
const JUMP: f64 = 0.1;

/// Returns that are merged into one point.
#[derive(Default)]
struct Group {
    sum: Vector2<f64>,
    count: u32,
    /// Beam and position of the last one.
    last: Option<(usize, Point2<f64>)>,
    /// Arc that their beams span at their ranges, m.
    arc: f64,
}

impl Group {
    fn add(&mut self, beam: usize, point: Point2<f64>, arc: f64) {
        self.arc += if self.count == 0 { 0.0 } else { arc };
        self.sum += point.coords;
        self.count += 1;
        self.last = Some((beam, point));
    }

    fn mean(&self) -> Option<Point2<f64>> {
        (self.count > 0).then(|| Point2::from(self.sum / f64::from(self.count)))
    }
}

/// Points of a scan in the frame of the base at its stamp, thinned: neighbouring returns are averaged as long as all lie within `spacing`
/// of the first by the directions of their beams. The grouping must not depend on noise: points selected for being far from the last one
/// would all be off to one side, and turn the map.
///
/// `step`: how the base moved in the `elapsed` seconds before the stamp, by odometry, as `before_from_now`. With a sweep's duration set,
/// the points are moved to where they would have been seen at the stamp.
///
/// ```
/// # use zenav_protocol::{geometry::Pose2, messages::Scan};
/// use zenav_scan_matching::{ScanSettings, points};
///
/// // Five beams, 2 cm apart on a wall that is 1 m ahead of a lidar, which is mounted 0.2 m ahead of the base.
/// let scan = Scan {
///     angle_min: -0.04,
///     angle_increment: 0.02,
///     ranges: vec![1.0; 5],
///     base_from_laser: Pose2::new(0.2, 0.0, 0.0),
///     range_max: 5.0,
///     ..Scan::default()
/// };
/// let seen = points(&scan, Pose2::IDENTITY, 0.0, &ScanSettings::default());
/// assert_eq!(seen.len(), 3, "neighbours within 3 cm are one point");
/// assert!(seen.iter().all(|point| (point.x - 1.2).abs() < 0.001));
/// ```
#[must_use]
pub fn points(scan: &Scan, step: Pose2, elapsed: f64, settings: &ScanSettings) -> Vec<Point2<f64>> {
    let range_max = scan.range_max.min(settings.max_range);
    let share = if elapsed > 0.0 { settings.sweep / elapsed } else { 0.0 };
    let count = scan.ranges.len().max(1) as f64;
    let mut points: Vec<Point2<f64>> = Vec::with_capacity(scan.ranges.len());
    let mut group = Group::default();
    let mut moving = scan.moving.iter().peekable();
    for (number, range) in scan.ranges.iter().enumerate() {
        while moving.next_if(|[_, end]| *end as usize <= number).is_some() {}
        let is_moving = moving.peek().is_some_and(|[start, _]| *start as usize <= number);
        let length = f64::from(*range);
        if is_moving || !scan.is_return(*range) || length > range_max {
            continue;
        }
        let (sin, cos) = scan.angle(number).sin_cos();
        let mut point = scan
            .base_from_laser
            .transform_point(Point2::new(length * cos, length * sin));
        if share > 0.0 {
            // The base was at this share of the step, backwards.
            let back = share * (1.0 - number as f64 / count);
            point = Pose2::IDENTITY
                .interpolate(&step.inverse(), back.min(1.0))
                .transform_point(point);
        }
        let arc = scan.angle_increment.abs() * length;
        let is_apart = group
            .last
            .is_none_or(|last| number > last.0 + 1 || (point - last.1).norm() > JUMP.max(settings.spacing));
        if is_apart || group.arc + arc > settings.spacing {
            points.extend(group.mean());
            group = Group::default();
        }
        group.add(number, point, arc);
    }
    points.extend(group.mean());
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_protocol::time::Stamp;

    /// Two walls 1 m to the left and to the right, each range off by `noise`.
    fn corridor(noise: impl Fn(usize) -> f64) -> Scan {
        let (count, from) = (480, -0.5 * std::f64::consts::PI - 0.5);
        let increment = -2.0 * from / f64::from(count - 1);
        let ranges = (0..count).map(|beam| {
            let across = (from + increment * f64::from(beam)).sin().abs();
            (1.0 / across.max(0.2) + noise(beam as usize)) as f32
        });
        Scan {
            stamp: Stamp::from_secs(1.0),
            angle_min: from,
            angle_increment: increment,
            range_min: 0.02,
            range_max: 30.0,
            ranges: ranges.collect(),
            ..Scan::default()
        }
    }

    #[test]
    fn noise_moves_no_wall_to_one_side() {
        let settings = ScanSettings::default();
        let wave = |beam: usize| 0.01 * (beam as f64 * 2.4).sin();
        let (mut sums, mut count) = ([0.0; 2], 0.0);
        let seen = points(&corridor(wave), Pose2::IDENTITY, 0.0, &settings);
        for point in seen
            .iter()
            .filter(|point| (point.y.abs() - 1.0).abs() < 0.1 && point.x.abs() < 1.5)
        {
            // Outwards ahead and inwards behind on one side is a turn.
            sums[0] += point.y - point.y.signum();
            sums[1] += (point.y - point.y.signum()) * point.x;
            count += 1.0;
        }
        assert!(count > 60.0, "{count}");
        assert!(
            sums.iter().all(|sum| (sum / count).abs() < 0.001),
            "{sums:?} of {count}"
        );
    }

    #[test]
    fn neighbours_become_their_mean_and_two_surfaces_do_not() {
        let settings = ScanSettings::default();
        let seen = points(&corridor(|_| 0.0), Pose2::IDENTITY, 0.0, &settings);
        assert!((100..300).contains(&seen.len()), "{}", seen.len());
        let mut scan = corridor(|_| 0.0);
        scan.ranges[..240].fill(2.0);
        scan.ranges[240..].fill(2.5);
        let edge = points(&scan, Pose2::IDENTITY, 0.0, &settings);
        let between = |point: &&Point2<f64>| (2.01..2.49).contains(&point.coords.norm());
        assert_eq!(edge.iter().filter(between).count(), 0);
    }
}
