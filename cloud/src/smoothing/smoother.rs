//! Which trajectory does a way become? Shortcut, corridor, curve, time law, check; and what is always safe where that fails.
//!
//! A smoother never fails a plan: the unsmoothed way goes out with a safe time law, and says why (`fallback:REASON`). It knows no clock:
//! times come from the one it is given, and nothing but the statistics depends on them.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::{PlanStatistics, SolverFigures, TrajectoryPoint};
use zenav_protocol::robot::RobotModel;

use super::certificate::{Collision, Evidence, certify, clearance};
use super::corridor::{RoomSize, corridor};
use super::curve::{CurveError, EndTangent, Ends, fit};
use super::shortcut::{is_clear, shortcut};
use super::timing::legs::{corners_from, rejoined, safe_motion};
use super::timing::sweep::SweepError;
use super::timing::{GeometricPath, Limits, Motion, SpeedLimit, UNRESTRICTED};
use crate::space::ConfigurationSpace;

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
    pub rooms: RoomSize,
    /// Length over which the robot likes to turn, m.
    pub turning_length: f64,
    /// Distance between samples of the curve, m.
    pub step: f64,
    /// The solver's iterations, at most.
    pub max_iterations: u32,
}

impl Default for SmoothSettings {
    fn default() -> Self {
        Self {
            rooms: RoomSize {
                length: 1.5,
                reach: 1.0,
                comfort: 0.3,
            },
            turning_length: 0.25,
            step: 0.02,
            max_iterations: 60,
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
    pub fn trajectory(&self, period: f64) -> Vec<TrajectoryPoint> {
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

/// Slower than this a robot is at rest, m/s and rad/s at the wheels.
const AT_REST: f64 = 0.02;
/// A robot at rest whose heading differs by less from the way begins without turning on the spot, rad.
const ALIGNED: f64 = 0.3;
/// A moving robot goes on along its arc when the way lies ahead to within this, rad; else it stops first.
const AHEAD: f64 = 1.2;
/// Sharpest arc that is gone on with, 1/m.
const SHARPEST_ARC: f64 = 3.0;
/// Sharper corners are turned on the spot, rad.
const SHARP: f64 = 2.0;
/// A wanted heading at the end this close to the way's is arrived with, rad; else it is turned to on the spot.
const ARRIVING: f64 = 0.8;

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
    let mut times = Times {
        clock,
        corridor: 0.0,
        geometry: 0.0,
        timing: 0.0,
    };
    let mut result = Smoothed::default();
    let (motion, evidence, status, least) = match smoothed_or_safe(space, query, &limits, settings, &mut times) {
        Ok(curve) => (curve.motion, curve.evidence, SMOOTHED.to_owned(), curve.least),
        Err((reason, Some((motion, least)))) => (motion, Evidence::default(), format!("fallback:{reason}"), least),
        Err((reason, None)) => (Motion::new(), Evidence::default(), format!("fallback:{reason}"), None),
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
    result.motion = motion;
    result
}

/// Times of the phases, s.
struct Times<'a> {
    clock: &'a mut dyn FnMut() -> f64,
    corridor: f64,
    geometry: f64,
    timing: f64,
}

impl Times<'_> {
    fn measure<T>(&mut self, phase: fn(&mut Self) -> &mut f64, work: impl FnOnce() -> T) -> T {
        let begin = (self.clock)();
        let result = work();
        let end = (self.clock)();
        *phase(self) += end - begin;
        result
    }
}

/// A motion that was checked, and how it came about.
struct Checked {
    motion: Motion,
    evidence: Evidence,
    least: Option<f64>,
}

/// Why there is no curve, and what is safe instead.
type Failed = (String, Option<(Motion, Option<f64>)>);

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
    let comfort = settings
        .rooms
        .comfort
        .max(space.footprint().circumscribed_radius() - space.radius());
    let settings = SmoothSettings {
        rooms: RoomSize {
            comfort,
            ..settings.rooms
        },
        ..*settings
    };
    // A way that comes back to where it was is cut there.
    let short = times.measure(
        |t| &mut t.corridor,
        || corners_from(query.start.position(), &shortcut(space, &way, comfort)),
    );
    let zones = space.zones();
    let in_zones = |point: Point2<f64>| zones.speed_limit(point);
    let job = Job {
        space,
        query,
        limits,
        settings: &settings,
        exempt,
        speed_limit: if zones.has_speed_limits() {
            &in_zones
        } else {
            UNRESTRICTED
        },
    };
    let safe = |times: &mut Times<'_>| times.measure(|t| &mut t.timing, || job.safe(&short).or_else(|| job.safe(&way)));
    if short.len() < 2 {
        // Nothing to drive: braking and turning is all there is.
        return match safe(times) {
            Some((motion, least)) => Ok(Checked {
                motion,
                evidence: Evidence::default(),
                least,
            }),
            None => Err(("collision".to_owned(), None)),
        };
    }
    let legs = times.measure(|t| &mut t.timing, || job.legs(&short).duration());
    match job.curve(&short, legs, times) {
        Ok(curve) if curve.motion.duration() <= legs => Ok(curve),
        Ok(curve) => match safe(times) {
            Some(safe) if safe.0.duration() < curve.motion.duration() => Err(("slower".to_owned(), Some(safe))),
            _ => Ok(curve),
        },
        Err(reason) => Err((reason, safe(times))),
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

/// How a trajectory begins.
enum Beginning {
    /// On along the arc that the robot is on.
    Moving,
    /// From rest, along the heading.
    Aligned,
    /// From rest, after a turn on the spot; a moving robot brakes first.
    Turned,
}

/// A motion in the making: where it has come to, and how it came about.
struct Drive {
    motion: Motion,
    at: Pose2,
    evidence: Evidence,
}

impl Drive {
    /// Turns into a path's direction, where it is not in it, and follows the path.
    fn follow(&mut self, path: GeometricPath, speed: f64, limits: &Limits) -> Result<(), String> {
        let (first, last) = (path.points()[0], path.points()[path.points().len() - 1]);
        if speed == 0.0 {
            self.motion.spin(self.at, wrap_angle(first.yaw - self.at.yaw), limits);
        }
        self.motion
            .follow(path, speed, limits)
            .map_err(|_: SweepError| "too_fast".to_owned())?;
        self.at = Pose2::new(last.x, last.y, last.yaw);
        Ok(())
    }
}

/// Whether a corner is so sharp that a robot is better off stopping there, and turning.
fn is_sharp(before: Point2<f64>, corner: Point2<f64>, after: Point2<f64>) -> bool {
    (corner - before).angle(&(after - corner)) > SHARP
}

struct Job<'a> {
    space: &'a ConfigurationSpace,
    query: &'a SmoothQuery<'a>,
    limits: &'a Limits,
    settings: &'a SmoothSettings,
    exempt: f64,
    speed_limit: SpeedLimit<'a>,
}

impl Job<'_> {
    /// Stop, turn, go.
    fn legs(&self, way: &[Point2<f64>]) -> Motion {
        let SmoothQuery {
            start,
            start_velocity,
            goal_yaw,
            ..
        } = *self.query;
        safe_motion(way, start, start_velocity, goal_yaw, self.limits, self.speed_limit)
    }

    /// Stop, turn, go: checked.
    fn safe(&self, way: &[Point2<f64>]) -> Option<(Motion, Option<f64>)> {
        let motion = self.legs(way);
        let least = clearance(self.space, &motion, self.limits, self.exempt).ok()?;
        Some((motion, least))
    }

    /// The first beginning and end that give a free curve in less than `enough` seconds, else the fastest one; the last reason when none does.
    fn curve(&self, way: &[Point2<f64>], enough: f64, times: &mut Times<'_>) -> Result<Checked, String> {
        let mut best: Result<Checked, String> = Err(String::new());
        for beginning in self.beginnings(way) {
            for arrives in [true, false] {
                if arrives && !self.can_arrive(way) {
                    continue;
                }
                match (self.attempt(way, &beginning, arrives, times), &best) {
                    (Ok(found), Ok(known)) if found.motion.duration() >= known.motion.duration() => {}
                    (Ok(found), _) => best = Ok(found),
                    (Err(_), Ok(_)) => {}
                    (Err(reason), Err(_)) => best = Err(reason),
                }
                if best.as_ref().is_ok_and(|found| found.motion.duration() <= enough) {
                    return best;
                }
            }
        }
        best
    }

    fn beginnings(&self, way: &[Point2<f64>]) -> Vec<Beginning> {
        let SmoothQuery {
            start,
            start_velocity: Twist2 { v, w },
            ..
        } = *self.query;
        let leg = way[1] - way[0];
        let turn = wrap_angle(leg.y.atan2(leg.x) - start.yaw).abs();
        let wheels = v.abs() + w.abs() * self.limits.half_separation;
        let mut beginnings = Vec::new();
        if self.exempt > 0.0 {
            // A place that has to be left is left straight.
        } else if wheels > AT_REST {
            if v > AT_REST && turn < AHEAD && w.abs() <= SHARPEST_ARC * v {
                beginnings.push(Beginning::Moving);
            }
        } else if turn < ALIGNED {
            beginnings.push(Beginning::Aligned);
        }
        beginnings.push(Beginning::Turned);
        beginnings
    }

    /// Whether the wanted heading is near enough to the way's last leg to be arrived with.
    fn can_arrive(&self, way: &[Point2<f64>]) -> bool {
        let [.., before, last] = way else { return false };
        let leg = last - before;
        self.query
            .goal_yaw
            .is_some_and(|yaw| wrap_angle(yaw - leg.y.atan2(leg.x)).abs() < ARRIVING)
    }

    fn attempt(
        &self,
        way: &[Point2<f64>],
        beginning: &Beginning,
        arrives: bool,
        times: &mut Times<'_>,
    ) -> Result<Checked, String> {
        let SmoothQuery {
            start,
            start_velocity,
            goal_yaw,
            ..
        } = *self.query;
        let goal_yaw = goal_yaw.filter(|yaw| yaw.is_finite());
        let mut drive = Drive {
            motion: Motion::new(),
            at: start,
            evidence: Evidence::default(),
        };
        let (way, mut enter) = match beginning {
            Beginning::Moving => {
                let tangent = EndTangent {
                    direction: start.heading(),
                    curvature: Some(start_velocity.w / start_velocity.v),
                };
                (self.led_in(way, start_velocity.v), Some((tangent, start_velocity.v)))
            }
            Beginning::Aligned => (
                way.to_vec(),
                Some((
                    EndTangent {
                        direction: start.heading(),
                        curvature: None,
                    },
                    0.0,
                )),
            ),
            Beginning::Turned => {
                drive.at = drive.motion.brake(start, start_velocity, self.limits);
                (
                    if drive.motion.is_empty() {
                        way.to_vec()
                    } else {
                        self.joined(drive.at.position(), way)
                    },
                    None,
                )
            }
        };
        let mut rest = &way[..];
        if self.exempt > 0.0
            && let [from, to, ..] = way[..]
        {
            self.straight(from, to, &mut drive, times)?;
            rest = &way[1..];
        }
        while rest.len() > 1 {
            let end = (1..rest.len() - 1)
                .find(|i| is_sharp(rest[i - 1], rest[*i], rest[i + 1]))
                .unwrap_or(rest.len() - 1);
            let leave = goal_yaw.filter(|_| arrives && end + 1 == rest.len());
            let leave = leave.map(|yaw| EndTangent {
                direction: Pose2::new(0.0, 0.0, yaw).heading(),
                curvature: None,
            });
            self.curved(&rest[..=end], enter.take(), leave, &mut drive, times)?;
            rest = &rest[end..];
        }
        if let Some(yaw) = goal_yaw {
            drive.motion.spin(drive.at, wrap_angle(yaw - drive.at.yaw), self.limits);
        }
        let least = times.measure(
            |t| &mut t.geometry,
            || clearance(self.space, &drive.motion, self.limits, self.exempt),
        );
        let least = least.map_err(|Collision| "collision".to_owned())?;
        Ok(Checked {
            motion: drive.motion,
            evidence: drive.evidence,
            least,
        })
    }

    /// Turns towards a place and goes there straight.
    fn straight(
        &self,
        from: Point2<f64>,
        to: Point2<f64>,
        drive: &mut Drive,
        times: &mut Times<'_>,
    ) -> Result<(), String> {
        let Some(path) = GeometricPath::straight(from, to, self.settings.step) else {
            return Ok(());
        };
        times.measure(
            |t| &mut t.timing,
            || drive.follow(path.limited(self.speed_limit), 0.0, self.limits),
        )
    }

    /// Goes along a way without stopping. It begins with a tangent and a speed (m/s), or after a turn on the spot.
    fn curved(
        &self,
        way: &[Point2<f64>],
        enter: Option<(EndTangent, f64)>,
        leave: Option<EndTangent>,
        drive: &mut Drive,
        times: &mut Times<'_>,
    ) -> Result<(), String> {
        let rooms = times.measure(|t| &mut t.corridor, || corridor(self.space, way, &self.settings.rooms));
        let ends = Ends {
            start: enter.map(|(tangent, _)| tangent),
            end: leave,
        };
        let path = times.measure(
            |t| &mut t.geometry,
            || {
                let curve = fit(
                    &rooms,
                    &ends,
                    self.settings.turning_length,
                    self.settings.max_iterations,
                )?;
                let path = curve.sampled(self.settings.step)?;
                let solver = SolverFigures {
                    status: curve.solver,
                    iterations: curve.iterations,
                    gap: curve.gap,
                };
                drive.evidence.add(&rooms, solver);
                Ok(path)
            },
        );
        let path = path.map_err(|error: CurveError| error.to_string())?;
        times.measure(
            |t| &mut t.timing,
            || {
                let speed = enter.map_or(0.0, |(_, speed)| speed);
                drive.follow(path.limited(self.speed_limit), speed, self.limits)
            },
        )
    }

    /// The way of a moving robot: a little on along its heading, then to the farthest corner in sight.
    fn led_in(&self, way: &[Point2<f64>], speed: f64) -> Vec<Point2<f64>> {
        let start = self.query.start;
        let mut lead = (0.6 * speed).clamp(0.1, 0.6).min(0.4 * (way[1] - way[0]).norm());
        while lead > 0.05 {
            let ahead = start.position() + start.heading() * lead;
            let first = way[1..].iter().rposition(|corner| self.sees(ahead, *corner));
            if let Some(first) = first.filter(|_| self.sees(start.position(), ahead)) {
                return [&[start.position(), ahead], &way[1 + first..]].concat();
            }
            lead *= 0.5;
        }
        way.to_vec()
    }

    /// The way of a robot that came to rest beside it: to the farthest corner in sight, else back to the nearest point.
    fn joined(&self, at: Point2<f64>, way: &[Point2<f64>]) -> Vec<Point2<f64>> {
        match way[1..].iter().rposition(|corner| self.sees(at, *corner)) {
            Some(corner) => corners_from(at, &way[1 + corner..]),
            None => rejoined(at, way),
        }
    }

    fn sees(&self, from: Point2<f64>, to: Point2<f64>) -> bool {
        is_clear(
            self.space,
            from,
            to,
            self.space.radius() + 0.5 * self.settings.rooms.comfort,
        )
    }
}
