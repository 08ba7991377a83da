//! Plan. How is the robot to move, and until when is the plan valid?

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::MapRef;
use crate::time::Stamp;
pub use crate::trajectory::{Trajectory, TrajectoryPoint};

/// Order of the plans for one robot: plans of a restarted writer are newer than all before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Revision {
    /// Number of the writer's run, higher after every restart.
    pub incarnation: u64,
    /// Counts the writer's plans from one.
    pub counter: u64,
}

/// The edge pose that something was computed from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BasedOn {
    /// Its stamp, on the edge's own clock.
    pub stamp: Stamp,
    /// Boot that the clock belongs to.
    pub boot_id: String,
}

/// The motion that a robot is to follow, and its validity. Written only by the mission that holds the robot's lease.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Plan {
    /// The goal that the plan serves.
    pub goal_id: String,
    /// Lease epoch under which the plan was written.
    pub epoch: u64,
    /// Newer plans replace older ones.
    pub revision: Revision,
    /// Identifies the trajectory: a renewed plan keeps it, and the robot continues along it.
    pub trajectory_id: u64,
    /// The map that the plan was checked on.
    pub map: MapRef,
    /// Frame of all coordinates: `map`.
    pub frame: String,
    /// The edge pose that the plan was computed from or rechecked at; validity counts from its stamp.
    pub based_on: BasedOn,
    /// How long after `based_on` the robot may follow the plan, s. The robot is at rest by then.
    pub valid_for: f64,
    /// The path's corner points, without the start; a waypoint law drives them when there is no trajectory.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub waypoints: Vec<Point2<f64>>,
    /// The time-stamped trajectory; empty for a plain list of waypoints.
    pub trajectory: Trajectory,
    /// Point on the previous trajectory at which this one begins; without it, the trajectory begins where the robot rests.
    pub splice: Option<Splice>,
    /// How the plan was computed.
    pub statistics: PlanStatistics,
}

/// A point on the trajectory that a new one replaces: a replan starts from the state predicted there, including speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Splice {
    /// The trajectory being driven.
    pub trajectory_id: u64,
    /// Plan time on it at which the new trajectory begins, s.
    pub time: f64,
}

/// How a plan was computed, and its certificate.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlanStatistics {
    /// Planner, such as `astar`.
    pub planner: String,
    /// Time in the search, ms.
    pub search_ms: f64,
    /// Time in shortcutting and corridor, ms.
    pub corridor_ms: f64,
    /// Time in the geometry solver, ms.
    pub geometry_ms: f64,
    /// Time in the time law, ms.
    pub timing_ms: f64,
    /// Length of the driven path, m.
    pub length: f64,
    /// Duration of the trajectory, s.
    pub duration: f64,
    /// Energy that the trajectory draws by the robot's model, J.
    #[serde(default)]
    pub energy_j: f64,
    /// Least distance of the true footprint to an occupied cell along the trajectory, m; `None` when no such cell is near.
    pub min_clearance: Option<f64>,
    /// `smoothed`, `fallback:REASON`, or `waypoints`.
    pub status: String,
    /// The geometry solver's own status.
    pub solver: String,
    /// What was checked, and the solvers' results.
    #[serde(default)]
    pub certificate: Certificate,
}

/// Why a trajectory can be trusted: the result of an independent check, and how its parts were computed. The clearance is in
/// [`PlanStatistics`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default)]
pub struct Certificate {
    /// The free polygons that contain the curve; `None` where the path is driven as straight lines.
    pub corridor: Option<CorridorFigures>,
    /// How the curve was found; `None` as above.
    pub geometry: Option<SolverFigures>,
    /// The time law: `sweep` (as fast as the limits allow), `jerk_limited`, or `sweep:REASON` where a jerk limit was requested but not
    /// applied.
    pub time_law: String,
    /// How the jerk-limited time law was found; `None` without one.
    pub timing: Option<SolverFigures>,
    /// Largest use of each limit along the trajectory.
    pub largest_use: LimitUse,
    /// Shortest duration on this geometry, by the exact sweep without a jerk limit, s.
    pub lower_bound: f64,
    /// Duration over the lower bound.
    pub over_lower_bound: f64,
}

/// The corridor around a path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CorridorFigures {
    /// Convex free polygons, each overlapping the next.
    #[serde(rename = "rooms")]
    pub polygons: usize,
    /// Least width across the path available to the robot's centre, m.
    pub least_width: f64,
}

/// Result of a solver.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SolverFigures {
    /// The solver's status; the worst one if several problems were solved.
    pub status: String,
    /// Iterations, summed over all problems.
    pub iterations: u32,
    /// Relative duality gap, the largest over all problems.
    pub gap: f64,
}

/// Use of a robot's limits as shares: one is the whole limit; plans use at most 0.95.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default)]
pub struct LimitUse {
    /// Of the forward speed.
    pub speed: f64,
    /// Of the wheels' speed.
    pub wheel_speed: f64,
    /// Of the wheels' acceleration.
    pub wheel_acceleration: f64,
    /// Of the lateral acceleration.
    pub lateral_acceleration: f64,
    /// Of the yaw rate.
    pub yaw_rate: f64,
    /// Of the jerk; `None` without a jerk limit, and where the acceleration jumps.
    pub jerk: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_without_a_certificate_are_read_and_with_one_come_back() {
        let old = r#"{"planner":"astar","search_ms":1.0,"corridor_ms":0.0,"geometry_ms":0.0,"timing_ms":0.0,"length":2.0,"duration":4.0,"min_clearance":null,"status":"smoothed","solver":"Solved"}"#;
        let mut statistics: PlanStatistics = serde_json::from_str(old).unwrap();
        assert_eq!(statistics.certificate, Certificate::default());
        statistics.certificate = Certificate {
            corridor: Some(CorridorFigures {
                polygons: 3,
                least_width: 0.7,
            }),
            geometry: Some(SolverFigures {
                status: "Solved".into(),
                iterations: 12,
                gap: 1e-9,
            }),
            time_law: "sweep".into(),
            over_lower_bound: 1.0,
            ..Certificate::default()
        };
        let text = serde_json::to_string(&statistics).unwrap();
        assert_eq!(serde_json::from_str::<PlanStatistics>(&text).unwrap(), statistics);
    }
}
