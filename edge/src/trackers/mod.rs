//! Which twist follows a plan? One trait, one file a law; the robot's file names the law (`[controller] tracker = …`).
//!
//! | `tracker` | law | after |
//! |---|---|---|
//! | `time_law` (default) | feed-forward of the time-stamped trajectory, feedback on the pose error | Kanayama 1990, Samson 1990 |
//! | `wheel_law` | wheel speeds in proportion to bearing and distance of the next waypoint | the two-wheel exercise |
//! | `heading_first` | turns to the next waypoint, then drives at it | the go-to-goal exercise |
//! | `pid` | PID on the distance from the path | |
//! | `pure_pursuit` | an arc to a point ahead on the path, slowed in bends and near the end | Macenski et al. 2023 |
//!
//! What laws have in common is kept in `on_path` (laws on a path) and `waypoints` (laws that drive at the next waypoint).
//!
//! A plan without a trajectory is driven by its waypoints: `time_law` falls back to `wheel_law`.

mod heading_first;
mod on_path;
mod path_projection;
mod pid;
mod pure_pursuit;
mod trajectory;
mod waypoints;
mod wheel_law;

pub use heading_first::HeadingFirst;
pub use on_path::{OnPath, PathLaw, Wanted};
pub use path_projection::PathProjection;
pub use pid::Pid;
pub use pure_pursuit::PurePursuit;
pub use trajectory::TrajectoryTracker;
pub use waypoints::{ThroughWaypoints, WaypointLaw};
pub use wheel_law::WheelLaw;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::robot::{ControllerGains, Drive, TrackerKind};
use zenav_protocol::trajectory::Trajectory;

/// A law that follows a plan.
pub trait Tracker: std::fmt::Debug + Send + Sync {
    /// One tick: the wanted twist.
    fn step(&mut self, view: &TrackerInput, gains: &ControllerGains) -> Twist2;

    /// How far it is, for a robot at `map_from_base`.
    fn progress(&self, map_from_base: &Pose2) -> Progress;

    /// What it drives at, map frame: its name and place.
    fn target(&self) -> Option<(&'static str, Point2<f64>)>;

    /// The trajectory and the plan time reached (s), where the plan has a trajectory: a replan is spliced into it.
    fn followed(&self) -> Option<(&Trajectory, f64)>;

    /// Distance from where the plan has the robot, m, at the last tick.
    fn off_track(&self) -> f64;

    /// A copy.
    fn boxed(&self) -> Box<dyn Tracker>;
}

impl Clone for Box<dyn Tracker> {
    fn clone(&self) -> Self {
        self.boxed()
    }
}

/// The law of a kind for a trajectory, from plan time `time` (s) on; `waypoints` are the plan's own.
#[must_use]
pub fn along_trajectory(
    kind: TrackerKind,
    drive: &Drive,
    trajectory: Trajectory,
    time: f64,
    waypoints: &[Point2<f64>],
) -> Box<dyn Tracker> {
    // Without corner points the trajectory's own points will do.
    let corners = || {
        if waypoints.is_empty() {
            trajectory.positions_spaced(0.5)
        } else {
            waypoints.to_vec()
        }
    };
    match kind {
        TrackerKind::TimeLaw => Box::new(TrajectoryTracker::new(drive, trajectory, time)),
        TrackerKind::WheelLaw => {
            let corners = corners();
            Box::new(ThroughWaypoints::new(
                WheelLaw,
                drive,
                corners,
                Some(PathProjection::new(trajectory, time)),
            ))
        }
        TrackerKind::HeadingFirst => {
            let corners = corners();
            Box::new(ThroughWaypoints::new(
                HeadingFirst,
                drive,
                corners,
                Some(PathProjection::new(trajectory, time)),
            ))
        }
        TrackerKind::Pid => Box::new(OnPath::new(
            Pid::default(),
            drive,
            PathProjection::new(trajectory, time),
        )),
        TrackerKind::PurePursuit => Box::new(OnPath::new(
            PurePursuit::default(),
            drive,
            PathProjection::new(trajectory, time),
        )),
    }
}

/// The law of a kind for bare waypoints, from a robot at `map_from_base`.
#[must_use]
pub fn through_waypoints(
    kind: TrackerKind,
    drive: &Drive,
    map_from_base: Pose2,
    waypoints: Vec<Point2<f64>>,
) -> Box<dyn Tracker> {
    let projection = || PathProjection::through(drive, map_from_base, &waypoints);
    match kind {
        TrackerKind::TimeLaw | TrackerKind::WheelLaw => {
            Box::new(ThroughWaypoints::new(WheelLaw, drive, waypoints, None))
        }
        TrackerKind::HeadingFirst => Box::new(ThroughWaypoints::new(HeadingFirst, drive, waypoints, None)),
        TrackerKind::Pid => Box::new(OnPath::new(Pid::default(), drive, projection())),
        TrackerKind::PurePursuit => Box::new(OnPath::new(PurePursuit::default(), drive, projection())),
    }
}

/// What a tracker sees in one tick.
#[derive(Clone, Copy, Debug)]
pub struct TrackerInput {
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

/// At rest: wheel surface speed, m/s.
const AT_REST: f64 = 0.02;

/// Direction of a point relative to the robot's heading, rad.
fn bearing(map_from_base: &Pose2, target: Point2<f64>) -> f64 {
    let to = target - map_from_base.position();
    wrap_angle(to.y.atan2(to.x) - map_from_base.yaw)
}

/// Scales a twist down to a wheel surface speed; the curvature stays.
fn capped(drive: &Drive, twist: Twist2, cap: f64) -> Twist2 {
    let share = (cap / drive.surface_speed(twist).max(1e-9)).min(1.0);
    Twist2::new(share * twist.v, share * twist.w)
}
