//! Trajectory builder. Where the robot brakes, stops and turns on a path, and which curves lead from stop to stop.
//!
//! A robot at rest starts along its heading or turns on the spot first; a moving robot continues along its arc or brakes first. In
//! between it stops and turns only at corners that are too sharp for a curve, and at corners for which no curve was found: everything
//! else is one curve.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::SolverFigures;
use zenav_protocol::robot::Footprint;

use super::certificate::{Collision, Evidence, clearance};
use super::fit::{EndTangent, Ends};
use super::outcome::Fallback;
use super::phases::Phases;
use super::segment::{NoSegment, Segment, segment};
use super::settings::SmoothingSettings;
use super::shortcut::has_leg;
use super::smoother::SmoothQuery;
use super::timing::stop_turn_go::{corners_from, rejoined, stop_turn_go};
use super::timing::sweep::SweepError;
use super::timing::{GeometricPath, Limits, PiecewiseTrajectory, SpeedLimit};
use zenav_space::ConfigurationSpace;

/// A robot whose wheels are slower than this is at rest, m/s.
const AT_REST: f64 = 0.02;
/// Rounds in which stops are added one by one; after that a part without a curve is driven as stop, turn and go.
const ADDED: usize = 8;

/// A trajectory that was checked, with its evidence.
#[derive(Clone, Debug, Default)]
pub(super) struct Checked {
    pub(super) trajectory: PiecewiseTrajectory,
    pub(super) evidence: Evidence,
    /// Least clearance, m.
    pub(super) least: Option<f64>,
}

/// How a trajectory starts.
enum Beginning {
    /// Continues along the robot's present arc.
    Moving,
    /// From rest, along the heading.
    Aligned,
    /// From rest, after a turn on the spot; a moving robot brakes first.
    Turned,
}

/// A trajectory under construction, and where it ends so far.
#[derive(Clone)]
struct Partial {
    trajectory: PiecewiseTrajectory,
    at: Pose2,
}

/// Builds trajectories along a path.
pub(super) struct TrajectoryBuilder<'a> {
    pub(super) space: &'a ConfigurationSpace,
    pub(super) query: &'a SmoothQuery<'a>,
    pub(super) limits: &'a Limits,
    pub(super) settings: &'a SmoothingSettings,
    /// Metres around the start that are not checked.
    pub(super) exempt: f64,
    pub(super) speed_limit: SpeedLimit<'a>,
}

