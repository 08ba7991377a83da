//! Goals. What is a robot asked to do, and how far has it got?

use std::collections::BTreeMap;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::DrivingProfile;
use crate::config_text::{Expected, Number};
use crate::geometry::{MAX_COORDINATE, Pose2, wrap_angle};
use crate::time::Stamp;

/// A place, map frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GoalPoint {
    /// x, map frame, m.
    pub x: f64,
    /// y, map frame, m.
    pub y: f64,
    /// Heading, rad; without it, any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub yaw: Option<f64>,
}

impl GoalPoint {
    /// A place without a heading.
    #[must_use]
    pub const fn at(x: f64, y: f64) -> Self {
        Self { x, y, yaw: None }
    }

    /// Its position, m.
    #[must_use]
    pub fn position(&self) -> Point2<f64> {
        Point2::new(self.x, self.y)
    }

    /// The place as a pose; without a heading, it faces along x.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        Pose2::new(self.x, self.y, self.yaw.unwrap_or(0.0))
    }

    /// The place, with its heading wrapped.
    ///
    /// ```
    /// use zenav_protocol::messages::GoalPoint;
    ///
    /// let place = GoalPoint { x: 2.0, y: 1.5, yaw: Some(-4.0) }.checked()?;
    /// assert!((place.yaw.unwrap() - (std::f64::consts::TAU - 4.0)).abs() < 1e-12);
    /// let in_degrees = GoalPoint { x: 2.0, y: 1.5, yaw: Some(90.0) }.checked().unwrap_err();
    /// assert_eq!(in_degrees, "yaw is 90: expected radians within a full turn; 90 degrees are 1.571");
    /// # Ok::<(), String>(())
    /// ```
    ///
    /// # Errors
    /// What was expected: coordinates within 100 km, a heading in radians.
    pub fn checked(self) -> Result<Self, String> {
        let is_near = |value: f64| value.abs() <= MAX_COORDINATE;
        if !(is_near(self.x) && is_near(self.y)) {
            return Err(format!(
                "({}, {}): expected finite coordinates within {MAX_COORDINATE} m",
                Number(self.x),
                Number(self.y)
            ));
        }
        let yaw = self.yaw.map(|yaw| Expected::Angle.check(yaw)).transpose();
        Ok(Self {
            yaw: yaw.map_err(|why| format!("yaw is {why}"))?.map(wrap_angle),
            ..self
        })
    }
}

impl From<Pose2> for GoalPoint {
    fn from(pose: Pose2) -> Self {
        Self {
            yaw: Some(pose.yaw),
            ..Self::at(pose.x, pose.y)
        }
    }
}

/// A goal: exactly one of (`x`, `y`), `place` and `waypoints`; or a `tree`, alone or with one of them.
///
/// The tree finds the place on its blackboard as `goal`, and the waypoints as `goals`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GoalRequest {
    /// Identifies the goal; chosen by the requester. A repeated id means the same goal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// x, map frame, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x: Option<f64>,
    /// y, map frame, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y: Option<f64>,
    /// Heading at the goal, rad; without it, any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub yaw: Option<f64>,
    /// Name of a place on the map: from the world or deployment file, or added later.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
    /// Places to pass through, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub waypoints: Vec<GoalPoint>,
    /// A behaviour tree: the name of a shipped one, or its XML.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tree: Option<String>,
    /// Entries for the tree's blackboard.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub blackboard: BTreeMap<String, serde_json::Value>,
    /// What happens when another goal is being executed.
    #[serde(default)]
    pub on_busy: OnBusy,
    /// Queue priority, highest first; goals of equal priority run in order of arrival.
    #[serde(default)]
    pub priority: i32,
    /// Time limit from acceptance, s; when it passes, the goal is aborted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline_secs: Option<f64>,
    /// Distance from the place at which it counts as reached, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Driving profile of the trajectories; without it, the deployment's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile: Option<DrivingProfile>,
}

impl GoalRequest {
    /// Most waypoints of a goal.
    pub const MAX_WAYPOINTS: usize = 1000;
}

/// What happens to a goal that arrives while another one is being executed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum OnBusy {
    /// The new goal joins the queue.
    #[default]
    Queue,
    /// The running goal is cancelled.
    Preempt,
    /// The new goal is refused.
    Reject,
}

/// Phase of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum GoalPhase {
    /// The goal is stored and waits in the queue.
    Accepted,
    /// The goal is being executed.
    Active,
    /// The goal is paused.
    Paused,
    /// The goal was reached.
    Succeeded,
    /// The goal was given up, for the stated reason.
    Aborted,
    /// The goal was cancelled by a request.
    Canceled,
    /// The goal was refused after it was stored.
    Rejected,
}

impl GoalPhase {
    /// Whether the goal has ended: it changes phase no more.
    #[must_use]
    pub const fn is_end(self) -> bool {
        matches!(self, Self::Succeeded | Self::Aborted | Self::Canceled | Self::Rejected)
    }

