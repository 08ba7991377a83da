//! Where does a way run, by arc length? Samples with heading and curvature, and what lies between them.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::wrap_angle;

/// A sample of a way.
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

/// Largest speed at a place of the map, m/s; `None` where there is no limit but the robot's own.
pub type SpeedLimit<'a> = &'a dyn Fn(Point2<f64>) -> Option<f64>;

/// No place has a speed limit.
pub const UNRESTRICTED: SpeedLimit<'static> = &|_| None;

/// Slowest speed limit that counts, m/s: a way through a zone that may not be driven at all has no time law.
const SLOWEST: f64 = 0.01;

/// A way with a continuous heading: at least two samples, arc length strictly rising.
#[derive(Clone, Debug, PartialEq)]
pub struct GeometricPath {
    points: Vec<PathPoint>,
    /// Speed limit at each sample, m/s, infinite without; empty when there is none anywhere.
    speed_limits: Vec<f64>,
}

impl GeometricPath {
    /// A way through samples. `None` for fewer than two, for numbers that are not finite, and where the arc length does not rise.
    #[must_use]
    pub fn new(points: Vec<PathPoint>) -> Option<Self> {
        let finite = points
            .iter()
            .all(|p| p.s.is_finite() && p.x.is_finite() && p.y.is_finite() && p.yaw.is_finite() && p.k.is_finite());
        let rising = points.windows(2).all(|pair| pair[1].s > pair[0].s);
        (points.len() >= 2 && finite && rising).then_some(Self {
            points,
            speed_limits: Vec::new(),
        })
    }

    /// A straight line, sampled about every `step` metres; `None` when it has no length.
    #[must_use]
    pub fn straight(from: Point2<f64>, to: Point2<f64>, step: f64) -> Option<Self> {
        let way = to - from;
        let length = way.norm();
        if !length.is_finite() || length <= 1e-9 {
            return None;
        }
        // Few samples blunt the speed's peak, many cost memory: both ends are bounded.
        let pieces = (length / step).ceil().clamp(8.0, 4096.0) as usize;
        let yaw = way.y.atan2(way.x);
        let at = |i: usize| {
            let share = i as f64 / pieces as f64;
            let p = from + way * share;
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

    /// The same way, slower where the map's zones ask for it. A limit holds on both intervals beside its sample.
    #[must_use]
    pub fn limited(mut self, speed_limit: SpeedLimit<'_>) -> Self {
        let limits = self
            .points
            .iter()
            .map(|p| speed_limit(Point2::new(p.x, p.y)).map_or(f64::INFINITY, |limit| limit.max(SLOWEST)));
        let limits: Vec<f64> = limits.collect();
        self.speed_limits = if limits.iter().all(|limit| limit.is_infinite()) {
            Vec::new()
        } else {
            limits
        };
        self
    }

    /// Speed limit on the intervals beside a sample, m/s; infinite without.
    #[must_use]
    pub fn speed_limit(&self, index: usize) -> f64 {
        let around = index.saturating_sub(1)..(index + 2).min(self.speed_limits.len());
        let limits = self.speed_limits.get(around).unwrap_or_default();
        limits.iter().copied().fold(f64::INFINITY, f64::min)
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

    /// The point `ds` metres after sample `index` (which has a successor): cubic in position and heading, linear in curvature.
    #[must_use]
    pub fn between(&self, index: usize, ds: f64) -> PathPoint {
        let (from, to) = (&self.points[index], &self.points[index + 1]);
        let length = to.s - from.s;
        let u = (ds / length).clamp(0.0, 1.0);
        let tangent = |yaw: f64| Vector2::new(yaw.cos(), yaw.sin()) * length;
        let (m0, m1) = (tangent(from.yaw), tangent(to.yaw));
        PathPoint {
            s: from.s + u * length,
            x: hermite(u, from.x, to.x, m0.x, m1.x),
            y: hermite(u, from.y, to.y, m0.y, m1.y),
            yaw: hermite(u, from.yaw, to.yaw, from.k * length, to.k * length),
            k: from.k + u * (to.k - from.k),
        }
    }

    /// Largest change of heading from one sample to the next, rad: large at a cusp.
    #[must_use]
    pub fn largest_turn(&self) -> f64 {
        self.points
            .windows(2)
            .map(|pair| wrap_angle(pair[1].yaw - pair[0].yaw).abs())
            .fold(0.0, f64::max)
    }
}

/// Cubic through two values with two slopes (per unit of `u`).
fn hermite(u: f64, from: f64, to: f64, slope_from: f64, slope_to: f64) -> f64 {
    let (u2, u3) = (u * u, u * u * u);
    from * (2.0 * u3 - 3.0 * u2 + 1.0)
        + slope_from * (u3 - 2.0 * u2 + u)
        + to * (3.0 * u2 - 2.0 * u3)
        + slope_to * (u3 - u2)
}
