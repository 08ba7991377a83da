//! Smoother. Turns a path into a trajectory: shortcut, corridor, curve, time law, check; and a safe fallback if one of them fails.
//!
//! Smoothing never fails a plan: if it does not succeed, the unsmoothed path is sent with a safe time law and a reason ([`Fallback`]). It
//! reads no clock: a clock for the statistics and a flag that ends it early come from the caller.

use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{DrivingProfile, PlanStatistics};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::trajectory::Trajectory;
use zenav_space::ConfigurationSpace;

use super::certificate::certify;
use super::corridor::FreePolygon;
use super::outcome::{Fallback, Outcome};
use super::phases::Phases;
use super::settings::SmoothingSettings;
use super::shortcut::{is_clear, shortcut};
use super::timing::economy::economical;
use super::timing::stop_turn_go::corners_from;
use super::timing::{Limits, PiecewiseTrajectory, UNRESTRICTED};
use super::trajectory_builder::{Checked, TrajectoryBuilder};

/// A leg this close to the robot's heading needs no turn, rad.
const STRAIGHT: f64 = 0.02;
/// Places closer together than this are the same, m.
const ROUNDING: f64 = 1e-6;
/// Time between two points of a trajectory that is sent, s.
pub const SAMPLE_PERIOD: f64 = 0.05;

/// Input of smoothing.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::geometry::Pose2;
/// use zenav_smoothing::{Fallback, Outcome, SmoothQuery, SmoothingSettings, smooth};
/// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
/// # use zenav_protocol::robot::{RobotModel, shipped};
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 100 };
/// # let mut grid = Grid::filled(spec, Occupancy::FREE);
/// # (0..100).for_each(|y| grid[Cell::new(50, y)] = Occupancy::OCCUPIED);
/// # let model = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
/// # let space = ConfigurationSpace::new(&grid, &model.footprint, UnknownPolicy::Blocked, 0.0);
/// let path = [Point2::new(4.0, 1.0)];
/// let query = SmoothQuery { goal_yaw: Some(1.0), ..SmoothQuery::new(&path, Pose2::new(1.0, 1.0, 0.0)) };
/// // A wall stands across the path: nothing is driven.
/// let smoothed = smooth(&space, &query, &model, &SmoothingSettings::default(), None, &mut || 0.0);
/// assert_eq!(smoothed.outcome, Outcome::Unsmoothed(Fallback::PathBlocked));
/// assert!(smoothed.trajectory.is_empty());
/// ```
#[derive(Clone, Copy, Debug)]
pub struct SmoothQuery<'a> {
    /// Corner points, map frame, m; the start included or not.
    pub path: &'a [Point2<f64>],
    /// Pose at the start, map frame.
    pub start: Pose2,
    /// Velocity at the start.
    pub start_velocity: Twist2,
    /// Heading wanted at the end, rad; `None`: the path's own.
    pub goal_yaw: Option<f64>,
    /// Objective of the trajectory.
    pub profile: DrivingProfile,
}

impl<'a> SmoothQuery<'a> {
    /// The fastest trajectory from rest, with the path's own heading at the end.
    #[must_use]
    pub const fn new(path: &'a [Point2<f64>], start: Pose2) -> Self {
        Self {
            path,
            start,
            start_velocity: Twist2::ZERO,
            goal_yaw: None,
            profile: DrivingProfile::Fastest,
        }
    }
}

/// A trajectory, its outcome and its statistics.
#[derive(Clone, Debug, Default)]
pub struct Smoothed {
    /// Result of smoothing.
    pub outcome: Outcome,
    /// In closed form; empty if there is nothing to drive, and if the path itself is blocked.
    pub trajectory: PiecewiseTrajectory,
    /// The free polygons that contain the curve, in order; none along straight lines.
    pub corridor: Vec<FreePolygon>,
    /// The outcome as `status`, the solver's status, times of the phases, length, duration, least clearance and certificate; the caller
    /// fills in planner and search.
    pub statistics: PlanStatistics,
}

impl Smoothed {
    /// Points at most `period` seconds apart, as they are sent to the robot.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::{Pose2, Twist2};
    /// # use zenav_protocol::robot::{RobotModel, shipped};
    /// # use zenav_smoothing::unsmoothed;
    /// # let model = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
    /// # let smoothed = unsmoothed(&[Point2::new(2.0, 0.0)], Pose2::IDENTITY, Twist2::ZERO, None, &model);
    /// let points = smoothed.sampled(0.1);
    /// assert!(points.windows(2).all(|pair| pair[1].t - pair[0].t < 0.1 + 1e-9));
    /// assert_eq!((points[0].t, points.last().unwrap().v), (0.0, 0.0));
    /// ```
    #[must_use]
    pub fn sampled(&self, period: f64) -> Trajectory {
        self.trajectory.sampled(period)
    }

