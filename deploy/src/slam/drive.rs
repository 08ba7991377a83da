//! Drive. The simulated log of the tests: along a room of 10 m by 6 m with round pillars, half a circle in view.

use std::path::Path;

use nalgebra::Point2;
use zenav_fixtures::{robot, sweep_in_room};
use zenav_mapping::carmen;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_protocol::robot::LidarModel;
use zenav_protocol::time::Stamp;
use zenav_slam::{Slam, SlamSettings};

/// Half sides of the room, m.
const HALF: (f64, f64) = (5.0, 3.0);
/// Pillars: x, y and radius, m.
const PILLARS: [(f64, f64, f64); 5] = [
    (-1.5, 1.2, 0.4),
    (2.0, -2.2, 0.5),
    (3.8, 2.0, 0.6),
    (-4.0, 2.2, 0.5),
    (0.5, 2.4, 0.3),
];
/// Step between two scans, m, and what odometry makes of one.
const STEP: f64 = 0.08;
const SCALE: f64 = 1.01;

/// The scans of a robot that drives ahead, a tenth of a second apart, with its raw odometry. They are those of a CARMEN log: half a degree
/// apart, and the laser is the robot's origin.
pub(crate) fn scans(count: usize) -> Vec<Scan> {
    let lidar = LidarModel {
        mount: Pose2::IDENTITY,
        range_max: 20.0,
        beams: 361,
        field_of_view: std::f64::consts::PI,
        ..robot("tiago").lidar.unwrap()
    };
    let pillars = PILLARS.map(|(x, y, radius)| (Point2::new(x, y), radius));
    let scan = |number: usize| {
        let (way, secs) = (STEP * number as f64, 10.0 + 0.1 * number as f64);
        let sweep = sweep_in_room(&lidar, secs, Pose2::new(way - 4.0, -0.8, 0.0), HALF, &pillars);
        Scan {
            stamp: Stamp::from_secs(secs),
            angle_min: lidar.angle_min(),
            angle_increment: lidar.angle_increment(),
            range_max: lidar.range_max,
            ..zenav_fixtures::scan(0, Pose2::new(SCALE * way, 0.0, 0.0), sweep.ranges)
        }
    };
    (0..count).map(scan).collect()
}

/// Writes scans as a log.
pub(crate) fn write(path: &Path, scans: &[Scan]) {
    let lines: String = scans
        .iter()
        .map(|scan| carmen::line(scan, scan.odom_from_base))
        .collect();
    std::fs::write(path, lines).unwrap();
}

/// The finished map of scans.
pub(crate) fn mapped(scans: &[Scan]) -> Slam {
    let mut slam = Slam::new(SlamSettings::default());
    for scan in scans {
        slam.step(scan).unwrap();
    }
    slam.finish().unwrap();
    slam
}
