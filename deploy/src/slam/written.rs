//! Written. The files of a map.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use zenav_mapping::carmen::{self, LOG_BEAMS};
use zenav_mapping::{InsertMode, build_map, write_map};
use zenav_pose_graph::g2o;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_slam::Slam;

use super::picture::{self, Ways};
use crate::failure::Failure;
use crate::files;

/// What the files show.
pub(super) struct Drawn<'d> {
    pub(super) slam: &'d Slam,
    /// Time, s, and pose of scans.
    pub(super) trajectory: &'d [(f64, Pose2)],
    /// Scans to insert, whose `odom_from_base` is the pose in the map.
    pub(super) placed: &'d [Scan],
    /// Ways of the picture.
    pub(super) ways: Ways<'d>,
}

/// Writes a map into a folder; returns its file.
pub(super) fn write(out: &Path, resolution: f64, drawn: &Drawn<'_>) -> Result<PathBuf, Failure> {
    std::fs::create_dir_all(out).map_err(Failure::failed_at(out))?;
    let mut rows = "t,x,y,yaw\n".to_owned();
    for (stamp, Pose2 { x, y, yaw }) in drawn.trajectory {
        // Writing to a string does not fail.
        let _ = writeln!(rows, "{stamp},{x},{y},{yaw}");
    }
    files::write(&out.join("trajectory.csv"), rows)?;
    let graph = g2o::write_weighted(drawn.slam.graph(), &[], drawn.slam.weights());
    files::write(&out.join("graph.g2o"), graph)?;
    let built = build_map(drawn.placed, resolution, InsertMode::Reference, &LOG_BEAMS);
    let grid = built.map_err(Failure::failed)?.map.to_occupancy();
    let map = write_map(out, "map", &grid, "SLAM of a log").map_err(Failure::failed)?;
    let picture = picture::draw(&grid, &drawn.ways, drawn.slam)?;
    files::write(&out.join("slam.png"), picture.png()?)?;
    Ok(map)
}

/// Writes the log of scans with their poses in the map, `odom_from_base`, and raw odometry, into an existing folder.
pub(super) fn write_log(out: &Path, placed: &[Scan], odometry: &[Pose2]) -> Result<(), Failure> {
    let lines: String = placed
        .iter()
        .zip(odometry)
        .map(|(scan, odom_from_base)| carmen::line(scan, *odom_from_base))
        .collect();
    files::write(&out.join("carmen.log"), lines)
}
