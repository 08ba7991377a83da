//! Which twist follows a plan? One file a law.

mod trajectory;
mod waypoints;

pub use trajectory::{Timeline, TrajectoryTracker};
pub use waypoints::WaypointTracker;

use zenav_protocol::geometry::{Pose2, Twist2};

/// What a tracker sees in one tick.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Since the last tick, s.
    pub dt: f64,
    /// The estimate.
    pub map_from_base: Pose2,
    /// Measured velocity, base frame.
    pub velocity: Twist2,
    /// Largest speed of a wheel's contact point that still lets the robot rest by the plan's expiry, m/s.
    pub speed_cap: f64,
}

/// How far a tracker is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Plan time reached, s; zero for waypoints.
    pub time: f64,
    /// Next waypoint, counted from zero.
    pub waypoint: usize,
    /// Way left, m.
    pub distance_left: f64,
    /// Time left by the plan, s; for waypoints the distance at top speed.
    pub time_left: f64,
    /// Whether the robot is at rest at the end.
    pub finished: bool,
}
