//! Geometric path. A path by arc length, as a chain of clothoids: curvature is continuous, and linear in the arc length between samples.
//!
//! Heading and position are the integrals of the curvature, so a robot that follows the path at `v` turns at exactly `k v`, at every time
//! and not only at the samples; the limits of a drive, linear between samples as well, hold there too. A curve becomes a chain by
//! projecting its curvature onto the piecewise linear functions: the residual is orthogonal to them, so neither heading nor position
//! drifts. The remaining error is removed by the least change of curvature that leads to the curve's end.
//!
//! Sources: Bertolazzi and Frego, "On the G2 Hermite Interpolation Problem with Clothoids", J. Comp. Appl. Math. 2018 (the chain);
//! Strang and Fix, "An Analysis of the Finite Element Method", 1973 (the projection).

use nalgebra::{Matrix3, Point2, Vector3};
use zenav_protocol::geometry::Pose2;

/// A sample of a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathPoint {
    /// Arc length from the beginning, m.
    pub s: f64,
    /// Map x, m.
    pub x: f64,
    /// Map y, m.
    pub y: f64,
    /// Heading, rad; not wrapped, so that neighbours differ by little.
    pub yaw: f64,
    /// Curvature, 1/m, positive to the left.
    pub k: f64,
}

impl PathPoint {
    /// Its position, map frame, m.
    #[must_use]
    pub fn position(&self) -> Point2<f64> {
        Point2::new(self.x, self.y)
    }

    /// Its pose, map frame; its heading is not wrapped either.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        let Self { x, y, yaw, .. } = *self;
        Pose2 { x, y, yaw }
    }
}

/// Speed limit at a place of the map, m/s; `None` if only the robot's own limit applies.
pub type SpeedLimit<'a> = &'a dyn Fn(Point2<f64>) -> Option<f64>;

/// No speed limit anywhere.
pub const UNRESTRICTED: SpeedLimit<'static> = &|_| None;

/// Slowest speed limit that counts, m/s: a path through a zone that may not be driven at all has no time law.
const SLOWEST: f64 = 0.01;

/// A path with a continuous heading: at least two samples, arc length strictly rising.
#[derive(Clone, Debug, PartialEq)]
pub struct GeometricPath {
    points: Vec<PathPoint>,
    /// Speed limit at each sample, m/s, infinite if there is none; empty if there is none anywhere.
    speed_limits: Vec<f64>,
}

impl GeometricPath {
    /// The chain through samples of a smooth curve. The first and the last pose are the curve's, the others match it to within the square
    /// of the distance between samples. `None` for fewer than two samples, for non-finite numbers, if the arc length does not rise, and
    /// if the path turns by more than a radian from one sample to the next.
    ///
    /// ```
    /// use zenav_smoothing::{GeometricPath, PathPoint};
    ///
    /// let at = |s, x| PathPoint { s, x, ..PathPoint::default() };
    /// let path = GeometricPath::new(vec![at(0.0, 0.0), at(0.5, 0.5), at(2.0, 2.0)]).unwrap();
    /// assert_eq!(path.length(), 2.0);
    /// assert!(GeometricPath::new(vec![at(0.0, 0.0), at(0.0, 1.0)]).is_none(), "the arc length must rise");
    /// ```
    #[must_use]
    pub fn new(mut points: Vec<PathPoint>) -> Option<Self> {
        let finite = points
            .iter()
            .all(|p| p.s.is_finite() && p.x.is_finite() && p.y.is_finite() && p.yaw.is_finite() && p.k.is_finite());
        let rising = points.windows(2).all(|pair| pair[1].s > pair[0].s);
        let gentle = |pair: &[PathPoint]| {
            let length = pair[1].s - pair[0].s;
            (pair[1].yaw - pair[0].yaw).abs() <= LARGEST_TURN
                && pair.iter().all(|p| p.k.abs() * length <= 2.0 * LARGEST_TURN)
        };
        if points.len() < 2 || !finite || !rising || !points.windows(2).all(gentle) {
            return None;
        }
        let end = points[points.len() - 1];
        if points.iter().any(|p| p.k != 0.0) || end.yaw != points[0].yaw {
            let k = points[0].k;
            project(&mut points);
            begin_with(k, &mut points);
        }
        integrate(&mut points);
        for _ in 0..3 {
            if !close(&mut points, &end) {
                break;
            }
            integrate(&mut points);
        }
        if let Some(last) = points.last_mut().filter(|p| (p.x - end.x).hypot(p.y - end.y) < 1e-9) {
            (last.x, last.y) = (end.x, end.y);
        }
        Some(Self {
            points,
            speed_limits: Vec::new(),
        })
    }

