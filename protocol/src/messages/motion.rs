//! Motion requests. What is a motion worker asked for, and what does it answer: a path, a trajectory, or both?

use std::time::Duration;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::{KnownCourse, MapRef, PlanStatistics, Refusal, Zone};
use crate::geometry::{Pose2, Twist2};
use crate::robot::RobotModel;
use crate::time::Stamp;
use crate::trajectory::Trajectory;

/// Time limit of smoothing; after it the path is sent unsmoothed, as stop, turn and go.
pub const SMOOTHING_BUDGET: Duration = Duration::from_secs(2);
/// Upper limit of the search time, whatever is requested.
const LONGEST_SEARCH: Duration = Duration::from_secs(60);

/// A request to a motion worker; on the wire `{"kind": "trajectory" | "plan" | "smooth", …}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum MotionRequest {
    /// A drivable path and its trajectory.
    Trajectory(TrajectoryRequest),
    /// A path only.
    Plan(PlanRequest),
    /// The trajectory along a given path.
    Smooth(SmoothRequest),
}

impl MotionRequest {
    /// The robot whose map is needed, and the least revision of it.
    #[must_use]
    pub fn map(&self) -> (&str, &MapRef) {
        match self {
            Self::Trajectory(TrajectoryRequest { plan, .. }) | Self::Plan(plan) => (&plan.robot, &plan.map),
            Self::Smooth(smooth) => (&smooth.robot, &smooth.map),
        }
    }

    /// Time limit of the search.
    #[must_use]
    pub fn search_budget(&self) -> Duration {
        match self {
            Self::Trajectory(TrajectoryRequest { plan, .. }) | Self::Plan(plan) => {
                Duration::from_millis(plan.budget_ms).min(LONGEST_SEARCH)
            }
            Self::Smooth(_) => Duration::ZERO,
        }
    }

    /// Time limit of the whole answer.
    #[must_use]
    pub fn budget(&self) -> Duration {
        match self {
            Self::Trajectory(_) | Self::Smooth(_) => self.search_budget() + SMOOTHING_BUDGET,
            Self::Plan(_) => self.search_budget(),
        }
    }
}

/// Answer to a [`MotionRequest`] of the same kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum MotionReply {
    /// A path and its trajectory.
    Trajectory(TrajectoryReply),
    /// A path.
    Plan(PlanReply),
    /// A trajectory.
    Smooth(SmoothReply),
}

/// A request for a path and its trajectory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TrajectoryRequest {
    /// The path.
    pub plan: PlanRequest,
    /// Velocity at the start.
    #[serde(default)]
    pub start_velocity: Twist2,
    /// Heading at the end, rad; without it, any.
    pub goal_yaw: Option<f64>,
    /// Objective of the trajectory.
    #[serde(default)]
    pub profile: DrivingProfile,
}

impl TrajectoryRequest {
    /// The second half of the request: the trajectory along the path found on a map; `backwards` lists the pieces that are driven in
    /// reverse.
    #[must_use]
    pub fn smooth(&self, map: MapRef, path: Vec<Point2<f64>>, backwards: Vec<usize>) -> SmoothRequest {
        SmoothRequest {
            robot: self.plan.robot.clone(),
            model: self.plan.model.clone(),
            map,
            path,
            via: self.plan.via.iter().map(Pose2::position).collect(),
            backwards,
            start: self.plan.start,
            start_velocity: self.start_velocity,
            goal_yaw: self.goal_yaw,
            unknown_is_free: self.plan.unknown_is_free,
            profile: self.profile,
        }
    }
}

/// Answer to a [`TrajectoryRequest`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TrajectoryReply {
    /// The path, or why there is none.
    pub plan: PlanReply,
    /// Its trajectory; `None` without a path. Empty where the robot cannot drive the path; the status gives the reason.
    pub smooth: Option<SmoothReply>,
    /// Predicted time of arrival at the goal, waits for `yield_to` included, s from the start. `None` for a path that ignores other robots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arrival_secs: Option<f64>,
}

