//! Pieces. A path with stops, and with legs that are driven backwards, smoothed piece by piece.
//!
//! The path is cut where it changes between forwards and backwards (a cusp) and at the points to stop at. The first piece begins with the
//! robot's velocity; every piece ends at rest, and the next one begins where it ends. Driving backwards is driving forwards for a robot
//! turned by 180°.

use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{Certificate, CorridorFigures, LimitUse, PlanStatistics, SolverFigures};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::trajectory::Trajectory;
use zenav_space::ConfigurationSpace;

use super::corridor::FreePolygon;
use super::outcome::Outcome;
use super::settings::SmoothingSettings;
use super::smoother::{SmoothQuery, smooth};
use super::timing::{PiecewiseTrajectory, State};

/// A path passes a point if it is this close to it, m.
const PASSED: f64 = 0.05;

/// Where a path is cut into pieces; nowhere by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cuts<'a> {
    /// Legs that are driven backwards, by the index of the corner where they begin, as a planner reports them. Indices that are no leg's
    /// are ignored.
    pub backwards: &'a [usize],
    /// Points to stop at, in the order of the path, map frame, m; a piece that passes one of them again stops there again. Points off the
    /// path, or at its beginning or end, are ignored.
    pub via: &'a [Point2<f64>],
}

/// A piece of a path, from stop to stop.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// Corner points, map frame, m.
    pub path: Vec<Point2<f64>>,
    /// Whether it is driven backwards.
    pub backwards: bool,
    /// Whether the next piece goes the opposite way.
    pub ends_in_cusp: bool,
}

impl Piece {
    /// Required final heading, rad: before a cusp, the one in which the robot drives the last leg; otherwise any.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_smoothing::{Cuts, pieces};
    ///
    /// // Two metres along x, and one metre back.
    /// let path = [0.0, 2.0, 1.0].map(|x| Point2::new(x, 0.0));
    /// let cut = pieces(&path, &Cuts { backwards: &[1], via: &[] });
    /// assert_eq!((cut[0].end_yaw(), cut[1].end_yaw()), (Some(0.0), None));
    /// ```
    #[must_use]
    pub fn end_yaw(&self) -> Option<f64> {
        let [.., from, to] = self.path[..] else { return None };
        let along = if self.backwards { from - to } else { to - from };
        self.ends_in_cusp.then(|| along.y.atan2(along.x))
    }
}

/// The pieces of a path (corner points, map frame, m), at least one.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_smoothing::{Cuts, pieces};
///
/// // Two metres along x with a stop in the middle, and half a metre back.
/// let path = [0.0, 2.0, 1.5].map(|x| Point2::new(x, 0.0));
/// let cut = pieces(&path, &Cuts { backwards: &[1], via: &[Point2::new(1.0, 0.0)] });
/// let ends = cut.iter().map(|piece| (piece.path[1].x, piece.backwards));
/// assert!(ends.eq([(1.0, false), (2.0, false), (1.5, true)]));
/// ```
#[must_use]
pub fn pieces(path: &[Point2<f64>], cuts: &Cuts<'_>) -> Vec<Piece> {
    let mut is_back = vec![false; path.len()];
    for leg in cuts.backwards {
        if let Some(is_back) = is_back.get_mut(*leg) {
            *is_back = true;
        }
    }
    let mut pieces: Vec<Piece> = Vec::new();
    let mut first = 0;
    for corner in 1..path.len().max(2) {
        let goes_back = is_back.get(first) == Some(&true);
        let is_last = corner + 1 >= path.len();
        if !is_last && is_back[corner] == goes_back {
            continue;
        }
        let leg = path.get(first..=corner).unwrap_or(path);
        let cut = cut(leg, cuts.via);
        let count = cut.len();
        pieces.extend(cut.into_iter().enumerate().map(|(nth, path)| Piece {
            path,
            backwards: goes_back,
            ends_in_cusp: nth + 1 == count && !is_last,
        }));
        first = corner;
    }
    pieces
}

