//! Robot state. What is the robot doing now, and who commands it?

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::{BehaviourReport, LeaseState, Revision, is_first};
use crate::geometry::Twist2;
use crate::time::Stamp;

/// Link state: how long ago the lease was last renewed, by the robot's own clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Link {
    /// The lease is being renewed.
    Connected,
    /// No renewal for a while (default 0.5 s).
    Stale,
    /// No renewal for a long time (default 3 s), or none yet.
    #[default]
    Lost,
}

/// Which controller determines the robot's motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Nothing to do; the robot is at rest.
    #[default]
    Idle,
    /// The robot follows an accepted plan.
    Follow,
    /// An operator drives the robot by hand.
    Teleop,
    /// The robot executes a maneuver (spin, back up, …).
    Behaviour,
    /// The robot follows walls by itself, without a cloud.
    WallFollow,
    /// The robot drives back to its start by itself, without a cloud.
    ReturnHome,
    /// An operator stopped the robot; it stays stopped until resumed.
    Stopped,
}

/// State of the wall follower.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum WallFollowerState {
    /// The robot turns towards the nearest wall.
    #[default]
    WallSearch,
    /// The robot drives up to the wall.
    Approach,
    /// The robot turns until there is room ahead.
    Turn,
    /// The robot drives along the wall.
    WallFollow,
    /// The robot touched something and waits until an operator drives it away.
    Bump,
}

impl WallFollowerState {
    /// The state's name on the wire.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::WallSearch => "wall_search",
            Self::Approach => "approach",
            Self::Turn => "turn",
            Self::WallFollow => "wall_follow",
            Self::Bump => "bump",
        }
    }
}

/// The collision monitor's verdict on the requested motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum GuardZone {
    /// No limit: the motion passes unchanged.
    #[default]
    Clear,
    /// The collision monitor slows the robot down.
    Slow,
    /// The collision monitor keeps the robot at rest.
    Stop,
}

/// Progress on the plan in force.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlanProgress {
    /// The goal that the plan serves.
    pub goal_id: String,
    /// Lease epoch under which the plan was written.
    pub epoch: u64,
    /// The plan's revision.
    pub revision: Revision,
    /// The plan's trajectory; a renewed plan keeps it.
    pub trajectory_id: u64,
    /// Plan time reached, s.
    pub time: f64,
    /// Index of the next waypoint, from zero.
    pub waypoint: usize,
    /// Path left, m.
    pub distance_left: f64,
    /// Time left until the plan's end, s.
    pub time_left: f64,
    /// Time until the plan expires, s.
    pub valid_for: f64,
    /// Whether the robot is at rest at the plan's end.
    pub finished: bool,
}

/// State of a robot, published ten times a second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EdgeState {
    /// Time of the state, on the robot's clock.
    pub stamp: Stamp,
    /// Identifies this start of the edge; new after every restart.
    pub boot_id: String,
    /// Which controller determines the motion.
    pub mode: Mode,
    /// How long ago the lease was renewed.
    pub link: Link,
    /// Who may command the robot.
    pub lease: LeaseState,
    /// Recent maximum of the round trip to the lease holder and back, from its heartbeats, s. `None` before its first heartbeat.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub round_trip_secs: Option<f64>,
    /// Progress on the accepted plan, if there is one.
    pub plan: Option<PlanProgress>,
    /// Velocity in the base frame, m/s and rad/s.
    pub velocity: Twist2,
    /// The collision monitor's verdict.
    pub guard: GuardZone,
    /// Charge left, 0 to 1.
    pub battery: f64,
    /// The maneuver that is running, or the last one.
    pub behaviour: Option<BehaviourReport>,
    /// State of the wall follower, for a robot that follows walls without a commander.
    pub wall_follower: Option<WallFollowerState>,
    /// Control ticks skipped since the start because they came too late.
    #[serde(default)]
    pub missed_ticks: u64,
    /// Share of scans, poses and readings that the robot sends, 0 to 1: below 1 while its link cannot carry them all.
    #[serde(default = "all", skip_serializing_if = "is_all")]
    pub uplink: f64,
    /// Number of stops since this start of the edge.
    #[serde(default)]
    pub stops: u64,
    /// Whether the robot waits or leaves its plan to make way for another robot.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub makes_way: bool,
    /// Frame of the map that the robot's pose and plan are in.
    #[serde(default, skip_serializing_if = "is_first")]
    pub frame: u64,
    /// Present faults of the robot itself.
    #[serde(default, skip_serializing_if = "Faults::are_none")]
    pub faults: Faults,
}

impl Default for EdgeState {
    fn default() -> Self {
        Self {
            stamp: Stamp::default(),
            boot_id: String::new(),
            mode: Mode::default(),
            link: Link::default(),
            lease: LeaseState::default(),
            round_trip_secs: None,
            plan: None,
            velocity: Twist2::default(),
            guard: GuardZone::default(),
            battery: 0.0,
            behaviour: None,
            wall_follower: None,
            missed_ticks: 0,
            uplink: all(),
            stops: 0,
            makes_way: false,
            frame: 0,
            faults: Faults::default(),
        }
    }
}

const fn all() -> f64 {
    1.0
}

fn is_all(share: &f64) -> bool {
    *share >= 1.0
}

/// Faults of the robot itself, as text.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Faults {
    /// Why the body sends no readings: the robot brakes, accepts no plan, and its clock stands still.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<String>,
    /// Why the newest epoch and stop are not stored: a restart would forget them, so the robot grants no lease.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub storage: Option<String>,
    /// Which lidar looks elsewhere than its file says, and by how much: the robot drives slowly.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lidar: Option<String>,
}

impl Faults {
    /// Whether there is no fault.
    #[must_use]
    pub const fn are_none(&self) -> bool {
        self.body.is_none() && self.storage.is_none() && self.lidar.is_none()
    }
}

/// A shape for display.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Marker {
    /// Time of the shape, on the robot's clock.
    pub stamp: Stamp,
    /// What the shape stands for, such as `waypoint`.
    pub name: String,
    /// Corner points, map frame, m; one corner is a point.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<[f64; 2]>"))]
    pub points: Vec<Point2<f64>>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_default_state_is_read_back_as_it_was() {
        let state = EdgeState::default();
        let written = serde_json::to_string(&state).unwrap();
        assert_eq!(serde_json::from_str::<EdgeState>(&written).unwrap(), state, "{written}");
    }
}
