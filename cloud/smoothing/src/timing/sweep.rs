//! Time-optimal sweep. The fastest law along a path: two passes over the squared speed `b = v²`, exact for its samples.
//!
//! Between two samples the acceleration `a` is constant, and `b` and the curvature are linear in the arc length, so that both wheels'
//! accelerations `a (1 ± k h) ± h k' b` are linear there: bounds at both ends hold in between. The backward pass finds the largest `b`
//! from which the end can still be reached, the forward pass takes the largest step into it.
//!
//! Source: Pham and Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis", T-RO 2018.

use super::limits::Limits;
use super::path::{GeometricPath, PathPoint};

/// Why there is no law.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SweepError {
    /// The path is too tight, or too short, for the speed at its start.
    #[error("start speed {speed:.3} m/s: the path allows {limit:.3} m/s")]
    StartTooFast {
        /// Speed at the start, m/s.
        speed: f64,
        /// What the path allows there, m/s.
        limit: f64,
    },
}

/// Squared speed lost per metre in a zone whose limit the robot exceeds, as a multiple of the wheels' acceleration (full braking: 2).
const SLOWING: f64 = 1.0;
/// The same ahead of a zone, tried in this order: the zone's limit strictly; somewhat less than full braking, for a path that bends; as
/// gently as inside.
const SLOWING_AHEAD: [f64; 3] = [f64::MAX, 1.8, SLOWING];

/// Squared speed (m²/s²) at every sample: the fastest law that starts at `start_speed` (m/s, not negative) and ends at rest.
///
/// A start speed up to a tenth above what the path allows is treated as a control error, and cut. Linear in the samples.
///
/// # Errors
/// [`SweepError::StartTooFast`].
///
/// ```
/// use nalgebra::Point2;
/// use zenav_smoothing::{GeometricPath, Limits, SweepError, fastest};
///
/// # let limits = Limits { wheel_speed: 0.6, wheel_acceleration: 0.75, half_separation: 0.2, speed: 0.5, lateral_acceleration: 0.5,
/// #     yaw_rate: 2.5, jerk: None };
/// // At most 0.5 m/s and 0.75 m/s².
/// let path = |length| GeometricPath::straight(Point2::origin(), Point2::new(length, 0.0), 0.02).unwrap();
/// let squared = fastest(&path(1.0), &limits, 0.0)?;
/// assert_eq!((squared[0], squared[25], squared[50]), (0.0, 0.25, 0.0));
/// let refused = fastest(&path(0.1), &limits, 0.5).unwrap_err();
/// assert!(matches!(refused, SweepError::StartTooFast { limit, .. } if limit < 0.4));
/// # Ok::<(), SweepError>(())
/// ```
pub fn fastest(path: &GeometricPath, limits: &Limits, start_speed: f64) -> Result<Vec<f64>, SweepError> {
    let [strictly, firmly, gently] = SLOWING_AHEAD;
    let below = |ahead| {
        fastest_below(
            ceilings_for(path, limits, start_speed, ahead),
            path,
            limits,
            start_speed,
        )
    };
    let strict = below(strictly);
    if strict.is_ok() || !path.has_speed_limits() {
        return strict;
    }
    below(firmly).or_else(|_| below(gently))
}

/// The fastest law below these squared speeds, m²/s², on the intervals.
fn fastest_below(
    mut squared: Vec<f64>,
    path: &GeometricPath,
    limits: &Limits,
    start_speed: f64,
) -> Result<Vec<f64>, SweepError> {
    // A sample takes the lower ceiling of the intervals beside it.
    squared.push(squared[squared.len() - 1]);
    for i in (1..squared.len() - 1).rev() {
        squared[i] = squared[i].min(squared[i - 1]);
    }
    if let Some(last) = squared.last_mut() {
        *last = 0.0;
    }
    let points = path.points();
    let mut intervals = Vec::with_capacity(points.len());
    for (i, pair) in points.windows(2).enumerate().rev() {
        let interval = Interval::new(&pair[0], &pair[1], limits, squared[i].max(squared[i + 1]));
        squared[i] = interval.largest_start(squared[i], squared[i + 1]);
        intervals.push(interval);
    }
    let allowed = squared[0].sqrt();
    if start_speed > 1.1 * allowed + 1e-3 {
        return Err(SweepError::StartTooFast {
            speed: start_speed,
            limit: allowed,
        });
    }
    squared[0] = squared[0].min(start_speed.max(0.0).powi(2));
    for (i, interval) in intervals.iter().rev().enumerate() {
        squared[i + 1] = interval.largest_end(squared[i], squared[i + 1]);
    }
    Ok(squared)
}

