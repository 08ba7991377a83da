//! What is the fastest law along a way? Two passes over the squared speed `b = v²`, exact for its samples.
//!
//! Between two samples the acceleration `a` is constant, `b` is linear in the arc length and the curvature too, so that both wheels'
//! accelerations `a (1 ± k h) ± h k' b` are linear there: they are bounded where they are bounded at both ends. The backward pass finds
//! the largest `b` from which the end can still be reached, the forward pass takes the largest step into it.
//!
//! Source: Pham and Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis", T-RO 2018.

use super::limits::Limits;
use super::path::{GeometricPath, PathPoint};

/// Why there is no law.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SweepError {
    /// The way is too tight, or too short, for the speed at its start.
    #[error("start speed {speed:.3} m/s: the way allows {limit:.3} m/s")]
    StartTooFast {
        /// Speed at the start, m/s.
        speed: f64,
        /// What the way allows there, m/s.
        limit: f64,
    },
}

/// Squared speed that a robot loses for each metre in a zone that it entered too fast, as a share of the wheels' acceleration (of 2).
const SLOWING: f64 = 1.0;

/// Squared speed (m²/s²) at every sample: the fastest law that starts at `start_speed` (m/s, not negative) and ends at rest.
///
/// A start speed up to a tenth over what the way allows is taken as an error of control, and cut. Linear in the samples.
///
/// # Errors
/// [`SweepError::StartTooFast`].
pub fn fastest(path: &GeometricPath, limits: &Limits, start_speed: f64) -> Result<Vec<f64>, SweepError> {
    let points = path.points();
    let intervals: Vec<Interval> = points
        .windows(2)
        .map(|pair| Interval::new(&pair[0], &pair[1], limits))
        .collect();
    let mut squared = ceilings(path, limits, start_speed);
    // A sample has the lower one of the intervals beside it.
    squared.push(squared[squared.len() - 1]);
    for i in (1..squared.len() - 1).rev() {
        squared[i] = squared[i].min(squared[i - 1]);
    }
    if let Some(last) = squared.last_mut() {
        *last = 0.0;
    }
    for i in (0..intervals.len()).rev() {
        squared[i] = intervals[i].largest_start(squared[i], squared[i + 1]);
    }
    let allowed = squared[0].sqrt();
    if start_speed > 1.1 * allowed + 1e-3 {
        return Err(SweepError::StartTooFast {
            speed: start_speed,
            limit: allowed,
        });
    }
    squared[0] = squared[0].min(start_speed.max(0.0).powi(2));
    for i in 0..intervals.len() {
        squared[i + 1] = intervals[i].largest_end(squared[i], squared[i + 1]);
    }
    Ok(squared)
}

/// Largest squared speed (m²/s²) on every interval, by curvature and by the map's zones.
///
/// A robot that is faster than a zone allows slows down in it, it does not stop.
#[must_use]
pub fn ceilings(path: &GeometricPath, limits: &Limits, start_speed: f64) -> Vec<f64> {
    let begin = path.points()[0].s;
    let ceiling = |(i, pair): (usize, &[PathPoint])| {
        let own = limits.speed_squared(pair[0].k.abs().max(pair[1].k.abs()));
        let slowing = start_speed * start_speed - SLOWING * limits.wheel_acceleration * (pair[0].s - begin);
        own.min(path.speed_limit(i).powi(2).max(slowing))
    };
    path.points().windows(2).enumerate().map(ceiling).collect()
}

/// One interval's bounds, each `x * start + y * end <= limit` on the squared speeds at its ends.
struct Interval {
    bounds: [(f64, f64); 8],
    limit: f64,
}

impl Interval {
    fn new(from: &PathPoint, to: &PathPoint, limits: &Limits) -> Self {
        let length = to.s - from.s;
        let slope = (to.k - from.k) / length;
        let h = limits.half_separation;
        // a = (end - start) / (2 length)
        let per_acceleration = 0.5 / length;
        let mut bounds = [(0.0, 0.0); 8];
        for (i, (wheel, at_end)) in [(1.0, false), (-1.0, false), (1.0, true), (-1.0, true)]
            .into_iter()
            .enumerate()
        {
            let p = (1.0 + wheel * h * if at_end { to.k } else { from.k }) * per_acceleration;
            let q = wheel * h * slope;
            let (x, y) = if at_end { (-p, p + q) } else { (q - p, p) };
            bounds[2 * i] = (x, y);
            bounds[2 * i + 1] = (-x, -y);
        }
        Self {
            bounds,
            limit: limits.wheel_acceleration,
        }
    }

    /// Largest squared speed at the end, at most `cap`, from `start`.
    fn largest_end(&self, start: f64, cap: f64) -> f64 {
        let upper = |&(x, y): &(f64, f64)| {
            if y > 0.0 {
                (self.limit - x * start) / y
            } else {
                f64::INFINITY
            }
        };
        self.bounds.iter().map(upper).fold(cap, f64::min).max(0.0)
    }

    /// Largest squared speed at the start, at most `cap`, from which one at most `end_cap` can be reached.
    ///
    /// The feasible pairs are a convex polygon with (0, 0) in it: Newton's steps from the cap go down to its corner, each to the
    /// crossing of the two bounds that disagree most.
    fn largest_start(&self, cap: f64, end_cap: f64) -> f64 {
        let mut start = cap;
        for _ in 0..16 {
            // Of the end's lower and upper bounds (offset, slope over start) the tightest at this start.
            let (mut low, mut low_line) = (0.0, (0.0, 0.0));
            let (mut high, mut high_line) = (end_cap, (end_cap, 0.0));
            let mut beyond = f64::INFINITY;
            for &(x, y) in &self.bounds {
                if y > 1e-12 {
                    let value = (self.limit - x * start) / y;
                    if value < high {
                        (high, high_line) = (value, (self.limit / y, -x / y));
                    }
                } else if y < -1e-12 {
                    let value = (self.limit - x * start) / y;
                    if value > low {
                        (low, low_line) = (value, (self.limit / y, -x / y));
                    }
                } else if x > 0.0 {
                    beyond = beyond.min(self.limit / x);
                }
            }
            if low <= high && start <= beyond {
                return start;
            }
            let crossing = (high_line.0 - low_line.0) / (low_line.1 - high_line.1);
            let next = if low > high { crossing.min(beyond) } else { beyond };
            // Rounding may leave the corner a hair outside for ever.
            if next.is_nan() || next >= start {
                return start.min(next).max(0.0) * (1.0 - 1e-12);
            }
            start = next.max(0.0);
        }
        start
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
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
            let interval = Interval::new(&PathPoint { k: k0, ..PathPoint::default() }, &PathPoint { s: 0.02, k: k1, ..PathPoint::default() }, &LIMITS);
            let feasible = |x: f64| (0..=4000).any(|i| {
                let y = end_cap * f64::from(i) / 4000.0;
                interval.bounds.iter().all(|(bx, by)| bx * x + by * y <= interval.limit + 1e-9)
            });
            let found = interval.largest_start(cap, end_cap);
            prop_assert!(found >= 0.0 && found <= cap);
            let scan = (0..=200).map(|i| cap * f64::from(i) / 200.0).filter(|&x| feasible(x)).fold(0.0, f64::max);
            prop_assert!(found >= scan - 1e-9, "{} below {}", found, scan);
            let end = interval.largest_end(found, end_cap);
            prop_assert!(interval.bounds.iter().all(|(x, y)| x * found + y * end <= interval.limit + 1e-6));
        }
    }
}
