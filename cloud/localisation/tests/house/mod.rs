//! The map of a house, and the scans of a lidar in it.

use nalgebra::{Point2, Vector2};
use zenav_fixtures::{scan, spec, walled_room};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};
use zenav_protocol::messages::Scan;

/// Three rooms of distinct shape, 12 m by 8 m.
pub fn house() -> OccupancyGrid {
    walled_room(spec(240, 160, 0.05), |at| {
        let is_in = |x: [f64; 2], y: [f64; 2]| (x[0]..x[1]).contains(&at.x) && (y[0]..y[1]).contains(&at.y);
        let walls = is_in([5.0, 5.1], [0.0, 3.0]) || is_in([5.0, 5.1], [4.0, 8.0]) || is_in([5.0, 10.5], [4.5, 4.6]);
        walls
            || is_in([1.0, 1.8], [6.2, 7.0])
            || is_in([3.2, 4.2], [0.5, 0.9])
            || is_in([8.0, 9.0], [1.0, 1.5])
            || is_in([7.0, 7.4], [6.5, 7.6])
    })
}

/// The scan of a full-circle lidar at a pose, to the nearest centimetre, with this `odom_from_base`, and this guess for the first scan.
pub fn look(map: &OccupancyGrid, stamp: u64, truth: Pose2, odom_from_base: Pose2, guess: Pose2) -> Scan {
    let beams = 240;
    let at = truth.position();
    let ranges = (0..beams).map(|beam| {
        let angle = truth.yaw - std::f64::consts::PI + std::f64::consts::TAU * f64::from(beam) / f64::from(beams);
        let way = Vector2::new(angle.cos(), angle.sin());
        let meets = |step: &i32| {
            let cell = map.at(Point2::from(at.coords + way * (0.01 * f64::from(*step))));
            cell.is_none_or(|value| *value >= Occupancy::OCCUPIED_FROM)
        };
        // No return beyond the range.
        (2..800).find(meets).map_or(f32::INFINITY, |step| 0.01 * step as f32)
    });
    Scan {
        map_from_odom: guess * odom_from_base.inverse(),
        odom_from_base,
        ..scan(stamp, Pose2::IDENTITY, ranges.collect())
    }
}

/// A drive through two rooms: true poses with odometry that overestimates every step by 3 % and turns a little.
pub fn drive() -> Vec<(Pose2, Pose2)> {
    let mut pairs = vec![(Pose2::new(1.0, 2.0, 0.6), Pose2::IDENTITY)];
    for number in 0..260 {
        let (truth, odometry) = pairs[pairs.len() - 1];
        let turn = if number < 40 {
            0.0
        } else {
            -0.008 * f64::from(u8::from(number < 120))
        };
        let step = Pose2::new(0.03, 0.0, turn);
        let told = Pose2::new(0.0309, 0.0, turn + 0.0004);
        pairs.push((truth * step, odometry * told));
    }
    pairs
}