/// Largest squared speed (m²/s²) on every interval, by curvature and by the map's zones, for a law of [`fastest`].
///
/// A robot that is faster than a zone allows slows down in it; it does not stop.
///
/// # Panics
/// Without speeds.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_smoothing::{GeometricPath, Limits, ceilings, fastest};
///
/// # let limits = Limits { wheel_speed: 0.6, wheel_acceleration: 0.75, half_separation: 0.2, speed: 0.5, lateral_acceleration: 0.5,
/// #     yaw_rate: 2.5, jerk: None };
/// // A zone of 0.2 m/s begins at x = 1 m; elsewhere 0.5 m/s is the limit.
/// let zone = |at: Point2<f64>| (at.x > 1.0).then_some(0.2);
/// let path = GeometricPath::straight(Point2::origin(), Point2::new(2.0, 0.0), 0.02).unwrap().limited(&zone);
/// let squared = ceilings(&path, &limits, &fastest(&path, &limits, 0.0)?);
/// assert!((squared[0] - 0.25).abs() < 1e-9 && (squared[99] - 0.04).abs() < 1e-9);
/// # Ok::<(), zenav_smoothing::SweepError>(())
/// ```
#[must_use]
pub fn ceilings(path: &GeometricPath, limits: &Limits, squared: &[f64]) -> Vec<f64> {
    let start_speed = squared[0].sqrt();
    let holds = |ceilings: &Vec<f64>| {
        let reached = squared.windows(2).map(|pair| pair[0].max(pair[1]));
        reached
            .zip(ceilings)
            .all(|(reached, ceiling)| reached <= ceiling + 1e-9)
    };
    let mut tried = SLOWING_AHEAD
        .map(|ahead| ceilings_for(path, limits, start_speed, ahead))
        .into_iter();
    let gentle = tried.next_back().unwrap_or_default();
    tried.find(holds).unwrap_or(gentle)
}

/// The same for a given deceleration ahead of a zone (full braking: 2).
fn ceilings_for(path: &GeometricPath, limits: &Limits, start_speed: f64, ahead: f64) -> Vec<f64> {
    let begin = path.points()[0].s;
    let mut is_inside = true;
    let ceiling = |(i, pair): (usize, &[PathPoint])| {
        let own = limits.speed_squared(pair[0].k.abs().max(pair[1].k.abs()));
        let zone = path.speed_limit(i);
        is_inside &= zone < start_speed;
        let slowing = if is_inside { SLOWING } else { ahead };
        let slowing = start_speed * start_speed - slowing * limits.wheel_acceleration * (pair[0].s - begin);
        own.min(zone.powi(2).max(slowing))
    };
    path.points().windows(2).enumerate().map(ceiling).collect()
}

/// One interval's bounds on the squared speeds at its ends, `|end + slope · start| <= reach`: of the outer wheel at start and end, then
/// of the inner wheel at start and end.
struct Interval {
    slopes: [f64; 4],
    reaches: [f64; 4],
    /// Whether the inner wheel can be the first to reach its limit; if not, its bounds repeat the outer one's.
    inner: bool,
}

