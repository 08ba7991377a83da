//! Trackers. Which twist follows a plan? One trait, one file per law; the robot file names the law (`[controller] tracker = …`).
//!
//! | `tracker` | law | after |
//! |---|---|---|
//! | `time_law` (default) | feed-forward of the time-stamped trajectory, feedback on the pose error | Kanayama 1990, Samson 1990 |
//! | `wheel_law` | wheel speeds in proportion to bearing and distance of the next waypoint | the two-wheel exercise |
//! | `wheel_law_original` | the same without changes, as a yardstick | the two-wheel exercise |
//! | `heading_first` | turns to the next waypoint, then drives at it | the go-to-goal exercise |
//! | `pid` | PID on the distance from the path | |
//! | `pure_pursuit` | an arc to a point ahead on the path, slowed in bends and near the end | Macenski et al. 2023 |
//!
//! Code that several laws share is in `on_path` (laws on a path) and `waypoints` (laws that drive at the next waypoint).
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
mod wheel_law_original;

pub use heading_first::HeadingFirst;
pub use on_path::{OnPath, PathLaw, Wanted};
pub use path_projection::PathProjection;
pub use pid::Pid;
pub use pure_pursuit::PurePursuit;
pub use trajectory::TrajectoryTracker;
pub use waypoints::{ThroughWaypoints, WaypointLaw};
pub use wheel_law::WheelLaw;
pub use wheel_law_original::OriginalWheelLaw;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::robot::{ControllerGains, Drive};
use zenav_protocol::trajectory::Trajectory;

/// A law that follows a plan.
pub trait Tracker: std::fmt::Debug + Send + Sync {
    /// One tick: the wanted twist.
    fn step(&mut self, view: &TrackerInput, gains: &ControllerGains) -> Twist2;

    /// Progress of a robot at `map_from_base`.
    fn progress(&self, map_from_base: &Pose2) -> Progress;

    /// Name and position of the point that it drives at, map frame.
    fn target(&self) -> Option<(&'static str, Point2<f64>)>;

    /// The trajectory and the plan time reached (s), where the plan has a trajectory: a replan is spliced into it.
    fn followed(&self) -> Option<(&Trajectory, f64)>;

    /// Continues from the place on the path nearest to the robot, which another source drives now.
    fn rejoin(&mut self, map_from_base: &Pose2);

    /// Distance from the plan at the last tick, m.
    fn off_track(&self) -> f64;

    /// Carries the plan over to another map frame.
    fn moved(&mut self, new_from_old: Pose2);

    /// A copy.
    fn boxed(&self) -> Box<dyn Tracker>;
}

impl Clone for Box<dyn Tracker> {
    fn clone(&self) -> Self {
        self.boxed()
    }
}

/// A law that `[controller] tracker` names. A new tracker is a file with its law, and a row of [`LAWS`].
#[derive(Clone, Copy, Debug)]
pub struct Law {
    /// Its name in the robot file.
    pub name: &'static str,
    along: Along,
    through: Through,
}

/// Makes a tracker for a trajectory that has been driven for some seconds, and the waypoints it came from.
type Along = fn(&Drive, Trajectory, f64, &[Point2<f64>]) -> Box<dyn Tracker>;
/// Makes a tracker for waypoints, from a pose.
type Through = fn(&Drive, Pose2, Vec<Point2<f64>>) -> Box<dyn Tracker>;

/// Every law; the first is the default.
pub const LAWS: &[Law] = &[
    Law {
        name: "time_law",
        along: |drive, trajectory, time, _| Box::new(TrajectoryTracker::new(drive, trajectory, time)),
        through: |drive, _, waypoints| Box::new(ThroughWaypoints::new(WheelLaw, drive, waypoints, None)),
    },
    Law::on_path::<PurePursuit>("pure_pursuit"),
    Law::on_path::<Pid>("pid"),
    Law::at_waypoints::<WheelLaw>("wheel_law"),
    Law::at_waypoints::<OriginalWheelLaw>("wheel_law_original"),
    Law::at_waypoints::<HeadingFirst>("heading_first"),
];

/// The robot file names an unknown tracker.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`controller.tracker` is `{0}`: expected one of {list}", list = LAWS.iter().map(|law| law.name).collect::<Vec<_>>().join(", "))]
pub struct UnknownTracker(String);

impl Law {
    /// The law of a name.
    ///
    /// ```
    /// use zenav_edge::trackers::Law;
    ///
    /// assert_eq!(Law::named("pure_pursuit")?.name, "pure_pursuit");
    /// let unknown = Law::named("mpc").unwrap_err().to_string();
    /// assert!(unknown.starts_with("`controller.tracker` is `mpc`: expected one of time_law, pure_pursuit"), "{unknown}");
    /// # Ok::<(), zenav_edge::trackers::UnknownTracker>(())
    /// ```
    ///
    /// # Errors
    /// [`UnknownTracker`], which lists the known ones.
    pub fn named(name: &str) -> Result<Self, UnknownTracker> {
        let known = LAWS.iter().copied().find(|law| law.name == name);
        known.ok_or_else(|| UnknownTracker(name.chars().take(64).collect()))
    }

