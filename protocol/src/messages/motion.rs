//! Motion requests. What is asked of a motion worker, and what does it answer: a path, a trajectory, or both at once.

use std::time::Duration;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::{KnownCourse, MapRef, PlanStatistics, Refusal, Zone};
use crate::geometry::{Pose2, Twist2};
use crate::robot::RobotModel;
use crate::time::Stamp;
use crate::trajectory::Trajectory;

/// Time that smoothing may take; then the path goes out unsmoothed, as stop, turn and go.
pub const SMOOTHING_BUDGET: Duration = Duration::from_secs(2);
/// Longest time that a search may take, whatever is asked for.
const LONGEST_SEARCH: Duration = Duration::from_secs(60);

/// A request to a motion worker; on the wire `{"kind": "trajectory" | "plan" | "smooth", …}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum MotionRequest {
    /// A path that the robot can drive, and its trajectory.
    Trajectory(TrajectoryRequest),
    /// A path alone.
    Plan(PlanRequest),
    /// The trajectory along a given path.
    Smooth(SmoothRequest),
}

impl MotionRequest {
    /// The robot whose map is needed, and the state of it that is needed at least.
    #[must_use]
    pub fn map(&self) -> (&str, &MapRef) {
        match self {
            Self::Trajectory(TrajectoryRequest { plan, .. }) | Self::Plan(plan) => (&plan.robot, &plan.map),
            Self::Smooth(smooth) => (&smooth.robot, &smooth.map),
        }
    }

    /// Time that the search may take.
    #[must_use]
    pub fn search_budget(&self) -> Duration {
        match self {
            Self::Trajectory(TrajectoryRequest { plan, .. }) | Self::Plan(plan) => {
                Duration::from_millis(plan.budget_ms).min(LONGEST_SEARCH)
            }
            Self::Smooth(_) => Duration::ZERO,
        }
    }

    /// Time that the whole answer may take.
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
    /// Heading wanted at the end, rad, if any.
    pub goal_yaw: Option<f64>,
    /// What the trajectory is to be good at.
    #[serde(default)]
    pub profile: DrivingProfile,
}

impl TrajectoryRequest {
    /// The second half of the request: the trajectory along the path that was found on a map, some pieces of it backwards.
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
    /// Its trajectory; `None` without a path. Empty where the robot cannot drive the path, as the status says.
    pub smooth: Option<SmoothReply>,
    /// When the robot is at the goal, its waits for `yield_to` included, s from the start; `None` of a path that gives way to nobody.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arrival_secs: Option<f64>,
}

/// A request for a path through the robot's current map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlanRequest {
    /// Whose map to plan on.
    pub robot: String,
    /// Footprint and limits.
    #[cfg_attr(feature = "schema", schemars(with = "serde_json::Value"))]
    pub model: RobotModel,
    /// The map must be at least at this revision; a worker with an older one asks for the whole first.
    pub map: MapRef,
    /// Start, map frame.
    pub start: Pose2,
    /// Poses to pass on the way to the goal, in order, map frame.
    #[serde(default)]
    pub via: Vec<Pose2>,
    /// Goal, map frame.
    pub goal: Pose2,
    /// Planner (`astar`, …).
    pub planner: String,
    /// Whether unknown cells may be driven through.
    #[serde(default)]
    pub unknown_is_free: bool,
    /// Points whose cells count as free, map frame, m: would there be a path if what stands there had left?
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub cleared: Vec<Point2<f64>>,
    /// Robots to give way to, from the time of the request on: the path leads past them where it can.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub yield_to: Vec<KnownCourse>,
    /// A robot that does not fit where it stands, by the map, may leave by the nearest free position, if that is this near, m.
    #[serde(default)]
    pub escape: f64,
    /// A goal where the robot does not fit may be replaced by the nearest free position, if that is this near, m.
    #[serde(default, skip_serializing_if = "is_none")]
    pub goal_tolerance: f64,
    /// Time the search may take, ms.
    pub budget_ms: u64,
    /// Seed of planners that draw samples.
    #[serde(default)]
    pub seed: u64,
}

/// Answer to a [`PlanRequest`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlanReply {
    /// The map that was planned on.
    pub map: MapRef,
    /// What came out.
    pub outcome: PlanOutcome,
    /// Pieces of the path that are driven backwards, by the corner that they begin at.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub backwards: Vec<usize>,
    /// The leg that the outcome is about where there is no path: zero leads to the first pose of `via`, or to the goal.
    #[serde(default)]
    pub leg: usize,
    /// Whether the path first leads out of a place where the robot does not fit.
    #[serde(default)]
    pub escapes: bool,
    /// Time in the search, ms.
    pub search_ms: f64,
    /// Nodes expanded.
    pub expansions: u64,
    /// How the answer came about.
    #[serde(default)]
    pub origin: PlanOrigin,
}

