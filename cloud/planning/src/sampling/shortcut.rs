//! How does a way with needless corners become a short one? Corners that are not needed are left out, the others are pulled in until the way
//! is as taut as a string around the obstacles.
//!
//! Every step replaces two legs by a shorter connection that is seen (triangle inequality), so a way never becomes longer.

use nalgebra::Point2;

use zenav_space::LineOfSight;

/// Corners are pulled in to within this distance, cells.
const PRECISION: f64 = 1.0 / 128.0;
/// Rounds that gain less than this share of the length are the last ones.
const LEAST_GAIN: f64 = 1e-5;
/// Most rounds.
const ROUNDS: usize = 64;

/// Length of a way, cells.
#[must_use]
pub fn length(way: &[Point2<f64>]) -> f64 {
    way.windows(2).map(|leg| (leg[1] - leg[0]).norm()).sum()
}

/// Leaves out corners, from the front and from the back: from each corner that is kept the way goes to the farthest one that is seen, as far as
/// a search in doubling steps finds it. Ends soon after `stops` says so.
pub fn prune(sight: &impl LineOfSight, way: &mut Vec<Point2<f64>>, stops: impl Fn() -> bool) {
    if way.len() < 3 {
        return;
    }
    for _ in 0..2 {
        let (mut at, mut kept) = (0, 1);
        while at + 1 < way.len() && !stops() {
            let sees = |to: usize| to < way.len() && sight.sees(way[at], way[to]);
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
            let next = way[to];
            way[kept] = next;
            kept += 1;
            at = to;
        }
        // What was not looked at any more stays as it is.
        way.drain(kept..=at);
        way.reverse();
    }
}

/// Pulls a way taut: afterwards no corner can be moved towards its neighbours by more than `PRECISION`, or `stops` has said so.
pub fn tighten(sight: &impl LineOfSight, way: &mut Vec<Point2<f64>>, stops: impl Fn() -> bool) {
    for _ in 0..ROUNDS {
        let before = length(way);
        prune(sight, way, &stops);
        let mut i = 1;
        while i + 1 < way.len() {
            if stops() {
                return;
            }
            let (a, v, b) = (way[i - 1], way[i], way[i + 1]);
            let moved = seen(v, b, |p| sight.sees(a, p));
            let moved = seen(moved, a, |p| sight.sees(p, b));
            if (moved - v).norm() > PRECISION {
                way[i] = moved;
            } else {
                // Wedged between two obstacles: cut the corner between them.
                let share = share_seen((a - v).norm().max((b - v).norm()), |share| {
                    sight.sees(v + (a - v) * share, v + (b - v) * share)
                });
                if share * (a - v).norm().min((b - v).norm()) > PRECISION {
                    way[i] = v + (a - v) * share;
                    way.insert(i + 1, v + (b - v) * share);
                    i += 1;
                }
            }
            i += 1;
        }
        if before - length(way) <= LEAST_GAIN * before {
            break;
        }
    }
    prune(sight, way, &stops);
}

/// The last point from `a` towards `b` that is seen, as far as halving finds it.
fn seen(a: Point2<f64>, b: Point2<f64>, sees: impl Fn(Point2<f64>) -> bool) -> Point2<f64> {
    a + (b - a) * share_seen((b - a).norm(), |share| sees(a + (b - a) * share))
}

/// The largest share of a length, up to [`PRECISION`], at which something is seen, as far as halving finds it; nothing is lost at 0.
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
