//! Session files. Reads and writes sessions, and rebuilds scans from the points that they keep.

use std::path::Path;

use zenav_mapping::atomic::write_atomically;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;
use zenav_slam::{MOST_BYTES, Slam};

use crate::failure::Failure;
use crate::files;

/// Beams of a rebuilt scan: an eighth of a degree.
const BEAMS: usize = 2880;

/// Reads a session file.
pub(super) fn read(path: &Path) -> Result<Slam, Failure> {
    let bytes = files::bytes_within(path, MOST_BYTES as u64)?;
    Slam::load(&bytes).map_err(Failure::usage_at(path))
}

/// Writes a session file atomically.
pub(super) fn write(path: &Path, slam: &Slam) -> Result<(), Failure> {
    let bytes = slam.save().map_err(Failure::failed_at(path))?;
    write_atomically(path, &bytes).map_err(Failure::failed)
}

/// The scans of nodes, rebuilt from their points, at the poses of the nodes.
pub(super) fn scans(slam: &Slam, nodes: std::ops::Range<usize>) -> Vec<Scan> {
    nodes.filter_map(|node| scan(slam, node)).collect()
}

/// Beams without a point are without a return.
fn scan(slam: &Slam, node: usize) -> Option<Scan> {
    let (points, pose) = (slam.scan(node)?, slam.nodes().get(node)?);
    let laser = slam.laser_of(node);
    let increment = std::f64::consts::TAU / BEAMS as f64;
    let mut ranges = vec![f32::NAN; BEAMS];
    for point in points {
        let beam = point - laser;
        let number = ((beam.y.atan2(beam.x) + std::f64::consts::PI) / increment).round() as usize % BEAMS;
        ranges[number] = ranges[number].min(beam.norm() as f32);
    }
    Some(Scan {
        stamp: Stamp::default(),
        angle_min: -std::f64::consts::PI,
        angle_increment: increment,
        range_min: 0.0,
        range_max: f64::from(f32::MAX),
        ranges,
        moving: Vec::new(),
        base_from_laser: Pose2::new(laser.x, laser.y, 0.0),
        map_from_odom: Pose2::IDENTITY,
        odom_from_base: *pose,
    })
}