/// How an answer to a [`PlanRequest`] came about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum PlanOrigin {
    /// By a search for it.
    #[default]
    Searched,
    /// An earlier answer, or the rest of it, which is still as good as a search would find.
    Reused,
    /// An earlier answer of which a piece was replaced, or which is a few hundredths longer than need be.
    Repaired,
}

/// What came out of a search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "outcome")]
pub enum PlanOutcome {
    /// A path, from start to goal.
    Found {
        /// Corner points, map frame, start and goal included.
        #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
        path: Vec<Point2<f64>>,
        /// Its length, m.
        length: f64,
    },
    /// The robot does not fit where it is to go.
    GoalOccupied {
        /// The nearest place where it does.
        #[cfg_attr(feature = "schema", schemars(with = "Option<[f64; 2]>"))]
        nearest_free: Option<Point2<f64>>,
    },
    /// The robot does not fit where it stands, by this map.
    StartOccupied {
        /// The nearest place where it does.
        #[cfg_attr(feature = "schema", schemars(with = "Option<[f64; 2]>"))]
        nearest_free: Option<Point2<f64>>,
    },
    /// Start and goal are not connected.
    NoPath,
    /// Start or goal lie outside the map.
    OutOfMap,
    /// The budget ran out.
    TimedOut,
    /// The worker has no such map.
    NoMap,
}

/// A request for the trajectory along a path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SmoothRequest {
    /// Whose map to smooth on.
    pub robot: String,
    /// Footprint and limits.
    #[cfg_attr(feature = "schema", schemars(with = "serde_json::Value"))]
    pub model: RobotModel,
    /// The map that the path was found on.
    pub map: MapRef,
    /// Corner points, map frame, start and goal included.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub path: Vec<Point2<f64>>,
    /// Points of the path to stop at on the way, in order, map frame: elsewhere its corners may be cut.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub via: Vec<Point2<f64>>,
    /// Pieces of the path that are driven backwards, by the corner that they begin at.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub backwards: Vec<usize>,
    /// Pose at the start.
    pub start: Pose2,
    /// Velocity at the start.
    pub start_velocity: Twist2,
    /// Heading wanted at the end, if any.
    pub goal_yaw: Option<f64>,
    /// Whether unknown cells may be driven through.
    #[serde(default)]
    pub unknown_is_free: bool,
    /// What the trajectory is to be good at.
    #[serde(default)]
    pub profile: DrivingProfile,
}

/// What a trajectory is to be good at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum DrivingProfile {
    /// As fast as the limits allow.
    #[default]
    Fastest,
    /// With the least energy for the path, by the robot's own model of its motors, in whatever time that takes.
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
    /// The trajectory; empty only where there is nothing to drive, or where the path is blocked, as the status says.
    pub trajectory: Trajectory,
    /// Status, times, certificate.
    pub statistics: PlanStatistics,
}

/// What a motion worker was asked, and what it answered: enough to compute it again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MotionRecord {
    /// When it was answered, on the worker's clock.
    pub stamp: Stamp,
    /// The worker's name.
    pub worker: String,
    /// Which of the worker's requests it was, counted from 1 since its start, over all robots. What a worker keeps of one request for the
    /// next is known to whoever has all of them.
    pub number: u64,
    /// The map that it was answered on; `None` without one.
    pub map: Option<MapRef>,
    /// Zones of that map.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub zones: Vec<Zone>,
    /// What was asked.
    pub request: MotionRequest,
    /// What was answered.
    pub answer: Result<MotionReply, Refusal>,
    /// Whether its time ran out while it was worked on: it might have come out otherwise.
    #[serde(default)]
    pub cut_short: bool,
}

/// A search tree or path, to be drawn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SearchTree {
    /// When it was made.
    pub stamp: Stamp,
    /// Pairs of points, map frame: each an edge of the tree.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[[f64; 2]; 2]>"))]
    pub edges: Vec<[Point2<f64>; 2]>,
    /// The best path so far.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub path: Vec<Point2<f64>>,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
fn is_none(tolerance: &f64) -> bool {
    *tolerance == 0.0
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
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
