//! Session files. Reads, writes and draws sessions, and rebuilds scans from the points that they keep.

use std::path::Path;

use serde::Deserialize;
use zenav_mapping::carmen::LOG_BEAMS;
use zenav_mapping::{InsertMode, build_map, write_atomically};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;
use zenav_slam::{MOST_BYTES, SessionError, Slam};

use crate::failure::Failure;
use crate::files;

/// Beams of a rebuilt scan: an eighth of a degree.
const BEAMS: usize = 2880;
/// Longest line that the mapping service writes before a session, bytes.
const MOST_HEAD: usize = 16 << 20;

/// A session as read from a file.
#[derive(Debug)]
pub(super) struct Stored {
    pub(super) slam: Slam,
    /// Whether a robot's mapping service keeps the file: it has data of its own in it, and the session's scans beside it.
    pub(super) is_of_robot: bool,
}

/// What is read of the line that the mapping service writes before a session.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Head {
    /// Id of the map that SLAM began in and did not make; empty if it made its map itself.
    base: String,
}

/// Reads a session file. If SLAM began in a map that it did not make, a warning says that it is left out.
pub(super) fn read(path: &Path) -> Result<Stored, Failure> {
    let bytes = bytes(path)?;
    let stored = load(&bytes).map_err(Failure::usage_at(path))?;
    warn_of_base(path, &bytes);
    Ok(stored)
}

/// Warns if the session in the bytes of a file began in a map that it did not make, which the file lacks.
fn warn_of_base(path: &Path, bytes: &[u8]) {
    if let Some(base) = base(bytes) {
        tracing::warn!(
            "{}: the session began in the map `{base}`, which `slam.base` beside it holds: that map is left out",
            path.display()
        );
    }
}

/// Id of the map that a session began in and did not make, by the head of its file.
fn base(bytes: &[u8]) -> Option<String> {
    let head = &bytes[..head(bytes)?];
    let Head { base } = serde_json::from_slice(head).unwrap_or_default();
    (!base.is_empty()).then_some(base)
}

/// Length of the line of JSON that the mapping service writes before a session.
fn head(bytes: &[u8]) -> Option<usize> {
    let end = bytes.iter().position(|byte| *byte == b'\n');
    end.filter(|_| bytes.starts_with(b"{"))
}

fn bytes(path: &Path) -> Result<Vec<u8>, Failure> {
    files::bytes_within(path, (MOST_BYTES + MOST_HEAD) as u64)
}

/// The session in the bytes of a file.
fn load(bytes: &[u8]) -> Result<Stored, SessionError> {
    let head = head(bytes);
    Ok(Stored {
        slam: Slam::load(head.map_or(bytes, |end| &bytes[end + 1..]))?,
        is_of_robot: head.is_some(),
    })
}

/// The map of a session file, drawn from the points of its scans; `None` if the file is no session. If SLAM began in a map
/// that it did not make, a warning says that it is left out.
pub(crate) fn drawn(path: &Path, resolution: f64) -> Result<Option<OccupancyGrid>, Failure> {
    let bytes = bytes(path)?;
    let slam = match load(&bytes) {
        Err(SessionError::Foreign) => return Ok(None),
        stored => stored.map_err(Failure::usage_at(path))?.slam,
    };
    warn_of_base(path, &bytes);
    let scans = scans(&slam, 0..slam.nodes().len());
    if scans.is_empty() {
        return Err(Failure::usage_at(path)("expected a session with scans, found none"));
    }
    let built = build_map(&scans, resolution, InsertMode::Reference, &LOG_BEAMS);
    Ok(Some(built.map_err(Failure::usage_at(path))?.map.to_occupancy()))
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
        range_max: f64::from(f32::MAX),
        ranges,
        base_from_laser: Pose2::new(laser.x, laser.y, 0.0),
        odom_from_base: *pose,
        ..Scan::default()
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::grid::Occupancy;

    use super::super::drive;
    use super::*;

    #[test]
    fn a_session_of_the_mapping_service_is_read_without_its_head() {
        let folder = tempfile::tempdir().unwrap();
        let (own, robots) = (folder.path().join("own.slam"), folder.path().join("slam.session"));
        let slam = drive::mapped(&drive::scans(6));
        let bytes = slam.save().unwrap();
        std::fs::write(&own, &bytes).unwrap();
        std::fs::write(&robots, [b"{\"frame\":3,\"moves\":[]}\n".as_slice(), &bytes].concat()).unwrap();
        for (path, is_of_robot) in [(&own, false), (&robots, true)] {
            let stored = read(path).unwrap();
            assert_eq!(stored.is_of_robot, is_of_robot);
            assert_eq!(stored.slam.save().unwrap(), bytes);
        }
        std::fs::write(&robots, "{\"frame\":3}\nP5 1 1 255\n").unwrap();
        let refused = read(&robots).unwrap_err();
        assert!(refused.message.contains("expected a SLAM session"), "{refused}");
    }

    #[test]
    fn a_session_that_began_in_a_map_is_known_by_its_head() {
        let kept = b"{\"frame\":3,\"moves\":[],\"base\":\"hall\"}\nsession";
        assert_eq!(base(kept).as_deref(), Some("hall"));
        let without: [&[u8]; 4] = [
            b"{\"frame\":3}\nsession",
            b"{\"base\":\"\"}\nsession",
            b"{no head\nsession",
            b"session\n{\"base\":\"hall\"}\n",
        ];
        for bytes in without {
            assert_eq!(base(bytes), None);
        }
    }

    #[test]
    fn a_session_is_drawn_and_another_file_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let (session, other) = (folder.path().join("room.slam"), folder.path().join("notes.txt"));
        write(&session, &drive::mapped(&drive::scans(20))).unwrap();
        std::fs::write(&other, "no map").unwrap();
        let map = drawn(&session, 0.05).unwrap().unwrap();
        let around = |at: Point2<f64>, wanted: Occupancy| {
            let spec = map.spec();
            let values = map.values().iter().enumerate();
            let mut near = values.filter(|(index, _)| (spec.center(spec.cell(*index)) - at).norm() < 0.1);
            near.any(|(_, value)| Occupancy::of(*value) == wanted)
        };
        // The map begins at the first scan: the wall on the robot's right, and the floor before it.
        let (wall, floor) = (Point2::new(1.0, -2.2), Point2::new(1.0, -1.0));
        assert!(around(wall, Occupancy::Occupied));
        assert!(around(floor, Occupancy::Free) && !around(floor, Occupancy::Occupied));
        assert!(drawn(&other, 0.05).unwrap().is_none());
    }
}