    /// The chain that begins at a pose (s, x, y, yaw and curvature) and continues by links, each with a length (m, positive) and an end
    /// curvature (1/m).
    ///
    /// `None` as in [`Self::new`].
    ///
    /// ```
    /// use std::f64::consts::FRAC_PI_2;
    /// use zenav_smoothing::{GeometricPath, PathPoint};
    ///
    /// // A quarter of a circle of 1 m radius to the left, from the origin along x.
    /// let start = PathPoint { k: 1.0, ..PathPoint::default() };
    /// let path = GeometricPath::chain(start, &[(FRAC_PI_2 / 16.0, 1.0); 16]).unwrap();
    /// let end = path.points()[16];
    /// assert!((end.x - 1.0).abs() < 1e-6 && (end.y - 1.0).abs() < 1e-6 && (end.yaw - FRAC_PI_2).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn chain(start: PathPoint, links: &[(f64, f64)]) -> Option<Self> {
        let mut points = vec![start];
        let mut last = start;
        for &(length, k) in links {
            let turn = 0.5 * (last.k + k) * length;
            if !(length > 0.0 && turn.abs() <= LARGEST_TURN) {
                return None;
            }
            last = PathPoint {
                s: last.s + length,
                yaw: last.yaw + turn,
                k,
                ..last
            };
            points.push(last);
        }
        integrate(&mut points);
        let sound = points.len() > 1 && points.iter().all(|p| (p.s + p.x + p.y + p.yaw + p.k).is_finite());
        sound.then_some(Self {
            points,
            speed_limits: Vec::new(),
        })
    }

    /// A straight line, sampled about every `step` metres; `None` when it has no length.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_smoothing::GeometricPath;
    ///
    /// let path = GeometricPath::straight(Point2::new(1.0, 1.0), Point2::new(4.0, 5.0), 0.02).unwrap();
    /// assert!((path.length() - 5.0).abs() < 1e-9 && path.points().len() == 251);
    /// assert!(GeometricPath::straight(Point2::origin(), Point2::origin(), 0.02).is_none());
    /// ```
    #[must_use]
    pub fn straight(from: Point2<f64>, to: Point2<f64>, step: f64) -> Option<Self> {
        let along = to - from;
        let length = along.norm();
        if !length.is_finite() || length <= 1e-9 {
            return None;
        }
        // Few samples clip the speed's peak, many cost memory: both are bounded.
        let pieces = (length / step).ceil().clamp(8.0, 4096.0) as usize;
        let yaw = along.y.atan2(along.x);
        let at = |i: usize| {
            let share = i as f64 / pieces as f64;
            let p = from + along * share;
            PathPoint {
                s: length * share,
                x: p.x,
                y: p.y,
                yaw,
                k: 0.0,
            }
        };
        Self::new((0..=pieces).map(at).collect())
    }

    /// The same path with the speed limits of the map's zones. A limit holds on both intervals beside its sample.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_smoothing::GeometricPath;
    ///
    /// // A zone that begins at x = 1 m.
    /// let zone = |at: Point2<f64>| (at.x > 1.0).then_some(0.2);
    /// let path = GeometricPath::straight(Point2::origin(), Point2::new(2.0, 0.0), 0.02).unwrap().limited(&zone);
    /// assert!(path.speed_limit(0).is_infinite() && path.speed_limit(99) == 0.2);
    /// ```
    #[must_use]
    pub fn limited(mut self, speed_limit: SpeedLimit<'_>) -> Self {
        let limits = self
            .points
            .iter()
            .map(|p| speed_limit(p.position()).map_or(f64::INFINITY, |limit| limit.max(SLOWEST)));
        let limits: Vec<f64> = limits.collect();
        self.speed_limits = if limits.iter().all(|limit| limit.is_infinite()) {
            Vec::new()
        } else {
            limits
        };
        self
    }

    /// Whether a zone limits its speed anywhere.
    #[must_use]
    pub fn has_speed_limits(&self) -> bool {
        !self.speed_limits.is_empty()
    }

    /// Speed limit from sample `index` to the next, m/s; infinite if there is none.
    #[must_use]
    pub fn speed_limit(&self, index: usize) -> f64 {
        match self.speed_limits.get(index..index + 2) {
            Some([from, to]) => from.min(*to),
            _ => f64::INFINITY,
        }
    }

    /// The samples.
    #[must_use]
    pub fn points(&self) -> &[PathPoint] {
        &self.points
    }

    /// Length, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.points[self.points.len() - 1].s - self.points[0].s
    }

    /// Change of the curvature after sample `index` (which has a successor), 1/m².
    #[must_use]
    pub fn slope(&self, index: usize) -> f64 {
        let (from, to) = (&self.points[index], &self.points[index + 1]);
        (to.k - from.k) / (to.s - from.s)
    }

    /// The point `ds` metres after sample `index` (which has a successor).
    #[must_use]
    pub fn between(&self, index: usize, ds: f64) -> PathPoint {
        let (from, to) = (&self.points[index], &self.points[index + 1]);
        let length = to.s - from.s;
        let ds = ds.clamp(0.0, length);
        along(from, from.k + (to.k - from.k) * ds / length, ds)
    }
}