    /// The phase in one word, for people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Active => "active",
            Self::Paused => "paused",
            Self::Succeeded => "succeeded",
            Self::Aborted => "aborted",
            Self::Canceled => "canceled",
            Self::Rejected => "rejected",
        }
    }
}

/// Answer to a goal, a cancel or a pause.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GoalReply {
    /// Identifies the goal.
    pub id: String,
    /// The goal's phase.
    pub state: GoalPhase,
    /// Why the goal ended, unless it succeeded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// For a request to a group of robots: the robot that took the goal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
}

/// A goal and its progress.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GoalState {
    /// Identifies the goal.
    pub id: String,
    /// The robot that the goal is for.
    pub robot: String,
    /// The goal's phase.
    pub state: GoalPhase,
    /// Why the goal ended, unless it succeeded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Position in the queue while the goal waits: 1 is next.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub queue: Option<u64>,
    /// Time of acceptance, on the mission's clock.
    pub accepted: Stamp,
    /// Time at which its execution began.
    pub started: Option<Stamp>,
    /// Time of the end.
    pub ended: Option<Stamp>,
    /// Progress on the goal.
    #[serde(default)]
    pub feedback: GoalFeedback,
    /// Drives of the goal, in order; only the newest if there are many.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub legs: Vec<Leg>,
    /// The goal as it was submitted.
    pub request: GoalRequest,
    /// Current coordinates of the goal's places, if the map has moved since it was submitted: the places keep their spot in the building,
    /// so their coordinates change.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub resolved: Vec<GoalPoint>,
}

/// One drive of a goal: the robot follows a path or a list of waypoints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Leg {
    /// Name of the tree node that drove.
    pub name: String,
    /// The drive's destination, if it is a single place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goal: Option<GoalPoint>,
    /// `Active`, `Succeeded`, `Aborted` or `Canceled`.
    pub state: GoalPhase,
    /// Why the drive ended, unless it succeeded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Time at which driving began.
    pub started: Stamp,
    /// Time at which it ended.
    pub ended: Option<Stamp>,
    /// Trajectories published for the drive.
    #[serde(default)]
    pub plans: u64,
    /// Trajectories that replaced a blocked, lost or refused one.
    #[serde(default)]
    pub replans: u64,
    /// Length of the first planned path, m.
    #[serde(default)]
    pub planned_length: f64,
}

/// Progress on a goal.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GoalFeedback {
    /// What the behaviour tree is doing, in words.
    pub step: String,
    /// Path left, m.
    pub distance_left: Option<f64>,
    /// Time left, s.
    pub time_left: Option<f64>,
    /// Plans published for the goal.
    #[serde(default)]
    pub plans: u64,
    /// Plans that replaced a blocked or lost one.
    #[serde(default)]
    pub replans: u64,
    /// Recoveries started.
    #[serde(default)]
    pub recoveries: u64,
    /// Distance between robot and goal at the end, by the robot's own estimate, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub final_error: Option<f64>,
    /// The blockage that the robot is waiting for, while it waits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blockage: Option<Blockage>,
}

/// An obstacle that blocks the way and may leave.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Blockage {
    /// x of its centre, map frame, m.
    pub x: f64,
    /// y of its centre, map frame, m.
    pub y: f64,
    /// Time since which it is known to be there, on the mission's clock.
    pub since: Stamp,
}

impl Blockage {
    /// Its centre, m.
    #[must_use]
    pub fn position(&self) -> Point2<f64> {
        Point2::new(self.x, self.y)
    }
}

/// Cancels a goal.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CancelRequest {
    /// Goal to cancel; without it, the running one.
    pub id: Option<String>,
    /// Identifies the request: a repeated request gets the first answer.
    pub request_id: Option<String>,
}

/// Pauses a goal, or resumes it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PauseRequest {
    /// Goal to pause or resume; without it, the running one.
    pub id: Option<String>,
    /// `false` pauses the goal, `true` resumes it.
    #[serde(default)]
    pub resume: bool,
    /// Identifies the request: a repeated request gets the first answer.
    pub request_id: Option<String>,
}

/// Moves a waiting goal to another position in the queue.
///
/// The goal takes on the priority and the urgency (`preempt`) of the goal it is put before, or of the last one in the queue.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MoveGoalRequest {
    /// Goal to move.
    pub id: String,
    /// The waiting goal to put it before; without it, the goal moves to the end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before: Option<String>,
    /// Identifies the request: a repeated request gets the first answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request_id: Option<String>,
}

/// Lists goals.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GoalsRequest {
    /// Only this goal.
    pub id: Option<String>,
    /// Only goals in these states; empty means all.
    #[serde(default)]
    pub states: Vec<GoalPhase>,
    /// Most goals in the answer, newest first.
    pub limit: Option<usize>,
}

/// Answer to a list of goals.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GoalsReply {
    /// The goals, newest first.
    pub goals: Vec<GoalState>,
    /// Time of the answer, on the mission's clock, for comparison with the goals' stamps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub now: Option<Stamp>,
}