impl TrajectoryBuilder<'_> {
    /// The heading of a robot at rest; `None` while it moves.
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

    /// The path with a stop and a turn at every corner, without a check for collisions.
    pub(super) fn unchecked_stop_turn_go(&self, path: &[Point2<f64>]) -> PiecewiseTrajectory {
        let SmoothQuery {
            start,
            start_velocity,
            goal_yaw,
            ..
        } = *self.query;
        stop_turn_go(path, start, start_velocity, goal_yaw, self.limits, self.speed_limit)
    }

    /// Stop, turn, go: checked. A moving robot brakes, and continues from where it stopped, or returns to where it was.
    pub(super) fn stop_turn_go(&self, path: &[Point2<f64>]) -> Option<Checked> {
        self.checked(self.unchecked_stop_turn_go(path), Evidence::default())
            .ok()
            .or_else(|| {
                let partial = self.braked();
                let at = partial.at.position();
                let back: Vec<_> = [at].iter().chain(path).copied().collect();
                let paths = [self.joined(at, path), corners_from(at, &back)];
                let driven = paths.iter().filter(|_| self.moves()).filter_map(|path| {
                    let mut partial = partial.clone();
                    for leg in path.windows(2) {
                        self.straight(leg[0], leg[1], &mut partial).ok()?;
                    }
                    self.arrived(partial, Evidence::default()).ok()
                });
                driven.into_iter().next()
            })
    }

    /// The first beginning and end that give a free curve of at most `enough` seconds, else the fastest one; the last reason if there is
    /// none.
    pub(super) fn smooth(
        &self,
        path: &[Point2<f64>],
        enough: f64,
        phases: &mut Phases<'_>,
    ) -> Result<Checked, Fallback> {
        let mut best: Result<Checked, Fallback> = Err(Fallback::TimedOut);
        for beginning in self.beginnings(path) {
            for arrives in [true, false] {
                if arrives && !self.can_arrive(path) {
                    continue;
                }
                match (self.attempt(path, &beginning, arrives, phases), &best) {
                    (Ok(found), Ok(known)) if found.trajectory.duration() >= known.trajectory.duration() => {}
                    (Ok(found), _) => best = Ok(found),
                    (Err(_), Ok(_)) => {}
                    (Err(reason), Err(_)) => best = Err(reason),
                }
                if best.as_ref().is_ok_and(|found| found.trajectory.duration() <= enough) {
                    return best;
                }
            }
        }
        best
    }

    fn beginnings(&self, path: &[Point2<f64>]) -> Vec<Beginning> {
        let SmoothQuery {
            start,
            start_velocity: Twist2 { v, w },
            ..
        } = *self.query;
        let leg = path[1] - path[0];
        let turn = wrap_angle(leg.y.atan2(leg.x) - start.yaw).abs();
        let mut beginnings = Vec::new();
        if self.exempt > 0.0 {
            // A robot that has to leave an obstacle goes straight first.
        } else if self.moves() {
            if v > AT_REST && turn < self.settings.stops.ahead && w.abs() <= self.settings.stops.sharpest_arc * v {
                beginnings.push(Beginning::Moving);
            }
        } else if turn < self.settings.stops.aligned {
            beginnings.push(Beginning::Aligned);
        }
        beginnings.push(Beginning::Turned);
        beginnings
    }

    /// Whether the goal heading is close enough to the path's last leg to be reached by the curve.
    fn can_arrive(&self, path: &[Point2<f64>]) -> bool {
        let [.., before, last] = path else { return false };
        let leg = last - before;
        self.goal_yaw()
            .is_some_and(|yaw| wrap_angle(yaw - leg.y.atan2(leg.x)).abs() < self.settings.stops.arriving)
    }

    fn goal_yaw(&self) -> Option<f64> {
        self.query.goal_yaw.filter(|yaw| yaw.is_finite())
    }

    fn attempt(
        &self,
        path: &[Point2<f64>],
        beginning: &Beginning,
        arrives: bool,
        phases: &mut Phases<'_>,
    ) -> Result<Checked, Fallback> {
        let SmoothQuery {
            start, start_velocity, ..
        } = *self.query;
        let mut partial = Partial {
            trajectory: PiecewiseTrajectory::new(),
            at: start,
        };
        let along = |curvature: Option<f64>| EndTangent {
            direction: start.heading(),
            curvature,
        };
        let (path, enter) = match beginning {
            Beginning::Moving => {
                let tangent = along(Some(start_velocity.w / start_velocity.v));
                (self.led_in(path, start_velocity.v), Some((tangent, start_velocity.v)))
            }
            Beginning::Aligned => (path.to_vec(), Some((along(None), 0.0))),
            Beginning::Turned => {
                partial = self.braked();
                let path = if partial.trajectory.is_empty() {
                    path.to_vec()
                } else {
                    self.joined(partial.at.position(), path)
                };
                (path, None)
            }
        };
        let mut rest = &path[..];
        if self.exempt > 0.0
            && let [from, to, ..] = path[..]
        {
            phases.measure(|p| &mut p.timing, || self.straight(from, to, &mut partial))?;
            rest = &path[1..];
        }
        let leave = self.goal_yaw().filter(|_| arrives).map(|yaw| EndTangent {
            direction: Pose2::new(0.0, 0.0, yaw).heading(),
            curvature: None,
        });
        let ends = Ends {
            start: enter.map(|(tangent, _)| tangent),
            end: leave,
        };
        let parts = self.parts(rest, &ends, phases)?;
        let mut evidence = Evidence::default();
        let mut speed = enter.map_or(0.0, |(_, speed)| speed);
        for part in parts {
            if let Some(curve) = part.curve {
                let solver = SolverFigures {
                    status: curve.solver,
                    iterations: curve.iterations,
                    gap: curve.gap,
                };
                evidence.add(&part.polygons, solver);
            }
            phases.measure(|p| &mut p.timing, || self.follow(part.geometry, speed, &mut partial))?;
            speed = 0.0;
        }
        phases.measure(|p| &mut p.geometry, || self.arrived(partial, evidence))
    }

    /// Curves along a path, from stop to stop; where there is no curve, stops are added.
    fn parts(&self, path: &[Point2<f64>], ends: &Ends, phases: &mut Phases<'_>) -> Result<Vec<Segment>, Fallback> {
        let is_sharp =
            |i: usize| (path[i] - path[i - 1]).angle(&(path[i + 1] - path[i])) > self.settings.stops.sharp_corner;
        let mut stops: Vec<bool> = (0..path.len())
            .map(|i| i == 0 || i + 1 >= path.len() || is_sharp(i))
            .collect();
        let mut known: Vec<(usize, usize, Segment)> = Vec::new();
        let mut first_reason = None;
        let mut round = 0;
        loop {
            let (mut parts, mut missing) = (Vec::new(), false);
            let at: Vec<usize> = (0..path.len()).filter(|i| stops[*i]).collect();
            for leg in at.windows(2) {
                let (from, to) = (leg[0], leg[1]);
                let ends = Ends {
                    start: ends
                        .start
                        .filter(|_| from == 0)
                        .or_else(|| self.tight(path, from, from + 1)),
                    end: ends
                        .end
                        .filter(|_| to + 1 == path.len())
                        .or_else(|| (to + 1 < path.len()).then(|| self.tight(path, to - 1, to)).flatten()),
                };
                if phases.is_over() {
                    return Err(Fallback::TimedOut);
                }
                let found = match known.iter().position(|part| (part.0, part.1) == (from, to)) {
                    Some(index) => Ok(known.swap_remove(index).2),
                    None => segment(self.space, &path[from..=to], &ends, self.settings, phases),
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
                        stop_at(&mut stops[from + 1..to], &path[from..=to], &error, round >= ADDED);
                    }
                }
            }
            if !missing {
                let is_curved = parts.iter().any(|(_, _, part)| part.curve.is_some());
                return match first_reason {
                    // Only stop, turn and go is left.
                    Some(reason) if !is_curved => Err(reason),
                    _ => Ok(parts.into_iter().map(|(_, _, part)| part).collect()),
                };
            }
            known.extend(parts);
            round += 1;
        }
    }

    /// Where a long robot has no room to turn freely, its curve is tangent to the path's own leg.
    fn tight(&self, path: &[Point2<f64>], from: usize, to: usize) -> Option<EndTangent> {
        let around = self.space.footprint().circumscribed_radius();
        let is_tight = |i: usize| self.space.clearance(path[i]) <= around + 1e-3;
        let leg = path[to] - path[from];
        (self.is_long() && (is_tight(from) || is_tight(to))).then(|| EndTangent {
            direction: leg.normalize(),
            curvature: None,
        })
    }

    /// The braking trajectory of a moving robot, and the pose where it comes to rest.
    fn braked(&self) -> Partial {
        let mut trajectory = PiecewiseTrajectory::new();
        let at = trajectory.brake(self.query.start, self.query.start_velocity, self.limits);
        Partial { trajectory, at }
    }

    /// Turns towards a place and drives there straight.
    fn straight(&self, from: Point2<f64>, to: Point2<f64>, partial: &mut Partial) -> Result<(), Fallback> {
        match GeometricPath::straight(from, to, self.settings.step) {
            Some(geometry) => self.follow(geometry, 0.0, partial),
            None => Ok(()),
        }
    }

    /// Turns into a path's direction if the robot is at rest, and follows the path.
    fn follow(&self, geometry: GeometricPath, speed: f64, partial: &mut Partial) -> Result<(), Fallback> {
        let (first, last) = (geometry.points()[0], geometry.points()[geometry.points().len() - 1]);
        if speed == 0.0 {
            partial
                .trajectory
                .spin(partial.at, wrap_angle(first.yaw - partial.at.yaw), self.limits);
        }
        partial
            .trajectory
            .follow(geometry.limited(self.speed_limit), speed, self.limits)
            .map_err(|_: SweepError| Fallback::TooFast)?;
        partial.at = Pose2::new(last.x, last.y, last.yaw);
        Ok(())
    }

    /// Adds the last turn, and checks the whole trajectory.
    fn arrived(&self, mut partial: Partial, evidence: Evidence) -> Result<Checked, Fallback> {
        if let Some(yaw) = self.goal_yaw() {
            partial
                .trajectory
                .spin(partial.at, wrap_angle(yaw - partial.at.yaw), self.limits);
        }
        self.checked(partial.trajectory, evidence)
    }

    fn checked(&self, trajectory: PiecewiseTrajectory, evidence: Evidence) -> Result<Checked, Fallback> {
        let least =
            clearance(self.space, &trajectory, self.limits, self.exempt).map_err(|Collision| Fallback::Collision)?;
        Ok(Checked {
            trajectory,
            evidence,
            least,
        })
    }

    /// The path of a moving robot: a short lead along its heading, then to the farthest corner in sight.
    fn led_in(&self, path: &[Point2<f64>], speed: f64) -> Vec<Point2<f64>> {
        let start = self.query.start;
        let mut lead = (0.6 * speed).clamp(0.1, 0.6).min(0.4 * (path[1] - path[0]).norm());
        while lead > 0.05 {
            let ahead = start.position() + start.heading() * lead;
            let first = path[1..].iter().rposition(|corner| self.sees(ahead, *corner));
            if let Some(first) = first.filter(|_| self.sees(start.position(), ahead)) {
                return [&[start.position(), ahead], &path[1 + first..]].concat();
            }
            lead *= 0.5;
        }
        path.to_vec()
    }

    /// The path of a robot that stopped beside it: to the farthest corner in sight, else back to the nearest point.
    fn joined(&self, at: Point2<f64>, path: &[Point2<f64>]) -> Vec<Point2<f64>> {
        match path
            .get(1..)
            .and_then(|rest| rest.iter().rposition(|corner| self.sees(at, *corner)))
        {
            Some(corner) => corners_from(at, &path[1 + corner..]),
            None => rejoined(at, path),
        }
    }

    fn sees(&self, from: Point2<f64>, to: Point2<f64>) -> bool {
        has_leg(self.space, from, to, 0.5 * self.settings.corridor.clearance)
    }
}

fn reason(error: &NoSegment) -> Fallback {
    match error {
        NoSegment::Curve(error) => Fallback::Curve(error.clone()),
        NoSegment::Collides(_) => Fallback::Collision,
        NoSegment::TimedOut => Fallback::TimedOut,
    }
}

/// Adds stops at inner corners of a part without a curve: at those nearest to the collisions, or else at the sharpest one; or at all of
/// them.
fn stop_at(stops: &mut [bool], path: &[Point2<f64>], error: &NoSegment, all: bool) {
    let corner = |i: usize| path[i + 1];
    match error {
        _ if all => stops.fill(true),
        NoSegment::Collides(places) => {
            for place in places {
                let distance = |i: &usize| (corner(*i) - place).norm();
                let nearest = (0..stops.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
                nearest.into_iter().for_each(|i| stops[i] = true);
            }
        }
        NoSegment::Curve(_) | NoSegment::TimedOut => {
            let turn = |i: &usize| (corner(*i) - path[*i]).angle(&(path[i + 2] - corner(*i)));
            let sharpest = (0..stops.len()).max_by(|a, b| turn(a).total_cmp(&turn(b)));
            sharpest.into_iter().for_each(|i| stops[i] = true);
        }
    }
}
