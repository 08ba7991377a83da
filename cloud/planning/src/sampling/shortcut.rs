//! Shortcuts and string pulling between any points. Removes redundant corners, and pulls the others in until the path runs around the
//! obstacles like a taut string.
//!
//! Every step replaces two legs by a shorter connection in sight (triangle inequality), so a path never becomes longer.

use nalgebra::Point2;

use zenav_space::LineOfSight;

use crate::path::length;

/// Precision of pulled corners, cells.
const PRECISION: f64 = 1.0 / 128.0;
/// A round that gains less than this share of the length is the last one.
const LEAST_GAIN: f64 = 1e-5;
/// Largest number of rounds of string pulling.
const ROUNDS: usize = 64;

/// Removes corners, from the front and from the back: from each kept corner the path goes to the farthest corner in sight that a search
/// with doubling steps finds. Ends soon after `stops` returns true.
pub fn prune(sight: &impl LineOfSight, path: &mut Vec<Point2<f64>>, stops: impl Fn() -> bool) {
    if path.len() < 3 {
        return;
    }
    for _ in 0..2 {
        let (mut at, mut kept) = (0, 1);
        while at + 1 < path.len() && !stops() {
            let sees = |to: usize| to < path.len() && sight.sees(path[at], path[to]);
            let (mut to, mut step) = (at + 1, 1);
            while sees(to + step) {
                to += step;
                step *= 2;
            }
            while step > 0 {
                if sees(to + step) {
                    to += step;
                }
                step /= 2;
            }
            let next = path[to];
            path[kept] = next;
            kept += 1;
            at = to;
        }
        // The part that was not examined stays as it is.
        path.drain(kept..=at);
        path.reverse();
    }
}

/// Pulls a path taut: moves corners towards their neighbours, round by round, until the gain is negligible or `stops` returns true.
pub fn pull_string(sight: &impl LineOfSight, path: &mut Vec<Point2<f64>>, stops: impl Fn() -> bool) {
    for _ in 0..ROUNDS {
        let before = length(path);
        prune(sight, path, &stops);
        let mut i = 1;
        while i + 1 < path.len() {
            if stops() {
                return;
            }
            let (a, v, b) = (path[i - 1], path[i], path[i + 1]);
            let moved = seen(v, b, |p| sight.sees(a, p));
            let moved = seen(moved, a, |p| sight.sees(p, b));
            if (moved - v).norm() > PRECISION {
                path[i] = moved;
            } else {
                // Wedged between two obstacles: cut the corner between them.
                let share = share_seen((a - v).norm().max((b - v).norm()), |share| {
                    sight.sees(v + (a - v) * share, v + (b - v) * share)
                });
                if share * (a - v).norm().min((b - v).norm()) > PRECISION {
                    path[i] = v + (a - v) * share;
                    path.insert(i + 1, v + (b - v) * share);
                    i += 1;
                }
            }
            i += 1;
        }
        if before - length(path) <= LEAST_GAIN * before {
            break;
        }
    }
    prune(sight, path, &stops);
}

/// The last point in sight from `a` towards `b`, by bisection.
fn seen(a: Point2<f64>, b: Point2<f64>, sees: impl Fn(Point2<f64>) -> bool) -> Point2<f64> {
    a + (b - a) * share_seen((b - a).norm(), |share| sees(a + (b - a) * share))
}

/// The largest share of a length at which `sees` holds, by bisection to within [`PRECISION`]; 0 is taken as seen.
fn share_seen(length: f64, sees: impl Fn(f64) -> bool) -> f64 {
    let (mut free, mut blocked) = (0.0, 1.0);
    while (blocked - free) * length > PRECISION {
        let middle = 0.5 * (free + blocked);
        if sees(middle) {
            free = middle;
        } else {
            blocked = middle;
        }
    }
    free
}
