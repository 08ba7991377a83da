//! Poses to stop at. Smooths a path with stops, and with pieces driven backwards, piece by piece.

use nalgebra::Point2;
use zenav_protocol::messages::{Certificate, CorridorFigures, LimitUse, PlanStatistics, SolverFigures};
use zenav_smoothing::Outcome;

/// A path passes a point if it is this close to it, m.
const PASSED: f64 = 0.05;

/// A piece of a path, from rest to rest.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Piece {
    /// Corner points, m.
    pub(super) path: Vec<Point2<f64>>,
    /// Whether it is driven backwards.
    pub(super) backwards: bool,
    /// Whether the next piece goes the opposite way.
    pub(super) ends_in_cusp: bool,
}

impl Piece {
    /// Required final heading, rad: before a cusp, that of the last leg; otherwise any.
    pub(super) fn end_yaw(&self) -> Option<f64> {
        let [.., from, to] = self.path[..] else { return None };
        let along = if self.backwards { from - to } else { to - from };
        self.ends_in_cusp.then(|| along.y.atan2(along.x))
    }
}

/// Cuts a path where it changes between forwards and backwards (legs are numbered by their first corner), and at the points to stop at.
pub(super) fn pieces(path: &[Point2<f64>], backwards: &[usize], via: &[Point2<f64>]) -> Vec<Piece> {
    let mut is_back = vec![false; path.len()];
    for leg in backwards {
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
        let cut = cut(leg, via);
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

/// Cuts a path at the points to stop at. Points off the path, or at its beginning or end, are ignored.
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

/// Combines the statistics of consecutive pieces: times, lengths and energies add up; the least clearance counts; the status is the first
/// that is not smooth; the certificate covers both.
pub(super) fn sum(before: PlanStatistics, piece: PlanStatistics) -> PlanStatistics {
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
            pieces(&path, backwards, via)
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
        assert_eq!(pieces(&path[..1], &[], &[]).len(), 1);
    }
}
