//! Bezier curve. A chain of Bezier pieces of degree five, and samples along it.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::wrap_angle;

use super::timing::{GeometricPath, PathPoint};

/// A curve, with the result of the solver.
#[derive(Clone, Debug)]
pub struct Curve {
    pieces: Vec<[Point2<f64>; 6]>,
    /// The solver's status.
    pub solver: String,
    /// Iterations of the solver.
    pub iterations: u32,
    /// Its relative duality gap.
    pub gap: f64,
}

/// Why there is no curve.
///
/// ```
/// use zenav_smoothing::{Ends, fit};
///
/// let refused = fit(&[], &Ends::default(), 0.25, 60).unwrap_err();
/// assert_eq!(refused.to_string(), "no polygons");
/// ```
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CurveError {
    /// The solver found none.
    #[error("{0}")]
    Solver(String),
    /// The curve stops and turns back somewhere: no heading there.
    #[error("cusp")]
    Cusp,
}

/// Samples of a curve.
#[derive(Clone, Debug)]
pub struct Sampled {
    /// The samples.
    pub geometry: GeometricPath,
    /// The last sample of each piece.
    pub ends: Vec<usize>,
}

/// Largest turn from one sample to the next, rad.
const FINE_TURN: f64 = 0.04;
/// A turn between samples that stays above this at the finest sampling is a cusp, rad.
const CUSP: f64 = 0.5;
/// Curvature from which on a curve is practically a turn on the spot, 1/m.
const SHARPEST: f64 = 500.0;
/// Largest number of samples of a piece.
const MOST_SAMPLES: usize = 1024;

impl Curve {
    pub(super) fn new(pieces: Vec<[Point2<f64>; 6]>, solver: String, iterations: u32, gap: f64) -> Self {
        Self {
            pieces,
            solver,
            iterations,
            gap,
        }
    }

    /// Control points of the pieces.
    #[must_use]
    pub fn pieces(&self) -> &[[Point2<f64>; 6]] {
        &self.pieces
    }

    /// Samples at most about `step` metres apart, closer where the curve turns.
    ///
    /// # Errors
    /// [`CurveError::Cusp`] if the curve has no heading somewhere.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_smoothing::{CorridorSettings, Ends, corridor, fit};
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 100 };
    /// # let map = Grid::filled(spec, Occupancy::FREE);
    /// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
    /// # let path = [(1.0, 1.0), (3.0, 1.0), (3.0, 3.0)].map(|(x, y)| Point2::new(x, y));
    /// # let polygons = corridor(&space, &path, &CorridorSettings::default());
    /// # let curve = fit(&polygons, &Ends::default(), 0.25, 60)?;
    /// let sampled = curve.sampled(0.05)?;
    /// let points = sampled.geometry.points();
    /// assert!(points.windows(2).all(|pair| pair[1].s > pair[0].s && (pair[1].yaw - pair[0].yaw).abs() < 0.1));
    /// assert_eq!((sampled.ends.len(), sampled.ends.last()), (curve.pieces().len(), Some(&(points.len() - 1))));
    /// # Ok::<(), zenav_smoothing::CurveError>(())
    /// ```
    pub fn sampled(&self, step: f64) -> Result<Sampled, CurveError> {
        let mut points: Vec<PathPoint> = Vec::new();
        let mut ends = Vec::with_capacity(self.pieces.len());
        for (i, piece) in self.pieces.iter().enumerate() {
            let polygon: f64 = piece.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            // A step that is not a number counts as a large one.
            let mut samples = ((polygon / step).ceil().clamp(2.0, MOST_SAMPLES as f64) as usize).max(2);
            let polynomial = Polynomial::new(piece);
            let before = points.len();
            loop {
                points.truncate(before);
                let finest = samples >= MOST_SAMPLES;
                match polynomial.append(samples, i == 0, &mut points) {
                    Some(turn) if turn <= FINE_TURN || (finest && turn <= CUSP) => break,
                    _ if finest => return Err(CurveError::Cusp),
                    _ => samples *= 2,
                }
            }
            ends.push(points.len() - 1);
        }
        let geometry = GeometricPath::new(points).ok_or(CurveError::Cusp)?;
        Ok(Sampled { geometry, ends })
    }
}

/// A piece as a polynomial of its parameter, 0 to 1.
struct Polynomial {
    start: Point2<f64>,
    end: Point2<f64>,
    powers: [Vector2<f64>; 5],
}

impl Polynomial {
    fn new(piece: &[Point2<f64>; 6]) -> Self {
        // Repeated differences of the control points, times binomial coefficients, are the coefficients.
        let mut differences: Vec<Vector2<f64>> = piece.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let mut powers = [Vector2::zeros(); 5];
        for (power, binomial) in powers.iter_mut().zip([5.0, 10.0, 10.0, 5.0, 1.0]) {
            *power = differences[0] * binomial;
            differences = differences.windows(2).map(|pair| pair[1] - pair[0]).collect();
        }
        Self {
            start: piece[0],
            end: piece[5],
            powers,
        }
    }