    /// Whether the trajectory follows the smooth curve rather than the unsmoothed path.
    #[must_use]
    pub fn is_smooth(&self) -> bool {
        self.outcome == Outcome::Smoothed
    }
}

/// The trajectory along a path, from the start's pose and velocity to rest at the path's end.
///
/// `model` has the footprint that `space` was built for. `clock` (s) is only used for the times of the phases; once `cancel` is set, the
/// safe trajectory is returned soon. Deterministic except for these two.
///
/// Cost: mostly that of the quadratic programme; `cargo bench -p zenav-smoothing` measures it.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::geometry::Pose2;
/// use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
/// use zenav_protocol::robot::{RobotModel, shipped};
/// use zenav_smoothing::{SAMPLE_PERIOD, SmoothQuery, SmoothingSettings, smooth};
/// use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 100 };
/// let grid = Grid::filled(spec, Occupancy::FREE);
/// let model = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
/// let space = ConfigurationSpace::new(&grid, &model.footprint, UnknownPolicy::Blocked, 0.0);
/// let path = [Point2::new(3.0, 1.0), Point2::new(3.0, 4.0)];
/// let query = SmoothQuery::new(&path, Pose2::new(1.0, 1.0, 0.0));
/// let smoothed = smooth(&space, &query, &model, &SmoothingSettings::default(), None, &mut || 0.0);
/// assert!(smoothed.is_smooth());
/// let trajectory = smoothed.sampled(SAMPLE_PERIOD);
/// let end = trajectory.last().unwrap();
/// assert!(end.v == 0.0 && (end.position() - Point2::new(3.0, 4.0)).norm() < 1e-6);
/// assert!(trajectory.length() < 5.0, "the corner is cut");
/// ```
pub fn smooth(
    space: &ConfigurationSpace,
    query: &SmoothQuery<'_>,
    model: &RobotModel,
    settings: &SmoothingSettings,
    cancel: Option<&AtomicBool>,
    clock: &mut dyn FnMut() -> f64,
) -> Smoothed {
    let limits = Limits::of(model);
    let mut phases = Phases::new(clock, cancel);
    let (checked, outcome) = match smoothed_or_safe(space, query, &limits, settings, &mut phases) {
        Ok(curve) => (Some(curve), Outcome::Smoothed),
        Err((reason, safe)) => (safe.map(|safe| *safe), Outcome::Unsmoothed(reason)),
    };
    let Checked {
        trajectory,
        mut evidence,
        least,
    } = checked.unwrap_or_default();
    let corridor = std::mem::take(&mut evidence.polygons);
    let (trajectory, limits) = match query.profile {
        DrivingProfile::Economy if !phases.is_over() => {
            phases.measure(|p| &mut p.timing, || economical(trajectory, model, &limits))
        }
        DrivingProfile::Economy | DrivingProfile::Fastest => (trajectory, limits),
    };
    let (trajectory, jerk) = phases.measure(|p| &mut p.timing, || trajectory.with_limited_jerk(&limits));
    let solver = evidence.status();
    let certificate = phases.measure(|p| &mut p.timing, || certify(&trajectory, &model.drive, evidence, jerk));
    let statistics = PlanStatistics {
        corridor_ms: phases.corridor * 1e3,
        geometry_ms: phases.geometry * 1e3,
        timing_ms: phases.timing * 1e3,
        length: trajectory.length(),
        duration: trajectory.duration(),
        energy_j: trajectory.energy(model),
        min_clearance: least,
        status: outcome.to_string(),
        solver,
        certificate,
        ..PlanStatistics::default()
    };
    Smoothed {
        outcome,
        trajectory,
        corridor,
        statistics,
    }
}

/// Why there is no curve, and the safe alternative.
type Failed = (Fallback, Option<Box<Checked>>);

