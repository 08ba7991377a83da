//! Plan acceptance. May this plan move the robot? Trust but verify: the robot checks every plan before it drives it.
//!
//! A plan must belong to the current lease epoch and boot, be newer than every plan before it, not expired, finite, monotone in time and
//! within the robot's own limits, start where the robot will be, and be free of obstacles as far as the robot's latest scan sees. A
//! rejection has no effect except an event with its reason.

use nalgebra::Point2;
use thiserror::Error;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::{Plan, Revision, Trajectory, TrajectoryPoint};
use zenav_protocol::robot::{Drive, RobotModel};
use zenav_protocol::time::Stamp;

use crate::settings::AcceptanceSettings;

/// Tolerance of speed and acceleration limits for rounding and sampling, as a share.
const LIMIT_SLACK: f64 = 0.02;
/// Tolerance of a wheel's speed change between two points, rad/s.
const STEP_SLACK: f64 = 0.1;
/// A trajectory ends at rest: largest wheel surface speed there, m/s.
const END_SPEED: f64 = 0.1;
/// Largest coordinate of a point, m: with greater ones lengths would overflow. And longest trajectory, m: some trackers divide it into
/// equal steps.
const FARTHEST: f64 = 1e8;
const LONGEST: f64 = 1e5;
/// Most trajectory points and waypoints looked at.
const MOST_POINTS: usize = 100_000;
/// Longest goal id, bytes.
const LONGEST_ID: usize = 128;
/// Spacing of the poses checked against the scan, m and rad.
const CHECK_SPACING: (f64, f64) = (0.05, 0.2);
/// An obstacle in contact may be this much deeper inside the outline along the path than it is now, m.
const TOUCHING: f64 = 0.01;

/// Why a plan was refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Rejection {
    /// The plan belongs to another lease epoch.
    #[error("plan of epoch {got}, the current epoch is {current}")]
    WrongEpoch {
        /// Epoch of the plan.
        got: u64,
        /// Epoch of the current lease.
        current: u64,
    },
    /// No lease is live, or an operator holds it.
    #[error("no mission holds a live lease")]
    NoLease,
    /// The stop is latched.
    #[error("the robot is stopped")]
    Stopped,
    /// The plan was made in a map frame from which it cannot be carried over to the robot's.
    #[error("OldFrame: the plan is of map frame {got}, the robot is in frame {current}")]
    OldFrame {
        /// Frame of the plan.
        got: u64,
        /// Frame of the robot.
        current: u64,
    },
    /// The robot's pose in the map is not known.
    #[error("it is not known where the robot is")]
    NotLocalised,
    /// A maneuver is running.
    #[error("maneuver {0} is running")]
    Busy(String),
    /// Not newer than a plan seen before.
    #[error("plan revision {}.{} is not newer than {}.{}", .got.incarnation, .got.counter, .newest.incarnation, .newest.counter)]
    Stale {
        /// Revision of the plan.
        got: Revision,
        /// The newest seen under this epoch.
        newest: Revision,
    },
    /// Its revision is farther from the newest than a writer can count within a lease.
    #[error("plan revision {}.{} leaps from {}.{}, by more than {longest}", .got.incarnation, .got.counter, .newest.incarnation, .newest.counter)]
    Leap {
        /// Revision of the plan.
        got: Revision,
        /// The newest accepted under this epoch.
        newest: Revision,
        /// The longest step.
        longest: u64,
    },
    /// Its trajectory was discarded before.
    #[error("trajectory {0} was discarded; send a new one")]
    Discarded(u64),
    /// Based on another boot of this edge.
    #[error("plan based on boot {got}, the edge runs boot {current}")]
    WrongBoot {
        /// Boot id that the plan is based on, shortened.
        got: String,
        /// Boot id of this edge.
        current: String,
    },
    /// Based on a stamp in the future.
    #[error("plan based on a stamp {0:.3} s in the future")]
    Future(f64),
    /// Based on a time before the last resume.
    #[error("plan based on a stamp from before the robot was resumed")]
    BeforeResume,
    /// It has expired.
    #[error("plan expired {0:.3} s ago")]
    Expired(f64),
    /// A number that is not finite, or a name that is too long.
    #[error("{0}")]
    Malformed(&'static str),
    /// Another frame than the map.
    #[error("plan frame is not `map`")]
    Frame,
    /// Neither trajectory nor waypoints.
    #[error("plan has neither trajectory nor waypoints")]
    Empty,
    /// Time does not increase from point to point.
    #[error("time does not increase at point {0}")]
    TimeOrder(usize),
    /// Over a limit of the robot.
    #[error("{what} at point {point} is {value:.3}, over the limit of {limit:.3}")]
    OverLimit {
        /// Name of the quantity.
        what: &'static str,
        /// Index of the point.
        point: usize,
        /// Value in the plan.
        value: f64,
        /// Limit of the robot.
        limit: f64,
    },
    /// It does not start where the robot will be.
    #[error("trajectory starts {distance:.2} m, {yaw:.2} rad and {speed:.2} m/s from where the robot will be")]
    Start {
        /// Distance from the predicted position, m.
        distance: f64,
        /// Difference of heading, rad.
        yaw: f64,
        /// Difference of wheel surface speed, m/s.
        speed: f64,
    },
    /// It does not end at rest.
    #[error("trajectory ends at {0:.2} m/s, not at rest")]
    EndsMoving(f64),
    /// An obstacle is in the way.
    #[error("blocked in the latest scan at ({x:.2}, {y:.2}), {time:.1} s ahead")]
    Blocked {
        /// Obstacle, map frame, m.
        x: f64,
        /// Obstacle, map frame, m.
        y: f64,
        /// Plan time of the collision, s.
        time: f64,
    },
    /// A known trajectory id with other points.
    #[error("trajectory {0} is known with other points")]
    Changed(u64),
}

