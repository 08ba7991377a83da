//! How is a way driven from beginning to end? Where the robot brakes, stops and turns, and on which curves it goes between.
//!
//! A robot at rest begins along its heading or turns on the spot first; one that moves goes on along its arc or brakes first. In between it
//! stops and turns only at corners too sharp for a curve, and at corners where no curve has room: everything else is one curve.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::SolverFigures;
use zenav_protocol::robot::Footprint;

use super::certificate::{Collision, Evidence, clearance};
use super::fit::{EndTangent, Ends};
use super::segment::{NoSegment, Segment, segment};
use super::shortcut::has_leg;
use super::smoother::{SmoothQuery, SmoothSettings, Times};
use super::timing::legs::{corners_from, rejoined, safe_motion};
use super::timing::sweep::SweepError;
use super::timing::{GeometricPath, Limits, Motion, SpeedLimit};
use zenav_space::ConfigurationSpace;

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
/// Times that stops are added one by one; then a part without a curve is driven as stop, turn and go.
const ADDED: usize = 8;

/// A motion that was checked, and how it came about.
#[derive(Clone, Debug, Default)]
pub(super) struct Checked {
    pub(super) motion: Motion,
    pub(super) evidence: Evidence,
    /// Least clearance, m.
    pub(super) least: Option<f64>,
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

/// A motion in the making, and where it has come to.
#[derive(Clone)]
struct Drive {
    motion: Motion,
    at: Pose2,
}

/// What leads along a way.
pub(super) struct TrajectoryBuilder<'a> {
    pub(super) space: &'a ConfigurationSpace,
    pub(super) query: &'a SmoothQuery<'a>,
    pub(super) limits: &'a Limits,
    pub(super) settings: &'a SmoothSettings,
    /// Metres around the start that are not checked.
    pub(super) exempt: f64,
    pub(super) speed_limit: SpeedLimit<'a>,
}