/// Cuts a path at the points to stop at.
fn cut(path: &[Point2<f64>], via: &[Point2<f64>]) -> Vec<Vec<Point2<f64>>> {
    let mut pieces = Vec::new();
    let mut rest = path.to_vec();
    for stop in via {
        let passes = |leg: &[Point2<f64>]| {
            let along = leg[1] - leg[0];
            let share = ((stop - leg[0]).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
            (leg[0] + along * share - stop).norm() < PASSED
        };
        let Some(leg) = rest.windows(2).position(passes) else {
            continue;
        };
        let ahead = [&[*stop], &rest[leg + 1..]].concat();
        let is_end = |end: Option<&Point2<f64>>| end.is_none_or(|end| (end - stop).norm() < PASSED);
        if is_end(rest.first()) || is_end(rest.last()) {
            continue;
        }
        rest.truncate(leg + 1);
        rest.push(*stop);
        pieces.push(std::mem::replace(&mut rest, ahead));
    }
    pieces.push(rest);
    pieces
}

/// The trajectory of a piece, from time zero on.
#[derive(Clone, Debug)]
pub struct SmoothedPiece {
    /// In closed form; if the piece is driven backwards, that of a robot turned by 180°.
    pub trajectory: PiecewiseTrajectory,
    /// Whether it is driven backwards.
    pub backwards: bool,
}

impl SmoothedPiece {
    /// The robot's states at most `period` seconds apart, the end included.
    #[must_use]
    pub fn states(&self, period: f64) -> Vec<State> {
        let states = self.trajectory.states(period).into_iter();
        states
            .map(|state| if self.backwards { state.turned() } else { state })
            .collect()
    }

    /// Like [`Self::states`], as sent over the wire.
    #[must_use]
    pub fn sampled(&self, period: f64) -> Trajectory {
        self.states(period).into_iter().map(|state| state.point).collect()
    }

    /// The robot's pose at the end, map frame.
    fn end(&self) -> Pose2 {
        let end = self.trajectory.at(self.trajectory.duration()).point.pose();
        if self.backwards { end.turned() } else { end }
    }
}

/// The trajectories of a path's pieces, their outcome and their statistics.
#[derive(Clone, Debug, Default)]
pub struct SmoothedPieces {
    /// The outcome of the first piece that is not smooth.
    pub outcome: Outcome,
    /// The pieces in which the robot moves, in order; none if there is nothing to drive, and if a piece is blocked.
    pub pieces: Vec<SmoothedPiece>,
    /// The free polygons that contain the curves of all pieces, in order; none along straight lines.
    pub corridor: Vec<FreePolygon>,
    /// Of all pieces together: times, lengths and energies add up, the least clearance counts, and the certificate holds for each piece.
    pub statistics: PlanStatistics,
}

impl SmoothedPieces {
    /// Whether nothing moves.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pieces.is_empty()
    }

    /// Whether every piece follows a smooth curve rather than the unsmoothed path.
    #[must_use]
    pub fn is_smooth(&self) -> bool {
        self.outcome == Outcome::Smoothed
    }

    /// The robot's states at most `period` seconds apart, the ends of all pieces included; empty if nothing moves.
    #[must_use]
    pub fn states(&self, period: f64) -> Vec<State> {
        let (mut states, mut begin) = (Vec::new(), 0.0);
        for piece in &self.pieces {
            // Each piece begins with the state in which the one before ends.
            let known = usize::from(!states.is_empty());
            for mut state in piece.states(period).into_iter().skip(known) {
                state.point.t += begin;
                states.push(state);
            }
            begin += piece.trajectory.duration();
        }
        states
    }

    /// Like [`Self::states`], as sent over the wire.
    #[must_use]
    pub fn sampled(&self, period: f64) -> Trajectory {
        self.states(period).into_iter().map(|state| state.point).collect()
    }
}