/// A request for a path through the robot's current map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlanRequest {
    /// Robot on whose map to plan.
    pub robot: String,
    /// Footprint and limits.
    pub model: RobotModel,
    /// Least revision of the map; a worker with an older one first requests the whole map.
    pub map: MapRef,
    /// Start, map frame.
    pub start: Pose2,
    /// Poses to pass through on the way to the goal, in order, map frame.
    #[serde(default)]
    pub via: Vec<Pose2>,
    /// Goal, map frame.
    pub goal: Pose2,
    /// Planner (`astar`, …).
    pub planner: String,
    /// Whether unknown cells may be driven through.
    #[serde(default)]
    pub unknown_is_free: bool,
    /// Points whose cells count as free, map frame, m: tests whether a path would exist if the obstacle there left.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub cleared: Vec<Point2<f64>>,
    /// Courses of robots with right of way, times relative to the start: the path passes them in space and time where it can.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub yield_to: Vec<KnownCourse>,
    /// If the map has the robot standing where it does not fit, it may leave through the nearest free position within this distance, m.
    #[serde(default)]
    pub escape: f64,
    /// A goal where the robot does not fit may be replaced by the nearest free position within this distance, m.
    #[serde(default, skip_serializing_if = "crate::drive::is_zero")]
    pub goal_tolerance: f64,
    /// Time limit of the search, ms.
    pub budget_ms: u64,
    /// Seed of sampling-based planners.
    #[serde(default)]
    pub seed: u64,
}

/// Answer to a [`PlanRequest`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlanReply {
    /// The map that was planned on.
    pub map: MapRef,
    /// Result of the search.
    pub outcome: PlanOutcome,
    /// Pieces of the path that are driven in reverse, each by the index of its first corner.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub backwards: Vec<usize>,
    /// If there is no path, the leg that the outcome is about: zero leads to the first pose of `via`, or to the goal.
    #[serde(default)]
    pub leg: usize,
    /// Whether the path starts by leaving a place where the robot does not fit.
    #[serde(default)]
    pub escapes: bool,
    /// Time in the search, ms.
    pub search_ms: f64,
    /// Nodes expanded.
    pub expansions: u64,
    /// How the answer was obtained.
    #[serde(default)]
    pub origin: PlanOrigin,
}

impl PlanReply {
    /// An answer without a path, before any search.
    #[must_use]
    pub fn without_path(map: MapRef, outcome: PlanOutcome) -> Self {
        Self {
            map,
            outcome,
            backwards: Vec::new(),
            leg: 0,
            escapes: false,
            search_ms: 0.0,
            expansions: 0,
            origin: PlanOrigin::Searched,
        }
    }
}

/// How an answer to a [`PlanRequest`] was obtained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum PlanOrigin {
    /// By a search.
    #[default]
    Searched,
    /// An earlier answer, or the rest of it, that is still as good as a new search result.
    Reused,
    /// An earlier answer with one piece replaced, or one that is a few hundredths longer than necessary.
    Repaired,
}

/// Result of a search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "outcome")]
pub enum PlanOutcome {
    /// A path, from start to goal.
    Found {
        /// Corner points, map frame, including start and goal.
        #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
        path: Vec<Point2<f64>>,
        /// Its length, m.
        length: f64,
    },
    /// The robot does not fit at the goal.
    GoalOccupied {
        /// The nearest place where it fits.
        #[cfg_attr(feature = "schema", schemars(with = "Option<[f64; 2]>"))]
        nearest_free: Option<Point2<f64>>,
    },
    /// The robot does not fit where it stands, according to this map.
    StartOccupied {
        /// The nearest place where it fits.
        #[cfg_attr(feature = "schema", schemars(with = "Option<[f64; 2]>"))]
        nearest_free: Option<Point2<f64>>,
    },
    /// Start and goal are not connected.
    NoPath,
    /// Start or goal is outside the map.
    OutOfMap,
    /// The search ran out of time.
    TimedOut,
    /// The worker has no such map.
    NoMap,
}

/// A request for the trajectory along a path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SmoothRequest {
    /// Robot on whose map to smooth.
    pub robot: String,
    /// Footprint and limits.
    pub model: RobotModel,
    /// The map that the path was found on.
    pub map: MapRef,
    /// Corner points, map frame, including start and goal.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub path: Vec<Point2<f64>>,
    /// Points of the path to stop at, in order, map frame; other corners may be cut.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub via: Vec<Point2<f64>>,
    /// Pieces of the path that are driven in reverse, each by the index of its first corner.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub backwards: Vec<usize>,
    /// Pose at the start.
    pub start: Pose2,
    /// Velocity at the start.
    pub start_velocity: Twist2,
    /// Heading at the end; without it, any.
    pub goal_yaw: Option<f64>,
    /// Whether unknown cells may be driven through.
    #[serde(default)]
    pub unknown_is_free: bool,
    /// Objective of the trajectory.
    #[serde(default)]
    pub profile: DrivingProfile,
}