/// The names of the rejections for the metrics, one per variant.
macro_rules! kinds {
    ($($pattern:pat => $name:literal),* $(,)?) => {
        impl Rejection {
            /// Every name that [`Self::kind`] gives.
            pub const KINDS: &'static [&'static str] = &[$($name),*];

            /// Which check the plan failed, without its numbers.
            #[must_use]
            pub const fn kind(&self) -> &'static str {
                match self {
                    $($pattern => $name,)*
                }
            }
        }
    };
}

kinds! {
    Self::WrongEpoch { .. } => "wrong_epoch",
    Self::NoLease => "no_lease",
    Self::Stopped => "stopped",
    Self::NotLocalised => "not_localised",
    Self::Busy(_) => "busy",
    Self::Stale { .. } => "stale",
    Self::Discarded(_) => "discarded",
    Self::WrongBoot { .. } => "wrong_boot",
    Self::Future(_) => "future",
    Self::BeforeResume => "before_resume",
    Self::Expired(_) => "expired",
    Self::Malformed(_) => "malformed",
    Self::Frame => "frame",
    Self::OldFrame { .. } => "old_frame",
    Self::Leap { .. } => "leap",
    Self::Empty => "empty",
    Self::TimeOrder(_) => "time_order",
    Self::OverLimit { .. } => "over_limit",
    Self::Start { .. } => "start",
    Self::EndsMoving(_) => "ends_moving",
    Self::Blocked { .. } => "blocked",
    Self::Changed(_) => "changed",
}

/// The robot's lease, stop and clock, against which a plan's header is checked.
#[derive(Clone, Debug)]
pub struct Grant<'a> {
    /// Now, on the edge's clock.
    pub now: Stamp,
    /// Id of this boot.
    pub boot_id: &'a str,
    /// Epoch of the current lease.
    pub epoch: u64,
    /// Whether a mission's lease is live.
    pub mission_live: bool,
    /// Whether the stop is latched.
    pub stopped: bool,
    /// When the robot was resumed last.
    pub resumed: Option<Stamp>,
    /// The newest revision accepted under this epoch.
    pub newest: Option<Revision>,
    /// Longest validity that counts, s.
    pub max_validity: f64,
    /// Longest accepted step of a counter or an incarnation.
    pub longest_step: u64,
}