/// Like [`smooth()`], for a path that is cut into pieces.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::geometry::Pose2;
/// use zenav_smoothing::{Cuts, SAMPLE_PERIOD, SmoothQuery, SmoothingSettings, smooth_pieces};
/// # use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
/// # use zenav_protocol::robot::{RobotModel, shipped};
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 100 };
/// # let grid = Grid::filled(spec, Occupancy::FREE);
/// # let model = RobotModel::from_toml(shipped("jackal").unwrap(), "jackal").unwrap();
/// # let space = ConfigurationSpace::new(&grid, &model.footprint, UnknownPolicy::Blocked, 0.0);
/// // Back out of a lane, and on to the left.
/// let path = [Point2::new(3.0, 2.0), Point2::new(1.5, 2.0), Point2::new(1.5, 4.0)];
/// let query = SmoothQuery::new(&path, Pose2::new(3.0, 2.0, 0.0));
/// let cuts = Cuts { backwards: &[0], via: &[] };
/// let smoothed = smooth_pieces(&space, &query, &cuts, &model, &SmoothingSettings::default(), None, &mut || 0.0);
/// let trajectory = smoothed.sampled(SAMPLE_PERIOD);
/// assert!(trajectory.iter().filter(|point| point.x > 1.6).all(|point| point.v <= 0.0 && point.yaw.abs() < 0.1));
/// let end = trajectory.last().unwrap();
/// assert!(end.v.abs() < 1e-6 && (end.position() - Point2::new(1.5, 4.0)).norm() < 1e-3);
/// ```
pub fn smooth_pieces(
    space: &ConfigurationSpace,
    query: &SmoothQuery<'_>,
    cuts: &Cuts<'_>,
    model: &RobotModel,
    settings: &SmoothingSettings,
    cancel: Option<&AtomicBool>,
    clock: &mut dyn FnMut() -> f64,
) -> SmoothedPieces {
    let turned_space = (!cuts.backwards.is_empty()).then(|| space.turned());
    let pieces = pieces(query.path, cuts);
    let mut whole = SmoothedPieces::default();
    let mut asked = *query;
    for (index, piece) in pieces.iter().enumerate() {
        asked.path = &piece.path;
        asked.goal_yaw = if index + 1 == pieces.len() {
            query.goal_yaw
        } else {
            piece.end_yaw()
        };
        let smoothed = match turned_space.as_ref().filter(|_| piece.backwards) {
            Some(space) => smooth(space, &turned(&asked), model, settings, cancel, &mut *clock),
            None => smooth(space, &asked, model, settings, cancel, &mut *clock),
        };
        let is_blocked = smoothed.trajectory.is_empty() && !smoothed.is_smooth();
        whole.statistics = sum(std::mem::take(&mut whole.statistics), smoothed.statistics);
        if whole.is_smooth() {
            whole.outcome = smoothed.outcome;
        }
        if is_blocked {
            whole.pieces.clear();
            whole.corridor.clear();
            return whole;
        }
        whole.corridor.extend(smoothed.corridor);
        // Where there is nothing to drive, the next piece begins at the same pose.
        if !smoothed.trajectory.is_empty() {
            let driven = SmoothedPiece {
                trajectory: smoothed.trajectory,
                backwards: piece.backwards,
            };
            (asked.start, asked.start_velocity) = (driven.end(), Twist2::ZERO);
            whole.pieces.push(driven);
        }
    }
    whole
}

/// The same query for the same robot with its rear as its front.
fn turned<'a>(query: &SmoothQuery<'a>) -> SmoothQuery<'a> {
    let Twist2 { v, w } = query.start_velocity;
    SmoothQuery {
        start: query.start.turned(),
        start_velocity: Twist2::new(-v, w),
        goal_yaw: query.goal_yaw.map(|yaw| yaw + PI),
        ..*query
    }
}

/// Combines the statistics of consecutive pieces: times, lengths and energies add up; the least clearance counts; the status is the first
/// that is not smooth; the certificate covers both.
fn sum(before: PlanStatistics, piece: PlanStatistics) -> PlanStatistics {
    if before.status.is_empty() {
        return piece;
    }
    let least = before
        .min_clearance
        .into_iter()
        .chain(piece.min_clearance)
        .reduce(f64::min);
    let status = if before.status == Outcome::Smoothed.to_string() {
        piece.status
    } else {
        before.status
    };
    PlanStatistics {
        corridor_ms: before.corridor_ms + piece.corridor_ms,
        geometry_ms: before.geometry_ms + piece.geometry_ms,
        timing_ms: before.timing_ms + piece.timing_ms,
        length: before.length + piece.length,
        duration: before.duration + piece.duration,
        energy_j: before.energy_j + piece.energy_j,
        min_clearance: least,
        status,
        solver: worse(before.solver, piece.solver),
        certificate: both(before.certificate, piece.certificate),
        ..piece
    }
}