impl Interval {
    /// Squared speeds are at most `cap`.
    fn new(from: &PathPoint, to: &PathPoint, limits: &Limits, cap: f64) -> Self {
        let length = to.s - from.s;
        // a = (end - start) / (2 length), times 2 length: a wheel's acceleration is `(1 ± h k) (end - start) ± h k' b · 2 length`.
        let (h, limit) = (limits.half_separation, 2.0 * length * limits.wheel_acceleration);
        if from.k == 0.0 && to.k == 0.0 {
            return Self {
                slopes: [-1.0; 4],
                reaches: [limit; 4],
                inner: false,
            };
        }
        // Where the curvature changes slowly, `|k'| b <= A |k|`, the outer wheel's bounds imply the inner one's.
        let (k0, k1) = (from.k.abs(), to.k.abs());
        let same_side = from.k * to.k > 0.0 && h * k0.max(k1) < 1.0;
        let inner = !(same_side && 2.0 * (to.k - from.k).abs() * cap <= limit * k0.min(k1));
        let outer = if from.k + to.k > 0.0 { h } else { -h };
        let [(m0, r0), (m1, r1)] = Self::wheel(outer, from.k, to.k, limit);
        let [(m2, r2), (m3, r3)] = if inner {
            Self::wheel(-outer, from.k, to.k, limit)
        } else {
            [(m0, r0), (m1, r1)]
        };
        Self {
            slopes: [m0, m1, m2, m3],
            reaches: [r0, r1, r2, r3],
            inner,
        }
    }

    /// Slope and reach of a wheel at start and end.
    fn wheel(side: f64, k0: f64, k1: f64, limit: f64) -> [(f64, f64); 2] {
        let (p0, p1, q) = (1.0 + side * k0, 1.0 + side * k1, 2.0 * side * (k1 - k0));
        [bound(q - p0, p0, limit), bound(-p1, p1 + q, limit)]
    }

    /// The line `± reach - slope · start`.
    fn line(&self, i: usize, sign: f64, start: f64) -> f64 {
        sign * self.reaches[i] - self.slopes[i] * start
    }

    /// Largest squared speed at the end from `start`.
    fn upper(&self, start: f64) -> f64 {
        let outer = lesser(self.line(0, 1.0, start), self.line(1, 1.0, start));
        if self.inner {
            lesser(outer, lesser(self.line(2, 1.0, start), self.line(3, 1.0, start)))
        } else {
            outer
        }
    }

    /// Least squared speed at the end from `start`.
    fn lower(&self, start: f64) -> f64 {
        let outer = greater(self.line(0, -1.0, start), self.line(1, -1.0, start));
        if self.inner {
            greater(outer, greater(self.line(2, -1.0, start), self.line(3, -1.0, start)))
        } else {
            outer
        }
    }

    /// Largest squared speed at the end, at most `cap`, from `start`.
    fn largest_end(&self, start: f64, cap: f64) -> f64 {
        greater(lesser(cap, self.upper(start)), 0.0)
    }

    /// Largest squared speed at the start, at most `cap`, from which one at most `end_cap` can be reached.
    fn largest_start(&self, cap: f64, end_cap: f64) -> f64 {
        // Usually the braking of one wheel decides: `-reach - slope · start <= end_cap`.
        let braking = |i: usize| {
            if self.slopes[i] < 0.0 {
                (end_cap + self.reaches[i]) / -self.slopes[i]
            } else {
                f64::INFINITY
            }
        };
        let mut start = lesser(cap, lesser(braking(0), braking(1)));
        if self.inner {
            start = lesser(start, lesser(braking(2), braking(3)));
        }
        if self.upper(start) >= greater(self.lower(start), 0.0) {
            start
        } else {
            self.corner(start, end_cap)
        }
    }