impl TrajectoryBuilder<'_> {
    /// The heading of a robot at rest.
    pub(super) fn heading(&self) -> Option<f64> {
        (!self.moves()).then_some(self.query.start.yaw)
    }

    fn moves(&self) -> bool {
        let Twist2 { v, w } = self.query.start_velocity;
        v.abs() + w.abs() * self.limits.half_separation > AT_REST
    }

    fn is_long(&self) -> bool {
        matches!(self.space.footprint(), Footprint::Polygon(_))
    }

    /// Stop, turn, go.
    pub(super) fn legs(&self, way: &[Point2<f64>]) -> Motion {
        let SmoothQuery {
            start,
            start_velocity,
            goal_yaw,
            ..
        } = *self.query;
        safe_motion(way, start, start_velocity, goal_yaw, self.limits, self.speed_limit)
    }

    /// Stop, turn, go: checked. A robot that is moving brakes and goes on from where it has come to, or from where it was.
    pub(super) fn stop_turn_go(&self, way: &[Point2<f64>]) -> Option<Checked> {
        self.checked(self.legs(way), Evidence::default()).ok().or_else(|| {
            let drive = self.braked();
            let at = drive.at.position();
            let back: Vec<_> = [at].iter().chain(way).copied().collect();
            let ways = [self.joined(at, way), corners_from(at, &back)];
            let driven = ways.iter().filter(|_| self.moves()).filter_map(|way| {
                let mut drive = drive.clone();
                for leg in way.windows(2) {
                    self.straight(leg[0], leg[1], &mut drive).ok()?;
                }
                self.arrived(drive, Evidence::default()).ok()
            });
            driven.into_iter().next()
        })
    }

    /// The first beginning and end that give a free curve in less than `enough` seconds, else the fastest one; the last reason when none does.
    pub(super) fn smooth(&self, way: &[Point2<f64>], enough: f64, times: &mut Times<'_>) -> Result<Checked, String> {
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
        let mut beginnings = Vec::new();
        if self.exempt > 0.0 {
            // A place that has to be left is left straight.
        } else if self.moves() {
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
        self.goal_yaw()
            .is_some_and(|yaw| wrap_angle(yaw - leg.y.atan2(leg.x)).abs() < ARRIVING)
    }

    fn goal_yaw(&self) -> Option<f64> {
        self.query.goal_yaw.filter(|yaw| yaw.is_finite())
    }

    fn attempt(
        &self,
        way: &[Point2<f64>],
        beginning: &Beginning,
        arrives: bool,
        times: &mut Times<'_>,
    ) -> Result<Checked, String> {
        let SmoothQuery {
            start, start_velocity, ..
        } = *self.query;
        let mut drive = Drive {
            motion: Motion::new(),
            at: start,
        };
        let along = |curvature: Option<f64>| EndTangent {
            direction: start.heading(),
            curvature,
        };
        let (way, enter) = match beginning {
            Beginning::Moving => {
                let tangent = along(Some(start_velocity.w / start_velocity.v));
                (self.led_in(way, start_velocity.v), Some((tangent, start_velocity.v)))
            }
            Beginning::Aligned => (way.to_vec(), Some((along(None), 0.0))),
            Beginning::Turned => {
                drive = self.braked();
                let way = if drive.motion.is_empty() {
                    way.to_vec()
                } else {
                    self.joined(drive.at.position(), way)
                };
                (way, None)
            }
        };
        let mut rest = &way[..];
        if self.exempt > 0.0
            && let [from, to, ..] = way[..]
        {
            times.measure(|t| &mut t.timing, || self.straight(from, to, &mut drive))?;
            rest = &way[1..];
        }
        let leave = self.goal_yaw().filter(|_| arrives).map(|yaw| EndTangent {
            direction: Pose2::new(0.0, 0.0, yaw).heading(),
            curvature: None,
        });
        let ends = Ends {
            start: enter.map(|(tangent, _)| tangent),
            end: leave,
        };
        let parts = self.parts(rest, &ends, times)?;
        let mut evidence = Evidence::default();
        let mut speed = enter.map_or(0.0, |(_, speed)| speed);
        for part in parts {
            if let Some(curve) = part.curve {
                let solver = SolverFigures {
                    status: curve.solver,
                    iterations: curve.iterations,
                    gap: curve.gap,
                };
                evidence.add(&part.rooms, solver);
            }
            times.measure(|t| &mut t.timing, || self.follow(part.path, speed, &mut drive))?;
            speed = 0.0;
        }
        times.measure(|t| &mut t.geometry, || self.arrived(drive, evidence))
    }

    /// Curves along a way, from stop to stop; where there is none, another stop.
    fn parts(&self, way: &[Point2<f64>], ends: &Ends, times: &mut Times<'_>) -> Result<Vec<Segment>, String> {
        let is_sharp = |i: usize| (way[i] - way[i - 1]).angle(&(way[i + 1] - way[i])) > SHARP;
        let mut stops: Vec<bool> = (0..way.len())
            .map(|i| i == 0 || i + 1 >= way.len() || is_sharp(i))
            .collect();
        let mut known: Vec<(usize, usize, Segment)> = Vec::new();
        let mut first_reason = None;
        let mut round = 0;
        loop {
            let (mut parts, mut missing) = (Vec::new(), false);
            let at: Vec<usize> = (0..way.len()).filter(|i| stops[*i]).collect();
            for leg in at.windows(2) {
                let (from, to) = (leg[0], leg[1]);
                let ends = Ends {
                    start: ends
                        .start
                        .filter(|_| from == 0)
                        .or_else(|| self.tight(way, from, from + 1)),
                    end: ends
                        .end
                        .filter(|_| to + 1 == way.len())
                        .or_else(|| (to + 1 < way.len()).then(|| self.tight(way, to - 1, to)).flatten()),
                };
                let found = match known.iter().position(|part| (part.0, part.1) == (from, to)) {
                    Some(index) => Ok(known.swap_remove(index).2),
                    None => segment(self.space, &way[from..=to], &ends, self.settings, times),
                };
                match found {
                    Ok(found) => parts.push((from, to, found)),
                    Err(error) => {
                        let reason = reason(&error);
                        let is_bound = from == 0 && ends.start.is_some() && matches!(error, NoSegment::Curve(_));
                        if to - from < 2 || is_bound {
                            return Err(reason);
                        }
                        first_reason.get_or_insert(reason);
                        missing = true;
                        stop_at(&mut stops[from + 1..to], &way[from..=to], &error, round >= ADDED);
                    }
                }
            }
            if !missing {
                let is_curved = parts.iter().any(|(_, _, part)| part.curve.is_some());
                return match first_reason {
                    // Nothing but stop, turn and go is left.
                    Some(reason) if !is_curved => Err(reason),
                    _ => Ok(parts.into_iter().map(|(_, _, part)| part).collect()),
                };
            }
            known.extend(parts);
            round += 1;
        }
    }

    /// Where a long robot has no room to turn freely, it goes along the way's own leg.
    fn tight(&self, way: &[Point2<f64>], from: usize, to: usize) -> Option<EndTangent> {
        let around = self.space.footprint().circumscribed_radius();
        let is_tight = |i: usize| self.space.clearance(way[i]) <= around + 1e-3;
        let leg = way[to] - way[from];
        (self.is_long() && (is_tight(from) || is_tight(to))).then(|| EndTangent {
            direction: leg.normalize(),
            curvature: None,
        })
    }

    /// The robot at rest, where it comes to rest.
    fn braked(&self) -> Drive {
        let mut motion = Motion::new();
        let at = motion.brake(self.query.start, self.query.start_velocity, self.limits);
        Drive { motion, at }
    }

    /// Turns towards a place and goes there straight.
    fn straight(&self, from: Point2<f64>, to: Point2<f64>, drive: &mut Drive) -> Result<(), String> {
        match GeometricPath::straight(from, to, self.settings.step) {
            Some(path) => self.follow(path, 0.0, drive),
            None => Ok(()),
        }
    }

    /// Turns into a path's direction, where the robot is at rest and not in it, and follows the path.
    fn follow(&self, path: GeometricPath, speed: f64, drive: &mut Drive) -> Result<(), String> {
        let (first, last) = (path.points()[0], path.points()[path.points().len() - 1]);
        if speed == 0.0 {
            drive
                .motion
                .spin(drive.at, wrap_angle(first.yaw - drive.at.yaw), self.limits);
        }
        drive
            .motion
            .follow(path.limited(self.speed_limit), speed, self.limits)
            .map_err(|_: SweepError| "too_fast".to_owned())?;
        drive.at = Pose2::new(last.x, last.y, last.yaw);
        Ok(())
    }

    /// The last turn, and the check of all of it.
    fn arrived(&self, mut drive: Drive, evidence: Evidence) -> Result<Checked, String> {
        if let Some(yaw) = self.goal_yaw() {
            drive.motion.spin(drive.at, wrap_angle(yaw - drive.at.yaw), self.limits);
        }
        self.checked(drive.motion, evidence)
    }

    fn checked(&self, motion: Motion, evidence: Evidence) -> Result<Checked, String> {
        let least =
            clearance(self.space, &motion, self.limits, self.exempt).map_err(|Collision| "collision".to_owned())?;
        Ok(Checked {
            motion,
            evidence,
            least,
        })
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
        match way
            .get(1..)
            .and_then(|rest| rest.iter().rposition(|corner| self.sees(at, *corner)))
        {
            Some(corner) => corners_from(at, &way[1 + corner..]),
            None => rejoined(at, way),
        }
    }

    fn sees(&self, from: Point2<f64>, to: Point2<f64>) -> bool {
        has_leg(self.space, from, to, 0.5 * self.settings.rooms.comfort)
    }
}

fn reason(error: &NoSegment) -> String {
    match error {
        NoSegment::Curve(error) => error.to_string(),
        NoSegment::Collides(_) => "collision".to_owned(),
    }
}

/// Adds stops at inner corners of a part that has no curve: the ones nearest to where it collides, or else the sharpest; or all of them.
fn stop_at(stops: &mut [bool], way: &[Point2<f64>], error: &NoSegment, all: bool) {
    let corner = |i: usize| way[i + 1];
    match error {
        _ if all => stops.fill(true),
        NoSegment::Collides(places) => {
            for place in places {
                let distance = |i: &usize| (corner(*i) - place).norm();
                let nearest = (0..stops.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
                nearest.into_iter().for_each(|i| stops[i] = true);
            }
        }
        NoSegment::Curve(_) => {
            let turn = |i: &usize| (corner(*i) - way[*i]).angle(&(way[i + 2] - corner(*i)));
            let sharpest = (0..stops.len()).max_by(|a, b| turn(a).total_cmp(&turn(b)));
            sharpest.into_iter().for_each(|i| stops[i] = true);
        }
    }
}