/// The certificate of both: the largest use of each limit, the narrowest corridor, the law and the solver that fell short.
fn both(before: Certificate, piece: Certificate) -> Certificate {
    let corridor = |a: CorridorFigures, b: CorridorFigures| CorridorFigures {
        polygons: a.polygons + b.polygons,
        least_width: a.least_width.min(b.least_width),
    };
    let solver = |a: SolverFigures, b: SolverFigures| SolverFigures {
        status: worse(a.status, b.status),
        iterations: a.iterations + b.iterations,
        gap: a.gap.max(b.gap),
    };
    let (a, b) = (before.largest_use, piece.largest_use);
    let duration = before.lower_bound * before.over_lower_bound + piece.lower_bound * piece.over_lower_bound;
    let lower_bound = before.lower_bound + piece.lower_bound;
    Certificate {
        corridor: of_both(before.corridor, piece.corridor, corridor),
        geometry: of_both(before.geometry, piece.geometry, solver),
        time_law: if before.time_law.starts_with("sweep:") {
            before.time_law
        } else {
            piece.time_law
        },
        timing: of_both(before.timing, piece.timing, solver),
        largest_use: LimitUse {
            speed: a.speed.max(b.speed),
            wheel_speed: a.wheel_speed.max(b.wheel_speed),
            wheel_acceleration: a.wheel_acceleration.max(b.wheel_acceleration),
            lateral_acceleration: a.lateral_acceleration.max(b.lateral_acceleration),
            yaw_rate: a.yaw_rate.max(b.yaw_rate),
            jerk: of_both(a.jerk, b.jerk, f64::max),
        },
        lower_bound,
        over_lower_bound: if lower_bound > 0.0 {
            duration / lower_bound
        } else {
            piece.over_lower_bound
        },
    }
}

/// The status to report for two pieces: that of the problem that was not solved.
fn worse(a: String, b: String) -> String {
    if b.is_empty() || !(a.is_empty() || a == "Solved") {
        a
    } else {
        b
    }
}

fn of_both<T>(a: Option<T>, b: Option<T>, join: impl FnOnce(T, T) -> T) -> Option<T> {
    match (a, b) {
        (Some(a), Some(b)) => Some(join(a, b)),
        (a, b) => a.or(b),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_of_two_pieces_holds_for_both() {
        let piece = |status: &str, time_law: &str, speed: f64, least_width: f64| PlanStatistics {
            status: "smoothed".to_owned(),
            solver: status.to_owned(),
            certificate: Certificate {
                corridor: Some(CorridorFigures {
                    polygons: 2,
                    least_width,
                }),
                time_law: time_law.to_owned(),
                largest_use: LimitUse {
                    speed,
                    ..LimitUse::default()
                },
                lower_bound: 1.0,
                over_lower_bound: speed,
                ..Certificate::default()
            },
            ..PlanStatistics::default()
        };
        let narrow = piece("MaxIterations", "sweep:Failed", 0.5, 0.1);
        let fast = piece("Solved", "jerk_limited", 0.9, 0.4);
        let unsmoothed = PlanStatistics {
            status: "smoothed".to_owned(),
            ..PlanStatistics::default()
        };
        let all = sum(sum(unsmoothed, narrow), fast);
        let Certificate {
            corridor,
            time_law,
            largest_use,
            lower_bound,
            over_lower_bound,
            ..
        } = all.certificate;
        assert_eq!(
            (all.solver.as_str(), time_law.as_str()),
            ("MaxIterations", "sweep:Failed")
        );
        assert_eq!(
            corridor.map(|corridor| (corridor.polygons, corridor.least_width)),
            Some((4, 0.1))
        );
        assert_eq!((largest_use.speed, lower_bound, over_lower_bound), (0.9, 2.0, 0.7));
    }

    #[test]
    fn a_path_is_cut_where_it_turns_back_and_where_it_is_to_stop() {
        let path = [0.0, 2.0, 1.0, 0.5, 5.0].map(|x| Point2::new(x, 0.0));
        let cut = |backwards: &[usize], via: &[Point2<f64>]| {
            pieces(&path, &Cuts { backwards, via })
                .into_iter()
                .map(|piece| (piece.path.len(), piece.backwards, piece.ends_in_cusp))
                .collect::<Vec<_>>()
        };
        assert_eq!(cut(&[], &[]), [(5, false, false)]);
        assert_eq!(cut(&[0], &[]), [(2, true, true), (4, false, false)]);
        assert_eq!(
            cut(&[1, 2], &[]),
            [(2, false, true), (3, true, true), (2, false, false)]
        );
        let stop = Point2::new(3.0, 0.0);
        let expected = [(2, false, true), (3, true, true), (2, false, false), (2, false, false)];
        assert_eq!(cut(&[1, 2], &[stop]), expected);
        assert_eq!(cut(&[3], &[]), [(4, false, true), (2, true, false)]);
        assert_eq!(pieces(&path[..1], &Cuts::default()).len(), 1);
        assert_eq!(pieces(&[], &Cuts::default()).len(), 1);
    }
}