    fn place(&self, u: f64) -> Point2<f64> {
        let [a, b, c, d, e] = &self.powers;
        self.start + (a + (b + (c + (d + e * u) * u) * u) * u) * u
    }

    fn first(&self, u: f64) -> Vector2<f64> {
        let [a, b, c, d, e] = &self.powers;
        a + (b * 2.0 + (c * 3.0 + (d * 4.0 + e * (5.0 * u)) * u) * u) * u
    }

    fn second(&self, u: f64) -> Vector2<f64> {
        let [_, b, c, d, e] = &self.powers;
        b * 2.0 + (c * 6.0 + (d * 12.0 + e * (20.0 * u)) * u) * u
    }

    /// Appends samples; returns the largest turn between two of them, or `None` where there is no heading.
    fn append(&self, samples: usize, with_first: bool, points: &mut Vec<PathPoint>) -> Option<f64> {
        let mut largest = 0.0_f64;
        let speed = |u: f64| self.first(u).norm();
        let step = 1.0 / samples as f64;
        for i in usize::from(!with_first)..=samples {
            let u = i as f64 * step;
            // The end is taken exactly.
            let place = if i == samples { self.end } else { self.place(u) };
            let (first, second) = (self.first(u), self.second(u));
            let rate = first.norm();
            let k = first.perp(&second) / (rate * rate * rate);
            // Without speed the curvature is NaN: a cusp as well.
            if rate <= 1e-6 || k.is_nan() || k.abs() >= SHARPEST {
                return None;
            }
            let mut point = PathPoint {
                s: 0.0,
                x: place.x,
                y: place.y,
                yaw: first.y.atan2(first.x),
                k,
            };
            if let Some(last) = points.last() {
                let turn = wrap_angle(point.yaw - last.yaw);
                largest = largest.max(turn.abs());
                point.yaw = last.yaw + turn;
                // Gauss-Legendre quadrature with three points.
                let (middle, reach) = (u - 0.5 * step, 0.5 * step * 0.6_f64.sqrt());
                point.s = last.s
                    + step / 18.0 * (5.0 * speed(middle - reach) + 8.0 * speed(middle) + 5.0 * speed(middle + reach));
            }
            points.push(point);
        }
        Some(largest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_lie_on_the_curve_and_the_last_one_of_a_piece_at_its_end() {
        let first = [0.0, 0.4, 0.9, 1.3, 1.8, 2.0].map(|x: f64| Point2::new(x, 0.5 * (x * 3.0).sin()));
        // The same piece rotated by half a turn about the first one's end.
        let mut second = first.map(|p| Point2::new(2.0 * first[5].x - p.x, 2.0 * first[5].y - p.y));
        second.reverse();
        let curve = Curve::new(vec![first, second], String::new(), 0, 0.0);
        let sampled = curve.sampled(0.02).unwrap();
        let points = sampled.geometry.points();
        assert_eq!(sampled.ends[1], points.len() - 1);
        let end = points[sampled.ends[0]];
        assert!((end.position() - first[5]).norm() < 1e-4);
        // Halfway by de Casteljau's scheme.
        let mut row = first.to_vec();
        while row.len() > 1 {
            row = row
                .windows(2)
                .map(|pair| nalgebra::center(&pair[0], &pair[1]))
                .collect();
        }
        assert!((Polynomial::new(&first).place(0.5) - row[0]).norm() < 1e-12);
        let distances = points.iter().map(|p| (p.position() - row[0]).norm());
        assert!(distances.fold(f64::INFINITY, f64::min) < 0.011);
    }

    #[test]
    fn numbers_that_are_none_end_the_sampling() {
        let line = [0.0, 0.4, 0.8, 1.2, 1.6, 2.0].map(|x| Point2::new(x, 0.0));
        let curve = |piece| Curve::new(vec![piece], String::new(), 0, 0.0);
        assert_eq!(curve(line).sampled(f64::NAN).unwrap().geometry.points().len(), 3);
        let nowhere = line.map(|p| p * f64::NAN);
        assert!(matches!(curve(nowhere).sampled(0.02), Err(CurveError::Cusp)));
    }

    #[test]
    fn a_curve_that_turns_back_has_no_heading() {
        let there = [0.0, 1.0, 2.0, 2.0, 1.0, 0.0].map(|x| Point2::new(x, 0.0));
        let curve = Curve::new(vec![there], String::new(), 0, 0.0);
        assert!(matches!(curve.sampled(0.02), Err(CurveError::Cusp)));
    }
}
