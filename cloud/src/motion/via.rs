//! Poses to stop at. How is a path with stops on its way smoothed piece by piece?

use nalgebra::Point2;
use zenav_protocol::messages::PlanStatistics;
use zenav_smoothing::Outcome;

/// A path passes a point that is so near to it, m.
const PASSED: f64 = 0.05;

/// A path cut at the points to stop at. One that the path does not pass, and one at its beginning or end, is left out.
pub(super) fn pieces(path: &[Point2<f64>], via: &[Point2<f64>]) -> Vec<Vec<Point2<f64>>> {
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

/// Of one piece and the next: times, lengths and energies add up, the least clearance counts, and the status of the first that is not smooth.
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
        ..piece
    }
}