/// Checks a plan's header: who wrote it, when, for how long. Returns its expiry on the edge's clock.
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_edge::acceptance::{Grant, Rejection, judge_head};
/// # use zenav_protocol::messages::{BasedOn, MapRef, Plan, PlanStatistics, Revision, Trajectory};
/// # use zenav_protocol::time::Stamp;
/// # let plan = Plan {
/// #     goal_id: "tea".into(), epoch: 4, revision: Revision { incarnation: 1, counter: 1 }, trajectory_id: 1, map: MapRef::default(),
/// #     frame: "map".into(), based_on: BasedOn { stamp: Stamp::from_secs(10.0), boot_id: "boot-1".into() }, valid_for: 3.0,
/// #     waypoints: vec![Point2::new(1.0, 0.0)], trajectory: Trajectory::default(), splice: None, statistics: PlanStatistics::default(),
/// # };
/// # let grant = Grant {
/// #     now: Stamp::from_secs(10.2), boot_id: "boot-1", epoch: 4, mission_live: true, stopped: false, resumed: None, newest: None,
/// #     max_validity: 10.0, longest_step: 1000,
/// # };
/// // A plan of epoch 4, made from the pose at 10 s and valid for 3 s, arrives at 10.2 s.
/// assert_eq!(judge_head(&plan, &grant), Ok(Stamp::from_secs(13.0)));
/// let late = Grant { now: Stamp::from_secs(13.5), ..grant.clone() };
/// assert_eq!(judge_head(&plan, &late).unwrap_err().to_string(), "plan expired 0.500 s ago");
/// let of_another = Grant { epoch: 5, ..grant };
/// assert_eq!(judge_head(&plan, &of_another), Err(Rejection::WrongEpoch { got: 4, current: 5 }));
/// ```
///
/// # Errors
/// [`Rejection`].
pub fn judge_head(plan: &Plan, grant: &Grant<'_>) -> Result<Stamp, Rejection> {
    if plan.epoch != grant.epoch {
        return Err(Rejection::WrongEpoch {
            got: plan.epoch,
            current: grant.epoch,
        });
    }
    if !grant.mission_live {
        return Err(Rejection::NoLease);
    }
    if grant.stopped {
        return Err(Rejection::Stopped);
    }
    if plan.based_on.boot_id != grant.boot_id {
        return Err(Rejection::WrongBoot {
            got: plan.based_on.boot_id.chars().take(40).collect(),
            current: grant.boot_id.to_owned(),
        });
    }
    if let Some(newest) = grant.newest.filter(|newest| plan.revision <= *newest) {
        return Err(Rejection::Stale {
            got: plan.revision,
            newest,
        });
    }
    if let Some(newest) = grant
        .newest
        .filter(|newest| leaps(plan.revision, *newest, grant.longest_step))
    {
        return Err(Rejection::Leap {
            got: plan.revision,
            newest,
            longest: grant.longest_step,
        });
    }
    if plan.based_on.stamp > grant.now {
        return Err(Rejection::Future(plan.based_on.stamp.secs_since(grant.now)));
    }
    if grant.resumed.is_some_and(|resumed| plan.based_on.stamp < resumed) {
        return Err(Rejection::BeforeResume);
    }
    if !(plan.valid_for.is_finite() && plan.valid_for > 0.0) {
        return Err(Rejection::Malformed("plan validity is not a positive number"));
    }
    if plan.goal_id.len() > LONGEST_ID {
        return Err(Rejection::Malformed("plan goal id is too long"));
    }
    if plan.frame != "map" {
        return Err(Rejection::Frame);
    }
    let expiry = plan.based_on.stamp.plus_secs(plan.valid_for.min(grant.max_validity));
    if expiry <= grant.now {
        return Err(Rejection::Expired(grant.now.secs_since(expiry)));
    }
    Ok(expiry)
}

/// Whether a revision is farther from the newest than a writer can count.
fn leaps(revision: Revision, newest: Revision, longest: u64) -> bool {
    let counted_from = if revision.incarnation == newest.incarnation {
        newest.counter
    } else {
        0
    };
    revision.incarnation.saturating_sub(newest.incarnation) > longest
        || revision.counter.saturating_sub(counted_from) > longest
}

