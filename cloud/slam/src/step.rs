//! Step. What did a scan do to the map, or why could it do nothing?

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
    /// Score of the match, 0 to 1, where there was one that counts.
    pub score: Option<f64>,
    /// Whether the scan agrees with the map around it, if only well enough for a node.
    pub fits: bool,
    /// Whether it says that the robot is elsewhere: it fits badly, and its beams go through walls, or nobody knows where it was switched
    /// on. Who stands around the robot hides the map, and contradicts nothing. A scan that contradicts is not inserted: it would confirm the
    /// next one.
    pub contradicts: bool,
    /// Points that the scan saw.
    pub points: usize,
    /// Whether a wide search was needed.
    pub is_searched: bool,
    /// Direction in the map, rad, along which the scan does not know the position.
    pub degenerate: Option<f64>,
    /// Loop closures found.
    pub closures: usize,
    /// How well the pose is known within the map around it: covariance of x, y (m²) and yaw (rad²) along the map's axes; without a
    /// match that counts, nothing new is known.
    pub covariance: Option<Matrix3<f64>>,
    /// From the pose, which odometry has a say in, to the one that the scan alone would have: what `covariance` is of.
    pub by_scan: Pose2,
    /// How the surroundings moved in the map as the graph was settled: `new_from_old`, for places about the robot.
    pub moved: Option<Pose2>,
}

/// Counts over a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Scans given.
    pub scans: usize,
    /// Wide searches of the front end.
    pub wide_searches: usize,
    /// Scans without a match that counts.
    pub unmatched: usize,
    /// Submaps searched for a closure.
    pub searched: usize,
    /// Of these, searches that spent their budget before anything was known: in vain.
    pub cut: usize,
    /// Closures found.
    pub found: usize,
}