/// Objective of a trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum DrivingProfile {
    /// As fast as the limits allow.
    #[default]
    Fastest,
    /// With the least energy for the path, by the robot's own motor model, regardless of duration.
    Economy,
}

impl std::str::FromStr for DrivingProfile {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "fastest" => Ok(Self::Fastest),
            "economy" => Ok(Self::Economy),
            _ => Err(format!("`{name}`: expected fastest or economy")),
        }
    }
}

/// Answer to a [`SmoothRequest`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SmoothReply {
    /// The map that was smoothed on.
    pub map: MapRef,
    /// The trajectory; empty only if there is nothing to drive, or the path is blocked, as given by the status.
    pub trajectory: Trajectory,
    /// Status, times, certificate.
    pub statistics: PlanStatistics,
    /// The corridor that the certificate counts, for display: convex polygons that are free for the robot's centre, each with its corners
    /// counter-clockwise, map frame, m, to the millimetre. Straight parts have none; all are left out if they are more than 256. A
    /// [`Plan`](super::Plan) does not carry them: the robot does not need them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Vec<Vec<[f64; 2]>>"))]
    pub corridor: Vec<Vec<Point2<f64>>>,
}

/// A motion worker's request and answer, sufficient to reproduce the computation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MotionRecord {
    /// Time of the answer, on the worker's clock.
    pub stamp: Stamp,
    /// The worker's name.
    pub worker: String,
    /// Number of the request, counted from 1 since the worker's start, over all robots. The state that a worker keeps between requests can
    /// be reconstructed from all of its records.
    pub number: u64,
    /// The map that the answer was computed on; `None` without one.
    pub map: Option<MapRef>,
    /// Zones of that map.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub zones: Vec<Zone>,
    /// What was asked.
    pub request: MotionRequest,
    /// What was answered.
    pub answer: Result<MotionReply, Refusal>,
    /// Whether the time limit was reached while the request was processed; a repetition may give a different result.
    #[serde(default)]
    pub cut_short: bool,
}

/// A search tree or path, for display.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SearchTree {
    /// Time at which it was made.
    pub stamp: Stamp,
    /// Pairs of points, map frame: each an edge of the tree.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[[f64; 2]; 2]>"))]
    pub edges: Vec<[Point2<f64>; 2]>,
    /// The best path so far.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub path: Vec<Point2<f64>>,
}

/// Checks the `backwards` of a path with this many corner points: indices of its legs, ascending.
///
/// ```
/// use zenav_protocol::messages::check_backwards;
///
/// // Three corner points have two legs.
/// assert!(check_backwards(&[0, 1], 3).is_ok());
/// assert!(check_backwards(&[2], 3).is_err());
/// ```
///
/// # Errors
/// What was expected.
pub fn check_backwards(backwards: &[usize], corners: usize) -> Result<(), String> {
    let legs = corners.saturating_sub(1);
    if backwards.is_sorted_by(|a, b| a < b) && backwards.last().is_none_or(|last| *last < legs) {
        Ok(())
    } else {
        Err(format!(
            "`backwards`: expected indices of the path's {legs} legs, ascending"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::shipped;

    #[test]
    fn a_request_says_its_kind_and_how_long_it_may_take() {
        let plan = PlanRequest {
            robot: "r".into(),
            model: RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap(),
            map: MapRef::default(),
            start: Pose2::IDENTITY,
            via: Vec::new(),
            goal: Pose2::new(1.0, 0.0, 0.0),
            planner: "astar".into(),
            unknown_is_free: false,
            cleared: Vec::new(),
            yield_to: Vec::new(),
            escape: 0.0,
            goal_tolerance: 0.0,
            budget_ms: 500,
            seed: 1,
        };
        let whole = MotionRequest::Trajectory(TrajectoryRequest {
            plan: plan.clone(),
            start_velocity: Twist2::ZERO,
            goal_yaw: None,
            profile: DrivingProfile::Fastest,
        });
        assert_eq!(whole.budget(), Duration::from_millis(500) + SMOOTHING_BUDGET);
        assert_eq!(MotionRequest::Plan(plan).budget(), Duration::from_millis(500));
        let value = serde_json::to_value(&whole).unwrap();
        assert_eq!(value["kind"], "trajectory");
        assert_eq!(serde_json::from_value::<MotionRequest>(value).unwrap(), whole);
    }
}