/// Largest turn from one sample to the next, rad.
const LARGEST_TURN: f64 = 1.0;

/// The end of a clothoid of the given length from a point, with the curvature `k` at its end.
fn along(from: &PathPoint, k: f64, length: f64) -> PathPoint {
    // About the middle the heading is `turn u + bend u² / 2`, u from -1/2 to 1/2: its sine and cosine are integrated as series.
    let (turn, bend) = (0.5 * (from.k + k) * length, (k - from.k) * length);
    let (t2, b2) = (turn * turn, bend * bend);
    let second = t2 / 12.0 + b2 / 320.0;
    let fourth = t2 * t2 / 80.0 + t2 * b2 * (3.0 / 896.0) + b2 * b2 / 36864.0;
    let sixth = t2 * t2 * t2 / 448.0 + t2 * t2 * b2 * (5.0 / 3072.0);
    let forward = 1.0 - second / 2.0 + fourth / 24.0 - sixth / 720.0;
    let third = t2 * bend * (3.0 / 160.0) + bend * b2 / 3584.0;
    let fifth = t2 * t2 * bend * (5.0 / 896.0) + t2 * bend * b2 * (5.0 / 9216.0);
    let sideways = bend / 24.0 - third / 6.0 + fifth / 120.0;
    // Heading at the middle: half the turn, less the bend's part of it.
    let (sin, cos) = (from.yaw + 0.5 * turn - 0.125 * bend).sin_cos();
    PathPoint {
        s: from.s + length,
        x: from.x + length * (forward * cos - sideways * sin),
        y: from.y + length * (forward * sin + sideways * cos),
        yaw: from.yaw + turn,
        k,
    }
}

/// Integrates headings and positions from the first point on, by the curvatures and arc lengths.
fn integrate(points: &mut [PathPoint]) {
    for i in 1..points.len() {
        let length = points[i].s - points[i - 1].s;
        let s = points[i].s;
        points[i] = PathPoint {
            s,
            ..along(&points[i - 1], points[i].k, length)
        };
    }
}

/// Projects a curve's curvature, of which the samples give value and integral, onto the nearest piecewise linear function.
fn project(points: &mut [PathPoint]) {
    // Between samples the curve's curvature is taken as quadratic, by both ends and the integral, which is the turn.
    let moments = |from: &PathPoint, to: &PathPoint| {
        let length = to.s - from.s;
        let bulge = 0.5 * (to.yaw - from.yaw) - 0.25 * length * (from.k + to.k);
        (
            length * (from.k / 3.0 + to.k / 6.0) + bulge,
            length * (from.k / 6.0 + to.k / 3.0) + bulge,
        )
    };
    // Tridiagonal system: elimination downwards, substitution upwards.
    let mut rows: Vec<(f64, f64)> = Vec::with_capacity(points.len());
    let (mut coupling, mut diagonal, mut side) = (0.0, 0.0, 0.0);
    for i in 0..points.len() {
        let next = points.get(i + 1);
        let length = next.map_or(0.0, |to| to.s - points[i].s);
        let (first, second) = next.map_or((0.0, 0.0), |to| moments(&points[i], to));
        let (above, value) = rows.last().copied().unwrap_or_default();
        let pivot = diagonal + length / 3.0 - coupling * above;
        rows.push((length / 6.0 / pivot, (side + first - coupling * value) / pivot));
        (coupling, diagonal, side) = (length / 6.0, length / 3.0, second);
    }
    let mut below = 0.0;
    for (point, (above, value)) in points.iter_mut().zip(&rows).rev() {
        below = value - above * below;
        point.k = below;
    }
}