    /// The feasible pairs form a convex polygon that contains (0, 0): Newton steps from above descend to its corner, each to the crossing
    /// of the two bounds that disagree most.
    #[cold]
    fn corner(&self, above: f64, end_cap: f64) -> f64 {
        let mut start = above;
        for _ in 0..16 {
            // The tightest lower and upper bound of the end (value at zero, slope) at this start.
            let at = |line: (f64, f64)| line.0 + line.1 * start;
            let (mut low, mut high) = ((0.0, 0.0), (end_cap, 0.0));
            for (slope, reach) in self.slopes.into_iter().zip(self.reaches) {
                let (below, above) = ((-reach, -slope), (reach, -slope));
                if at(below) > at(low) {
                    low = below;
                }
                if at(above) < at(high) {
                    high = above;
                }
            }
            if at(low) <= at(high) {
                return start;
            }
            let next = (high.0 - low.0) / (low.1 - high.1);
            // Rounding may leave the corner slightly outside for ever.
            if next.is_nan() || next >= start {
                return start * (1.0 - 1e-12);
            }
            start = next.max(0.0);
        }
        start
    }
}

/// `|start · x + end · y| <= limit` as slope and reach.
fn bound(start: f64, end: f64, limit: f64) -> (f64, f64) {
    // A bound that hardly depends on the end is one of the start alone.
    let end = if end.abs() < LEAST { LEAST.copysign(end) } else { end };
    let inverse = end.recip();
    (start * inverse, limit * inverse.abs())
}

