//! Points. Which points did a scan see, in the frame of the robot's base?

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;

use crate::settings::ScanSettings;

/// Points of a scan in the frame of the base at its stamp, thinned.
///
/// `step`: how the base moved in the `elapsed` seconds before the stamp, by odometry, as `before_from_now`. With a sweep's duration the
/// points are moved to where they would have been seen at the stamp.
#[must_use]
pub fn points(scan: &Scan, step: Pose2, elapsed: f64, settings: &ScanSettings) -> Vec<Point2<f64>> {
    let range_max = scan.range_max.min(settings.max_range);
    let share = if elapsed > 0.0 { settings.sweep / elapsed } else { 0.0 };
    let count = scan.ranges.len().max(1) as f64;
    let mut points: Vec<Point2<f64>> = Vec::with_capacity(scan.ranges.len());
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
            // The base stood where a share of the step, backwards, leads to.
            let back = share * (1.0 - number as f64 / count);
            point = Pose2::IDENTITY
                .interpolate(&step.inverse(), back.min(1.0))
                .transform_point(point);
        }
        let is_new = points
            .last()
            .is_none_or(|last| (point - last).norm() >= settings.spacing);
        if is_new {
            points.push(point);
        }
    }
    points
}