/// Sets the first sample's curvature: a moving robot continues its turn. The next two samples compensate for heading and position.
fn begin_with(k: f64, points: &mut [PathPoint]) {
    let [a, b, c, d, ..] = points else { return };
    let change = k - a.k;
    // Integral of each hat function, and its mean distance from the first sample.
    let origin = a.s;
    let (first, second, third) = (b.s - a.s, c.s - a.s, d.s - b.s);
    let from = |sum: f64| sum / 3.0 - origin;
    let (near, middle, far) = (from(2.0 * a.s + b.s), from(a.s + b.s + c.s), from(b.s + c.s + d.s));
    b.k -= change * first / second * (far - near) / (far - middle);
    c.k += change * first / third * (middle - near) / (far - middle);
    a.k = k;
}

/// Applies the least change of curvatures and length that leads to an end, to first order; returns whether there was anything to change.
fn close(points: &mut [PathPoint], end: &PathPoint) -> bool {
    let (first, last) = (points[0], points[points.len() - 1]);
    let off = Vector3::new(end.x - last.x, end.y - last.y, end.yaw - last.yaw);
    if off.amax() < 1e-12 {
        return false;
    }
    // Effect of a change of each curvature, and of the scale, on the end.
    let length = last.s - first.s;
    let share = |i: usize| {
        let before = i.checked_sub(1).map_or(0.0, |j| points[i].s - points[j].s);
        let after = points.get(i + 1).map_or(0.0, |next| next.s - points[i].s);
        0.5 * (before + after)
    };
    let effect = |p: &PathPoint| Vector3::new(p.y - last.y, last.x - p.x, 1.0);
    let scale = Vector3::new(last.x - first.x, last.y - first.y, 0.0);
    let mut normal = scale * scale.transpose() / length;
    // The first curvature is the robot's own, and stays.
    for (i, point) in points.iter().enumerate().skip(1) {
        let effect = effect(point);
        normal += effect * effect.transpose() * share(i);
    }
    let Some(pull) = invert(&normal).map(|inverse| inverse * off) else {
        return false;
    };
    let stretch = 1.0 + scale.dot(&pull) / length;
    if !(0.5..2.0).contains(&stretch) {
        return false;
    }
    for (i, point) in points.iter_mut().enumerate() {
        point.k = (point.k + if i > 0 { effect(point).dot(&pull) } else { 0.0 }) / stretch;
        point.s = first.s + (point.s - first.s) * stretch;
    }
    true
}

