//! Which trajectory does a way become? Shortcut, corridor, curve, time law, check; and what is always safe where that fails.
//!
//! A smoother never fails a plan: the unsmoothed way goes out with a safe time law, and says why (`fallback:REASON`). It knows no clock:
//! times come from the one it is given, and nothing but the statistics depends on them.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{DrivingProfile, PlanStatistics};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::trajectory::Trajectory;

use super::certificate::certify;
use super::corridor::FreePolygonSize;
use super::shortcut::{is_clear, shortcut};
use super::timing::economy::economical;
use super::timing::legs::corners_from;
use super::timing::{Limits, Motion, UNRESTRICTED};
use super::trajectory_builder::{Checked, TrajectoryBuilder};
use zenav_space::ConfigurationSpace;

/// Time between two points of a trajectory that goes out, s.
pub const PERIOD: f64 = 0.05;

/// What is asked of a smoother.
#[derive(Clone, Copy, Debug)]
pub struct SmoothQuery<'a> {
    /// The way: corner points, map frame, the start included or not.
    pub way: &'a [Point2<f64>],
    /// Pose at the start.
    pub start: Pose2,
    /// Velocity at the start.
    pub start_velocity: Twist2,
    /// Heading wanted at the end.
    pub goal_yaw: Option<f64>,
}

/// How a smoother works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothSettings {
    /// Size of the corridor's rooms.
    pub rooms: FreePolygonSize,
    /// Length over which the robot likes to turn, m.
    pub turning_length: f64,
    /// Distance between samples of the curve, m.
    pub step: f64,
    /// The solver's iterations, at most.
    pub max_iterations: u32,
    /// What the time law is to be good at.
    pub profile: DrivingProfile,
}

impl Default for SmoothSettings {
    fn default() -> Self {
        Self {
            rooms: FreePolygonSize {
                length: 1.5,
                reach: 1.0,
                comfort: 0.3,
            },
            turning_length: 0.25,
            step: 0.02,
            max_iterations: 60,
            profile: DrivingProfile::default(),
        }
    }
}

/// A trajectory and how it came about.
#[derive(Clone, Debug, Default)]
pub struct Smoothed {
    /// The motion; empty when there is nothing to drive, and when the way itself is blocked.
    pub motion: Motion,
    /// `status`, `solver`, times of the phases, length, duration, least clearance; planner and search are the caller's.
    pub statistics: PlanStatistics,
}

impl Smoothed {
    /// Points at most `period` seconds apart.
    #[must_use]
    pub fn trajectory(&self, period: f64) -> Trajectory {
        self.motion.trajectory(period)
    }

    /// Whether the curve came out, rather than the unsmoothed way.
    #[must_use]
    pub fn is_smooth(&self) -> bool {
        self.statistics.status == SMOOTHED
    }
}

/// Status of a trajectory along a curve.
pub const SMOOTHED: &str = "smoothed";

/// The trajectory along a way. Deterministic but for the times that `clock` (s) tells.
///
/// `model` has the footprint that `space` was made for.
pub fn smooth(
    space: &ConfigurationSpace,
    query: &SmoothQuery<'_>,
    model: &RobotModel,
    settings: &SmoothSettings,
    clock: &mut dyn FnMut() -> f64,
) -> Smoothed {
    let limits = Limits::of(model);
    let mut times = Times::new(clock);
    let mut result = Smoothed::default();
    let (checked, status) = match smoothed_or_safe(space, query, &limits, settings, &mut times) {
        Ok(curve) => (Some(curve), SMOOTHED.to_owned()),
        Err((reason, safe)) => (safe.map(|safe| *safe), format!("fallback:{reason}")),
    };
    let Checked {
        motion,
        evidence,
        least,
    } = checked.unwrap_or_default();
    let (motion, limits) = match settings.profile {
        DrivingProfile::Fastest => (motion, limits),
        DrivingProfile::Economy => times.measure(|t| &mut t.timing, || economical(motion, model, &limits)),
    };
    let (motion, jerk) = times.measure(|t| &mut t.timing, || motion.with_limited_jerk(&limits));
    let solver = evidence.status();
    let certificate = times.measure(|t| &mut t.timing, || certify(&motion, &model.drive, evidence, jerk));
    let statistics = &mut result.statistics;
    (statistics.corridor_ms, statistics.geometry_ms, statistics.timing_ms) =
        (times.corridor * 1e3, times.geometry * 1e3, times.timing * 1e3);
    (statistics.length, statistics.duration) = (motion.length(), motion.duration());
    (statistics.status, statistics.solver, statistics.min_clearance) = (status, solver, least);
    statistics.certificate = certificate;
    statistics.energy_j = motion.energy(model);
    result.motion = motion;
    result
}