fn smoothed_or_safe(
    space: &ConfigurationSpace,
    query: &SmoothQuery<'_>,
    limits: &Limits,
    settings: &SmoothingSettings,
    phases: &mut Phases<'_>,
) -> Result<Checked, Failed> {
    if !query.start.is_finite() || !query.start_velocity.is_finite() {
        return Err((Fallback::StartNotFinite, None));
    }
    let path = corners_from(query.start.position(), query.path);
    let Some(exempt) = exempt(space, query.start, &path) else {
        return Err((Fallback::PathBlocked, None));
    };
    let zones = space.zones();
    let in_zones = |point: Point2<f64>| zones.speed_limit(point);
    let builder = TrajectoryBuilder {
        space,
        query,
        limits,
        settings,
        exempt,
        speed_limit: if zones.has_speed_limits() {
            &in_zones
        } else {
            UNRESTRICTED
        },
    };
    // A path that returns to an earlier place is cut there.
    let cancel = phases.cancel();
    let short = phases.measure(
        |p| &mut p.corridor,
        || {
            let short = shortcut(space, &path, settings.corridor.clearance, builder.heading(), cancel);
            corners_from(query.start.position(), &short)
        },
    );
    let safe = |phases: &mut Phases<'_>| {
        phases.measure(
            |p| &mut p.timing,
            || builder.stop_turn_go(&short).or_else(|| builder.stop_turn_go(&path)),
        )
    };
    if short.len() < 2 {
        // Nothing to drive: only braking and turning remain.
        return safe(phases).ok_or((Fallback::Collision, None));
    }
    let unsmoothed = phases.measure(|p| &mut p.timing, || builder.unchecked_stop_turn_go(&short).duration());
    match builder.smooth(&short, unsmoothed, phases) {
        Ok(curve) if curve.trajectory.duration() <= unsmoothed => Ok(curve),
        Ok(curve) => match safe(phases) {
            Some(safe) if safe.trajectory.duration() < curve.trajectory.duration() => {
                Err((Fallback::Slower, Some(Box::new(safe))))
            }
            _ => Ok(curve),
        },
        Err(reason) => Err((reason, safe(phases).map(Box::new))),
    }
}

/// How far a robot with part of its outline in an obstacle drives straight ahead until it is free, m; zero if it is free already, if it
/// would turn first, and if it does not get free on the first leg.
fn straight_out(space: &ConfigurationSpace, start: Pose2, path: &[Point2<f64>]) -> f64 {
    let [from, to, ..] = path else { return 0.0 };
    let (leg, heading) = (to - from, start.heading());
    if space.footprint_clearance(start) > 0.0 || leg.dot(&heading) < STRAIGHT.cos() * leg.norm() {
        return 0.0;
    }
    let step = 0.5 * space.spec().resolution;
    let mut along = (1..=(leg.norm() / step) as u32).map(|nth| f64::from(nth) * step);
    let stands_free = |off: f64| {
        let place = start.position() + heading * off;
        space.footprint_clearance(Pose2::new(place.x, place.y, start.yaw)) > 0.0
    };
    // A turn at that place is still checked.
    along.find(|off| stands_free(*off)).map_or(0.0, |off| off - ROUNDING)
}

/// Metres around the start that are not checked, because the robot has to leave an obstacle of the map; `None` if the path itself is
/// blocked.
fn exempt(space: &ConfigurationSpace, start: Pose2, path: &[Point2<f64>]) -> Option<f64> {
    let radius = space.radius();
    let mut exempt = straight_out(space, start, path);
    for (i, leg) in path.windows(2).enumerate() {
        if is_clear(space, leg[0], leg[1], radius) {
            continue;
        }
        let leaves = i == 0 && (space.clearance(leg[0]) <= radius || !space.is_permitted(leg[0]));
        let left = leaves.then(|| left_after(space, [leg[0], leg[1]], radius)).flatten()?;
        exempt = exempt.max(left - ROUNDING);
    }
    Some(exempt)
}

/// How far along a leg a robot gets clear of an obstacle that it stands in or too close to, m; `None` if it gets closer first, and if the
/// rest of the leg is not clear.
fn left_after(space: &ConfigurationSpace, [from, to]: [Point2<f64>; 2], radius: f64) -> Option<f64> {
    let (leg, step) = (to - from, 0.5 * space.spec().resolution);
    let (length, yaw) = (leg.norm(), leg.y.atan2(leg.x));
    let place = |off: f64| from + leg * (off / length.max(ROUNDING));
    // It may drive backwards.
    let stands_free = |at: Point2<f64>| {
        let looks = |yaw: f64| space.footprint_clearance(Pose2::new(at.x, at.y, yaw)) > 0.0;
        space.clearance(at) > radius && space.is_permitted(at) && (looks(yaw) || looks(yaw + PI))
    };
    let mut along = (1..=(length / step) as u32)
        .map(|nth| f64::from(nth) * step)
        .chain([length]);
    let left = along.find(|off| stands_free(place(*off)))?;
    let kept = space.clearance(from).min(radius) - ROUNDING;
    let leaves = space.segment_clearance(from, place(left)) >= kept && is_clear(space, place(left), to, radius);
    leaves.then_some(left)
}