/// The inverse of a symmetric matrix of positions and an angle, whose rows differ in units.
fn invert(normal: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let units = Vector3::from_fn(|i, _| normal[(i, i)].sqrt().max(1e-150).recip());
    let scaled = Matrix3::from_fn(|i, j| normal[(i, j)] * units[i] * units[j]);
    let inverse = scaled.try_inverse().filter(|inverse| inverse.amax() < 1e9)?;
    Some(Matrix3::from_fn(|i, j| inverse[(i, j)] * units[i] * units[j]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A curve whose heading is `bend · sin(wave s)` and a turn, by Simpson's rule in small steps.
    fn wavy(length: f64, bend: f64, wave: f64, turn: f64, step: f64) -> Vec<PathPoint> {
        let yaw = |s: f64| bend * (wave * s).sin() + turn * s;
        let k = |s: f64| bend * wave * (wave * s).cos() + turn;
        let samples = (length / step).ceil() as usize;
        let h = length / samples as f64;
        let mut points = vec![PathPoint {
            yaw: yaw(0.0),
            k: k(0.0),
            ..PathPoint::default()
        }];
        for i in 1..=samples {
            let mut last = points[i - 1];
            let fine = h / 16.0;
            for j in 0..16 {
                let s = h * (i - 1) as f64 + fine * f64::from(j);
                let simpson =
                    |f: fn(f64) -> f64| fine / 6.0 * (f(yaw(s)) + 4.0 * f(yaw(s + 0.5 * fine)) + f(yaw(s + fine)));
                last.x += simpson(f64::cos);
                last.y += simpson(f64::sin);
            }
            let s = h * i as f64;
            points.push(PathPoint {
                s,
                yaw: yaw(s),
                k: k(s),
                ..last
            });
        }
        points
    }

    #[test]
    fn a_line_stays_a_line_to_the_last_bit_and_an_arc_an_arc() {
        let line = GeometricPath::straight(Point2::new(1.0, 2.0), Point2::new(4.0, 6.0), 0.1).unwrap();
        let end = line.points()[line.points().len() - 1];
        assert!((end.x - 4.0).abs() < 1e-12 && (end.y - 6.0).abs() < 1e-12 && line.points().iter().all(|p| p.k == 0.0));
        let arc = GeometricPath::new(wavy(3.0, 0.0, 1.0, 0.5, 0.1)).unwrap();
        for p in arc.points() {
            assert!((p.k - 0.5).abs() < 1e-9 && (p.x - 2.0 * (0.5 * p.s).sin()).abs() < 1e-9);
        }
    }

    #[test]
    fn what_is_no_way_is_refused() {
        let at = |s: f64, yaw: f64, k: f64| PathPoint {
            s,
            yaw,
            k,
            ..PathPoint::default()
        };
        assert!(GeometricPath::new(vec![]).is_none() && GeometricPath::new(vec![at(0.0, 0.0, 0.0)]).is_none());
        for second in [
            at(0.0, 0.0, 0.0),
            at(0.1, 2.0, 0.0),
            at(0.1, 0.0, 60.0),
            at(0.1, f64::NAN, 0.0),
            at(f64::INFINITY, 0.0, 0.0),
        ] {
            assert!(
                GeometricPath::new(vec![at(0.0, 0.0, 0.0), second]).is_none(),
                "{second:?}"
            );
        }
        assert!(GeometricPath::chain(PathPoint::default(), &[]).is_none());
    }

    proptest! {
        #[test]
        fn a_chain_keeps_to_its_curve_and_ends_where_it_ends(length in 0.3..60.0_f64, bend in -1.0..1.0_f64, wave in 0.1..4.0_f64, turn in -0.5..0.5_f64) {
            let curve = wavy(length, bend, wave, turn, 0.02);
            let path = GeometricPath::new(curve.clone()).unwrap();
            for (p, q) in path.points().iter().zip(&curve) {
                prop_assert!((p.x - q.x).hypot(p.y - q.y) < 1e-6 * (1.0 + bend.abs() * wave.powi(3)), "{} m off after {}", (p.x - q.x).hypot(p.y - q.y), q.s);
                prop_assert!((p.yaw - q.yaw).abs() < 1e-4 && (p.k - q.k).abs() < 1e-2);
            }
            let (first, last, end) = (path.points()[0], path.points()[curve.len() - 1], curve[curve.len() - 1]);
            prop_assert!((last.x - end.x).hypot(last.y - end.y) < 1e-9 && (last.yaw - end.yaw).abs() < 1e-9);
            prop_assert!((first.k - curve[0].k).abs() < 1e-6);
        }

        #[test]
        fn place_and_heading_are_integrals_of_the_curvature(k in prop::array::uniform2(-12.0..12.0_f64), length in 0.001..0.05_f64, yaw in -3.0..3.0_f64, share in 0.0..1.0_f64) {
            let path = GeometricPath::chain(PathPoint { yaw, k: k[0], ..PathPoint::default() }, &[(length, k[1])]).unwrap();
            let (mut x, mut y) = (0.0, 0.0);
            let steps = 2000;
            let ds = share * length / f64::from(steps);
            for i in 0..steps {
                let middle = path.between(0, ds * (f64::from(i) + 0.5));
                prop_assert!((middle.k - (k[0] + (k[1] - k[0]) * middle.s / length)).abs() < 1e-9);
                (x, y) = (x + ds * middle.yaw.cos(), y + ds * middle.yaw.sin());
            }
            let there = path.between(0, share * length);
            prop_assert!((there.x - x).hypot(there.y - y) < 1e-7 * length, "{}", (there.x - x).hypot(there.y - y) / length);
            prop_assert!((there.yaw - yaw - 0.5 * (k[0] + there.k) * there.s).abs() < 1e-12);
        }
    }
}