/// Times of the phases, s.
pub(super) struct Times<'a> {
    clock: &'a mut dyn FnMut() -> f64,
    pub(super) corridor: f64,
    pub(super) geometry: f64,
    pub(super) timing: f64,
}

impl<'a> Times<'a> {
    pub(super) fn new(clock: &'a mut dyn FnMut() -> f64) -> Self {
        Self {
            clock,
            corridor: 0.0,
            geometry: 0.0,
            timing: 0.0,
        }
    }

    pub(super) fn measure<T>(&mut self, phase: fn(&mut Self) -> &mut f64, work: impl FnOnce() -> T) -> T {
        let begin = (self.clock)();
        let result = work();
        let end = (self.clock)();
        *phase(self) += end - begin;
        result
    }
}

/// Why there is no curve, and what is safe instead.
type Failed = (String, Option<Box<Checked>>);

fn smoothed_or_safe(
    space: &ConfigurationSpace,
    query: &SmoothQuery<'_>,
    limits: &Limits,
    settings: &SmoothSettings,
    times: &mut Times<'_>,
) -> Result<Checked, Failed> {
    if !query.start.is_finite() || !query.start_velocity.is_finite() {
        return Err(("start_not_finite".to_owned(), None));
    }
    let way = corners_from(query.start.position(), query.way);
    let Some(exempt) = exempt(space, &way) else {
        return Err(("way_blocked".to_owned(), None));
    };
    let zones = space.zones();
    let in_zones = |point: Point2<f64>| zones.speed_limit(point);
    let course = TrajectoryBuilder {
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
    // A way that comes back to where it was is cut there.
    let short = times.measure(
        |t| &mut t.corridor,
        || {
            let short = shortcut(space, &way, settings.rooms.comfort, course.heading());
            corners_from(query.start.position(), &short)
        },
    );
    let safe = |times: &mut Times<'_>| {
        times.measure(
            |t| &mut t.timing,
            || course.stop_turn_go(&short).or_else(|| course.stop_turn_go(&way)),
        )
    };
    if short.len() < 2 {
        // Nothing to drive: braking and turning is all there is.
        return safe(times).ok_or(("collision".to_owned(), None));
    }
    let legs = times.measure(|t| &mut t.timing, || course.legs(&short).duration());
    match course.smooth(&short, legs, times) {
        Ok(curve) if curve.motion.duration() <= legs => Ok(curve),
        Ok(curve) => match safe(times) {
            Some(safe) if safe.motion.duration() < curve.motion.duration() => {
                Err(("slower".to_owned(), Some(Box::new(safe))))
            }
            _ => Ok(curve),
        },
        Err(reason) => Err((reason, safe(times).map(Box::new))),
    }
}

/// Metres around the start that the robot has to leave whatever the map says there; `None` where the way itself is blocked.
fn exempt(space: &ConfigurationSpace, way: &[Point2<f64>]) -> Option<f64> {
    let radius = space.radius();
    let mut exempt = 0.0;
    for (i, leg) in way.windows(2).enumerate() {
        if is_clear(space, leg[0], leg[1], radius) {
            continue;
        }
        let leaves = i == 0 && (space.clearance(leg[0]) <= radius || !space.is_permitted(leg[0]));
        if !leaves || space.segment_clearance(leg[0], leg[1]) < space.clearance(leg[0]).min(radius) - 1e-6 {
            return None;
        }
        exempt = (leg[1] - leg[0]).norm();
    }
    Some(exempt)
}