/// Checks a plan's content by itself: finite, monotone, within the limits of this robot.
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_edge::acceptance::judge_course;
/// # use zenav_protocol::messages::{BasedOn, MapRef, Plan, PlanStatistics, Revision, Trajectory, TrajectoryPoint};
/// # let drive = zenav_fixtures::robot("tiago").drive;
/// # let plan = Plan {
/// #     goal_id: "tea".into(), epoch: 4, revision: Revision::default(), trajectory_id: 1, map: MapRef::default(), frame: "map".into(),
/// #     based_on: BasedOn::default(), valid_for: 3.0, waypoints: vec![Point2::new(1.0, 0.0)], trajectory: Trajectory::default(),
/// #     splice: None, statistics: PlanStatistics::default(),
/// # };
/// // A list of waypoints is driven at the robot's own speed; a trajectory must keep its limits.
/// assert_eq!(judge_course(&plan, &drive), Ok(()));
/// let at = |t: f64, x: f64, v: f64| TrajectoryPoint { t, x, v, ..TrajectoryPoint::default() };
/// let trajectory = vec![at(0.0, 0.0, 0.0), at(1.0, 0.5, 1.0), at(2.0, 1.0, 0.0)].into();
/// let error = judge_course(&Plan { trajectory, ..plan }, &drive).unwrap_err();
/// assert_eq!(error.to_string(), "wheel speed at point 1 is 10.152, over the limit of 6.280");
/// ```
///
/// # Errors
/// [`Rejection`].
pub fn judge_course(plan: &Plan, drive: &Drive) -> Result<(), Rejection> {
    if plan.trajectory.is_empty() && plan.waypoints.is_empty() {
        return Err(Rejection::Empty);
    }
    if plan.trajectory.len() > MOST_POINTS || plan.waypoints.len() > MOST_POINTS {
        return Err(Rejection::Malformed("plan has too many points"));
    }
    if !plan
        .waypoints
        .iter()
        .all(|point| point.coords.iter().all(|value| value.is_finite()))
    {
        return Err(Rejection::Malformed("a waypoint is not finite"));
    }
    if !plan
        .trajectory
        .iter()
        .all(|p| p.t.is_finite() && p.pose().is_finite() && p.twist().is_finite())
    {
        return Err(Rejection::Malformed("a trajectory point is not finite"));
    }
    let points = plan.trajectory.iter().map(TrajectoryPoint::position);
    if !points
        .chain(plan.waypoints.iter().copied())
        .all(|point| point.coords.amax() <= FARTHEST)
    {
        return Err(Rejection::Malformed("a point is too far from the map's origin"));
    }
    if plan.trajectory.length() > LONGEST {
        return Err(Rejection::Malformed("the trajectory is too long"));
    }
    if plan.splice.is_some_and(|splice| !splice.time.is_finite()) {
        return Err(Rejection::Malformed("plan splice time is not finite"));
    }
    if plan.trajectory.first().is_some_and(|first| first.t.abs() > 1e-6) {
        return Err(Rejection::Malformed("trajectory does not start at time zero"));
    }
    for (index, point) in plan.trajectory.iter().enumerate() {
        judge_speed(index, point.twist(), drive)?;
    }
    for (index, pair) in plan.trajectory.windows(2).enumerate() {
        if let [from, to] = pair {
            judge_step(index + 1, from, to, drive)?;
        }
    }
    if let Some(last) = plan.trajectory.last() {
        let speed = drive.surface_speed(last.twist());
        if speed > END_SPEED {
            return Err(Rejection::EndsMoving(speed));
        }
    }
    Ok(())
}

fn within(what: &'static str, point: usize, value: f64, limit: f64) -> Result<(), Rejection> {
    if value.abs() > limit * (1.0 + LIMIT_SLACK) {
        Err(Rejection::OverLimit {
            what,
            point,
            value: value.abs(),
            limit,
        })
    } else {
        Ok(())
    }
}

fn judge_speed(point: usize, twist: Twist2, drive: &Drive) -> Result<(), Rejection> {
    for wheel in drive.wheels(twist) {
        within("wheel speed", point, wheel, drive.max_wheel_speed)?;
    }
    within("speed", point, twist.v, drive.top_speed())?;
    within("yaw rate", point, twist.w, drive.top_yaw_rate())
}

fn judge_step(point: usize, from: &TrajectoryPoint, to: &TrajectoryPoint, drive: &Drive) -> Result<(), Rejection> {
    let dt = to.t - from.t;
    if dt <= 0.0 {
        return Err(Rejection::TimeOrder(point));
    }
    let (before, after) = (drive.wheels(from.twist()), drive.wheels(to.twist()));
    for (before, after) in before.iter().zip(after) {
        let limit = drive.max_wheel_acceleration * dt + STEP_SLACK;
        if (after - before).abs() > limit * (1.0 + LIMIT_SLACK) {
            return Err(Rejection::OverLimit {
                what: "wheel acceleration",
                point,
                value: (after - before).abs() / dt,
                limit: drive.max_wheel_acceleration,
            });
        }
    }
    // The poses must be reachable at these speeds.
    let (way, turn) = (from.pose().distance(&to.pose()), wrap_angle(to.yaw - from.yaw));
    within("distance to the point", point, way, drive.top_speed() * dt + 0.01)?;
    within("turn to the point", point, turn, drive.top_yaw_rate() * dt + 0.02)
}

/// Checks that a trajectory starts where the robot will be.
///
/// # Errors
/// [`Rejection::Start`].
pub fn judge_start(
    start: &TrajectoryPoint,
    predicted: Pose2,
    velocity: Twist2,
    drive: &Drive,
    settings: &AcceptanceSettings,
) -> Result<(), Rejection> {
    let distance = predicted.distance(&start.pose());
    let yaw = wrap_angle(start.yaw - predicted.yaw).abs();
    let speed = drive.surface_speed(Twist2::new(start.v - velocity.v, start.w - velocity.w));
    if distance > settings.start_distance || yaw > settings.start_yaw || speed > settings.start_speed {
        Err(Rejection::Start { distance, yaw, speed })
    } else {
        Ok(())
    }
}