    /// The law that a robot's gains name; the default if there is no such law.
    pub(crate) fn of(gains: &ControllerGains) -> Self {
        Self::named(&gains.tracker).unwrap_or(LAWS[0])
    }

    /// A law of feedback from a path.
    const fn on_path<L: PathLaw + Default>(name: &'static str) -> Self {
        Self {
            name,
            along: |drive, trajectory, time, _| {
                Box::new(OnPath::new(L::default(), drive, PathProjection::new(trajectory, time)))
            },
            through: |drive, map_from_base, waypoints| {
                let projection = PathProjection::through(drive, map_from_base, &waypoints);
                Box::new(OnPath::new(L::default(), drive, projection))
            },
        }
    }

    /// A law that drives at the next waypoint.
    const fn at_waypoints<L: WaypointLaw + Default>(name: &'static str) -> Self {
        Self {
            name,
            along: |drive, trajectory, time, waypoints| {
                // Without corner points the trajectory's own points will do.
                let corners = if waypoints.is_empty() {
                    trajectory.positions_spaced(0.5)
                } else {
                    waypoints.to_vec()
                };
                let projection = PathProjection::new(trajectory, time);
                Box::new(ThroughWaypoints::new(L::default(), drive, corners, Some(projection)))
            },
            through: |drive, _, waypoints| Box::new(ThroughWaypoints::new(L::default(), drive, waypoints, None)),
        }
    }

    /// A tracker along a trajectory from plan time `time` (s) on; `waypoints` are the plan's own. A trajectory driven backwards takes the
    /// default law: the others drive at points ahead of the robot.
    ///
    /// ```
    /// # let tiago = zenav_fixtures::robot("tiago");
    /// use zenav_edge::trackers::{Law, Tracker, TrackerInput};
    /// use zenav_protocol::{geometry::{Pose2, Twist2}, trajectory::TrajectoryPoint};
    ///
    /// let at = |t: f64| TrajectoryPoint { t, x: 0.4 * t, v: 0.4, ..TrajectoryPoint::default() };
    /// let mut tracker = Law::named("time_law")?.along_trajectory(&tiago.drive, vec![at(0.0), at(5.0)].into(), 0.0, &[]);
    /// // The robot is 5 cm to the left of its straight path.
    /// let map_from_base = Pose2::new(0.0, 0.05, 0.0);
    /// let view = TrackerInput { dt: 0.02, map_from_base, velocity: Twist2::new(0.4, 0.0), speed_cap: f64::INFINITY };
    /// let wanted = tracker.step(&view, &tiago.controller);
    /// assert!(wanted.v > 0.3 && wanted.w < 0.0, "{wanted:?}");
    /// # Ok::<(), zenav_edge::trackers::UnknownTracker>(())
    /// ```
    #[must_use]
    pub fn along_trajectory(
        &self,
        drive: &Drive,
        trajectory: Trajectory,
        time: f64,
        waypoints: &[Point2<f64>],
    ) -> Box<dyn Tracker> {
        let law = if trajectory.iter().any(|point| point.v < 0.0) {
            &LAWS[0]
        } else {
            self
        };
        (law.along)(drive, trajectory, time, waypoints)
    }

    /// A tracker through bare waypoints, from a robot at `map_from_base`.
    #[must_use]
    pub fn through_waypoints(
        &self,
        drive: &Drive,
        map_from_base: Pose2,
        waypoints: Vec<Point2<f64>>,
    ) -> Box<dyn Tracker> {
        (self.through)(drive, map_from_base, waypoints)
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

/// Progress of a tracker.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Plan time reached, s; zero for waypoints.
    pub time: f64,
    /// Next waypoint, counted from zero.
    pub waypoint: usize,
    /// Distance left, m.
    pub distance_left: f64,
    /// Time left by the plan, s; for waypoints the distance left at top speed.
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
pub(crate) fn capped(drive: &Drive, twist: Twist2, cap: f64) -> Twist2 {
    let share = (cap / drive.surface_speed(twist).max(1e-9)).min(1.0);
    Twist2::new(share * twist.v, share * twist.w)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_law_is_found_by_its_name_and_an_unknown_one_is_refused_with_all_that_there_are() {
        assert!(
            LAWS.iter()
                .all(|law| Law::named(law.name).is_ok_and(|known| known.name == law.name))
        );
        assert_eq!(Law::of(&ControllerGains::default()).name, LAWS[0].name);
        let refusal = Law::named("mpc").map_err(|error| error.to_string());
        assert!(refusal.is_err_and(|text| text.contains("`mpc`") && LAWS.iter().all(|law| text.contains(law.name))));
    }
}