/// `f64::min` handles NaN, which takes several times as long, in the critical chain of the sweep.
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// Like [`lesser`].
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// Least factor of the end in a bound.
const LEAST: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;
    use proptest::prelude::*;

    const LIMITS: Limits = Limits {
        wheel_speed: 0.6,
        wheel_acceleration: 0.75,
        half_separation: 0.2,
        speed: 0.6,
        lateral_acceleration: 0.5,
        yaw_rate: 2.5,
        jerk: None,
    };

    fn duration(path: &GeometricPath, squared: &[f64]) -> f64 {
        path.points()
            .windows(2)
            .zip(squared.windows(2))
            .map(|(p, b)| 2.0 * (p[1].s - p[0].s) / (b[0].sqrt() + b[1].sqrt()))
            .sum()
    }

    #[test]
    fn a_straight_line_is_a_trapezoid() {
        let path = GeometricPath::straight(Point2::origin(), Point2::new(6.0, 0.0), 0.01).unwrap();
        let squared = fastest(&path, &LIMITS, 0.0).unwrap();
        let expected = 6.0 / 0.6 + 0.6 / 0.75;
        assert!(
            (duration(&path, &squared) - expected).abs() < 1e-3,
            "{} against {expected}",
            duration(&path, &squared)
        );
    }

    #[test]
    fn a_start_that_cannot_stop_in_time_is_refused() {
        let path = GeometricPath::straight(Point2::origin(), Point2::new(0.1, 0.0), 0.01).unwrap();
        assert!(matches!(
            fastest(&path, &LIMITS, 0.6),
            Err(SweepError::StartTooFast { .. })
        ));
    }

    #[test]
    fn a_zone_is_driven_through_at_its_speed_and_entered_too_fast_it_slows_the_robot_down() {
        let straight = || GeometricPath::straight(Point2::origin(), Point2::new(6.0, 0.0), 0.02).unwrap();
        let zone = |p: Point2<f64>| (2.0..4.0).contains(&p.x).then_some(0.2);
        let path = straight().limited(&zone);
        let squared = fastest(&path, &LIMITS, 0.0).unwrap();
        for (p, b) in path.points().iter().zip(&squared) {
            let inside = p.x > 1.985 && p.x < 4.0;
            assert!(!inside || b.sqrt() <= 0.2 + 1e-9);
        }
        assert!(squared.iter().any(|b| b.sqrt() > 0.55), "outside it is as fast as ever");
        let everywhere = |_: Point2<f64>| Some(0.2);
        let squared = fastest(&straight().limited(&everywhere), &LIMITS, 0.5).unwrap();
        assert_eq!(squared[0], 0.25);
        assert!(squared[50] <= 0.04 + 1e-9, "slow after a metre");
        // A robot that can slow down for a zone does: 0.5² - 2 A s is below 0.2² after 0.14 m.
        let ahead = |p: Point2<f64>| (p.x > 0.4).then_some(0.2);
        let path = straight().limited(&ahead);
        let squared = fastest(&path, &LIMITS, 0.5).unwrap();
        assert!(
            path.points()
                .iter()
                .zip(&squared)
                .all(|(p, b)| p.x < 0.4 || b.sqrt() <= 0.2 + 1e-9)
        );
        // A zone that is too near is entered as slowly as possible.
        let near = |p: Point2<f64>| (p.x > 0.1).then_some(0.2);
        let path = straight().limited(&near);
        let squared = fastest(&path, &LIMITS, 0.5).unwrap();
        let (p, b) = path.points().iter().zip(&squared).find(|(p, _)| p.x > 0.11).unwrap();
        let braked = 0.25 - 2.0 * LIMITS.wheel_acceleration * p.x;
        assert!((braked - 1e-9..braked + 0.04).contains(b), "{b} {braked}");
        assert_eq!(ceilings(&path, &LIMITS, &squared).len(), path.points().len() - 1);
    }

    proptest! {
        #[test]
        fn every_limit_holds_at_and_between_samples(turns in prop::collection::vec((-6.0..6.0_f64, 2_usize..30), 1..8), start in 0.0..0.6) {
            let mut k = 0.0;
            let mut links = Vec::new();
            for (target, samples) in turns {
                links.extend((1..=samples).map(|i| (0.02, k + (target - k) * i as f64 / samples as f64)));
                k = target;
            }
            let path = GeometricPath::chain(PathPoint::default(), &links).unwrap();
            let Ok(squared) = fastest(&path, &LIMITS, start) else { return Ok(()) };
            prop_assert_eq!(squared[squared.len() - 1], 0.0);
            for (pair, b) in path.points().windows(2).zip(squared.windows(2)) {
                let length = pair[1].s - pair[0].s;
                let a = (b[1] - b[0]) / (2.0 * length);
                let slope = (pair[1].k - pair[0].k) / length;
                for u in [0.0, 0.3, 0.5, 0.8, 1.0] {
                    let (k, b) = (pair[0].k + u * (pair[1].k - pair[0].k), b[0] + u * (b[1] - b[0]));
                    prop_assert!(b >= 0.0);
                    for wheel in [1.0, -1.0] {
                        prop_assert!((b.sqrt() * (1.0 + wheel * k * 0.2)).abs() <= 0.6 + 1e-9);
                        prop_assert!((a * (1.0 + wheel * k * 0.2) + wheel * 0.2 * slope * b).abs() <= 0.75 + 1e-9);
                    }
                    prop_assert!(b * k.abs() <= 0.5 + 1e-9 && b.sqrt() * k.abs() <= 2.5 + 1e-9);
                }
            }
        }

        #[test]
        fn the_start_is_the_corner_of_what_can_be_reached(k0 in -8.0..8.0_f64, k1 in -8.0..8.0_f64, cap in 0.001..0.4, end_cap in 0.0..0.4) {
            let interval = Interval::new(&PathPoint { k: k0, ..PathPoint::default() }, &PathPoint { s: 0.02, k: k1, ..PathPoint::default() }, &LIMITS, f64::max(cap, end_cap));
            let feasible = |x: f64| (0..=4000).any(|i| {
                let y = end_cap * f64::from(i) / 4000.0;
                interval.slopes.iter().zip(interval.reaches).all(|(slope, reach)| f64::abs(slope * x + y) <= reach + 1e-9)
            });
            let found = interval.largest_start(cap, end_cap);
            prop_assert!(found >= 0.0 && found <= cap);
            let scan = (0..=200).map(|i| cap * f64::from(i) / 200.0).filter(|&x| feasible(x)).fold(0.0, f64::max);
            prop_assert!(found >= scan - 1e-9, "{} below {}", found, scan);
            let end = interval.largest_end(found, end_cap);
            prop_assert!(interval.slopes.iter().zip(interval.reaches).all(|(slope, reach)| f64::abs(slope * found + end) <= reach + 1e-9 * (1.0 + reach)));
        }
    }
}