/// Checks that a trajectory is free of the obstacle points of the latest scan (map frame), for a robot that scanned from `map_from_base`. A
/// point inside the outline at that pose is in contact, seen with a noisy range: only motion deeper into it is rejected.
///
/// # Errors
/// [`Rejection::Blocked`].
pub fn judge_free(
    trajectory: &Trajectory,
    model: &RobotModel,
    map_from_base: Pose2,
    obstacles: &[Point2<f64>],
    settings: &AcceptanceSettings,
) -> Result<(), Rejection> {
    let footprint = &model.footprint;
    let reach = footprint.circumscribed_radius();
    let mut last: Option<Pose2> = None;
    // Only obstacles near the checked part.
    let horizon = settings.scan_horizon + reach;
    let base_from_map = map_from_base.inverse();
    let near: Vec<_> = obstacles
        .iter()
        .filter(|point| (*point - map_from_base.position()).norm() < horizon)
        .map(|point| (*point, footprint.depth(base_from_map.transform_point(*point))))
        .collect();
    let points = trajectory.spaced(f64::NEG_INFINITY, CHECK_SPACING.0, CHECK_SPACING.1);
    for point in points.take(MOST_POINTS) {
        let pose = point.pose();
        let spaced = |last: Pose2| {
            last.distance(&pose) >= CHECK_SPACING.0 || wrap_angle(pose.yaw - last.yaw).abs() >= CHECK_SPACING.1
        };
        let distance = pose.distance(&map_from_base);
        if distance > settings.scan_horizon || !last.is_none_or(spaced) {
            continue;
        }
        last = Some(pose);
        let slack = settings.scan_tolerance + settings.scan_tolerance_per_metre * distance;
        let base_from_map = pose.inverse();
        let hit = near.iter().find(|(obstacle, before)| {
            (obstacle - pose.position()).norm_squared() < reach * reach
                && footprint.depth(base_from_map.transform_point(*obstacle)) > slack.max(before + TOUCHING)
        });
        if let Some((hit, _)) = hit {
            return Err(Rejection::Blocked {
                x: hit.x,
                y: hit.y,
                time: point.t,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Twist2;
    use zenav_protocol::trajectory::TrajectoryPoint;

    use super::*;

    #[test]
    fn a_trajectory_that_leads_out_of_all_reach_is_refused() {
        let drive = zenav_fixtures::robot("tiago").drive;
        let judge = |x: f64| {
            // Slowly enough for any robot.
            let at = |t: f64, x: f64| TrajectoryPoint::new(t, Pose2::new(x, 0.0, 0.0), Twist2::ZERO);
            let trajectory = vec![at(0.0, 0.0), at(10.0 * x, x)].into();
            let plan = Plan {
                trajectory,
                ..Plan::default()
            };
            judge_course(&plan, &drive)
        };
        assert_eq!(judge(5e4), Ok(()));
        for x in [2e5, 1e9] {
            assert!(matches!(judge(x), Err(Rejection::Malformed(_))), "{x}");
        }
    }

    #[test]
    fn what_touches_the_robot_bars_only_a_motion_farther_into_it() {
        let jackal = zenav_fixtures::robot("jackal");
        let driven = |end: Pose2| -> Trajectory {
            let poses = [(0.0, Pose2::IDENTITY), (1.0, end)];
            poses
                .map(|(t, pose)| TrajectoryPoint::new(t, pose, Twist2::ZERO))
                .to_vec()
                .into()
        };
        let judge = |end, obstacle| {
            let settings = AcceptanceSettings::default();
            judge_free(&driven(end), &jackal, Pose2::IDENTITY, &[obstacle], &settings)
        };
        // A noisy range puts it inside the outline, whose half width is 0.215 m.
        let beside = Point2::new(0.0, 0.175);
        assert_eq!(judge(Pose2::new(-0.4, 0.0, 0.0), beside), Ok(()), "past it");
        for (end, obstacle) in [
            (Pose2::new(-0.1, 0.1, 0.0), beside),
            (Pose2::new(-0.4, 0.0, 0.0), Point2::new(-0.4, 0.0)),
        ] {
            assert!(
                matches!(judge(end, obstacle), Err(Rejection::Blocked { .. })),
                "{end:?}"
            );
        }
    }
}
