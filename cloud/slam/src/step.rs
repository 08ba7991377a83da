//! Step. The effects of a scan on the map, or why it had none.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use zenav_pose_graph::{GraphError, SolveError};
use zenav_protocol::geometry::Pose2;

/// Why a step failed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SlamError {
    /// A number of the scan or of its poses is not finite: skip the scan.
    #[error("the scan at {0} s is malformed")]
    Scan(f64),
    /// The scan is older than the last one: sort the log.
    #[error("the scan at {0} s comes after a newer one")]
    Order(f64),
    /// The graph refused a measurement.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The graph has no solution.
    #[error(transparent)]
    Solve(#[from] SolveError),
}

/// What a step did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effects {
    /// `map_from_base` at the scan's stamp.
    pub pose: Pose2,
    /// Whether the scan became a node.
    pub is_inserted: bool,
    /// Score of the match, 0 to 1, if a match counts.
    pub score: Option<f64>,
    /// Whether the scan agrees with the surrounding map, at least well enough for a node.
    pub fits: bool,
    /// Whether the scan says that the robot is elsewhere: it fits badly, and its beams go through walls or the robot's place was unknown
    /// before. People around the robot hide the map and contradict nothing. A contradicting scan is not inserted, since it would confirm
    /// the next one.
    pub contradicts: bool,
    /// Number of points of the scan.
    pub points: usize,
    /// Whether a wide search was needed.
    pub is_searched: bool,
    /// Direction in the map, rad, along which the scan does not constrain the position.
    pub degenerate: Option<f64>,
    /// Loop closures found.
    pub closures: usize,
    /// Uncertainty of the pose within the surrounding map: covariance of x, y (m²) and yaw (rad²) along the map's axes; `None` without a
    /// match that counts.
    pub covariance: Option<Matrix3<f64>>,
    /// Transform from the pose, which includes odometry, to the pose by the scan alone; `covariance` refers to the latter.
    pub by_scan: Pose2,
    /// Whether a solve of the graph began: [`Slam::last_solve`](crate::Slam::last_solve).
    pub begins_solve: bool,
    /// How the surroundings moved in the map when the poses of a solve were adopted: `new_from_old`, valid near the robot.
    pub moved: Option<Pose2>,
}

/// Counts over a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Scans taken in.
    pub scans: usize,
    /// Wide searches of the front end.
    pub wide_searches: usize,
    /// Scans without a match that counts.
    pub unmatched: usize,
    /// Submaps searched for a closure.
    pub searched: usize,
    /// Of these, searches whose budget ran out before a result.
    pub cut: usize,
    /// Closures found.
    pub found: usize,
}
