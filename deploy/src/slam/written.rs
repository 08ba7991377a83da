//! Written. The files of a map.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use nalgebra::Point2;
use zenav_mapping::carmen::LOG_BEAMS;
use zenav_mapping::{InsertMode, build as maps, map_file};
use zenav_pose_graph::{EdgeKind, g2o};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_slam::Slam;

use super::picture;
use crate::failure::Failure;
use crate::files;

/// Writes a map into a folder; returns its file. `trajectory`: time, s, and pose of scans; `placed`: scans to insert, their
/// `odom_from_base` being the pose in the map; `before`: the path by odometry alone, if any.
pub(super) fn write(
    out: &Path,
    resolution: f64,
    trajectory: &[(f64, Pose2)],
    placed: &[Scan],
    before: &[Pose2],
    slam: &Slam,
) -> Result<PathBuf, Failure> {
    std::fs::create_dir_all(out).map_err(Failure::failed_at(out))?;
    let mut rows = "t,x,y,yaw\n".to_owned();
    for (stamp, Pose2 { x, y, yaw }) in trajectory {
        // Writing to a string does not fail.
        let _ = writeln!(rows, "{stamp},{x},{y},{yaw}");
    }
    files::write(&out.join("trajectory.csv"), rows)?;
    files::write(&out.join("graph.g2o"), g2o::write(slam.graph(), &[]))?;
    let built = maps::build_map(placed, resolution, InsertMode::Reference, &LOG_BEAMS).map_err(Failure::failed)?;
    let grid = built.map.to_occupancy();
    let map = map_file::write_map(out, "map", &grid, "SLAM of a log").map_err(Failure::failed)?;
    let edges = slam.graph().edges().iter().zip(slam.weights());
    let joined = |is_true: bool| -> Vec<[Point2<f64>; 2]> {
        let chosen = edges
            .clone()
            .filter(move |(edge, weight)| edge.kind == EdgeKind::Closure && (**weight > 0.0) == is_true);
        let poses = slam.graph().poses();
        chosen
            .map(|(edge, _)| [poses[edge.from].position(), poses[edge.to].position()])
            .collect()
    };
    let after: Vec<_> = trajectory.iter().map(|(_, pose)| *pose).collect();
    let picture = picture::draw(&grid, before, &after, &joined(true), &joined(false))?;
    files::write(&out.join("slam.png"), picture.png()?)?;
    Ok(map)
}
